"""The covariance function shared by all outputs: squared exponential plus delta."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

from manifold.errors import UsageError
from manifold.records import Array


@dataclass(frozen=True)
class SquaredExponentialDelta:
    """`c(x, x') = mu * delta(x, x') + exp(-||x - x'||^2 / (2 l^2))`.

    The delta is 1 where the coordinates are *equal*, in the cross-covariance too. At a training latent the
    cross-covariance is therefore a column of K and the posterior mean is the datum itself; next to it the
    posterior is the smooth one. The mean jumps there, by design: it reproduces data exactly and stays stable.

    Among the training latents themselves the delta is one of *samples*: K = SE + mu I. The two readings
    differ only for coinciding latents, where delta by coordinates would make K singular.

    Attributes:
        mu: noise filter, the height of the delta, >= 0, in units of the signal variance.
        length_scale: l, > 0, in units of the latent coordinates.

    Source: Hikichi & Iwasaki, eq. 14.
    """

    mu: float = 1e-4
    length_scale: float = 1.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.mu) and self.mu >= 0):
            raise UsageError(f"mu = {self.mu}, expected a finite number >= 0")
        if not (np.isfinite(self.length_scale) and self.length_scale > 0):
            raise UsageError(f"length_scale = {self.length_scale}, expected a finite number > 0")

    def smooth(self, X_a: Array, X_b: Array) -> Array:
        """The squared-exponential part between X_a (M, Q) and X_b (N, Q), shape (M, N)."""
        # Differences, not the expanded square: equal coordinates give exactly 1.
        squared = cdist(X_a, X_b, "sqeuclidean")  # [M, N]
        return np.exp(squared * (-0.5 / self.length_scale**2))

    def training(self, X: Array) -> Array:
        """Covariance K of the training latents X (N, Q), shape (N, N)."""
        K = self.smooth(X, X)
        K[np.diag_indices_from(K)] = 1.0 + self.mu
        return K

    def cross(self, X_new: Array, X: Array) -> Array:
        """Cross-covariance of X_new (M, Q) and X (N, Q), the delta included, shape (M, N)."""
        return self.smooth(X_new, X) + self.mu * equal_rows(X_new, X)

    def gradient(self, X: Array, dK: Array, smooth: Array | None = None) -> Array:
        """Gradient with respect to X of a function of K, by the chain rule.

        `d F / d x_i = -(2 / l^2) sum_j dK_ij SE_ij (x_i - x_j)`.

        Args:
            X: latents, shape (N, Q).
            dK: symmetric derivatives of the function with respect to the entries of K, shape (N, N).
            smooth: the squared-exponential part of K where it is at hand, shape (N, N).
        Returns:
            Shape (N, Q). The delta does not move with X and adds nothing.
        """
        G = dK * (self.smooth(X, X) if smooth is None else smooth)  # [N, N]
        return (-2.0 / self.length_scale**2) * (G.sum(axis=1)[:, None] * X - G @ X)


def equal_rows(A: Array, B: Array) -> Array:
    """Which rows of A (M, Q) equal which rows of B (N, Q) in every coordinate, bool, shape (M, N)."""
    equal = np.ones((A.shape[0], B.shape[0]), dtype=bool)
    for a, b in zip(A.T, B.T, strict=True):
        equal &= a[:, None] == b[None, :]
    return equal


def first_equal_row(A: Array, B: Array) -> Array:
    """Index of the first row of B (N, Q) that equals each row of A (M, Q), or -1, shape (M,)."""
    equal = equal_rows(A, B)
    return np.where(equal.any(axis=1), equal.argmax(axis=1), -1)
