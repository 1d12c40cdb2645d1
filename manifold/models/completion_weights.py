"""Weights of samples that meet a few readings of a material, and say of the rest what the likeliest mixtures say."""

from __future__ import annotations

import numpy as np

from manifold.models.nonnegative import nonnegative_weights
from manifold.records import Array

_ALIKE = 1.0  # how much bands of a material keep the shares of materials that their mean has
_SMALL = 0.003  # of the energy in all directions, against that of the readings
_STAY = 0.03  # of what the second pass may change in all directions
FEW = 12.0  # sum of the weights of readings, cosines in them, at which these hold; more readings speak louder


def completion_weights(
    samples: Array, targets: Array, weights: Array, gram: Array, group: Array, structure: Array
) -> Array:
    """Weights v >= 0 of samples in every band, shape (B, n).

    First as mixtures say, `structure`, as far as the materials' shares go, so that highlights are alike in all bands:

        sum_p w (v g - t)^2 / |t|^2 + small v G v + alike |S v - S structure|^2,

    S adding up the samples of a material. Then the least change, in the metric G of all directions, that meets the
    readings better.

    Args:
        samples: cube roots g at the readings, shape (n, P).
        targets: cube roots t of the material there, NaN where not measured, shape (B, P).
        weights: of the readings, shape (P,).
        gram: G, inner products of samples averaged over all directions, shape (n, n).
        group: which material a sample is of, shape (n,).
        structure: weights of the samples in the mean of all bands, shape (n,).
    """
    share = (group[None] == np.arange(group.max() + 1)[:, None]).astype(float)
    alike, towards = share.T @ share, share.T @ (share @ structure)
    is_read = np.isfinite(targets)
    known = np.where(is_read, targets, 0.0)
    norm = float(np.sum(weights * known**2)) / len(targets)
    if norm == 0.0:
        return np.zeros((len(targets), len(samples)))
    louder = max(float(weights.sum()), 1.0) / FEW
    gram = gram * (weights.sum() / norm)
    found = np.zeros((len(targets), len(samples)))
    for mask in np.unique(is_read, axis=0):
        rows = np.flatnonzero((is_read == mask).all(axis=1))
        w = weights * mask / norm
        inner, cross = (samples * w) @ samples.T, (known[rows] * w) @ samples.T
        first = nonnegative_weights(
            louder * inner + _SMALL * gram + _ALIKE * alike, louder * cross + _ALIKE * towards
        )
        found[rows] = nonnegative_weights(
            louder * inner + _STAY * gram, louder * cross + _STAY * first @ gram
        )
    return found
