"""Reads the readings of one sample by one or several instruments, corrects their colours, and merges them.

A colour correction is learned at the directions that both instruments measured, and applied to all readings of the
goniometer. The goniometer's values at these directions are interpolated in half and difference angles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.optimize import brentq
from scipy.spatial import Delaunay, QhullError, cKDTree

from manifold.colour.correction import ColourCorrection, learn_correction, read_correction, write_correction
from manifold.colour.difference import delta_e_2000_lab, lab_values
from manifold.colour.narrow_bands import in_daylight
from manifold.core import disk, progress
from manifold.core.directions import SAME_RAD, to_rusinkiewicz
from manifold.core.errors import BandMismatchError, UsageError
from manifold.core.names import counted, first_few
from manifold.core.records import Array
from manifold.core.results import Result, derived, entry
from manifold.estimate.inputs import Sample
from manifold.formats import registry
from manifold.formats.readings import NO_GLOSS, Between, GlossUnits, Readings
from manifold.formats.recognition import counts_as_readings
from manifold.library.identity import alike
from manifold.library.importing import find_files

_ENOUGH_SAMPLES = 6  # samples for a colour correction; see docs/explanation/completion.md
_ASK_FOR_PAIRS = "do both files of each pair read one sample?"
_CAMERA_BANDS = 3  # of the instruments whose colours are corrected
_MOST_READINGS = 2000  # most readings of a goniometer that are used
_TWO_SAMPLES = (
    0.2  # error of a correction; in the corpus always less for one sample, and more for 4 in 5 pairs of two
)
_SIMPLEX = 4  # points needed to interpolate in three coordinates


@dataclass(frozen=True, eq=False)
class CalibratedInstrument(Result):
    """A colour correction that was learned from named samples and written to a file.

    Attributes:
        left_out: texts that name the samples without a partner, their files, and the reason.
    """

    path: Path = field(metadata=entry())
    correction: ColourCorrection
    samples: Sequence[str] = field(
        metadata=entry(row="samples", words=lambda made: len(made.samples), json=False)
    )
    left_out: tuple[str, ...] = field(default=(), metadata=entry())

    @property
    @derived(row="form", json=False)
    def form(self) -> str:
        """The mathematical form of the correction."""
        return self.correction.form

    @property
    def errors(self) -> dict[str, float]:
        """Relative leave-one-out errors by form, and without a correction; NaN if an error could not be measured."""
        return {**self.correction.errors, "none: estimated spectra": self.correction.uncorrected}

    @property
    @derived(json=lambda made: dict(made.ciede2000))
    def ciede2000(self) -> list[tuple[str, list[float]]]:
        """Return the CIEDE2000 (D65/2) of every sample from the reference, before and after the correction.

        The correction is learned without the sample; unknown values are NaN.
        """
        colours = self.correction.colours
        if len(self.samples) == 1:
            colours = colours.mean(axis=0, keepdims=True)
        return list(zip(self.samples, colours.tolist(), strict=False))

    @property
    def harm(self) -> str | None:
        """The reason why the correction is worse than none by its leave-one-out errors; None if it is not worse."""
        learned = self.correction
        error = learned.errors[learned.form]
        if error >= learned.uncorrected:
            return f"leave-one-out error {error:.4f}, without a correction {learned.uncorrected:.4f}"
        if len(self.samples) == 1:
            return None  # its readings are left out, which says nothing of other colours
        before, after = learned.colours.mean(axis=0)
        if after > before:
            return f"mean CIEDE2000 (D65/2) {before:.1f} without it, {after:.1f} with it"
        return self._worse if 2 * np.sum(learned.is_worse) > len(self.samples) else None

    @property
    def _worse(self) -> str:
        """The samples that become worse, worst first."""
        colours = self.correction.colours
        worse = np.flatnonzero(self.correction.is_worse)
        named = [
            f"{self.samples[k]} (CIEDE2000, D65/2: {colours[k, 0]:.1f} before, {colours[k, 1]:.1f} after)"
            for k in worse[np.argsort(colours[worse, 0] - colours[worse, 1], kind="stable")]
        ]
        return f"{counted(len(worse), 'sample')} of {len(self.samples)} become worse: {first_few(named)}"

    @property
    @derived()
    def notes(self) -> tuple[str, ...]:
        """Return sentences about the range and quality of the correction."""
        notes, n_samples = [], len(self.samples)
        if self.left_out:
            apart = first_few(self.left_out, 6, "; ", " (--json lists them)")
            notes.append(f"{counted(len(self.left_out), 'sample')} left out: {apart}")
        harm = self.harm
        if n_samples > 1 and np.any(self.correction.is_worse) and harm != self._worse:
            notes.append(self._worse)
        if harm is not None:
            notes.append(f"do not use it: {harm}; {_ASK_FOR_PAIRS}")
        if n_samples < _ENOUGH_SAMPLES:
            few = (
                "one sample determines the correction of its own colour only: in simulations the error for other "
                "colours is one half"
                if n_samples == 1
                else f"{n_samples} samples determine a correction poorly: in simulations the error for other colours "
                "is a quarter, with six samples a sixth"
            )
            notes.append(f"{few}; give {_ENOUGH_SAMPLES} or more samples of different colours")
        return tuple(notes)

    def to_json(self) -> dict[str, Any]:
        """Return plain values that are added to those of the correction."""
        return self.correction.to_json() | super().to_json()


def learn_across(pairs: Sequence[tuple[Readings, Readings]]) -> ColourCorrection:
    """Learn the colour correction of an instrument from pairs of readings (reference, other) of the same samples.

    All readings of an instrument must have the same bands.
    """
    pairs = [(in_daylight(reference), in_daylight(other)) for reference, other in pairs]
    for pair in pairs[1:]:
        for one, first in zip(pair, pairs[0], strict=True):
            first.bands.require_same(
                one.bands, one.name, "calibrate from readings of the same two instruments"
            )
    values = [_shared_values(*pair) for pair in pairs]
    groups = np.repeat(np.arange(len(pairs)), [len(x) for x, _ in values])
    return learn_correction(
        np.vstack([x for x, _ in values]), np.vstack([y for _, y in values]), pairs[0][1].bands, pairs[0][0].bands,
        groups=groups if len(pairs) > 1 else None,
    )  # fmt: skip


def correct_colours(readings: Readings, correction: ColourCorrection) -> Readings:
    """Return corrected readings, in the bands of the correction's reference instrument."""
    readings = in_daylight(readings)
    correction.source.require_same(
        readings.bands, readings.name, "the colour correction was learned from another instrument"
    )
    nm = correction.reference.wavelengths_nm
    known = readings.measured.all(axis=1)
    values = np.full((len(readings), correction.reference.count), np.nan)
    values[known] = correction.apply(readings.values[known])
    beyond = 100.0 * float(np.mean(correction.is_beyond(readings.values[known]))) if known.any() else 0.0
    note = f"colours corrected: {correction.form}"
    if beyond > 0.0:
        note += f"; {beyond:.0f} % of the readings are brighter than those it was learned from: corrected in proportion"
    nm_array = None if nm is None else np.array(nm)
    return replace(readings, wavelengths_nm=nm_array, values=values).with_note(note)


def merge(reference: Readings, other: Readings) -> tuple[Readings, ColourCorrection | None]:
    """Merge readings of one sample by two instruments in the bands of the first; also return the colour correction.

    The reference is a spectrophotometer. The other instrument is a goniometer, whose colours are corrected to those
    of the reference if it has three bands. If both have the same bands, nothing is corrected and the correction is
    None.
    """
    if reference.bands == other.bands:
        return _joined(reference, other), None
    x, y = _shared_values(reference, other)
    correction = learn_correction(x, y, other.bands, reference.bands)
    error = correction.errors[correction.form]
    note = f"{other.instrument} corrected by {reference.instrument} at {len(x)} directions that both read"
    if np.isfinite(error):
        note += f", with a leave-one-out error of {100.0 * error:.0f} %"
    if error > _TWO_SAMPLES:
        note += f": do both files read one sample, {reference.name} and {other.name}?"
    step = -(-len(other) // _MOST_READINGS)
    some = other.select_pairs(np.arange(0, len(other), step))
    return _joined(reference, correct_colours(some, correction)).with_note(note), correction


def between_measurements(parts: Sequence[Readings]) -> Between | None:
    """Return the differences between measurements of one sample beyond their repeatability.

    `parts` are in the same bands, each from one file or instrument. The result is None if no two share a direction
    pair. One variance between measurements is estimated over all direction pairs.

    Source: Mandel & Paule 1970.
    """
    at = np.vstack([_coordinates(part.wi, part.wo) for part in parts])
    values = np.vstack([part.values for part in parts])
    within = np.concatenate([np.full(len(part), part.repeatability) for part in parts])
    file = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    near = cKDTree(at).query_ball_point(at, SAME_RAD, return_sorted=True)
    groups = [np.array(g) for g in dict.fromkeys(map(tuple, near)) if len(set(file[list(g)])) > 1]
    groups = [g for g in groups if np.isfinite(values[g]).all() and np.all(values[g].mean(axis=0) > 0.0)]
    if not groups:
        return None

    def excess(variance: float) -> float:
        total = 0.0
        for g in groups:
            weight = 1.0 / (within[g] ** 2 + variance)
            mean = weight @ values[g] / weight.sum()
            total += float(np.mean(weight @ ((values[g] - mean) / mean) ** 2)) - (len(g) - 1)
        return total

    variance = 0.0 if excess(0.0) <= 0.0 else 1.0 if excess(1.0) >= 0.0 else brentq(excess, 0.0, 1.0)
    bands = parts[0].bands
    apart = [delta_e_2000_lab(*lab_values(values[g[[0, -1]]], bands, parts[0].viewing)) for g in groups]
    return Between(float(np.sqrt(variance)), float(np.mean(apart)), len(groups))


def _shared_values(reference: Readings, other: Readings) -> tuple[Array, Array]:
    """Return values of another instrument (S, 3) and of the reference (S, B) at shared directions."""
    if other.bands.count != _CAMERA_BANDS:
        raise BandMismatchError(
            f"{other.name}: {other.bands}, expected three bands, which the {reference.bands} of "
            f"{reference.name} correct; give the spectrophotometer's file first"
        )
    at_reference = _interpolated(other, reference.wi, reference.wo)
    is_shared = np.isfinite(at_reference).all(axis=1) & reference.measured.all(axis=1)
    return at_reference[is_shared], reference.values[is_shared]


def _interpolated(readings: Readings, wi: Array, wo: Array) -> Array:
    """Interpolate values of an isotropic sample to direction pairs (P, 3): (P, B), NaN outside its readings' hull."""
    known = readings.measured.all(axis=1)
    at, roots = _coordinates(readings.wi[known], readings.wo[known]), np.cbrt(readings.values[known])
    _, first = np.unique(at.round(4), axis=0, return_index=True)
    if len(first) < _SIMPLEX:
        return np.full((len(wi), readings.bands.count), np.nan)
    try:
        interpolator = LinearNDInterpolator(_triangulation(at[first].tobytes()), roots[first])
    except QhullError as error:  # points in a plane
        raise UsageError(
            f"{readings.name}: its directions lie in one plane, expected several incidences to interpolate between"
        ) from error
    return np.asarray(interpolator(_coordinates(wi, wo))) ** 3


@lru_cache(maxsize=4)
def _triangulation(points: bytes) -> Delaunay:
    """Return the triangulation of points (K, 3), float64, cached because all samples share their directions."""
    return Delaunay(np.frombuffer(points).reshape(-1, 3))


def _coordinates(wi: Array, wo: Array) -> Array:
    """Return half and difference angles of an isotropic, reciprocal BRDF: `sqrt(theta_h)`, theta_d by phi_d; (P, 3)."""
    theta_h, theta_d, phi_d, _ = to_rusinkiewicz(wi, wo)
    folded = np.abs(np.mod(phi_d + 0.5 * np.pi, np.pi) - 0.5 * np.pi)  # [0, pi / 2]
    return np.column_stack([np.sqrt(theta_h), theta_d * np.cos(folded), theta_d * np.sin(folded)])


def _joined(reference: Readings, other: Readings) -> Readings:
    """Join the readings of both; the reference's readings together weigh at least as much as the other's."""
    share = max(len(other) / len(reference), 1.0)
    return replace(
        reference,
        instrument=f"{reference.instrument} + {other.instrument}",
        wi=np.vstack([reference.wi, other.wi]),
        wo=np.vstack([reference.wo, other.wo]),
        values=np.vstack([reference.values, other.values]),
        weights=np.concatenate([reference.weights, other.weights / share]),
        scatter=np.concatenate([reference.scatter, other.scatter]),
        notes=tuple(dict.fromkeys((*reference.notes, *other.notes))),
        gloss={**other.gloss, **reference.gloss},
        texture={**other.texture, **reference.texture},
        colour_error=max(reference.colour_error, other.colour_error),
    )


def read(
    paths: Sequence[Path],
    sample: str | None = None,
    correction: Path | None = None,
    gloss: GlossUnits = NO_GLOSS,
    unit: str | None = None,
) -> tuple[Readings, ColourCorrection | None]:
    """Read one sample from its files; also return the colour correction learned from the files of two instruments.

    Args:
        paths: files of the sample; the instrument with the correct colours comes first.
        sample: name of the sample, if a file has several.
        correction: file of `manifold calibrate`, which is applied to readings in three bands.
        gloss: gloss units by angle in degrees, which replace gloss in the files.
        unit: unit of values in files that name none, see `registry.read`.

    Returns:
        The readings, and the correction; None if none was learned.
    """
    is_only = len(paths) == 1
    readings = [
        registry.read_readings(path, sample, _MOST_READINGS, is_only=is_only, unit=unit) for path in paths
    ]
    names = list(dict.fromkeys(each.name for each in readings))
    if sample is not None and sample not in names:
        raise UsageError(
            f"no file holds a sample '{sample}', but {' and '.join(names)}; name another, or none"
        )
    return _merged(readings, correction, gloss)


def read_sample(
    sample: Sample, correction: Path | None = None, gloss: GlossUnits = NO_GLOSS
) -> tuple[Readings, ColourCorrection | None]:
    """Read a sample that `inputs.find_samples` found; return its readings and correction like `read`."""
    readings = [registry.read_readings(path, name, _MOST_READINGS) for path, name in sample.parts]
    merged, learned = _merged(readings, correction, gloss)
    return merged if sample.note is None else merged.with_note(sample.note), learned


def _merged(
    readings: list[Readings], correction: Path | None, gloss: GlossUnits
) -> tuple[Readings, ColourCorrection | None]:
    if correction is not None:
        known = read_correction(correction)
        readings = [correct_colours(r, known) if r.bands.count == 3 else r for r in readings]
    if len({one.viewing for one in readings if one.bands.is_rgb}) > 1:
        readings = [in_daylight(one) for one in readings]
    merged, learned = readings[0], None
    for other in readings[1:]:
        merged, learned = merge(merged, other)
    comparable = [one for one in readings if one.bands == readings[0].bands]
    if len(comparable) > 1 and (between := between_measurements(comparable)) is not None:
        repeatability = float(np.hypot(merged.repeatability, between.deviation))
        merged = replace(merged, between=between, repeatability=repeatability)
    return replace(merged, gloss={**merged.gloss, **gloss}), learned


def calibrate(paths: Sequence[Path], output: Path, *, allow_harm: bool = False) -> CalibratedInstrument:
    """Learn an instrument's colour correction from samples that two instruments measured, and write it as JSON.

    Args:
        paths: files or folders, alternately of the reference and of the other instrument. Samples with the same name
            in both are used; in two files with a single sample each, the names may differ.
        output: the file to write.
        allow_harm: write the correction even if its leave-one-out errors are larger than those without a correction.

    Raises:
        UsageError: the paths are not pairs, no sample is in both, or the correction is worse than none.
    """
    disk.require_writable(output)
    if len(paths) % 2 or not paths:
        raise UsageError(
            f"found {len(paths)}, expected pairs of files or folders: the reference's, then the other's"
        )
    pairs: list[tuple[Readings, Readings]] = []
    left_out: list[str] = []
    for reference, other in zip(paths[::2], paths[1::2], strict=True):
        shared, apart = pairs_of(reference, other)
        pairs += shared
        left_out += apart
    learned = learn_across(pairs)
    calibrated = CalibratedInstrument(output, learned, [one.name for one, _ in pairs], tuple(left_out))
    if calibrated.harm is not None and not allow_harm:
        unpaired = f"; left out: {first_few(left_out, 3, '; ')}" if left_out else ""
        raise UsageError(
            f"{output}: not written, the correction is worse than none ({calibrated.harm}){unpaired}; {_ASK_FOR_PAIRS} "
            "give more samples of different colours, or write it with --allow-harm (allow_harm=True)"
        )
    write_correction(output, learned)
    return calibrated


def pairs_of(reference: Path, other: Path) -> tuple[list[tuple[Readings, Readings]], list[str]]:
    """Return pairs of readings of samples with the same name under two paths.

    The second result holds a text for each sample without a partner, which states the reason.
    """
    if reference == other:
        raise UsageError(
            f"{reference} is given twice, expected files of the reference and of another instrument"
        )
    first, second = _samples_in(reference), _samples_in(other)
    if len(first) == len(second) == 1 and not (reference.is_dir() or other.is_dir()):
        second = dict.fromkeys(first, *second.values())  # whatever its name
    pairs, left_out = [], []
    for name in dict.fromkeys((*first, *second)):
        held = {reference: first.get(name, []), other: second.get(name, [])}
        if all(len(each) == 1 for each in held.values()):
            pairs.append((held[reference][0].readings, held[other][0].readings))
            continue
        path, files = max(held.items(), key=lambda each: len(each[1]))
        within = ", ".join(str(held_file.path) for held_file in files)
        why = f"read {len(files)} times in {path}" if len(files) > 1 else f"in {path} only"
        left_out.append(f"{files[0].readings.name} ({within}), {why}")
    if not pairs:
        raise UsageError(
            f"{reference} and {other}: no sample has the same name in both; found {first_few(left_out, 4, '; ')}"
        )
    return pairs, left_out


class _Held(NamedTuple):
    """Readings, and the file that holds them."""

    path: Path
    readings: Readings


def _samples_in(path: Path) -> dict[str, list[_Held]]:
    """Return readings in a file, or in the files of a folder, by the names of their samples."""
    held: dict[str, list[_Held]] = {}
    files = find_files([path], counts_as_readings, "readings file") if path.is_dir() else [path]
    for file in progress.each(files, str):
        for record in registry.read_all(file):
            readings = registry.as_readings(record, _MOST_READINGS)
            held.setdefault(alike(readings.name.strip()), []).append(_Held(file, readings))
    return held
