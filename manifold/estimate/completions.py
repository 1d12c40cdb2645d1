"""The work behind `manifold complete`: readings in, a full BRDF out, with its diagnostics."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from manifold import __version__
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import Plausibility
from manifold.colour.correction import ColourCorrection
from manifold.colour.difference import lab_under_d65
from manifold.directions import from_spherical
from manifold.errors import UsageError
from manifold.estimate import instruments
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.completion import Completion
from manifold.estimate.expected import calibrate
from manifold.estimate.inputs import safe_name
from manifold.estimate.picture_colours import with_picture_colours
from manifold.estimate.suggestions import Suggested, directions_left, suggest
from manifold.formats.readings import Readings, Viewing, gloss_fault
from manifold.formats.text import number
from manifold.library.store import Library
from manifold.metrics import Errors
from manifold.model import diagnostics
from manifold.model.output_file import COMPLETION_OPTIONS, OutputOptions, require_bsdf_output, write_checked
from manifold.names import counted
from manifold.progress import Stages
from manifold.records import Array, plain

_PROFILE_INCIDENCES_DEG = (20.0, 40.0, 60.0)
_PROFILE_ELEVATIONS_DEG = np.arange(-80.0, 81.0, 5.0)


@dataclass(frozen=True, eq=False)
class Completed:
    """A completed material, as written.

    Attributes:
        picture: of its ball; None where none was asked for.
        completion: with errors at the readings that are those of the file.
        correction: of a second instrument's colours, learned from its readings; None where there was none to learn.
        plausibility: of the written file, read back.
        suggested: the next readings to take; None where none were asked for.
        diagnostics: what a user should know before trusting it, in sentences.
        seconds: in all, without reading.
    """

    path: Path
    picture: Path | None
    completion: Completion
    correction: ColourCorrection | None
    expected: Errors[float]
    plausibility: Plausibility
    suggested: Suggested | None
    diagnostics: tuple[str, ...]
    seconds: float

    @property
    def residual(self) -> float:
        """Return the residual of the readings in cube roots: root mean square, or that of gloss if it is larger."""
        return self.completion.residual_of_readings

    @property
    def rows(self) -> dict[str, object]:
        """Return the rows of its table, by label: words, and lists of words."""
        found = self.completion
        rows: dict[str, object] = {
            "readings": f"{len(found.readings)} of {found.readings.name}, {found.readings.instrument}, "
            f"{found.readings.bands}",
            "expected error": [
                words + self._beside(self.expected.ball) * (not k)
                for k, words in enumerate(self.expected.words)
            ],
            "residual of readings": f"{100 * self.residual:.1f} % in cube roots, "
            f"at most {100 * max(found.misfits.max(), self.residual):.1f} %",
        }
        if (off := found.colour_misfits) is not None:
            most = int(off.argmax())
            wi, wo = (
                np.degrees(np.arccos(min(w[most, 2], 1.0))) for w in (found.readings.wi, found.readings.wo)
            )
            rows["colours at the readings"] = (
                f"off by CIEDE2000 ({found.viewing}) {off.mean():.2f} in the mean, at most {off[most]:.2f} "
                f"(at {wi:.0f} and {wo:.0f} degrees)" + self._beside(off[most])
            )
        if (between := found.readings.between) is not None:
            rows["between measurements"] = (
                f"{100 * between.deviation:.1f} % of a value, beyond what each repeats (Mandel-Paule, "
                f"{counted(between.pairs, 'shared reading')}); CIEDE2000 ({found.viewing}) {between.ciede2000:.2f}"
            )
        if found.readings.gloss:
            rows["gloss"] = [
                f"{found.gloss[a]:.3g} at {a:g} degrees, {u:g} given" for a, u in found.readings.gloss.items()
            ]
        rows["combination of"] = [f"{name} {weight:.2f}" for name, weight in found.made_of]
        rows["albedo"] = f"at most {self.plausibility.max_albedo:.2f}"
        return rows

    def _beside(self, ciede2000: float) -> str:
        """Return a remark on an error that is smaller than the differences between measurements of the sample."""
        between = self.completion.readings.between
        return "" if between is None or ciede2000 > between.ciede2000 else " (less than measurements differ)"

    def to_json(self) -> dict[str, Any]:
        """Return plain values."""
        made = self.completion
        known = {
            "path": self.path,
            "picture": self.picture,
            "sample": made.readings.name,
            "instrument": made.readings.instrument,
            "readings": len(made.readings),
            "misfits": made.misfits,
            "viewing": str(made.viewing),
            "lab": made.colours,
            "misfits_ciede2000": made.colour_misfits,
            "repeatability": made.readings.repeatability,
            "between_measurements": made.readings.between,
            "residual": self.residual,
            "gloss": {
                f"{angle:g}": {"read": made.readings.gloss.get(angle), "completed": units}
                for angle, units in made.gloss.items()
            },
            "made_of": dict(made.made_of),
            "alternatives": made.alternatives,
            "expected": self.expected,
            "uncertainty": uncertainty(made),
            "correction": self.correction,
            "plausibility": self.plausibility,
            "suggested_deg": self.suggested and self.suggested.angles_deg,
            "diagnostics": self.diagnostics,
            "seconds": self.seconds,
        }
        return plain(known)


def complete(
    library: Path,
    readings: Readings | Path,
    output: Path,
    *,
    sample: str | None = None,
    correction: ColourCorrection | None = None,
    picture: Path | None = None,
    count: int = 0,
    instrument: str | None = None,
    options: OutputOptions = COMPLETION_OPTIONS,
) -> Completed:
    """Complete readings of one sample through the materials of a library, and write the BRDF as an RGL file.

    Args:
        library: of measured materials.
        readings: of the sample, or their file; where a spectrum is missing, the colour of its picture is taken.
        output: the file to write; its name becomes the material's.
        sample: which of a file with several.
        correction: what `instruments.read` learned, to be reported.
        picture: of the ball, to render.
        count: how many further readings to suggest.
        instrument: whose directions to suggest.
        options: of the file.

    Raises:
        BandMismatchError: bands of readings and library do not go together.
        UsageError: the output does not end in `.bsdf`, nothing was read, or there is no such instrument.
    """
    start = time.perf_counter()
    if isinstance(readings, Path):
        readings, correction = instruments.read([readings], sample)
    readings = with_picture_colours(readings)
    if count:
        directions_left(count, readings, instrument)
    require_bsdf_output(output)
    shares = {"reading materials": 4, "completing": 1, "expected error": 1, "writing": 1, "rendering": 2}
    stages = Stages(shares)
    opened = Library(library)
    stages.begin("reading materials")
    atoms = atoms_of(opened)
    stages.begin("completing")
    made = Completion.of(atoms, readings)
    stages.begin("expected error")
    calibration = calibrate(atoms, made.readings, opened)
    suggested = suggest(atoms, count, made, instrument) if count else None
    expected = calibration.expected(made)
    stages.begin("writing")
    written = write_checked(
        output,
        made.brdf,
        options,
        description=_describe(made),
        remedy="make it physical, measure more directions near the highlight",
        expected_error=expected.cube_root,
        keeps_hue=True,  # readings determine colours well, and how much light there is in all directions badly
    )
    if picture is not None:
        stages.begin("rendering")
        draw_ball(output, picture)
    plausibility = written.plausibility
    if written.file is not None:
        made = made.as_written(MeasuredBRDF(written.file))
    if written.change is not None:
        expected = expected.beside(written.change)
    notes = (
        *made.notes,
        *calibration.notes(made),
        *diagnostics.of_prediction(False, plausibility),
        *_of_unit(made.readings, plausibility),
        *written.projection,
    )
    return Completed(
        output, picture, made, correction, expected, plausibility, suggested, notes,
        time.perf_counter() - start,
    )  # fmt: skip


def _of_unit(readings: Readings, plausibility: Plausibility) -> tuple[str, ...]:
    """Return a note if readings without a unit make a material that reflects more light than it receives."""
    if readings.assumed_unit != "brdf" or plausibility.max_albedo <= diagnostics.MOST_ALBEDO:
        return ()
    return (
        "the values have no unit and were taken as BRDF in 1/sr: with this albedo they may be reflectance factors "
        "(--unit factor); the expected error does not include that",
    )


def draw_ball(file: Path, picture: Path) -> None:
    """Render the ball of a file into a picture."""
    from manifold.render import ball, images
    from manifold.render.render import RenderSettings

    images.write_image(picture, ball.read_material(file).render(RenderSettings()))


_kept: dict[tuple[Path, str], LibraryAtoms] = {}  # of the library that was used last, for the next sample


def atoms_of(library: Library) -> LibraryAtoms:
    """Return the atoms of a library, cached for the next sample."""
    key = library.path, library.content_hash
    if key not in _kept:
        _kept.clear()
        _kept[key] = LibraryAtoms.of_library(library)
    return _kept[key]


def parse_lab(text: str, viewing: Viewing) -> Array:
    """Return the CIELAB colour (3,) under D65 and the 2 degree observer of `L,a,b` under a light, to an observer."""
    values = [number(part) for part in text.split(",")]
    if len(values) != 3 or None in values:
        raise UsageError(f"colour '{text}', expected L,a,b such as 50,20,10, with L from 0 to 100")
    return colour_under_d65(np.array(values, dtype=np.float64), viewing)


def colour_under_d65(lab: Array, viewing: Viewing) -> Array:
    """Return `difference.lab_under_d65` of a colour (3,) whose lightness is checked."""
    if not 0.0 <= lab[0] <= 100.0:
        raise UsageError(
            f"colour '{','.join(f'{v:g}' for v in lab)}', expected L,a,b such as 50,20,10, with L from 0 to 100"
        )
    return lab_under_d65(lab, viewing)


def parse_gloss(texts: Iterable[str]) -> dict[float, float]:
    """Parse texts such as `60=12.5` into gloss units by angle in degrees."""
    found: dict[float, float] = {}
    for text in texts:
        angle, is_pair, units = text.partition("=")
        try:
            pair = float(angle), float(units)
        except ValueError:
            pair = np.nan, np.nan
        if not is_pair or not np.isfinite(pair).all():
            raise UsageError(f"gloss '{text}', expected an angle and gloss units, such as 60=12.5")
        if (fault := gloss_fault(*pair)) is not None:
            raise UsageError(fault)
        if pair[0] in found:
            raise UsageError(f"gloss at {pair[0]:g} degrees twice, expected once; give their mean")
        found[pair[0]] = pair[1]
    return found


def uncertainty(made: Completion) -> dict[str, Any]:
    """Return the relative standard deviation of f over hypotheses, in the plane of incidence, by direction."""
    profiles: dict[str, list[float]] = {}
    for incidence in _PROFILE_INCIDENCES_DEG:
        wi = from_spherical(np.deg2rad(incidence), np.pi)
        wo = from_spherical(np.deg2rad(_PROFILE_ELEVATIONS_DEG), 0.0)
        profiles[f"{incidence:g}"] = made.spread_at(np.broadcast_to(wi, wo.shape), wo).tolist()
    return {"theta_o_deg": _PROFILE_ELEVATIONS_DEG.tolist(), "by_incidence_deg": profiles}


def _describe(made: Completion) -> str:
    gloss = " and its gloss" if made.readings.gloss else ""
    return (
        f"Completed from {len(made.readings)} readings ({made.readings.instrument}) of {made.readings.name}{gloss} "
        f"through {len(made.atoms.names)} materials by manifold {__version__}"
    )


def file_name(readings: Readings) -> str:
    """Return the default name of a completed material's file: that of the sample."""
    return f"{safe_name(readings.name)}.bsdf"
