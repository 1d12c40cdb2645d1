"""Text files of instruments: decoding, lines, separators and strict numbers."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from manifold.core import disk
from manifold.core.errors import FileFormatError
from manifold.core.names import printable
from manifold.core.records import Array

_LONGEST_FINDING = 400  # letters
CORRECT_CELL = "correct the cell"
"""Text for error messages that says what to do about one wrong value."""
MOST_ROWS = 5_000_000
"""The largest number of lines of a table."""


class ErrorContext:
    """Creates one-line errors that name a file and the place in it, and parses numbers with such errors."""

    def __init__(self, path: Path, remedy: str) -> None:
        """Take the file's path; `remedy` ends the errors that name no other remedy."""
        self.path, self.remedy = path, remedy

    def error(
        self, found: str, where: str | None = None, *, field: str | None = None, remedy: str | None = None
    ) -> FileFormatError:
        """Return the error `FILE, WHERE: FOUND; REMEDY`, or `FILE: field 'FIELD' FOUND; REMEDY`."""
        name = printable(self.path.name or str(self.path), 255) + (f", {where}" if where else "")
        found = found if field is None else f"field '{printable(field, 64)}' {found}"
        return FileFormatError(f"{name}: {printable(found, _LONGEST_FINDING)}; {remedy or self.remedy}")

    def number(self, text: str, where: str) -> float:
        """Parse a finite number, with a decimal point or comma; otherwise raise an error that names its context."""
        value = number(text)
        if value is None:
            raise self.error(
                f"found '{printable(text.strip(), 24)}', expected a finite number", where, remedy=CORRECT_CELL
            )
        return value

    def numbers(self, cells: list[str], line: int) -> list[float]:
        """Apply `number` to every cell of a line, counted from 1."""
        values = [plain_float(cell) for cell in cells]
        if not all(abs(value) < 1e300 for value in values):
            return [self.number(cell, f"line {line}, cell {k}") for k, cell in enumerate(cells, start=1)]
        return values

    def table(self, lines: Sequence[tuple[int, str]], separator: str | None, width: int) -> Array:
        """Parse pairs (line number, text) of `width` cells each; return shape (lines, width)."""
        self.require_rows(lines)
        table = np.empty((len(lines), width))
        for row, (line_number, line) in zip(table, lines, strict=True):
            cells = split_cells(line, separator)
            while len(cells) > width and not cells[-1]:  # trailing separators
                cells.pop()
            if len(cells) != width:
                raise self.error(f"{len(cells)} cells, expected {width}", f"line {line_number}")
            row[:] = self.numbers(cells, line_number)
        return table

    def require_rows(self, lines: Sequence[tuple[int, str]]) -> None:
        """Raise FileFormatError if there is no line, or more than tables have."""
        if not 1 <= len(lines) <= MOST_ROWS:
            raise self.error(f"{len(lines)} rows, expected 1 to {MOST_ROWS}")

    def count(self, text: str, where: str, largest: int) -> int:
        """Parse a whole number from 1 to `largest`."""
        value = number(text)
        if value is None or value != int(value) or not 1 <= value <= largest:
            raise self.error(
                f"found a count of '{printable(text.strip(), 24)}', expected a whole number from 1 to {largest}",
                where,
            )
        return int(value)


LARGEST_TEXT = 150_000_000
"""Size in bytes of the longest text file that is read; files of goniometers are a hundred times smaller."""

NUMBER = r"[+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eEdD][+-]?\d+)?"
"""The pattern of a number: with a decimal point or comma, and an exponent, which may be Fortran's."""

_MINUS = str.maketrans(
    {"\u2212": "-", "\u2013": "-", "\u2010": "-", "\u2011": "-", "\u00a0": " ", "\u202f": " "}
)
_NUMBER = re.compile(NUMBER)
_WITH_UNIT = re.compile(rf"({NUMBER})\s*([^\s\d].*)?", re.DOTALL)
# Of wavelengths in nm by unit; of wavenumbers, nm times the number.
_NM = {
    **dict.fromkeys(("nm", "nanometer", "nanometers", "nanometre", "nanometres"), 1.0),
    **dict.fromkeys(("um", "micron", "microns", "micrometer", "micrometers", "micrometre", "micrometres"), 1e3),
    **dict.fromkeys(("a", "\u00e5", "angstrom", "angstroms", "\u00e5ngstr\u00f6m"), 0.1),
    "m": 1e9,
}  # fmt: skip
_WAVENUMBERS = {"cm-1", "cm^-1", "1/cm", "cm\u207b\u00b9", "cm**-1", "kayser", "wavenumber", "wavenumbers"}
_MICRO = str.maketrans({"\u00b5": "u", "\u03bc": "u", "\u2212": "-", "\u212b": "\u00e5"})
_DEGREES = {"deg", "degree", "degrees", "\u00b0", "\u00ba", "d", "dg"}
_RADIANS = {"rad", "radian", "radians"}
LENGTH_UNIT = (
    r"(?:nm|nano\w+|[u\u00b5\u03bc]m|micro\w+|\u00e5|\u212b|angstroms?|a(?=\s*[)\]])|m|"
    r"cm\s?(?:\^|\*\*)?-1|1/cm|cm\u207b\u00b9)"
)
"""The pattern of a unit of wavelengths, in lower case."""


def read_bytes(path: Path, most: int = LARGEST_TEXT) -> bytes:
    """Read the whole file."""
    return disk.read_bytes(path, advice="check the path", most=most)


def decode(data: bytes) -> str:
    r"""Decode a file as UTF-8, as UTF-16 if it has a byte order mark, or else as Latin-1; lines end with \n.

    Typographic minus signs and spaces are replaced by plain ones, and the end-of-file mark of DOS is removed.
    """
    is_utf16 = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))  # as spreadsheets write it
    try:
        text = data.decode("utf-16", "replace") if is_utf16 else data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    return text.translate(_MINUS).replace("\r\n", "\n").replace("\r", "\n").rstrip("\x1a")


def read_lines(path: Path) -> list[str]:
    """Read the lines of a text file, with any line end."""
    return decode(read_bytes(path)).split("\n")


def data_lines(
    lines: list[str], first: int = 1, marks: tuple[str, ...] = ("#", "!")
) -> list[tuple[int, str]]:
    """Return the lines that are neither empty nor comments, with their line numbers, which begin at `first`."""
    return [
        (k, line)
        for k, line in enumerate(lines, start=first)
        if line.strip() and not line.lstrip().startswith(marks)
    ]


def plain_float(text: str) -> float:
    """Convert a text by Python's rules, or return NaN.

    It is faster than `number`; if it returns NaN, call `number`, which accepts more texts.
    """
    try:
        return float("nan") if "_" in text else float(text)
    except ValueError:
        return float("nan")


def number(text: str) -> float | None:
    """Return the finite number in a text, or None; Fortran's exponent D and a decimal comma are accepted."""
    text = text.strip().strip('"').strip()
    if _NUMBER.fullmatch(text) is None:
        return None
    value = float(text.replace(",", ".").replace("d", "e").replace("D", "e"))
    return value if abs(value) < 1e300 else None


class Measure(NamedTuple):
    """A number and its unit, in lower case and without brackets; empty if there is none."""

    value: float
    unit: str


def number_with_unit(text: str) -> Measure | None:
    """Return the finite number that a text begins with and the unit behind it, or None.

    The unit may be attached to the number or be in brackets.

    >>> number_with_unit("1.55um"), number_with_unit("632,8 [nm]"), number_with_unit("red")
    (Measure(value=1.55, unit='um'), Measure(value=632.8, unit='nm'), None)
    """
    found = _WITH_UNIT.fullmatch(text.strip().strip('"').strip())
    value = number(found[1]) if found else None
    if found is None or value is None:
        return None
    return Measure(value, plain_unit(found[2] or ""))


def plain_unit(text: str) -> str:
    """Return a unit in lower case, without brackets and blanks, with `u` for micro.

    >>> plain_unit(" [\u00b5m]"), plain_unit("(cm -1)")
    ('um', 'cm-1')
    """
    return re.sub(r"[\s()\[\]{}]", "", text.lower().translate(_MICRO))


def wavelength_nm(text: str, unit: str = "") -> float | None:
    """Return the wavelength in nm of a text such as `633 nm`, `0,6328 um`, `6328 A`, `15803 cm-1`; None for others.

    `unit` is the unit of a number without one. If it is empty, numbers below 100 are in micrometres, others in
    nanometres.

    >>> wavelength_nm("1.55um"), wavelength_nm("0,5"), wavelength_nm("20000", "cm-1"), wavelength_nm("5 eV")
    (1550.0, 500.0, 500.0, None)
    """
    measure = number_with_unit(text)
    if measure is None or measure.value <= 0.0:
        return None
    own = measure.unit or unit or ("nm" if measure.value >= 100.0 else "um")
    nm = nanometres(np.array([measure.value]), own)
    return None if nm is None else float(f"{nm[0]:.12g}")


def nanometres(values: Array, unit: str) -> Array | None:
    """Return wavelengths in nm of positive numbers in a unit of wavelengths or wavenumbers; None for other units."""
    plain = plain_unit(unit)
    if plain in _WAVENUMBERS:
        return 1e7 / values
    return values * _NM[plain] if plain in _NM else None


def is_length_unit(text: str) -> bool:
    """Return whether a text is a unit of wavelengths or wavenumbers."""
    return nanometres(np.ones(1), text) is not None


def angle_unit(text: str) -> Literal["degrees", "radians"] | None:
    """Return the unit of angles that a text is, or None."""
    unit = plain_unit(text)
    return "degrees" if unit in _DEGREES else "radians" if unit in _RADIANS else None


_BLANK_CELLS = re.compile(r'"([^"]*)"|((?:[^\s"(\[]|\s*[(\[][^()\[\]]*[)\]]|[(\[])+)')


def split_cells(line: str, separator: str | None) -> list[str]:
    """Return the cells of a line, without blanks around them and without whole quotes.

    If `separator` is None, blanks with at most one comma separate the cells, except in or before brackets.

    >>> split_cells('red; "50,5" ;60', ";"), split_cells("theta_i (deg)  f [1 / sr]", None)
    (['red', '50,5', '60'], ['theta_i (deg)', 'f [1 / sr]'])
    """
    if separator is None:
        if not any(mark in line for mark in ',"(['):
            return line.split()
        words = (quoted or plain.strip(",") for quoted, plain in _BLANK_CELLS.findall(line))
        return [word for word in words if word]
    if '"' not in line:
        return [cell.strip() for cell in line.split(separator)]
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])]


def find_separator(lines: list[str]) -> str | None:
    """Return the separator of the cells of a table's lines: `;`, tab, comma, or None for blanks.

    A comma is a separator only where nothing else is: between digits it may be a decimal comma.
    """
    for separator in (";", "\t"):
        if lines and all(separator in line for line in lines):
            return separator
    if lines and all("," in line for line in lines):
        # Decimal commas between blanks: nearly every cell is a number with at most one comma.
        rows = [split_cells(line, None) for line in lines]
        spaced = [len(row) > 1 and all(number(cell) is not None for cell in row) for row in rows]
        has_blanks = 2 * sum(spaced) > len(lines)
        return None if has_blanks else ","
    return None


def list_rows(lines: list[tuple[int, str]]) -> list[tuple[int, list[str]]]:
    """Return the cells of the `data_lines` of a list, each row with its line's number.

    >>> list_rows([(1, "name;L;a;b"), (3, "RAL 3005;27,5;28,1;7")])
    [(1, ['name', 'L', 'a', 'b']), (3, ['RAL 3005', '27,5', '28,1', '7'])]
    """
    separator = find_separator([line for _, line in lines])
    return [(k, split_cells(line, separator)) for k, line in lines]


def with_whole_name(cells: list[str], width: int) -> list[str]:
    """Return the cells of a row; if there are more than `width`, the first ones are one name of several words.

    >>> with_whole_name(["RAL", "1000", "76", "0", "28"], 4)
    ['RAL 1000', '76', '0', '28']
    """
    extra = len(cells) - width
    is_name = extra > 0 and number(cells[0]) is None
    return [" ".join(cells[: extra + 1]), *cells[extra + 1 :]] if is_name else cells
