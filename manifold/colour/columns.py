"""Text files of two columns: wavelengths in nm and values."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from manifold.errors import FileFormatError
from manifold.formats.text import decode, number
from manifold.records import Array
from manifold.system import reading


def read_columns(path: Path, what: str) -> tuple[Array, Array]:
    """Wavelengths in nm, increasing, and values of a text file of two columns, both of shape (B,).

    Raises:
        UsageError: the file cannot be read.
        FileFormatError: it has no such columns.
    """
    advice = f"expected a text file of wavelengths and {what}s"
    content = reading.read_bytes(path, advice=advice, most=reading.MOST_TEXT)
    lines = decode(content).splitlines()
    rows: list[tuple[float, float]] = []
    for k, line in enumerate(lines, start=1):
        cells = _numbers(line)
        if cells is not None:
            rows.append(cells)
        elif rows and line.strip() and not line.lstrip().startswith("#"):
            raise FileFormatError(
                f"{path}: line {k} is '{line.strip()[:40]}', expected a wavelength in nm and a {what}"
            )
    if len(rows) < 2:
        raise FileFormatError(
            f"{path}: found {len(rows)} rows of wavelength and {what}, expected at least 2, such as 400;0.1"
        )
    nm, values = np.array(sorted(rows)).T
    if np.any(np.diff(nm) <= 0) or not 100.0 <= nm[0] <= nm[-1] <= 10000.0:
        raise FileFormatError(
            f"{path}: wavelengths from {nm[0]:g} to {nm[-1]:g}, expected different ones in nm"
        )
    return nm, values


def _numbers(line: str) -> tuple[float, float] | None:
    """The first two numbers of a line, with a decimal point or comma, or None where it does not begin with two.

    Between blanks, tabs or semicolons, commas are decimal ones; elsewhere they separate. `400,0,5` could be either.
    """
    line = line.strip()
    is_spaced = re.search(r"[;\s]", line) is not None
    cells = [cell for cell in re.split(r",?[;\s]+", line) if cell] if is_spaced else line.split(",")
    if len(cells) < 2 or (not is_spaced and re.fullmatch(r"\d+(,\d+){2,}", line)):
        return None
    first, second = number(cells[0]), number(cells[1])
    return None if first is None or second is None else (first, second)
