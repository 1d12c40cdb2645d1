"""Directions in the local frame (z is the normal), and quadrature over them."""

from __future__ import annotations

import numpy as np

from manifold.errors import ShapeError
from manifold.records import Array


def from_spherical(theta_rad: Array | float, phi_rad: Array | float) -> Array:
    """Unit vectors (..., 3) of elevation from the normal and azimuth, both in radians, broadcast."""
    theta, phi = np.broadcast_arrays(np.asarray(theta_rad, float), np.asarray(phi_rad, float))
    sin_theta = np.sin(theta)
    return np.stack([sin_theta * np.cos(phi), sin_theta * np.sin(phi), np.cos(theta)], axis=-1)


def normalize(w: Array) -> Array:
    """Vectors (..., 3) scaled to unit length."""
    return w / np.linalg.norm(w, axis=-1, keepdims=True)


def half_vector(wi: Array, wo: Array) -> Array:
    """Unit half vectors (..., 3)."""
    return normalize(wi + wo)


def require_directions(w: Array, name: str) -> Array:
    """Directions as float64 (..., 3).

    Raises:
        ShapeError: the last axis is not 3, a value is not finite, or a vector is not of unit length (1e-3).
    """
    w = np.asarray(w, dtype=np.float64)
    if w.ndim == 0 or w.shape[-1] != 3:
        raise ShapeError(f"{name} has shape {w.shape}, expected (..., 3)")
    if not np.all(np.isfinite(w)):
        raise ShapeError(f"{name} has non-finite components, expected unit vectors; drop those directions")
    length_squared = np.einsum("...i,...i->...", w, w)
    if np.any(np.abs(length_squared - 1.0) > 2e-3):
        worst = float(np.sqrt(length_squared.flat[int(np.argmax(np.abs(length_squared - 1.0)))]))
        raise ShapeError(f"{name} has a vector of length {worst:.4g}, expected unit vectors; normalise them")
    return w


def hemisphere_quadrature(n_theta: int, n_phi: int) -> tuple[Array, Array]:
    """Nodes (n_theta * n_phi, 3) and solid-angle weights in sr over the upper hemisphere.

    Gauss-Legendre in the squared sine of the elevation, which absorbs one cosine, times a uniform azimuth:
    sum(weights * cos(theta)) is pi to rounding.
    """
    x, wx = np.polynomial.legendre.leggauss(n_theta)
    s2 = 0.5 * (x + 1.0)  # sin^2 theta in (0, 1); d omega cos theta = 0.5 d(s2) d phi
    theta = np.arcsin(np.sqrt(s2))
    phi = (np.arange(n_phi) + 0.5) * (2.0 * np.pi / n_phi)
    nodes = from_spherical(theta[:, None], phi[None, :]).reshape(-1, 3)
    projected = np.repeat(0.5 * (0.5 * wx) * (2.0 * np.pi / n_phi), n_phi)
    return nodes, projected / nodes[:, 2]
