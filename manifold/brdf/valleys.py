"""Valleys in highlights: in-plane minima near the mirror direction, which measured materials hardly have."""

from __future__ import annotations

from collections.abc import Sequence

import numba as nb
import numpy as np

from manifold.directions import from_spherical
from manifold.records import Array

LAYOUT_INCIDENCES_DEG = (25.0, 40.0, 50.0, 65.0)
JUDGED_INCIDENCES_DEG = (30.0, 45.0, 60.0)
"""Not those of layouts, so that predictions are judged at incidences for which nothing was optimised."""
REACH_DEG = 20.0
"""Largest angle of profiles from the mirror direction."""
_DARK = 1e-9  # 1/sr


def profile_pairs(incidences_deg: Sequence[float] = LAYOUT_INCIDENCES_DEG) -> tuple[Array, Array]:
    """Directions wi (I, 1, 3) and wo (I, D, 3): in the plane of incidence, around the mirror direction."""
    offset = np.arange(-REACH_DEG, REACH_DEG + 1.0)
    incidence = np.array(incidences_deg)
    outgoing = np.deg2rad(np.minimum(incidence[:, None] + offset, 85.0))
    wo = np.stack([-np.sin(outgoing), np.zeros_like(outgoing), np.cos(outgoing)], axis=2)
    return from_spherical(np.deg2rad(incidence), np.zeros(len(incidence)))[:, None], wo


def valley_depth(f: Array) -> Array:
    """Depth of the deepest minimum of profiles f (..., D), relative to the lower of the maxima on its two sides, (...).

    0 where all values are dark.
    """
    f = np.asarray(f, dtype=np.float64)
    depth = np.empty(f.shape[:-1])
    _deepest(f.reshape(-1, f.shape[-1]), depth.reshape(-1))
    return depth[()]


@nb.njit(cache=True)
def _deepest(f, depth):
    """`valley_depth` of profiles (K, D), into depth (K,): running maxima of short rows are slow in numpy."""
    left = np.empty(f.shape[1])  # the highest value up to each direction
    for k in range(f.shape[0]):
        highest = f[k, 0]
        for d in range(f.shape[1]):
            highest = np.maximum(highest, f[k, d])
            left[d] = highest
        highest, deepest = f[k, -1], 0.0
        for d in range(f.shape[1] - 1, -1, -1):
            highest = np.maximum(highest, f[k, d])
            side = min(left[d], highest)
            deepest = np.maximum(deepest, (side - f[k, d]) / max(side, _DARK))
        depth[k] = deepest


def valley_excess(u: Array, profiles: Array, limits: Array) -> tuple[Array, Array]:
    """Depth of the valleys of blends beyond the mean of the depths allowed for their materials.

    Args:
        u: weights of blends, shape (K, N).
        profiles: cube roots of the materials at `profile_pairs()` or some of them, shape (N, I, D, B).
        limits: depth that each material may have, shape (N,).
    Returns:
        Shape (K,), and its gradient by u, (K, N).
    """
    N, n_incidences, D, B = profiles.shape
    roots = (u @ profiles.reshape(N, -1)).reshape(len(u), n_incidences, D, B)
    cubes = roots**3
    f = sum(cubes[..., b] for b in range(B)) / B  # [K, I, D]; the mean is slow along a short axis
    excess = np.maximum(valley_depth(f).max(axis=1) - u @ limits, 0.0)
    gradient = np.zeros_like(u)
    k = np.flatnonzero(excess)
    f, roots = f[k], roots[k]
    left = np.maximum.accumulate(f, axis=2)
    right = np.maximum.accumulate(f[..., ::-1], axis=2)[..., ::-1]
    sides = np.minimum(left, right)
    depth = (sides - f) / np.maximum(sides, _DARK)
    i, bottom = np.divmod(depth.reshape(len(k), n_incidences * D).argmax(axis=1), D)
    row = np.arange(len(k))
    at = np.arange(D)[None]
    on_lower_side = np.where(left[row, i, bottom] <= right[row, i, bottom], 1, -1)
    beyond = (at - bottom[:, None]) * on_lower_side[:, None] <= 0
    side = np.where(beyond, f[row, i], -1.0).argmax(axis=1)

    def slope(d: Array) -> Array:
        """Gradient of f at incidences i and directions d by u, (len(k), N)."""
        return np.einsum("kb,nkb->kn", roots[row, i, d] ** 2, profiles[:, i, d]) * (3.0 / B)

    low, high = f[row, i, bottom][:, None], f[row, i, side][:, None]
    gradient[k] = low / high**2 * slope(side) - slope(bottom) / high - limits
    return excess, gradient
