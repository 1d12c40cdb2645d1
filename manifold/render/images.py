"""Reads and writes pictures (EXR linear, PNG tone-mapped) in sRGB primaries, and computes their differences."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from manifold.colour.conversion import decode_srgb, encode_srgb, srgb_to_xyz
from manifold.colour.difference import delta_e_2000, delta_e_itp
from manifold.colour.picture_files import Image, read_picture
from manifold.core import disk
from manifold.core.errors import FileFormatError, ShapeError, UsageError
from manifold.core.extras import require
from manifold.core.records import Array
from manifold.render import backend

SUFFIXES = (".exr", ".png")
_KNEE = 0.7  # linear value above which highlights are compressed, so that they keep their form below white
_COMPRESSION = 1  # of PNG: a third of the time of the default, for files a sixth larger


def tone_map(linear: Array) -> Array:
    """Convert linear sRGB (..., 3) to display values in [0, 1].

    Values up to 0.7 keep their colours exactly. Brighter values approach white without reaching it, so that
    highlights remain distinguishable. Negative values (colours outside sRGB) become 0.

    >>> tone_map(np.array([0.0, 0.18, 1.0, 100.0])).round(2)
    array([0.  , 0.46, 0.95, 1.  ])
    """
    x = np.maximum(np.asarray(linear, dtype=np.float64), 0.0)
    rest = 1.0 - _KNEE
    bright = _KNEE + rest * -np.expm1(-np.maximum(x - _KNEE, 0.0) / rest)
    return encode_srgb(np.where(x <= _KNEE, x, bright))


def require_image_path(path: Path) -> None:
    """Raise UsageError, before a picture is rendered, if `write_image` cannot write it."""
    if path.suffix.lower() not in SUFFIXES:
        raise UsageError(f"{path}: expected a name that ends in .exr (linear) or .png (tone-mapped)")
    disk.require_writable(path)


def write_image(path: Path, linear: Array) -> None:
    """Write linear sRGB (H, W, 3) as `.exr`, or tone-mapped as `.png`; the file is replaced atomically.

    An array (H, W, 1) becomes one channel of an `.exr` file. Values in half precision are written in half
    precision, others in single precision.

    Raises:
        UsageError: the suffix is neither `.exr` nor `.png`, or the file cannot be written.
    """
    require_image_path(path)
    if path.suffix.lower() == ".exr":
        mi = backend.mitsuba_of_any_variant()
        values = linear if linear.dtype == np.float16 else np.asarray(linear, dtype=np.float32)
        with disk.replacing(path) as partial, backend.two_threads():
            mi.Bitmap(np.ascontiguousarray(values)).write(str(partial))
    else:
        write_display(path, tone_map(linear), is_srgb=True)


def write_display(path: Path, values: Array, *, is_srgb: bool = False) -> None:
    """Write display values in [0, 1], (H, W, 3) or with their opacity (H, W, 4), as PNG.

    With `is_srgb`, the file states its colour space; textures of slopes have none.
    """
    from PIL import Image as PillowImage
    from PIL.PngImagePlugin import PngInfo

    picture = PillowImage.fromarray(np.round(values * 255.0).astype(np.uint8))
    chunks = PngInfo()
    if is_srgb:
        chunks.add(b"sRGB", b"\0")  # perceptual rendering intent
    with disk.replacing(path) as partial:
        picture.save(partial, "PNG", compress_level=_COMPRESSION, pnginfo=chunks)


class GuessedEncodingWarning(UserWarning):
    """Warns that a picture does not say whether its values are linear."""


def read_image(path: Path, is_linear: bool | None = None) -> Array:
    """Read a picture as linear sRGB, float64, shape (H, W, 3).

    Display pictures are decoded, see `colour.picture_files.read_picture`. A GuessedEncodingWarning says if that was a
    guess.
    """
    picture = read_picture(path, is_linear)
    if picture.is_guessed:
        for note in picture.notes:
            warnings.warn(note, GuessedEncodingWarning, stacklevel=3)
    return _finite(picture).astype(np.float64)


def read_display(path: Path) -> Array:
    """Read a picture as display values in [0, 1], shape (H, W, 3); a linear one is tone-mapped."""
    return as_display(read_picture(path))


def as_display(picture: Image) -> Array:
    """Return a picture's display values in [0, 1], shape (H, W, 3); a linear one is tone-mapped."""
    linear = _finite(picture)
    return encode_srgb(linear) if picture.is_encoded else tone_map(linear)


def _finite(picture: Image) -> Array:
    if not np.isfinite(picture.values).all():
        raise FileFormatError(f"{picture.path}: has pixels that are not finite; render it again")
    return picture.values


PIXELS_PER_DEGREE = 67.0
"""Pixels per degree of a viewer 0.7 m from a 0.7 m wide display with 3840 columns."""

_WHITE = np.array([1.0, 1.0, 1.0])


@dataclass(frozen=True)
class Summary:
    """Statistics of a map of differences between pictures."""

    mean: float
    median: float
    p95: float
    max: float

    def __str__(self) -> str:
        return f"mean {self.mean:.3f}, median {self.median:.3f}, 95th percentile {self.p95:.3f}, largest {self.max:.3f}"

    @classmethod
    def of(cls, values: Array) -> Summary:
        """Summarise all values of an array."""
        return cls(
            float(np.mean(values)),
            float(np.median(values)),
            float(np.quantile(values, 0.95)),
            float(np.max(values)),
        )


def ciede2000_map(display: Array, other: Array) -> Array:
    """Return CIEDE2000 between display values in [0, 1], shape (H, W), relative to the display's white."""
    return delta_e_2000(*_xyz(display, other), srgb_to_xyz(_WHITE))


def itp_map(display: Array, other: Array) -> Array:
    """Return Delta E_ITP between display values in [0, 1], shapes (H, W, 3); shape (H, W)."""
    return delta_e_itp(*_xyz(display, other))


def _xyz(display: Array, other: Array) -> tuple[Array, Array]:
    require_pictures(display, other)
    xyz, xyz_other = (srgb_to_xyz(decode_srgb(np.clip(p, 0.0, 1.0))) for p in (display, other))
    return xyz, xyz_other


def flip_map(reference: Array, test: Array, pixels_per_degree: float = PIXELS_PER_DEGREE) -> Array:
    """Return FLIP between display values in [0, 1], from 0 (equal) to 1 (most different), shape (H, W).

    Source: Andersson et al. 2020, DOI 10.1145/3406183, in the authors' implementation for low dynamic range.
    """
    evaluate = require("flip_evaluator").evaluate  # only comparisons need it

    require_pictures(reference, test)
    pictures = (np.clip(p, 0.0, 1.0).astype(np.float32) for p in (reference, test))
    found, _, _ = evaluate(*pictures, "LDR", applyMagma=False, parameters={"ppd": pixels_per_degree})
    return np.asarray(found[..., 0], dtype=np.float64)


def require_pictures(a: Array, b: Array) -> None:
    """Raise ShapeError unless two pictures have the same size and three channels."""
    if a.shape != b.shape or a.ndim != 3 or a.shape[2] != 3:
        raise ShapeError(
            f"pictures have shapes {a.shape} and {b.shape}, expected the same (height, width, 3); render both with "
            "the same size"
        )
