"""The non-negative combination of atoms that explains observations, and is near a prior."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

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
    v = weights[:1]
    with one_blas_thread:
        for atoms, run in _runs_of_atoms(bands):
            some, of_prior = bands[run], None
            if kept is not None and prior is not None:
                of_prior = list(zip(kept[run], prior[run], strict=True))
            seen = np.stack([band.seen for band in some])
            fitted = seen if prior is None else prior[run] @ atoms
            v = np.repeat(v[-1:], len(some), axis=0)  # neighbouring bands are alike
            for _ in range(_FITS):
                slopes = np.stack([band.slopes(f) for band, f in zip(some, fitted, strict=True)])
                v = _fit(atoms, seen, slopes**2, v, of_prior, usable)
                fitted = v @ atoms
            weights[run] = v
    return weights


def _runs_of_atoms(bands: Sequence[Observation]) -> Iterator[tuple[Array, slice]]:
    """The bands that follow each other and have the same atoms."""
    start = 0
    for stop in range(1, len(bands) + 1):
        if stop == len(bands) or bands[stop].atoms is not bands[start].atoms:
            yield bands[start].atoms, slice(start, stop)
            start = stop


def _fit(
    A: Array,
    y: Array,
    w: Array,
    start: Array,
    prior: Sequence[tuple[Array, Array]] | None,
    usable: Mask | None,
) -> Array:
    """Weights v >= 0 (B, n) that minimise `w_b (v_b A - y_b)^2`, and what `explain` adds, of bands that share atoms.

    Atoms enter a few at a time, by slopes, which are matrix products for all bands together.
    """
    square, cross, size = w @ (A**2).T, (w * y) @ A.T, np.sum(w * y**2, axis=1)
    for k, (K, s) in enumerate(prior or ()):
        of_prior = K @ s
        square[k] += np.diagonal(K)
        cross[k] += of_prior
        size[k] += s @ of_prior
    norms = np.sqrt(np.maximum(square, np.finfo(float).tiny))
    limit = _TOLERANCE * np.sqrt(size)
    used, v = start > 0.0, np.zeros_like(start)
    unfinished = np.arange(len(y))
    while unfinished.size:
        left = np.empty((len(unfinished), A.shape[1]))  # of what was seen, weighted
        slopes = cross[unfinished]
        for k, b in enumerate(unfinished.tolist()):
            columns = np.flatnonzero(used[b])
            some = A[columns]
            if columns.size:
                inner = (some * w[b]) @ some.T
                if prior is not None:
                    inner += prior[b][0][np.ix_(columns, columns)]
                v[b, columns] = nonnegative_weights(inner, cross[b][None, columns])[0]
            left[k] = w[b] * (v[b, columns] @ some)
            if prior is not None:
                slopes[k] -= prior[b][0][:, columns] @ v[b, columns]
        slopes = (slopes - left @ A.T) / norms[unfinished]
        slopes[used[unfinished] | (False if usable is None else ~usable)] = 0.0
        enter = np.argsort(-slopes, axis=1)[:, :_AT_ONCE]
        enters = np.take_along_axis(slopes, enter, axis=1) > limit[unfinished, None]
        row, place = np.nonzero(enters)
        used[unfinished[row], enter[row, place]] = True
        unfinished = unfinished[enters.any(axis=1)]
    return v
