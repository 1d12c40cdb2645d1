"""Options shared by several commands, and their parsing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from manifold.core import shipped
from manifold.core.errors import UsageError

from . import terminal
from .application import COLOUR, GRID
from .defaults import DEFAULT_LIBRARY as DEFAULT_LIBRARY
from .defaults import DEFAULT_MODEL as DEFAULT_MODEL
from .outputs import written

if TYPE_CHECKING:
    from manifold.estimate.sources import MaterialSource
    from manifold.formats.readings import Viewing
    from manifold.model.colours import ColourChoice
    from manifold.model.output_file import OutputOptions


def output_option(help: str, metavar: str = "FILE") -> Any:
    """Return the option `--output` for an annotation."""
    return written("--output", "-o", help=help, metavar=metavar)


LibraryOption = Annotated[
    Path,
    typer.Option(
        "--library",
        "-L",
        help="The library: a folder, a zip file, an address, or built-in.",
        metavar="LIBRARY",
    ),
]
MovedLibraryOption = Annotated[
    Path | None,
    typer.Option("--library", "-L", help="The model's library, if it was moved.", metavar="LIBRARY"),
]
JsonOption = Annotated[
    Path | None,
    written("--json", help="Also write the results as JSON; with -, write only JSON to stdout.", at_end=True),
]
ModelOption = Annotated[
    Path, typer.Option("--model", "-M", help="The model: a file, or built-in.", metavar="MODEL")
]


@dataclass(frozen=True)
class ColourOptions:
    """Options for the colour of a prediction; by default its colour is blended."""

    like: Annotated[
        str | None,
        typer.Option(
            help="Take the reflectance of this material of the model, or of a .bsdf file.",
            metavar="NAME|FILE",
            rich_help_panel=COLOUR,
        ),
    ] = None
    reflectance: Annotated[
        Path | None,
        typer.Option(
            help="Take a reflectance spectrum: a text file of nm and values from 0 to 1.",
            metavar="FILE",
            rich_help_panel=COLOUR,
        ),
    ] = None
    srgb: Annotated[
        str | None,
        typer.Option(
            help="Take an sRGB colour: #rrggbb, or r,g,b from 0 to 1.",
            metavar="COLOUR",
            rich_help_panel=COLOUR,
        ),
    ] = None

    def choice(self, *, refused: str | None = None) -> ColourChoice:
        """Return the given colour.

        If the command cannot use a colour, `refused` is the text of the error.
        """
        from manifold.model.colours import ColourChoice

        if refused is not None and self != OWN_COLOUR:
            raise UsageError(f"--like, --reflectance and --srgb work only with {refused}")
        return ColourChoice(self.like, self.reflectance, self.srgb)


@dataclass(frozen=True)
class AttributeOptions:
    """Options for attributes that a prediction should have, by key of `attributes.ATTRIBUTES`."""

    gloss: Annotated[
        list[str] | None,
        typer.Option(
            help="Gloss units that the material should have at 20, 60 or 85 degrees, or a change of them, such as "
            "60=+10; may be repeated.",
            metavar="60=UNITS",
            rich_help_panel=COLOUR,
        ),
    ] = None
    lightness: Annotated[
        str | None,
        typer.Option(
            help="CIELAB lightness (45/0, D65) that the material should have, or a change of it.",
            metavar="L|+L|-L",
            rich_help_panel=COLOUR,
        ),
    ] = None
    chroma: Annotated[
        str | None,
        typer.Option(help="CIELAB chroma, or a change of it.", metavar="C|+C|-C", rich_help_panel=COLOUR),
    ] = None
    hue: Annotated[
        str | None,
        typer.Option(
            help="CIELAB hue in degrees, or a change of it.",
            metavar="H|+H|-H",
            rich_help_panel=COLOUR,
        ),
    ] = None


OWN_COLOUR, NO_ATTRIBUTES = ColourOptions(), AttributeOptions()
"""None of these options."""
MATERIAL = "FILE|NAME|X,Y|FROM:TO:T"
"""Metavariable of a material: a file, a material of the library, or a point on the map."""
GlossOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Gloss of the sample at 20, 60 or 85 degrees (ISO 2813); once for each angle.",
        metavar="ANGLE=UNITS",
    ),
]
CorrectionOption = Annotated[
    Path | None,
    typer.Option(
        "--correction",
        help="Correct readings in three bands by this file of `manifold calibrate`.",
        metavar="FILE",
    ),
]
PhysicalOption = Annotated[
    bool,
    typer.Option(
        "--physical",
        help="Make the file physically plausible: no negative values, albedo at most 1, reciprocal within "
        "5 %. Plausible values stay as they are; grids may be refined.",
        rich_help_panel=GRID,
    ),
]
ResolutionOption = Annotated[
    int,
    typer.Option(
        help="Outgoing directions: a grid of N x N.", metavar="N", min=4, max=512, rich_help_panel=GRID
    ),
]
IncidencesOption = Annotated[
    int,
    typer.Option(
        help="Angles of incidence from 0 to 90 degrees.", metavar="N", min=2, max=128, rich_help_panel=GRID
    ),
]


@dataclass(frozen=True)
class FileOptions:
    """Options for writing the file of an estimate."""

    physical: PhysicalOption = False
    resolution: ResolutionOption = 32
    incidences: Annotated[
        int | None,
        typer.Option(
            help="Angles of incidence from 0 to 90 degrees. [default: {manifold.core.defaults.FINE_INCIDENCES}]",
            metavar="N",
            min=2,
            max=128,
            rich_help_panel=GRID,
            show_default=False,
        ),
    ] = None

    @property
    def written(self) -> OutputOptions:
        """The options in the form that the writer takes."""
        from manifold.core.defaults import FINE_INCIDENCES
        from manifold.model.output_file import OutputOptions

        incidences = self.incidences or FINE_INCIDENCES
        return OutputOptions(self.physical, terminal.is_strict(), self.resolution, incidences)


@dataclass(frozen=True)
class ViewingOptions:
    """Options for the light and observer of CIELAB values: by default those of the file, or D65 and 2 degrees."""

    illuminant: Annotated[
        str | None,
        typer.Option(
            help="Illuminant of Lab values, such as D50 or A.  "
            "[default: that of the file, or {manifold.core.defaults.ILLUMINANT}]",
            metavar="NAME",
            rich_help_panel=COLOUR,
        ),
    ] = None
    observer: Annotated[
        int | None,
        typer.Option(
            help="Observer of Lab values in degrees: 2 (CIE 1931) or 10 (CIE 1964).  "
            "[default: that of the file, or {manifold.core.defaults.OBSERVER_DEG}]",
            metavar="DEGREES",
            rich_help_panel=COLOUR,
        ),
    ] = None

    def viewing(self, usual: Viewing | None = None) -> Viewing:
        """Return the light and observer; the usual ones, or D65/2, if none are given."""
        from manifold.formats.readings import DAYLIGHT, Viewing

        usual = usual or DAYLIGHT
        return Viewing(self.illuminant or usual.illuminant, self.observer or usual.observer_deg)

    @property
    def given(self) -> Viewing | None:
        """The given light and observer; None if neither is given."""
        return None if self.illuminant is None and self.observer is None else self.viewing()


DAYLIGHT, USUAL_FILE = ViewingOptions(), FileOptions()
"""None of these options."""
SampleOption = Annotated[
    str | None, typer.Option("--sample", help="The sample to take from a file with several.", metavar="NAME")
]
ReportOption = Annotated[
    Path | None,
    written(
        "--report",
        help="Also write a printable report, as one HTML file.",
        at_end=True,
    ),
]
UnitOption = Annotated[
    str | None,
    typer.Option(
        help="Unit of values in a table that names none: brdf (1/sr), factor (1 is the perfect diffuser) or percent.",
        metavar="UNIT",
    ),
]


def linear_option(panel: str | None = None) -> Any:
    """Return the option `--linear` for an annotation."""
    return typer.Option(
        "--linear", help="Read pictures as linear values, whatever their files say.", rich_help_panel=panel
    )


def encoded_option(panel: str | None = None) -> Any:
    """Return the option `--encoded` for an annotation."""
    return typer.Option(
        "--encoded",
        help="Read pictures as encoded for a display, whatever their files say; .exr, .hdr and .pfm are always linear. "
        "By default, 8 bits without a colour space are sRGB, 16 bits and floats linear.",
        rich_help_panel=panel,
    )


def are_linear(linear: bool, encoded: bool) -> bool | None:
    """Return whether `--linear` or `--encoded` is given for pictures, as True or False; None without them."""
    if linear and encoded:
        raise UsageError("found --linear and --encoded, expected at most one of them")
    return linear if linear or encoded else None


def material_source(text: str, model: Path, library: Path | None) -> MaterialSource:
    """Return the material that an argument names; if the default model does not exist, the default library is used."""
    from manifold.estimate.sources import parse_source

    has_model = model != DEFAULT_MODEL or shipped.exists(model)
    return parse_source(text, model, library or (None if has_model else DEFAULT_LIBRARY))


def several_materials(texts: Sequence[str], model: Path, library: Path | None) -> list[MaterialSource]:
    """Return the materials that arguments name; patterns such as `*.bsdf` are expanded."""
    from manifold.core.disk import matching

    return [material_source(each, model, library) for text in texts for each in matching(text)]


def material_sources(
    texts: Sequence[str], model: Path, library: Path | None, *, colour: ColourOptions
) -> list[MaterialSource]:
    """Return the materials that arguments name, predictions in the colour of the options."""
    from manifold.estimate.sources import PlaceSource

    sources = several_materials(texts, model, library)
    are_measured = not any(isinstance(source, PlaceSource) for source in sources)
    refused = "predictions; files and materials have their own colours" if are_measured else None
    choice = colour.choice(refused=refused)
    return [
        replace(source, colour=choice) if isinstance(source, PlaceSource) else source for source in sources
    ]
