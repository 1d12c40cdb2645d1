"""The commands report and demo."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from manifold import progress

from . import options, terminal
from .application import app
from .model_commands import show_prediction
from .outputs import written
from .worker_options import ONE, OneWorkerOptions

Grid = Literal["default", "hikichi"]


@app.command(
    "report",
    short_help="Evaluate a model.",
    epilog="Example: manifold report --json report.json --picture map.png",
)
def report(
    model: options.ModelOption = options.DEFAULT_MODEL,
    library: options.MovedLibraryOption = None,
    grid: Annotated[
        Grid,
        typer.Option(help="12,420 direction pairs, or the 1,458,000 of Hikichi & Iwasaki, eq. 22 (minutes)."),
    ] = "default",
    json: options.JsonOption = None,
    compare: Annotated[
        bool,
        typer.Option(
            "--compare",
            help="Also refit the Gaussian-process models without each material (minutes for 195 bands).",
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
        Path | None,
        written("--picture", help="Also draw the map of the latents.", metavar="FILE.png"),
    ] = None,
    workers: OneWorkerOptions = ONE,
) -> None:
    """Evaluate a model: reconstruction, leave-one-out against baselines, plausibility, times.

    --workers and --scheduler share out the models that are fitted without each material.
    """
    from manifold.evaluate.report import make_report
    from manifold.evaluate.report_text import format_report

    results = terminal.Results(json)
    with progress.shown("Evaluating"), workers.executor() as executor:
        made = make_report(
            model, grid, library=library, compare=compare, all_bands=all_bands, principled=principled,
            picture=picture, workers=executor,
        )  # fmt: skip
    results.text(format_report(made))
    results.document(made.to_json())


@app.command(
    "demo", short_help="Run everything on the built-in corpus.", epilog="Example: manifold demo demo"
)
def demo(
    folder: Annotated[
        Path, typer.Argument(help="Where to put everything; made if missing.", metavar="FOLDER")
    ] = Path("demo"),
) -> None:
    """Run everything on the built-in synthetic corpus: files, library, model, prediction, pictures, fit, report.

    Takes about four minutes on two cores. FOLDER/index.html shows what was made, and what to do next.
    """
    from manifold import demo
    from manifold.evaluate.report_text import format_report

    results = terminal.Results()
    result = demo.run(folder)
    show_prediction(results, result.predicted)
    results.text(f"\n{format_report(result.report)}\n")
    results.text(f"Open {folder / 'index.html'} in a browser.\n\n")
    results.rows(
        f"Written to {folder}",
        {what: [path.name for path in paths] or "none" for what, paths in result.files.items()}
        | ({"left out": result.left_out} if result.left_out else {}),
    )
