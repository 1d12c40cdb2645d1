"""Covariance functions shared by all outputs: a smooth part plus a delta, `c(x, x') = k(x, x') + mu delta(x, x')`.

The delta is 1 where the coordinates are *equal*, also in the cross-covariance. At a training latent the
cross-covariance is therefore a column of K, and the posterior mean equals the training sample. Beside the training
latent the posterior is the smooth one, so the mean jumps there, by design. Among the training latents the delta is 1
for the same *sample*: K = k(X, X) + mu I. The two definitions differ only for coinciding latents, for which a delta
of coordinates would make K singular.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from manifold.core.defaults import DEFAULT_MU
from manifold.core.errors import UsageError
from manifold.core.records import Array, Indices, Mask
from manifold.registries import KERNELS

SMALLEST_MU = 1e-10  # below, K loses definiteness while latents pass each other
LARGEST_MU = 1e6  # above, everything is noise


@dataclass(frozen=True)
class Kernel(ABC):
    """A radial covariance g(r^2) of unit variance, and a delta: `c(x, x') = g(||x - x'||^2 / l^2) + mu delta(x, x')`.

    Attributes:
        mu: noise filter, the height of the delta, >= 0, in units of the signal variance.
        length_scale: l, > 0, in units of the latent coordinates.
        family: name of the radial part for `kernel_named`.
        steepest: largest |dg/dr|.

    Source: Rasmussen & Williams 2006, chapter 4; the delta: Hikichi & Iwasaki, eq. 14.
    """

    mu: float = DEFAULT_MU
    length_scale: float = 1.0
    family: ClassVar[str]
    steepest: ClassVar[float]

    def __post_init__(self) -> None:
        if not (np.isfinite(self.mu) and self.mu >= 0):
            raise UsageError(f"mu = {self.mu}, expected a finite number >= 0")
        if not (np.isfinite(self.length_scale) and self.length_scale > 0):
            raise UsageError(f"length_scale = {self.length_scale}, expected a finite number > 0")

    @property
    def name(self) -> str:
        """The kernel's name, as `kernel_named` takes it."""
        return self.family

    @property
    def is_compiled(self) -> bool:
        """Return whether the compiled loops support this class; subclasses may differ from it."""
        return type(self) in _COMPILED

    @property
    def numbers(self) -> tuple[int, float]:
        """Parameters for compiled loops: index of the class for `radial_of_pair`, `1 / l^2`."""
        return _COMPILED.index(type(self)), 1.0 / self.length_scale**2

    @abstractmethod
    def radial(self, squared: Any, xp: Any = np) -> tuple[Any, Any]:
        """Return g and dg / d r^2 at squared distances in length scales, in the same shape.

        `xp` is the array library that provides `exp` and `sqrt`.
        """

    def smooth(self, A: Array, B: Array) -> Array:
        """Return the covariance of A (M, Q) and B (N, Q) without the delta, shape (M, N)."""
        return self.smooth_and_slope(A, B)[0]

    def smooth_and_slope(self, A: Array, B: Array) -> tuple[Array, Array]:
        """Return `smooth(A, B)`, and the slope that `pull_back` takes, both of shape (M, N)."""
        return self.radial(squared_distances(A, B) / self.length_scale**2)

    @property
    def prior_variance(self) -> float:
        """The variance of the prior, including the delta."""
        return 1.0 + self.mu

    def training(self, X: Array) -> Array:
        """Return the covariance K of the training latents X (N, Q), shape (N, N)."""
        return self.training_and_slope(X)[0]

    def training_and_slope(self, X: Array) -> tuple[Array, Array]:
        """Return `training(X)`, and the slope that `gradient` takes, both of shape (N, N)."""
        K, slope = self.smooth_and_slope(X, X)
        K.flat[:: len(K) + 1] = self.prior_variance
        return K, slope

    def pull_back(self, A: Array, B: Array, dK: Array, slope: Array | None = None) -> Array:
        """Return the gradient in A (M, Q) of `sum(dK * smooth(A, B))` for fixed B (N, Q) and dK (M, N), shape (M, Q).

        `slope` (M, N) is the slope of `smooth_and_slope(A, B)`; None computes it.
        """
        slope = self.smooth_and_slope(A, B)[1] if slope is None else slope
        G = (2.0 / self.length_scale**2) * dK * slope
        return np.asarray(G.sum(axis=1)[:, None] * A - G @ B)

    def gradient(self, X: Array, dK: Array, slope: Array | None = None) -> Array:
        """Return the gradient with respect to X (N, Q) of a function of K = `training(X)`, shape (N, Q).

        dK (N, N) holds the symmetric derivatives of the function with respect to K. `slope` (N, N) is the slope of
        `training_and_slope(X)`; None computes it.
        """
        return 2.0 * self.pull_back(X, X, dK, slope)


class SquaredExponential(Kernel):
    """`g = exp(-r^2 / 2)`. Source: Hikichi & Iwasaki, eq. 14."""

    family, steepest = "se", math.exp(-0.5)

    def radial(self, squared: Any, xp: Any = np) -> tuple[Any, Any]:
        """Return g and dg / d r^2 at squared distances."""
        g = xp.exp(-0.5 * squared)
        return g, -0.5 * g


class Matern32(Kernel):
    """`g = (1 + sqrt(3) r) exp(-sqrt(3) r)`. Source: Rasmussen & Williams 2006, eq. 4.17."""

    family, steepest = "matern32", math.sqrt(3.0) / math.e

    def radial(self, squared: Any, xp: Any = np) -> tuple[Any, Any]:
        """Return g and dg / d r^2 at squared distances."""
        a = xp.sqrt(3.0 * squared)
        decay = xp.exp(-a)
        return (1.0 + a) * decay, -1.5 * decay


class Matern52(Kernel):
    """`g = (1 + sqrt(5) r + 5 r^2 / 3) exp(-sqrt(5) r)`. Source: Rasmussen & Williams 2006, eq. 4.17."""

    family = "matern52"
    _GOLDEN = (1.0 + math.sqrt(5.0)) / 2.0  # sqrt(5) r where it is steepest
    steepest = math.sqrt(5.0) / 3.0 * _GOLDEN**3 * math.exp(-_GOLDEN)

    def radial(self, squared: Any, xp: Any = np) -> tuple[Any, Any]:
        """Return g and dg / d r^2 at squared distances."""
        a = xp.sqrt(5.0 * squared)
        decay = xp.exp(-a)
        return (1.0 + a + a * a / 3.0) * decay, (-5.0 / 6.0) * (1.0 + a) * decay


_COMPILED = (SquaredExponential, Matern32, Matern52)  # in the order of `radial_of_pair` in cpp/models.cpp


def kernel_named(name: str | type[Kernel], mu: float = DEFAULT_MU, length_scale: float = 1.0) -> Kernel:
    """Return a kernel, given its name in `KERNELS`, or a class of your own with `family`, `steepest` and `radial`.

    >>> kernel_named("se", mu=1e-4).smooth(np.array([[0.0]]), np.array([[0.0], [1.0]])).round(3)
    array([[1.   , 0.607]])
    """
    if isinstance(name, type) and issubclass(name, Kernel):
        return name(mu, length_scale)
    return KERNELS[name](mu, length_scale)


def require_mu(mu: float) -> None:
    """Raise UsageError unless a value of mu is valid for a fit."""
    if not SMALLEST_MU <= mu <= LARGEST_MU:
        raise UsageError(
            f"mu = {mu}, expected {SMALLEST_MU:g} to {LARGEST_MU:g}: smaller values make K singular, larger ones "
            "leave only noise"
        )


def squared_distances(A: Array, B: Array) -> Array:
    """Return the squared distances of A (M, Q) and B (N, Q), shape (M, N); exactly 0 for equal coordinates.

    It does not use SciPy's module of distances, which takes longer to import than a prediction to compute.
    """
    squared = np.zeros((len(A), len(B)))
    for a, b in zip(A.T, B.T, strict=True):
        difference = np.subtract.outer(a, b)
        squared += difference * difference
    return squared


def equal_rows(A: Array, B: Array) -> Mask:
    """Return a mask of the rows of A (M, Q) and B (N, Q) that are equal in every coordinate, bool, shape (M, N)."""
    equal = np.ones((A.shape[0], B.shape[0]), dtype=bool)
    for a, b in zip(A.T, B.T, strict=True):
        equal &= a[:, None] == b[None, :]
    return equal


def first_equal_row(A: Array, B: Array) -> Indices:
    """Return the index of the first row of B (N, Q) that equals each row of A (M, Q), or -1, shape (M,)."""
    equal = equal_rows(A, B)
    return np.where(equal.any(axis=1), equal.argmax(axis=1), -1)
