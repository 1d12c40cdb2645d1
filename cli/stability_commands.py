"""The command stability."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from . import options, terminal
from .application import app


@app.command(
    "stability",
    short_help="Where methods fail, and whether they say so.",
    epilog="Example: manifold stability --only duplicates --picture stability.png",
)
def stability(
    only: Annotated[
        list[str] | None, typer.Option(help="A failure mode's name; may be repeated.", metavar="NAME")
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option("--picture", "-o", help="Draw error against severity here.", metavar="FILE.png"),
    ] = None,
    markdown: Annotated[
        Path | None, typer.Option(help="Write what happened and what to do here.", metavar="FILE.md")
    ] = None,
    json: options.JsonOption = None,
) -> None:
    """Try a catalogue of failure modes on built-in plastics whose truth is known: minutes in all.

    Undetected: the largest error about which nothing was said; above its limit it is silently wrong. A false alarm is a
    warning or a refusal where the inputs are harmless. Both are defects of this program: then the exit status is 1.
    Fine, warned and refused are in order of severity.
    """
    from manifold.experiments.stability import advice_page
    from manifold.experiments.stability.catalogue import MODES
    from manifold.workflows import failures

    results = terminal.Results(json)
    with terminal.progress("Failure modes") as step:
        made = failures.stability(only or (), picture, markdown, step)
    results.table(advice_page.COLUMNS, advice_page.table(made))
    results.text(advice_page.summary(made) + "\n")
    results.document(made.to_json(MODES))
    if made.wrong or made.false_alarms:
        raise typer.Exit(1)
