"""A material from pixels of its ball: a prior of mixtures of two materials, then non-negative least squares.

What no lamp lights is not in the pixels. There the estimate follows the mixtures of one or two materials, or of
dielectric coats, that explain the pixels: differences from their posterior mean cost, direction by direction, in
cube roots.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.mixtures import LAMBERTIAN_SPREAD, Hypotheses, Mixtures
from manifold.model.estimator import explain
from manifold.model.observation import LEAST, Observation
from manifold.records import Array, Mask

GRID_STRIDE = 7
"""One in this many directions of the encoding grid is enough to compare atoms."""

_MODEL_ERROR = 0.05  # standard deviation of cube roots of pixels about the best mixture, relative
_INDEPENDENT = 30.0  # number of pixels whose errors are independent
_EXPONENT = 2.0  # of the norm of mixtures
_KEEP = 1e-3  # weight of squared changes over all directions against those of pixels, both relative
_DARK = 0.05  # of the root mean square of cube roots: changes of darker directions cost no more
_COUNT = 200  # mixtures of which the mean is taken


def estimate(
    atoms: LibraryAtoms, channels: Sequence[Observation], usable: Mask | None = None
) -> tuple[Array, list[Hypotheses]]:
    """Weights of atoms, never negative, that explain every channel, (C, n), and mixtures of each as prior.

    That is of pixels alone: readings of a kind of material that the library lacks would choose a wrong one.

    Args:
        atoms: n, of values.
        channels: of a camera, C.
        usable: which atoms may be used, shape (n,); by default all.
    """
    usable = np.ones(len(atoms), bool) if usable is None else usable
    priors = [pixel_mixtures(atoms, rows.pixels, usable) for rows in channels]
    mixed, G = np.vstack([prior.mean for prior in priors]), atoms.on_grid[:, ::GRID_STRIDE]
    means = np.cbrt(np.maximum(mixed @ G, 0.0))
    norms = np.sum(means**2, axis=1)
    norms = np.maximum(norms, _DARK * norms.mean() + np.finfo(float).tiny)
    kept = []
    for mean, norm in zip(means, norms, strict=True):
        least = _DARK * np.sqrt(norm / len(mean))
        cost = G / (3.0 * np.maximum(mean, least) ** 2 * np.sqrt(norm))
        kept.append(_KEEP * cost @ cost.T)
    return explain([rows.relative for rows in channels], kept, mixed, usable), priors


def pixel_posterior(atoms: LibraryAtoms, rows: Observation, usable: Mask) -> Mixtures:
    """Posterior probabilities of mixtures of two of the usable atoms that are `mixed`, given pixels in one channel.

    As `posterior` has it for readings; mixtures and errors are of values, and those of bounds that hold are none.

    Args:
        atoms: n, of values.
        rows: the pixels.
        usable: which of the atoms may be used, shape (n,).
    """
    index = atoms.mixed[usable[atoms.mixed]]
    _, material_of = np.unique(atoms.material_of[index], return_inverse=True)
    seen = np.maximum(rows.seen, LEAST)
    whitened = np.sqrt(_INDEPENDENT * rows.weights / rows.weights.sum()) / (3.0 * _MODEL_ERROR * seen)
    X, y, is_bound = rows.atoms[index] * whitened, rows.seen * whitened, rows.is_bound
    n_library = int(material_of[-1]) - len(atoms.coats)
    mixtures = Mixtures.fitted(X[:, ~is_bound], y[~is_bound], material_of, n_library)
    misfit = mixtures.misfit
    for row, bound in zip(X[:, is_bound].T, y[is_bound], strict=True):
        misfit = misfit + np.maximum(bound - mixtures.of(row), 0.0) ** 2
    X, y, G = X[:, ~is_bound], y[~is_bound], atoms.on_grid[index, ::GRID_STRIDE]
    # A Lambertian as bright as what was seen, or black to the eye.
    albedo = max(float(X[-1] @ y) / (float(X[-1] @ X[-1]) + LAMBERTIAN_SPREAD**-2), LEAST)
    relative = np.maximum(mixtures.norm(G @ G.T) / (albedo**2 * float(G[-1] @ G[-1])), 1.0)
    return replace(mixtures, misfit=misfit).weighed(_INDEPENDENT, relative, _EXPONENT)


def pixel_mixtures(atoms: LibraryAtoms, rows: Observation, usable: Mask) -> Hypotheses:
    """The most probable of the mixtures of `pixel_posterior`, in one channel."""
    mixtures = pixel_posterior(atoms, rows, usable)
    best = mixtures.most_probable(_COUNT)
    probability = mixtures.probability[best] / mixtures.probability[best].sum()
    weights = np.zeros((len(best), len(atoms)))
    weights[:, atoms.mixed[usable[atoms.mixed]]] = mixtures.weights(best)
    return Hypotheses(probability, weights, (probability @ weights)[None])
