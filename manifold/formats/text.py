"""Text files of instruments: decoding, lines, separators and strict numbers."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from manifold import disk
from manifold.errors import FileFormatError
from manifold.names import printable
from manifold.records import Array

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


LARGEST_TEXT = 150_000_000
"""Bytes of the longest text file that is read: a goniometer's are a hundred times shorter."""

_MINUS = str.maketrans(
    {"\u2212": "-", "\u2013": "-", "\u2010": "-", "\u2011": "-", "\u00a0": " ", "\u202f": " "}
)
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eEdD][+-]?\d+)?")


def read_bytes(path: Path, most: int = LARGEST_TEXT) -> bytes:
    """The whole file."""
    return disk.read_bytes(path, advice="check the path", most=most)


def decode(data: bytes) -> str:
    """Text of a file in UTF-8, else Latin-1; lines end with \\n, whatever they end with in the file.

    Minus signs and spaces of typesetters are plain; the mark that ends files of DOS is left out.
    """
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    return text.translate(_MINUS).replace("\r\n", "\n").replace("\r", "\n").rstrip("\x1a")


def read_lines(path: Path) -> list[str]:
    """The lines of a text file, however they end."""
    return decode(read_bytes(path)).split("\n")


def data_lines(
    lines: list[str], first: int = 1, marks: tuple[str, ...] = ("#", "!")
) -> list[tuple[int, str]]:
    """Lines that are neither empty nor comments, each with its number in the file; the first line's is `first`."""
    return [
        (k, line)
        for k, line in enumerate(lines, start=first)
        if line.strip() and not line.lstrip().startswith(marks)
    ]


def plain_float(text: str) -> float:
    """What Python takes the text for, or NaN: quicker than `number`, which decides where this is no finite number."""
    try:
        return float("nan") if "_" in text else float(text)
    except ValueError:
        return float("nan")


def number(text: str) -> float | None:
    """The finite number that a text is, or None; Fortran's exponent D and a decimal comma are accepted."""
    text = text.strip().strip('"').strip()
    if _NUMBER.fullmatch(text) is None:
        return None
    value = float(text.replace(",", ".").replace("d", "e").replace("D", "e"))
    return value if abs(value) < 1e300 else None


def split_cells(line: str, separator: str | None) -> list[str]:
    """Cells of a line without quotes; runs of blanks separate where `separator` is None."""
    if separator is None:
        return line.replace('"', " ").split()
    cells = [cell.strip().strip('"').strip() for cell in line.split(separator)]
    while cells and not cells[-1]:  # trailing separators
        cells.pop()
    return cells


def find_separator(lines: list[str]) -> str | None:
    """What separates the cells of a table's lines: `;`, tab, comma, or None for blanks.

    A comma is a separator only where nothing else is: between digits it may be a decimal comma.
    """
    for separator in (";", "\t"):
        counts = [line.count(separator) for line in lines]
        if counts and min(counts) >= 1:
            return separator
    counts = [line.count(",") for line in lines]
    if counts and min(counts) >= 1:
        # Decimal commas between blanks: every cell is a number with at most one comma.
        if all(len(line.split()) > 1 and all(number(c) is not None for c in line.split()) for line in lines):
            return None
        return ","
    return None
