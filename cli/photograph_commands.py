"""The command photograph, and the options that say how pictures of a ball were taken."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from manifold.core import progress
from manifold.core.errors import UsageError

from . import options, terminal
from .application import TAKEN, app
from .outputs import checked, or_default

if TYPE_CHECKING:
    from collections.abc import Sequence

    from manifold.estimate.coat import Coated
    from manifold.estimate.completions import Completed, Photographed
    from manifold.estimate.lamp_plan import Determined, LampPlan
    from manifold.estimate.sightings import PhotoRequest
    from manifold.model.output_file import OutputOptions


_AS_THE_LIGHT = "1"  # exposure of pictures as bright as light times material


@dataclass(frozen=True)
class PhotoOptions:
    """Options of the light and camera of pictures of a ball."""

    lamp: Annotated[
        list[str] | None,
        typer.Option(
            "--lamp",
            help="The direction of the one lamp: right, up, towards the camera, and its distance in radii of the ball "
            "if it is near; flash, at the camera; a file with one line per picture, X Y Z and the intensity in one or "
            "three channels if known; or found, estimated from the pictures, with its distance if it is near. Once, or "
            "once per picture.",
            metavar="X,Y,Z[,D]|flash|FILE|found[,D]",
        ),
    ] = None
    light: Annotated[
        list[str] | None,
        typer.Option(
            "--light",
            help="Instead of --lamp: the surroundings as an equirectangular .exr environment map, whose first column "
            "is straight ahead of the camera, or studio, overcast, sky, one-lamp or room. Once, or once per picture.",
            metavar="PICTURE|NAME",
        ),
    ] = None
    light_ball: Annotated[
        list[str] | None,
        typer.Option(
            "--light-ball",
            help="Instead of --lamp: a picture of a mirror ball in the same place, by the same camera, optionally with "
            "its outline. Once, or once per picture. The fit estimates the brightness of clipped highlights.",
            metavar="PICTURE[@X,Y,R]",
        ),
    ] = None
    exposure: Annotated[
        str | None,
        typer.Option(
            "--exposure",
            help="Exposure of the pictures relative to the light, or to a white diffuser that faces the lamp; free: "
            "unknown, equal for all pictures; each: unknown, different per picture (or lamps of unknown strength).  "
            "[default: each for lamps without a grey card, free if their file has intensities, else "
            f"{_AS_THE_LIGHT}]",
            metavar="E|free|each",
            rich_help_panel=TAKEN,
        ),
    ] = None
    grey: Annotated[
        str | None,
        typer.Option(
            "--grey",
            help="A grey card in the pictures, facing the camera: corner and size in pixels, and reflectance. It fixes "
            "the exposure and the colour of the lamp.",
            metavar="X,Y,W,H,R",
            rich_help_panel=TAKEN,
        ),
    ] = None
    circle: Annotated[
        list[str] | None,
        typer.Option(
            "--circle",
            help="The outline of the ball in pixels. [default: estimated]",
            metavar="X,Y,R",
            show_default=False,
            rich_help_panel=TAKEN,
        ),
    ] = None
    cylinder: Annotated[
        list[str] | None,
        typer.Option(
            "--cylinder",
            help="Instead of a ball, an upright cylinder such as a painted tin: centre, radius and height in pixels.",
            metavar="X,Y,R,H",
            rich_help_panel=TAKEN,
        ),
    ] = None
    distance: Annotated[
        float | None,
        typer.Option(
            "--distance",
            help="Distance of the camera from the centre of the ball, in radii of the ball. [default: far]",
            metavar="RADII",
            rich_help_panel=TAKEN,
        ),
    ] = None
    elevation: Annotated[
        float,
        typer.Option(
            "--elevation",
            help="Elevation of the camera above the ball, in degrees.",
            metavar="DEG",
            min=-89.0,
            max=89.0,
            rich_help_panel=TAKEN,
        ),
    ] = 0.0
    turn: Annotated[
        list[float] | None,
        typer.Option(
            "--turn",
            help="Azimuth of the direction straight ahead of the camera in the environment map, in degrees to the "
            "right of its first column.",
            metavar="DEG",
            rich_help_panel=TAKEN,
        ),
    ] = None
    camera: Annotated[
        Path | None,
        typer.Option(
            "--camera",
            help="Sensitivities of the camera: a text file of wavelengths in nm and three columns. [default: sRGB]",
            metavar="FILE",
            rich_help_panel=TAKEN,
        ),
    ] = None
    linear: Annotated[bool, options.linear_option(TAKEN)] = False
    encoded: Annotated[bool, options.encoded_option(TAKEN)] = False
    dark: Annotated[
        Path | None,
        typer.Option(
            "--dark",
            help="A picture without light, subtracted from the others.",
            metavar="PICTURE",
            rich_help_panel=TAKEN,
        ),
    ] = None

    def request_of(self, pictures: Sequence[Path]) -> PhotoRequest:
        """Return the request that these options make for pictures. Raises UsageError if they contradict each other."""
        from manifold.estimate.sightings import PhotoRequest

        if sum(map(bool, (self.light, self.lamp, self.light_ball))) != 1:
            from manifold.colour.lights import ENVIRONMENTS

            several = "several lights are given" if self.light or self.lamp else "no light is given"
            raise UsageError(
                f"{pictures[0]}: {several}; use --lamp (X,Y,Z, flash, FILE or found), --light-ball MIRROR.png or "
                f"--light (ENV.exr, {', '.join(ENVIRONMENTS)})"
            )
        if self.circle and self.cylinder:
            raise UsageError("--circle and --cylinder, expected one of them")
        if any(
            text.count(",") != count
            for given, count in ((self.circle, 2), (self.cylinder, 3))
            for text in given or ()
        ):
            raise UsageError("expected --circle X,Y,R, or --cylinder X,Y,R,H")
        is_unknown = self.exposure is None and bool(self.lamp) and self.grey is None
        exposure = self.exposure or ("each" if is_unknown else _AS_THE_LIGHT)
        try:
            known = None if exposure == "free" or (exposure == "each" and self.grey is None) else 1.0
            if exposure not in ("free", "each"):
                known = float(exposure)
        except ValueError:
            raise UsageError(
                f"--exposure '{exposure}', expected a number above 0, 'each' or 'free'"
            ) from None
        far = float("inf") if self.distance is None else self.distance
        return PhotoRequest(
            list(pictures), self.light or (), self.cylinder or self.circle or (), self.turn or (0.0,), self.elevation,
            far, known, self.camera, self.lamp or (), None if is_unknown else exposure == "each", self.grey,
            options.are_linear(self.linear, self.encoded), self.dark,
            self.light_ball or (),
        )  # fmt: skip


NONE = PhotoOptions()


@app.command(
    "photograph",
    epilog="Example: manifold photograph a.png b.png c.png --lamp found -o paint.bsdf",
)
def photograph(
    pictures: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Pictures of one ball: .exr, .hdr, .tif, .png or .jpg, or raw files of a camera.",
            metavar="PICTURE",
            show_default=False,
        ),
    ] = None,
    photos: PhotoOptions = NONE,
    readings: Annotated[
        list[Path] | None,
        typer.Option(help="Also readings of the material, from an instrument's file.", metavar="FILE"),
    ] = None,
    sample: options.SampleOption = None,
    gloss: options.GlossOption = None,
    lab: Annotated[
        str | None, typer.Option(help="Also its CIELAB colour (45/0, D65, 2 degrees).", metavar="L,a,b")
    ] = None,
    library: options.LibraryOption = options.DEFAULT_LIBRARY,
    output: Annotated[
        Path | None, options.output_option("The file to write. [default: the first picture's name, .bsdf]")
    ] = None,
    picture: Annotated[
        bool,
        typer.Option("--picture", help="Also draw the photographs beside their prediction, into NAME.png."),
    ] = False,
    report: options.ReportOption = None,
    suggest: Annotated[
        int,
        typer.Option(
            help="Also suggest this many lamp directions for the next pictures; without pictures, for the first.",
            metavar="K",
            min=0,
            max=100,
        ),
    ] = 0,
    file: options.FileOptions = options.USUAL_FILE,
    json: options.JsonOption = None,
) -> None:
    """Estimate the BRDF of a painted ball or tin from photographs, with a library of materials as prior.

    The light of the pictures is given by --lamp, --light or --light-ball. Readings, gloss and a colour of the same
    material are part of the same estimate. To locate the result on a map, run `manifold locate`.
    """
    results = terminal.Results(json)
    if not pictures:
        if not suggest or readings or lab or gloss or report:
            raise UsageError(
                "no picture is given; give one, or only --suggest K for the first positions of the lamp"
            )
        suggest_lamps(results, library, suggest)
        return
    complete_photographs(
        results, photos.request_of(pictures), library, output, readings=readings, sample=sample, gloss=gloss, lab=lab,
        picture=picture, report=report, suggest=suggest, written=file.written,
    )  # fmt: skip


def suggest_lamps(results: terminal.Results, library: Path, count: int) -> None:
    """Print the suggested positions of the lamp for the first pictures."""
    from manifold.estimate.lamp_plan import plan_lamps

    with progress.shown("Leaving materials out"):
        plan = plan_lamps(library, count)
    show_plan(results, plan, "")
    results.document(plan)


def complete_photographs(
    results: terminal.Results, request: PhotoRequest, library: Path, output: Path | None, *,
    readings: Sequence[Path] | None, sample: str | None, gloss: Sequence[str] | None, lab: str | None, picture: bool,
    report: Path | None, suggest: int, written: OutputOptions,
) -> None:  # fmt: skip
    """Estimate a material from photographs and, if given, its readings, gloss and colour; print the result."""
    from manifold.estimate import completions, instruments, reports
    from manifold.estimate.attributes import readings_of_colour
    from manifold.library.store import Library

    if readings and lab is not None:
        raise UsageError(f"found --lab {lab} and readings {readings[0]}, expected one of them")
    measured = instruments.read(list(readings), sample)[0] if readings else None
    if lab is not None:
        colour = completions.parse_lab(lab, options.DAYLIGHT.viewing())
        measured = readings_of_colour(colour, {}, Library(library).bands)
    target = or_default(output, f"{request.photographs[0].stem}.bsdf")
    with progress.shown("Completing"):
        made = completions.complete(
            library, measured, target, pictures=request, gloss=completions.parse_gloss(gloss or []),
            picture=checked(target.with_suffix(".png"), "picture") if picture else None, count=suggest,
            options=written,
        )  # fmt: skip
    if report is not None:
        reports.write_completion(report, made, readings or ())
    show_completed(results, made, report)
    if isinstance(made, completions.Photographed):
        show_pictures(results, made)
        if made.plan is not None:
            show_plan(results, made.plan, " in addition to these")
    results.document(made)


def show_completed(
    results: terminal.Results,
    completed: Completed | Coated,
    report: Path | None,
    readings: Sequence[Path] = (),
) -> None:
    """Print a completed material: its rows, its report, the next command and the first notes.

    The next command exports the material or, if it should not be used yet, suggests more readings.
    """
    from manifold.estimate.completions import NextStep

    rows = completed.summary | ({} if report is None else {"report": report})
    assert completed.path is not None
    rows["next"] = terminal.export_command(completed.path)
    if completed.next_step is NextStep.CHECK_OBSERVATIONS:
        del rows["next"]
    elif readings and completed.next_step is NextStep.READ_MORE:
        command = f"manifold complete {shlex.join(map(str, readings))}"
        is_suggested = completed.suggested is not None
        rows["next"] = "measure the directions below" if is_suggested else f"{command} --suggest 3"
    results.rows(f"Completed {completed.path}", rows | terminal.notes(completed.diagnostics))


def show_pictures(results: terminal.Results, made: Photographed) -> None:
    """Print a row for each picture."""
    results.text("\n")
    is_found = any(ball.lamp_deg is not None for ball, _, _ in made.balls_with_residuals)
    results.table(
        ("picture", "circle", "lamp", *["lamp +-"] * is_found, "residual", "predicted from the others"),
        [
            (
                ball.photograph.path.name, str(ball.circle), " ".join(map(str, ball.lamps)) or "-",
                *["-" if ball.lamp_deg is None else f"{ball.lamp_deg:.0f} degrees"] * is_found,
                f"{100 * residual:.1f} %", "-" if predicted is None else f"{100 * predicted:.1f} %",
            )
            for ball, residual, predicted in made.balls_with_residuals
        ],
    )  # fmt: skip


def show_plan(results: terminal.Results, plan: LampPlan, beside: str) -> None:
    """Print the suggested positions of a lamp."""
    from manifold.core.judged_lights import LIGHTS

    heads = ("lamp from the camera", "ball", "colour", "gloss 60", "flop")

    def cells(label: str, determined: Determined) -> tuple[str, ...]:
        return (
            label,
            f"{determined.ball:.1f}",
            f"{determined.colour:.1f}",
            f"{100.0 * determined.gloss:.0f} %",
            f"{determined.flop:.1f}",
        )

    results.text(
        f"\nMedian errors of left-out materials with one picture{beside}, by the angle between lamp and camera\n"
        f"(CIEDE2000 of the ball in {LIGHTS} and of the colour at 45/0, gloss, L* at 15 minus L* at 110 degrees)\n"
    )
    results.table(
        heads, [cells(f"{determined.angles_deg[-1]:.0f} degrees", determined) for determined in plan.alone]
    )
    results.text("\nNext lamp directions\n")
    results.table(
        heads, [cells(f"{determined.angles_deg[-1]:.0f} degrees", determined) for determined in plan.next]
    )
