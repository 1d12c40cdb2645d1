"""Mixtures of two materials, updated band by band with the colours of the readings.

The highlight of a coat is white and that of a metal coloured: single bands tell more of which materials a sample
resembles than their mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from manifold.models.gloss_readings import GlossReadings
from manifold.models.mixtures import (
    LIKE_ONE,
    SCALE_SPREAD,
    SHARES,
    Mixtures,
    independent,
    log_likelihood,
    log_of_norm,
    normalised,
)
from manifold.models.nonnegative import nonnegative_weights
from manifold.records import Array

_COUNT = 100  # of hypotheses
_CONSIDERED = 4000  # most probable mixtures of samples, of which many are of the same materials
_ALIKE = 0.07  # standard deviation between bands of the shares of materials
_COLOUR = 0.7  # weight of the differences between bands against their mean


@dataclass(frozen=True, eq=False)
class BandMixtures:
    """Hypotheses about the material that was read: mixtures of one or two materials.

    Attributes:
        probability: of H hypotheses, of sum 1, most probable first, shape (H,).
        weights: of samples, mean over bands, shape (H, n + 1).
        mean: weights in every band, averaged over hypotheses, shape (B, n + 1).
    """

    probability: Array
    weights: Array
    mean: Array


def band_mixtures(
    mixtures: Mixtures,
    samples: Array,
    targets: Array,
    weights: Array,
    where: Array,
    gram: Array,
    group: Array,
    gloss: GlossReadings | None = None,
) -> BandMixtures:
    """Posterior probabilities of mixtures of two materials, given readings in B bands.

    Weights >= 0 of the samples of both materials and of the Lambertian are fitted to every band, with shares of
    materials near those in the mean of all bands. The likelihood is that of `mixtures.posterior`.

    Args:
        mixtures: of samples, fitted to the mean over bands, see `mixtures.posterior`.
        samples: cube roots of n samples and, last, of the Lambertian at the readings, shape (n + 1, P).
        targets: cube roots of the material there, NaN where not measured, shape (B, P).
        weights: of the readings, shape (P,).
        where: coordinates of the readings, see `nearby.places`, shape (P, 3).
        gram: inner products of samples over all directions, shape (n + 1, n + 1).
        group: which material a sample is of, from 0, shape (n + 1,); the Lambertian's is the number of materials.
        gloss: readings of gloss, if there are any.
    """
    chosen = _of_different_materials(mixtures, group)
    found = np.zeros((len(chosen), len(targets), len(samples)))
    misfit, count = ((mixtures.scale[chosen] - 1.0) / SCALE_SPREAD) ** 2, 0.0
    is_read = np.isfinite(targets)
    any_read = is_read.any(axis=1)
    for mask in np.unique(is_read[any_read], axis=0):
        rows = np.flatnonzero((is_read == mask).all(axis=1))
        X, y = independent(samples[:, mask], targets[np.ix_(rows, mask)], weights[mask], where[mask])
        part = len(rows) / any_read.sum()
        count += part * (1.0 + _COLOUR) * y.shape[1]
        for k, mixture in enumerate(chosen):
            found[k, rows], missed = _fit_bands(X, y, mixtures.weights(mixture[None])[0], group)
            misfit[k] += part * missed
    of_mean = found[:, any_read].mean(axis=1)
    found[:, ~any_read] = of_mean[:, None]
    if gloss is not None:
        level = float(np.sqrt(np.mean(targets[is_read] ** 2)))
        misfit += [gloss.misfit(weights, level) for weights in found]
        count += len(gloss.target)
    norm = np.sum((of_mean @ gram) * of_mean, axis=1)
    N = int(group[-1])
    is_one = group[mixtures.first[chosen]] == group[mixtures.second[chosen]]
    log_prior = np.log(
        np.where(is_one, LIKE_ONE / N, (1.0 - LIKE_ONE) / max(len(SHARES) * N * (N - 1) / 2, 1.0))
    )
    probability = normalised(log_prior + log_likelihood(misfit, count) - log_of_norm(norm))
    order = np.argsort(-probability, kind="stable")
    return BandMixtures(probability[order], of_mean[order], np.tensordot(probability, found, 1))


def _of_different_materials(mixtures: Mixtures, group: Array) -> Array:
    """The most probable mixtures, one for every pair of materials and shares of them."""
    seen: dict[tuple[int, int, float], int] = {}
    for k in mixtures.most_probable(_CONSIDERED).tolist():
        i, j, share = int(group[mixtures.first[k]]), int(group[mixtures.second[k]]), float(mixtures.share[k])
        if i > j:
            i, j, share = j, i, 1.0 - share
        seen.setdefault((i, j, 1.0 if i == j else round(share, 3)), k)
        if len(seen) == _COUNT:
            break
    return np.array(list(seen.values()))


def _fit_bands(X: Array, y: Array, structure: Array, group: Array) -> tuple[Array, float]:
    """Weights (b, n + 1) in some bands of the samples of a mixture's materials, and their misfit."""
    totals = np.bincount(group, structure)
    used = np.flatnonzero((totals[group] > 0.0) | (group == group[-1]))
    share = (group[used] == np.flatnonzero(totals[:-1] > 0.0)[:, None]) / _ALIKE
    towards = share @ structure[used]
    v = nonnegative_weights(X[used] @ X[used].T + share.T @ share, y @ X[used].T + towards @ share)
    missed = y - v @ X[used]
    mean = missed.mean(axis=0)
    apart = np.sum((v @ share.T - towards) ** 2) + _COLOUR * np.sum((missed - mean) ** 2)
    weights = np.zeros((len(y), len(group)))
    weights[:, used] = v
    return weights, float(mean @ mean + apart / len(y))
