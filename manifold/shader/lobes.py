"""Samples a shader by a mixture of a cosine and two GGX lobes, which needs no table and no search.

The density is a formula, and therefore exact for every material. The lobes, and their weights at each angle of
incidence, are chosen so that the variance of `f cos / density` is small.

Source: Eto & Tokuyoshi 2023, "Bounded VNDF sampling for Smith-GGX reflections".
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from manifold.brdf.interface import EvaluableBRDF
from manifold.brdf.unmeasured_cells import STEEPEST
from manifold.colour.conversion import luminance
from manifold.core.directions import from_spherical, normalize
from manifold.core.records import Array

ALPHAS = tuple(float(f"{a:.3g}") for a in np.geomspace(0.004, 0.9, 12))
"""Roughnesses of the lobes that are tried; the nearest one is within 28 %, which increases the variance little."""

LEAST_COSINE = 0.05
"""Smallest weight of the cosine, which bounds `f cos / density` outside the lobes."""

_POINTS = 15  # a side of the square of variates, at which each candidate is sampled for the choice
_STEPS = 60  # of the weights' iteration; later ones change the variance by less than a percent


@dataclass(frozen=True, eq=False)
class Lobes:
    """A mixture of a cosine and GGX lobes.

    Attributes:
        alphas: roughness of the lobes, shape (2,).
        theta_i_rad: angles of incidence, increasing, shape (T,).
        weights: weights of the cosine and the lobes at these angles, shape (T, 3); rows sum to 1, and are
            interpolated linearly.
    """

    alphas: Array
    theta_i_rad: Array
    weights: Array

    def weights_at(self, wi: Array) -> Array:
        """Return the weights at directions (K, 3), shape (K, 3)."""
        theta = np.arctan2(np.hypot(wi[:, 0], wi[:, 1]), wi[:, 2])
        return np.stack([np.interp(theta, self.theta_i_rad, column) for column in self.weights.T], axis=1)

    def pdf(self, wi: Array, wo: Array) -> Array:
        """Return the density of `sample` in 1/sr at pairs (K, 3), shape (K,), 0 below the horizon."""
        weights = self.weights_at(wi)
        density = weights[:, 0] * np.maximum(wo[:, 2], 0.0) / np.pi
        for k, alpha in enumerate(self.alphas):
            density += weights[:, k + 1] * lobe_pdf(wi, wo, float(alpha))
        return np.where((wi[:, 2] > 0.0) & (wo[:, 2] > 0.0), density, 0.0)

    def sample(self, wi: Array, u: Array) -> tuple[Array, Array]:
        """Return directions (K, 3) for variates (K, 2), and their densities (K,); 0 below the horizon."""
        weights = self.weights_at(wi)
        first = np.concatenate([np.zeros((len(wi), 1)), np.cumsum(weights, axis=1)[:, :-1]], axis=1)
        chosen = (u[:, :1] >= first[:, 1:]).sum(axis=1)
        rows = np.arange(len(wi))
        within = (u[:, 0] - first[rows, chosen]) / np.maximum(weights[rows, chosen], 1e-9)
        u = np.column_stack([np.clip(within, 0.0, 1.0), u[:, 1]])
        wo = sample_cosine(u)
        for k, alpha in enumerate(self.alphas):
            of = chosen == k + 1
            wo[of] = sample_lobe(wi[of], u[of], float(alpha))
        return wo, self.pdf(wi, wo)


def sample_cosine(u: Array) -> Array:
    """Return directions (K, 3) with the density cos(theta) / pi for variates (K, 2)."""
    return from_spherical(np.arcsin(np.sqrt(u[:, 1])), 2.0 * np.pi * u[:, 0])


def sample_lobe(wi: Array, u: Array, alpha: float) -> Array:
    """Return reflections (K, 3) at visible GGX normals, mostly above the horizon, for variates u (K, 2)."""
    stretched = normalize(wi * [alpha, alpha, 1.0])
    bound = _bound(wi, alpha) * stretched[:, 2]
    z = (1.0 - u[:, 1]) * (1.0 + bound) - bound
    phi, sine = 2.0 * np.pi * u[:, 0], np.sqrt(np.maximum(1.0 - z * z, 0.0))
    m = (stretched + np.stack([sine * np.cos(phi), sine * np.sin(phi), z], axis=1)) * [alpha, alpha, 1.0]
    size = np.linalg.norm(m, axis=1, keepdims=True)
    m = np.where(size > 0.0, m / np.maximum(size, 1e-20), [0.0, 0.0, 1.0])  # 0 where a reflection grazes
    return np.asarray(2.0 * np.sum(wi * m, axis=1, keepdims=True) * m - wi)


def lobe_pdf(wi: Array, wo: Array, alpha: float) -> Array:
    """Return the density of `sample_lobe` in 1/sr at pairs (K, 3) above the horizon, shape (K,)."""
    m = wi + wo
    m = m / np.maximum(np.linalg.norm(m, axis=1, keepdims=True), 1e-20)
    a2 = alpha * alpha
    spread = (m[:, 0] ** 2 + m[:, 1] ** 2) / a2 + m[:, 2] ** 2
    length = np.sqrt(a2 * (wi[:, 0] ** 2 + wi[:, 1] ** 2) + wi[:, 2] ** 2)
    return np.asarray(1.0 / (np.pi * a2 * spread**2) / (2.0 * (_bound(wi, alpha) * wi[:, 2] + length)))


def _bound(wi: Array, alpha: float) -> Array:
    """Return the share of the spherical cap below the horizon that is sampled (Eto & Tokuyoshi 2023, eq. 5)."""
    a2, s2 = alpha * alpha, (1.0 + np.hypot(wi[:, 0], wi[:, 1])) ** 2
    return np.asarray((1.0 - a2) * s2 / (s2 + a2 * wi[:, 2] ** 2))


def fit_lobes(brdf: EvaluableBRDF, theta_i_rad: Array) -> Lobes:
    """Choose lobes and weights for a material at some angles of incidence, shape (T,).

    The second moment of `f cos / density`, of luminances, is minimised over the weights by a multiplicative iteration
    for each pair of roughnesses; the pair with the smallest sum of logarithms of these moments is chosen.
    """
    theta = np.asarray(theta_i_rad, float)
    fitted = theta[theta <= STEEPEST]
    fitted = fitted if len(fitted) else theta[:1]
    parts = [_moments(brdf, float(angle)) for angle in fitted]
    best, chosen = np.inf, (ALPHAS[0], ALPHAS[-1], np.zeros((len(fitted), 3)))
    for a, b in combinations(range(len(ALPHAS)), 2):
        found = [_weights(densities[[0, a + 1, b + 1]], squares) for densities, squares in parts]
        cost = float(sum(np.log(moment) for _, moment in found))
        if cost < best:
            best, chosen = cost, (ALPHAS[a], ALPHAS[b], np.stack([weights for weights, _ in found]))
    weights = np.stack([np.interp(theta, fitted, column) for column in chosen[2].T], axis=1)
    return Lobes(np.array(chosen[:2]), theta, weights)


def _moments(brdf: EvaluableBRDF, theta_i_rad: float) -> tuple[Array, Array]:
    """Return densities of all candidates (K, P) at points that all of them sample, and quadrature weights.

    The weights (P,) are of the squares of `f cos`: their sum over a density is the second moment.
    """
    across = (np.arange(_POINTS) + 0.5) / _POINTS
    u = np.stack(np.meshgrid(across, across), axis=-1).reshape(-1, 2)
    wi = np.broadcast_to(from_spherical(theta_i_rad, 0.0), (len(u), 3))
    wo = np.concatenate([sample_cosine(u), *(sample_lobe(wi, u, alpha) for alpha in ALPHAS)])
    wo = normalize(wo[wo[:, 2] > 1e-3])
    wi = np.broadcast_to(wi[0], wo.shape)
    densities = np.stack([wo[:, 2] / np.pi, *(lobe_pdf(wi, wo, alpha) for alpha in ALPHAS)])
    f_cos = np.maximum(luminance(brdf.eval(wi, wo), brdf.bands), 0.0) * wo[:, 2]
    squares = f_cos**2 / (len(u) * densities.sum(axis=0))
    return densities, squares


def _weights(densities: Array, squares: Array) -> tuple[Array, float]:
    """Return the weights (K,) of densities (K, P) with the smallest second moment, and that."""
    weights = np.full(len(densities), 1.0 / len(densities))
    moment = 1.0
    for _ in range(_STEPS):
        mixture = weights @ densities
        gains = densities @ (squares / mixture**2)
        moment = float(np.sum(squares / mixture))
        if moment <= 0.0:  # black
            return np.array([1.0, 0.0, 0.0]), 1.0
        weights = weights * np.sqrt(gains)
        weights /= weights.sum()
    weights[0] = max(weights[0], LEAST_COSINE)
    weights[1:] *= (1.0 - weights[0]) / max(weights[1:].sum(), 1e-9)
    return weights, moment
