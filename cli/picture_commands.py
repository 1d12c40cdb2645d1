"""Commands that draw: maps, walks, slices, renders, and the page."""

from __future__ import annotations

import sys
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from manifold.core import progress
from manifold.core.errors import UsageError

from . import options, terminal
from .application import LIGHT, app
from .batch_options import ONE, OneWorkerOptions, PointsOption, inputs_of, make_many
from .outputs import or_default

if TYPE_CHECKING:
    pass


_RENDER = "render.png"
PictureOption = Annotated[Path, options.output_option("The picture: .png, .pdf or .svg.")]


SliceKind = Literal["angles", "image", "spectra"]


@app.command(
    "map",
    epilog="Example: manifold map --mark -0.3,1.2 -o map.png",
)
def latent_map(
    mark: Annotated[
        str | None,
        typer.Option(
            help="Also show the prediction at this point, or the point of a material.",
            metavar=options.MATERIAL,
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
    choice = colour.choice(refused=refused)
    with progress.shown("Rendering"):
        marked, left_out = maps.latent_map(
            model,
            output,
            library=library,
            marked=None if mark is None else options.material_source(mark, model, library),
            colour=choice,
        )
    rows: dict[str, object] = {"left out": ", ".join(left_out)} if left_out else {}
    results.rows(f"Drawn {output}", rows | (marked.rows if marked is not None else {}))
    results.document(
        {
            "path": output,
            "marked": marked and marked.latent,
            "left_out": left_out,
            "prediction": marked,
        }
    )


@app.command(
    "walk",
    epilog="Example: manifold walk syn_satin_gold syn_metallic_gold -o walk.png",
)
def walk(
    start: Annotated[
        str, typer.Argument(help="The first material: a name, a file, or a point.", metavar="FROM")
    ],
    end: Annotated[str, typer.Argument(help="The second material.", metavar="TO")],
    steps: Annotated[int, typer.Option(help="Number of balls.", metavar="N", min=2, max=25)] = 7,
    model: options.ModelOption = options.DEFAULT_MODEL,
    library: options.MovedLibraryOption = None,
    output: PictureOption = Path("walk.png"),
    json: options.JsonOption = None,
) -> None:
    """Draw a walk between two materials in perceptually equal steps, and predictions between their points on the map.

    A walk uses only the two materials: it interpolates their roughness and averages the rest. The second row shows
    predictions from all surrounding materials, on the straight line between the two points.
    `manifold predict FROM:TO:T -o FILE.bsdf` and `manifold export FROM:TO:T` write a step of the walk.
    """
    from manifold.pictures import maps

    results = terminal.Results(json)
    ends = [options.material_source(text, model, library) for text in (start, end)]
    with progress.shown("Rendering"):
        between = maps.walk(model, ends[0], ends[1], output, steps=steps, library=library)
    diagnosed = tuple(f"t = {t:.2g}: {said}" for t, made in between.items() for said in made.diagnostics)
    results.rows(f"Drawn {output}", {"diagnostics": diagnosed} if diagnosed else {})
    results.document(
        {
            "path": output,
            "predictions": [{"t": t} | made.to_json() for t, made in between.items()],
        }
    )


@app.command(
    "slices",
    epilog="Example: manifold slices gold_spec.bsdf felt_spec.bsdf --bands 450,650 -o slices.png",
)
def slices(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            help=".bsdf files, fits, materials of the library, or points on the map.", metavar="MATERIAL"
        ),
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
        str | None,
        typer.Option(help="Wavelengths in nm, such as 450,550,650, in place of R, G, B.", metavar="NM,NM"),
    ] = None,
    model: options.ModelOption = options.DEFAULT_MODEL,
    library: options.MovedLibraryOption = None,
    output: PictureOption = Path("slices.png"),
    json: options.JsonOption = None,
) -> None:
    """Draw slices of several BRDFs beside each other, by default at incidences of 20, 40 and 60 degrees."""
    from manifold.pictures import figures, maps

    results = terminal.Results(json)
    figures.require_writable(output)
    wavelengths = parse_wavelengths(bands) if bands is not None else []
    materials = options.material_sources(names or [], model, library, colour=colour)
    drawn = maps.sources(materials)
    curves = maps.slices(drawn, output, kind=kind, wavelengths_nm=wavelengths)
    labels = [source.label for source in drawn]
    results.rows(f"Drawn {output}", {"materials": labels})
    predictions = {source.label: source.prediction for source in drawn if source.prediction is not None}
    for label, made in predictions.items():
        results.rows(label[:1].upper() + label[1:], made.rows)
    results.document(
        {
            "path": output,
            "materials": labels,
            "curves": curves,
            "predictions": predictions,
        }
    )


def parse_wavelengths(text: str) -> list[float]:
    """Parse one to four numbers separated by commas."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if not 1 <= len(values) <= 4 or not all(0 < value < 1e5 for value in values):
        raise UsageError(f"--bands '{text}': expected one to four wavelengths in nm, like 450,550,650")
    return values


@app.command(
    "explore",
    epilog="Example: manifold explore, or manifold explore -o map.html",
)
def explore(
    output: Annotated[
        Path | None,
        options.output_option("Write the page as one HTML file that needs no network, and stop."),
    ] = None,
    model: options.ModelOption = options.DEFAULT_MODEL,
    library: options.MovedLibraryOption = None,
    surface: Annotated[
        list[Path] | None,
        typer.Option(
            help="A folder that `manifold surface` wrote or, if it holds several surfaces, the JSON file of one; may "
            "be repeated.",
            metavar="FOLDER",
        ),
    ] = None,
    folder: Annotated[
        Path, typer.Option(help="Folder for the files that the page writes.", metavar="FOLDER")
    ] = Path(),
    port: Annotated[
        int, typer.Option(help="Port of the server; 0 selects a free one.", metavar="N", min=0, max=65535)
    ] = 0,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")
    ] = True,
) -> None:
    """Explore the map in a web page: drag a point to see the ball, slices, reflectance and nearest materials.

    The page is served on the loopback interface only, until Ctrl-C; it can also write .bsdf files, render, fit,
    export, locate files and complete readings. In notebooks, manifold.page.MapWidget shows it.
    """
    from manifold.page import explore

    results = terminal.Results()
    with progress.shown("Tabulating"):
        if output is not None:
            size = explore.write_page(model, output, library=library, surfaces=surface or ())
            results.rows(f"Written {output}", {"size": terminal.megabytes(size)})
            return
        served = explore.server(model, library=library, folder=folder, port=port, surfaces=surface or ())

    def ready(address: str) -> None:
        results.text(f"{address}\n")
        sys.stdout.flush()
        if browser:
            webbrowser.open(address)

    explore.serve_until_interrupted(served, ready)


IlluminantOption = Annotated[
    str,
    typer.Option(
        help="CIE illuminant (D65, A, F2, F11, LED-B3, ...), or a text file of nm and power.",
        metavar="NAME|FILE",
        rich_help_panel=LIGHT,
    ),
]
EnvironmentOption = Annotated[
    Path | None,
    typer.Option(
        help="Equirectangular environment map (latitude by longitude). [default: a studio light]",
        metavar="FILE",
        rich_help_panel=LIGHT,
    ),
]
SizeOption = Annotated[
    int, typer.Option(help="Pixels per side.", metavar="N", min=16, max=8192, rich_help_panel=LIGHT)
]
SamplesOption = Annotated[
    int, typer.Option(help="Samples per pixel.", metavar="N", min=1, max=1 << 20, rich_help_panel=LIGHT)
]
SeedOption = Annotated[
    int,
    typer.Option(
        help="Seed of the noise; equal seeds give equal pictures, up to rounding.",
        metavar="N",
        min=0,
        rich_help_panel=LIGHT,
    ),
]


@app.command(
    "render",
    epilog="Example: manifold render satin_gold_spec.bsdf --illuminant F11 -o gold.png",
)
def render(
    materials: Annotated[
        list[str] | None,
        typer.Argument(
            help="A .bsdf file, the JSON of a fit, a material of the library, or a point on the map; or several, "
            "folders, or libraries.",
            metavar=options.MATERIAL,
            show_default=False,
        ),
    ] = None,
    points: PointsOption = None,
    model: options.ModelOption = options.DEFAULT_MODEL,
    library: options.MovedLibraryOption = None,
    colour: options.ColourOptions = options.OWN_COLOUR,
    direct: Annotated[
        bool,
        typer.Option(
            "--direct",
            help="Render with the `manifold` BSDF plugin, which combines the library's materials while rendering, "
            "instead of sampling them into a file first; needs LLVM.",
        ),
    ] = False,
    output: Annotated[
        Path | None,
        options.output_option(
            f"Picture: .png tone-mapped, .exr linear; or the folder. [default: {_RENDER}, or renders]"
        ),
    ] = None,
    illuminant: IlluminantOption = "D65",
    environment: EnvironmentOption = None,
    size: SizeOption = 256,
    samples: SamplesOption = 64,
    seed: SeedOption = 0,
    linear: Annotated[bool, options.linear_option(LIGHT)] = False,
    encoded: Annotated[bool, options.encoded_option(LIGHT)] = False,
    workers: OneWorkerOptions = ONE,
    json: options.JsonOption = None,
) -> None:
    """Render a ball of a file, of a material of the library, or of a prediction, under an environment light.

    Spectral materials are rendered spectrally, RGB ones in RGB. Colours are chromatically adapted (Bradford).
    """
    from manifold.pictures import renders
    from manifold.render.ball import make_settings

    results = terminal.Results(json)
    settings = make_settings(
        size=size, samples=samples, seed=seed, illuminant=illuminant, environment=environment,
        is_linear=options.are_linear(linear, encoded),
    )  # fmt: skip
    if points is not None:
        if materials or colour != options.OWN_COLOUR:
            raise UsageError("found --from and a material or colour; write these into columns of the table")
        from manifold.estimate.inputs import read_points
        from manifold.many import commands as many

        rows, failed = read_points(points, model, library)
        command = many.renders(settings, model=model, library=library, direct=direct)
        make_many(results, command, rows, output, workers.executor(), failed=failed)
        return
    from manifold.formats.recognition import is_rendered

    sources = options.material_sources(materials or [], model, library, colour=colour)
    if not sources:
        raise UsageError(
            "no material is given; give one: a file, a name, or a point such as -0.3,1.2 or FROM:TO:T; or several of "
            "these"
        )
    if (several := inputs_of(sources, output, is_rendered)) is not None:
        if direct:
            raise UsageError("--direct works only with one point, or with --from")
        from manifold.many import commands as many

        make_many(results, many.renders(settings), several, output, workers.executor())
        return
    with progress.shown("Rendering"):
        made = renders.render(sources[0], or_default(output, _RENDER), settings, direct=direct)
    results.rows(f"Rendered {made.path}", made.rows)
    results.document(made)


@app.command(
    "compare",
    epilog="Example: manifold compare satin_gold_spec.bsdf predicted_spec.bsdf -o difference.png",
)
def compare(
    a: Annotated[
        str,
        typer.Argument(
            help="A picture; or a .bsdf file, the JSON of a fit, a material of the library, a point on the map.",
            metavar="A",
        ),
    ],
    b: Annotated[str, typer.Argument(help="Another picture, or another material.", metavar="B")],
    model: options.ModelOption = options.DEFAULT_MODEL,
    library: options.MovedLibraryOption = None,
    output: Annotated[Path, options.output_option("The figure: .png, .pdf or .svg.")] = Path(
        "comparison.png"
    ),
    illuminant: IlluminantOption = "D65",
    environment: EnvironmentOption = None,
    size: SizeOption = 256,
    samples: SamplesOption = 96,
    seed: SeedOption = 0,
    linear: Annotated[bool, options.linear_option(LIGHT)] = False,
    encoded: Annotated[bool, options.encoded_option(LIGHT)] = False,
    json: options.JsonOption = None,
) -> None:
    """Put two pictures side by side, with maps of CIEDE2000 and FLIP; materials are first rendered in the same light.

    CIEDE2000 is defined for two uniform patches, where about 1 is just noticeable side by side. A Delta E_ITP of 1 is
    just noticeable in the most critical viewing conditions (ITU-R BT.2124; white of 100 cd/m2). Means over a ball have
    no such threshold. FLIP ranges from 0 to 1 and ignores detail too fine to be visible. All three include the noise of
    the renders, which decreases with --samples.
    """
    from manifold.pictures import renders
    from manifold.render.ball import make_settings

    results = terminal.Results(json)
    is_linear = options.are_linear(linear, encoded)
    settings = make_settings(
        size=size, samples=samples, seed=seed, illuminant=illuminant, environment=environment, is_linear=is_linear
    )  # fmt: skip
    with progress.shown("Comparing"):
        sources = [options.material_source(text, model, library) for text in (a, b)]
        made = renders.compare(sources[0], sources[1], output, settings, is_linear=is_linear)
    results.rows(f"Compared {made.a} and {made.b} in {output}", made.rows)
    results.document(made)
