"""Valleys in highlights: in-plane minima near the mirror direction, which are small in measured materials."""

from __future__ import annotations

from collections.abc import Sequence

import numba as nb
import numpy as np
from scipy.sparse import csr_array

from manifold.directions import from_spherical, rotate_z
from manifold.records import Array, Indices

LAYOUT_INCIDENCES_DEG = (25.0, 40.0, 50.0, 65.0)
ASSESSED_INCIDENCES_DEG = (30.0, 45.0, 60.0)
"""Not those of layouts: predictions are assessed at incidences for which nothing was optimised."""
LAYOUT_AZIMUTHS_DEG = (0.0, 45.0, 90.0, 135.0)
"""Of incidence, where a material is anisotropic: most look the same after half a turn."""
REACH_DEG = 20.0
"""Largest angle of profiles from the mirror direction."""
_DARK = 1e-9  # 1/sr
_SHARPNESS = 32  # power of the weights in smooth maxima


def profile_pairs(
    incidences_deg: Sequence[float] = LAYOUT_INCIDENCES_DEG, azimuths_deg: Sequence[float] = (0.0,)
) -> tuple[Array, Array]:
    """Directions wi (I, 1, 3) and wo (I, D, 3): in the plane of incidence, around the mirror direction.

    I counts all incidences at all azimuths.
    """
    offset = np.arange(-REACH_DEG, REACH_DEG + 1.0)
    incidence = np.array(incidences_deg)
    outgoing = np.deg2rad(np.minimum(incidence[:, None] + offset, 85.0))
    wo = np.stack([-np.sin(outgoing), np.zeros_like(outgoing), np.cos(outgoing)], axis=2)
    wi = from_spherical(np.deg2rad(incidence), 0.0)[:, None]
    azimuths = np.deg2rad(azimuths_deg)
    turned = [np.concatenate([rotate_z(w, azimuth) for azimuth in azimuths]) for w in (wi, wo)]
    return turned[0], turned[1]


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


def squared_valleys(u: Array, profiles: Array, limits: Array) -> tuple[Array, Array]:
    """Squared depths of the valleys of blends beyond the mean of the depths allowed for their materials, summed.

    Smooth in u, so that what minimises it does not depend on rounding: depths are summed over directions, where
    `valley_depth` takes the deepest, and the maxima on their sides are means weighted with the 32nd power of values.

    Args:
        u: weights of blends, shape (K, N).
        profiles: cube roots of the materials at `profile_pairs()` or some of them, shape (N, I, D, B).
        limits: depth that each material may have, shape (N,).
    Returns:
        Shape (K,), and its gradient by u, (K, N).
    """
    flat = profiles.reshape(len(profiles), -1)
    roots = (u @ flat).reshape(len(u), *profiles.shape[1:])
    value, k, by_roots, by_allowed = _squared(roots, u @ limits)
    gradient = np.zeros_like(u)
    gradient[k] = by_roots @ flat.T + by_allowed[:, None] * limits
    return value, gradient


def squared_valleys_of_some(
    u: Array, materials: Indices, profiles: Array, limits: Array
) -> tuple[Array, Array]:
    """`squared_valleys` of blends u (K, n) of some of the materials, (K, n) indices; the gradient is (K, n), too."""
    flat = profiles.reshape(len(profiles), -1)
    starts = np.arange(0, u.size + 1, u.shape[1])
    blends = csr_array((u.ravel(), materials.ravel(), starts), (len(u), len(flat)))
    roots = (blends @ flat).reshape(len(u), *profiles.shape[1:])
    value, k, by_roots, by_allowed = _squared(roots, np.sum(u * limits[materials], axis=1))
    gradient = np.zeros_like(u)
    for row, slope, by_limit in zip(k, by_roots, by_allowed, strict=True):
        some = materials[row]
        gradient[row] = flat[some] @ slope + by_limit * limits[some]
    return value, gradient


def _squared(roots: Array, allowed: Array) -> tuple[Array, Indices, Array, Array]:
    """Of blends with cube roots (K, I, D, B) and depths allowed (K,): `squared_valleys`, (K,).

    And which blends have any, (k,); the gradients of these by their roots, (k, I D B), and by what is allowed, (k,).
    """
    K, *of_profile, B = roots.shape
    cubes = roots**3
    f = sum(cubes[..., b] for b in range(B)) / B  # [K, I, D]; the mean is slow along a short axis
    k = np.flatnonzero(valley_depth(f).max(axis=1) > allowed)  # weighted means are no larger than maxima
    value = np.zeros(K)
    roots, f = roots[k], f[k]
    top = np.maximum(f.max(axis=2, keepdims=True), _DARK)
    less = (f / top) ** (_SHARPNESS - 1)
    power = less * f / top
    left_sum, right_sum = _sums_to(power), _sums_from(power)
    left, right = _sums_to(power * f) / left_sum, _sums_from(power * f) / right_sum
    side = np.maximum(np.minimum(left, right), _DARK)
    depth = np.maximum(1.0 - f / side - allowed[k, None, None], 0.0)
    value[k] = np.sum(depth**2, axis=(1, 2))
    by_side = 2.0 * depth * f / side**2
    by_f = -2.0 * depth / side
    is_left = left <= right
    for slope, means, back in (
        (np.where(is_left, by_side, 0.0) / left_sum, left, _sums_from),
        (np.where(is_left, 0.0, by_side) / right_sum, right, _sums_to),
    ):
        by_f += (_SHARPNESS + 1) * power * back(slope) - _SHARPNESS * less / top * back(slope * means)
    by_roots = (3.0 / B) * by_f[..., None] * roots**2
    return value, k, by_roots.reshape(len(k), np.prod([*of_profile, B])), -2.0 * depth.sum(axis=(1, 2))


def _sums_to(f: Array) -> Array:
    """Sums of profiles (..., D) up to each direction."""
    return np.cumsum(f, axis=-1) + np.finfo(float).tiny


def _sums_from(f: Array) -> Array:
    """Sums of profiles (..., D) from each direction on."""
    return _sums_to(f[..., ::-1])[..., ::-1]
