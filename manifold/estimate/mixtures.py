"""Mixtures of two atoms and a Lambertian, with prior and posterior probabilities.

A few readings, or pixels of one picture, do not determine which materials a material resembles, and thus its highlight
where nothing was seen: many mixtures fit. All are evaluated, and averaged by their posterior probability.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.special import logsumexp

from manifold.records import Array, Indices

SHARES = (0.5, 0.2, 0.8)  # of the first atom, besides 1
_MOST_PAIRS = 40_000  # pairs of atoms of two materials; of larger libraries as many at random
_FREEDOM = 3.0  # degrees of freedom of Student's t: the variances of noise and residual are estimates
_TWO_COATS = 0.8  # share of mixtures of two coats among those that a coat is part of

LIKE_ONE = 0.8
"""Prior probability that a material is like a single one of the library, in one band or between two."""

COATED = 0.05
"""Prior probability that a material is like dielectric coats, and not like those of the library."""

SCALE_SPREAD = 0.15
"""Standard deviation of the scale of atoms about 1, before anything is read."""

LAMBERTIAN_SPREAD = 0.5
"""Standard deviation of the weight of the Lambertian, before anything is read."""


@dataclass(frozen=True, eq=False)
class Mixtures:
    """H mixtures `a (x g_i + (1 - x) g_j) + l L` of two of n atoms and a Lambertian.

    Attributes:
        first, second: i and j, shape (H,).
        share: x, shape (H,).
        scale, lambertian: a and l, shape (H,).
        log_prior: logarithm of their probability before anything is seen, shape (H,).
        misfit: their squared error over its variance, shape (H,).
        n_atoms: n; the Lambertian is atom n.
        log_posterior: logarithm of their probability, shape (H,); up to `evidence`, that of what was seen.
        evidence: likewise, up to a constant.
    """

    first: Indices
    second: Indices
    share: Array
    scale: Array
    lambertian: Array
    log_prior: Array
    misfit: Array
    n_atoms: int
    log_posterior: Array
    evidence: float = 0.0

    @classmethod
    def fitted(cls, X: Array, y: Array, material_of: Indices, n_library: int | None = None) -> Mixtures:
        """All mixtures of atoms, with the scale and Lambertian of each that are of largest posterior density.

        Args:
            X: what atoms and, last, the Lambertian were seen to be, whitened: errors have variance 1; shape (n + 1, R).
            y: what was seen, shape (R,).
            material_of, n_library: as of `posterior`.
        """
        N = int(material_of[-1])
        first, second, share = atom_pairs(N, (len(material_of) - 1) // N)
        log_prior = log_prior_of(material_of[first], material_of[second], material_prior(N, n_library))
        with_seen, inner = X @ y, _products(X @ X.T, first, second, share)
        # Gaussian priors of scale and Lambertian, as terms of the normal equations.
        of_scale, of_lambertian = SCALE_SPREAD**-2, LAMBERTIAN_SPREAD**-2
        aa, al, ll = inner[0] + of_scale, inner[1], inner[2] + of_lambertian
        of_mixture = share * with_seen[first] + (1.0 - share) * with_seen[second] + of_scale
        scale, lambertian = two_nonnegative(aa, al, ll, of_mixture, float(with_seen[-1]))
        misfit = scale**2 * aa + 2.0 * scale * lambertian * al + lambertian**2 * ll
        misfit -= 2.0 * (of_mixture * scale + with_seen[-1] * lambertian)
        misfit = np.maximum(misfit + y @ y + of_scale, 0.0)
        return cls(first, second, share, scale, lambertian, log_prior, misfit, len(X) - 1, log_prior)

    def weighed(self, count: float, norm: Array, exponent: float) -> Mixtures:
        """The same with posterior probabilities: the likelihood is Student's t, divided by a power of the norm.

        Errors are relative: a mixture as dark as possible would be the best, if what it misses did not count as light,
        too.

        Args:
            count: how many independent errors the misfit is the sum of.
            norm: squared norm of the mixtures over all directions and of what they do not explain, above 0, (H,).
            exponent: of the norm.
        """
        log = self.log_prior + log_likelihood(self.misfit, count) - 0.5 * exponent * np.log(norm)
        evidence = float(logsumexp(log))
        return replace(self, log_posterior=log - evidence, evidence=evidence)

    @property
    def probability(self) -> Array:
        """Posterior, of sum 1, shape (H,)."""
        return np.exp(self.log_posterior)

    def of(self, values: Array) -> Array:
        """A linear functional of the mixtures, from that of atoms and Lambertian (n + 1,): shape (H,)."""
        of_pair = self.share * values[self.first] + (1.0 - self.share) * values[self.second]
        return self.scale * of_pair + self.lambertian * values[-1]

    def norm(self, inner: Array) -> Array:
        """Squared norms of the mixtures, from inner products of atoms and Lambertian (n + 1, n + 1): shape (H,)."""
        aa, al, ll = _products(inner, self.first, self.second, self.share)
        return self.scale**2 * aa + 2.0 * self.scale * self.lambertian * al + self.lambertian**2 * ll

    def weights(self, chosen: Indices) -> Array:
        """Weights of atoms and Lambertian in h of the mixtures, shape (h, n + 1)."""
        weights, k = np.zeros((len(chosen), self.n_atoms + 1)), np.arange(len(chosen))
        weights[k, self.first[chosen]] += self.scale[chosen] * self.share[chosen]
        weights[k, self.second[chosen]] += self.scale[chosen] * (1.0 - self.share[chosen])
        weights[:, -1] += self.lambertian[chosen]
        return weights

    def most_probable(self, count: int) -> Indices:
        """The mixtures of the largest probability, at most `count`, most probable first."""
        count = min(count, len(self.log_posterior))
        some = np.sort(np.argpartition(-self.log_posterior, count - 1)[:count])
        return some[np.argsort(-self.log_posterior[some], kind="stable")]


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Hypotheses about a material that was seen: mixtures of one or two materials.

    Attributes:
        probability: of H hypotheses, of sum 1, most probable first, shape (H,).
        weights: of n atoms, mean over bands, shape (H, n).
        mean: weights in every band, averaged over hypotheses, shape (B, n).
    """

    probability: Array
    weights: Array
    mean: Array

    def spread(self, roots: Array, importance: Array | float = 1.0) -> float:
        """Standard deviation over directions, relative to the mean, from cube roots of hypotheses there (H, P).

        Args:
            roots: of the hypotheses.
            importance: of the directions, shape (P,).
        """
        mean = self.probability @ roots
        variance = self.probability @ (roots - mean) ** 2
        norm = max(float(np.sum(mean**2 * importance)), np.finfo(float).tiny)
        return float(np.sqrt(np.sum(variance * importance) / norm))


def material_prior(N: int, n_library: int | None = None) -> Array:
    """Probabilities of N materials before anything is read, of which all but the first n are coats: shape (N,)."""
    n = N if n_library is None else n_library
    coated = COATED if n < N else 0.0
    return np.repeat([(1.0 - coated) / n, coated / max(N - n, 1)], [n, N - n])


def log_prior_of(first: Indices, second: Indices, prior: Array) -> Array:
    """Logarithms of prior probabilities of mixtures of two materials, or of one where both are the same: (H,).

    Those of one material have its probability times `LIKE_ONE` together. Those of two have the rest: measured ones
    their share of it, the others the share of coats, most of which are of two coats: a highlight and its haze.

    Args:
        first, second: of N materials, shape (H,).
        prior: of the materials, see `material_prior`, shape (N,).
    """
    is_one = first == second
    one = prior[first] / np.maximum(np.bincount(first[is_one], minlength=len(prior)), 1)[first]
    is_coat = prior != prior[0]
    n_coats = is_coat[first].astype(int) + is_coat[second]
    coated = prior[is_coat].sum()
    shares = np.array([1.0 - coated, coated * (1.0 - _TWO_COATS), coated * _TWO_COATS])
    two = (shares / np.maximum(np.bincount(n_coats[~is_one], minlength=3), 1))[n_coats]
    return np.log(np.where(is_one, LIKE_ONE * one, (1.0 - LIKE_ONE) * two))


def log_likelihood(misfit: Array, count: float) -> Array:
    """Log density of Student's t up to a constant, at the sum of `count` squared errors over their variance."""
    return np.asarray(-0.5 * (_FREEDOM + count) * np.log1p(misfit / _FREEDOM))


def _products(inner: Array, first: Indices, second: Indices, share: Array) -> tuple[Array, Array, float]:
    """Inner products of mixtures `x g_i + (1 - x) g_j` with themselves (H,), with the Lambertian (H,), and its own.

    From those of atoms and, last, the Lambertian, shape (n + 1, n + 1).
    """
    rest, own = 1.0 - share, np.diagonal(inner)
    aa = share**2 * own[first] + 2.0 * share * rest * inner[first, second] + rest**2 * own[second]
    return aa, share * inner[first, -1] + rest * inner[second, -1], float(inner[-1, -1])


@lru_cache(maxsize=4)
def atom_pairs(N: int, per_material: int) -> tuple[Indices, Indices, Array]:
    """Indices and shares of all mixtures: each atom alone, and every pair in every share."""
    of = np.repeat(np.arange(N), per_material)
    i, j = np.triu_indices(len(of), 1)
    is_one = of[i] == of[j]
    two = np.flatnonzero(~is_one)
    if len(two) > _MOST_PAIRS:
        two = np.sort(np.random.default_rng(0).choice(two, _MOST_PAIRS, replace=False))
    kept = np.concatenate([np.flatnonzero(is_one), two])
    alone, i, j = np.arange(len(of)), i[kept], j[kept]
    first = np.concatenate([alone, *([i] * len(SHARES))])
    second = np.concatenate([alone, *([j] * len(SHARES))])
    return first, second, np.concatenate([np.ones(len(of)), np.repeat(SHARES, len(i))])


def two_nonnegative(aa: Array, ab: Array, bb: float, a: Array, b: float) -> tuple[Array, Array]:
    """x, y >= 0 that minimise `aa x^2 + 2 ab x y + bb y^2 - 2 (a x + b y)`, problem by problem."""
    determinant = aa * bb - ab**2
    x, y = (a * bb - b * ab) / determinant, (b * aa - a * ab) / determinant
    x, y = np.where(y < 0.0, a / aa, x), np.maximum(y, 0.0)
    y = np.where(x < 0.0, max(b, 0.0) / bb, y)
    return np.maximum(x, 0.0), y
