"""A material from pixels of its ball: a prior of mixtures of two materials, then non-negative least squares.

What no lamp lights is not in the pixels. There the estimate follows the mixtures of one or two materials, or of
dielectric coats, that explain the pixels: differences from their posterior mean cost, direction by direction, in
cube roots.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from manifold.estimate.mixtures import (  # fmt: skip
    SCALE_SPREAD,
    MixtureProducts,
    atom_pairs,
    log_likelihood,
    log_prior_of,
    material_prior,
    two_nonnegative,
)
from manifold.estimate.photo_atoms import PhotoAtoms
from manifold.nonnegative import nonnegative_weights
from manifold.records import Array, Indices, Mask

_MODEL_ERROR = 0.05  # standard deviation of cube roots of pixels about the best mixture, relative
_INDEPENDENT = 30.0  # number of pixels whose errors are independent
_RELATIVE = 2.0  # exponent of the norm of mixtures: see `mixtures.log_of_norm`
_LAMBERTIAN_SPREAD = 0.5  # standard deviation of its weight, before anything is seen
_KEEP = 1e-3  # weight of squared changes over all directions against those of pixels, both relative
_DARK = 0.05  # of the root mean square of cube roots: changes of darker directions cost no more
_LEAST = 216.0 / 24389.0  # of display white: CIELAB is linear below
_FITS = 2  # each with the slopes, and the bounds, of the one before
_STRIDE = 7  # one in this many directions of the encoding grid is enough to compare atoms
_SHOWN = 200  # mixtures of which the mean is taken


@dataclass(frozen=True, eq=False)
class Rows:
    """Linear functionals of a BRDF in one channel, and what they were seen to be.

    Attributes:
        atoms: of n atoms, shape (n, R).
        seen: shape (R,).
        weights: numbers of pixels, shape (R,).
        is_bound: what was at least as bright as seen, since the camera clipped it, shape (R,).
    """

    atoms: Array
    seen: Array
    weights: Array
    is_bound: Mask

    def scaled(self, exposure: float) -> Rows:
        """The same for what was seen under an exposure."""
        return Rows(self.atoms, self.seen / exposure, self.weights, self.is_bound)

    def only(self, atoms: Mask) -> Rows:
        """The same for some of the atoms."""
        return Rows(self.atoms[atoms], self.seen, self.weights, self.is_bound)

    def slopes(self, fitted: Array) -> Array:
        """By what to multiply errors, so that they are those of cube roots, relative to what was seen: (R,).

        Bounds that hold do not count.
        """
        seen = np.maximum(self.seen, 0.0)
        a, b = np.cbrt(seen), np.cbrt(np.maximum(fitted, 0.0))
        secant = np.maximum(a * a + a * b + b * b, 3.0 * _LEAST ** (2.0 / 3.0))
        norm = max(float(self.weights @ seen ** (2.0 / 3.0)), _LEAST * float(self.weights.sum()))
        counts = np.where(self.is_bound & (fitted >= self.seen), 0.0, self.weights)
        return np.sqrt(counts / norm) / secant

    def residual(self, weights: Array) -> float:
        """Relative error of cube roots of weights (n,) of atoms."""
        fitted = weights @ self.atoms
        return float(np.linalg.norm((fitted - self.seen) * self.slopes(fitted)))


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
    atoms: PhotoAtoms, channels: list[Rows], usable: Mask | None = None
) -> tuple[Array, list[Prior]]:
    """Weights of atoms, never negative, that explain every channel, and the prior of each: (C, n).

    Args:
        atoms: n of them.
        channels: of a camera, C.
        usable: which atoms may be used, shape (n,); by default all.
    """
    usable = np.ones(len(atoms), bool) if usable is None else usable
    priors = [prior_of(atoms, rows, usable) for rows in channels]
    G = atoms.on_grid[:, ::_STRIDE]
    means = np.array([np.cbrt(np.maximum(prior.mean @ G, 0.0)) for prior in priors])
    norms = np.sum(means**2, axis=1)
    norms = np.maximum(norms, _DARK * norms.mean() + np.finfo(float).tiny)
    weights = np.zeros((len(channels), len(atoms)))
    for c, (rows, prior) in enumerate(zip(channels, priors, strict=True)):
        least = _DARK * np.sqrt(norms[c] / means.shape[1])
        cost = G[usable] / (3.0 * np.maximum(means[c], least) ** 2 * np.sqrt(norms[c]))
        kept = _KEEP * cost @ cost.T
        weights[c, usable] = _fitted(rows.only(usable), kept, prior.mean[usable])
    return weights, priors


def _fitted(rows: Rows, kept: Array, prior: Array) -> Array:
    fitted = prior @ rows.atoms
    for _ in range(_FITS):
        slopes = rows.slopes(fitted)
        A, y = rows.atoms * slopes, rows.seen * slopes
        weights = nonnegative_weights(A @ A.T + kept, (A @ y + kept @ prior)[None])[0]
        fitted = weights @ rows.atoms
    return weights


def prior_of(atoms: PhotoAtoms, rows: Rows, usable: Mask) -> Prior:
    """The posterior mean of mixtures `a (x g_i + (1 - x) g_j) + l L` of two atoms and a Lambertian, in values.

    As `completion.mixtures.posterior` does it for readings, which compares cube roots.
    """
    index = atoms.mixed[usable[atoms.mixed]]
    first, second, share, log_prior = _mixtures(atoms, index)
    seen = np.maximum(rows.seen, _LEAST)
    whitened = np.sqrt(_INDEPENDENT * rows.weights / rows.weights.sum()) / (3.0 * _MODEL_ERROR * seen)
    X, y = rows.atoms[index] * whitened, rows.seen * whitened
    bounds, least_seen = X[:, rows.is_bound], y[rows.is_bound]
    X, y = X[:, ~rows.is_bound], y[~rows.is_bound]
    with_seen = X @ y
    inner = MixtureProducts.of(X @ X.T, first, second, share)
    of_scale, of_lambertian = SCALE_SPREAD**-2, _LAMBERTIAN_SPREAD**-2
    inner = MixtureProducts(inner.aa + of_scale, inner.al, inner.ll + of_lambertian)
    of_mixture = share * with_seen[first] + (1.0 - share) * with_seen[second] + of_scale
    scale, lambertian = two_nonnegative(inner.aa, inner.al, inner.ll, of_mixture, float(with_seen[-1]))
    misfit = inner.norm(scale, lambertian) - 2.0 * (of_mixture * scale + with_seen[-1] * lambertian)
    misfit = np.maximum(misfit + y @ y + of_scale, 0.0)
    for row, bound in zip(bounds.T, least_seen, strict=True):
        value = scale * (share * row[first] + (1.0 - share) * row[second]) + lambertian * row[-1]
        misfit += np.maximum(bound - value, 0.0) ** 2
    G = atoms.on_grid[index, ::_STRIDE]
    norm = MixtureProducts.of(G @ G.T, first, second, share).norm(scale, lambertian)
    # A Lambertian as bright as what was seen, or black to the eye.
    albedo = max(float(with_seen[-1]) / inner.ll, _LEAST)
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
