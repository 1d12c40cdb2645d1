"""Criteria that locate a new material, as functions of weights and variances.

A material has R rows, of one latent each: a whole material one of all its bands, single bands a row per band. A
criterion maps weights V (R, n) of the training samples and posterior variances v (R,), in units of the output
variance s^2, to a value and its derivatives. Values are of the size of a negative log likelihood per output, so
that the prior on latents weighs alike beside all of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from manifold.latent.decoder import Decoder
from manifold.records import Array

CRITERIA = ("decoded", "cube-root", "mapped", "likelihood")
"""Linear error of decoded values, error of their cube roots, residual in the mapped domain, and likelihood."""

OF_VALUES = ("decoded", "cube-root")
"""Those that need decoded values; the others need inner products only."""

Criterion = Callable[[Array, Array], tuple[float, Array, Array]]
"""From V (R, n) and v (R,) to the value and its derivatives by V (R, n) and by v (R,)."""

# Relative to a material's root mean square: the slope of smaller cube roots is that of this one.
_SMALLEST_ROOT = 1e-3
_ROUNDING = 1e-14  # relative rounding error of squared distances, which are differences of large numbers


@dataclass(frozen=True, eq=False)
class Products:
    """Inner products of new rows and training samples in the mapped domain, all less the mean of the samples.

    Attributes:
        S: among the n samples, shape (n, n).
        cross: of R rows with the samples, shape (R, n).
        norm: squared norms of the rows, shape (R,).
    """

    S: Array
    cross: Array
    norm: Array

    @classmethod
    def centred(cls, S: Array, cross: Array, norm: Array) -> Products:
        """Of products about any origin: S (n, n), cross (R, n), norm (R,)."""
        row_mean, mean, mean_cross = S.mean(axis=1), S.mean(), cross.mean(axis=1)
        return cls(
            S - row_mean[:, None] - row_mean[None] + mean,
            cross - mean_cross[:, None] - row_mean[None] + mean,
            np.maximum(norm - 2.0 * mean_cross + mean, 0.0),
        )

    @property
    def distances(self) -> Array:
        """Squared distances of rows from samples, shape (R, n)."""
        return self.norm[:, None] + np.diag(self.S)[None] - 2.0 * self.cross

    def residual(self, V: Array) -> tuple[Array, Array]:
        """Squared distances `||y_r - V_r Y||^2` of rows from their predictions, (R,), and derivatives by V (R, n)."""
        VS = V @ self.S
        squared = self.norm - 2.0 * np.sum(V * self.cross, axis=1) + np.sum(VS * V, axis=1)
        floor = _ROUNDING * (self.norm + np.trace(self.S) / len(self.S))
        return np.maximum(squared, floor), 2.0 * (VS - self.cross)


def mapped_residual(products: Products) -> Criterion:
    """`R/2 log sum_r ||T(f_r) - V_r T(F)||^2`."""
    rows = len(products.norm)

    def criterion(V: Array, v: Array) -> tuple[float, Array, Array]:
        squared, slope = products.residual(V)
        total = float(squared.sum())
        return 0.5 * rows * float(np.log(total)), 0.5 * rows / total * slope, np.zeros_like(v)

    return criterion


def likelihood(products: Products, scale: float) -> Criterion:
    """`sum_r ( 1/2 log v_r + ||T(f_r) - V_r T(F)||^2 / (2 D s^2 v_r) )`.

    Residuals are relative to the posterior variance, which is then calibrated at the latents found.

    Args:
        products: of the rows.
        scale: D s^2, outputs times output variance.
    Source: Lawrence 2005, section 3.1; Rasmussen & Williams 2006, eq. 5.8.
    """

    def criterion(V: Array, v: Array) -> tuple[float, Array, Array]:
        squared, slope = products.residual(V)
        misfit = 0.5 * squared / (scale * v)
        value = float(np.sum(0.5 * np.log(v) + misfit))
        return value, 0.5 * slope / (scale * v)[:, None], (0.5 - misfit) / v

    return criterion


def decoded_error(decoder: Decoder, f: Array, *, cube_root: bool = False) -> Criterion:
    """`R/2 log sum_r ||g(w f*_r) - g(w f_r)||^2` of values f (R, P), `w` the cosines; g the identity or the cube root.

    Highlights dominate the linear error; that of cube roots is closer to perceived differences.
    """
    w, rows = decoder.cosines, len(f)
    target = np.cbrt(w * f) if cube_root else w * f
    floor = _ROUNDING * float(np.sum(target * target)) + np.finfo(float).tiny
    # The slope of a cube root is unbounded at 0, where the search would diverge.
    steepest = 3.0 * _SMALLEST_ROOT**2 * float(np.mean(target * target)) + np.finfo(float).tiny

    def criterion(V: Array, v: Array) -> tuple[float, Array, Array]:
        values, slope = decoder.combine(V)
        found, slope = w * values, w * slope
        if cube_root:
            found = np.cbrt(found)
            slope = slope / np.maximum(3.0 * found * found, steepest)
        difference = found - target
        squared = max(float(np.sum(difference * difference)), floor)
        dV = (rows / squared) * (difference * slope) @ decoder.mapped.T
        return 0.5 * rows * float(np.log(squared)), dV, np.zeros_like(v)

    return criterion
