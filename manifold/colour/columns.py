"""Text files of two columns: wavelengths in nm and values."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from manifold.errors import FileFormatError
from manifold.formats.text import decode
from manifold.records import Array
from manifold.system import small_files


def read_columns(path: Path, what: str) -> tuple[Array, Array]:
    """Wavelengths in nm, increasing, and values of a text file of two columns."""
    advice = f"expected a text file of wavelengths and {what}s"
    content = small_files.read_bytes(path, advice=advice, most=small_files.MOST_TEXT)
    lines = decode(content).splitlines()
    rows: list[tuple[float, float]] = []
    for number, line in enumerate(lines, start=1):
        cells = _numbers(line)
        if cells is not None:
            rows.append(cells)
        elif rows and line.strip() and not line.lstrip().startswith("#"):
            raise FileFormatError(
                f"{path}: line {number} is '{line.strip()[:40]}', expected a wavelength in nm and a {what} "
                "with a decimal point"
            )
    if len(rows) < 2:
        raise FileFormatError(
            f"{path}: found {len(rows)} rows of wavelength and {what}, expected at least 2, with decimal points"
        )
    nm, values = np.array(sorted(rows)).T
    if np.any(np.diff(nm) <= 0) or not 100.0 <= nm[0] <= nm[-1] <= 10000.0:
        raise FileFormatError(
            f"{path}: wavelengths from {nm[0]:g} to {nm[-1]:g}, expected different ones in nm"
        )
    return nm, values


def _numbers(line: str) -> tuple[float, float] | None:
    """The first two numbers of a line, or None where it does not begin with two, or may hold decimal commas."""
    if re.search(r"\d,\d", line) and re.search(r"[;\s]", line.strip()):
        return None
    cells = line.replace(",", " ").replace(";", " ").split()
    try:
        first, second = float(cells[0]), float(cells[1])
    except (ValueError, IndexError):
        return None
    return (first, second) if np.isfinite(first) and np.isfinite(second) else None
