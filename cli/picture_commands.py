"""Commands that draw: map, walk, slices."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from manifold import progress
from manifold.errors import UsageError

from . import options, terminal
from .application import app

PictureOption = Annotated[Path, options.output_option("The picture: .png, .pdf or .svg.")]


SliceKind = Literal["angles", "image", "spectra"]


@app.command(
    "map",
    short_help="Draw the map of materials as rendered balls.",
    epilog="Example: manifold map --mark -0.3,1.2 -o map.png",
)
def latent_map(
    mark: Annotated[
        str | None,
        typer.Option(
            help="Also show the prediction at this place, or where a material lies.", metavar=options.MATERIAL
        ),
    ] = None,
    colour: options.ColourOptions = options.OWN_COLOUR,
    model: options.ModelOption = options.DEFAULT_MODEL,
    library: options.MovedLibraryOption = None,
    output: PictureOption = Path("map.png"),
    json: options.JsonOption = None,
) -> None:
    """Draw the first two latent dimensions: every material as a rendered ball, over the expected error.

    Balls are rendered once and cached in the library.
    """
    from manifold.pictures import maps

    results = terminal.Results(json)
    refused = "--mark; materials have their own colours" if mark is None else None
    colour = colour.choice(refused=refused)
    with progress.shown("Rendering"):
        marked, left_out = maps.latent_map(
            model,
            output,
            library=library,
            marked=None if mark is None else options.material_source(mark, model, library),
            colour=colour,
        )
    rows: dict[str, object] = {"left out": ", ".join(left_out)} if left_out else {}
    results.rows(f"Drawn {output}", rows | (marked.rows if marked is not None else {}))
    results.document(
        {
            "picture": str(output),
            "marked": None if marked is None else marked.latent.tolist(),
            "left_out": left_out,
            "prediction": None if marked is None else marked.to_json(),
        }
    )


@app.command(
    "walk",
    short_help="Draw a walk between two materials.",
    epilog="Example: manifold walk syn_satin_gold syn_metallic_gold -o walk.png",
)
def walk(
    start: Annotated[
        str, typer.Argument(help="The first material: a name, a file, or a place.", metavar="FROM")
    ],
    end: Annotated[str, typer.Argument(help="The last material.", metavar="TO")],
    steps: Annotated[int, typer.Option(help="Balls on the path.", metavar="N", min=2, max=25)] = 7,
    model: options.ModelOption = options.DEFAULT_MODEL,
    library: options.MovedLibraryOption = None,
    output: PictureOption = Path("walk.png"),
    json: options.JsonOption = None,
) -> None:
    """Draw a walk between two materials, in steps that look equally large, and below it the path of latents.

    A walk is made of the two materials alone: roughness goes from one to the other, the rest is averaged. The path
    of latents shows what `predict` makes of the surrounding materials on the straight line between the two.
    `manifold predict FROM:TO:T -o FILE.bsdf` and `manifold export FROM:TO:T` write a step of the walk.
    """
    from manifold.pictures import maps

    results = terminal.Results(json)
    ends = [options.material_source(text, model, library) for text in (start, end)]
    with progress.shown("Rendering"):
        between = maps.walk(model, ends[0], ends[1], output, steps=steps, library=library)
    diagnosed = tuple(f"t = {t:.2g}: {said}" for t, made in between.items() for said in made.diagnostics)
    expected = [
        f"t = {t:.2g}: {made.expected.ball:.1f}" for t, made in between.items() if made.expected is not None
    ]
    rows: dict[str, object] = {"expected CIEDE2000": expected} if expected else {}
    results.rows(f"Drawn {output}", rows | ({"diagnostics": diagnosed} if diagnosed else {}))
    results.document(
        {
            "picture": str(output),
            "predictions": [{"t": t} | made.to_json() for t, made in between.items()],
        }
    )


@app.command(
    "slices",
    short_help="Draw BRDF values over angles or wavelengths.",
    epilog="Example: manifold slices gold_spec.bsdf felt_spec.bsdf --bands 450,650 -o slices.png",
)
def slices(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            help=".bsdf files, fits, materials of the library, or places on the map.", metavar="MATERIAL"
        ),
    ] = None,
    latent: Annotated[
        list[str] | None,
        typer.Option(help="Also a prediction; may be repeated.", metavar="X,Y|NAME|FROM:TO:T"),
    ] = None,
    colour: options.ColourOptions = options.OWN_COLOUR,
    kind: Annotated[
        SliceKind,
        typer.Option(
            help="angles: in the plane of incidence; image: over Rusinkiewicz theta_h and theta_d; "
            "spectra: over wavelength."
        ),
    ] = "angles",
    bands: Annotated[
        str | None, typer.Option(help="Wavelengths in nm in place of R, G, B: 450,550,650.", metavar="NM,NM")
    ] = None,
    model: options.ModelOption = options.DEFAULT_MODEL,
    library: options.MovedLibraryOption = None,
    output: PictureOption = Path("slices.png"),
    json: options.JsonOption = None,
) -> None:
    """Draw measured and predicted BRDFs beside each other: slices at incidence 20, 40 and 60 degrees."""
    from manifold.pictures import slices
    from manifold.plots import figures

    results = terminal.Results(json)
    figures.require_writable(output)
    wavelengths = parse_wavelengths(bands) if bands is not None else []
    materials = options.material_sources(names or [], latent or [], model, library, colour=colour)
    drawn = slices.sources(materials)
    slices.slices(drawn, output, kind=kind, wavelengths_nm=wavelengths)
    labels = [source.label for source in drawn]
    results.rows(f"Drawn {output}", {"materials": labels})
    predictions = {source.label: source.prediction for source in drawn if source.prediction is not None}
    for label, made in predictions.items():
        results.rows(label[:1].upper() + label[1:], made.rows)
    results.document(
        {
            "picture": str(output),
            "materials": labels,
            "predictions": {label: made.to_json() for label, made in predictions.items()},
        }
    )


def parse_wavelengths(text: str) -> list[float]:
    """One to four numbers separated by commas."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if not 1 <= len(values) <= 4 or not all(0 < value < 1e5 for value in values):
        raise UsageError(f"--bands '{text}': expected one to four wavelengths in nm, like 450,550,650")
    return values
