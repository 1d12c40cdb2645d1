"""Valleys in highlights: in-plane minima near the mirror direction, which measured materials hardly have."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from manifold.directions import from_spherical
from manifold.records import Array

LAYOUT_INCIDENCES_DEG = (25.0, 40.0, 50.0, 65.0)
JUDGED_INCIDENCES_DEG = (30.0, 45.0, 60.0)
"""Others than those that maps are laid out by, so that predictions are judged by what nothing was made to meet."""
REACH_DEG = 20.0
"""How far from the mirror direction profiles go."""


def profile_pairs(incidences_deg: Sequence[float] = LAYOUT_INCIDENCES_DEG) -> tuple[Array, Array]:
    """Directions wi (I, 1, 3) and wo (I, D, 3): in the plane of incidence, around the mirror direction."""
    offset = np.arange(-REACH_DEG, REACH_DEG + 1.0)
    incidence = np.array(incidences_deg)
    outgoing = np.deg2rad(np.minimum(incidence[:, None] + offset, 85.0))
    wo = np.stack([-np.sin(outgoing), np.zeros_like(outgoing), np.cos(outgoing)], axis=2)
    return from_spherical(np.deg2rad(incidence), np.zeros(len(incidence)))[:, None], wo


def valley_depth(f: Array) -> Array:
    """How far profiles f (..., D) fall below the lower of the highest values on both sides, as a share of it, (...)."""
    left = np.maximum.accumulate(f, axis=-1)
    right = np.maximum.accumulate(f[..., ::-1], axis=-1)[..., ::-1]
    sides = np.minimum(left, right)
    return np.max(1.0 - f / np.maximum(sides, 1e-9), axis=-1)


def valley_excess(u: Array, profiles: Array, limit: float) -> tuple[Array, Array]:
    """How much deeper than `limit` the valleys of blends are.

    Args:
        u: weights of blends, shape (K, N).
        profiles: cube roots of the materials at `profile_pairs()` or some of them, shape (N, I, D, B).
        limit: depth that any blend may have.
    Returns:
        Shape (K,), and its gradient by u, (K, N).
    """
    N, n_incidences, D, B = profiles.shape
    roots = (u @ profiles.reshape(N, -1)).reshape(len(u), n_incidences, D, B)
    f = (roots**3).mean(axis=3)  # [K, I, D]
    left = np.maximum.accumulate(f, axis=2)
    right = np.maximum.accumulate(f[..., ::-1], axis=2)[..., ::-1]
    depth = (1.0 - f / np.maximum(np.minimum(left, right), 1e-9)).reshape(len(u), -1)
    deepest = depth.argmax(axis=1)
    excess = np.maximum(depth[np.arange(len(u)), deepest] - limit, 0.0)
    gradient = np.zeros_like(u)
    k = np.flatnonzero(excess)
    i, bottom = np.divmod(deepest[k], D)
    at = np.arange(D)[None]
    on_lower_side = np.where(left[k, i, bottom] <= right[k, i, bottom], 1, -1)
    beyond = (at - bottom[:, None]) * on_lower_side[:, None] <= 0
    side = np.where(beyond, f[k, i], -1.0).argmax(axis=1)

    def slope(d: Array) -> Array:
        """Gradient of f at incidences i and directions d by u, (len(k), N)."""
        return np.einsum("kb,nkb->kn", roots[k, i, d] ** 2, profiles[:, i, d]) * (3.0 / B)

    low, high = f[k, i, bottom][:, None], f[k, i, side][:, None]
    gradient[k] = low / high**2 * slope(side) - slope(bottom) / high
    return excess, gradient
