"""Readings of one sample by one or several instruments, read from files and put together, colours corrected.

A colour correction is learned at the directions that both instruments read, and applied to all readings of the
goniometer. For these directions its values are interpolated in half and difference angles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.optimize import brentq
from scipy.spatial import QhullError, cKDTree

from manifold import disk
from manifold.colour.correction import ColourCorrection, learn_correction, read_correction, write_correction
from manifold.colour.difference import delta_e_2000_lab, lab_values
from manifold.colour.narrow_bands import in_daylight
from manifold.directions import to_rusinkiewicz
from manifold.errors import BandMismatchError, UsageError
from manifold.estimate.inputs import Sample, find_samples
from manifold.formats import registry
from manifold.formats.readings import Between, Readings
from manifold.library.identity import alike
from manifold.names import counted
from manifold.records import Array, plain

_ENOUGH_SAMPLES = 6  # samples for a colour correction; see docs/explanation/completion.md
_SHOWN_WORSE = 5
_CAMERA_BANDS = 3
_SAME_PLACE = 1e-3  # largest distance between pairs of directions, in half and difference angles, in radians
_MOST_READINGS = 2000  # most readings of a goniometer that are used
_TWO_SAMPLES = (
    0.2  # error of a correction; in the corpus always less for one sample, and more for 4 in 5 pairs of two
)
_SIMPLEX = 4  # points needed to interpolate in three coordinates


@dataclass(frozen=True, eq=False)
class CalibratedInstrument:
    """A colour correction that was learned from samples, whose names it has, and written."""

    path: Path
    correction: ColourCorrection
    samples: Sequence[str]

    @property
    def errors(self) -> dict[str, float]:
        """Relative error, left out, by form; and without a correction. NaN where it could not be measured."""
        return {**self.correction.errors, "none: estimated spectra": self.correction.uncorrected}

    @property
    def colours(self) -> list[tuple[str, list[float]]]:
        """Of every sample CIEDE2000 (D65/2) to the reference, before and after the correction, left out; or NaN."""
        colours = self.correction.colours
        if len(self.samples) == 1:
            colours = colours.mean(axis=0, keepdims=True)
        return list(zip(self.samples, colours.tolist(), strict=False))

    @property
    def notes(self) -> tuple[str, ...]:
        """What the correction is good for, in sentences."""
        learned, samples = self.correction, self.samples
        notes, n_samples = [], len(samples)
        if n_samples > 1 and (worse := np.flatnonzero(learned.is_worse)).size:
            shown = [
                f"{samples[k]} (CIEDE2000, D65/2: {learned.colours[k, 0]:.1f} before, "
                f"{learned.colours[k, 1]:.1f} after)"
                for k in worse[np.argsort(np.diff(learned.colours[worse])[:, 0])[::-1][:_SHOWN_WORSE]]
            ]
            notes.append(
                f"{counted(len(worse), 'sample')} of {n_samples} become worse: {', '.join(shown)}"
                + (" and others" if len(worse) > _SHOWN_WORSE else "")
            )
        error = learned.errors[learned.form]
        if error >= learned.uncorrected:
            notes.append(
                f"spectra estimated without a correction have a smaller error, {learned.uncorrected:.4f}: do not "
                "use it; do both files of each pair read one sample?"
            )
        if n_samples < _ENOUGH_SAMPLES:
            few = (
                "one sample determines the correction of its own colour only: in simulations the error for other "
                "colours is one half"
                if n_samples == 1
                else f"{n_samples} samples determine a correction badly: in simulations the error for other colours "
                "is a quarter, with six samples a sixth"
            )
            notes.append(f"{few}; give {_ENOUGH_SAMPLES} or more samples of different colours")
        return tuple(notes)

    def to_json(self) -> dict[str, Any]:
        """Plain values; None for an error that could not be measured."""
        known = {"path": self.path, "ciede2000": dict(self.colours), "notes": self.notes}
        return self.correction.to_json() | plain(known)


def learn_across(pairs: Sequence[tuple[Readings, Readings]]) -> ColourCorrection:
    """The correction of an instrument by another, from their readings (reference, other) of samples, all in the same
    bands.
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
    """Return readings in the bands of the reference that a correction was learned from."""
    readings = in_daylight(readings)
    correction.source.require_same(
        readings.bands, readings.name, "the colour correction was learned from another instrument's"
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
    """Readings of one sample by two instruments, in the bands of the first, and the colour correction that was learned.

    The reference is a spectrophotometer, to whose colours the other is corrected: a goniometer, in the same bands,
    which leave nothing to correct (None), or in three.
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
    """How far measurements of one sample differ beyond what each repeats; None where no two share a direction pair.

    Parts are in the same bands, each of one file or instrument. Source: Mandel & Paule 1970; over all pairs of
    directions with one between-measurement variance.
    """
    at = np.vstack([_coordinates(part.wi, part.wo) for part in parts])
    values = np.vstack([part.values for part in parts])
    within = np.concatenate([np.full(len(part), part.repeatability) for part in parts])
    file = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    near = cKDTree(at).query_ball_point(at, _SAME_PLACE, return_sorted=True)
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
    """Values of another instrument (S, 3) and of the reference (S, B) where both read a sample."""
    if other.bands.count != _CAMERA_BANDS:
        raise BandMismatchError(
            f"{other.name}: {other.bands}, expected three bands, to be corrected by the {reference.bands} of "
            f"{reference.name}; give the spectrophotometer's file first"
        )
    at_reference = _interpolated(other, reference.wi, reference.wo)
    is_shared = np.isfinite(at_reference).all(axis=1) & reference.measured.all(axis=1)
    return at_reference[is_shared], reference.values[is_shared]


def _interpolated(readings: Readings, wi: Array, wo: Array) -> Array:
    """Values of an isotropic sample interpolated at direction pairs (P, 3): (P, B), NaN outside its readings' hull."""
    known = readings.measured.all(axis=1)
    at, roots = _coordinates(readings.wi[known], readings.wo[known]), np.cbrt(readings.values[known])
    _, first = np.unique(at.round(4), axis=0, return_index=True)
    if len(first) < _SIMPLEX:
        return np.full((len(wi), readings.bands.count), np.nan)
    try:
        interpolator = LinearNDInterpolator(at[first], roots[first])
    except QhullError as error:  # points in a plane
        raise UsageError(
            f"{readings.name}: its directions lie in one plane, expected several incidences to interpolate between"
        ) from error
    return np.asarray(interpolator(_coordinates(wi, wo))) ** 3


def _coordinates(wi: Array, wo: Array) -> Array:
    """Half and difference angles of an isotropic, reciprocal BRDF: `sqrt(theta_h)`, theta_d by phi_d; (P, 3)."""
    theta_h, theta_d, phi_d, _ = to_rusinkiewicz(wi, wo)
    folded = np.abs(np.mod(phi_d + 0.5 * np.pi, np.pi) - 0.5 * np.pi)  # [0, pi / 2]
    return np.column_stack([np.sqrt(theta_h), theta_d * np.cos(folded), theta_d * np.sin(folded)])


def _joined(reference: Readings, other: Readings) -> Readings:
    """The readings of both, weighted so that those of the reference count at least as much as the other's together."""
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
    gloss: Mapping[float, float] = MappingProxyType({}),
    unit: str | None = None,
) -> tuple[Readings, ColourCorrection | None]:
    """Readings of one sample from its files, and the colour correction that was learned from two instruments' files, if
    any.

    The instrument whose colours are right stands first. `correction`, a file of `manifold calibrate`, is applied to
    readings in three bands; `gloss`, in units by angle in degrees, goes before that of the files; `unit` is of values
    in files that say none, see `registry.read`.
    """
    is_only = len(paths) == 1
    readings = [
        registry.read_readings(path, sample, _MOST_READINGS, is_only=is_only, unit=unit) for path in paths
    ]
    names = list(dict.fromkeys(one.name for one in readings))
    if sample is not None and sample not in names:
        raise UsageError(
            f"no file holds a sample '{sample}', but {' and '.join(names)}; name another, or none"
        )
    return _merged(readings, correction, gloss)


def read_sample(
    sample: Sample, correction: Path | None = None, gloss: Mapping[float, float] = MappingProxyType({})
) -> tuple[Readings, ColourCorrection | None]:
    """The same of a sample that was found in files, see `inputs.find_samples`."""
    readings = [registry.read_readings(path, name, _MOST_READINGS) for path, name in sample.parts]
    merged, learned = _merged(readings, correction, gloss)
    return merged if sample.note is None else merged.with_note(sample.note), learned


def _merged(
    readings: list[Readings], correction: Path | None, gloss: Mapping[float, float]
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


def calibrate(paths: Sequence[Path], output: Path) -> CalibratedInstrument:
    """Learn an instrument's colour correction from files of samples that two instruments read, and write it as JSON.

    Paths are of every sample, or several of the same names, the reference's file, then the other's; or a folder of each
    instrument's, in which samples of the same names are used.
    """
    disk.require_writable(output)
    is_folders = len(paths) == 2 and all(path.is_dir() for path in paths)
    if len(paths) % 2 or not paths:
        raise UsageError(
            f"found {len(paths)}, expected pairs of files, of every sample the reference's, then the other's; or two "
            "folders, the reference's first"
        )
    pairs = (
        _pairs_of_folders(paths[0], paths[1])
        if is_folders
        else [
            pair
            for reference, other in zip(paths[::2], paths[1::2], strict=True)
            for pair in registry.read_pairs(reference, other, _MOST_READINGS)
        ]
    )
    learned = learn_across(pairs)
    write_correction(output, learned)
    return CalibratedInstrument(output, learned, [reference.name for reference, _ in pairs])


def _pairs_of_folders(reference: Path, other: Path) -> list[tuple[Readings, Readings]]:
    """Readings of the samples that have the same name in two folders."""
    first, second = ({alike(one.name): one for one in find_samples([path])} for path in (reference, other))
    shared = [(first[name], second[name]) for name in first if name in second]
    if not shared:
        raise UsageError(f"{reference} and {other}: no sample has the same name in both; name pairs of files")
    return [(read_sample(one)[0], read_sample(two)[0]) for one, two in shared]
