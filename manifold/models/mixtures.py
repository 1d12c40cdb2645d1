"""Posterior over mixtures of two samples, given a few readings of a material.

A dozen readings do not determine which samples a material resembles, and thus its highlight between the readings:
many mixtures fit them. All are evaluated, and averaged by their posterior probability.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import solve_triangular

from manifold.models.nearby import cells, covariance
from manifold.records import Array

SHARES = (0.5, 0.2, 0.8)  # of the first sample, besides 1
_MOST_PAIRS = 40_000  # pairs of samples of two materials; of larger libraries as many at random
_REACH = 2.0  # correlation length of the residual of mixtures, in lengths of `nearby`
_FREEDOM = 3.0  # degrees of freedom of Student's t: the variances of noise and residual are estimates
_LAMBERTIAN_SPREAD = 0.5  # standard deviation of the weight of the Lambertian, before anything is read
_RELATIVE = 5.0  # exponent of the norm

NOISE = 0.02
"""Standard deviation of the noise of cube roots, relative to them and their root mean square."""

MISSED = 0.04
"""Standard deviation of the residual of the best mixture, relative to the same."""

LIKE_ONE = 0.8
"""Prior probability that a material is like a single one of the library, in one band or between two."""

SCALE_SPREAD = 0.15
"""Standard deviation of the scale of samples about 1, before anything is read."""


@dataclass(frozen=True, eq=False)
class Mixtures:
    """H mixtures `a (x g_i + (1 - x) g_j) + l L` of two samples and a Lambertian, in cube roots.

    Attributes:
        first, second: i and j, shape (H,).
        share: x, shape (H,).
        scale: a, shape (H,).
        lambertian: l, shape (H,).
        probability: posterior, shape (H,), of sum 1.
        n_samples: n; the Lambertian is sample n.
    """

    first: Array
    second: Array
    share: Array
    scale: Array
    lambertian: Array
    probability: Array
    n_samples: int

    def weights(self, chosen: Array) -> Array:
        """Weights of samples and Lambertian in some mixtures (h,), shape (h, n + 1)."""
        rows, weights = np.arange(len(chosen)), np.zeros((len(chosen), self.n_samples + 1))
        scale, share = self.scale[chosen], self.share[chosen]
        np.add.at(weights, (rows, self.first[chosen]), scale * share)
        np.add.at(weights, (rows, self.second[chosen]), scale * (1.0 - share))
        weights[:, -1] += self.lambertian[chosen]
        return weights

    def most_probable(self, count: int) -> Array:
        """The mixtures of the largest probability, at most `count`, most probable first."""
        count = min(count, len(self.probability))
        some = np.sort(np.argpartition(-self.probability, count - 1)[:count])
        return some[np.argsort(-self.probability[some], kind="stable")]


def posterior(
    samples: Array, target: Array, weights: Array, where: Array, gram: Array, group: Array
) -> Mixtures:
    """Posterior probabilities of mixtures of two samples, given readings of a material.

    Scale and Lambertian of every mixture are those of largest posterior density. The likelihood is Student's t in cube
    roots, with residuals that are correlated at nearby directions; its heavy tails keep several mixtures probable where
    none fits the readings. It is divided by the fifth power of the mixture's norm: errors are relative, so that a
    predicted highlight that does not exist costs more than one that is missing.

    Args:
        samples: cube roots of n samples and, last, of the Lambertian at the readings, shape (n + 1, P).
        target: cube roots of the material there, shape (P,).
        weights: of the readings, shape (P,).
        where: coordinates of the readings, see `nearby.places`, shape (P, 3).
        gram: inner products of samples over all directions, shape (n + 1, n + 1).
        group: which material a sample is of, shape (n + 1,).
    """
    first, second, share, log_prior = _pairs(group.tobytes(), group.dtype.str)
    X, targets = independent(samples, target[None], weights, where)
    y = targets[0]
    with_target = X @ y
    at_readings, everywhere = (_Products.of(inner, first, second, share) for inner in (X @ X.T, gram))
    a_target = share * with_target[first] + (1.0 - share) * with_target[second]
    # Gaussian priors of scale and Lambertian, as terms of the normal equations.
    of_scale, of_lambertian = SCALE_SPREAD**-2, _LAMBERTIAN_SPREAD**-2
    told = _Products(at_readings.aa + of_scale, at_readings.al, at_readings.ll + of_lambertian)
    scale, lambertian = _two_nonnegative(
        told.aa, told.al, told.ll, a_target + of_scale, float(with_target[-1])
    )
    misfit = told.norm(scale, lambertian) - 2.0 * (
        (a_target + of_scale) * scale + with_target[-1] * lambertian
    )
    misfit = np.maximum(misfit + y @ y + of_scale, 0.0)
    norm = everywhere.norm(scale, lambertian)
    probability = normalised(log_prior + log_likelihood(misfit, len(y)) - log_of_norm(norm))
    return Mixtures(first, second, share, scale, lambertian, probability, len(samples) - 1)


def log_likelihood(misfit: Array, count: float) -> Array:
    """Log density of Student's t up to a constant, at the sum of `count` squared errors over their variance."""
    return np.asarray(-0.5 * (_FREEDOM + count) * np.log1p(misfit / _FREEDOM))


def log_of_norm(norm: Array) -> Array:
    """Penalty on the squared norm of mixtures over all directions, since errors are relative.

    Infinite for black mixtures, unless all are black.
    """
    is_black = norm <= np.finfo(float).tiny
    if is_black.all():
        return np.zeros_like(norm)
    return np.where(is_black, np.inf, 0.5 * _RELATIVE * np.log(np.where(is_black, 1.0, norm)))


def normalised(log_probability: Array) -> Array:
    """Probabilities of sum 1 from their logarithms up to a constant."""
    probability = np.exp(log_probability - log_probability.max())
    return np.asarray(probability / probability.sum())


def independent(samples: Array, targets: Array, weights: Array, where: Array) -> tuple[Array, Array]:
    """Samples (n + 1, C) and targets (B, C), whitened: their differences are independent and of variance 1.

    C is the number of readings, or of averages of those that share a cell.

    Args:
        samples: cube roots of n samples and, last, of the Lambertian at the readings, shape (n + 1, P).
        targets: cube roots of the material there, shape (B, P).
        weights: of the readings, shape (P,).
        where: coordinates of the readings, see `nearby.places`, shape (P, 3).
    """
    cell = cells(where)
    total = np.bincount(cell, weights)

    def averaged(rows: Array) -> Array:
        return np.array([np.bincount(cell, row * weights) for row in rows]) / total

    read, of_targets, places = averaged(samples), averaged(targets), averaged(where.T).T
    square = np.mean(of_targets**2, axis=0)
    level = np.sqrt(square + np.average(square, weights=total) + 1e-12)
    noise = np.diag(NOISE**2 / total) + MISSED**2 * covariance(places / _REACH, places / _REACH)
    L = np.linalg.cholesky(noise)
    apart = [solve_triangular(L, (rows / level).T, lower=True).T for rows in (read, of_targets)]
    return apart[0], apart[1]


@dataclass(frozen=True, eq=False)
class _Products:
    """Inner products of mixtures `x g_i + (1 - x) g_j` with themselves (H,), with the Lambertian (H,), and its own."""

    aa: Array
    al: Array
    ll: float

    @classmethod
    def of(cls, inner: Array, first: Array, second: Array, share: Array) -> _Products:
        """From inner products of samples and Lambertian, shape (n + 1, n + 1)."""
        rest = 1.0 - share
        own = np.diagonal(inner)
        aa = share**2 * own[first] + 2.0 * share * rest * inner[first, second] + rest**2 * own[second]
        return cls(aa, share * inner[first, -1] + rest * inner[second, -1], float(inner[-1, -1]))

    def norm(self, scale: Array, lambertian: Array) -> Array:
        """Squared norms of scaled mixtures with a Lambertian, shape (H,)."""
        return scale**2 * self.aa + 2.0 * scale * lambertian * self.al + lambertian**2 * self.ll


@lru_cache(maxsize=4)
def _pairs(group: bytes, dtype: str) -> tuple[Array, Array, Array, Array]:
    """Indices, shares and log priors of all mixtures: each sample alone, and every pair in every share."""
    of = np.frombuffer(group, dtype)[:-1]
    i, j = np.triu_indices(len(of), 1)
    is_one = of[i] == of[j]
    two = np.flatnonzero(~is_one)
    if len(two) > _MOST_PAIRS:
        two = np.sort(np.random.default_rng(0).choice(two, _MOST_PAIRS, replace=False))
    kept = np.concatenate([np.flatnonzero(is_one), two])
    alone, i, j = np.arange(len(of)), i[kept], j[kept]
    first = np.concatenate([alone, *([i] * len(SHARES))])
    second = np.concatenate([alone, *([j] * len(SHARES))])
    is_one = of[first] == of[second]
    count_one = int(is_one.sum())
    prior = np.where(is_one, LIKE_ONE / count_one, (1.0 - LIKE_ONE) / max(len(first) - count_one, 1))
    return first, second, np.concatenate([np.ones(len(of)), np.repeat(SHARES, len(i))]), np.log(prior)


def _two_nonnegative(aa: Array, ab: Array, bb: float, a: Array, b: float) -> tuple[Array, Array]:
    """x, y >= 0 that minimise `aa x^2 + 2 ab x y + bb y^2 - 2 (a x + b y)`, problem by problem."""
    determinant = aa * bb - ab**2
    x, y = (a * bb - b * ab) / determinant, (b * aa - a * ab) / determinant
    x, y = np.where(y < 0.0, a / aa, x), np.maximum(y, 0.0)
    y = np.where(x < 0.0, max(b, 0.0) / bb, y)
    return np.maximum(x, 0.0), y
