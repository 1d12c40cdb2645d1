"""The command stability."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from manifold import progress

from . import options, terminal
from .application import app
from .outputs import written
from .worker_options import ONE, OneWorkerOptions


@app.command(
    "stability",
    short_help="Test known failure modes, and whether they are detected.",
    epilog="Example: manifold stability --only duplicates --picture stability.png",
)
def stability(
    only: Annotated[
        list[str] | None, typer.Option(help="A failure mode's name; may be repeated.", metavar="NAME")
    ] = None,
    picture: Annotated[
        Path | None,
        written("--picture", "-o", help="Plot error against severity into this file.", metavar="FILE.png"),
    ] = None,
    workers: OneWorkerOptions = ONE,
    json: options.JsonOption = None,
) -> None:
    """Run a catalogue of failure modes on synthetic plastics with known ground truth (takes minutes).

    Undetected: the largest error without a warning or an error message; above its limit the result is silently
    wrong. A false alarm is a warning or a refusal for harmless inputs. Both are defects of this program; those that are
    not known make the exit status 1. Outcomes are listed in order of severity.
    """
    from manifold.evaluate.stability import conclusions, stability_figure
    from manifold.evaluate.stability.catalogue import MODES
    from manifold.evaluate.stability.trials import run_modes, select_modes
    from manifold.plots import figures

    results = terminal.Results(json)
    modes = select_modes(MODES, only or ())
    if picture is not None:
        figures.require_writable(picture)
    with progress.shown("Failure modes"), workers.executor() as executor:
        made = run_modes(modes, executor)
    if picture is not None:
        figures.save(stability_figure.panels(made, modes), picture)
    results.sentence(conclusions.conclusion(made))
    results.table(conclusions.COLUMNS, conclusions.table(made))
    results.text(conclusions.summary(made) + "\n")
    for what, reason in made.skipped.items():
        results.sentence(f"{what} was skipped: {reason}")
    results.document(made.to_json(modes))
    known = {(mode.key, method) for mode in modes for method in mode.known}
    for row in made.wrong:
        if (row.mode, row.method) in known:
            results.sentence(f"known: {row.method} is wrong without a message in {row.mode}")
    if made.false_alarms or any((row.mode, row.method) not in known for row in made.wrong):
        raise typer.Exit(1)
