"""Photographs from files, as linear values; what a camera did not see is NaN."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from manifold.colour.conversion import encode_srgb
from manifold.colour.pictures import read_picture
from manifold.errors import FileFormatError
from manifold.records import Array, Mask

_LEAST_SIZE = 16
_SEARCHED = 800  # pixels of the longer side in which outlines and lamps are sought, at least, where pictures have more


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

    @property
    def factor(self) -> int:
        """By how much to reduce it to what outlines and lamps are sought in."""
        return max(1, max(self.values.shape[:2]) // _SEARCHED)

    def reduced(self, factor: int) -> Photograph:
        """The same so many times smaller, where one pixel of a square was clipped as clipped."""
        if factor == 1:
            return self
        clipped = reduced(self.is_clipped[..., None].astype(np.float32), factor)[..., 0] > 0.0
        return replace(self, values=reduced(self.values, factor), is_clipped=clipped)


def read_photograph(path: Path, is_linear: bool = False) -> Photograph:
    """A photograph, see `colour.pictures.read_picture`.

    Args:
        path: of the picture.
        is_linear: its values are linear, whatever kind of file it is.
    Raises:
        MissingFileError: there is no such file.
        FileFormatError: it is no picture, too small or too large, or of a kind that is not supported.
    """
    picture = read_picture(path)
    height, width = picture.values.shape[:2]
    if min(height, width) < _LEAST_SIZE:
        raise FileFormatError(
            f"{path}: {width} x {height} pixels, expected at least {_LEAST_SIZE} pixels a side"
        )
    seen: Mask = np.isfinite(picture.values).all(axis=2) & picture.is_opaque
    values = np.where(seen[..., None], picture.values, np.float32(np.nan))
    notes = picture.notes
    if is_linear and picture.is_encoded:
        values, notes = (
            encode_srgb(values).astype(np.float32),
            (f"{path.name}: its values are taken as linear",),
        )
    grey = (f"{path.name}: grey; the colour is not in it",) * picture.is_grey
    return Photograph(path, values, picture.is_clipped & seen, notes + grey)


def reduced(values: Array, factor: int) -> Array:
    """Means of squares of pixels; NaN where one of them is."""
    if factor == 1:
        return values
    H, W = (n // factor * factor for n in values.shape[:2])
    return np.asarray(values[:H, :W].reshape(H // factor, factor, W // factor, factor, -1).mean(axis=(1, 3)))
