"""Expected error of a prediction at a latent, from the errors of left-out materials."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

from manifold.model.blending import blend_weights, widest_gap
from manifold.records import Array

LEAST_MATERIALS = 4
"""With fewer, left-out errors predict nothing."""

BELOW_TWICE = 0.9
"""Share of the left-out errors that are below twice the expected."""

COARSE_BELOW = 8
"""Number of materials below which expected errors are uncertain by a factor of three, and vary little with place."""

LEVEL = 0.9
"""Share of new materials whose true error is to be below `Reliability.bound` times the expected one."""
GUARANTEED = 1.0 - 2.0 * (1.0 - LEVEL)
"""What jackknife+ guarantees of that share, whatever the distribution of materials."""

_LIKE = 2.0  # number of materials at which the power a is one half (docs/explanation/expected-errors.md)
_LEAST_RESIDUAL = 1e-4
_RESIDUAL = 0.75  # power of a material's own residual, where it is known; the rest is that of its place
_FAR = 0.25  # power with which errors grow with the distance to the nearest material, in length scales


@dataclass(frozen=True, eq=False)
class ExpectedError:
    """`e(x) = c m prod (e_i / m)^(a u_i(x)) hypot(1, d(x))^(1/4)`, a = N / (N + 2): one number, `c`, is fitted.

    The logarithms of the leave-one-out errors e_i of the surrounding materials are averaged with the weights u of a
    blend. Errors grow with the distance d to the nearest material, in length scales. The power a shrinks the e_i to
    their geometric mean m, the more the fewer materials there are. Farther from all materials than any of them is from
    the others, by g, errors are at least m (d / g)^2, up to the largest e_i: nothing is known there. Of a material
    whose residual r at x is known, the expected error is `c e(x)^(1/4) r^(3/4)`.

    Attributes:
        X: places of the materials, shape (N, Q).
        log_errors: logarithms of their errors when left out, shape (N,).
        length_scale: of the weights.
        log_factor: logarithm of c.
    """

    X: Array
    log_errors: Array
    length_scale: float
    log_factor: float

    @classmethod
    def calibrate(
        cls,
        X: Array,
        places: Array,
        errors: Array,
        length_scale: float,
        floor: float,
        residuals: Array | None = None,
    ) -> ExpectedError:
        """Fit c: at least half of the left-out errors are below the expected one, and 90 % below twice that.

        Args:
            X: places of the materials, shape (N, Q).
            places: where each was found among the others when it was left out, shape (N, Q).
            errors: its error there, shape (N,).
            length_scale: of the map.
            floor: smaller errors count as this one.
            residuals: its residual there, shape (N,), for the errors of materials whose residual is known.
        """
        logs = np.log(np.maximum(errors, floor))
        off = np.empty(len(X))
        for i in range(len(X)):
            others = np.delete(np.arange(len(X)), i)
            residual = None if residuals is None else residuals[i]
            off[i] = (
                logs[i]
                - cls(X[others], logs[others], length_scale, 0.0)._log_at(places[i : i + 1], residual)[0]
            )
        factor = max(float(np.median(off)), float(np.quantile(off, BELOW_TWICE)) - np.log(2.0))
        return cls(X, logs, length_scale, factor)

    def at(self, x: Array, residual: float | None = None) -> Array:
        """Expected errors at places x (M, Q), of materials of a residual if that is known, shape (M,)."""
        expected = np.exp(self._log_at(x, residual))
        return expected if residual is not None else np.maximum(expected, self._floor(x))

    def _floor(self, x: Array) -> Array:
        """What is expected at least at places x (M, Q) that are far from all materials, shape (M,)."""
        nearest = cdist(x, self.X).min(axis=1)
        mean, most = np.exp(self.log_errors.mean()), np.exp(self.log_errors.max())
        return np.asarray(np.minimum(mean * (nearest / widest_gap(self.X)) ** 2, max(most, mean)))

    def _log_at(self, x: Array, residual: float | None) -> Array:
        u = blend_weights(x, self.X, self.length_scale)
        nearest = cdist(x, self.X).min(axis=1) / self.length_scale
        mean, power = self.log_errors.mean(), len(self.X) / (len(self.X) + _LIKE)
        around = mean + power * (u @ self.log_errors - mean)
        log = around + _FAR * np.log(np.hypot(1.0, nearest))
        if residual is not None:
            log = (1.0 - _RESIDUAL) * log + _RESIDUAL * np.log(max(residual, _LEAST_RESIDUAL))
        return self.log_factor + log


@dataclass(frozen=True)
class Reliability:
    """Expected errors of left-out materials beside true ones.

    Attributes:
        true, expected: median and 90th percentile.
        rank_correlation: of expected with true errors (Spearman).
        below_twice: share of true errors that are below twice the expected.
        bound: by how much to multiply the expected error so that a new material's true one is below in 90 %; None of
            too few materials. What jackknife+ guarantees of it, for materials that are exchangeable with these, is
            `GUARANTEED`.
        most_level: the highest such share that the number of materials allows.

    Source: Barber, Candes, Ramdas & Tibshirani 2021, for residuals that are normalised by the expected ones.
    """

    true: tuple[float, float]
    expected: tuple[float, float]
    rank_correlation: float
    below_twice: float
    bound: float | None
    most_level: float

    @classmethod
    def of(cls, true: Array, expected: Array) -> Reliability:
        """Of true errors (N,) and those that were expected without the material."""
        from scipy.stats import spearmanr  # takes half a second to import, and predictions do without

        n = len(true)
        k = int(np.ceil(LEVEL * (n + 1)))
        true_both, expected_both = (
            (float(np.median(e)), float(np.quantile(e, 0.9))) for e in (true, expected)
        )
        return cls(
            true_both, expected_both, float(spearmanr(expected, true)[0]), float(np.mean(true < 2.0 * expected)),
            float(np.sort(true / expected)[k - 1]) if k <= n else None, n / (n + 1.0),
        )  # fmt: skip
