"""The work behind `manifold complete`: readings in, a full BRDF out, with its diagnostics."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from manifold import __version__
from manifold.brdf.gloss import gloss_meter
from manifold.brdf.plausibility import Plausibility
from manifold.colour.correction import ColourCorrection
from manifold.directions import from_spherical
from manifold.errors import UsageError
from manifold.formats import registry
from manifold.formats.readings import Readings
from manifold.library.store import Library
from manifold.model import diagnostics
from manifold.model.checked_file import require_bsdf_output, write_checked
from manifold.model.completion.complete import Completion, complete
from manifold.model.completion.correction_file import read_correction, write_correction
from manifold.model.completion.expected import calibrate
from manifold.model.completion.hybrid import Hybrid, combine, corrected, learn_across
from manifold.model.completion.samples import LibrarySamples
from manifold.model.completion.suggest import Suggested, directions_left, suggest
from manifold.model.prediction import ClippedBRDF
from manifold.records import Progress
from manifold.system import atomic
from manifold.system.stages import Stages
from manifold.workflows import renders

_MOST_READINGS = 2000
_ENOUGH_SAMPLES = 6  # of a colour correction; see docs/design/completion.md
_PROFILE_INCIDENCES_DEG = (20.0, 40.0, 60.0)
_PROFILE_ELEVATIONS_DEG = np.arange(-80.0, 81.0, 5.0)


@dataclass(frozen=True, eq=False)
class Completed:
    """A completed material, as written.

    Attributes:
        path: the written file.
        picture: of its ball; None where none was asked for.
        found: the completion.
        hybrid: what was read, and how instruments were put together.
        expected: expected errors: ball CIEDE2000, cube-root and linear error.
        plausibility: of the written file, read back.
        suggested: the next readings to take; None where none were asked for.
        diagnostics: what a user should know before trusting it, in sentences.
        seconds: in all, without reading.
    """

    path: Path
    picture: Path | None
    found: Completion
    hybrid: Hybrid
    expected: dict[str, float]
    plausibility: Plausibility
    suggested: Suggested | None
    diagnostics: tuple[str, ...]
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        found = self.found
        return {
            "path": str(self.path),
            "picture": None if self.picture is None else str(self.picture),
            "sample": found.readings.name,
            "instrument": found.readings.instrument,
            "readings": len(found.readings),
            "misfits": found.misfits.tolist(),
            "gloss": {
                f"{angle:g}": {"read": units, "completed": found.gloss[angle]}
                for angle, units in found.readings.gloss.items()
            },
            "made_of": dict(found.made_of),
            "alternatives": [vars(a) for a in found.alternatives],
            "expected": self.expected,
            "uncertainty": uncertainty(found),
            "correction": None if self.hybrid.correction is None else self.hybrid.correction.to_json(),
            "plausibility": vars(self.plausibility),
            "suggested_deg": None if self.suggested is None else self.suggested.angles_deg.tolist(),
            "diagnostics": list(self.diagnostics),
            "seconds": self.seconds,
        }


def complete_readings(
    hybrid: Hybrid,
    library: Path,
    output: Path,
    *,
    picture: Path | None = None,
    count: int = 0,
    instrument: str | None = None,
    physical: bool = False,
    force: bool = False,
    resolution: int = 32,
    n_theta_i: int = 8,
    on_progress: Progress | None = None,
) -> Completed:
    """Complete readings of one sample through the materials of a library, and write the BRDF as an RGL file.

    Args:
        hybrid: the readings, as `read` gives them.
        library: of measured materials.
        output: the file to write; its name becomes the material's.
        picture: of the ball, to render.
        count: how many further readings to suggest.
        instrument: whose directions to suggest.
        physical: project the file to non-negative, reciprocal within 5 %, and albedo at most 1.
        force: also write a file whose albedo exceeds 1.05.
        resolution: nodes per axis of the outgoing grid; with `physical`, at least.
        n_theta_i: incident elevations; with `physical`, at least.
        on_progress: called with how much is done.
    Raises:
        BandMismatchError: bands of readings and library do not go together.
        UsageError: the output does not end in `.bsdf`, nothing was read, or there is no such instrument.
    """
    start = time.perf_counter()
    if count:
        directions_left(count, hybrid.readings, instrument)
    require_bsdf_output(output, "completed materials")
    shares = {"reading materials": 4, "completing": 1, "expected error": 1, "writing": 1, "rendering": 2}
    stages = Stages(on_progress, shares)
    samples = LibrarySamples.of_library(Library.open(library), stages.begin("reading materials"))
    stages.begin("completing")
    found = complete(samples, hybrid.readings)
    stages.begin("expected error")
    calibration = calibrate(samples, found.readings)
    expected = calibration.expected(found)
    suggested = suggest(samples, count, found, instrument) if count else None
    stages.begin("writing")
    plausibility = write_checked(
        output,
        ClippedBRDF(found.brdf),
        description=_describe(found),
        remedy="scale it with --physical, measure more directions near the highlight",
        physical=physical,
        keeps_hue=True,  # readings tell colours well, and how much light there is in all directions badly
        force=force,
        resolution=resolution,
        n_theta_i=n_theta_i,
    )
    if picture is not None:
        settings = renders.make_settings(size=256, samples=32, seed=0, illuminant="D65", environment=None)
        renders.render(renders.file_source(output), picture, settings, stages.begin("rendering"))
    notes = (*found.notes, *calibration.notes(found), *diagnostics.of_prediction(False, plausibility))
    if physical:
        notes += diagnostics.of_projection(plausibility)
    return Completed(
        output, picture, found, hybrid, expected, plausibility, suggested, notes, time.perf_counter() - start,
    )  # fmt: skip


def read(
    paths: Sequence[Path],
    sample: str | None = None,
    correction: Path | None = None,
    gloss: Mapping[float, float] = MappingProxyType({}),
) -> Hybrid:
    """Readings of one sample from its files; those of several instruments are put together.

    Args:
        paths: of one instrument, or of several, whose colours are right first.
        sample: which of a file's samples, of every file that holds several.
        correction: of colours, a file of `manifold calibrate`, applied to readings in three bands.
        gloss: of the sample, in gloss units, by angle in degrees; that of the files, where they have some, otherwise.
    Raises:
        FileFormatError: a file is of no known format, or damaged.
        BandMismatchError: bands of the files, or of the correction, do not go together.
        UsageError: a file cannot be read, or has no such sample.
    """
    is_only = len(paths) == 1
    readings = [registry.read_readings(path, sample, _MOST_READINGS, is_only=is_only) for path in paths]
    names = list(dict.fromkeys(one.name for one in readings))
    if sample is not None and sample not in names:
        raise UsageError(
            f"no file holds a sample '{sample}', but {' and '.join(names)}; name another, or none"
        )
    if correction is not None:
        learned = read_correction(correction)
        readings = [corrected(r, learned) if r.values.shape[1] == 3 else r for r in readings]
    found = Hybrid(readings[0], None, 0)
    for other in readings[1:]:
        found = combine(found.readings, other)
    return replace(found, readings=replace(found.readings, gloss={**found.readings.gloss, **gloss}))


def parse_gloss(texts: Iterable[str]) -> dict[float, float]:
    """Gloss units by angle in degrees, of texts such as `60=12.5`.

    Raises:
        UsageError: a text is none, an angle is none of a gloss meter's, or comes twice.
    """
    found: dict[float, float] = {}
    for text in texts:
        angle, is_pair, units = text.partition("=")
        try:
            pair = float(angle), float(units)
        except ValueError:
            pair = np.nan, np.nan
        if not is_pair or not np.isfinite(pair).all() or pair[1] < 0.0:
            raise UsageError(f"gloss '{text}', expected an angle and gloss units, such as 60=12.5")
        gloss_meter(pair[0])
        if pair[0] in found:
            raise UsageError(f"gloss at {pair[0]:g} degrees twice, expected once; give their mean")
        found[pair[0]] = pair[1]
    return found


def calibrate_instrument(paths: Sequence[Path], output: Path) -> tuple[ColourCorrection, int]:
    """Learn an instrument's colour correction from files of samples that two instruments read, and write it.

    Args:
        paths: of every sample, or several of the same names, the reference's file, then the other's.
        output: a JSON file.
    Returns:
        The correction, and from how many samples it was learned.
    Raises:
        UsageError: the number of files is odd, no names are the same, or too few directions are shared.
        BandMismatchError: bands differ between samples, or the other instrument has not three.
    """
    if len(paths) % 2 or not paths:
        raise UsageError(
            f"{len(paths)} files, expected pairs: of every sample the reference's, then the other's"
        )
    atomic.require_writable(output)
    pairs = [
        pair
        for reference, other in zip(paths[::2], paths[1::2], strict=True)
        for pair in registry.read_pairs(reference, other, _MOST_READINGS)
    ]
    learned = learn_across(pairs)
    write_correction(output, learned)
    return learned.colours, len(pairs)


def calibration_notes(n_samples: int) -> tuple[str, ...]:
    """Limitations of a colour correction by the number of its samples, in sentences."""
    if n_samples >= _ENOUGH_SAMPLES:
        return ()
    few = (
        "one sample determines the correction of its own colour, and its error says nothing of others: in "
        "simulations these are missed by half"
        if n_samples == 1
        else f"{n_samples} samples determine a correction badly: in simulations new colours are missed by a quarter, "
        "with six by a sixth"
    )
    return (f"{few}; give {_ENOUGH_SAMPLES} or more samples of different colours",)


def suggest_first(library: Path, count: int, instrument: str | None = None) -> Suggested:
    """The readings to begin with, for a library, before anything is read."""
    directions_left(count, None, instrument)
    return suggest(LibrarySamples.of_library(Library.open(library)), count, None, instrument)


def uncertainty(found: Completion) -> dict[str, Any]:
    """Standard deviation of f over hypotheses, relative, in the plane of incidence, direction by direction."""
    profiles: dict[str, list[float]] = {}
    for incidence in _PROFILE_INCIDENCES_DEG:
        wi = from_spherical(np.deg2rad(incidence), np.pi)
        wo = from_spherical(np.deg2rad(_PROFILE_ELEVATIONS_DEG), 0.0)
        profiles[f"{incidence:g}"] = found.spread_at(np.broadcast_to(wi, wo.shape), wo).tolist()
    return {"theta_o_deg": _PROFILE_ELEVATIONS_DEG.tolist(), "by_incidence_deg": profiles}


def _describe(found: Completion) -> str:
    gloss = " and its gloss" if found.readings.gloss else ""
    return (
        f"Completed from {len(found.readings)} readings ({found.readings.instrument}) of {found.readings.name}{gloss} "
        f"through {len(found.samples.names)} materials by manifold {__version__}"
    )


def file_name(readings: Readings) -> str:
    """The default name of a completed material's file: that of the sample."""
    name = "".join(c if c.isalnum() or c in "-_." else "_" for c in readings.name).strip(".")
    return f"{name or 'completed'}.bsdf"
