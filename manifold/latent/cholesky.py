"""The Cholesky factor of a covariance, with as little jitter as necessary, and a warning."""

from __future__ import annotations

import warnings

import numpy as np
from scipy.linalg import cholesky
from scipy.spatial.distance import cdist

from manifold.errors import NumericalError
from manifold.latent.kernels import Kernel
from manifold.records import Array
from manifold.system.names import first_few

_FIRST_JITTER = 1e-12
_LAST_JITTER = 1e-2
_COINCIDE = 1e-6  # latents closer than this many length scales are named as coinciding


class JitterWarning(UserWarning):
    """K was not positive definite: jitter was added to its diagonal, which makes predictions smoother than mu says."""


def factorise(X: Array, kernel: Kernel) -> tuple[Array, Array, float]:
    """K, its lower Cholesky factor and the jitter that was needed (0 as a rule)."""
    K = kernel.training(X)
    diagonal, variance = np.diag_indices_from(K), np.diag(K).copy()
    jitter = 0.0
    while True:
        L = _cholesky_or_none(K)
        if L is not None:
            break
        raised = _FIRST_JITTER if jitter == 0.0 else 10.0 * jitter
        if raised > _LAST_JITTER:
            raise NumericalError(
                f"K is not positive definite even with {jitter:.0e} on its diagonal (N = {X.shape[0]}, "
                f"mu = {kernel.mu:.0e}): {_name_coinciding(X, kernel)}; raise mu"
            )
        jitter = raised
        K[diagonal] = variance + jitter
    if jitter > 0.0:
        warnings.warn(
            f"K is not positive definite (N = {X.shape[0]}, mu = {kernel.mu:.0e}): "
            f"{_name_coinciding(X, kernel)}; added {jitter:.0e} to its diagonal; "
            f"raise mu to {jitter:.0e} or more",
            JitterWarning,
            stacklevel=4,
        )
    return K, L, jitter


def _cholesky_or_none(K: Array) -> Array | None:
    """The lower factor, or None where K is singular to working precision."""
    try:
        L = cholesky(K, lower=True)
    except np.linalg.LinAlgError:
        return None
    # Rounding can let a singular K pass with meaningless pivots.
    smallest_pivot = float(np.diag(L).min()) ** 2
    return L if smallest_pivot > 4.0 * K.shape[0] * np.finfo(float).eps else None


def _name_coinciding(X: Array, kernel: Kernel) -> str:
    """The latents that coincide, or else the closest two, in words."""
    if X.shape[0] < 2:
        return "a single latent"
    distances = cdist(X, X)
    distances[np.tril_indices_from(distances)] = np.inf
    pairs = np.argwhere(distances <= _COINCIDE * kernel.length_scale)
    if len(pairs) == 0:
        i, j = np.unravel_index(int(distances.argmin()), distances.shape)
        return f"latents {i} and {j} are closest, {distances[i, j]:.1e} apart"
    return f"latents {first_few([f'{i} and {j}' for i, j in pairs])} coincide"
