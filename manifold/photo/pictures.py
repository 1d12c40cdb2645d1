"""Photographs from files, as linear values; what a camera did not see is NaN."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from manifold.colour.conversion import decode_srgb
from manifold.errors import FileFormatError, MissingFileError
from manifold.records import Array, Mask
from manifold.rendering import images

_LINEAR = (".exr", ".hdr", ".pfm")
_TIFF = (".tif", ".tiff")
_DISPLAY = (".png", ".jpg", ".jpeg", ".bmp", ".webp")
SUFFIXES = _LINEAR + _TIFF + _DISPLAY
"""Of files that are read."""

_LEAST_SIZE, _MOST_PIXELS = 16, 100_000_000
_PLATEAU = 4  # pixels of the very same largest value are clipped


@dataclass(frozen=True, eq=False)
class Photograph:
    """A picture in linear values.

    Attributes:
        path: where it was read.
        values: shape (H, W, 3), float32; NaN where the picture is transparent or not finite.
        is_clipped: pixels that were at least as bright as their values, shape (H, W).
        notes: assumptions about the file, in sentences.
    """

    path: Path
    values: Array
    is_clipped: Mask
    notes: tuple[str, ...] = ()


def read_photograph(path: Path) -> Photograph:
    """A photograph: EXR, HDR, PFM and TIFF are linear, PNG and JPEG are decoded as sRGB.

    Raises:
        MissingFileError: there is no such file.
        FileFormatError: it is no picture, too small or too large, or of a kind that is not supported.
    """
    if not path.is_file():
        raise MissingFileError(f"{path}: no such file; name a picture (.exr, .tif, .png, .jpg)")
    suffix = path.suffix.lower()
    notes: tuple[str, ...] = ()
    clipped: Any
    opaque: Array | None
    if suffix in _LINEAR:
        values, clipped, opaque = _split(images.read_channels(path), None)
    elif suffix in _TIFF:
        values, clipped, opaque = _read_tiff(path)
    elif suffix in _DISPLAY:
        values, clipped, opaque = _read_display(path)
        notes = (f"{path.name}: taken as sRGB; tone curves and colour settings of a camera are not undone",)
    else:
        raise FileFormatError(f"{path}: found '{suffix}', expected .exr, .tif, .png or .jpg")
    if values.ndim != 3 or values.shape[2] not in (1, 3) or min(values.shape[:2]) < _LEAST_SIZE:
        raise FileFormatError(
            f"{path}: shape {values.shape}, expected rows, columns and 3 channels, at least {_LEAST_SIZE} pixels a side"
        )
    if values.shape[2] == 1:
        values = np.repeat(values, 3, axis=2)
    if np.array_equal(values[..., 0], values[..., 1], equal_nan=True) and np.array_equal(
        values[..., 0], values[..., 2], equal_nan=True
    ):
        notes += (f"{path.name}: grey; the colour is not in it",)
    seen: Mask = np.all(np.isfinite(values), axis=2)
    if opaque is not None:
        seen &= opaque >= 1.0
    seen_values = np.where(seen[..., None], values, np.nan).astype(np.float32)
    return Photograph(path, seen_values, clipped & seen, notes)


def _split(values: Array, full: float | None) -> tuple[Array, Mask, Array | None]:
    """Values (H, W, C), clipped pixels (H, W), and opacity if there is any, of channels and their largest value."""
    values = np.atleast_3d(values)
    opaque = values[..., -1] if values.shape[2] in (2, 4) else None
    values = values if opaque is None else values[..., :-1]
    if full is None:  # floats are clipped where they are the largest, if several are
        most = np.max(values, where=np.isfinite(values), initial=-np.inf)
        clipped: Mask = np.any(np.equal(values, most), axis=2)
        return values, clipped & (np.count_nonzero(clipped) >= _PLATEAU), opaque
    values = values / full
    return values, np.any(np.greater_equal(values, 1.0), axis=2), None if opaque is None else opaque / full


def _read_display(path: Path) -> tuple[Array, Mask, Array | None]:
    """The right way up, palettes as their colours, decoded."""
    from PIL import Image, ImageOps

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(path) as image:
                upright = ImageOps.exif_transpose(image)
                kind = "RGBA" if upright.has_transparency_data else "RGB"
                pixels = np.asarray(upright.convert(kind))
    except Exception as error:  # Pillow raises whatever its decoders do
        raise FileFormatError(f"{path}: not a readable picture ({error}); save it again") from error
    of_byte = decode_srgb(np.arange(256) / 255.0).astype(np.float32)
    return _split(of_byte[pixels], 1.0)


def _read_tiff(path: Path) -> tuple[Array, Mask, Array | None]:
    """Linear; integers relative to their largest value."""
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            page: Any = file.pages[0]
            if page.size > 4 * _MOST_PIXELS:
                raise ValueError(f"{page.shape} values")
            values = np.asarray(page.asarray())
            is_palette = page.photometric == tifffile.PHOTOMETRIC.PALETTE
            if page.planarconfig == tifffile.PLANARCONFIG.SEPARATE and values.ndim == 3:
                values = np.moveaxis(values, 0, -1)
    except Exception as error:  # tifffile raises whatever its decoders do
        raise FileFormatError(
            f"{path}: not a readable TIFF ({error}); save it without compression"
        ) from error
    if is_palette:
        raise FileFormatError(f"{path}: a palette, expected linear values; save it as RGB")
    full = float(np.iinfo(values.dtype).max) if values.dtype.kind in "ui" else None
    return _split(values.astype(np.float32), full)
