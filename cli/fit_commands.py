"""The command that fits BSDFs: fit."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from manifold import progress
from manifold.errors import FileFormatError, UsageError

from . import options, terminal
from .application import app
from .batch_options import inputs_of, make_many
from .outputs import or_default
from .worker_options import PER_CORE, WorkerOptions

if TYPE_CHECKING:
    from manifold.batch import Outcome
    from manifold.estimate.sources import MaterialSource


Metric = Literal["appearance", "cube-root", "linear", "log"]


@app.command(
    "fit",
    short_help="Fit the parameters of a BSDF, by default principled.",
    epilog="Example: manifold fit satin_gold_spec.bsdf -o satin_gold.fit.json",
)
def fit(
    sources: Annotated[
        list[str] | None,
        typer.Argument(help="A .bsdf file, a file of readings, a material of the library, or a place on the map; or "
        "several, folders of .bsdf files, or libraries.", metavar="MATERIAL"),
    ] = None,
    latent: options.PlaceOption = None,
    colour: options.ColourOptions = options.OWN_COLOUR,
    model: options.ModelOption = options.DEFAULT_MODEL,
    library: options.MovedLibraryOption = None,
    output: Annotated[
        Path | None,
        options.output_option("The JSON file to write, or the folder. [default: NAME.fit.json, or fits]"),
    ] = None,
    method: Annotated[
        str,
        typer.Option(
            help="{manifold.fit.principled.METHODS}: Gauss-Newton from many starts, or others to compare with.",
            metavar="NAME",
        ),
    ] = "gauss-newton",
    metric: Annotated[
        Metric, typer.Option(help="Residuals: of a lit ball and cube roots of samples; or of samples alone.")
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
        float, typer.Option(help="Relative noise of the samples, as a lower bound.", metavar="SHARE")
    ] = 0.01,
    workers: WorkerOptions = PER_CORE,
    picture: Annotated[
        bool, typer.Option("--picture", help="Also draw each fit beside its material, into NAME.fit.png.")
    ] = False,
    json: options.JsonOption = None,
) -> None:  # fmt: skip
    """Fit a BSDF of Mitsuba to measured files or to a predicted material.

    Writes one JSON per material: parameters, the difference on a lit ball, residuals, all minima found, and
    how well the samples determine each parameter. Fits that are up to date are kept. Several materials are fitted into
    a folder, with a table and a sheet of balls.
    """
    from manifold.estimate import inputs
    from manifold.estimate.sources import FileSource, PlaceSource
    from manifold.fit import fits
    from manifold.formats import registry
    from manifold.render.bsdf_parameters import principled

    materials = options.material_sources(
        sources or [], [] if latent is None else [latent], model, library,
        colour=colour,
    )  # fmt: skip
    if not materials:
        raise UsageError("found nothing to fit; name files, materials of the library, or places on the map")
    places = [source for source in materials if isinstance(source, PlaceSource)]
    if places and sample is not None:
        raise UsageError("--sample is of a file of readings; leave it or the places out")
    if sample is not None and len(materials) > 1:
        raise UsageError(f"sample {sample} of {len(materials)} files, expected one file; name one")
    if bsdf is not None and (free is not None or wide_colours):
        raise UsageError(
            "--bsdf goes with neither --free nor --wide-colours: its file has free parameters and ranges"
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
    target = or_default(output, f"{sample or source.name}{inputs.FIT}")
    with progress.shown("Fitting"):
        outcome = fits.fit(source, target, settings)
    predictions = [outcome.source] if places else []
    if outcome.content is not None:
        results.rows(f"Fitted {outcome.path}" + " (up to date)" * outcome.was_there, _rows(outcome.content))
        for prediction in predictions:
            results.rows("Fitted to a prediction", prediction.rows)
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
    """A picture beside the JSON of a fit."""
    from manifold.estimate.sources import source_file
    from manifold.fit.comparison import picture_of_fit

    target = outcome.path.with_suffix(".png")
    with progress.shown("Drawing"), source_file(source) as path:
        delta_e, flip = picture_of_fit(outcome.path, path, target)
    results.table(["picture", "CIEDE2000", "FLIP"], [[target.name, f"{delta_e:.2f}", f"{flip:.3f}"]])


def _rows(content: dict[str, Any]) -> dict[str, object]:
    from manifold.fit.identifiability import ParameterIdentifiability
    from manifold.metrics import Errors

    rows: dict[str, object] = {}
    for statement in content["statements"]:
        rows[statement["name"]] = str(ParameterIdentifiability(**statement))
    if content["errors"] is not None:
        rows["CIEDE2000 on the ball"] = Errors(**content["errors"])
    rows["relative residual"] = [f"{name} {value:.3f}" for name, value in content["residuals"].items()]
    rows["best diffuse"] = f"{content['metric']} {content['diffuse_residual']:.3f}"
    if content["spectral_residual"] is not None:
        rows["all bands"] = f"{content['metric']} {content['spectral_residual']:.3f}"
    others = [
        f"{minimum['residual']:.3f}" + " (as good)" * minimum["as_good"] for minimum in content["minima"][1:]
    ]
    rows["other minima"] = others or "none found"
    rows |= terminal.numbered("note", content["notes"])
    rows["time"] = f"{content['seconds']:.2f} s, {content['n_pairs']} direction pairs"
    return rows
