"""Pictures of BRDFs in notebooks: a ball in studio light, computed by quadrature."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np

from manifold.colour import ball_colours
from manifold.colour.conversion import encode_srgb, xyz_to_srgb

if TYPE_CHECKING:
    from manifold.brdf.interface import BRDF, EvaluableBRDF
    from manifold.colour.ball_colours import Picture
    from manifold.core.records import Array, Mask

_PIXELS = 64
_BLOCK = 48  # pixels evaluated at once: 40,000 direction pairs


class NotebookPicture:
    """Base class of BRDFs that notebooks show as a rendered ball."""

    def _repr_png_(self: BRDF) -> bytes:
        return ball_png(self)


def ball_png(brdf: BRDF) -> bytes:
    """Return a picture of a ball with a BRDF as a PNG file of 64 x 64 pixels, transparent around the ball."""
    from PIL import Image

    shown, inside = ball_image(brdf, _PIXELS)
    image = np.rint(255.0 * np.dstack([shown, inside])).astype(np.uint8)
    memory = io.BytesIO()
    Image.fromarray(image).save(memory, "PNG")
    return memory.getvalue()


def ball_image(brdf: EvaluableBRDF, size: int) -> tuple[Array, Mask]:
    """Return a picture of a ball with a BRDF, display values (size, size, 3), and the mask of the ball's pixels."""
    return _picture(brdf, ball_colours.ball(size, *ball_colours.DRAWN), size)


def sun_image(brdf: EvaluableBRDF, size: int, degrees: float) -> tuple[Array, Mask]:
    """Return a picture of a ball under a sun at `degrees` from the view, and the mask of its lit pixels."""
    return _picture(brdf, ball_colours.sun_ball(degrees, size), size)


def _picture(brdf: EvaluableBRDF, ball: Picture, size: int) -> tuple[Array, Mask]:
    image, inside = np.zeros((size, size, 3)), np.zeros((size, size), bool)
    column, row = ((0.5 + 0.5 * ball.places * [1.0, -1.0]) * size).astype(int).T
    for first in range(0, len(column), _BLOCK):
        pixels = slice(first, first + _BLOCK)
        part = ball.of_pixels(pixels)
        linear = xyz_to_srgb(part.xyz(brdf.eval(part.wi, part.wo), brdf.bands))
        image[row[pixels], column[pixels]] = encode_srgb(linear)
    inside[row, column] = True
    return image, inside
