"""Error of a target's shading model for a material: CIEDE2000 on the ball."""

from __future__ import annotations

from collections.abc import Callable

from manifold.colour import ball_colours
from manifold.fitting.fit_samples import EvaluableBRDF
from manifold.records import Array, Bands


def ball_xyz(f: Callable[[Array, Array], Array], bands: Bands) -> Array:
    """CIE XYZ under D65 of a ball's pixels, shape (K, 3).

    Args:
        f: BRDF in 1/sr, shape (P, B), of directions to the viewer and to the light, each (P, 3).
        bands: of its values.
    """
    ball = ball_colours.ball()
    return ball.xyz(f(ball.wi, ball.wo), bands)


def material_xyz(material: EvaluableBRDF) -> Array:
    """The same of a measured or predicted BRDF."""
    return ball_xyz(material.eval, material.bands)


def rgb_xyz(f: Callable[[Array, Array], Array]) -> Array:
    """The same of a shading model in linear sRGB."""
    return ball_xyz(f, Bands(None))
