"""Colour corrections between two instruments, as JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from manifold import __version__
from manifold.colour.correction import FORMS, ColourCorrection
from manifold.errors import FileFormatError
from manifold.model.completion.hybrid import InstrumentCorrection
from manifold.records import Bands
from manifold.system import atomic
from manifold.system.small_files import read_json

_FORMAT = "manifold colour correction"


def write_correction(path: Path, correction: InstrumentCorrection) -> None:
    """Write a correction as a JSON file, atomically; wavelengths are in nm, or null for linear sRGB."""
    content = {
        "format": _FORMAT,
        "program": f"manifold {__version__}",
        "source_wavelengths_nm": correction.source.wavelengths_nm,
        "wavelengths_nm": correction.target.wavelengths_nm,
    }
    atomic.write_text(path, json.dumps(content | correction.colours.to_json(), indent=1) + "\n")


def read_correction(path: Path) -> InstrumentCorrection:
    """Read a correction.

    Raises:
        UsageError: the file cannot be read.
        FileFormatError: it is no colour correction, or a damaged one.
    """
    content = read_json(path, "a colour correction of `manifold calibrate`")
    try:
        return _checked(content)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise FileFormatError(
            f"{path}: not a colour correction ({error}), expected one of `manifold calibrate`"
        ) from error


def _checked(content: Any) -> InstrumentCorrection:
    if content["format"] != _FORMAT or content["form"] not in FORMS:
        raise ValueError("its format or form is unknown")
    matrix = np.array(content["matrix"], dtype=np.float64)
    scale, largest = float(content["scale"]), float(content["largest"])
    source, target = (_bands(content[key]) for key in ("source_wavelengths_nm", "wavelengths_nm"))
    shape = (ColourCorrection.terms_of(content["form"]), target.count)
    if matrix.shape != shape or not np.all(np.isfinite(matrix)):
        raise ValueError(f"its matrix has shape {matrix.shape}, expected {shape} of finite numbers")
    if not (0.0 < scale < np.inf and 0.0 < largest < np.inf):
        raise ValueError("its scale or largest value is not positive")
    errors = {str(form): np.nan if e is None else float(e) for form, e in content["errors"].items()}
    colours = ColourCorrection(content["form"], matrix, scale, largest, errors)
    return InstrumentCorrection(colours, source, target)


def _bands(nm: Any) -> Bands:
    return Bands(None if nm is None else tuple(float(w) for w in nm))
