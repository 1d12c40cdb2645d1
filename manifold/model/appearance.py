"""Direction pairs by which new materials are located among blends: those of the measurements, and of the ball."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from manifold.brdf.measured import MeasuredBRDF
from manifold.colour import ball_colours
from manifold.models.decoder import EncodingPairs
from manifold.records import Array

_BALL_STRIDE = 7  # of a ball's direction pairs, one in this many serves to find a place


@dataclass(frozen=True, eq=False)
class AppearancePairs:
    """Direction pairs of the encoding grid, then some of those that light a ball, which the grid hardly has.

    Attributes:
        pairs: all of them.
        n_grid: how many are the grid's.
        amplitude: cube roots of cos(theta_i) cos(theta_o) in the grid, of the light on the ball, shape (P,).
    """

    pairs: EncodingPairs
    n_grid: int
    amplitude: Array

    def weight(self, samples: Array) -> Array:
        """Amplitudes at which samples, cube roots (n, P), have as much on the ball as in the grid, shape (P,)."""
        weight = self.amplitude.copy()
        grid, lit = (
            float(np.sum((samples[:, part] * weight[part]) ** 2))
            for part in (slice(None, self.n_grid), slice(self.n_grid, None))
        )
        weight[self.n_grid :] *= np.sqrt(grid / max(lit, np.finfo(float).tiny))
        return weight


@cache
def appearance_pairs(is_isotropic: bool = True) -> AppearancePairs:
    """What blends are compared with new materials by; cosines, numbers and light do not depend on isotropy."""
    grid, ball = EncodingPairs.default(is_isotropic), ball_colours.ball()
    some = slice(None, None, _BALL_STRIDE)
    pairs = EncodingPairs(np.vstack([grid.wi, ball.wi[some]]), np.vstack([grid.wo, ball.wo[some]]))
    amplitude = np.cbrt(np.concatenate([grid.cosines, ball.light[some]]))
    return AppearancePairs(pairs, len(grid.cosines), amplitude)


def roots_at(materials: Sequence[MeasuredBRDF], pairs: EncodingPairs) -> Array:
    """Cube roots of values at direction pairs, a row for every band of every material, shape (N B, P)."""
    return np.concatenate([np.cbrt(np.maximum(m.eval(pairs.wi, pairs.wo), 0.0)).T for m in materials])
