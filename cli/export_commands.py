"""The command that writes materials for engines: export."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from manifold import progress
from manifold.errors import UsageError

from . import options, terminal
from .application import app
from .batch_options import make_many
from .outputs import or_default, written

if TYPE_CHECKING:
    from manifold.batch import Outcome


@app.command(
    "export",
    short_help="Write a material for engines: glTF, MaterialX, USD, Blender, Unreal, Unity.",
    epilog="Example: manifold export satin_gold_spec.bsdf -o satin_gold.glb",
)
def export(
    source: Annotated[
        str | None,
        typer.Argument(
            help="The JSON of a fit; or a .bsdf file, a material of the library, or a place on the map, which is "
            "fitted; or a library or folder of them.",
            metavar="SOURCE",
            show_default=False,
        ),
    ] = None,
    latent: options.PlaceOption = None,
    model: options.ModelOption = options.DEFAULT_MODEL,
    library: options.MovedLibraryOption = None,
    colour: options.ColourOptions = options.OWN_COLOUR,
    output: Annotated[
        Path | None,
        options.output_option(
            "The file: {manifold.fit.exports.targets.SUFFIXES}; for many materials, a folder. "
            "[default: the material's name, .glb; or exports]"
        ),
    ] = None,
    target: Annotated[
        str | None,
        typer.Option(
            help="The target, if neither the suffix nor the fit determines it: {manifold.fit.exports.targets.TARGETS}. "
            "[default for folders: gltf]",
            metavar="NAME",
        ),
    ] = None,
    against: Annotated[
        Path | None,
        typer.Option(help="For a fit: the measured .bsdf to compare with.", metavar="FILE"),
    ] = None,
    mapped: Annotated[
        bool,
        typer.Option("--mapped", help="Compute the parameters from those of principled: faster, less accurate."),
    ] = False,
    picture: Annotated[
        bool, typer.Option("--picture", help="Also draw the material beside the target's model, into NAME.png.")
    ] = False,
    pack: Annotated[
        Path | None,
        written(
            help="Write a whole library, or folder, here, with index.html: balls measured and exported, and their "
            "differences.",
            metavar="FOLDER",
        ),
    ] = None,
    json: options.JsonOption = None,
) -> None:  # fmt: skip
    """Export materials to rendering engines, and report the error of each engine's shading model.

    The target's own model is fitted to the material, which takes seconds. The error is the mean CIEDE2000 on
    the ball between the two, in lights that the fit did not see, beside that of Mitsuba's principled, where
    the fit starts.
    """
    from manifold.estimate.sources import FileSource
    from manifold.fit import exporting
    from manifold.fit.exports.targets import TARGETS
    from manifold.io_rgl import material_name

    results = terminal.Results(json)
    if pack is not None and output is not None:
        raise UsageError(
            f"found --pack {pack} and -o {output}, expected one of them: both are where to write"
        )
    if pack is not None and source is None and latent is None:
        source = str(library or options.DEFAULT_LIBRARY)
    material = options.one_material(source, latent, model, library, colour=colour)
    if isinstance(material, FileSource) and material.path.is_dir():
        if against is not None:
            raise UsageError("--against goes with the JSON of one fit; leave it out for a folder")
        command = exporting.exports(
            TARGETS[target or "gltf"], is_mapped=mapped, with_pictures=picture, is_pack=pack is not None
        )
        make_many(results, command, exporting.export_sources(material.path), pack or output)
        return
    if pack is not None:
        raise UsageError(f"--pack goes with a library or a folder of files, found {material}; use -o for one")
    name = material_name(Path(material.name.removesuffix(".fit.json")))
    path = or_default(output, name + TARGETS[target or "gltf"].suffix)
    drawn = path.with_suffix(".png") if picture else None
    with progress.shown("Exporting"):
        outcome = exporting.export(material, target, path, against=against, is_mapped=mapped, picture=drawn)
    _show(results, outcome, drawn)


def _show(results: terminal.Results, outcome: Outcome[Any], picture: Path | None) -> None:
    from manifold.metrics import Errors

    content = outcome.content or {}
    rows = terminal.parameter_rows(content["parameters"])
    rows["CIEDE2000 on the ball"] = f"{Errors(**content['errors'])}, against the {content['against']}"
    if content["principled_errors"] is not None:
        rows["of Mitsuba's principled"] = Errors(**content["principled_errors"])
    if picture is not None:
        rows["picture"] = picture
    rows |= terminal.numbered("note", outcome.notes)
    results.rows(f"Exported {outcome.path} ({content['target']})", rows)
    results.document({"exports": [outcome.to_json()], "failed": []})
