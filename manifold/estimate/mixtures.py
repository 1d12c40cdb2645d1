"""Posterior over mixtures of two atoms, given a few readings of a material.

A dozen readings do not determine which atoms a material resembles, and thus its highlight between the readings: many
mixtures fit them. All are evaluated, and averaged by their posterior probability.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import solve_triangular

from manifold.estimate.residual import cells, covariance
from manifold.records import Array, Indices, Mask

SHARES = (0.5, 0.2, 0.8)  # of the first atom, besides 1
_MOST_PAIRS = 40_000  # pairs of atoms of two materials; of larger libraries as many at random
_REACH = 2.0  # correlation length of the residual of mixtures, in lengths of `residual`
_FREEDOM = 3.0  # degrees of freedom of Student's t: the variances of noise and residual are estimates
_TWO_COATS = 0.8  # share of mixtures of two coats among those that a coat is part of
_RELATIVE = 5.0  # exponent of the norm

NOISE = 0.02
"""Standard deviation of the noise of cube roots, relative to them and their root mean square."""

MODEL_ERROR = 0.04
"""Standard deviation of the residual of the best mixture, relative to the same."""

LIKE_ONE = 0.8
"""Prior probability that a material is like a single one of the library, in one band or between two."""

COATED = 0.05
"""Prior probability that a material is like dielectric coats, and not like those of the library."""

SCALE_SPREAD = 0.15
"""Standard deviation of the scale of atoms about 1, before anything is read."""

LAMBERTIAN_SPREAD = 0.5
"""Standard deviation of the weight of the Lambertian, before anything is read."""


@dataclass(frozen=True, eq=False)
class ReadingRoots:
    """Cube roots of a material and of atoms at P readings.

    Attributes:
        atoms: of n atoms and, last, of the Lambertian, shape (n + 1, P).
        material: in B bands, NaN where not measured, shape (B, P).
        weights: of the readings, shape (P,).
        where: coordinates of their directions, see `residual.coordinates`, shape (P, 3).
    """

    atoms: Array
    material: Array
    weights: Array
    where: Array

    def part(self, bands: Indices, readings: Mask) -> ReadingRoots:
        """Some bands, by index, at some readings, by mask."""
        material = self.material[bands][:, readings]
        return ReadingRoots(self.atoms[:, readings], material, self.weights[readings], self.where[readings])

    def whitened(self) -> tuple[Array, Array]:
        """Atoms (n + 1, C) and material (B, C): their differences are independent and of variance 1.

        C is the number of readings, or of averages of those that share a cell.
        """
        cell = cells(self.where)
        total = np.bincount(cell, self.weights)

        def averaged(rows: Array) -> Array:
            return np.array([np.bincount(cell, row * self.weights) for row in rows]) / total

        atoms, material, where = averaged(self.atoms), averaged(self.material), averaged(self.where.T).T
        square = np.mean(material**2, axis=0)
        level = np.sqrt(square + np.average(square, weights=total) + 1e-12)
        noise = np.diag(NOISE**2 / total) + MODEL_ERROR**2 * covariance(where / _REACH, where / _REACH)
        L = np.linalg.cholesky(noise)
        white = [solve_triangular(L, (rows / level).T, lower=True).T for rows in (atoms, material)]
        return white[0], white[1]


@dataclass(frozen=True, eq=False)
class Mixtures:
    """H mixtures `a (x g_i + (1 - x) g_j) + l L` of two atoms and a Lambertian, in cube roots.

    Attributes:
        first, second: i and j, shape (H,).
        share: x, shape (H,).
        scale: a, shape (H,).
        lambertian: l, shape (H,).
        probability: posterior, shape (H,), of sum 1.
        n_atoms: n; the Lambertian is atom n.
    """

    first: Indices
    second: Indices
    share: Array
    scale: Array
    lambertian: Array
    probability: Array
    n_atoms: int

    def weights(self, k: int) -> Array:
        """Weights of atoms and Lambertian in mixture k, shape (n + 1,)."""
        weights = np.zeros(self.n_atoms + 1)
        weights[self.first[k]] += self.scale[k] * self.share[k]
        weights[self.second[k]] += self.scale[k] * (1.0 - self.share[k])
        weights[-1] += self.lambertian[k]
        return weights

    def most_probable(self, count: int) -> Indices:
        """The mixtures of the largest probability, at most `count`, most probable first."""
        count = min(count, len(self.probability))
        some = np.sort(np.argpartition(-self.probability, count - 1)[:count])
        return some[np.argsort(-self.probability[some], kind="stable")]


def posterior(
    read: ReadingRoots, gram: Array, material_of: Indices, n_library: int | None = None
) -> Mixtures:
    """Posterior probabilities of mixtures of two atoms, given readings of a material in one band.

    Scale and Lambertian of every mixture are those of largest posterior density. The likelihood is Student's t in cube
    roots, with residuals that are correlated at nearby directions; its heavy tails keep several mixtures probable where
    none fits the readings. It is divided by the fifth power of the mixture's norm: errors are relative, so that a
    predicted highlight that does not exist costs more than one that is missing.

    Args:
        read: the readings, B = 1.
        gram: inner products of atoms over all directions, shape (n + 1, n + 1).
        material_of: which of N materials an atom is of, as many atoms of each; N for the Lambertian; shape (n + 1,).
        n_library: n, how many of the materials are measured ones; all by default. The others are coats.
    """
    N = int(material_of[-1])
    first, second, share = atom_pairs(N, (len(material_of) - 1) // N)
    log_prior = log_prior_of(material_of[first], material_of[second], material_prior(N, n_library))
    X, (y,) = read.whitened()
    scale, lambertian, misfit = scaled_mixtures(X, y, first, second, share)
    everywhere, n_readings = MixtureProducts.of(gram, first, second, share), len(y)
    X, y = read.atoms * np.sqrt(read.weights / len(read.weights)), read.material[0]
    y = y * np.sqrt(read.weights / len(read.weights))
    with_read, read_products = X @ y, MixtureProducts.of(X @ X.T, first, second, share)
    cross = (
        scale * (share * with_read[first] + (1.0 - share) * with_read[second]) + lambertian * with_read[-1]
    )
    unexplained = np.maximum(read_products.norm(scale, lambertian) - 2.0 * cross + y @ y, 0.0)
    norm = everywhere.norm(scale, lambertian) + unexplained
    probability = normalised(log_prior + log_likelihood(misfit, n_readings) - log_of_norm(norm))
    return Mixtures(first, second, share, scale, lambertian, probability, len(X) - 1)


def scaled_mixtures(
    X: Array, y: Array, first: Indices, second: Indices, share: Array
) -> tuple[Array, Array, Array]:
    """Scale and weight of the Lambertian of largest posterior density of every mixture, and its squared error: (H,).

    Args:
        X: what atoms and, last, the Lambertian are at readings, whitened: errors have variance 1; shape (n + 1, R).
        y: what was read, shape (R,).
        first, second, share: of the mixtures, shape (H,).
    """
    with_seen, inner = X @ y, MixtureProducts.of(X @ X.T, first, second, share)
    # Gaussian priors of scale and Lambertian, as terms of the normal equations.
    of_scale, of_lambertian = SCALE_SPREAD**-2, LAMBERTIAN_SPREAD**-2
    inner = MixtureProducts(inner.aa + of_scale, inner.al, inner.ll + of_lambertian)
    of_mixture = share * with_seen[first] + (1.0 - share) * with_seen[second] + of_scale
    scale, lambertian = two_nonnegative(inner.aa, inner.al, inner.ll, of_mixture, float(with_seen[-1]))
    misfit = inner.norm(scale, lambertian) - 2.0 * (of_mixture * scale + with_seen[-1] * lambertian)
    return scale, lambertian, np.maximum(misfit + y @ y + of_scale, 0.0)


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


def log_of_norm(norm: Array) -> Array:
    """Penalty on the squared norm of mixtures over all directions and of what they do not explain, above 0.

    Errors are relative: a mixture as dark as possible would be the best, if what it misses of the readings did not
    count as light, too.
    """
    return np.asarray(0.5 * _RELATIVE * np.log(norm))


def normalised(log_probability: Array) -> Array:
    """Probabilities of sum 1 from their logarithms up to a constant."""
    probability = np.exp(log_probability - log_probability.max())
    return np.asarray(probability / probability.sum())


@dataclass(frozen=True, eq=False)
class MixtureProducts:
    """Inner products of mixtures `x g_i + (1 - x) g_j` with themselves (H,), with the Lambertian (H,), and its own."""

    aa: Array
    al: Array
    ll: float

    @classmethod
    def of(cls, inner: Array, first: Indices, second: Indices, share: Array) -> MixtureProducts:
        """From inner products of atoms and Lambertian, shape (n + 1, n + 1)."""
        rest = 1.0 - share
        own = np.diagonal(inner)
        aa = share**2 * own[first] + 2.0 * share * rest * inner[first, second] + rest**2 * own[second]
        return cls(aa, share * inner[first, -1] + rest * inner[second, -1], float(inner[-1, -1]))

    def norm(self, scale: Array, lambertian: Array) -> Array:
        """Squared norms of scaled mixtures with a Lambertian, shape (H,)."""
        return scale**2 * self.aa + 2.0 * scale * lambertian * self.al + lambertian**2 * self.ll


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
