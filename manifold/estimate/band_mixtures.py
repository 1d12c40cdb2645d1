"""Mixtures of two materials, updated band by band with the colours of the readings.

The highlight of a coat is white and that of a metal coloured: single bands say more than their mean about which
materials the readings resemble.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from manifold.estimate.gloss import GlossReadings
from manifold.estimate.mixtures import (
    SCALE_SPREAD,
    Mixtures,
    ReadingRoots,
    log_likelihood,
    log_of_norm,
    log_prior_of,
    material_prior,
    normalised,
)
from manifold.nonnegative import nonnegative_weights
from manifold.records import Array, Indices

_COUNT = 100  # of hypotheses
_CONSIDERED = 4000  # most probable mixtures of atoms, of which many are of the same materials
_ALIKE = 0.07  # standard deviation between bands of the shares of materials
_COLOUR = 0.7  # weight of the differences between bands against their mean


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Hypotheses about the material that was read: mixtures of one or two materials.

    Attributes:
        probability: of H hypotheses, of sum 1, most probable first, shape (H,).
        weights: of atoms, mean over bands, shape (H, n + 1).
        mean: weights in every band, averaged over hypotheses, shape (B, n + 1).
    """

    probability: Array
    weights: Array
    mean: Array


def band_mixtures(
    mixtures: Mixtures,
    read: ReadingRoots,
    gram: Array,
    material_of: Indices,
    gloss: GlossReadings | None = None,
    n_library: int | None = None,
) -> Hypotheses:
    """Posterior probabilities of mixtures of two materials, given readings in B bands.

    Weights >= 0 of the atoms of both materials and of the Lambertian are fitted to every band, with shares of materials
    near those in the mean of all bands. The likelihood is that of `mixtures.posterior`.

    Args:
        mixtures: of atoms, fitted to the mean over bands.
        read: the readings.
        gram, material_of, n_library: of the atoms, as in `mixtures.posterior`.
        gloss: readings of gloss, if there are any.
    """
    chosen = _of_different_materials(mixtures, material_of)
    fitted = np.zeros((len(chosen), len(read.material), len(read.atoms)))
    misfit, count = ((mixtures.scale[chosen] - 1.0) / SCALE_SPREAD) ** 2, 0.0
    is_read = np.isfinite(read.material)
    any_read = is_read.any(axis=1)
    for mask in np.unique(is_read[any_read], axis=0):
        rows = np.flatnonzero((is_read == mask).all(axis=1))
        X, y = read.part(rows, mask).whitened()
        part = len(rows) / any_read.sum()
        count += part * (1.0 + _COLOUR) * y.shape[1]
        for h, k in enumerate(chosen):
            fitted[h, rows], of_bands = _fit_bands(X, y, mixtures.weights(k), material_of)
            misfit[h] += part * of_bands
    of_mean = fitted[:, any_read].mean(axis=1)
    fitted[:, ~any_read] = of_mean[:, None]
    if gloss is not None:
        level = float(np.sqrt(np.mean(read.material[is_read] ** 2)))
        misfit += [gloss.misfit(weights, level) for weights in fitted]
        count += len(gloss.roots)
    residual = fitted @ read.atoms - np.where(is_read, read.material, 0.0)
    squares = np.sum(is_read * residual**2 * read.weights, axis=(1, 2)) / np.sum(is_read)
    norm = np.sum((of_mean @ gram) * of_mean, axis=1) + squares
    prior = material_prior(int(material_of[-1]), n_library)
    log_prior = log_prior_of(material_of[mixtures.first[chosen]], material_of[mixtures.second[chosen]], prior)
    probability = normalised(log_prior + log_likelihood(misfit, count) - log_of_norm(norm))
    order = np.argsort(-probability, kind="stable")
    return Hypotheses(probability[order], of_mean[order], np.tensordot(probability, fitted, 1))


def _of_different_materials(mixtures: Mixtures, material_of: Indices) -> Indices:
    """The most probable mixtures, one for every pair of materials and shares of them."""
    seen: dict[tuple[int, int, float], int] = {}
    for k in mixtures.most_probable(_CONSIDERED).tolist():
        i, j = int(material_of[mixtures.first[k]]), int(material_of[mixtures.second[k]])
        share = float(mixtures.share[k])
        if i > j:
            i, j, share = j, i, 1.0 - share
        seen.setdefault((i, j, 1.0 if i == j else round(share, 3)), k)
        if len(seen) == _COUNT:
            break
    return np.array(list(seen.values()))


def _fit_bands(X: Array, y: Array, structure: Array, material_of: Indices) -> tuple[Array, float]:
    """Weights (b, n + 1) in some bands of the atoms of a mixture's materials, and their misfit."""
    totals = np.bincount(material_of, structure)
    used = np.flatnonzero((totals[material_of] > 0.0) | (material_of == material_of[-1]))
    share = (material_of[used] == np.flatnonzero(totals[:-1] > 0.0)[:, None]) / _ALIKE
    towards = share @ structure[used]
    v = nonnegative_weights(X[used] @ X[used].T + share.T @ share, y @ X[used].T + towards @ share)
    residual = y - v @ X[used]
    mean = residual.mean(axis=0)
    apart = np.sum((v @ share.T - towards) ** 2) + _COLOUR * np.sum((residual - mean) ** 2)
    weights = np.zeros((len(y), len(material_of)))
    weights[:, used] = v
    return weights, float(mean @ mean + apart / len(y))
