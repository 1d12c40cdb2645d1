"""Terminal output of all commands: progress bars, and results as text and as JSON."""

from __future__ import annotations

import json
import os
import sys
import textwrap
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from rich.cells import cell_len
from rich.console import Console
from rich.progress import (
    BarColumn,
    DownloadColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
)

from manifold import __version__
from manifold.system import atomic, stages

from . import outputs

warned: list[str] = []
"""Warnings of this package since the command began, which its JSON repeats."""

_WIDTH = 80  # columns that sentences and lists are broken to; a line with a single long word may be longer


@contextmanager
def progress(title: str, *, in_bytes: bool = False) -> Iterator[stages.Progress | None]:
    """A progress bar on stderr, or None where stderr is no terminal; or lines for the program that asked for them."""
    listening = os.environ.get(stages.PROGRESS_VARIABLE, "")
    if listening.isdecimal() and len(listening) < 6:
        yield _json_lines_to(int(listening))
        return
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
            bar.update(task, completed=done, total=total, what=printable(what))

        yield step


def _json_lines_to(descriptor: int) -> stages.Progress:
    """Steps as JSON lines into an open file; nothing once the reader is gone."""

    def step(done: int, total: int, what: str) -> None:
        with suppress(OSError):
            os.write(descriptor, f"{json.dumps([done, total, what])}\n".encode())

    return step


class Results:
    """What a command prints on stdout: text for people and, where asked, a JSON file; for `-`, JSON alone."""

    def __init__(self, json_target: Path | None = None) -> None:
        """Refuse a JSON file that cannot be written, before any work.

        Raises:
            UsageError: its folder is missing or not writable, or it is a folder itself.
        """
        self._target = json_target
        self._only_json = json_target is not None and str(json_target) == "-"
        if json_target is not None and not self._only_json:
            atomic.require_writable(json_target)

    def text(self, text: str) -> None:
        """Print lines as they are."""
        if not self._only_json:
            sys.stdout.write(printable(text))

    def sentence(self, text: str) -> None:
        """Print a text as a paragraph, whose lines but the first are indented."""
        self.text(_filled(text, "", "  ") + "\n")

    def title(self, title: str) -> None:
        """Print a line, bold on a terminal."""
        if not self._only_json:
            Console(highlight=False, soft_wrap=True).print(printable(title), style="bold", markup=False)

    def rows(self, title: str, rows: Mapping[str, object]) -> None:
        """Print a title, then one aligned line per label and value; sentences and lists are broken into lines."""
        self.title(title)
        width = max((len(label) for label in rows), default=0)
        for label, value in rows.items():
            self.text(_row(f"  {label:<{width}}  ", value) + "\n")

    def table(self, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
        """Print a table, never cut: numbers to the right, words to the left; nothing where there are no rows."""
        if not rows:
            return
        cells = [[str(cell) for cell in row] for row in rows]
        widths = [max(map(cell_len, column)) for column in zip(columns, *cells, strict=True)]
        is_numeric = [all(map(is_number, column)) for column in zip(*cells, strict=True)]

        def line(row: Sequence[str]) -> str:
            padded = []
            for cell, width, number in zip(row, widths, is_numeric, strict=True):
                blanks = " " * (width - cell_len(cell))  # characters of East Asia take two columns each
                padded.append(blanks + cell if number else cell + blanks)
            return "  ".join(padded).rstrip()

        self.title(line(columns))
        self.text("".join(f"{line(row)}\n" for row in cells))

    def document(self, document: Mapping[str, Any]) -> None:
        """Write the results as JSON where they were asked for.

        Raises:
            UsageError: the file cannot be written.
        """
        if self._target is None:
            return
        document = {"program": f"manifold {__version__}", **document, "warnings": list(warned)}
        text = json.dumps(document, indent=2, allow_nan=False) + "\n"
        if self._only_json:
            sys.stdout.write(text)
        else:
            outputs.require_unused(self._target)
            atomic.write_text(self._target, text)


def printable(text: str) -> str:
    """A text as it can be shown: control characters, which terminals obey, and bytes that are no text as escapes."""
    return "".join(
        c if c.isprintable() or c == "\n" or unicodedata.category(c) == "Zs" else ascii(c)[1:-1] for c in text
    )


def _row(head: str, value: object) -> str:
    """A label and its value, whose lines begin below each other; paths stay whole, whatever their length.

    The items of a list follow each other, sentences of a tuple begin on lines of their own.
    """
    if isinstance(value, tuple):
        return "\n".join(_row(" " * len(head) if k else head, item) for k, item in enumerate(value))
    if isinstance(value, Path):
        return f"{head}{value}"
    if isinstance(value, list):
        # Lines break between items only, unless an item is longer than a line.
        room = _WIDTH - len(head)
        items = [text if len(text) > room else text.replace(" ", "\0") for text in map(str, value)]
        return _filled(", ".join(items), head, " " * len(head)).replace("\0", " ")
    text = f"{head}{value}"
    return text if len(text) <= _WIDTH else _filled(str(value), head, " " * len(head))


def _filled(text: str, first: str, others: str) -> str:
    """Lines of at most `_WIDTH` columns, broken at blanks, with what they begin with."""
    return textwrap.fill(
        text, _WIDTH, initial_indent=first, subsequent_indent=others,
        break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip


def is_number(text: str) -> bool:
    """Whether a text is one number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def first_three(words: Sequence[str], between: str = "; ") -> str:
    """The first three of what may be many, and how many more."""
    more = [f"and {len(words) - 3} more (--json lists them)"] if words[3:] else []
    return between.join([*words[:3], *more])


def parameter_rows(parameters: Mapping[str, Any]) -> dict[str, object]:
    """Rows of `Results.rows` for parameters, which are numbers or colours."""
    return {
        key: ", ".join(f"{v:.4g}" for v in value) if isinstance(value, list) else f"{value:.4g}"
        for key, value in parameters.items()
    }


def numbered(label: str, values: Sequence[object]) -> dict[str, object]:
    """Rows of `Results.rows` for several values of one label: the second is labelled `label 2`."""
    return {label if k == 1 else f"{label} {k}": value for k, value in enumerate(values, start=1)}


def megabytes(size: int) -> str:
    """A size in bytes for people."""
    return f"{size / 1e6:.1f} MB" if size >= 1e5 else f"{size / 1e3:.1f} kB"
