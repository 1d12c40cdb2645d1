"""The command chart."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from manifold import progress
from manifold.errors import UsageError

from . import options, terminal
from .application import app
from .worker_options import ONE, OneWorkerOptions

if TYPE_CHECKING:
    from manifold.evaluate.chart import Chart

_LETTERS = {"predict": "P", "bytes": "B", "fit": "F"}


@app.command(
    "chart",
    short_help="Speed against accuracy of many settings on one library.",
    epilog="Example: manifold chart --library library.zarr -o chart.png --json chart.json",
)
def chart(
    library: Annotated[
        Path | None,
        typer.Option(
            "--library",
            "-L",
            help="Library of materials; by default library.zarr, or the model's.",
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
            help="A setting's key, or a method's with --readings; may be repeated.",
            metavar="KEY",
        ),
    ] = None,
    output: Annotated[Path | None, options.output_option("A picture: .png, .pdf or .svg.")] = None,
    readings: Annotated[
        bool,
        typer.Option(
            "--readings",
            help="Instead: errors of completions against the number of readings (takes minutes; with --only one of "
            "completion, ridge, ridge_same, nearest, principled: less).",
        ),
    ] = False,
    workers: OneWorkerOptions = ONE,
    json: options.JsonOption = None,
) -> None:
    """Cross-validate many settings in ten folds: error against time to predict, bytes, and time to fit.

    Takes minutes (51 materials in 195 bands: ten). When it is interrupted, the library keeps what is done, and the
    same command continues.

    Times are relative to one evaluation of a synthetic material in the same run. P, B, F: on the Pareto front of
    an error against time to predict, bytes, or time to fit. Fits to the evaluated materials themselves are on no
    front. With --readings it runs in this process.
    """
    from manifold.evaluate.chart import make_chart
    from manifold.library.store import Library
    from manifold.model.manifold import Manifold
    from manifold.plots import figures

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


def _write_chart(made: Chart, results: terminal.Results, output: Path | None) -> None:
    from manifold.evaluate import chart_figure
    from manifold.evaluate.chart import conclusion
    from manifold.plots import figures

    if said := conclusion(made):
        results.sentence(said)
    columns = "setting,CIEDE2000,front,cube root,front,linear,front,ITP,RMSE,predict,MB,fit"
    results.table(columns.split(","), _rows(made))
    results.text(
        "front: Pareto-optimal against P time to predict, B bytes, F time to fit.\n"
        f"predict, fit: in times of a reference, here {1e3 * made.reference_seconds:.3g} ms of a core; "
        f"each material left out once, in {made.folds} folds.\n"
    )
    for row in made.rows:
        if row.warnings:
            results.sentence(
                f"{row.title}: {len(row.warnings)} of {made.folds} fits warned: {row.warnings[0]}"
            )
    for key, reason in made.skipped.items():
        results.sentence(f"{key} was skipped: {reason}")
    results.document(made.to_json())
    if output is not None:
        figures.save(chart_figure.chart(made), output)


def _rows(made: Chart) -> list[list[str]]:
    def letters(error: str, key: str) -> str:
        return "".join(_LETTERS[cost] for cost, keys in made.fronts[error].items() if key in keys)

    return [
        [
            row.title,
            f"{row.median.ball:.2f}", letters("ball", row.key),
            f"{row.median.cube_root:.3f}", letters("cube_root", row.key),
            f"{row.median.linear:.3f}", letters("linear", row.key),
            f"{row.median.ball_itp:.2f}", f"{row.median.rmse:.3g}", f"{row.predict.median:.3g}",
            f"{row.bytes / 1e6:.3g}", "" if row.fit is None else f"{row.fit.median:.3g}",
        ]
        for row in made.rows
    ]  # fmt: skip


def _chart_readings(
    results: terminal.Results, library: Path, only: Sequence[str], output: Path | None
) -> None:
    from manifold.estimate.atoms import LibraryAtoms
    from manifold.evaluate import chart_figure
    from manifold.evaluate.readings import measure_curves
    from manifold.library.store import Library
    from manifold.plots import figures

    opened = Library.open(library)
    with progress.shown("Chart"):
        curves = measure_curves(LibraryAtoms.of_library(opened), only=only, library=opened)
    results.text("Errors of left-out materials, median / 90th percentile:\n")
    results.table(
        ["method", "readings", "ball CIEDE2000", "cube root", "linear"],
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
