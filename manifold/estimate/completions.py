"""The work behind `manifold complete`: readings in, a full BRDF out, with its diagnostics."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, field
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
from manifold.estimate.completion import Alternative, Completion
from manifold.estimate.expected import calibrate
from manifold.estimate.inputs import safe_name
from manifold.estimate.picture_colours import with_picture_colours
from manifold.estimate.suggestions import Suggested, directions_left, suggest
from manifold.formats.readings import Between, Readings, Viewing, gloss_fault
from manifold.formats.text import number
from manifold.library.store import Library
from manifold.metrics import EXPECTED_COLUMNS, Errors
from manifold.model import diagnostics
from manifold.model.output_file import COMPLETION_OPTIONS, OutputOptions, require_bsdf_output, write_checked
from manifold.names import counted
from manifold.progress import Stages
from manifold.records import Array
from manifold.results import Result, derived, entry

_PROFILE_INCIDENCES_DEG = (20.0, 40.0, 60.0)
_PROFILE_ELEVATIONS_DEG = np.arange(-80.0, 81.0, 5.0)


@dataclass(frozen=True, eq=False)
class Completed(Result):
    """A completed material, as written. A new field or property is shown everywhere if it has an entry.

    Attributes:
        picture: of its ball; None where none was asked for.
        completion: with errors at the readings that are those of the file.
        correction: of a second instrument's colours, learned from its readings; None where there was none to learn.
        plausibility: of the written file, read back.
        suggested: the next readings to take; None where none were asked for.
        diagnostics: what a user should know before trusting it, in sentences.
        seconds: in all, without reading.
    """

    path: Path = field(metadata=entry())
    picture: Path | None = field(metadata=entry())
    completion: Completion

    @property
    @derived()
    def sample(self) -> str:
        """Name of the sample."""
        return self.completion.readings.name

    @property
    @derived(columns={"instrument": ()})
    def instrument(self) -> str:
        """Name of the instrument."""
        return self.completion.readings.instrument

    @property
    @derived(
        row="readings", columns={"readings": ()},
        words=lambda result: f"{result.readings} of {result.sample}, {result.instrument}, "
        f"{result.completion.readings.bands}",
    )  # fmt: skip
    def readings(self) -> int:
        """Number of readings."""
        return len(self.completion.readings)

    correction: ColourCorrection | None = field(metadata=entry())
    expected: Errors[float] = field(
        metadata=entry(
            row="expected error", columns=EXPECTED_COLUMNS,
            words=lambda result: [
                words + result.beside(result.expected.ball) * (k == 0) for k, words in enumerate(result.expected.words)
            ],
        )
    )  # fmt: skip

    @property
    @derived(
        row="residual of readings", columns={"residual": ()},
        words=lambda result: f"{100 * result.residual:.1f} % in cube roots, "
        f"at most {100 * max(result.misfits.max(), result.residual):.1f} %",
    )  # fmt: skip
    def residual(self) -> float:
        """Residual of the readings in cube roots: root mean square, or that of gloss if it is larger."""
        return self.completion.residual_of_readings

    @property
    @derived()
    def misfits(self) -> Array:
        """Relative errors at the readings, see `Completion.misfits`, shape (P,)."""
        return self.completion.misfits

    @property
    @derived()
    def viewing(self) -> str:
        """Light and observer of the colours."""
        return str(self.completion.viewing)

    @property
    @derived()
    def lab(self) -> tuple[Array, Array] | None:
        """CIELAB of the readings and of the completion there, (P, 3) each; None without colours."""
        return self.completion.colours

    @property
    @derived(row="colours at the readings", words=lambda result: result.colours_in_words())
    def misfits_ciede2000(self) -> Array | None:
        """CIEDE2000 between every reading and the completion there, (P,); None without colours."""
        return self.completion.colour_misfits

    @property
    @derived()
    def repeatability(self) -> float:
        """Repeatability of the instrument, relative."""
        return self.completion.readings.repeatability

    @property
    @derived(row="between measurements", words=lambda result: result.between_in_words())
    def between_measurements(self) -> Between | None:
        """Difference between measurements of the sample; None where there is one."""
        return self.completion.readings.between

    @property
    @derived(
        row="gloss",
        words=lambda result: [
            f"{result.completion.gloss[angle]:.3g} at {angle:g} degrees, {units:g} given"
            for angle, units in result.completion.readings.gloss.items()
        ],
    )
    def gloss(self) -> dict[str, dict[str, float | None]]:
        """Gloss units by angle in degrees: read, and completed."""
        read = self.completion.readings.gloss
        return {
            f"{angle:g}": {"read": read.get(angle), "completed": units}
            for angle, units in self.completion.gloss.items()
        }

    @property
    @derived(
        row="combination of", words=lambda result: [f"{name} {weight:.2f}" for name, weight in result.made_of.items()]
    )  # fmt: skip
    def made_of(self) -> dict[str, float]:
        """Weights of materials, by name."""
        return dict(self.completion.made_of)

    @property
    @derived()
    def alternatives(self) -> tuple[Alternative, ...]:
        """Mixtures that explain the readings, most probable first."""
        return self.completion.alternatives

    @property
    @derived()
    def uncertainty(self) -> dict[str, Any]:
        """Relative standard deviation of f over hypotheses, in the plane of incidence, by direction."""
        return uncertainty(self.completion)

    plausibility: Plausibility = field(metadata=entry(row="albedo", words="at most {.max_albedo:.2f}"))
    suggested: Suggested | None

    @property
    @derived()
    def suggested_deg(self) -> Array | None:
        """Angles of the next readings to take, in degrees."""
        return None if self.suggested is None else self.suggested.angles_deg

    diagnostics: tuple[str, ...] = field(metadata=entry())
    seconds: float = field(metadata=entry())

    def colours_in_words(self) -> str:
        """Return the mean and largest difference of colours at the readings, with the angles of the largest."""
        off, readings = self.misfits_ciede2000, self.completion.readings
        assert off is not None
        most = int(off.argmax())
        wi, wo = (np.degrees(np.arccos(min(w[most, 2], 1.0))) for w in (readings.wi, readings.wo))
        return (
            f"mean CIEDE2000 ({self.viewing}) {off.mean():.2f}, largest {off[most]:.2f} (incidence {wi:.0f}, "
            f"outgoing {wo:.0f} degrees)" + self.beside(off[most])
        )

    def between_in_words(self) -> str:
        """Return the difference between measurements, and the number of readings that it is based on."""
        between = self.between_measurements
        assert between is not None
        return (
            f"{100 * between.deviation:.1f} % of a value, beyond what each repeats (Mandel-Paule, "
            f"{counted(between.pairs, 'shared reading')}); CIEDE2000 ({self.viewing}) {between.ciede2000:.2f}"
        )

    def beside(self, ciede2000: float) -> str:
        """Return a remark on an error that is smaller than the differences between measurements of the sample."""
        between = self.between_measurements
        return "" if between is None or ciede2000 > between.ciede2000 else " (less than measurements differ)"


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
    completion = Completion.of(atoms, readings)
    stages.begin("expected error")
    calibration = calibrate(atoms, completion.evidence, opened)
    suggested = suggest(atoms, count, completion, instrument) if count else None
    expected = calibration.expected(completion)
    stages.begin("writing")
    written = write_checked(
        output,
        completion.brdf,
        options,
        description=_describe(completion),
        remedy="make it physical, measure more directions near the highlight",
        expected_error=expected.cube_root,
        keeps_hue=True,  # readings determine colours well, and how much light there is in all directions badly
    )
    if picture is not None:
        stages.begin("rendering")
        draw_ball(output, picture)
    plausibility = written.plausibility
    if written.file is not None:
        completion = completion.as_written(MeasuredBRDF(written.file))
    notes = (
        *completion.notes,
        *calibration.notes(completion),
        *written.notes,
        *_of_unit(completion.readings, plausibility),
    )
    return Completed(
        output, picture, completion, correction, written.expected(expected), plausibility, suggested, notes,
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
    units_by_angle: dict[float, float] = {}
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
        if pair[0] in units_by_angle:
            raise UsageError(f"gloss at {pair[0]:g} degrees twice, expected once; give their mean")
        units_by_angle[pair[0]] = pair[1]
    return units_by_angle


def uncertainty(completion: Completion) -> dict[str, Any]:
    """Return the relative standard deviation of f over hypotheses, in the plane of incidence, by direction."""
    profiles: dict[str, list[float]] = {}
    for incidence in _PROFILE_INCIDENCES_DEG:
        wi = from_spherical(np.deg2rad(incidence), np.pi)
        wo = from_spherical(np.deg2rad(_PROFILE_ELEVATIONS_DEG), 0.0)
        profiles[f"{incidence:g}"] = completion.spread_at(np.broadcast_to(wi, wo.shape), wo).tolist()
    return {"theta_o_deg": _PROFILE_ELEVATIONS_DEG.tolist(), "by_incidence_deg": profiles}


def _describe(completion: Completion) -> str:
    readings = completion.readings
    gloss = " and its gloss" if readings.gloss else ""
    return (
        f"Completed from {len(readings)} readings ({readings.instrument}) of {readings.name}{gloss} "
        f"through {len(completion.atoms.names)} materials by manifold {__version__}"
    )


def file_name(readings: Readings) -> str:
    """Return the default name of a completed material's file: that of the sample."""
    return f"{safe_name(readings.name)}.bsdf"
