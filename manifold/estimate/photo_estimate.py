"""A material from pixels of its ball: a prior of mixtures of two materials, then non-negative least squares.

What no lamp lights is not in the pixels. There the estimate follows the mixtures of one or two materials, or of
dielectric coats, that explain the pixels: differences from their posterior mean cost, direction by direction, in
cube roots.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from manifold.estimate.mixtures import (
    LAMBERTIAN_SPREAD,
    MixtureProducts,
    atom_pairs,
    log_likelihood,
    log_prior_of,
    material_prior,
    scaled_mixtures,
)
from manifold.estimate.photo_atoms import PhotoAtoms
from manifold.model.estimator import explain
from manifold.model.observation import LEAST, Observation
from manifold.records import Array, Indices, Mask

_MODEL_ERROR = 0.05  # standard deviation of cube roots of pixels about the best mixture, relative
_INDEPENDENT = 30.0  # number of pixels whose errors are independent
_RELATIVE = 2.0  # exponent of the norm of mixtures: see `mixtures.log_of_norm`
_KEEP = 1e-3  # weight of squared changes over all directions against those of pixels, both relative
_DARK = 0.05  # of the root mean square of cube roots: changes of darker directions cost no more
_STRIDE = 7  # one in this many directions of the encoding grid is enough to compare atoms
_SHOWN = 200  # mixtures of which the mean is taken


@dataclass(frozen=True, eq=False)
class Prior:
    """Mixtures of two materials that explain one channel.

    Attributes:
        mean: weights of atoms, shape (n,).
        evidence: logarithm of the probability of what was seen, up to a constant.
        spread: standard deviation of cube roots over all directions, relative to their mean.
    """

    mean: Array
    evidence: float
    spread: float


def estimate(
    atoms: PhotoAtoms, channels: Sequence[Observation], usable: Mask | None = None
) -> tuple[Array, list[Prior]]:
    """Weights of atoms, never negative, that explain every channel, and the prior of each: (C, n).

    The prior is of pixels alone: readings of a kind of material that the library lacks would choose a wrong one.

    Args:
        atoms: n of them.
        channels: of a camera, C.
        usable: which atoms may be used, shape (n,); by default all.
    """
    usable = np.ones(len(atoms), bool) if usable is None else usable
    priors = [prior_of(atoms, rows.pixels, usable) for rows in channels]
    G = atoms.on_grid[:, ::_STRIDE]
    means = np.array([np.cbrt(np.maximum(prior.mean @ G, 0.0)) for prior in priors])
    norms = np.sum(means**2, axis=1)
    norms = np.maximum(norms, _DARK * norms.mean() + np.finfo(float).tiny)
    kept = []
    for mean, norm in zip(means, norms, strict=True):
        least = _DARK * np.sqrt(norm / len(mean))
        cost = G / (3.0 * np.maximum(mean, least) ** 2 * np.sqrt(norm))
        kept.append(_KEEP * cost @ cost.T)
    relative, mean = [rows.relative for rows in channels], np.array([prior.mean for prior in priors])
    return explain(relative, kept, mean, usable), priors


def prior_of(atoms: PhotoAtoms, rows: Observation, usable: Mask) -> Prior:
    """The posterior mean of mixtures `a (x g_i + (1 - x) g_j) + l L` of two atoms and a Lambertian, in values.

    As `estimate.mixtures.posterior` does it for readings, which compares cube roots.
    """
    index = atoms.mixed[usable[atoms.mixed]]
    first, second, share, log_prior = _mixtures(atoms, index)
    seen = np.maximum(rows.seen, LEAST)
    whitened = np.sqrt(_INDEPENDENT * rows.weights / rows.weights.sum()) / (3.0 * _MODEL_ERROR * seen)
    X, y = rows.atoms[index] * whitened, rows.seen * whitened
    bounds, least_seen = X[:, rows.is_bound], y[rows.is_bound]
    X, y = X[:, ~rows.is_bound], y[~rows.is_bound]
    scale, lambertian, misfit = scaled_mixtures(X, y, first, second, share)
    for row, bound in zip(bounds.T, least_seen, strict=True):
        value = scale * (share * row[first] + (1.0 - share) * row[second]) + lambertian * row[-1]
        misfit += np.maximum(bound - value, 0.0) ** 2
    G = atoms.on_grid[index, ::_STRIDE]
    norm = MixtureProducts.of(G @ G.T, first, second, share).norm(scale, lambertian)
    # A Lambertian as bright as what was seen, or black to the eye.
    albedo = max(float(X[-1] @ y) / (float(X[-1] @ X[-1]) + LAMBERTIAN_SPREAD**-2), LEAST)
    relative = np.maximum(norm / (albedo**2 * float(G[-1] @ G[-1])), 1.0)
    log = log_prior + log_likelihood(misfit, _INDEPENDENT) - 0.5 * _RELATIVE * np.log(relative)
    evidence = float(logsumexp(log))
    best = np.argsort(-log)[:_SHOWN]
    probability = np.exp(log[best] - evidence)
    probability /= probability.sum()
    mixtures = np.zeros((len(best), len(atoms)))
    k = np.arange(len(best))
    mixtures[k, index[first[best]]] += scale[best] * share[best]
    mixtures[k, index[second[best]]] += scale[best] * (1.0 - share[best])
    mixtures[:, index[-1]] += lambertian[best]
    roots = np.cbrt(mixtures @ atoms.on_grid[:, ::_STRIDE])
    mean = probability @ roots
    variance = probability @ (roots - mean) ** 2
    spread = float(np.sqrt(variance.sum() / max(float(mean @ mean), np.finfo(float).tiny)))
    return Prior(probability @ mixtures, evidence, spread)


def _mixtures(atoms: PhotoAtoms, index: Indices) -> tuple[Indices, Indices, Array, Array]:
    """Atoms, by place in `index`, shares, and logarithms of prior probabilities of all mixtures: (H,) each."""
    _, material = np.unique(atoms.material_of[index], return_inverse=True)
    N = int(material[-1])
    first, second, share = atom_pairs(N, (len(index) - 1) // N)
    n_library = N - len(atoms.library.coats)
    return first, second, share, log_prior_of(material[first], material[second], material_prior(N, n_library))
