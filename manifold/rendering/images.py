"""Pictures in files: EXR linear, PNG tone-mapped, everything in sRGB primaries."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from manifold.colour.conversion import encode_srgb
from manifold.errors import FileFormatError, MissingFileError, UsageError
from manifold.records import Array
from manifold.rendering import backend
from manifold.system import atomic

SUFFIXES = (".exr", ".png")
_DISPLAY_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp")
_KNEE = 0.7


def tone_map(linear: Array) -> Array:
    """Linear sRGB (..., 3) as display values in [0, 1].

    Values up to 0.7 keep their colours exactly; brighter ones approach white without reaching it, so highlights stay
    apart. Negative values (colours outside sRGB) are cut.

    >>> tone_map(np.array([0.0, 0.18, 1.0, 100.0])).round(2)
    array([0.  , 0.46, 0.95, 1.  ])
    """
    x = np.maximum(np.asarray(linear, dtype=np.float64), 0.0)
    rest = 1.0 - _KNEE
    bright = _KNEE + rest * -np.expm1(-np.maximum(x - _KNEE, 0.0) / rest)
    return encode_srgb(np.where(x <= _KNEE, x, bright))


def require_image_path(path: Path) -> None:
    """Check, before a picture is made, that `write_image` can write it.

    Raises:
        UsageError: the suffix is neither `.exr` nor `.png`, or the file cannot be written.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise UsageError(f"{path}: pictures are written as .exr (linear) or .png (tone-mapped); name one so")
    atomic.require_writable(path)


def write_image(path: Path, linear: Array) -> None:
    """Write linear sRGB (H, W, 3): as it is into `.exr`, tone-mapped into `.png`; atomically.

    Raises:
        UsageError: the suffix is neither `.exr` nor `.png`, or the file cannot be written.
    """
    require_image_path(path)
    if path.suffix.lower() == ".exr":
        _write(path, np.asarray(linear, dtype=np.float32))
    else:
        write_display(path, tone_map(linear))


def write_display(path: Path, values: Array) -> None:
    """Write display values in [0, 1], (H, W, 3) or with their opacity (H, W, 4), as PNG.

    Raises:
        UsageError: the file cannot be written.
    """
    _write(path, np.round(values * 255.0).astype(np.uint8))


def _write(path: Path, values: NDArray[np.float32] | NDArray[np.uint8]) -> None:
    mi = backend.mitsuba_of_any_variant()
    with atomic.replacing(path) as partial:
        mi.Bitmap(np.ascontiguousarray(values)).write(str(partial))


def read_channels(path: Path) -> Array:
    """The channels of a linear picture as they are, float32, shape (H, W, C), infinities and NaN included.

    Raises:
        FileFormatError: Mitsuba cannot read it as a picture.
    """
    mi = backend.mitsuba_of_any_variant()
    try:
        bitmap = mi.Bitmap(str(path))
        return np.atleast_3d(np.array(bitmap.convert(component_format=mi.Struct.Type.Float32)))
    except Exception as error:  # Mitsuba raises bare RuntimeErrors
        raise FileFormatError(f"{path}: not a readable picture ({_reason(error)}); save it again") from error


def read_image(path: Path) -> Array:
    """A picture as linear sRGB, float64, shape (H, W, 3); display pictures are decoded.

    Raises:
        UsageError: there is no such file.
        FileFormatError: Mitsuba cannot read it as a picture.
    """
    if not path.is_file():
        raise MissingFileError(f"{path}: no such file; name a picture (.exr, .hdr, .pfm, .png, .jpg)")
    mi = backend.mitsuba_of_any_variant()
    try:
        bitmap = mi.Bitmap(str(path))
        plain = bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False)
    except Exception as error:  # Mitsuba raises bare RuntimeErrors
        raise FileFormatError(
            f"{path}: not a readable picture ({_reason(error)}); expected .exr, .hdr, .pfm, .png or .jpg"
        ) from error
    linear = np.array(plain, dtype=np.float64)
    if linear.ndim != 3 or not np.all(np.isfinite(linear)):
        raise FileFormatError(f"{path}: pixels that are not finite; render it again")
    return linear


def read_display(path: Path) -> Array:
    """A picture as display values in [0, 1], shape (H, W, 3): as it is stored, or tone-mapped where it is linear.

    Raises:
        UsageError: there is no such file.
        FileFormatError: Mitsuba cannot read it as a picture.
    """
    linear = read_image(path)
    return encode_srgb(linear) if path.suffix.lower() in _DISPLAY_SUFFIXES else tone_map(linear)


def _reason(error: Exception) -> str:
    """The last sentence of one of Mitsuba's messages."""
    return " ".join(str(error).split("\n")[0].split())[-120:]
