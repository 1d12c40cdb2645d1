"""Errors about the content of files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from manifold.errors import FileFormatError
from manifold.formats.text import number, plain_float, split_cells
from manifold.records import Array
from manifold.system.names import printable

_LONGEST_FINDING = 400  # letters
MOST_ROWS = 5_000_000
"""Of a table."""


class ErrorContext:
    """Errors of one short line that name a file and the place in it; and numbers that are read with such errors."""

    def __init__(self, path: Path, remedy: str) -> None:
        """Errors of a file; the remedy is what to do where an error names no other."""
        self.path, self.remedy = path, remedy

    def error(
        self, found: str, where: str | None = None, *, field: str | None = None, remedy: str | None = None
    ) -> FileFormatError:
        """The error `FILE, WHERE: FOUND; REMEDY`, or `FILE: field 'FIELD' FOUND; REMEDY`."""
        name = printable(self.path.name or str(self.path), 255) + (f", {where}" if where else "")
        found = found if field is None else f"field '{printable(field, 64)}' {found}"
        return FileFormatError(f"{name}: {printable(found, _LONGEST_FINDING)}; {remedy or self.remedy}")

    def number(self, text: str, where: str) -> float:
        """A finite number, with a decimal point or comma, or an error that names its context."""
        value = number(text)
        if value is None:
            raise self.error(f"found '{printable(text.strip(), 24)}', expected a finite number", where)
        return value

    def numbers(self, cells: list[str], line: int) -> list[float]:
        """`number` of every cell of a line, counted from 1."""
        values = [plain_float(cell) for cell in cells]
        if not all(abs(value) < 1e300 for value in values):
            return [self.number(cell, f"line {line}, cell {k}") for k, cell in enumerate(cells, start=1)]
        return values

    def table(self, lines: Sequence[tuple[int, str]], separator: str | None, width: int) -> Array:
        """The numbers of lines of `width` cells, each line with its number in the file; shape (lines, cells)."""
        self.require_rows(lines)
        table = np.empty((len(lines), width))
        for row, (line_number, line) in zip(table, lines, strict=True):
            cells = split_cells(line, separator)
            if len(cells) != width:
                raise self.error(f"{len(cells)} cells, expected {width}", f"line {line_number}")
            row[:] = self.numbers(cells, line_number)
        return table

    def require_rows(self, lines: Sequence[tuple[int, str]]) -> None:
        """Raise FileFormatError where there is no line, or more than tables have."""
        if not 1 <= len(lines) <= MOST_ROWS:
            raise self.error(f"{len(lines)} rows, expected 1 to {MOST_ROWS}")

    def count(self, text: str, where: str, largest: int) -> int:
        """A whole number from 1 to `largest`."""
        value = number(text)
        if value is None or value != int(value) or not 1 <= value <= largest:
            raise self.error(
                f"found a count of '{printable(text.strip(), 24)}', expected a whole number from 1 to {largest}",
                where,
            )
        return int(value)
