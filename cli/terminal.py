"""What all commands share on the terminal: progress, tables, JSON, and how errors end."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    DownloadColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
)
from rich.table import Table

from manifold import atomic

Step = Callable[[int, int, str], None]
"""Called by long work with (done, total, what)."""

_PIPE_WIDTH = 200  # columns where stdout is no terminal: a table must not be cut for a screen nobody has


def stdout() -> Console:
    """The console for results."""
    return Console(width=None if sys.stdout.isatty() else _PIPE_WIDTH, highlight=False, soft_wrap=True)


@contextmanager
def progress(title: str, *, in_bytes: bool = False) -> Iterator[Step | None]:
    """A progress bar on stderr, or None where stderr is no terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        DownloadColumn() if in_bytes else MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[what]}"),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=None, what="")

        def step(done: int, total: int, what: str) -> None:
            bar.update(task, completed=done, total=total, what=what)

        yield step


def show_rows(title: str, rows: Mapping[str, object]) -> None:
    """Print a title, then one aligned line per label and value."""
    console = stdout()
    console.print(f"[bold]{title}[/bold]")
    width = max((len(label) for label in rows), default=0)
    for label, value in rows.items():
        console.print(f"  {label:<{width}}  {value}", markup=False)


def show_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table; every column but the first is right-aligned."""
    table = Table(title=title, title_justify="left", box=None, pad_edge=False, header_style="bold")
    for index, column in enumerate(columns):
        table.add_column(column, justify="left" if index == 0 else "right", no_wrap=True)
    for row in rows:
        table.add_row(*(str(value) for value in row))
    stdout().print(table)


def write_json(target: Path | None, document: Mapping[str, Any]) -> None:
    """Write a document as JSON to a file, atomically, or to stdout for `-`; nothing for None.

    Raises:
        UsageError: the file cannot be written.
    """
    if target is None:
        return
    text = json.dumps(document, indent=2, allow_nan=False) + "\n"
    if str(target) == "-":
        sys.stdout.write(text)
        return
    atomic.write_text(target, text)


def megabytes(size: int) -> str:
    """A size in bytes for people."""
    return f"{size / 1e6:.1f} MB"
