"""The command that fits BSDFs: fit."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from manifold.errors import FileFormatError, UsageError

from . import options, terminal
from .application import app

if TYPE_CHECKING:
    from manifold.workflows.output_index import Outcome
    from manifold.workflows.sources import MaterialSource


Method = Literal["gauss-newton", "adam", "swarm"]
Metric = Literal["appearance", "cube-root", "linear", "log"]


@app.command(
    "fit",
    short_help="Fit the parameters of a BSDF, by default principled.",
    epilog="Example: manifold fit satin_gold_spec.bsdf -o satin_gold.fit.json",
)
def fit(
    sources: Annotated[
        list[str] | None,
        typer.Argument(help=".bsdf files, files of readings, folders of .bsdf files (searched recursively), "
        "materials of the library, or places on the map.", metavar="MATERIAL"),
    ] = None,
    latent: options.PlaceOption = None,
    like: options.LikeOption = None,
    reflectance: options.ReflectanceOption = None,
    srgb: options.SrgbOption = None,
    model: options.ModelOption = options.DEFAULT_MODEL,
    library: options.MovedLibraryOption = None,
    output: Annotated[
        Path | None,
        options.output_option("The JSON file to write; for several materials, the folder."),
    ] = None,
    method: Annotated[
        Method, typer.Option(help="gauss-newton: from many starts; adam and swarm: earlier methods, for "
        "comparison.")
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
    jobs: Annotated[
        int | None, typer.Option("--jobs", "-j", help="Processes; one per core if not given.", metavar="N", min=1)
    ] = None,
    picture: Annotated[
        bool, typer.Option("--picture", help="Also draw each fit beside its material, into NAME.fit.png.")
    ] = False,
    json: options.JsonOption = None,
) -> None:  # fmt: skip
    """Fit a BSDF of Mitsuba to measured files or to a predicted material.

    Writes one JSON per material: parameters, the difference on a lit ball, residuals, all minima found, and
    how well the samples determine each parameter. Fits that are up to date are kept.
    """
    from manifold.fitting.bsdf_parameters import principled
    from manifold.formats import registry
    from manifold.workflows import fits
    from manifold.workflows.sources import FileSource, PlaceSource

    materials = options.material_sources(
        sources or [], [] if latent is None else [latent], model, library,
        like=like, reflectance=reflectance, srgb=srgb,
    )  # fmt: skip
    if not materials:
        raise UsageError("found nothing to fit; name files, materials of the library, or places on the map")
    places = [source for source in materials if isinstance(source, PlaceSource)]
    measured = [
        source.path if isinstance(source, FileSource) else source
        for source in materials
        if not isinstance(source, PlaceSource)
    ]
    if places and sample is not None:
        raise UsageError("--sample is of a file of readings; leave it or the places out")
    if bsdf is not None and (free is not None or wide_colours):
        raise UsageError(
            "--bsdf goes with neither --free nor --wide-colours: its file has free parameters and ranges"
        )
    for path in measured if picture else ():
        if isinstance(path, Path) and path.is_file() and (known := registry.identify(path)) is not None:
            raise UsageError(
                f"{path}: {known.name}, which cannot be rendered; leave --picture out, or write a .bsdf with "
                f"`manifold convert` or `manifold complete`"
            )
    results = terminal.Results(json)
    family = None if bsdf is None else fits.read_family(bsdf)
    if free is not None:
        family = principled([name.strip() for name in free.split(",")], wide_colours=wide_colours)
    settings = fits.FitSettings(family, method, metric, noise, wide_colours, sample)
    fitted: list[tuple[Outcome[Any], MaterialSource]] = []
    if places and len(materials) > 1:
        fits.make_folder(output or Path(), f"{len(materials)} fits")
    if measured:
        with terminal.progress("Fitting") as step:
            for outcome in fits.fit_files(measured, output, settings, jobs=jobs, on_progress=step):
                source = outcome.source
                fitted.append((outcome, FileSource(source) if isinstance(source, Path) else source))
    predictions = []
    for place in places:
        target = output if len(materials) == 1 else (output or Path()) / f"{place}.fit.json"
        with terminal.progress("Reading materials") as step:
            predicted = fits.fit_prediction(place, target, settings, step)
        predictions.append(predicted.source)
        fitted.append((predicted, place))
    outcomes = [outcome for outcome, _ in fitted]
    _show(results, outcomes)
    for prediction in predictions:
        results.rows("Fitted to a prediction", prediction.rows)
    if picture:
        _draw(results, fitted)
    failed = [f"{outcome.name}: {outcome.failure}" for outcome in outcomes if outcome.failure is not None]
    results.document(
        {
            "fits": [o.content for o in outcomes if o.content is not None],
            "failed": failed,
            "predictions": [prediction.to_json() for prediction in predictions],
        }
    )
    if failed:
        raise FileFormatError(_failures(outcomes))


def _failures(outcomes: list[Outcome[Any]]) -> str:
    """All that went wrong, in one line; what failed alike together."""
    names: dict[str, list[str]] = {}
    for outcome in outcomes:
        if outcome.failure is not None:
            failed = names.setdefault(outcome.failure, [])
            is_named = outcome.failure.startswith((str(outcome.source), outcome.source.name))
            failed += [] if is_named else [outcome.name]
    said = [
        f"{terminal.first_three(failed, ', ')}: {failure}" if failed else failure
        for failure, failed in names.items()
    ]
    return terminal.first_three(said)


def _draw(results: terminal.Results, fitted: list[tuple[Outcome[Any], MaterialSource]]) -> None:
    """A picture beside the JSON of every fit."""
    from manifold.workflows.fit_pictures import picture_of_fit
    from manifold.workflows.sources import source_file

    rows = []
    with terminal.progress("Drawing") as step:
        for done, (outcome, source) in enumerate(fitted, start=1):
            if outcome.content is None:
                continue
            target = outcome.path.with_suffix(".png")
            with source_file(source) as path:
                delta_e, flip = picture_of_fit(outcome.path, path, target)
            rows.append([target.name, f"{delta_e:.2f}", f"{flip:.3f}"])
            if step is not None:
                step(done, len(fitted), outcome.name)
    results.table(["picture", "CIEDE2000", "FLIP"], rows)


def _show(results: terminal.Results, outcomes: list[Outcome[Any]]) -> None:
    """All of a single fit; one line each of several."""
    fitted = [(outcome, outcome.content) for outcome in outcomes if outcome.content is not None]
    if len(fitted) == 1:
        outcome, content = fitted[0]
        results.rows(f"Fitted {outcome.path}" + " (up to date)" * outcome.was_there, _rows(content))
    elif fitted:
        rows = [
            [
                outcome.name,
                "" if content["ball"] is None else f"{content['ball']['unseen_light']:.2f}",
                f"{content['residuals'][content['metric']]:.3f}",
                f"{content['diffuse_residual']:.3f}",
                len(content["minima"]),
                len(content["notes"]) or "",
                "kept" if outcome.was_there else f"{content['seconds']:.1f} s",
            ]
            for outcome, content in fitted
        ]
        results.table(["material", "CIEDE2000", "residual", "diffuse", "minima", "notes", "time"], rows)
        if any(content["notes"] for _, content in fitted):
            results.text(
                "The JSON of a fit contains its notes; they are printed when a single material is fitted.\n"
            )


def _rows(content: dict[str, Any]) -> dict[str, object]:
    from manifold.fitting.fit_metrics import BallDifference
    from manifold.fitting.identifiability import ParameterIdentifiability

    rows: dict[str, object] = {}
    for statement in content["statements"]:
        rows[statement["name"]] = str(ParameterIdentifiability(**statement))
    if content["ball"] is not None:
        rows["CIEDE2000 on the ball"] = str(BallDifference(**content["ball"]))
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
