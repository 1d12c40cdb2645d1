"""The command about textured surfaces: surface."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from manifold.core import progress
from manifold.core.defaults import SURFACE_TARGETS
from manifold.core.errors import UsageError

from . import options, terminal
from .application import app
from .batch_options import PER_CORE, WorkerOptions, make_many
from .outputs import or_default


@app.command(
    "surface",
    epilog="Example: manifold surface sample.xlsx -o sample_surface",
)
def surface(
    sources: Annotated[
        list[Path],
        typer.Argument(
            help="Workbooks of an MA-T12 with pictures, or folders of them; with --lamp, pictures or a folder of them.",
            metavar="WORKBOOK...",
        ),
    ],
    output: Annotated[
        Path | None,
        options.output_option(
            "The folder to write. [default: NAME_surface, or surfaces for several samples]"
        ),
    ] = None,
    library: options.LibraryOption = options.DEFAULT_LIBRARY,
    sample: options.SampleOption = None,
    lamp: Annotated[
        Path | None,
        typer.Option(
            "--lamp",
            help="For photographs of a flat sample from above, instead of workbooks: a text file of lamp "
            "directions, one line per picture in the order of the file names: right, up, towards the camera, and "
            "the intensity if lamps differ.",
            metavar="FILE",
        ),
    ] = None,
    linear: Annotated[bool, options.linear_option()] = False,
    encoded: Annotated[bool, options.encoded_option()] = False,
    size: Annotated[
        int, typer.Option(help="Width and height of the textures, in pixels.", metavar="N", min=192, max=8192)
    ] = 1024,
    target: Annotated[
        list[str] | None,
        typer.Option(
            help="gltf, openpbr, standard-surface, usd or blender; may be repeated. "
            f"[default: {', '.join(SURFACE_TARGETS)}]",
            show_default=False,
            metavar="NAME",
        ),
    ] = None,
    mm_per_pixel: Annotated[
        float | None,
        typer.Option(
            help="Width of a picture's pixel in millimetres, if known. It is recorded; heights stay in pixels.",
            metavar="MM",
            min=1e-6,
            max=1e3,
        ),
    ] = None,
    workers: WorkerOptions = PER_CORE,
    json: options.JsonOption = None,
) -> None:
    """Make a textured material from the pictures that an instrument takes with its readings.

    The readings are completed to the mean BRDF; pictures under lamps of known direction show how colour and
    slope differ from it, point by point. Writes textures without seams, and glTF, MaterialX, USD and Blender materials
    with them. Surfaces of several samples go into one folder, with a table and a picture of all.
    """
    from manifold.estimate import inputs
    from manifold.surface.files import make_surface
    from manifold.surface.lamp_pictures import files_in, read_folder, read_workbook

    results = terminal.Results(json)
    targets = target or SURFACE_TARGETS
    if lamp is not None:
        if sample is not None:
            raise UsageError("--sample works only with a workbook; leave it out")
        is_linear = options.are_linear(linear, encoded)
        pictures, readings = read_folder(files_in(sources), lamp, is_linear), None
    else:
        if linear or encoded:
            raise UsageError(
                "--linear and --encoded work only with --lamp; an instrument's pictures are linear"
            )
        samples = [] if sample is not None else inputs.find_samples(sources)
        if len(samples) > 1 or any(source.is_dir() for source in sources):
            from manifold.many import commands as many

            if output is not None:
                inputs.require_apart(sources, output)
            command = many.surfaces(library, size=size, targets=targets, mm_per_pixel=mm_per_pixel)
            make_many(results, command, samples, output, workers.executor())
            return
        if len(sources) > 1:
            raise UsageError(f"found --sample {sample} of {len(sources)} files, expected one workbook")
        pictures, readings = read_workbook(sources[0], sample)

    folder = or_default(output, f"{sources[0].stem}_surface")
    with progress.shown("Making the surface"):
        made = make_surface(
            library, pictures, readings, folder, size=size, targets=targets, mm_per_pixel=mm_per_pixel
        )
    time = {"time": f"{made.seconds:.1f} s", **terminal.numbered("note", made.notes)}
    results.rows(f"Surface {made.folder}", made.rows | time)
    results.document(made)
