"""Commands that evaluate: reports and charts of left-out errors, failure modes, budgets of scenes; and the demo."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from manifold.core import progress
from manifold.core.errors import UsageError

from . import options, terminal
from .application import app
from .batch_options import ONE, OneWorkerOptions
from .outputs import checked

if TYPE_CHECKING:
    from manifold.study.budget.budgets import Budget
    from manifold.study.chart import Chart

Grid = Literal["default", "hikichi"]


@app.command(
    "report",
    epilog="Example: manifold report --json report.json --picture",
)
def report(
    model: options.ModelOption = options.DEFAULT_MODEL,
    library: options.MovedLibraryOption = None,
    grid: Annotated[
        Grid,
        typer.Option(
            help="Direction pairs: 12,420, or the 1,458,000 of Hikichi & Iwasaki, eq. 22 (minutes)."
        ),
    ] = "default",
    json: options.JsonOption = None,
    compare: Annotated[
        bool,
        typer.Option(
            "--compare",
            help="Also evaluate GPLVMs, blends and reconstructions by few numbers, refitted without each material "
            "(minutes for 195 bands).",
        ),
    ] = False,
    all_bands: Annotated[
        bool, typer.Option("--all-bands", help="Measure errors in all bands, not in about 20 of them.")
    ] = False,
    principled: Annotated[
        bool,
        typer.Option(
            "--principled", help="Also fit Mitsuba's principled to the evaluated materials themselves."
        ),
    ] = False,
    picture: Annotated[
        bool, typer.Option("--picture", help="Also draw the map, into a .png named after the model.")
    ] = False,
    full: Annotated[
        bool,
        typer.Option(
            "--full",
            help="Also print errors by light and colour, plausibility, times, and each material's errors.",
        ),
    ] = False,
    workers: OneWorkerOptions = ONE,
) -> None:
    """Evaluate a model: errors of left-out materials, beside those of simpler methods, and expected errors.

    --workers and --scheduler distribute the leave-one-out fits.
    """
    from manifold.evaluate.report import make_report
    from manifold.evaluate.report_text import format_report, format_summary

    results = terminal.Results(json)
    with progress.shown("Evaluating"), workers.executor() as executor:
        made = make_report(
            model, grid, library=library, compare=compare, all_bands=all_bands, principled=principled,
            picture=checked(Path(f"{model.stem}.png"), "picture") if picture else None, workers=executor,
        )  # fmt: skip
    results.text(format_report(made) if full else format_summary(made))
    results.document(made)


@app.command(
    "demo",
    epilog="Example: manifold demo demo",
)
def demo(
    folder: Annotated[
        Path, typer.Argument(help="The folder for all files; made if missing.", metavar="FOLDER")
    ] = Path("demo"),
    everything: Annotated[
        bool,
        typer.Option(
            "--all",
            help="Also draw a second light, the fit, the map as balls and a walk, and run the chart, failure modes "
            "and budgets: about seven minutes on two cores.",
        ),
    ] = False,
) -> None:
    """Complete a measured material from 12 readings, then import, embed, evaluate, predict, render and fit.

    The second part uses 51 synthetic materials. Takes about a minute on two cores. Each result is reported as soon as
    it is ready; FOLDER/index.html shows all of them.
    """
    from manifold.cli import demo

    results = terminal.Results()

    def announce(made: demo.Made) -> None:
        results.sentence(f"{made.seconds:4.0f} s  {made.what}")
        results.text(f"        {made.look}\n")
        sys.stdout.flush()  # also through a pipe

    result = demo.run(folder, everything=everything, announce=announce)
    if result.left_out is not None:
        results.sentence(f"note: {result.left_out}")


_LETTERS = {"predict": "P", "bytes": "B", "fit": "F"}


@app.command(
    "chart",
    epilog="Example: manifold chart --library library.zarr -o chart.png --json chart.json",
)
def chart(
    library: Annotated[
        Path | None,
        typer.Option(
            "--library",
            "-L",
            help=f"Library of materials; by default {options.DEFAULT_LIBRARY}, or the model's.",
            metavar="FOLDER",
        ),
    ] = None,
    model: Annotated[
        Path | None,
        typer.Option("--model", "-M", help="A fitted model: chart its materials.", metavar="FILE"),
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(
            help="Run only this setting (with --readings, this method); may be repeated.",
            metavar="KEY",
        ),
    ] = None,
    output: Annotated[Path | None, options.output_option("A picture: .png, .pdf or .svg.")] = None,
    readings: Annotated[
        bool,
        typer.Option(
            "--readings",
            help="Chart errors of completions against the number of readings instead. Takes minutes; fewer with --only "
            "completion, ridge, ridge_same, nearest or principled (ridge_same: ridge regression at completion's "
            "directions).",
        ),
    ] = False,
    workers: OneWorkerOptions = ONE,
    json: options.JsonOption = None,
) -> None:
    """Cross-validate many settings in ten folds: error against time to predict, bytes, and time to fit.

    Takes minutes (ten for 51 materials in 195 bands). After an interruption, the same command
    continues from the finished settings, which the library keeps.

    The unit of time is one evaluation of a synthetic material at 8,192 direction pairs in 195 bands, in the same run.
    In the table, P, B and F mark settings on the Pareto front of error against time to predict, bytes, or time to fit.
    Fits to the evaluated materials themselves are not marked. With --readings, the work is not shared.
    """
    from manifold.library.store import Library
    from manifold.model.manifold import Manifold
    from manifold.pictures import figures
    from manifold.study.chart import make_chart

    results = terminal.Results(json)
    if output is not None:
        figures.require_writable(output)
    if readings:
        if model is not None:
            raise UsageError("--readings charts a library by itself; leave --model out")
        _chart_readings(results, library or options.DEFAULT_LIBRARY, only or (), output)
        return
    if model is None:
        opened = Library.open(library or options.DEFAULT_LIBRARY)
        names = opened.names
    else:
        loaded = Manifold.load(model, library)
        opened, names = loaded.library, loaded.names
    with progress.shown("Chart"), workers.executor() as executor:
        files = [opened.read(name) for name in names]
        made = make_chart(files, only or (), library=opened, workers=executor)
    _write_chart(made, results, output)


def _write_chart(chart: Chart, results: terminal.Results, output: Path | None) -> None:
    from manifold.core.judged_lights import BALL_COLUMN
    from manifold.model.coherence import NEIGHBOURS_COMPARED
    from manifold.pictures import figures
    from manifold.study import chart_figure
    from manifold.study.chart import conclusion

    if said := conclusion(chart):
        results.sentence(said)
    columns = f"setting,{BALL_COLUMN},front,cube root,front,linear,front,ITP,RMSE,detour,kept,predict,MB,fit"
    results.table(columns.split(","), _chart_rows(chart))
    results.text(
        "front: on the Pareto front against P time to predict, B bytes, F time to fit.\n"
        f"predict, fit: multiples of a reference, here {1e3 * chart.reference_seconds:.3g} ms of a core; "
        f"each material is left out once, in {chart.folds} folds.\n"
        "detour, kept: of a map of all materials. Detour halfway between the most similar ones (median; 1 lies "
        f"between them); share of the {NEIGHBOURS_COMPARED} most similar among the {NEIGHBOURS_COMPARED} nearest.\n"
    )
    for row in chart.rows:
        if row.warnings:
            results.sentence(
                f"{row.title}: {len(row.warnings)} of {chart.folds} fits warned: {row.warnings[0]}"
            )
    results.document(chart)
    if output is not None:
        figures.save(chart_figure.chart(chart), output)


def _chart_rows(chart: Chart) -> list[list[str]]:
    from manifold.core.names import percent

    def letters(error: str, key: str) -> str:
        return "".join(_LETTERS[cost] for cost, keys in chart.fronts[error].items() if key in keys)

    return [
        [
            row.title,
            f"{row.median.ball:.2f}", letters("ball", row.key),
            f"{row.median.cube_root:.3f}", letters("cube_root", row.key),
            f"{row.median.linear:.3f}", letters("linear", row.key),
            f"{row.median.ball_itp:.2f}", f"{row.median.rmse:.3g}",
            *(("", "") if (c := row.coherence) is None else (f"{c.detour:.2f}", percent(c.neighbours_kept))),
            f"{row.predict.median:.3g}", f"{row.bytes / 1e6:.3g}", "" if row.fit is None else f"{row.fit.median:.3g}",
        ]
        for row in chart.rows
    ]  # fmt: skip


def _chart_readings(
    results: terminal.Results, library: Path, only: Sequence[str], output: Path | None
) -> None:
    from manifold.core.judged_lights import BALL_COLUMN
    from manifold.estimate.atoms import LibraryAtoms
    from manifold.evaluate.readings import measure_curves
    from manifold.library.store import Library
    from manifold.pictures import figures
    from manifold.study import chart_figure

    opened = Library.open(library)
    with progress.shown("Chart"):
        curves = measure_curves(LibraryAtoms.of_library(opened), only=only, library=opened)
    results.text("Errors of left-out materials, median / 90th percentile:\n")
    results.table(
        ["method", "readings", BALL_COLUMN, "cube root", "linear"],
        [
            [
                curve.title, str(n),
                f"{median.ball:.2f} / {p90.ball:.2f}", f"{median.cube_root:.3f} / {p90.cube_root:.3f}",
                f"{median.linear:.3f} / {p90.linear:.3f}",
            ]
            for curve in curves
            for n, median, p90 in curve.summary
        ],
    )  # fmt: skip
    results.document({"curves": [curve.to_json() for curve in curves]})
    if output is not None:
        figures.save(chart_figure.readings_chart(curves), output)


@app.command(
    "stability",
    epilog="Example: manifold stability --only duplicates -o stability.png",
)
def stability(
    only: Annotated[
        list[str] | None, typer.Option(help="A failure mode's name; may be repeated.", metavar="NAME")
    ] = None,
    output: Annotated[
        Path | None, options.output_option("A picture of error against severity: .png, .pdf or .svg.")
    ] = None,
    workers: OneWorkerOptions = ONE,
    json: options.JsonOption = None,
) -> None:
    """Run a catalogue of failure modes on synthetic plastics with known ground truth (takes minutes).

    Column "undetected" is the largest error that caused no warning or error message. If it exceeds the mode's limit,
    the result is silently wrong. A false alarm is a warning or a refusal for harmless inputs. Both are defects of this
    program; new ones set the exit status to 1. For each mode, outcomes are listed by rising severity of the fault.
    """
    from manifold.pictures import figures
    from manifold.study.stability import catalogue, stability_figure
    from manifold.study.stability.catalogue import MODES
    from manifold.study.stability.trials import run_modes, select_modes

    results = terminal.Results(json)
    modes = select_modes(MODES, only or ())
    if output is not None:
        figures.require_writable(output)
    with progress.shown("Failure modes"), workers.executor() as executor:
        trials = run_modes(modes, executor)
    if output is not None:
        figures.save(stability_figure.panels(trials, modes), output)
    results.sentence(catalogue.conclusion(trials))
    results.table(catalogue.COLUMNS, catalogue.table(trials))
    results.text(catalogue.summary(trials) + "\n")
    for what, reason in trials.skipped.items():
        results.sentence(f"{what} was skipped: {reason}")
    results.document(trials.to_json(modes))
    known = {(mode.key, method) for mode in modes for method in mode.known}
    for row in trials.wrong:
        if (row.mode, row.method) in known:
            results.sentence(f"known: {row.method} is wrong without a message in {row.mode}")
    if trials.false_alarms or any((row.mode, row.method) not in known for row in trials.wrong):
        raise typer.Exit(1)


_NAME = 16  # columns of a material's name in the table; below it stands in full


@app.command(
    "budget",
    epilog="Example: manifold budget scene.xml --max-delta-e 0.5 -o lean",
)
def budget(
    scene: Annotated[
        Path | None, typer.Argument(help="Mitsuba scene, .xml or .json.", metavar="SCENE")
    ] = None,
    example: Annotated[
        str | None,
        typer.Option(
            help="Instead of a scene: {manifold.registries.EXAMPLES}.", metavar="NAME"
        ),
    ] = None,
    max_delta_e: Annotated[
        float,
        typer.Option(help="Largest CIEDE2000 in the scene's light, mean over a material's pixels.", metavar="X"),
    ] = 1.0,
    max_flip: Annotated[
        float | None, typer.Option(help="Largest mean FLIP over the pixels of a material.", metavar="X")
    ] = None,
    max_bytes: Annotated[
        int | None, typer.Option(help="Largest size of all materials together.", metavar="N")
    ] = None,
    max_ms: Annotated[
        float | None, typer.Option(help="Largest time of a million evaluations of a material.", metavar="X")
    ] = None,
    output: Annotated[
        Path | None,
        options.output_option("Folder for the files and a scene that uses them.", "DIR"),
    ] = None,
    size: Annotated[
        int, typer.Option(help="Pixels of the longer side, in the analysis.", metavar="N", min=16, max=2048)
    ] = 128,
    samples: Annotated[
        int, typer.Option(help="Samples per pixel, in the analysis.", metavar="N", min=1, max=1 << 16)
    ] = 128,
    seed: Annotated[
        int,
        typer.Option(help="Seed of the noise; equal seeds give equal pictures, up to rounding.", metavar="N", min=0),
    ] = 0,
    picture: Annotated[
        bool,
        typer.Option(
            "--picture",
            help="Also draw both renders and the cost of every representation, into FOLDER.png, or "
            "budget.png without a folder.",
        ),
    ] = False,
    json: options.JsonOption = None,
) -> None:  # fmt: skip
    """Find the cheapest representation of each measured material that preserves the rendered picture.

    Each BSDF of type measured or manifold is kept, or replaced by a parametric fit or by a version with fewer bands or
    angles. By convention a CIEDE2000 above 1 is called visible.
    """
    from manifold.study.budget import budgets
    from manifold.study.budget.search import Tolerance

    results = terminal.Results(json)
    if (scene is None) == (example is None):
        both = "" if scene is None else ", not both"
        raise UsageError(f"give a scene or --example NAME{both}")
    if output is not None and output.suffix.lower() in (".png", ".xml", ".json") and not output.is_dir():
        raise UsageError(f"{output}: named like a file, expected a folder; --picture draws the renders")
    tolerance = Tolerance(max_delta_e, max_flip, max_bytes, max_ms)
    settings = budgets.BudgetSettings(size, samples, seed)
    drawn = checked((output or Path("budget")).with_suffix(".png"), "picture") if picture else None
    with progress.shown("Budget"):
        if scene is not None:
            made = budgets.budget_scene(scene, tolerance, settings, output, drawn)
        else:
            made = budgets.example(str(example), tolerance, settings, output, drawn)
    _show_budget(results, made)


def _show_budget(results: terminal.Results, budget: Budget) -> None:
    columns = ["material", "representation", "bytes", "ms", "pred.", "verified", "FLIP"]
    rows = [
        [
            chosen.material if len(chosen.material) <= _NAME else f"{chosen.material[: _NAME - 1]}~",
            chosen.representation,
            chosen.size,
            f"{chosen.milliseconds:.0f}" if chosen.milliseconds >= 10 else f"{chosen.milliseconds:.1f}",
            f"{chosen.predicted:.2f}",
            f"{chosen.verified.delta_e:.2f}",
            f"{chosen.verified.flip:.3f}",
        ]
        for chosen in budget.materials
    ]
    results.table(columns, rows)
    for chosen in budget.materials:
        results.sentence(
            f"{chosen.material}: {chosen.lighting}; {chosen.reason}; noise {chosen.noise.rendered:.2f}, subtracted"
        )
    results.text(
        "pred., verified: predicted and verified mean CIEDE2000 in the scene's light; "
        "ms: time of a million evaluations in milliseconds\n"
    )
    results.text(f"{budget.bytes} of {budget.full_bytes} bytes, {_share(budget)} of the whole files\n")
    for note in budget.notes:
        results.sentence(f"note: {note}")
    if budget.output is not None:
        results.text(f"wrote {budget.output}\n")
    results.document(budget)


def _share(budget: Budget) -> str:
    percent = 100.0 * budget.bytes / budget.full_bytes
    return f"{percent:.0f} %" if percent >= 10.0 else f"{percent:.2g} %"
