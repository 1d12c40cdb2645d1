"""The non-negative combination of atoms that explains observations, and is near a prior."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from manifold.model.observation import Observation
from manifold.nonnegative import nonnegative_weights
from manifold.records import Array, Mask
from manifold.threads import one_blas_thread

_FITS = 2  # the second with the slopes, and the bounds, of the first
_AT_ONCE = 16  # atoms that enter together
_TOLERANCE = 1e-9  # of slopes, relative to the norm of the target


def explain(
    bands: Sequence[Observation],
    kept: Sequence[Array] | None = None,
    prior: Array | None = None,
    usable: Mask | None = None,
) -> Array:
    """Weights v >= 0 of n atoms that explain what was seen in every band, shape (B, n), mostly zeros.

    They minimise `sum_r w_r (T(v g_r) - T(seen_r))^2 + (v - s) K (v - s)`, with T the cube root, or the identity where
    rows are of cube roots. Differences of cube roots are those of values times slopes: linear least squares, repeated
    with better slopes.

    Args:
        bands: what was seen in each.
        kept: K, what changes from the prior cost, shape (n, n) for every band; nothing by default.
        prior: s, shape (B, n).
        usable: which atoms may have weights, shape (n,); all by default.
    Source: docs/explanation/reconstruction.md.
    """
    weights: Array = np.zeros((len(bands), len(bands[0].atoms)))
    v = weights[0]
    with one_blas_thread:
        for b, seen in enumerate(bands):
            K, s = (None, None) if kept is None or prior is None else (kept[b], prior[b])
            fitted = seen.seen if s is None else s @ seen.atoms
            for _ in range(_FITS):
                slopes = seen.slopes(fitted)
                v = _fit(
                    seen.atoms * slopes, seen.seen * slopes, v, K, s, usable
                )  # neighbouring bands are alike
                fitted = v @ seen.atoms
            weights[b] = v
    return weights


def _fit(
    A: Array, y: Array, start: Array, K: Array | None, prior: Array | None, usable: Mask | None
) -> Array:
    """Weights v >= 0 (n,) that minimise `|v A - y|^2 + (v - s) K (v - s)`; atoms enter a few at a time, by slopes."""
    square, cross, size = np.sum(A**2, axis=1), A @ y, float(y @ y)
    if K is not None and prior is not None:
        of_prior = K @ prior
        square, cross, size = square + np.diagonal(K), cross + of_prior, size + float(prior @ of_prior)
    norms = np.sqrt(np.maximum(square, np.finfo(float).tiny))
    limit = _TOLERANCE * np.sqrt(size)
    used = np.flatnonzero(start)
    while True:
        some, v = A[used], np.zeros(len(A))
        if used.size:
            inner = some @ some.T if K is None else some @ some.T + K[np.ix_(used, used)]
            v[used] = nonnegative_weights(inner, cross[None, used])[0]
        slopes = cross - A @ (v[used] @ some)
        if K is not None:
            slopes -= K[:, used] @ v[used]
        slopes /= norms
        slopes[used if usable is None else np.union1d(used, np.flatnonzero(~usable))] = 0.0
        enter = np.argsort(-slopes)[:_AT_ONCE]
        enter = enter[slopes[enter] > limit]
        if enter.size == 0:
            return v
        used = np.union1d(used, enter)
