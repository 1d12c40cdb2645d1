"""Text files of instruments: decoding, lines, separators and strict numbers."""

from __future__ import annotations

import re
from pathlib import Path

from manifold.system import reading

LARGEST_TEXT = 150_000_000
"""Bytes of the longest text file that is read: a goniometer's are a hundred times shorter."""

_MINUS = str.maketrans(
    {"\u2212": "-", "\u2013": "-", "\u2010": "-", "\u2011": "-", "\u00a0": " ", "\u202f": " "}
)
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eEdD][+-]?\d+)?")


def read_bytes(path: Path, most: int = LARGEST_TEXT) -> bytes:
    """The whole file.

    Raises:
        UsageError: it is missing, not a regular file, longer than `most` bytes, or cannot be read.
    """
    return reading.read_bytes(path, advice="check the path", most=most)


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
    """The lines of a text file, however they end. Raises: as `read_bytes`."""
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
