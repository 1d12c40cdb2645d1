"""Commands that render: render, compare."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from manifold import progress
from manifold.errors import UsageError

from . import options, terminal
from .application import app
from .batch_options import PointsOption, inputs_of, make_many
from .outputs import or_default
from .worker_options import ONE, OneWorkerOptions

if TYPE_CHECKING:
    from manifold.pictures.renders import Rendered
    from manifold.render.image_metrics import Summary

IlluminantOption = Annotated[
    str,
    typer.Option(
        help="CIE illuminant (D65, A, F2, F11, LED-B3, ...), or a text file of nm and power.",
        metavar="NAME|FILE",
    ),
]
EnvironmentOption = Annotated[
    Path | None,
    typer.Option(help="Environment map, latitude by longitude; a studio light if none.", metavar="FILE"),
]
SizeOption = Annotated[int, typer.Option(help="Pixels per side.", metavar="N", min=16, max=8192)]
SamplesOption = Annotated[int, typer.Option(help="Light paths per pixel.", metavar="N", min=1, max=1 << 20)]
SeedOption = Annotated[
    int, typer.Option(help="Seed of the noise; equal seeds give equal pictures.", metavar="N", min=0)
]


@app.command(
    "render",
    short_help="Render a ball of a measured or predicted material.",
    epilog="Example: manifold render satin_gold_spec.bsdf --illuminant F11 -o gold.png",
)
def render(
    materials: Annotated[
        list[str] | None,
        typer.Argument(
            help="A .bsdf file, the JSON of a fit, a material of the library, or a place on the map; or several, "
            "folders, or libraries.",
            metavar=options.MATERIAL,
            show_default=False,
        ),
    ] = None,
    latent: options.PlaceOption = None,
    points: PointsOption = None,
    model: options.ModelOption = options.DEFAULT_MODEL,
    library: options.MovedLibraryOption = None,
    colour: options.ColourOptions = options.OWN_COLOUR,
    direct: Annotated[
        bool,
        typer.Option("--direct", help="Evaluate the measured materials while rendering; needs LLVM."),
    ] = False,
    output: Annotated[
        Path | None,
        options.output_option(
            "Picture: .png tone-mapped, .exr linear; or the folder. [default: render.png, or renders]"
        ),
    ] = None,
    illuminant: IlluminantOption = "D65",
    environment: EnvironmentOption = None,
    size: SizeOption = 256,
    samples: SamplesOption = 64,
    seed: SeedOption = 0,
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
        size=size, samples=samples, seed=seed, illuminant=illuminant, environment=environment
    )
    if points is not None:
        if materials or latent is not None or colour != options.OWN_COLOUR:
            raise UsageError("found --from and a material or colour; write these into columns of the table")
        from manifold import many
        from manifold.estimate.point_table import read_points

        rows, failed = read_points(points, model, library)
        command = many.renders(settings, model=model, library=library, direct=direct)
        make_many(results, command, rows, output, workers.executor(), failed=failed)
        return
    from manifold.estimate.inputs import is_rendered

    sources = options.material_sources(
        materials or [], [] if latent is None else [latent], model, library,
        colour=colour,
    )  # fmt: skip
    if not sources or (materials and latent is not None):
        found = "nothing" if not sources else f"{', '.join(materials or ())} and --latent {latent}"
        raise UsageError(
            f"found {found}, expected one material: a file, a name, or a place like -0.3,1.2 or FROM:TO:T; or several"
        )
    if (several := inputs_of(sources, output, is_rendered)) is not None:
        if direct:
            raise UsageError("--direct goes with one place, or with --from")
        from manifold import many

        make_many(results, many.renders(settings), several, output, workers.executor())
        return
    with progress.shown("Rendering"):
        made = renders.render(sources[0], or_default(output, "render.png"), settings, direct=direct)
    _show(results, made)


def _show(results: terminal.Results, made: Rendered) -> None:
    content = made.to_json()
    rows = {
        "material": f"{content['material']} ({content['route']})",
        "light": content["illuminant"],
        "picture": "{size} x {size}, {samples} samples per pixel, seed {seed}".format(**content),
        "renderer": content["backend"],
        "time": f"{made.seconds:.1f} s",
    }
    results.rows(
        f"Rendered {made.path}", rows | (made.prediction.rows if made.prediction is not None else {})
    )
    results.document(content)


@app.command(
    "compare",
    short_help="Compare two pictures, or two rendered materials.",
    epilog="Example: manifold compare satin_gold_spec.bsdf predicted_spec.bsdf -o difference.png",
)
def compare(
    a: Annotated[
        str,
        typer.Argument(
            help="A picture; or a .bsdf file, the JSON of a fit, a material of the library, a place on the map.",
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
    samples: SamplesOption = 256,
    seed: SeedOption = 0,
    json: options.JsonOption = None,
) -> None:
    """Put two pictures side by side, with maps of CIEDE2000 and FLIP; materials are rendered alike first.

    A CIEDE2000 of 1, or a Delta E_ITP of 1 on a display with a white of 100 cd/m2, is visible side by side. FLIP
    ranges from 0 to 1 and ignores detail too fine to be visible. All three include the noise of the renders, which
    decreases with --samples.
    """
    from manifold.pictures import renders
    from manifold.render.ball import make_settings

    results = terminal.Results(json)
    settings = make_settings(
        size=size, samples=samples, seed=seed, illuminant=illuminant, environment=environment
    )
    with progress.shown("Comparing"):
        sources = [options.material_source(text, model, library) for text in (a, b)]
        made = renders.compare(sources[0], sources[1], output, settings)
    rows = {}
    for name, key in (("CIEDE2000", "ciede2000"), ("Delta E_ITP", "itp"), ("FLIP", "flip")):
        if made.ball:
            rows[f"{name} of the ball"] = _summary(made.ball[key])
        rows[f"{name} of the picture"] = _summary(made.pixels[key])
    results.rows(f"Compared {made.a} and {made.b} in {output}", rows)
    results.document(made.to_json())


def _summary(found: Summary) -> str:
    return (
        f"mean {found.mean:.3f}, median {found.median:.3f}, 95 % below {found.p95:.3f}, most {found.max:.3f}"
    )
