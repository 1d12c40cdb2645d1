"""Balls of BRDFs in the studio as pictures, for scripts that draw several beside each other."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from manifold.brdf.interface import BRDF
from manifold.colour import ball_colours
from manifold.colour.conversion import encode_srgb, xyz_to_srgb
from manifold.core.records import Array
from manifold.render import images

_PIXELS_AT_ONCE = 512  # bounds the memory that evaluations take


def lit_ball(brdf: BRDF, size: int, rings: int = 24, spokes: int = 48) -> Array:
    """Return the ball in the studio: sRGB and coverage, shape (size, size, 4)."""
    ball = ball_colours.ball(size, rings, spokes)
    picture = np.zeros((size, size, 4))
    for first in range(0, len(ball.places), _PIXELS_AT_ONCE):
        part = ball.of_pixels(slice(first, first + _PIXELS_AT_ONCE))
        linear = xyz_to_srgb(part.xyz(np.maximum(brdf.eval(part.wi, part.wo), 0.0), brdf.bands))
        column, row = (np.rint((0.5 + 0.5 * xy) * size - 0.5).astype(int) for xy in (part.places * [1, -1]).T)
        picture[row, column, :3] = encode_srgb(np.clip(linear, 0.0, 1.0))
        picture[row, column, 3] = np.clip(0.5 * size * (1.0 - np.linalg.norm(part.places, axis=1)), 0.0, 1.0)
    return picture


def flip(reference: Array, test: Array) -> float:
    """Return FLIP between two balls (size, size, 4), its mean over the pixels that they cover."""
    covered = reference[..., 3] > 0.0
    return float(images.flip_map(reference[..., :3], test[..., :3])[covered].mean())


def save(figure: Figure, path: Path, dpi: int = 100) -> None:
    """Write a figure of many balls as PNG with 128 values per channel, which take less space than 256."""
    with BytesIO() as file:
        figure.savefig(file, format="png", dpi=dpi)
        values = np.asarray(Image.open(file).convert("RGB"))
    Image.fromarray(values // 2 * 2 + values // 128).save(path, optimize=True)  # 0 and 255 stay
