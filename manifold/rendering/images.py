"""Pictures in files: EXR linear, PNG tone-mapped, everything in sRGB primaries."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import numpy as np

from manifold.colour.conversion import encode_srgb
from manifold.errors import FileFormatError, UsageError
from manifold.records import Array
from manifold.rendering import backend
from manifold.system import atomic

SUFFIXES = (".exr", ".png")
_DISPLAY_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp")
_KNEE = 0.7
_MOST_PIXELS = 1 << 26  # of the largest render
_HEADER_BYTES = 1 << 16


def tone_map(linear: Array) -> Array:
    """Linear sRGB (..., 3) as display values in [0, 1].

    Values up to 0.7 keep their colours exactly; brighter ones approach white without reaching it, so highlights stay
    apart. Negative values (colours outside sRGB) are cut.
    """
    x = np.maximum(np.asarray(linear, dtype=np.float64), 0.0)
    rest = 1.0 - _KNEE
    bright = _KNEE + rest * -np.expm1(-np.maximum(x - _KNEE, 0.0) / rest)
    return encode_srgb(np.where(x <= _KNEE, x, bright))


def mitsuba_path(path: Path) -> str:
    """A path as Mitsuba takes it. Raises UsageError where its bytes are no UTF-8."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise UsageError(
            f"{path}: a name that is no UTF-8, and Mitsuba takes no other; rename the file or folder"
        ) from None
    return str(path)


def require_image_path(path: Path) -> None:
    """Raise what `write_image` would, as far as it can be known before the work.

    Raises:
        UsageError: the suffix is neither `.exr` nor `.png`, or the file cannot be written, or its name is no UTF-8.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise UsageError(f"{path}: pictures are written as .exr (linear) or .png (tone-mapped); name one so")
    mitsuba_path(path.absolute())
    atomic.require_writable(path)


def write_image(path: Path, linear: Array) -> None:
    """Write linear sRGB (H, W, 3): as it is into `.exr`, tone-mapped into `.png`; atomically.

    Raises: as `require_image_path`.
    """
    require_image_path(path)
    if path.suffix.lower() == ".exr":
        values = np.asarray(linear, dtype=np.float32)
    else:
        values = np.round(tone_map(linear) * 255.0).astype(np.uint8)
    _write(path, values)


def _write(path: Path, values: Array) -> None:
    mi = backend.mitsuba_of_any_variant()
    with atomic.replacing(path) as partial:
        mi.Bitmap(np.ascontiguousarray(values)).write(str(partial))


def read_image(path: Path) -> Array:
    """A picture as linear sRGB, float64, shape (H, W, 3); display pictures are decoded.

    Raises:
        UsageError: there is no such file, or its name is no UTF-8.
        FileFormatError: it is no picture that Mitsuba reads.
    """
    if not path.is_file():
        raise UsageError(f"{path}: no such file; name a picture (.exr, .hdr, .pfm, .png, .jpg)")
    name = mitsuba_path(path)
    require_size(path)
    mi = backend.mitsuba_of_any_variant()
    try:
        bitmap = mi.Bitmap(name)
        plain = bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False)
    except Exception as error:  # Mitsuba raises bare RuntimeErrors
        raise FileFormatError(
            f"{path}: not a readable picture ({_reason(error)}); expected .exr, .hdr, .pfm, .png or .jpg"
        ) from error
    linear = np.array(plain, dtype=np.float64)
    if linear.ndim != 3 or not np.all(np.isfinite(linear)):
        raise FileFormatError(f"{path}: pixels that are not finite; render it again")
    return linear


def require_size(path: Path) -> None:
    """Raise FileFormatError where a picture announces more pixels than fit in memory; other files pass.

    A few bytes can announce any size, and Mitsuba takes the memory for it before it sees that they end.
    """
    with path.open("rb") as stream:
        head = stream.read(_HEADER_BYTES)
    sizes = [struct.unpack(">II", head[16:24])] if head.startswith(b"\x89PNG") and len(head) >= 24 else []
    if head.startswith(b"\x76\x2f\x31\x01"):  # OpenEXR
        boxes = re.finditer(rb"(?:data|display)Window\0box2i\0\x10\0\0\0(.{16})", head, re.DOTALL)
        corners = (struct.unpack("<4i", box[1]) for box in boxes)
        sizes += [(x1 - x0 + 1, y1 - y0 + 1) for x0, y0, x1, y1 in corners]
    if head.startswith(b"\xff\xd8"):  # JPEG: frames, and what looks like one
        frames = re.finditer(rb"\xff[\xc0-\xc3]\0.\x08(.{4})", head, re.DOTALL)
        sizes += [struct.unpack(">HH", frame[1]) for frame in frames]
    if head.startswith(b"BM") and len(head) >= 26:
        sizes += [struct.unpack("<ii", head[18:26])]
    text = re.search(
        rb"^[-+][XY] (\d{1,9}) [-+][XY] (\d{1,9})$|^P[Ff6]\s+(\d{1,9})\s+(\d{1,9})\s", head, re.M
    )
    if text is not None:  # Radiance, PFM, PPM
        width, height = (int(value) for value in text.groups() if value is not None)
        sizes += [(width, height)]
    for width, height in sizes:
        most = max(_MOST_PIXELS, 8 * path.stat().st_size)
        if abs(width * height) > most:
            raise FileFormatError(
                f"{path}: declares {width} x {height} pixels, expected at most {most} for its file size; export "
                "it again"
            )


def read_display(path: Path) -> Array:
    """A picture as display values in [0, 1], shape (H, W, 3): as it is stored, or tone-mapped where it is linear.

    Raises: as `read_image`.
    """
    linear = read_image(path)
    return encode_srgb(linear) if path.suffix.lower() in _DISPLAY_SUFFIXES else tone_map(linear)


def _reason(error: Exception) -> str:
    """The last sentence of one of Mitsuba's messages."""
    return " ".join(str(error).split("\n")[0].split())[-120:]
