"""Direction pairs at which new materials are compared with blends: the encoding grid, and those of a lit ball."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from manifold.brdf.measured import BRDF, values_at
from manifold.colour import ball_colours
from manifold.encoding import encoding_pairs
from manifold.pairs import Pairs
from manifold.records import Array

OF_BALL = slice(None, None, 7)
"""Which of a ball's direction pairs are used."""


@cache
def appearance_pairs(is_isotropic: bool = True) -> Pairs:
    """The pairs of the encoding grid, then some of those that light a ball, which are rare in the grid.

    Their number, cosines and light are the same for anisotropic materials.
    """
    return encoding_pairs(is_isotropic) + ball_colours.ball()[OF_BALL]


def appearance_weight(samples: Array) -> Array:
    """Amplitudes (P,) at the pairs, with which cube roots (n, P) have the same squared norm on ball and grid."""
    grid, ball = (np.cbrt(light) for light in (encoding_pairs().cosines, ball_colours.ball().light[OF_BALL]))
    of_grid = float(np.sum((samples[:, : len(grid)] * grid) ** 2))
    of_ball = float(np.sum((samples[:, len(grid) :] * ball) ** 2))
    return np.concatenate([grid, ball * np.sqrt(of_grid / max(of_ball, np.finfo(float).tiny))])


def roots_at(materials: Sequence[BRDF], pairs: Pairs) -> Array:
    """Cube roots of values at direction pairs, a row for every band of every material, shape (N B, P)."""
    return np.concatenate([np.cbrt(np.maximum(values_at(m, pairs), 0.0)).T for m in materials])
