"""Mixtures of two samples as hypotheses about a material of which a few readings are known, and what they say of it.

Which samples a material is like, and so how its highlight looks where nobody measured, is not determined by a dozen
readings: many mixtures meet them. They are all tried, and averaged by how well they do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from manifold.records import Array

_SHARES = (0.5, 0.2, 0.8)  # of the first sample, besides 1
_MOST_PAIRS = 40_000  # pairs of samples; of larger libraries as many at random
SHARP = 0.02
"""Noise of cube roots, as a share of them, by which mixtures give the best completions."""

BROAD = 0.1
"""Noise by which what they differ in tells how wrong completions are."""

_FLOOR = 0.3  # of the root mean square: where values are small, the noise is of this
_SCALE_SPREAD = 0.5  # samples are met at their own level, give or take this
_LAMBERTIAN_SPREAD = 0.5


@dataclass(frozen=True, eq=False)
class Mixtures:
    """H mixtures `a (x g_i + (1 - x) g_j) + l L` of two samples and a Lambertian, in cube roots, and their odds.

    Attributes:
        first, second: i and j, shape (H,).
        share: x, shape (H,).
        scale: a, shape (H,).
        lambertian: l, shape (H,).
        probability: shape (H,), of sum 1.
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
        np.add.at(weights, (rows, self.first[chosen]), (self.scale * self.share)[chosen])
        np.add.at(weights, (rows, self.second[chosen]), (self.scale * (1.0 - self.share))[chosen])
        weights[:, -1] += self.lambertian[chosen]
        return weights

    @property
    def mean(self) -> Array:
        """Weights averaged by probability, shape (n + 1,)."""
        weights = np.zeros(self.n_samples + 1)
        np.add.at(weights, self.first, self.probability * self.scale * self.share)
        np.add.at(weights, self.second, self.probability * self.scale * (1.0 - self.share))
        weights[-1] = self.probability @ self.lambertian
        return weights

    def likeliest(self, count: int) -> Array:
        """The mixtures of the largest probability, at most `count`, likeliest first."""
        return np.argsort(-self.probability, kind="stable")[:count]


def posterior(
    samples: Array, target: Array, weights: Array, gram: Array, *, noise: float = SHARP, relative: float = 4.0
) -> Mixtures:
    """How likely mixtures of two samples are, given readings of a material.

    Scale and Lambertian of every mixture are those that meet the readings best, near the level of the samples. The
    likelihood is Gaussian in cube roots. It is divided by `(v gram v)^(relative / 2)`, v being a mixture's weights:
    errors are relative, and a highlight that is not there costs more than one that is missed.

    Args:
        samples: cube roots of n samples and, last, of the Lambertian at the readings, shape (n + 1, P).
        target: cube roots of the material there, shape (P,).
        weights: of the readings, shape (P,).
        gram: inner products of samples over all directions, shape (n + 1, n + 1).
        noise: of cube roots, as a share of them.
        relative: exponent of the norm.
    """
    n = len(samples) - 1
    amplitude = np.sqrt(weights) / (
        noise * np.sqrt(target**2 + _FLOOR**2 * np.average(target**2, weights=weights) + 1e-12)
    )
    X, y = samples * amplitude, target * amplitude
    first, second, share = _pairs(n)
    inner, with_target = X @ X.T, X @ y
    scale_precision, lambertian_precision = _SCALE_SPREAD**-2, _LAMBERTIAN_SPREAD**-2
    saa = _of_pairs(inner, first, second, share) + scale_precision
    sal = share * inner[first, n] + (1.0 - share) * inner[second, n]
    sll = inner[n, n] + lambertian_precision
    sa = share * with_target[first] + (1.0 - share) * with_target[second] + scale_precision
    sl = with_target[n]
    scale, lambertian = _two_nonnegative(saa, sal, sll, sa, sl)
    misfit = (
        saa * scale**2 + 2.0 * sal * scale * lambertian + sll * lambertian**2
        - 2.0 * (sa * scale + sl * lambertian)
    )  # fmt: skip
    norm = (
        scale**2 * _of_pairs(gram, first, second, share)
        + 2.0 * scale * lambertian * (share * gram[first, n] + (1.0 - share) * gram[second, n])
        + lambertian**2 * gram[n, n]
    )
    log_probability = -0.5 * misfit - 0.5 * relative * np.log(np.maximum(norm, np.finfo(float).tiny))
    probability = np.exp(log_probability - log_probability.max())
    return Mixtures(first, second, share, scale, lambertian, probability / probability.sum(), n)


def _pairs(n: int) -> tuple[Array, Array, Array]:
    """Indices and shares of all mixtures of n samples: each alone, and every pair in every share."""
    i, j = np.triu_indices(n, 1)
    if len(i) > _MOST_PAIRS:
        some = np.random.default_rng(0).choice(len(i), _MOST_PAIRS, replace=False)
        i, j = i[some], j[some]
    alone = np.arange(n)
    first = np.concatenate([alone, *([i] * len(_SHARES))])
    second = np.concatenate([alone, *([j] * len(_SHARES))])
    return first, second, np.concatenate([np.ones(n), np.repeat(_SHARES, len(i))])


def _of_pairs(inner: Array, first: Array, second: Array, share: Array) -> Array:
    """Squared norms of mixtures, from inner products of samples."""
    rest = 1.0 - share
    return (
        share**2 * inner[first, first]
        + 2.0 * share * rest * inner[first, second]
        + rest**2 * inner[second, second]
    )


def _two_nonnegative(aa: Array, ab: Array, bb: float, a: Array, b: float) -> tuple[Array, Array]:
    """x, y >= 0 that minimise `aa x^2 + 2 ab x y + bb y^2 - 2 (a x + b y)`, problem by problem."""
    determinant = aa * bb - ab**2
    x, y = (a * bb - b * ab) / determinant, (b * aa - a * ab) / determinant
    x, y = np.where(y < 0.0, a / aa, x), np.maximum(y, 0.0)
    y = np.where(x < 0.0, max(b, 0.0) / bb, y)
    return np.maximum(x, 0.0), y
