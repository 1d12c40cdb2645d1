"""Colour corrections as JSON: what one instrument's bands become in another's."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from manifold import __version__
from manifold.colour.correction import FORMS, ColourCorrection
from manifold.errors import FileFormatError
from manifold.records import Array
from manifold.system import atomic
from manifold.system.small_files import read_json

_FORMAT = "manifold colour correction"


def write_correction(path: Path, correction: ColourCorrection, wavelengths_nm: Array | None) -> None:
    """Write a correction, atomically.

    Args:
        path: a JSON file.
        correction: to bands of these wavelengths.
        wavelengths_nm: of the reference, shape (B,); None for linear sRGB.
    """
    nm = None if wavelengths_nm is None else np.asarray(wavelengths_nm).tolist()
    content = {"format": _FORMAT, "program": f"manifold {__version__}", "wavelengths_nm": nm}
    atomic.write_text(path, json.dumps(content | correction.to_json(), indent=1) + "\n")


def read_correction(path: Path) -> tuple[ColourCorrection, Array | None]:
    """A correction, and the wavelengths of its bands in nm, or None for linear sRGB.

    Raises:
        UsageError: the file cannot be read.
        FileFormatError: it is no colour correction, or a damaged one.
    """
    content = read_json(path, "a colour correction of `manifold calibrate`")
    try:
        return _checked(content)
    except (KeyError, TypeError, ValueError) as error:
        raise FileFormatError(
            f"{path}: not a colour correction ({error}), expected one of `manifold calibrate`"
        ) from error


def _checked(content: Any) -> tuple[ColourCorrection, Array | None]:
    if content["format"] != _FORMAT or content["form"] not in FORMS:
        raise ValueError("its format or form is unknown")
    matrix = np.array(content["matrix"], dtype=np.float64)
    scale, largest = float(content["scale"]), float(content["largest"])
    nm = content["wavelengths_nm"]
    nm = None if nm is None else np.array(nm, dtype=np.float64)
    bands = 3 if nm is None else len(nm)
    terms = ColourCorrection.terms_of(content["form"])
    if matrix.shape != (terms, bands) or not np.all(np.isfinite(matrix)):
        raise ValueError(f"its matrix has shape {matrix.shape}, expected {(terms, bands)} of finite numbers")
    if not (0.0 < scale < np.inf and 0.0 < largest < np.inf):
        raise ValueError("its scale or largest value is not positive")
    return ColourCorrection(content["form"], matrix, scale, largest, dict(content["errors"])), nm
