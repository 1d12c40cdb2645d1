"""The command about textured surfaces: surface."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from manifold import progress

from . import options, terminal
from .application import app
from .outputs import or_default


@app.command(
    "surface",
    short_help="Make textures and materials of a workbook's own pictures.",
    epilog="Example: manifold surface sample.xlsx -o sample_surface",
)
def surface(
    source: Annotated[
        Path,
        typer.Argument(
            help="A workbook of an MA-T12 with pictures; or, with --picture, a text of lamps' directions, x y z each.",
            metavar="WORKBOOK",
        ),
    ],
    output: Annotated[
        Path | None, options.output_option("The folder to write. [default: the sample's name, _surface]")
    ] = None,
    library: options.LibraryOption = options.DEFAULT_LIBRARY,
    sample: options.SampleOption = None,
    picture: Annotated[
        list[Path] | None,
        typer.Option(
            "--picture",
            help="Instead of a workbook's: one a lamp, in order; may be repeated.",
            metavar="FILE",
        ),
    ] = None,
    size: Annotated[
        int, typer.Option(help="Pixels of a side of the textures.", metavar="N", min=192, max=8192)
    ] = 1024,
    target: Annotated[
        list[str] | None,
        typer.Option(
            help="gltf, openpbr, standard-surface, usd or blender; may be repeated. [default: all but the third]",
            show_default=False,
            metavar="NAME",
        ),
    ] = None,
    json: options.JsonOption = None,
) -> None:
    """Make a textured material of the pictures that an instrument takes beside its readings.

    The readings are completed to the BRDF of the mean; pictures under lamps of known direction show how colour and
    slope differ from it, point by point. Writes textures without seams, and glTF, MaterialX, USD and Blender materials
    with them.
    """
    from manifold.surface.files import TARGETS, make_surface

    results = terminal.Results(json)
    folder = or_default(output, f"{source.stem}_surface")
    with progress.shown("Making the surface"):
        made = make_surface(
            source,
            library,
            folder,
            sample=sample,
            pictures=picture or (),
            size=size,
            targets=target or TARGETS,
        )
    found, sparkle = made.surface, made.sparkle
    flakes = sparkle.flakes
    results.rows(
        f"Surface {made.folder}",
        {
            "pictures": [f"{label}" for label in found.pictures.labels],
            "colour, relative spread": ", ".join(f"{100 * s:.0f} %" for s in found.albedo.std(axis=(0, 1))),
            "slopes": "across {:.3f}, along {:.3f} (standard deviations)".format(
                *found.relief.std(axis=(0, 1))
            ),
            "heights": f"{found.height.std():.2f} pixels (standard deviation)",
            "sparkle": f"{sparkle.density:.1f} glints per 10,000 pixels and lamp",
            **(
                {}
                if flakes is None
                else {
                    "flakes": f"{flakes.density:.0f} per 10,000 pixels, slopes {flakes.slope_std:.2f}, reflectance "
                    f"{flakes.reflectance:.3f}, roughness {flakes.roughness:.2f} (GGX alpha)"
                }
            ),
            "files": [path.name for path in made.paths.values()],
            **{f"{target}, ball CIEDE2000": f"{ball:.2f}" for target, ball in made.exports.items()},
            "time": f"{made.seconds:.1f} s",
            **terminal.numbered("note", made.notes),
        },
    )
    results.document(made.to_json())
