"""Commands that fit BSDFs and make files of engines."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from manifold.core import progress
from manifold.core.errors import FileFormatError, UnknownNameError, UsageError
from manifold.registries import FIT_SUFFIX

from . import options, terminal
from .application import app
from .batch_options import PER_CORE, WorkerOptions, inputs_of, make_many, require_folder
from .outputs import checked, or_default, written

if TYPE_CHECKING:
    from manifold.estimate.sources import MaterialSource
    from manifold.many.batch import Outcome

_TARGET = "gltf"  # of an export whose file has no suffix
Metric = Literal["appearance", "cube-root", "linear", "log"]


@app.command(
    "fit",
    epilog="Example: manifold fit satin_gold_spec.bsdf -o satin_gold.fit.json",
)
def fit(
    sources: Annotated[
        list[str] | None,
        typer.Argument(help="A .bsdf file, a file of readings, a material of the library, or a point on the map; or "
        "several, folders of .bsdf files, or libraries.", metavar="MATERIAL"),
    ] = None,
    colour: options.ColourOptions = options.OWN_COLOUR,
    model: options.ModelOption = options.DEFAULT_MODEL,
    library: options.MovedLibraryOption = None,
    output: Annotated[
        Path | None,
        options.output_option(f"The JSON file to write, or the folder. [default: NAME{FIT_SUFFIX}, or fits]"),
    ] = None,
    method: Annotated[
        str,
        typer.Option(
            help="{manifold.registries.FITTERS}: Gauss-Newton from many starts; adam and swarm are for comparison.",
            metavar="NAME",
        ),
    ] = "gauss-newton",
    metric: Annotated[
        Metric, typer.Option(help="Residuals to minimise; appearance: balls in nine lights and cube roots.")
    ] = "appearance",
    free: Annotated[
        str | None,
        typer.Option(help="Parameters of principled to fit, separated by commas; the others are "
        "fixed.", metavar="NAMES"),
    ] = None,
    bsdf: Annotated[
        Path | None,
        typer.Option(help="Another BSDF: JSON of type, parameters (name, minimum, maximum, default) and fixed.",
                     metavar="FILE"),
    ] = None,
    wide_colours: Annotated[
        bool,
        typer.Option("--wide-colours", help="Let base colours range from -0.25 to 1.25; engines accept 0 to 1."),
    ] = False,
    sample: options.SampleOption = None,
    noise: Annotated[
        float, typer.Option(help="Smallest relative noise that the fit assumes for the samples.", metavar="SHARE")
    ] = 0.01,
    workers: WorkerOptions = PER_CORE,
    picture: Annotated[
        bool, typer.Option("--picture", help="Also draw each fit beside its material, into NAME.fit.png.")
    ] = False,
    json: options.JsonOption = None,
) -> None:  # fmt: skip
    """Fit a BSDF of Mitsuba to measured files or to a predicted material.

    Writes one JSON per material: parameters, the difference between the rendered balls, residuals, all minima found,
    and how well the samples determine each parameter. A repeated run keeps fits whose inputs have not changed. Several
    materials are fitted into a folder, with a table and a picture of all balls.
    """
    from manifold.estimate.sources import FileSource, PlaceSource
    from manifold.fit import fits
    from manifold.formats import registry
    from manifold.render.bsdf_parameters import principled

    materials = options.material_sources(sources or [], model, library, colour=colour)
    if not materials:
        raise UsageError("no material is given; give files, materials of the library, or points on the map")
    places = [source for source in materials if isinstance(source, PlaceSource)]
    if places and sample is not None:
        raise UsageError("--sample works only with a file of readings; leave out the option or the points")
    if sample is not None and len(materials) > 1:
        raise UsageError(f"sample {sample} of {len(materials)} files, expected one file; name one")
    if bsdf is not None and (free is not None or wide_colours):
        raise UsageError(
            "--bsdf cannot be combined with --free or --wide-colours: its file has free parameters and ranges"
        )
    results = terminal.Results(json)
    family = None if bsdf is None else fits.read_family(bsdf)
    if free is not None:
        family = principled([name.strip() for name in free.split(",")], wide_colours=wide_colours)
    settings = fits.FitSettings(family, method, metric, noise, wide_colours, sample)
    several = None if sample else inputs_of(materials, output, samples=True)
    if several is not None:
        command = fits.fits(settings, with_pictures=picture)
        make_many(results, command, several, output, workers.executor())
        return
    source = materials[0]
    if picture and isinstance(source, FileSource) and (known := registry.identify(source.path)) is not None:
        raise UsageError(
            f"{source}: {known.name}, which cannot be rendered; leave --picture out, or write a .bsdf with "
            f"`manifold convert` or `manifold complete`"
        )
    target = or_default(output, f"{sample or source.name}{FIT_SUFFIX}")
    with progress.shown("Fitting"):
        outcome = fits.fit(source, target, settings)
    predictions = [outcome.source] if places else []
    if outcome.content is not None:
        results.rows(
            f"Fitted {outcome.path}" + " (up to date)" * outcome.was_there, _fit_rows(outcome.content)
        )
        for prediction in predictions:  # whose diagnostics are notes of the fit
            results.rows("Fitted to a prediction", prediction.summary)
        if picture:
            _draw(results, outcome, source)
    failed = [] if outcome.failure is None else [f"{outcome.name}: {outcome.failure}"]
    results.document(
        {
            "fits": [] if outcome.content is None else [outcome.content],
            "failed": failed,
            "predictions": [prediction.to_json() for prediction in predictions],
        }
    )
    if outcome.failure is not None:
        is_named = outcome.failure.startswith((str(source), outcome.name))
        raise FileFormatError(outcome.failure if is_named else failed[0])


def _draw(results: terminal.Results, outcome: Outcome[Any], source: MaterialSource) -> None:
    """Draw a picture beside the JSON of a fit."""
    from manifold.estimate.source_files import source_file
    from manifold.pictures.fit_comparison import picture_of_fit

    target = outcome.path.with_suffix(".png")
    with progress.shown("Drawing"), source_file(source) as path:
        delta_e, flip = picture_of_fit(outcome.path, path, target)
    columns = ["picture", "CIEDE2000 (studio, D65)", "FLIP"]
    results.table(columns, [[target.name, f"{delta_e:.2f}", f"{flip:.3f}"]])


def _fit_rows(content: dict[str, Any]) -> dict[str, object]:
    from manifold.fit.principled import FitResult

    fit = FitResult.of_document(content)
    time = f"{fit.seconds:.2f} s, {fit.n_pairs} direction pairs"
    return fit.rows | terminal.numbered("note", fit.notes) | {"time": time}


@app.command(
    "export",
    epilog="Example: manifold export satin_gold_spec.bsdf -o satin_gold.glb",
)
def export(
    sources: Annotated[
        list[str] | None,
        typer.Argument(
            help="The JSON of a fit; or a .bsdf file, a material of the library, or a point on the map, which is "
            "fitted; or several, a library or folder of them.",
            metavar="SOURCE",
            show_default=False,
        ),
    ] = None,
    model: options.ModelOption = options.DEFAULT_MODEL,
    library: options.MovedLibraryOption = None,
    colour: options.ColourOptions = options.OWN_COLOUR,
    output: Annotated[
        Path | None,
        options.output_option(
            "The file: {manifold.registries.EXPORTS_IN_WORDS}; for many materials, a folder. "
            "[default: NAME and the suffix, or NAME_TARGET and the suffix for JSON, or if the suffix selects "
            "another target; for many materials the folder exports, or for shaders the folder shaders]"
        ),
    ] = None,
    target: Annotated[
        str | None,
        typer.Option(
            help="The target, if the suffix does not determine it: {manifold.registries.TARGETS}; or several, with "
            "commas between: their files go into the folder -o; or shader, a folder of a texture and code "
            f"that evaluate the BRDF itself. [default for folders: {_TARGET}]",
            metavar="NAME",
        ),
    ] = None,
    against: Annotated[
        Path | None,
        typer.Option(help="For a fit: the measured .bsdf to compare with.", metavar="FILE"),
    ] = None,
    picture: Annotated[
        bool,
        typer.Option(
            "--picture",
            help="Also draw the material beside the target's model, into NAME_TARGET.png; for several targets, all "
            "models, into NAME_exports.png.",
        ),
    ] = False,
    tolerance: Annotated[
        float | None,
        typer.Option(
            help="For shaders: write the smallest table whose difference from the material is at most this: "
            "{manifold.core.judged_lights.BALL}. [default: {manifold.core.defaults.SHADER_TOLERANCE}]",
            metavar="E",
        ),
    ] = None,
    prefix: Annotated[
        str | None,
        typer.Option(
            help="For shaders: begin all names in the code with this, so that a program may have several materials. "
            "[default: manifold]",
            metavar="NAME",
        ),
    ] = None,
    pack: Annotated[
        Path | None,
        written(
            help="Export a whole library or folder into this folder, with an index.html that shows measured and "
            "exported balls and their differences.",
            metavar="FOLDER",
        ),
    ] = None,
    json: options.JsonOption = None,
) -> None:  # fmt: skip
    """Export materials to rendering engines, and report the error of each engine's shading model.

    The target's own model is fitted to the material, which takes seconds. The error is the CIEDE2000 between
    balls of the material and of its fit, mean of {manifold.core.judged_lights.LIGHTS} that the fit did not use. The
    error of Mitsuba's principled, where the fit starts, is printed beside it. A shader evaluates the BRDF itself,
    without a fit.
    """
    results = terminal.Results(json)
    if pack is not None and output is not None:
        raise UsageError(f"found --pack {pack} and -o {output}, expected one of them: both name the output")
    if not sources:
        if pack is None:
            raise UsageError(
                "no material is given; give one: a file, a name, or a point such as -0.3,1.2 or FROM:TO:T"
            )
        sources = [str(library or options.DEFAULT_LIBRARY)]
    materials = options.material_sources(sources, model, library, colour=colour)
    if target == "shader":
        if against is not None:
            raise UsageError(
                "--against works only with the fit of a target's model; leave it out for a shader"
            )
        _export_shader(results, materials, output, tolerance, picture, pack, prefix)
        return
    if tolerance is not None or prefix is not None:
        raise UsageError(
            "--tolerance and --prefix work only with --target shader; leave them out for models that are fitted"
        )
    from manifold.estimate.inputs import is_many
    from manifold.fit import exporting  # which imports Matplotlib; a shader does without
    from manifold.fit.exports.targets import target_of
    from manifold.io_rgl import material_name
    from manifold.registries import TARGETS

    names = list(dict.fromkeys(map(str.strip, (target or _TARGET).split(","))))
    if "shader" in names:
        raise UsageError(
            f"--target {target}: a shader cannot be combined with other targets; export it with a command of its own"
        )
    try:
        targets = [TARGETS[name] for name in names]
    except UnknownNameError as error:
        raise UnknownNameError(f"{error}, shader") from None
    if len(targets) > 1 and pack is not None:
        raise UsageError(f"--pack works only with one target, found {target}")
    if is_many(materials):
        if against is not None:
            raise UsageError("--against works only with the JSON of one fit; leave it out for several")
        if len(targets) > 1:
            command = exporting.exports_of_many(targets, with_pictures=picture)
        else:
            command = exporting.exports(targets[0], with_pictures=picture, is_pack=pack is not None)
        make_many(results, command, exporting.all_sources(materials), pack or output)
        return
    (material,) = materials
    _refuse_pack_of_one(pack, material)
    name = material_name(Path(material.name.removesuffix(FIT_SUFFIX)))
    if len(targets) > 1:
        folder = or_default(output, ".")
        require_folder(folder, "the files of several targets; name a folder", targets[0].suffix)
        with progress.shown("Exporting"):
            drawn = checked(folder / f"{name}_{exporting.SHEET}.png", "picture") if picture else None
            outcomes = exporting.export_many(material, targets, folder, name, against=against, picture=drawn)
        _show_exports(results, outcomes, drawn)
        return
    named = targets[0] if target or output is None else target_of(None, output)
    path = or_default(output, f"{name}{named.file_suffix}")
    drawn = checked(exporting.picture_of(path, named), "picture") if picture else None
    with progress.shown("Exporting"):
        outcome = exporting.export(material, named.name, path, against=against, picture=drawn)
    _show_exports(results, [outcome], drawn)


def _refuse_pack_of_one(pack: Path | None, material: MaterialSource) -> None:
    if pack is not None:
        raise UsageError(
            f"--pack works only with a library or a folder of files, found {material}; use -o for one"
        )


def _export_shader(
    results: terminal.Results, materials: Sequence[MaterialSource], output: Path | None, tolerance: float | None,
    picture: bool, pack: Path | None, prefix: str | None,
) -> None:  # fmt: skip
    from manifold.core.defaults import SHADER_TOLERANCE
    from manifold.core.metrics import Errors
    from manifold.estimate.inputs import find_inputs, is_many
    from manifold.shader import exporting

    tolerance = SHADER_TOLERANCE if tolerance is None else tolerance
    if is_many(materials):
        if prefix is not None:
            raise UsageError(
                f"--prefix {prefix} works only with one material, found several; export each with its own prefix"
            )
        command = exporting.exports(tolerance, with_pictures=picture, is_pack=pack is not None)
        make_many(results, command, find_inputs(materials), pack or output)
        return
    (material,) = materials
    _refuse_pack_of_one(pack, material)
    folder = or_default(output, material.name.removesuffix(FIT_SUFFIX))
    require_folder(folder, "the files of a shader", ".glsl")
    with progress.shown("Exporting"):
        outcome = exporting.export(material, folder, tolerance=tolerance, with_picture=picture, prefix=prefix)
    content = outcome.content or {}
    rows: dict[str, object] = {
        "CIEDE2000 of the ball": f"{Errors(**content['errors'])}, against the {content['against']}",
        "texture": "{file}, {width} x {height}, ".format(**content["texture"])
        + f"{content['bytes'] / 1000:.0f} kB",
        "texture reads": ", ".join(f"{name} {count}" for name, count in content["fetches"].items()),
        "code": ", ".join(f"manifold.{language}" for language in content["code"]),
        "page": folder / exporting.PAGE,
    }
    rows |= terminal.numbered("note", outcome.notes)
    results.rows(f"Exported {folder} (shader)", rows)
    results.document({"exports": [outcome.to_json()], "failed": []})


def _show_exports(
    results: terminal.Results, outcomes: Sequence[Outcome[Any]], picture: Path | None = None
) -> None:
    from manifold.core.metrics import Errors
    from manifold.registries import TARGETS

    def parameters(content: dict[str, Any]) -> dict[str, object]:
        """Return rows of the parameters, without those that have their default."""
        usual = TARGETS[content["target"]].defaults
        changed = {name: value for name, value in content["parameters"].items() if value != usual[name]}
        return terminal.parameter_rows(changed)

    for outcome in outcomes:
        content = outcome.content or {}
        rows = parameters(content)
        rows["colour space"] = content["colour_space"]
        against = f"against the {content['against']}"
        if several := content.get("implementations"):
            for name, errors in several.items():
                rows[f"CIEDE2000 of the ball in {name}"] = f"{against}: {Errors(**errors)}"
        else:
            rows["CIEDE2000 of the ball"] = f"{against}: {Errors(**content['errors'])}"
        if (without := content.get("without_curve")) is not None:
            curve, base = TARGETS[content["target"]].curve
            rows[f"with {base} instead of {curve}"] = Errors(**without)
        if content["principled_errors"] is not None:
            rows["Mitsuba's principled"] = Errors(**content["principled_errors"])
        if picture is not None:
            rows["picture"] = picture
        rows |= terminal.numbered("note", outcome.notes)
        results.rows(f"Exported {outcome.path} ({content['target']})", rows)
        if (beside := content.get("beside")) is not None:
            rows = parameters(beside) | {"CIEDE2000 of the ball": f"{against}: {Errors(**beside['errors'])}"}
            results.rows(f"{beside['target']} in the same file", rows)
    results.document({"exports": [outcome.to_json() for outcome in outcomes], "failed": []})
