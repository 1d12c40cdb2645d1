"""A material in few parameters: two samples shared by all bands, and one weight of a white Lambertian."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from manifold.models.nonnegative import nonnegative_weights
from manifold.models.picture_terms import lab_slopes
from manifold.records import Array

_CANDIDATES = 300  # pairs that are best by cube roots alone, refitted with the picture term


def shared_pair(
    samples: Array,
    white: int,
    targets: Array,
    cosines: Array,
    rows: csr_matrix,
    to_xyz: Array,
) -> Array:
    """Weights v >= 0 of two samples in every band, and of a third that is alike in all: 2 + 2 B + 1 numbers.

    Minimises `sum w (v g - t)^2 / sum w t^2 + 1 / K sum_k |J_k 3 rows_k (t^2 (v g - t))|^2`: cube roots as in
    `reconstruction_weights`, and `L*`, `a*`, `b*` of averages of light, linearised at the target by the slopes J. All
    pairs are compared by the first term; the best of them exactly.

    Args:
        samples: cube roots g of BRDFs, never negative, shape (n, P).
        white: the sample whose weight is alike in all bands: a Lambertian.
        targets: cube roots t of the material's bands, shape (B, P).
        cosines: cos(theta_i) cos(theta_o) per direction pair, shape (P,).
        rows: averages over groups of pairs, (K, P); see `picture_rows`.
        to_xyz: XYZ of f = 1 / pi in each band alone, shape (3, B).
    Returns:
        Shape (B, n), zero but for the columns of the pair and of white.
    """
    B, n = len(targets), len(samples)
    weight = cosines ** (2.0 / 3.0)
    norm = float(np.sum(weight * targets**2))
    best = np.zeros((B, n))
    if norm == 0.0:
        return best
    gram, cross = (samples * weight) @ samples.T / norm, (targets * weight) @ samples.T / norm
    J = lab_slopes(rows @ np.maximum(targets, 0.0).T ** 3, to_xyz) * np.sqrt(1.0 / rows.shape[0])
    sloped = [(3.0 * rows.multiply(t**2)).tocsr() for t in targets]
    averages = np.array([s @ samples.T for s in sloped])  # of 3 t^2 g, [B, K, n]
    y = np.einsum("klb,bk->kl", J, np.array([s @ t for s, t in zip(sloped, targets, strict=True)])).ravel()
    most = -np.inf
    for i, j in _best_pairs(gram, cross):
        used = np.array([i, j, white])
        A = _shared_column(np.einsum("klb,bkm->klbm", J, averages[:, :, used])).reshape(y.size, -1)
        H = _shared_gram(gram[np.ix_(used, used)], B) + A.T @ A
        c = _shared_column(cross[:, used]) + A.T @ y
        v = nonnegative_weights(H, c[None])[0]
        gain = 2.0 * v @ c - v @ H @ v
        if gain > most:
            most = gain
            best[:] = 0.0
            best[:, [i, j]] = v[:-1].reshape(B, 2)
            best[:, white] += v[-1]
    return best


def _best_pairs(gram: Array, cross: Array) -> Array:
    """The pairs that lower the squared residual of cube roots most, shape (candidates, 2)."""
    gain = np.triu(pair_gains(gram, cross), 1)
    count = min(_CANDIDATES, gain.size)
    order = np.argpartition(-gain.ravel(), count - 1)[:count]
    pairs = np.column_stack(np.unravel_index(order, gain.shape))
    return pairs[pairs[:, 0] < pairs[:, 1]]


def pair_gains(gram: Array, cross: Array) -> Array:
    """How much every pair of samples lowers the squared residual, with weights >= 0 in every band: shape (n, n).

    Args:
        gram: inner products of n samples, shape (n, n).
        cross: inner products of B bands with the samples, shape (B, n).
    """
    d = np.maximum(np.diag(gram), np.finfo(float).tiny)
    determinant = np.outer(d, d) - gram * gram
    is_sound = determinant > 1e-9 * np.outer(d, d)
    determinant = np.where(is_sound, determinant, np.inf)
    total = np.zeros_like(gram)
    for c in cross:
        alone = np.maximum(c, 0.0) ** 2 / d
        a = (c[:, None] * d[None] - gram * c[None]) / determinant  # weight of the row's sample, signs free
        both = is_sound & (a > 0.0) & (a.T > 0.0)
        total += np.where(both, a * c[:, None] + a.T * c[None], np.maximum(alone[:, None], alone[None]))
    return total


def _shared_gram(gram: Array, B: int) -> Array:
    """Inner products (2 B + 1, 2 B + 1) of the unknowns: a pair per band, and what all bands share."""
    H = np.zeros((2 * B + 1, 2 * B + 1))
    H[:-1, :-1] = np.kron(np.eye(B), gram[:2, :2])
    H[:-1, -1] = H[-1, :-1] = np.tile(gram[:2, 2], B)
    H[-1, -1] = B * gram[2, 2]
    return H


def _shared_column(per_band: Array) -> Array:
    """From (..., B, 3) to (..., 2 B + 1): the third column is summed over bands."""
    pairs = per_band[..., :2].reshape(*per_band.shape[:-2], -1)
    return np.concatenate([pairs, per_band[..., 2].sum(axis=-1)[..., None]], axis=-1)
