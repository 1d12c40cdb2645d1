"""Weights of samples that fit the readings and stay close to the posterior mean elsewhere."""

from __future__ import annotations

import numpy as np

from manifold.models.nonnegative import nonnegative_weights
from manifold.records import Array

_STAY = 0.1  # weight of changes over all directions against residuals at readings
FEW = (
    12.0  # sum of the weights of readings, cosines included, up to which that holds; more readings weigh more
)


def completion_weights(samples: Array, targets: Array, weights: Array, gram: Array, supposed: Array) -> Array:
    """Weights v >= 0 of samples in every band that fit the readings, and differ little from prior weights: (B, n).

    They minimise `sum_p w (v g - t)^2 / |t|^2 + stay (v - s) G (v - s)`.

    Args:
        samples: cube roots g at the readings, shape (n, P).
        targets: cube roots t of the material there, NaN where not measured, shape (B, P).
        weights: of the readings, w, shape (P,).
        gram: G, inner products of samples averaged over all directions, shape (n, n).
        supposed: s, the prior weights, those of the mean hypothesis, shape (B, n).
    """
    is_read = np.isfinite(targets)
    known = np.where(is_read, targets, 0.0)
    norm = float(np.sum(weights * known**2)) / len(targets)
    if norm == 0.0:
        return np.zeros((len(targets), len(samples)))
    louder = max(float(weights.sum()), 1.0) / FEW
    kept = _STAY * gram * (weights.sum() / norm)
    found = np.zeros((len(targets), len(samples)))
    for mask in np.unique(is_read, axis=0):
        rows = np.flatnonzero((is_read == mask).all(axis=1))
        w = louder * weights * mask / norm
        inner, cross = (samples * w) @ samples.T, (known[rows] * w) @ samples.T
        found[rows] = nonnegative_weights(inner + kept, cross + supposed[rows] @ kept)
    return found
