"""Text files of instruments: decoding, lines, separators and strict numbers."""

from __future__ import annotations

import codecs
import os
import re
import stat
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from manifold.errors import FileFormatError, UsageError
from manifold.formats.tensor_file import printable
from manifold.records import Array

_LONGEST_FINDING = 400  # letters
LARGEST_TEXT = 150_000_000
"""Bytes of the longest text file that is read: a goniometer's are a hundred times shorter."""

_BOMS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_MINUS = str.maketrans(
    {"\u2212": "-", "\u2013": "-", "\u2010": "-", "\u2011": "-", "\u00a0": " ", "\u202f": " "}
)
_GROUPED = re.compile(r"[+-]?\d{1,3}([ .,'\u2019]\d{3})+([.,]\d+)?")  # by thousands
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eEdD][+-]?\d+)?")


def read_bytes(path: Path, limit: int = LARGEST_TEXT) -> bytes:
    """The whole file.

    Raises:
        UsageError: it is missing, not a regular file, or cannot be read.
        FileFormatError: it is longer than `limit` bytes.
    """
    try:
        status = os.stat(path)
        if not stat.S_ISREG(status.st_mode):
            raise UsageError(f"{path}: is not a regular file; name a file")
        if status.st_size > limit:
            raise FileFormatError(
                f"{path.name}: has {status.st_size / 1e6:.0f} MB, expected at most {limit / 1e6:.0f}; "
                "give an instrument's file"
            )
        return path.read_bytes()
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror}); check the path") from error


def decode(data: bytes) -> str:
    """Text of a file: by its byte order mark, else UTF-8, else Latin-1; lines end with \\n.

    Minus signs and spaces of typesetters are plain; the mark that ends files of DOS is left out.
    """
    text = _decoded(data).translate(_MINUS).replace("\r\n", "\n").replace("\r", "\n")
    return text.rstrip("\x1a")


def _decoded(data: bytes) -> str:
    for mark, encoding in _BOMS:
        if data.startswith(mark):
            return data.decode(encoding, "replace")
    if b"\0" in data[:400]:  # UTF-16 without a mark
        return data.decode("utf-16-le" if data[1:2] == b"\0" else "utf-16-be", "replace")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def read_lines(path: Path) -> list[str]:
    """The lines of a text file, however they end. Raises: as `read_bytes`."""
    return decode(read_bytes(path)).split("\n")


class Place:
    """Where in a file one reads: errors name file, line and cell."""

    def __init__(self, path: Path, remedy: str) -> None:
        """Remember the file and what to do about its errors."""
        self.path, self.remedy = path, remedy

    def error(self, found: str, where: str | None = None) -> FileFormatError:
        """An error of one line: `FILE, WHERE: FOUND; REMEDY`."""
        place = printable(self.path.name or str(self.path), 255) + (f", {where}" if where else "")
        return FileFormatError(f"{place}: {printable(found, _LONGEST_FINDING)}; {self.remedy}")

    def number(self, text: str, where: str) -> float:
        """A finite number, with a decimal point or comma, or an error that names its place."""
        value = number(text)
        if value is None:
            expected = "a finite number"
            if _GROUPED.fullmatch(text.strip()):
                expected += " without thousands separators"
            raise self.error(f"found '{printable(text.strip(), 24)}', expected {expected}", where)
        return value

    def numbers(self, cells: list[str], line: int) -> list[float]:
        """`number` of every cell of a line, counted from 1."""
        values = [plain_float(cell) for cell in cells]
        if not all(abs(value) < 1e300 for value in values):
            return [self.number(cell, f"line {line}, cell {k}") for k, cell in enumerate(cells, start=1)]
        return values

    def table(self, lines: Sequence[tuple[int, str]], separator: str | None, width: int) -> Array:
        """The numbers of lines of `width` cells, each line with its number in the file; shape (lines, cells)."""
        table = np.empty((len(lines), width))
        for row, (line_number, line) in zip(table, lines, strict=True):
            cells = split_cells(line, separator)
            if len(cells) != width:
                raise self.error(f"{len(cells)} cells, expected {width}", f"line {line_number}")
            row[:] = self.numbers(cells, line_number)
        return table

    def count(self, text: str, where: str, largest: int) -> int:
        """A whole number from 1 to `largest`."""
        value = number(text)
        if value is None or value != int(value) or not 1 <= value <= largest:
            raise self.error(
                f"found a count of '{printable(text.strip(), 24)}', expected a whole number from 1 to {largest}",
                where,
            )
        return int(value)


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
    """What separates the cells of a table's lines: `;`, tab, `|`, comma, or None for blanks.

    A comma is a separator only where nothing else is: between digits it may be a decimal comma.
    """
    for separator in (";", "\t", "|"):
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
