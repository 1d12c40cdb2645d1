"""The command that fits BSDFs: fit."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from manifold.errors import FileFormatError, UsageError

from . import options, terminal
from .application import app
from .outputs import unnamed

if TYPE_CHECKING:
    from manifold.model.colours import ColourChoice
    from manifold.workflows.fits import FitOutcome


Method = Literal["gauss-newton", "adam", "swarm"]
Metric = Literal["cube-root", "linear", "log"]
TargetModel = Literal["gltf", "openpbr", "standard-surface", "usd", "blender", "unreal", "unity"]


@app.command(
    "fit",
    short_help="Fit the parameters of a BSDF, by default principled.",
    epilog="Example: manifold fit satin_gold_spec.bsdf -o satin_gold.fit.json",
)
def fit(
    sources: Annotated[
        list[Path] | None,
        typer.Argument(help=".bsdf files, files of readings, or folders of .bsdf files (searched "
        "recursively).", metavar="FILE"),
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
    metric: Annotated[Metric, typer.Option(help="Domain in which residuals are minimised.")] = "cube-root",
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
    target: Annotated[
        TargetModel | None,
        typer.Option(help="Also fit an engine's own model, for `manifold export`; takes seconds."),
    ] = None,
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

    Writes one JSON per material: parameters, residuals, all minima found, and how well the samples
    determine each parameter. Fits that are up to date are kept. With --target, the JSON also contains the
    parameters of that engine's own model, and its error on the ball; `manifold export` writes them.
    """
    from manifold.formats import registry
    from manifold.workflows import fits

    if bool(sources) == (latent is not None):
        raise UsageError("expected either files or --latent X,Y; name what to fit")
    refused = "--latent; a file has its own colour" if sources else None
    colour = options.colour_choice(like, reflectance, srgb, refused=refused)
    if latent is not None and sample is not None:
        raise UsageError("--sample is of a file of readings; leave it or --latent out")
    if picture and target is not None:
        raise UsageError("--picture draws Mitsuba's BSDF, not a target's model; leave it or --target out")
    for path in sources or () if picture else ():
        if path.is_file() and (known := registry.identify(path)) is not None:
            raise UsageError(
                f"{path}: {known.name}, which cannot be rendered; leave --picture out, or write a .bsdf with "
                f"`manifold convert` or `manifold complete`"
            )
    results = terminal.Results(json)
    settings = fits.FitSettings(
        family=fits.family_of(free, bsdf, wide_colours=wide_colours), method=method, metric=metric,
        noise=noise, wide_colours=wide_colours, sample=sample, target=target,
    )  # fmt: skip
    if latent is not None:
        with terminal.progress("Reading materials") as step:
            outcomes = [
                fits.fit_prediction(
                    model, latent, output, settings, library=library, colour=colour, on_progress=step
                )
            ]
    else:
        with terminal.progress("Fitting") as step:
            outcomes = fits.fit_files(sources or [], output, settings, jobs=jobs, on_progress=step)
    _show(results, outcomes, target)
    for outcome in outcomes:
        if outcome.diagnosis is not None:
            results.rows("Fitted to a prediction", outcome.diagnosis.rows)
    if picture:
        _draw(results, outcomes, model, library, colour)
    failed = [f"{outcome.name}: {outcome.failure}" for outcome in outcomes if outcome.failure is not None]
    predictions = [o.diagnosis.to_json() for o in outcomes if o.diagnosis is not None]
    results.document(
        {
            "fits": [o.content for o in outcomes if o.content is not None],
            "failed": failed,
            "predictions": predictions,
        }
    )
    if failed:
        raise FileFormatError(_failures(outcomes))


def _failures(outcomes: list[FitOutcome]) -> str:
    """All that went wrong, in one line; what failed alike together."""
    names: dict[str, list[str]] = {}
    for outcome in outcomes:
        if outcome.failure is not None:
            failed = names.setdefault(outcome.failure, [])
            is_named = outcome.file and outcome.failure.startswith((str(outcome.file), outcome.file.name))
            failed += [] if is_named else [outcome.name]
    said = [
        f"{terminal.first_three(failed, ', ')}: {failure}" if failed else failure
        for failure, failed in names.items()
    ]
    return terminal.first_three(said)


def _draw(
    results: terminal.Results,
    outcomes: list[FitOutcome],
    model: Path,
    library: Path | None,
    colour: ColourChoice,
) -> None:
    """A picture beside the JSON of every fit."""
    from manifold.workflows import fit_pictures

    rows = []
    with terminal.progress("Drawing") as step:
        for done, outcome in enumerate(outcomes, start=1):
            if outcome.content is None:
                continue
            target = unnamed("picture", outcome.path.with_suffix(".png"))
            if outcome.file is not None:
                made = fit_pictures.picture_of_fit(outcome.path, outcome.file, target)
            else:
                latent = outcome.content["source"]["latent"]
                made = fit_pictures.picture_of_prediction_fit(
                    outcome.path, model, latent, target, library=library, colour=colour
                )
            rows.append([made.path.name, f"{made.ciede2000:.2f}", f"{made.flip:.3f}"])
            if step is not None:
                step(done, len(outcomes), outcome.name)
    results.table(["picture", "CIEDE2000", "FLIP"], rows)


def _show(results: terminal.Results, outcomes: list[FitOutcome], target: str | None) -> None:
    """All of a single fit; one line each of several; of a target's model where there is one."""
    fitted = [(outcome, outcome.content) for outcome in outcomes if outcome.content is not None]
    if len(fitted) == 1:
        outcome, content = fitted[0]
        rows = _rows(content) if target is None else _target_rows(content["target"])
        what = "" if target is None else f" (the model of {target})"
        results.rows(f"Fitted {outcome.path}{what}" + " (up to date)" * outcome.was_there, rows)
    elif fitted and target is not None:
        table = [
            [outcome.name, *_errors(content["target"], "ciede2000"), "kept" * outcome.was_there]
            for outcome, content in fitted
        ]
        results.table(["material", "CIEDE2000", "mapped", "of principled", ""], table)
    elif fitted:
        rows = [
            [
                outcome.name,
                f"{content['residuals'][content['metric']]:.3f}",
                f"{content['diffuse_residual']:.3f}",
                len(content["minima"]),
                len(content["notes"]) or "",
                "kept" if outcome.was_there else f"{content['seconds']:.1f} s",
            ]
            for outcome, content in fitted
        ]
        results.table(["material", "residual", "diffuse", "minima", "notes", "time"], rows)
        if any(content["notes"] for _, content in fitted):
            results.text(
                "The JSON of a fit contains its notes; they are printed when a single material is fitted.\n"
            )


def _errors(entry: dict[str, Any], kind: str) -> list[str]:
    """Of a target's model: fitted, mapped from the parameters of `principled`, and of that, if known."""
    return [f"{entry[key]:.2f}" for key in (kind, f"mapped_{kind}", f"principled_{kind}") if key in entry]


def _target_rows(entry: dict[str, Any]) -> dict[str, object]:
    own, mapped, of_principled = _errors(entry, "ciede2000")
    rows = terminal.parameter_rows(entry["parameters"])
    rows["CIEDE2000 on the ball"] = f"{own}, against the {entry['against']}"
    rows["of mapped parameters"], rows["of principled"] = mapped, of_principled
    rows["relative residual"] = f"cube-root {entry['residual']:.3f}, mapped {entry['mapped_residual']:.3f}"
    return rows


def _rows(content: dict[str, Any]) -> dict[str, object]:
    rows: dict[str, object] = {}
    for statement in content["statements"]:
        about = f"{statement['value']:.3f} +- {statement['standard_error']:.3f}, {statement['state']}"
        about += ", left at its default" * statement.get("is_kept", False)
        if statement["entangled_with"] is not None:
            about += f" (correlated with {statement['entangled_with']})"
        rows[statement["name"]] = about + ", at the end of its range" * statement["at_bound"]
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
