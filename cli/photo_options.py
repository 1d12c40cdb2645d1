"""Options of commands that take photographs of a ball, and what they print."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from manifold.errors import UsageError

from . import terminal

if TYPE_CHECKING:
    from manifold.estimate.lamp_plan import Determined, LampPlan
    from manifold.estimate.photographs import FromPhotographs
    from manifold.estimate.sightings import PhotoRequest


@dataclass(frozen=True)
class PhotoOptions:
    """Photographs of a ball, and how they were taken: the options of every command that takes such."""

    photo: Annotated[
        list[Path] | None,
        typer.Option(
            "--photo",
            help="A picture of a ball of the material: .exr or .tif (linear), .png or .jpg (sRGB). May be repeated.",
            metavar="PICTURE",
        ),
    ] = None
    light: Annotated[
        list[str] | None,
        typer.Option(
            "--light",
            help="Its light, by latitude and longitude, straight ahead in the first column: an .exr, or "
            "studio, overcast, sky, one-lamp or room. One, or one per picture.",
            metavar="PICTURE|NAME",
        ),
    ] = None
    circle: Annotated[
        list[str] | None,
        typer.Option(
            "--circle",
            help="The ball's outline in pixels. [default: found]",
            metavar="X,Y,R",
            show_default=False,
        ),
    ] = None
    turn: Annotated[
        list[float] | None,
        typer.Option(
            "--turn",
            help="Degrees from the light's first column to the right to straight ahead.",
            metavar="DEG",
        ),
    ] = None
    elevation: Annotated[
        float,
        typer.Option(
            "--elevation",
            help="Of the camera above the ball, in degrees.",
            metavar="DEG",
            min=-89.0,
            max=89.0,
        ),
    ] = 0.0
    distance: Annotated[
        float | None,
        typer.Option(
            "--distance",
            help="Of the camera from the ball's centre, in its radii. [default: far]",
            metavar="RADII",
        ),
    ] = None
    exposure: Annotated[
        str | None,
        typer.Option(
            "--exposure",
            help="Of the pictures relative to the light, or to a white diffuser that faces the lamp; free "
            "where it is not known; each where every picture has its own.  [default: 1, free of a lamp"
            " without a grey card]",
            metavar="E|free|each",
        ),
    ] = None
    camera: Annotated[
        Path | None,
        typer.Option(
            "--camera",
            help="Sensitivities of the camera, a text file of nm and three columns. [default: sRGB]",
            metavar="FILE",
        ),
    ] = None
    lamp: Annotated[
        list[str] | None,
        typer.Option(
            "--lamp",
            help="Instead of --light: where its one lamp is, to the right, up and towards the camera, with "
            "its distance in radii of the ball where it is near; flash, at the camera; a file, a line "
            "per picture; or found, in the pictures, with its distance where it is near. One, or one "
            "per picture.",
            metavar="X,Y,Z[,D]|flash|FILE|found[,D]",
        ),
    ] = None
    grey: Annotated[
        str | None,
        typer.Option(
            "--grey",
            help="With --lamp: a grey card in the pictures, facing the camera: corner and size in pixels, "
            "reflectance; it fixes exposure and the lamp's colour.",
            metavar="X,Y,W,H,R",
        ),
    ] = None
    linear: Annotated[
        bool, typer.Option("--linear", help="The pictures' values are linear, whatever their kind.")
    ] = False
    dark: Annotated[
        Path | None,
        typer.Option(
            "--dark", help="A picture without light, subtracted from the others.", metavar="PICTURE"
        ),
    ] = None
    light_ball: Annotated[
        list[str] | None,
        typer.Option(
            "--light-ball",
            help="Instead of --light: a picture of a mirror ball in the same place, by the same camera. "
            "One, or one per picture; its outline is found, or given behind it. How bright clipped "
            "spots were follows from the pixels.",
            metavar="PICTURE[@X,Y,R]",
        ),
    ] = None
    cylinder: Annotated[
        list[str] | None,
        typer.Option(
            "--cylinder",
            help="Instead of a ball an upright cylinder, such as a painted tin: centre, radius and height in pixels.",
            metavar="X,Y,R,H",
        ),
    ] = None

    def request(self) -> PhotoRequest | None:
        """What the options ask for; None without photographs."""
        if not self.photo:
            return None
        from manifold.estimate.sightings import PhotoRequest

        if sum(map(bool, (self.light, self.lamp, self.light_ball))) != 1:
            from manifold.colour.lights import ENVIRONMENTS

            several = "with several kinds of light" if self.light or self.lamp else "without its light"
            raise UsageError(
                f"found --photo {several}; give one of --light ENV.exr, or a name ({', '.join(ENVIRONMENTS)}), "
                "--light-ball MIRROR.png, and --lamp X,Y,Z, flash or found"
            )
        if self.circle and self.cylinder:
            raise UsageError("--circle and --cylinder, expected one of them")
        if any(
            text.count(",") != count
            for given, count in ((self.circle, 2), (self.cylinder, 3))
            for text in given or ()
        ):
            raise UsageError("expected --circle X,Y,R, or --cylinder X,Y,R,H")
        exposure = self.exposure or ("free" if self.lamp and self.grey is None else "1")
        try:
            known = None if exposure == "free" or (exposure == "each" and self.grey is None) else 1.0
            if exposure not in ("free", "each"):
                known = float(exposure)
        except ValueError:
            raise UsageError(f"--exposure '{exposure}', expected a number above 0, each or free") from None
        far = float("inf") if self.distance is None else self.distance
        return PhotoRequest(
            self.photo, self.light or (), self.cylinder or self.circle or (), self.turn or (0.0,), self.elevation, far,
            known, self.camera, self.lamp or (), exposure == "each", self.grey, self.linear, self.dark,
            self.light_ball or (),
        )  # fmt: skip


NONE = PhotoOptions()


def show_photographs(results: terminal.Results, title: str, found: FromPhotographs) -> None:
    """Print what was found in photographs."""
    notes = {f"note {k}": note for k, note in enumerate(found.diagnostics, start=1)}
    results.rows(title, {**found.rows, "time": f"{found.seconds:.1f} s", **notes})
    if found.plan is not None:
        show_plan(results, found.plan, " beside what there is")
    results.document(found)


def show_plan(results: terminal.Results, plan: LampPlan, beside: str) -> None:
    """Print where to hold a lamp."""
    heads = ("lamp from the camera", "ball", "colour", "gloss 60", "flop")

    def cells(label: str, one: Determined) -> tuple[str, ...]:
        return (
            label,
            f"{one.ball:.1f}",
            f"{one.colour:.1f}",
            f"{100.0 * one.gloss:.0f} %",
            f"{one.flop:.1f}",
        )

    results.text(
        f"\nWhat one picture{beside} determines, by the angle between lamp and camera: median errors of left-out "
        "materials\n(CIEDE2000 of the ball in five lights and of the colour at 45/0, gloss, L* at 15 less that at 110 "
        "degrees)\n"
    )
    results.table(heads, [cells(f"{one.angles_deg[-1]:.0f} degrees", one) for one in plan.alone])
    results.text("\nHold the lamp next\n")
    results.table(heads, [cells(f"{one.angles_deg[-1]:.0f} degrees", one) for one in plan.next])
