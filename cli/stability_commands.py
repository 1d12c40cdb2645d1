"""The command stability."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from . import options, terminal
from .application import app


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
        typer.Option(
            "--picture", "-o", help="Plot error against severity into this file.", metavar="FILE.png"
        ),
    ] = None,
    markdown: Annotated[
        Path | None, typer.Option(help="Write the results and advice into this file.", metavar="FILE.md")
    ] = None,
    json: options.JsonOption = None,
) -> None:
    """Run a catalogue of failure modes on synthetic plastics with known ground truth (takes minutes).

    Undetected: the largest error without a warning or an error message; above its limit the result is silently
    wrong. A false alarm is a warning or a refusal for harmless inputs. Both are defects of this program and make
    the exit status 1. Outcomes are listed in order of severity.
    """
    from manifold.experiments.stability import advice_page
    from manifold.experiments.stability.catalogue import MODES
    from manifold.experiments.stability.trials import run_modes, select_modes
    from manifold.plots import figures, plot_stability
    from manifold.system import atomic

    results = terminal.Results(json)
    modes = select_modes(MODES, only or ())
    if picture is not None:
        figures.require_writable(picture)
    if markdown is not None:
        atomic.require_writable(markdown)
    with terminal.progress("Failure modes") as step:
        made = run_modes(modes, step)
    if picture is not None:
        figures.save(plot_stability.panels(made, modes), picture)
    if markdown is not None:
        link = None if picture is None else os.path.relpath(picture, markdown.parent).replace(os.sep, "/")
        atomic.write_text(markdown, advice_page.markdown(made, modes, link))
    results.sentence(advice_page.conclusion(made))
    results.table(advice_page.COLUMNS, advice_page.table(made))
    results.text(advice_page.summary(made) + "\n")
    for what, reason in made.skipped.items():
        results.sentence(f"{what} was skipped: {reason}")
    results.document(made.to_json(modes))
    if made.wrong or made.false_alarms:
        raise typer.Exit(1)
