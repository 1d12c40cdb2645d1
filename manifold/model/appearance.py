"""Direction pairs at which new materials are compared with blends: the encoding grid, and those of a lit ball."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from manifold.brdf.measured import BRDF
from manifold.colour import ball_colours
from manifold.colour.panel import Panel
from manifold.encoding import EncodingPairs
from manifold.records import Array

OF_BALL = slice(None, None, 7)
"""Which of a ball's direction pairs are used."""


@dataclass(frozen=True, eq=False)
class AppearancePairs:
    """Direction pairs of the encoding grid, then some of those that light a ball, which are rare in the grid.

    Attributes:
        pairs: all of them.
        n_grid: number of those of the grid.
        amplitude: cube roots of cos(theta_i) cos(theta_o) in the grid and of the light on the ball, shape (P,).
    """

    pairs: EncodingPairs
    n_grid: int
    amplitude: Array

    def weight(self, samples: Array) -> Array:
        """Amplitudes (P,) with which samples, cube roots (n, P), have the same squared norm on ball and grid."""
        weight = self.amplitude.copy()
        grid, lit = (
            float(np.sum((samples[:, part] * weight[part]) ** 2))
            for part in (slice(None, self.n_grid), slice(self.n_grid, None))
        )
        weight[self.n_grid :] *= np.sqrt(grid / max(lit, np.finfo(float).tiny))
        return weight


@cache
def appearance_pairs(is_isotropic: bool = True) -> AppearancePairs:
    """The pairs; their cosines, number and light are the same for anisotropic materials."""
    grid, ball = EncodingPairs.default(is_isotropic), ball_colours.ball()
    pairs = EncodingPairs(np.vstack([grid.wi, ball.wi[OF_BALL]]), np.vstack([grid.wo, ball.wo[OF_BALL]]))
    amplitude = np.cbrt(np.concatenate([grid.cosines, ball.light[OF_BALL]]))
    return AppearancePairs(pairs, len(grid.cosines), amplitude)


def roots_at(materials: Sequence[BRDF], pairs: EncodingPairs | ball_colours.Ball | Panel) -> Array:
    """Cube roots of values at direction pairs, a row for every band of every material, shape (N B, P)."""
    return np.concatenate([np.cbrt(np.maximum(m.eval(pairs.wi, pairs.wo), 0.0)).T for m in materials])
