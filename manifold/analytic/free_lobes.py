"""Analytic basis BRDFs: a Lambertian, microfacet lobes with a free Fresnel term, and soft lobes.

A lobe is `D(theta_h) G(wi, wo) / (4 cos(theta_i) cos(theta_o)) * b_k(cos(theta_d))`. The Bernstein polynomials `b_k`
are never negative and sum to 1; Schlick's Fresnel term, `F0 + (1 - F0) (1 - cos(theta_d))^5`, is
`F0 sum_k b_k + (1 - F0) b_0` at degree 5, so that non-negative weights represent it, and approximate thin films and
flakes. Soft lobes, `(b_j(cos(theta_i)) b_k(cos(theta_o)) + b_k(cos(theta_i)) b_j(cos(theta_o))) / pi`, describe how
the reflection of a rough body towards the horizon deviates from a Lambertian's.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement
from math import comb

import numpy as np

from manifold.analytic.ggx import GGX, normal_distribution
from manifold.core.records import Array, Indices

ROUGHNESSES = tuple((0.004 * 2.0 ** np.arange(8)).tolist())  # 14 of them, by factors of 1.5, gain nothing
TAILS = (1.5, 2.0, 3.0)
DEGREE = 5


@dataclass(frozen=True)
class Lobes:
    """Basis BRDFs: a Lambertian of albedo 1, microfacet lobes, and soft lobes, in this order.

    There is one microfacet lobe for every roughness, tail and polynomial; the polynomial varies fastest.

    Attributes:
        roughnesses: values of alpha, each in (0, 1).
        tails: exponents of the normal distribution, each above 1; 2 is GGX, smaller exponents give longer tails.
        degree: degree of the Bernstein polynomials.
        soft_degree: degree of the polynomials of soft lobes, of which every pair makes a lobe; 0 for no soft lobes.
    """

    roughnesses: tuple[float, ...] = ROUGHNESSES
    tails: tuple[float, ...] = TAILS
    degree: int = DEGREE
    soft_degree: int = 0

    def __len__(self) -> int:
        return 1 + len(self.shapes) * (self.degree + 1) + len(self._soft)

    @property
    def _soft(self) -> list[tuple[int, int]]:
        """The pairs of polynomials that make the soft lobes."""
        return list(combinations_with_replacement(range(self.soft_degree + 1), 2)) if self.soft_degree else []

    @property
    def shapes(self) -> list[tuple[float, float]]:
        """Roughness and tail (exponent) of every normal distribution."""
        return [(alpha, tail) for alpha in self.roughnesses for tail in self.tails]

    def shape_of(self, chosen: Indices) -> Indices:
        """Return the index in `shapes` of each lobe's distribution, (n,); -1 for the Lambertian and soft lobes."""
        shape = (chosen - 1) // (self.degree + 1)
        return np.where(shape < len(self.shapes), shape, -1)

    def values(self, wi: Array, wo: Array, chosen: Indices | None = None) -> Array:
        """Return the BRDFs of the chosen lobes, by default all, in 1/sr, shape (n, P); 0 below the horizon."""
        chosen = np.arange(len(self)) if chosen is None else chosen
        shape, power = self.shape_of(chosen), (chosen - 1) % (self.degree + 1)
        f = np.full((len(chosen), len(wi)), 1.0 / np.pi)
        if np.any(shape >= 0):
            fresnel = bernstein(cos_theta_d(wi, wo), self.degree)
            cosine = cos_theta_h(wi, wo)
        masking: dict[float, Array] = {}
        for k in np.unique(shape[shape >= 0]):
            rows, (alpha, tail) = shape == k, self.shapes[k]
            if alpha not in masking:
                masking[alpha] = _masking(wi, wo, alpha)
            f[rows] = normal_distribution(cosine, alpha, tail) * masking[alpha] * fresnel[power[rows]]
        first = len(self) - len(self._soft)
        if np.any(chosen >= first):
            b = [bernstein(np.clip(w[:, 2], 0.0, 1.0), self.soft_degree) for w in (wi, wo)]
        for row in np.flatnonzero(chosen >= first):
            j, k = self._soft[chosen[row] - first]
            f[row] = (b[0][j] * b[1][k] + b[0][k] * b[1][j]) / np.pi
        return np.where((wi[:, 2] > 0.0) & (wo[:, 2] > 0.0), f, 0.0)

    def cube_roots(self, wi: Array, wo: Array) -> Array:
        """Return `f^(1/3)` of all lobes, see `values`."""
        return np.cbrt(self.values(wi, wo))


def microfacet_lobe(wi: Array, wo: Array, alpha: float, tail: float = 2.0) -> Array:
    """Return `D G / (4 cos(theta_i) cos(theta_o))` of a perfect reflector in 1/sr, shape (P,).

    Values below the horizon are undefined. The masking is that of GGX for every tail; see `normal_distribution`.
    """
    return normal_distribution(cos_theta_h(wi, wo), alpha, tail) * _masking(wi, wo, alpha)


def _masking(wi: Array, wo: Array, alpha: float) -> Array:
    """Return the masking of GGX, shape (P,), with cosines of at least 1e-9."""
    above = (np.maximum(w, [-1.0, -1.0, 1e-9]) for w in (wi, wo))
    return GGX.isotropic(alpha).masking(*above)


def cos_theta_h(wi: Array, wo: Array) -> Array:
    """Return the cosine between the half vector of directions (P, 3) and the normal, shape (P,).

    It is 0 between opposite directions.
    """
    h = wi + wo
    return h[:, 2] / np.maximum(np.linalg.norm(h, axis=1), np.finfo(float).tiny)


def cos_theta_d(wi: Array, wo: Array) -> Array:
    """Return the cosine between directions (P, 3) and their half vector, shape (P,)."""
    return np.clip(0.5 * np.linalg.norm(wi + wo, axis=1), 0.0, 1.0)


def bernstein(x: Array, degree: int) -> Array:
    """Return the Bernstein polynomials of x (P,) in [0, 1], shape (degree + 1, P).

    They are non-negative and sum to 1.
    """
    return np.array([comb(degree, k) * x**k * (1.0 - x) ** (degree - k) for k in range(degree + 1)])
