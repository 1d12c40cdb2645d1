"""The best non-negative combination of any number of samples, band by band."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from manifold.models.nonnegative import nonnegative_weights
from manifold.records import Array

_LEAST_MEAN = 1e-4  # in 1/sr: averages below are black


def reconstruction_weights(
    samples: Array, targets: Array, cosines: Array, rows: csr_matrix, *, picture: float = 1.0
) -> Array:
    """Weights v >= 0 of samples by which `(v g)^3` is nearest to every band of a material.

    First the error of cube roots alone, `sum w (v g - t)^2` with `w = (cos(theta_i) cos(theta_o))^(2/3)`, band by band:
    the cube-root error of `manifold.metrics`. Then again on the samples that any band uses, with the picture term,

        sum w (v g - t)^2 / sum w t^2 + picture sum_k q_k^2 (3 rows_k t^2 (v g - t))^2,

    the error of the cube roots of averages of light, linearised at the target:
    `q_k^2 = m_k^(-4/3) / (9 B sum m^(2/3))`, m_k being the average of f over group k and all bands.

    Args:
        samples: cube roots g of BRDFs, never negative, shape (n, P).
        targets: cube roots t of the material's bands, shape (B, P).
        cosines: cos(theta_i) cos(theta_o) per direction pair, shape (P,).
        rows: averages over groups of pairs, (K, P); see `picture_rows`.
        picture: 0 leaves out the second stage.
    Returns:
        Shape (B, n), mostly zeros.
    Source: docs/design/nonnegative.md.
    """
    weight = cosines ** (2.0 / 3.0)
    norm = float(np.sum(weight * targets**2))
    if norm == 0.0:
        return np.zeros((len(targets), len(samples)))
    gram, cross = (samples * weight) @ samples.T / norm, (targets * weight) @ samples.T / norm
    weights = nonnegative_weights(gram, cross)
    used = np.flatnonzero(weights.any(axis=0))
    if picture == 0.0 or used.size == 0:
        return weights
    columns, gram = np.ascontiguousarray(samples[used].T), gram[np.ix_(used, used)]
    means = np.maximum(rows @ np.maximum((targets**3).mean(axis=0), 0.0), _LEAST_MEAN)
    q = means ** (-2.0 / 3.0) / np.sqrt(len(targets) * np.sum(means ** (2.0 / 3.0)))
    for b, t in enumerate(targets):
        sloped = rows.multiply(t**2).tocsr()
        A, y = (sloped @ columns) * q[:, None], (sloped @ t) * q
        weights[b, used] = nonnegative_weights(
            gram + picture * A.T @ A, (cross[b, used] + picture * A.T @ y)[None]
        )[0]
    return weights
