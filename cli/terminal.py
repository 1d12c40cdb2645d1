"""Terminal output of all commands: progress bars, and results as text and as JSON."""

from __future__ import annotations

import shlex
import sys
import textwrap
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import typer

from manifold import __version__
from manifold.core import disk, shipped, text_tables
from manifold.core.names import first_few, printable
from manifold.core.progress import Progress as Listener

_is_strict = False
warned: list[str] = []
"""Warnings of this package since the command began, which its JSON repeats."""

used: dict[str, str] = {}
"""The built-in library, if the command used it, for its JSON."""

_SILENT_SECONDS = 10.0  # while a command works and stderr is no terminal
_QUICK_SECONDS = 1.0  # work that is done by then needs no line
_last_line = time.monotonic()
_last_text = ""

_SCHEMA = 1  # raised where a key of a document is renamed, removed or changes its meaning
_MOST_NOTES = 4  # of a result
_WIDTH = 80  # columns that sentences and lists are broken to; a line with a single long word may be longer


def begin(strict: bool) -> None:
    """Prepare the output of a command: forget earlier warnings, and start the timer of progress lines.

    With `strict`, warnings are errors.
    """
    global _last_line, _last_text, _is_strict
    _is_strict, _last_text = strict, ""
    _last_line = time.monotonic()
    warned.clear()
    used.clear()


def is_strict() -> bool:
    """Return whether warnings are errors in the running command."""
    return _is_strict


@contextmanager
def display(title: str, *, in_bytes: bool) -> Iterator[Listener]:
    """Show a progress bar on stderr or, if stderr is not a terminal, a line every ten seconds if it has changed."""
    if not sys.stderr.isatty():
        with _lines(title) as line:
            yield line
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        DownloadColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
    )

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


@contextmanager
def _lines(title: str) -> Iterator[Listener]:
    """Print lines on stderr from a separate thread, so that long steps do not look like a command that hangs."""
    state, finished = "", threading.Event()

    def step(done: int, total: int, what: str) -> None:
        nonlocal state
        state = f": {done} of {total}" + f", {what}" * bool(what)

    def tell() -> None:
        global _last_line, _last_text
        while not finished.wait(max(_last_line + _SILENT_SECONDS - time.monotonic(), _QUICK_SECONDS)):
            _last_line, text = time.monotonic(), printable(title + state)
            if text == _last_text:
                continue
            _last_text = text
            with suppress(OSError, ValueError):  # stderr may be closed by now
                sys.stderr.write(text + "\n")
                sys.stderr.flush()

    thread = threading.Thread(target=tell, daemon=True)
    thread.start()
    try:
        yield step
    finally:
        finished.set()
        thread.join()


class Results:
    """The output of a command on stdout: text for people and, if requested, a JSON file; for `-`, only JSON."""

    def __init__(self, json_target: Path | None = None) -> None:
        """Print for people, unless JSON goes to stdout; `outputs.check_all` refuses what cannot be written."""
        self._target = json_target
        self._only_json = json_target is not None and str(json_target) == "-"

    def text(self, text: str) -> None:
        """Print lines as they are."""
        if not self._only_json:
            sys.stdout.write(printable(text, keep="\n"))

    def sentence(self, text: str) -> None:
        """Print a text as a paragraph with a hanging indent."""
        self.text(_filled(text, "", "  ") + "\n")

    def rows(self, title: str, rows: Mapping[str, object]) -> None:
        """Print a title, then one row per label and value.

        Lists are joined by commas, and tuples printed line by line.
        """
        if self._only_json:
            return
        typer.secho(printable(title), bold=True)
        width = max(map(len, rows), default=0) + 4
        for label, value in rows.items():
            for k, item in enumerate(value if isinstance(value, tuple) else [value]):
                words = [str(each) for each in item] if isinstance(item, list) else [str(item)]
                # Items of a list that have room on a line are not broken.
                whole = [w.replace(" ", "\0") if words[1:] and len(w) < _WIDTH - width else w for w in words]
                head = f"  {label if k == 0 else ''}".ljust(width)
                self.text(_filled(", ".join(whole), head, " " * width).replace("\0", " ") + "\n")

    def table(self, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
        """Print a table in full width, with numbers aligned right and words left.

        It prints nothing if there are no rows.
        """
        if not rows or self._only_json:
            return
        cells = [[printable(str(cell)) for cell in row] for row in rows]
        sys.stdout.writelines(f"{line}\n" for line in text_tables.table_lines(columns, cells, bold=True))

    def document(self, document: object) -> None:
        """Write results, a record or a mapping, as JSON if the command has an option for it."""
        if self._target is None:
            return
        import json  # helps need none, and no arrays

        from manifold.core.records import plain

        document = {
            "program": f"manifold {__version__}", "schema": _SCHEMA, **used, **plain(document),
            "warnings": list(warned),
        }  # fmt: skip
        text = json.dumps(document, indent=2, allow_nan=False) + "\n"
        if self._only_json:
            sys.stdout.write(text)
        else:
            disk.write_text(self._target, text)


def _filled(text: str, first: str, others: str) -> str:
    """Wrap lines at blanks to at most `_WIDTH` columns, with their prefixes."""
    return textwrap.fill(
        text, _WIDTH, initial_indent=first, subsequent_indent=others,
        break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip


def first_three(words: Sequence[str]) -> str:
    """Return the first three words, and the number of the others."""
    return first_few(words, 3, "; ", " (--json lists them)")


def parameter_rows(parameters: Mapping[str, Any]) -> dict[str, object]:
    """Return rows of `Results.rows` for parameters, which are numbers or colours."""
    return {
        key: ", ".join(f"{v:.4g}" for v in value) if isinstance(value, list) else f"{value:.4g}"
        for key, value in parameters.items()
    }


def numbered(label: str, values: Sequence[object]) -> dict[str, object]:
    """Return rows of `Results.rows` for values with the same label, numbered from the second on: `label`, `label 2`."""
    return {label if k == 1 else f"{label} {k}": value for k, value in enumerate(values, start=1)}


def notes(sentences: Sequence[str]) -> dict[str, object]:
    """Return rows of `Results.rows` for the first notes on a result, and for the number of the others."""
    different = list(dict.fromkeys(sentences))
    left = len(different) - _MOST_NOTES
    others = {"more notes": f"{left} (--json lists all as diagnostics)"} if left > 0 else {}
    return numbered("note", different[:_MOST_NOTES]) | others


def export_command(path: Path) -> str:
    """Return the command that exports a material for engines."""
    return f"manifold export {shlex.quote(str(path))} -o {shlex.quote(str(path.with_suffix('.glb')))}"


def note_built_in(*, is_default: bool) -> None:
    """Name the built-in library in the JSON of the command, and on stderr if the user did not ask for it."""
    used["library"] = shipped.named(shipped.BUILT_IN)
    if is_default:
        count = len(shipped.about()["materials"])
        print(
            f"manifold: no library.zarr or model.h5 here: using the built-in library, {count} measured materials in "
            "RGB, which also serves for spectral readings",
            file=sys.stderr,
        )


def megabytes(size: int) -> str:
    """Format a size in bytes for people."""
    return f"{size / 1e6:.1f} MB" if size >= 1e5 else f"{size / 1e3:.1f} kB"
