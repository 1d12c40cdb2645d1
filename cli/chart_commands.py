"""The command chart."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from . import terminal
from .library_commands import JsonOption


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command(
        "chart",
        short_help="Speed against accuracy of many settings on one library.",
        epilog="Example: manifold chart --library library.zarr --json chart.json",
    )(chart)


def chart(
    library: Annotated[Path, typer.Option(help="Library of materials.", metavar="DIR")] = Path(
        "library.zarr"
    ),
    only: Annotated[
        list[str] | None, typer.Option(help="A setting's key; may be repeated.", metavar="KEY")
    ] = None,
    json: JsonOption = None,
) -> None:
    """Leave materials out in ten folds with every setting: error beside time to fit, time to predict, and bytes.

    Times are in those of one evaluation of a material at the same direction pairs. P, B, F: on the Pareto front of
    error against time to predict, bytes, or time to fit.
    """
    from manifold.brdf import MeasuredBRDF
    from manifold.chart import make_chart
    from manifold.store import Library

    results = terminal.Results(json)
    opened = Library.open(library)
    with terminal.progress("Chart") as step:
        made = make_chart([MeasuredBRDF(opened.read(name)) for name in opened.names], only or (), step)
    rows = [
        [
            r.title,
            f"{r.relative_error:.3f}",
            f"{r.fit_ratio:.2g}",
            f"{r.predict_ratio:.2g}",
            f"{r.bytes / 1e6:.3g}",
            "".join(axis[0].upper() for axis in r.on_front),
        ]
        for r in made.charted
    ]
    results.table(["setting", "error", "fit", "predict", "MB", "front"], rows)
    results.document(made.to_json())
