"""Importance sampling of analytic lobes, to render predictions that contain them."""

from __future__ import annotations

import numpy as np

from manifold.brdf.analytic.base import choose_lobe, cosine_hemisphere
from manifold.directions import half_vector
from manifold.latent.lobes import Lobes, normal_distribution
from manifold.records import Array


class LobeSampling:
    """A density that covers lobes: normals of every distribution that has a weight, and a cosine lobe."""

    def __init__(self, lobes: Lobes, weights: Array) -> None:
        """Sample lobes in proportion to weights (n_l,), at least 0 and not all zero."""
        shape = lobes.shape_of(np.arange(len(lobes)))
        totals = np.bincount(shape + 1, weights)
        self._shapes = [None, *lobes.shapes]  # the Lambertian first
        self._shares = totals / totals.sum()

    def pdf(self, wi: Array, wo: Array) -> Array:
        """Density of `sample` in 1/sr, shape (...); 0 below the horizon."""
        wi, wo = np.broadcast_arrays(wi, wo)
        up = (wi[..., 2] > 0.0) & (wo[..., 2] > 0.0)
        h = half_vector(wi[up], wo[up])
        cos_h = h[:, 2]
        per_normal = cos_h / (4.0 * np.maximum(np.sum(wi[up] * h, axis=1), 1e-9))
        found = np.zeros(len(h))
        for share, shape in zip(self._shares, self._shapes, strict=True):
            if share > 0.0 and shape is None:
                found += share * wo[up][:, 2] / np.pi
            elif share > 0.0 and shape is not None:
                found += share * normal_distribution(cos_h, *shape) * per_normal
        density = np.zeros(up.shape)
        density[up] = found
        return density

    def sample(self, wi: Array, u: Array) -> tuple[Array, Array]:
        """Outgoing directions (P, 3) and their pdf (P,) for wi (P, 3) and uniform variates (P, 2).

        A pdf of 0 marks an invalid sample.
        """
        chosen, u = choose_lobe(self._shares, u)
        wo = cosine_hemisphere(u)
        for k, shape in enumerate(self._shapes):
            mine = chosen == k
            if shape is not None and np.any(mine):
                h = _normals(u[mine], *shape)
                wo[mine] = 2.0 * np.sum(wi[mine] * h, axis=1, keepdims=True) * h - wi[mine]
        return wo, self.pdf(wi, wo)


def _normals(u: Array, alpha: float, tail: float) -> Array:
    """Normals (P, 3) of density `D cos(theta_h)`: the inverse of its cumulative distribution."""
    a2 = alpha * alpha
    x = (a2 ** (1.0 - tail) * (1.0 - u[:, 1]) + u[:, 1]) ** (1.0 / (1.0 - tail))
    sin_squared = np.clip((x - a2) / (1.0 - a2), 0.0, 1.0)
    s, phi = np.sqrt(sin_squared), 2.0 * np.pi * u[:, 0]
    return np.stack([s * np.cos(phi), s * np.sin(phi), np.sqrt(1.0 - sin_squared)], axis=1)
