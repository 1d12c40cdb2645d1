"""Implements `manifold complete` and `manifold photograph`, from the observations to the written file."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import Enum, auto
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from manifold import __version__
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import Plausibility
from manifold.colour.correction import ColourCorrection
from manifold.colour.difference import is_beyond_reflectances, lab_under_d65
from manifold.colour.picture_files import notes_together
from manifold.core.directions import from_spherical
from manifold.core.errors import UsageError
from manifold.core.judged_lights import BALL
from manifold.core.metrics import EXPECTED_COLUMNS, Errors
from manifold.core.names import counted, percent
from manifold.core.progress import Stages
from manifold.core.records import Array
from manifold.core.results import Result, derived, entry
from manifold.core.threads import one_blas_thread
from manifold.estimate import instruments
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.channels import Channels
from manifold.estimate.completion import Alternative, Completion
from manifold.estimate.expected import Calibration, calibrate, unreliable
from manifold.estimate.inputs import safe_name
from manifold.estimate.lamp_plan import LampPlan, plan_lamps
from manifold.estimate.left_out_readings import LeftOutReadings, left_out_readings
from manifold.estimate.picture_colours import with_picture_colours
from manifold.estimate.sightings import PhotoRequest, SeenBall, have_own_exposures, see
from manifold.estimate.solving import CONTRADICTION, Seen
from manifold.estimate.suggestions import Suggested, directions_left, suggest
from manifold.formats.readings import (
    NO_GLOSS,
    Assumption,
    Between,
    GlossUnits,
    Readings,
    Viewing,
    assumptions_first,
    gloss_fault,
)
from manifold.formats.text import number
from manifold.library.store import Library
from manifold.model import diagnostics
from manifold.model.output_file import COMPLETION_OPTIONS, OutputOptions, require_bsdf_output, write_checked
from manifold.model.prediction import ClippedBRDF

if TYPE_CHECKING:
    from manifold.model.location import Located

_ODD = 2.0  # least ratio of the error of a picture that contradicts the others to the median one
_PROFILE_INCIDENCES_DEG = (20.0, 40.0, 60.0)
_PROFILE_ELEVATIONS_DEG = np.arange(-80.0, 81.0, 5.0)


class NextStep(Enum):
    """The next step for a completed material: export it, read more, or check observations that are in doubt."""

    EXPORT = auto()
    READ_MORE = auto()
    CHECK_OBSERVATIONS = auto()


class Advice(NamedTuple):
    """Advice on a completed material: the next step, and a sentence; the sentence is None if its errors are unknown."""

    step: NextStep
    words: str | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Completed(Result):
    """A completed material that was written to a file.

    Attributes:
        path: path of the file; None if only a point on a map was requested.
        picture: picture of its ball, or of photographs beside predictions; None if none was requested.
        completion: the completion, with errors that refer to the written file.
        correction: colour correction of a second instrument, learned from its readings; None if there was none to
            learn.
        plausibility: physical plausibility of the written file; None without a file.
        left_out_readings: errors of predicting each reading from the others; None without readings, or for many.
        next_readings: readings to take next; None if none were requested and the expected errors are small.
        count: number of suggestions that were requested.
        diagnostics: sentences to read before using the file.
        seconds: total time, without reading files.
    """

    path: Path | None = field(metadata=entry())
    picture: Path | None = field(
        default=None, metadata=entry(row="picture")
    )  # fmt: skip
    completion: Completion

    @property
    @derived()
    def sample(self) -> str | None:
        """Name of the specimen; None without readings."""
        return None if self._readings is None else self._readings.name

    @property
    @derived(columns={"instrument": ()})
    def instrument(self) -> str | None:
        """Name of the instrument; None without readings."""
        return None if self._readings is None else self._readings.instrument

    @property
    @derived(
        row="readings", columns={"readings": ()},
        words=lambda result: result.readings
        and f"{result.sample}: {counted(result.readings, 'reading')}, {result.instrument}, "
        f"{result.completion.readings.bands_in_words}",
    )  # fmt: skip
    def readings(self) -> int | None:
        """Number of readings; None without."""
        return None if self._readings is None else len(self._readings)

    correction: ColourCorrection | None = field(default=None, metadata=entry())

    @property
    @derived(row="advice")
    def advice(self) -> str | None:
        """Advice whether to use the file, and what to measure first otherwise; None without expected errors."""
        return self._advised.words

    @property
    def next_step(self) -> NextStep:
        """What `advice` says to do next."""
        return self._advised.step

    @property
    def _advised(self) -> Advice:
        return advise(self.expected, self.next_readings, fault=self.fault, unit=_unit(self._readings))

    @property
    def fault(self) -> str | None:
        """Reason to doubt the values: contradicting observations, or a material that is too bright or too dark."""
        if self.completion.solution.contradiction > CONTRADICTION:
            return "readings and photographs contradict each other; check that both show the same material"
        what = "readings" if _unit(self._readings) is None else "unit of the readings (--unit)"
        if self.completion.is_too_dark:
            return f"darker than all materials of the library; check the {what}"
        if self.plausibility is None or self.plausibility.max_albedo <= diagnostics.MOST_ALBEDO:
            return None
        what = "exposure" if self._readings is None else what
        return f"albedo {self.plausibility.max_albedo:.2f}; check the {what}, or write it with --physical"

    expected: Errors[float] = field(
        metadata=entry(
            row="expected error", columns=EXPECTED_COLUMNS,
            words=lambda result: tuple(
                words + result.beside(result.expected.ball) * (k == 0) for k, words in enumerate(result.expected.words)
            ),
        )
    )  # fmt: skip

    @property
    @derived(row="residual", columns={"residual": ()}, words=lambda result: result.residuals_in_words())
    def residual(self) -> float:
        """Relative cube-root residual of the readings, or of the gloss if that is larger."""
        return self.completion.residual_of_readings

    @property
    @derived()
    def misfits(self) -> Array | None:
        """Relative errors at the readings, see `Completion.misfits`, shape (P,); None without readings."""
        return None if self._readings is None else self.completion.misfits

    @property
    @derived()
    def viewing(self) -> str | None:
        """Light and observer of the colours; None without readings."""
        return None if self._readings is None else str(self.completion.viewing)

    @property
    @derived()
    def lab(self) -> tuple[Array, Array] | None:
        """CIELAB colours of the readings, and of the completion at the same directions, each (P, 3), or None."""
        return None if self._readings is None else self.completion.colours

    @property
    @derived(row="colours at the readings", words=lambda result: result.colours_in_words())
    def misfits_ciede2000(self) -> Array | None:
        """CIEDE2000 between each reading and the completion at its directions, (P,); None without colours."""
        return None if self._readings is None else self.completion.colour_misfits

    left_out_readings: LeftOutReadings | None = field(
        default=None,
        metadata=entry(
            row="readings left out", words=lambda result: result.left_out_in_words(), is_detail=True
        ),
    )

    def left_out_in_words(self) -> str | None:
        """Return a text with the median and largest error of readings predicted from the others; None without any."""
        if (found := self.left_out_readings) is None:
            return None
        if found.ciede2000 is None:
            return (
                f"{percent(np.median(found.relative))} of cube roots (median, each reading predicted from the others), "
                f"largest {percent(found.relative.max())}"
            )
        return (
            f"CIEDE2000 ({self.viewing}) {np.median(found.ciede2000):.2f} (median, each reading predicted from "
            f"the others), largest {found.ciede2000.max():.2f}"
        )

    @property
    @derived()
    def repeatability(self) -> float | None:
        """Repeatability of the instrument, relative; None without readings."""
        return None if self._readings is None else self._readings.repeatability

    @property
    @derived(row="between measurements", words=lambda result: result.between_in_words())
    def between_measurements(self) -> Between | None:
        """Difference between measurements of the specimen; None if it was measured once."""
        return None if self._readings is None else self._readings.between

    @property
    @derived(
        row="gloss",
        words=lambda result: [
            f"{result.completion.gloss[angle]:.3g} at {angle:g} degrees, {units:g} given"
            for angle, units in result.completion.evidence.gloss.items()
        ],
    )
    def gloss(self) -> dict[str, dict[str, float | None]]:
        """Gloss units by angle in degrees, measured and completed."""
        read = self.completion.evidence.gloss
        return {
            f"{angle:g}": {"read": read.get(angle), "completed": units}
            for angle, units in self.completion.gloss.items()
        }

    @property
    @derived(
        row="combination of", words=lambda result: [f"{name} {weight:.2f}" for name, weight in result.made_of.items()],
        is_detail=True,
    )  # fmt: skip
    def made_of(self) -> dict[str, float]:
        """Weights of the materials by name or, from photographs, their shares of the ball's light."""
        return dict(self.completion.made_of)

    @property
    @derived()
    def alternatives(self) -> tuple[Alternative, ...]:
        """Mixtures that explain the observations, most probable first."""
        return self.completion.alternatives

    @property
    @derived()
    def uncertainty(self) -> dict[str, Any]:
        """Factors within which f is right with a probability of 0.9, in the plane of incidence, by direction."""
        return uncertainty(self.completion)

    @property
    @derived(row="change of the ball", words=lambda result: result.contributions_in_words(), is_detail=True)
    def contributions(self) -> dict[str, float]:
        """CIEDE2000 by which the ball changes without an observation, by name, see `Completion.contributions`."""
        return self.completion.contributions

    def contributions_in_words(self) -> str | None:
        """Return a text with the contributions; None without any."""
        parts = [f"without {name} {off:.1f}" for name, off in self.contributions.items()]
        return f"{', '.join(parts)} {BALL}" if parts else None

    plausibility: Plausibility | None = field(
        default=None, metadata=entry(row="albedo", words="at most {.max_albedo:.2f}", is_detail=True)
    )
    next_readings: Suggested | None = None
    count: int = 0

    @property
    def suggested(self) -> Suggested | None:
        """The next readings to take, in the requested number; None if none were requested."""
        return self.next_readings if self.count else None

    @property
    @derived()
    def suggested_deg(self) -> Array | None:
        """Angles of the next readings to take, in degrees."""
        return None if self.suggested is None else self.suggested.angles_deg

    diagnostics: tuple[str, ...] = field(default=(), metadata=entry())
    seconds: float = field(default=0.0, metadata=entry())

    @property
    def _readings(self) -> Readings | None:
        return self.completion.evidence.readings

    def residuals_in_words(self) -> list[str]:
        """Return texts with the residual of all readings, and the largest residual of one."""
        if self._readings is None:
            return []
        residual = self.completion.residual_of_readings
        most = max(float(self.completion.misfits.max()), residual)
        which = "readings and gloss" if self.completion.evidence.gloss else "readings"
        return [f"{100 * residual:.1f} % of the {which}, in cube roots, at most {100 * most:.1f} %"]

    def colours_in_words(self) -> str:
        """Return a text with the mean and largest colour difference at the readings, and the angles of the largest."""
        off, readings = self.misfits_ciede2000, self.completion.readings
        assert off is not None
        most = int(off.argmax())
        wi, wo = (np.degrees(np.arccos(min(w[most, 2], 1.0))) for w in (readings.wi, readings.wo))
        return (
            f"mean CIEDE2000 ({self.viewing}) {off.mean():.2f}, largest {off[most]:.2f} (incidence {wi:.0f}, "
            f"outgoing {wo:.0f} degrees)" + self.beside(off[most])
        )

    def between_in_words(self) -> str:
        """Return a text with the difference between measurements, and the number of readings on which it is based."""
        between = self.between_measurements
        assert between is not None
        return (
            f"{100 * between.deviation:.1f} % of a value, beyond what each repeats (Mandel-Paule, "
            f"{counted(between.pairs, 'shared reading')}); CIEDE2000 ({self.viewing}) {between.ciede2000:.2f}"
        )

    def beside(self, ciede2000: float) -> str:
        """Return a remark if an error is smaller than the differences between measurements of the specimen."""
        between = self.between_measurements
        return "" if between is None or ciede2000 > between.ciede2000 else " (less than measurements differ)"


@dataclass(frozen=True, kw_only=True, eq=False)
class Photographed(Completed):
    """A material completed from photographs, and perhaps readings.

    Attributes:
        balls: the balls that the photographs show.
        located: its point on a map; None if none was requested.
        plan: lamp positions for further photographs; None if no suggestion was requested.
    """

    balls: tuple[SeenBall, ...]

    @property
    @derived(
        row="photographs",
        is_detail=True,
        words=lambda result: [
            f"{ball.photograph.path.name}, ball at {ball.circle}"
            + "".join(f", lamp {lamp}" for lamp in ball.lamps)
            + f", residual {100 * residual:.1f} %"
            + ("" if predicted is None else f", {100 * predicted:.1f} % predicted from the others")
            for ball, residual, predicted in result.balls_with_residuals
        ],
    )
    def photographs(self) -> list[dict[str, Any]]:
        """Files of the photographs, with the balls, lamps and residuals."""
        return [
            {
                "path": ball.photograph.path,
                "circle": list(vars(ball.circle).values()),
                "lamps": [lamp.direction for lamp in ball.lamps],
                "residual": residual,
                "predicted": predicted,
            }
            for ball, residual, predicted in self.balls_with_residuals
        ]

    @property
    @derived(
        row="latent", words=lambda result: result.located and ",".join(result.located.coordinates), json=False
    )
    def latent(self) -> Array | None:
        """Its latent on a map; None if no point was requested."""
        return None if self.located is None else self.located.latent

    @property
    @derived(
        row="nearest", words=lambda result: [f"{name} ({apart:.2f})" for name, apart in result.nearest], json=False
    )  # fmt: skip
    def nearest(self) -> list[tuple[str, float]]:
        """The nearest materials on the map, with their distances."""
        return [] if self.located is None else self.located.nearest

    located: Located | None = field(
        default=None, metadata=entry(row="reconstruction error", words=lambda result: result.located.errors.words)
    )  # fmt: skip

    @property
    @derived(
        row="exposure", words=lambda result: list(dict.fromkeys(f"{each:.3g}" for each in result.exposures)),
        is_detail=True,
    )  # fmt: skip
    def exposures(self) -> Array:
        """Exposures of the pictures."""
        return self.completion.exposures

    plan: LampPlan | None = field(default=None, metadata=entry())

    @property
    @derived(row="residual", columns={"residual": ()}, words=lambda result: result.residuals_in_words())
    def residual(self) -> float:
        """Relative cube-root error of the pixels, as the root mean square over pictures."""
        return self.completion.solution.residual_of_pixels

    @property
    def balls_with_residuals(self) -> list[tuple[SeenBall, float, float | None]]:
        """The balls with the residual of their pixels, and with the error when the other pictures predict them."""
        residuals = self.completion.solution.residuals.tolist()
        errors = self.completion.picture_errors or [None] * len(residuals)
        return list(zip(self.balls, residuals, errors, strict=True))

    def residuals_in_words(self) -> list[str]:
        """Return texts with the residuals of pixels, of readings, and of readings that the pictures alone predict."""
        words = [f"{100 * self.residual:.1f} % of the pixels, in cube roots"]
        predicted = (
            f"; {100 * self.completion.solution.contradiction:.1f} % predicted from only the photographs"
        )
        return words + [of_readings + predicted for of_readings in super().residuals_in_words()]

    @property
    @derived(row="change of the ball", words=lambda result: result.contributions_in_words(), is_detail=True)
    def contributions(self) -> dict[str, float]:
        """CIEDE2000 by which the ball changes without an observation, by the name of the observation or picture."""
        names = {f"picture {k}": ball.photograph.path.name for k, ball in enumerate(self.balls, start=1)}
        return {names.get(name, name): off for name, off in self.completion.contributions.items()}


@one_blas_thread
def observe(
    library: Library,
    stages: Stages,
    readings: Readings | None = None,
    gloss: GlossUnits = NO_GLOSS,
    pictures: PhotoRequest | None = None,
) -> tuple[Completion, Calibration, tuple[SeenBall, ...]]:
    """Complete the readings, gloss and pictures of a material with a library as prior.

    Returns the completion, the calibration of its expected errors, and the balls in the pictures.
    """
    balls: tuple[SeenBall, ...] = ()
    if pictures is not None:
        stages.begin("reading pictures")
        balls = see(pictures)
    stages.begin("reading materials")
    atoms = atoms_of(library)
    seen: list[Seen] = [*(ball.sighting for ball in balls), *([] if readings is None else [readings]), gloss]
    stages.begin("completing")
    if pictures is None:
        completion = Completion.of(atoms, seen)
    else:
        channels = Channels.of_library(library, atoms.names, pictures.responses)
        completion = Completion.of(
            atoms.in_values, seen, exposure=pictures.exposure, each=have_own_exposures(pictures, balls),
            channels=channels,
        )  # fmt: skip
    stages.begin("expected error")
    return completion, calibrate(completion.atoms, completion.exposed, library), balls


def notes_of(completion: Completion, calibration: Calibration, balls: Sequence[SeenBall]) -> tuple[str, ...]:
    """Return sentences about contradictions, about undetermined properties, and about assumptions on pictures."""
    of_some, of_all = _of_balls(balls)
    notes = (
        *(warning for ball in balls for warning in ball.warnings),
        *odd_pictures([ball.photograph.path.name for ball in balls], completion.picture_errors),
        *calibration.notes(completion),
        *of_some,
        *completion.notes,
        *of_all,
    )
    return tuple(dict.fromkeys(notes))


def _of_balls(balls: Sequence[SeenBall]) -> tuple[list[str], list[str]]:
    """Return the notes on some of the pictures, and the notes on all; notes that named one picture name all theirs."""
    together = notes_together((ball.photograph.path.name, ball.notes) for ball in balls)
    of_some, of_all = list[str](), list[str]()
    for note, count in together.items():
        (of_all if count == len(balls) else of_some).append(note)
    return of_some, of_all


def complete(
    library: Path,
    readings: Readings | Path | None,
    output: Path,
    *,
    pictures: PhotoRequest | None = None,
    gloss: GlossUnits = NO_GLOSS,
    sample: str | None = None,
    correction: ColourCorrection | None = None,
    picture: Path | None = None,
    count: int = 0,
    instrument: str | None = None,
    options: OutputOptions = COMPLETION_OPTIONS,
) -> Completed:
    """Estimate a BRDF from observations of one material, with a library as prior, and write it as an RGL file.

    Args:
        library: path of the library of measured materials.
        readings: readings of the specimen, or the path of their file; the colour of the instrument's own picture
            replaces a missing spectrum. None if there are only photographs.
        output: the file to write; the material is named after it.
        pictures: photographs of balls of the material, and how they were taken.
        gloss: gloss units by angle in degrees, in addition to those of the readings.
        sample: name of the specimen, if the file has several.
        correction: colour correction from `instruments.read`, for the report.
        picture: file for a picture of the ball, or of the photographs beside their predictions; None draws none.
        count: number of further readings, or of photographs if there are any, to suggest.
        instrument: name of the instrument whose directions are suggested; None allows any.
        options: options of the output file.

    Raises:
        BandMismatchError: the bands of the readings and the library cannot be combined.
        UsageError: the output does not end in `.bsdf`, there are no observations, or there is no such instrument.
    """
    start = time.perf_counter()
    if isinstance(readings, Path):
        readings, correction = instruments.read([readings], sample)
    if readings is not None:
        readings = with_picture_colours(readings)
    if count and pictures is None:
        directions_left(count, readings, instrument)
    require_bsdf_output(output)
    if pictures is not None and picture is not None:
        from manifold.estimate import photographs

        photographs.require_drawable(picture, pictures)
    shares = {"reading materials": 4, "completing": 1, "expected error": 1, "writing": 1, "rendering": 2}
    if pictures is not None:
        shares |= {"reading pictures": 1, "completing": 3, "expected error": 5, "suggesting": 3}
    stages, opened = Stages(shares), Library(library)
    completion, calibration, balls = observe(opened, stages, readings, gloss, pictures)
    left_out = None if readings is None else left_out_readings(completion)
    expected = calibration.expected(completion, left_out)
    next_readings = None
    if not balls and (count or unreliable(expected)):
        next_readings = suggest(completion.atoms, max(count, 1), completion, instrument)
    stages.begin("writing")
    written = write_checked(
        output,
        ClippedBRDF(completion.brdf) if balls else completion.brdf,
        options,
        description=_describe(completion),
        remedy="make it physical, "
        + ("check the exposure" if balls else "measure more directions near the highlight"),
        expected_error=expected.cube_root,
        keeps_hue=True,  # observations determine colours well, and how much light there is in all directions badly
    )
    if picture is not None:
        stages.begin("rendering")
        if pictures is None:
            draw_ball(output, picture)
        else:
            photographs.draw_residuals(balls, output, completion, pictures.exposure, picture)
    plan = None
    if count and balls:
        stages.begin("suggesting")
        plan = plan_lamps(completion.atoms, count, [rows.pixels for rows in completion.solution.channels])
    if written.file is not None:
        completion = completion.as_written(MeasuredBRDF(written.file))
    notes = (
        _of_unit(readings, written.plausibility)
        + written.notes
        + notes_of(completion, calibration, balls)
        + _of_left_out(expected, left_out)
        + ("the residual of the pixels refers to the material before it was made physical",)
        * bool(balls and written.projection)
    )
    made: dict[str, Any] = {
        "path": output, "picture": picture, "completion": completion, "correction": correction,
        "expected": written.expected(expected), "plausibility": written.plausibility, "next_readings": next_readings,
        "count": count, "left_out_readings": left_out, "diagnostics": assumptions_first(notes),
        "seconds": time.perf_counter() - start,
    }  # fmt: skip
    return Photographed(**made, balls=balls, plan=plan) if balls else Completed(**made)


def advise(
    expected: Errors[float],
    next_readings: Suggested | None,
    *,
    fault: str | None = None,
    unit: str | None = None,
) -> Advice:
    """Return advice whether to use a completion with these expected errors, and which reading to take next.

    The advice is against using it if there is a `fault`, and names the `unit` if one was assumed.
    """
    if "scaled_ball" in expected.known:
        return Advice(
            NextStep.READ_MORE,
            "do not use its brightness, which is a guess: photograph a white or grey card (--grey), or read the "
            "material once (--lab, or --readings at 45/0)",
        )
    if fault is not None:
        return Advice(NextStep.CHECK_OBSERVATIONS, f"do not use it: {fault}")
    where = unreliable(expected)
    if where is None:
        use = (
            "use it"
            if unit is None
            else f"use it if the values are {unit}, which the file does not say (--unit)"
        )
        return Advice(NextStep.EXPORT, use if "elsewhere" in expected.known else None)
    if where == "highlights":
        advice = (
            f"do not use it for highlights: {percent(expected.near_mirror)} expected cube-root error there"
        )
    else:
        advice = f"do not use it: {percent(expected.elsewhere)} expected cube-root error beside highlights"
    if next_readings is None:
        return Advice(NextStep.READ_MORE, advice)
    theta_i, theta_o, phi = next_readings.angles_deg[0]
    first = f"read first: incidence {theta_i:.0f}, outgoing {theta_o:.0f}, azimuth {phi:.0f} degrees"
    return Advice(NextStep.READ_MORE, f"{advice}; {first}")


def odd_pictures(names: Sequence[str], predicted: Sequence[float]) -> list[str]:
    """Return a sentence about each photograph that contradicts the others, from its error when these predict it.

    Two photographs are not compared: for sparkling materials, one predicts the other too poorly.
    """
    if len(predicted) <= 2:
        return []
    usual = float(np.median(predicted))
    return [
        f"{name}: cube roots differ by {percent(error)} if the other pictures predict them, which contradict it: check "
        "that it shows the same material, its lamp and its outline"
        for name, error in zip(names, predicted, strict=False)
        if error > max(CONTRADICTION, _ODD * usual)
    ]


def _unit(readings: Readings | None) -> str | None:
    """Return the unit that was assumed, in words; None where the file states it or its format defines it."""
    words = {"brdf": "a BRDF in 1/sr", "factor": "reflectance factors", "percent": "per cent"}
    if readings is None or readings.unit_note is None:
        return None
    return words.get(readings.assumed_unit or "")


def _of_left_out(expected: Errors[float], left_out: LeftOutReadings | None) -> tuple[str, ...]:
    """Return a note if readings that the others predict raised the expected error of the ball."""
    if left_out is None or left_out.typical.ball != expected.ball:
        return ()
    return (
        f"readings that the others predict are off by CIEDE2000 {expected.ball:.2g} in the median (under the light of "
        "the readings' colours), more than the ball of a similar library material: this is its expected error",
    )


def _of_unit(readings: Readings | None, plausibility: Plausibility) -> tuple[str, ...]:
    """Return a note if readings without a unit make a material that reflects more light than it receives."""
    if (
        readings is None
        or readings.assumed_unit != "brdf"
        or plausibility.max_albedo <= diagnostics.MOST_ALBEDO
    ):
        return ()
    return (
        Assumption(
            "the values have no unit and were taken as BRDF in 1/sr: with this albedo they may be reflectance factors "
            "(--unit factor); the expected error does not include that"
        ),
    )


def draw_ball(file: Path, picture: Path) -> None:
    """Render a ball with the BRDF of a file, and write the picture."""
    from manifold.render import ball, images
    from manifold.render.render import RenderSettings

    images.write_image(picture, ball.read_material(file).render(RenderSettings()))


_kept: dict[tuple[Path, str], LibraryAtoms] = {}  # of the library that was used last, for the next sample


def atoms_of(library: Library) -> LibraryAtoms:
    """Return the atoms of a library; they are cached for the next specimen."""
    key = library.path, library.content_hash
    if key not in _kept:
        _kept.clear()
        _kept[key] = LibraryAtoms.of_library(library)
    return _kept[key]


def parse_lab(text: str, viewing: Viewing) -> Array:
    """Parse `L,a,b` for a light and observer, and convert it to CIELAB (3,) under D65 and the 2 degree observer."""
    values = [number(part) for part in text.split(",")]
    if len(values) != 3 or None in values:
        raise UsageError(f"colour '{text}', expected L,a,b such as 50,20,10, with L from 0 to 100")
    return colour_under_d65(np.array(values, dtype=np.float64), viewing)


def colour_under_d65(lab: Array, viewing: Viewing) -> Array:
    """Convert CIELAB (3,) from a light and observer to D65 and the 2 degree observer, after checking the colour."""
    colour = f"colour '{','.join(f'{v:g}' for v in lab)}'"
    if not 0.0 <= lab[0] <= 100.0:
        raise UsageError(f"{colour}, expected L,a,b such as 50,20,10, with L from 0 to 100")
    converted = lab_under_d65(lab, viewing)
    if is_beyond_reflectances(converted):
        raise UsageError(f"{colour}: no reflectance has it; expected L,a,b of a surface, with less chroma")
    return converted


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
    """Return `Completion.factors_at` in the plane of incidence, as plain values by direction."""
    profiles: dict[str, list[float]] = {}
    for incidence in _PROFILE_INCIDENCES_DEG:
        wi = from_spherical(np.deg2rad(incidence), np.pi)
        wo = from_spherical(np.deg2rad(_PROFILE_ELEVATIONS_DEG), 0.0)
        profiles[f"{incidence:g}"] = completion.factors_at(np.broadcast_to(wi, wo.shape), wo).tolist()
    return {"theta_o_deg": _PROFILE_ELEVATIONS_DEG.tolist(), "by_incidence_deg": profiles}


def _describe(completion: Completion) -> str:
    readings, pictures = completion.evidence.readings, len(completion.evidence.pictures)
    parts = [f"{counted(pictures, 'photograph')} of a ball"] if pictures else []
    if readings is not None:
        parts.append(f"{len(readings)} readings ({readings.instrument}) of {readings.name}")
    gloss = " and its gloss" if completion.evidence.gloss else ""
    return (
        f"Completed from {', '.join(parts)}{gloss} "
        f"through {len(completion.atoms.names)} materials by manifold {__version__}"
    )


def file_name(readings: Readings) -> str:
    """Return the default file name of a completed material, derived from the specimen's name."""
    return f"{safe_name(readings.name)}.bsdf"
