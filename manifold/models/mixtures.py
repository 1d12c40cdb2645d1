"""Mixtures of two samples as hypotheses about a material of which a few readings are known, and what they say of it.

Which samples a material is like, and so how its highlight looks where nobody measured, is not determined by a dozen
readings: many mixtures meet them. They are all tried, and averaged by how well they do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from manifold.records import Array

_SHARES = (0.5, 0.2, 0.8)  # of the first sample, besides 1
_MOST_PAIRS = 40_000  # pairs of samples; of larger libraries as many at random
SHARP = 0.02
"""Noise of cube roots, as a share of them, by which mixtures give the best completions."""

BROAD = 0.1
"""Noise by which what they differ in tells how wrong completions are."""

_FREEDOM = (
    8.0  # degrees of freedom of the noise: where no mixture meets the readings, it was larger than thought
)
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
        count = min(count, len(self.probability))
        some = np.sort(np.argpartition(-self.probability, count - 1)[:count])
        return some[np.argsort(-self.probability[some], kind="stable")]


def posteriors(
    samples: Array,
    target: Array,
    weights: Array,
    gram: Array,
    noises: Sequence[float] = (SHARP,),
    *,
    relative: float = 6.0,
) -> list[Mixtures]:
    """How likely mixtures of two samples are, given readings of a material, for every noise.

    Scale and Lambertian of every mixture are those that meet the readings best, near the level of the samples. The
    likelihood is Student's t in cube roots, of noise that is not quite known: where no mixture meets the readings, none
    is certain. It is divided by `(v gram v)^(relative / 2)`, v being a mixture's weights: errors are relative, and a
    highlight that is not there costs more than one that is missed.

    Args:
        samples: cube roots of n samples and, last, of the Lambertian at the readings, shape (n + 1, P).
        target: cube roots of the material there, shape (P,).
        weights: of the readings, shape (P,).
        gram: inner products of samples over all directions, shape (n + 1, n + 1).
        noises: of cube roots, as a share of them.
        relative: exponent of the norm.
    """
    n = len(samples) - 1
    amplitude = np.sqrt(weights / (target**2 + _FLOOR**2 * np.average(target**2, weights=weights) + 1e-12))
    X, y = samples * amplitude, target * amplitude
    with_target = X @ y
    first, second, share = _pairs(n)
    at_readings, everywhere = (_Products.of(inner, first, second, share) for inner in (X @ X.T, gram))
    a_target = share * with_target[first] + (1.0 - share) * with_target[second]
    found = []
    for noise in noises:
        # Misfit times noise^2: what is known of scale and Lambertian beforehand is weighed instead.
        known_scale, known_lambertian = (noise / _SCALE_SPREAD) ** 2, (noise / _LAMBERTIAN_SPREAD) ** 2
        told = _Products(at_readings.aa + known_scale, at_readings.al, at_readings.ll + known_lambertian)
        scale, lambertian = _two_nonnegative(
            told.aa, told.al, told.ll, a_target + known_scale, float(with_target[n])
        )
        misfit = told.norm(scale, lambertian) - 2.0 * (
            (a_target + known_scale) * scale + with_target[n] * lambertian
        )
        misfit = np.maximum(misfit + y @ y + known_scale, 0.0)
        norm = np.maximum(everywhere.norm(scale, lambertian), np.finfo(float).tiny)
        log_likelihood = -0.5 * (_FREEDOM + len(y)) * np.log1p(misfit / (_FREEDOM * noise**2))
        log_probability = log_likelihood - 0.5 * relative * np.log(norm)
        probability = np.exp(log_probability - log_probability.max())
        found.append(Mixtures(first, second, share, scale, lambertian, probability / probability.sum(), n))
    return found


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


def _two_nonnegative(aa: Array, ab: Array, bb: float, a: Array, b: float) -> tuple[Array, Array]:
    """x, y >= 0 that minimise `aa x^2 + 2 ab x y + bb y^2 - 2 (a x + b y)`, problem by problem."""
    determinant = aa * bb - ab**2
    x, y = (a * bb - b * ab) / determinant, (b * aa - a * ab) / determinant
    x, y = np.where(y < 0.0, a / aa, x), np.maximum(y, 0.0)
    y = np.where(x < 0.0, max(b, 0.0) / bb, y)
    return np.maximum(x, 0.0), y
