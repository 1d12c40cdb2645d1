"""Criteria that locate a new material, as functions of weights and variance.

A criterion maps weights V (n,) of the training materials and the posterior variance v, in units of the output
variance s^2, to a value and its derivatives. Values are of the size of a negative log likelihood per output, so that
the prior on latents weighs alike beside all of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from manifold.latent.decoder import Decoder
from manifold.records import Array

Criterion = Callable[[Array, float], tuple[float, Array, float]]
"""From V (n,) and v to the value and its derivatives by V (n,) and by v."""

# Relative to a material's root mean square: the slope of smaller cube roots is that of this one.
_SMALLEST_ROOT = 1e-3
_ROUNDING = 1e-14  # relative rounding error of squared distances, which are differences of large numbers


@dataclass(frozen=True, eq=False)
class Products:
    """Inner products of a new material and training materials in the mapped domain, all less the mean of the latter.

    Attributes:
        S: among the n materials, shape (n, n).
        cross: of the new one with them, shape (n,).
        norm: its squared norm.
    """

    S: Array
    cross: Array
    norm: float

    @classmethod
    def centred(cls, S: Array, cross: Array, norm: float) -> Products:
        """Of products about any origin: S (n, n), cross (n,), norm."""
        row_mean, mean, mean_cross = S.mean(axis=1), S.mean(), float(cross.mean())
        return cls(
            S - row_mean[:, None] - row_mean[None] + mean,
            cross - mean_cross - row_mean + mean,
            max(float(norm - 2.0 * mean_cross + mean), 0.0),
        )

    @property
    def distances(self) -> Array:
        """Squared distances from the training materials, shape (n,)."""
        return self.norm + np.diag(self.S) - 2.0 * self.cross

    def residual(self, V: Array) -> tuple[float, Array]:
        """Squared distance `||y - V Y||^2` from the prediction, and its derivative by V (n,)."""
        VS = V @ self.S
        squared = self.norm - 2.0 * float(V @ self.cross) + float(VS @ V)
        floor = _ROUNDING * (self.norm + np.trace(self.S) / len(self.S))
        return max(squared, floor), 2.0 * (VS - self.cross)


def mapped_residual(products: Products) -> Criterion:
    """`1/2 log ||T(f) - V T(F)||^2`."""

    def criterion(V: Array, v: float) -> tuple[float, Array, float]:
        squared, slope = products.residual(V)
        return 0.5 * float(np.log(squared)), 0.5 / squared * slope, 0.0

    return criterion


def likelihood(products: Products, scale: float) -> Criterion:
    """`1/2 log v + ||T(f) - V T(F)||^2 / (2 D s^2 v)`.

    The residual is relative to the posterior variance, which is then calibrated at the latent found.

    Args:
        products: of the material.
        scale: D s^2, outputs times output variance.
    Source: Lawrence 2005, section 3.1; Rasmussen & Williams 2006, eq. 5.8.
    """

    def criterion(V: Array, v: float) -> tuple[float, Array, float]:
        squared, slope = products.residual(V)
        misfit = 0.5 * squared / (scale * v)
        return float(0.5 * np.log(v) + misfit), 0.5 * slope / (scale * v), (0.5 - misfit) / v

    return criterion


def decoded_error(decoder: Decoder, f: Array) -> Criterion:
    """`1/2 log ||(w f*)^(1/3) - (w f)^(1/3)||^2` of values f (P,), `w` the cosines."""
    w = decoder.cosines
    target = np.cbrt(w * f)
    floor = _ROUNDING * float(target @ target) + np.finfo(float).tiny
    # The slope of a cube root is unbounded at 0, where the search would diverge.
    steepest = 3.0 * _SMALLEST_ROOT**2 * float(np.mean(target * target)) + np.finfo(float).tiny

    def criterion(V: Array, v: float) -> tuple[float, Array, float]:
        values, slope = (one[0] for one in decoder.combine(V[None]))
        found = np.cbrt(w * values)
        difference = found - target
        squared = max(float(difference @ difference), floor)
        slope = w * slope / np.maximum(3.0 * found * found, steepest)
        return 0.5 * float(np.log(squared)), decoder.mapped @ (difference * slope) / squared, 0.0

    return criterion
