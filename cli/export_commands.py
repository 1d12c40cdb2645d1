"""The command that writes materials for engines: export."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from manifold.errors import UsageError
from manifold.system import atomic

from . import options, terminal
from .application import app
from .outputs import or_default, unnamed
from .point_options import count_words, raise_failed

if TYPE_CHECKING:
    from manifold.workflows.exports import ExportOutcome


TargetName = Literal[
    "gltf",
    "openpbr",
    "standard-surface",
    "usd",
    "usd-materialx",
    "blender",
    "blender-json",
    "unreal",
    "unity",
]


@app.command(
    "export",
    short_help="Write a material for engines: glTF, MaterialX, USD, Blender, Unreal, Unity.",
    epilog="Example: manifold export satin_gold_spec.bsdf -o satin_gold.glb",
)
def export(
    source: Annotated[
        Path | None,
        typer.Argument(
            help="The JSON of a fit, or a .bsdf file, which is fitted; or a library or folder of them.",
            metavar="SOURCE",
        ),
    ] = None,
    latent: options.PlaceOption = None,
    model: options.ModelOption = options.DEFAULT_MODEL,
    library: options.MovedLibraryOption = None,
    like: options.LikeOption = None,
    reflectance: options.ReflectanceOption = None,
    srgb: options.SrgbOption = None,
    output: Annotated[
        Path | None,
        options.output_option("The file: .glb, .mtlx, .usda, .py, .json; for many materials, a folder."),
    ] = None,
    target: Annotated[
        TargetName | None,
        typer.Option(help="The target, where neither the suffix nor the fit tells it. [default for folders: gltf]"),
    ] = None,
    against: Annotated[
        Path | None,
        typer.Option(help="For a fit: the measured .bsdf to compare with.", metavar="FILE"),
    ] = None,
    direct: Annotated[
        bool,
        typer.Option(
            "--direct", help="Fit the target's own model to the material: more accurate; takes seconds."
        ),
    ] = False,
    json: options.JsonOption = None,
) -> None:  # fmt: skip
    """Export materials to rendering engines, and report the error of each engine's shading model.

    The error is the mean CIEDE2000 on the ball between the material and the target's model, evaluated by its
    specification. It is shown beside that of Mitsuba's principled, from whose parameters the target's are
    computed.
    """
    from manifold.fitting.exports.targets import TARGETS
    from manifold.system.stages import Stages
    from manifold.workflows import export_folders, exports

    results = terminal.Results(json)
    if (source is None) == (latent is None):
        raise UsageError("expected either a source or --latent X,Y; name what to export")
    refused = None if source is None else "--latent; a file has its own colour"
    colour = options.colour_choice(like, reflectance, srgb, refused=refused)
    if source is not None and source.is_dir():
        if against is not None:
            raise UsageError("--against goes with the JSON of one fit; leave it out for a folder")
        many = TARGETS[target or "gltf"]
        folder = output or Path("exports")
        with terminal.progress("Exporting") as step:
            outcomes = export_folders.export_all(
                source, many, folder, step, is_direct=direct, check=partial(unnamed, "output")
            )
        _show_all(results, outcomes, folder)
        return
    path = or_default(output, "material.glb")
    chosen = exports.target_for(target, path, source)
    atomic.require_writable(path)
    with terminal.progress("Exporting") as step:
        stages = Stages(step, {"": 8, "evaluating the target's model": 2})
        if source is not None:
            subject = exports.subject_of(source, against)
        else:
            subject = exports.subject_of_prediction(
                model,
                latent or "",
                library=library,
                colour=colour,
                on_progress=stages.begin(""),
            )
        stages.begin("evaluating the target's model")
        outcome = exports.export(subject, chosen, path, is_direct=direct)
    _show(results, outcome)


def _show(results: terminal.Results, outcome: ExportOutcome) -> None:
    content = outcome.export or {}
    rows = terminal.parameter_rows(content["parameters"])
    rows["CIEDE2000 on the ball"] = f"{content['ciede2000']:.2f}, against the {content['against']}"
    if content["principled_ciede2000"] is not None:
        rows["of principled"] = f"{content['principled_ciede2000']:.2f}"
    label = "note on principled" if content["method"] == "direct" else "note"
    rows |= terminal.numbered(label, outcome.notes)
    results.rows(f"Exported {outcome.path} ({content['target']})", rows)
    results.document({"exports": [content | {"path": str(outcome.path)}], "failed": []})


def _show_all(results: terminal.Results, outcomes: list[ExportOutcome], folder: Path) -> None:
    rows = []
    for outcome in outcomes:
        if outcome.export is not None:
            losses = (outcome.export["ciede2000"], outcome.export["principled_ciede2000"])
            rows.append(
                [outcome.name, *("" if v is None else f"{v:.2f}" for v in losses), "kept" * outcome.was_there]
            )
    results.table(["material", "CIEDE2000", "of principled", ""], rows)
    failed = [f"{o.name}: {o.failure}" for o in outcomes if o.failure is not None]
    kept = sum(o.was_there for o in outcomes)
    results.text(count_words(len(rows), "materials", folder, kept) + "\n")
    made = [o.export | {"path": str(o.path)} for o in outcomes if o.export is not None]
    results.document({"exports": made, "failed": failed})
    raise_failed(failed)
