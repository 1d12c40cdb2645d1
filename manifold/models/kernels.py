"""Covariance functions shared by all outputs: a smooth part plus a delta, `c(x, x') = k(x, x') + mu delta(x, x')`.

The delta is 1 where the coordinates are *equal*, in the cross-covariance too. At a training latent the
cross-covariance is therefore a column of K and the posterior mean is the datum itself; next to it the posterior is
the smooth one. Among the training latents themselves the delta is one of *samples*: K = k(X, X) + mu I. The two
readings differ only for coinciding latents, where delta by coordinates would make K singular.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.spatial.distance import cdist

from manifold.errors import UsageError
from manifold.records import Array

LINEAR_SUFFIX = "+linear"


@dataclass(frozen=True)
class Kernel(ABC):
    """A radial covariance g(r^2) of unit variance, a linear term, and a delta.

    `c(x, x') = g(||x - x'||^2 / l^2) + linear * x.x' / l^2 + mu * delta(x, x')`.

    Attributes:
        mu: noise filter, the height of the delta, >= 0, in units of the signal variance.
        length_scale: l, > 0, in units of the latent coordinates.
        linear: weight of the linear term, >= 0.
        family: what `kernel_named` calls the radial part.

    Source: Rasmussen & Williams 2006, chapter 4; the delta: Hikichi & Iwasaki, eq. 14.
    """

    mu: float = 1e-4
    length_scale: float = 1.0
    linear: float = 0.0
    family: ClassVar[str]

    def __post_init__(self) -> None:
        if not (np.isfinite(self.mu) and self.mu >= 0):
            raise UsageError(f"mu = {self.mu}, expected a finite number >= 0")
        if not (np.isfinite(self.length_scale) and self.length_scale > 0):
            raise UsageError(f"length_scale = {self.length_scale}, expected a finite number > 0")
        if not (np.isfinite(self.linear) and self.linear >= 0):
            raise UsageError(f"weight of the linear term = {self.linear}, expected a finite number >= 0")

    @property
    def name(self) -> str:
        """Its name as `kernel_named` takes it."""
        return self.family + LINEAR_SUFFIX * (self.linear > 0)

    @abstractmethod
    def radial(self, squared: Array) -> Array:
        """g at squared distances in length scales, same shape; 1 at 0."""

    @abstractmethod
    def radial_slope(self, squared: Array) -> Array:
        """Derivative of g with respect to the squared distance, same shape."""

    def smooth(self, A: Array, B: Array) -> Array:
        """Covariance of A (M, Q) and B (N, Q) without the delta, shape (M, N)."""
        K = self.radial(self._squared(A, B))
        if self.linear:
            K += self.linear / self.length_scale**2 * (A @ B.T)
        return K

    def prior_variance(self, X: Array) -> Array:
        """Variance of the prior at X (M, Q), the delta included, shape (M,)."""
        variance = np.full(len(X), 1.0 + self.mu)
        if self.linear:
            variance += self.linear / self.length_scale**2 * np.einsum("mq,mq->m", X, X)
        return variance

    def training(self, X: Array) -> Array:
        """Covariance K of the training latents X (N, Q), shape (N, N)."""
        K = self.smooth(X, X)
        K[np.diag_indices_from(K)] = self.prior_variance(X)
        return K

    def pull_back(self, A: Array, B: Array, dK: Array) -> Array:
        """Gradient with respect to A (M, Q) of `sum(dK * smooth(A, B))`, dK (M, N) and B (N, Q) held, shape (M, Q)."""
        G = (2.0 / self.length_scale**2) * dK * self.radial_slope(self._squared(A, B))
        gradient = G.sum(axis=1)[:, None] * A - G @ B
        if self.linear:
            gradient += self.linear / self.length_scale**2 * (dK @ B)
        return gradient

    def gradient(self, X: Array, dK: Array) -> Array:
        """Gradient with respect to X (N, Q) of a function of K = `training(X)`, shape (N, Q).

        Args:
            X: latents, shape (N, Q).
            dK: symmetric derivatives of the function with respect to the entries of K, shape (N, N).
        """
        return 2.0 * self.pull_back(X, X, dK)

    def _squared(self, A: Array, B: Array) -> Array:
        # Differences, not the expanded square: equal coordinates give exactly 0.
        return cdist(A, B, "sqeuclidean") / self.length_scale**2


class SquaredExponential(Kernel):
    """`g = exp(-r^2 / 2)`. Source: Hikichi & Iwasaki, eq. 14."""

    family = "se"

    def radial(self, squared: Array) -> Array:
        """g at squared distances, same shape."""
        return np.exp(-0.5 * squared)

    def radial_slope(self, squared: Array) -> Array:
        """dg / d r^2, same shape."""
        return -0.5 * np.exp(-0.5 * squared)


class Matern32(Kernel):
    """`g = (1 + sqrt(3) r) exp(-sqrt(3) r)`. Source: Rasmussen & Williams 2006, eq. 4.17."""

    family = "matern32"

    def radial(self, squared: Array) -> Array:
        """g at squared distances, same shape."""
        a = np.sqrt(3.0 * squared)
        return (1.0 + a) * np.exp(-a)

    def radial_slope(self, squared: Array) -> Array:
        """dg / d r^2, same shape."""
        return -1.5 * np.exp(-np.sqrt(3.0 * squared))


class Matern52(Kernel):
    """`g = (1 + sqrt(5) r + 5 r^2 / 3) exp(-sqrt(5) r)`. Source: Rasmussen & Williams 2006, eq. 4.17."""

    family = "matern52"

    def radial(self, squared: Array) -> Array:
        """g at squared distances, same shape."""
        a = np.sqrt(5.0 * squared)
        return (1.0 + a + a * a / 3.0) * np.exp(-a)

    def radial_slope(self, squared: Array) -> Array:
        """dg / d r^2, same shape."""
        a = np.sqrt(5.0 * squared)
        return -5.0 / 6.0 * (1.0 + a) * np.exp(-a)


class RationalQuadratic(Kernel):
    """`g = 1 / (1 + r^2 / 2)`, the rational quadratic of alpha = 1. Source: Rasmussen & Williams 2006, eq. 4.19."""

    family = "rq"

    def radial(self, squared: Array) -> Array:
        """g at squared distances, same shape."""
        return 1.0 / (1.0 + 0.5 * squared)

    def radial_slope(self, squared: Array) -> Array:
        """dg / d r^2, same shape."""
        return -0.5 / (1.0 + 0.5 * squared) ** 2


_FAMILIES: dict[str, type[Kernel]] = {
    kernel.family: kernel for kernel in (SquaredExponential, Matern32, Matern52, RationalQuadratic)
}

KERNELS = tuple(family + suffix for family in _FAMILIES for suffix in ("", LINEAR_SUFFIX))
"""Names that `kernel_named` takes."""


def kernel_named(name: str, mu: float = 1e-4, length_scale: float = 1.0) -> Kernel:
    """A kernel by its name, such as `se` or `matern32+linear`; the linear term has weight 1.

    Raises:
        UsageError: no kernel has that name, or mu or the length scale cannot be used.
    """
    if name not in KERNELS:
        raise UsageError(f"no kernel is called '{name}', expected one of {', '.join(KERNELS)}")
    family = name.removesuffix(LINEAR_SUFFIX)
    return _FAMILIES[family](mu, length_scale, linear=float(name != family))


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
