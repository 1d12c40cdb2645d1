"""Directions in the local frame (z is the normal), and quadrature over them."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from manifold.core.errors import ShapeError
from manifold.core.records import Array, Mask

NEAR_MIRROR_DEG = 10.0
"""Angle around a mirror direction within which errors count as those of the highlight."""

SAME_RAD = 1e-3
"""Largest difference of directions, in radians, at which readings count as readings of one direction."""

HORIZON = np.deg2rad(89.9)
"""Polar angle in radians at which limits at the horizon are evaluated."""


def u_to_theta(u: Array) -> Array:
    """Return the polar angle in radians of the unit-square coordinate u in [0, 1] of RGL files: u^2 pi / 2."""
    return np.square(u) * (0.5 * np.pi)


def u_to_phi(v: Array) -> Array:
    """Return the azimuth in radians of the unit-square coordinate v in [0, 1] of RGL files: (2 v - 1) pi."""
    return (2.0 * np.asarray(v) - 1.0) * np.pi


def from_spherical(theta_rad: Array | float, phi_rad: Array | float) -> Array:
    """Return unit vectors (..., 3) for polar angles and azimuths, both in radians; the arrays broadcast."""
    theta, phi = np.asarray(theta_rad, float), np.asarray(phi_rad, float)
    sin_theta = np.sin(theta)
    return _stack(sin_theta * np.cos(phi), sin_theta * np.sin(phi), np.cos(theta))


def to_spherical(w: Array) -> tuple[Array, Array]:
    """Return the polar angle and the azimuth in (-pi, pi] of directions (..., 3), in radians."""
    return np.arctan2(np.hypot(w[..., 0], w[..., 1]), w[..., 2]), np.arctan2(w[..., 1], w[..., 0])


def normalize(w: Array) -> Array:
    """Scale vectors (..., 3) to unit length."""
    return np.asarray(w / np.linalg.norm(w, axis=-1, keepdims=True))


def half_vector(wi: Array, wo: Array) -> Array:
    """Return the unit half vectors (..., 3) of wi and wo (..., 3)."""
    return normalize(wi + wo)


def require_real(values: Array, name: str) -> Array:
    """Return values as an array of real numbers, in their own precision; None counts as NaN.

    Raises:
        ShapeError: the rows have different lengths, or the values are complex numbers or texts.
    """
    try:
        array = np.asarray(values)
        array = array.astype(np.float64) if array.dtype == object else array
    except (TypeError, ValueError) as error:
        raise ShapeError(f"{name}: rows of different lengths, or no numbers; expected one array") from error
    if array.dtype.kind not in "fiu":
        raise ShapeError(f"{name}: values of type {array.dtype}, expected real numbers")
    return array


def require_vectors(w: Array, name: str, width: int = 3) -> Array:
    """Return vectors as an array (..., width) of real numbers, in their own precision.

    Raises:
        ShapeError: as `require_real`, or the last axis has another size.
    """
    w = require_real(w, name)
    if w.ndim == 0 or w.shape[-1] != width:
        raise ShapeError(f"{name} has shape {w.shape}, expected (..., {width})")
    return w


def require_directions(w: Array, name: str) -> Array:
    """Return directions as float64 (..., 3).

    Raises:
        ShapeError: as `require_vectors`, or a value is not finite, or a vector is not of unit length (1e-3).
    """
    w = np.asarray(require_vectors(w, name), dtype=np.float64)
    length_squared = np.einsum("...i,...i->...", w, w)
    deviation = np.abs(length_squared - 1.0)
    if np.all(deviation <= 2e-3):
        return w
    if not np.all(np.isfinite(w)):
        raise ShapeError(f"{name} has non-finite components, expected unit vectors; drop those directions")
    worst = float(np.sqrt(length_squared.flat[int(np.argmax(deviation))]))
    raise ShapeError(f"{name} has a vector of length {worst:.4g}, expected unit vectors; normalise them")


@lru_cache(maxsize=32)
def gauss_legendre(n: int) -> tuple[Array, Array]:
    """Return the nodes in (-1, 1) and weights of Gauss-Legendre quadrature, each (n,), read-only."""
    x, weights = (a.astype(np.float64) for a in np.polynomial.legendre.leggauss(n))
    x.setflags(write=False)
    weights.setflags(write=False)
    return x, weights


def hemisphere_quadrature(n_theta: int, n_phi: int) -> tuple[Array, Array]:
    """Return the nodes (n_theta * n_phi, 3) and solid-angle weights in sr over the upper hemisphere.

    The nodes are Gauss-Legendre nodes in the squared sine of the polar angle and uniform in azimuth;
    `sum(weights * cos(theta))` is pi up to rounding.
    """
    x, wx = gauss_legendre(n_theta)
    s2 = 0.5 * (x + 1.0)  # sin^2 theta in (0, 1); d omega cos theta = 0.5 d(s2) d phi
    theta = np.arcsin(np.sqrt(s2))
    phi: Array = (np.arange(n_phi) + 0.5) * (2.0 * np.pi / n_phi)
    nodes = from_spherical(theta[:, None], phi[None, :]).reshape(-1, 3)
    projected = np.repeat(0.5 * (0.5 * wx) * (2.0 * np.pi / n_phi), n_phi)
    return nodes, projected / nodes[:, 2]


def from_rusinkiewicz(
    theta_h: Array, theta_d: Array, phi_d: Array, phi_h: Array | float = 0.0
) -> tuple[Array, Array]:
    """Return the direction pairs with half and difference angles in radians, which broadcast: two arrays (..., 3).

    The half vector is `(theta_h, phi_h)`; wi is `(theta_d, phi_d)` in its frame; wo is wi mirrored at the half
    vector.

    Source: Rusinkiewicz 1998, section 2.
    """
    theta_h, theta_d, phi_d = (np.asarray(a, dtype=np.float64) for a in (theta_h, theta_d, phi_d))
    sine, cosine = np.sin(theta_d), np.cos(theta_d)
    x, y = sine * np.cos(phi_d), sine * np.sin(phi_d)
    c, s = np.cos(theta_h), np.sin(theta_h)
    cx, sx, cz, sz = c * x, s * x, c * cosine, s * cosine
    # The mirrored vector has -x and -y: all products are shared, as grids have millions of pairs.
    pair = _stack(sz + cx, y, cz - sx), _stack(sz - cx, -y, cz + sx)
    if np.ndim(phi_h) or phi_h:
        pair = rotate_z(pair[0], phi_h), rotate_z(pair[1], phi_h)
    return normalize(pair[0]), normalize(pair[1])


def to_rusinkiewicz(wi: Array, wo: Array) -> tuple[Array, Array, Array, Array]:
    """Return `theta_h, theta_d, phi_d, phi_h` in radians of direction pairs (..., 3); azimuths in (-pi, pi].

    An azimuth is arbitrary if its polar angle is 0. Opposite directions have no half vector and give NaN.

    Source: Rusinkiewicz 1998, section 2.
    """
    with np.errstate(invalid="ignore"):
        h = half_vector(wi, wo)
    theta_h, phi_h = to_spherical(h)
    theta_d, phi_d = to_spherical(_rotate_y(rotate_z(wi, -phi_h), -theta_h))
    return theta_h, theta_d, phi_d, phi_h


def angles_from_mirror(wi: Array, wo: Array) -> Array:
    """Return polar angles of wi and wo (P, 3), and the azimuth of wo from the mirror direction, in degrees, (P, 3)."""
    theta = [np.degrees(np.arccos(np.clip(w[:, 2], -1.0, 1.0))) for w in (wi, wo)]
    phi = [np.degrees(np.arctan2(w[:, 1], w[:, 0])) for w in (wi, wo)]
    return np.column_stack([*theta, np.abs((phi[1] - phi[0]) % 360.0 - 180.0)])


def cos_from_mirror(wi: Array, wo: Array) -> Array:
    """Return the cosine of the angle between wo and the mirror direction of wi, (P, 3) each, shape (P,)."""
    return np.einsum("pi,pi->p", wi * [-1.0, -1.0, 1.0], wo)


def is_near_mirror(wi: Array, wo: Array) -> Mask:
    """Return a mask (P,) of the direction pairs within `NEAR_MIRROR_DEG` of the mirror direction."""
    return np.asarray(cos_from_mirror(wi, wo) > np.cos(np.deg2rad(NEAR_MIRROR_DEG)))


def _rotate_y(w: Array, angle: Array) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return _stack(c * w[..., 0] + s * w[..., 2], w[..., 1], c * w[..., 2] - s * w[..., 0])


def rotate_z(w: Array, angle: Array | float) -> Array:
    """Rotate vectors (..., 3) about the normal by an angle in rad."""
    c, s = np.cos(angle), np.sin(angle)
    return _stack(c * w[..., 0] - s * w[..., 1], s * w[..., 0] + c * w[..., 1], w[..., 2])


def _stack(x: Array, y: Array, z: Array) -> Array:
    """Return vectors (..., 3) of components, which broadcast."""
    w = np.empty((*np.broadcast_shapes(x.shape, y.shape, z.shape), 3))
    w[..., 0], w[..., 1], w[..., 2] = x, y, z
    return w
