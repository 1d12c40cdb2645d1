"""Reflectance of a thin film on a surface in linear sRGB, interference integrated over wavelengths in Fourier space.

Source: Belcour & Barla 2017, section 4, with two orders of interference, as KHR_materials_iridescence and MaterialX
1.39 simplify it; the colour matching functions are the Gaussians of the paper.
"""

from __future__ import annotations

import numpy as np

from manifold.fitting.exports.lobes import schlick
from manifold.records import Array

_ORDERS = 2
_HEIGHT = np.array([5.4856e-13, 4.4201e-13, 5.2481e-13, 9.7470e-14])  # of Gaussians for X, Y, Z, and X again
_WAVE_NUMBER = np.array([1.6810e6, 1.7953e6, 2.2084e6, 2.2399e6])  # 1/m
_VARIANCE = np.array([4.3278e9, 9.3046e9, 6.6121e9, 4.5282e9])
_NORM = 1.0685e-7
# glTF's, of D65; and MaterialX's, of CIE 1931 RGB and illuminant E
_FROM_XYZ_GLTF = np.array(
    [
        [3.2404542, -1.5371385, -0.4985314],
        [-0.9692660, 1.8760108, 0.0415560],
        [0.0556434, -0.2040259, 1.0572252],
    ]
)
_FROM_XYZ_MATERIALX = np.array(
    [
        [2.3706743, -0.9000405, -0.4706338],
        [-0.5138850, 1.4253036, 0.0885814],
        [0.0052982, -0.0146949, 1.0093968],
    ]
)


def film_over_f0(ior: float, thickness_nm: float, f0: Array, cosine: Array) -> Array:
    """Reflectance of a film on a surface that reflects `f0` (3,) at normal incidence, shape (P, 3).

    Args:
        ior: of the film, at least 1; outside it is 1.
        thickness_nm: of the film.
        f0: of the surface without the film.
        cosine: of the angle of incidence, shape (P,).
    Source: KHR_materials_iridescence: Schlick's term at both interfaces, no polarisation.
    """
    root = np.sqrt(np.clip(f0, 0.0, 0.9999))
    below = (1.0 + root) / (1.0 - root)
    inside = _refracted(cosine, ior)
    first = schlick(((ior - 1.0) / (ior + 1.0)) ** 2, 1.0, cosine)
    second = schlick(((below - ior) / (below + ior)) ** 2, 1.0, inside)
    shift = np.pi + np.where(below < ior, np.pi, 0.0)
    path_m = 2e-9 * ior * thickness_nm * inside
    product = np.clip(first * second, 1e-5, 0.9999)
    return np.maximum(_interference(first, second, product, path_m, shift, _FROM_XYZ_GLTF), 0.0)


def film_over_index(ior: float, thickness_nm: float, n: Array, k: Array, cosine: Array) -> Array:
    """Reflectance of a film on a surface of indices n + i k (3,), shape (P, 3), in [0, 1].

    Args:
        ior, thickness_nm, cosine: as in `film_over_f0`.
        n, k: of the surface, relative to the outside.
    Source: MaterialX 1.39, mx_fresnel_airy: Fresnel's equations and phases of both polarisations.
    """
    inside = _refracted(cosine, ior)
    path_m = 2e-9 * ior * thickness_nm * inside
    is_beyond_brewster = cosine < np.cos(np.arctan(ior))
    outer = (np.where(is_beyond_brewster, 0.0, np.pi), np.full(len(cosine), np.pi))
    total = sum(
        _interference(
            first,
            second,
            np.maximum(first * second, 0.0),
            path_m,
            inner + shift[:, None],
            _FROM_XYZ_MATERIALX,
        )
        for first, second, inner, shift in zip(
            _polarised(cosine, np.array([ior]), np.zeros(1)),
            _polarised(inside, n / ior, k / ior),
            _phases(inside, ior, n, k),
            outer,
            strict=True,
        )
    )
    return np.clip(0.5 * total, 0.0, 1.0)


def _refracted(cosine: Array, ior: float) -> Array:
    """Cosine of the angle inside the film, (P,)."""
    return np.sqrt(1.0 - (1.0 - cosine**2) / ior**2)


def _interference(
    first: Array, second: Array, product: Array, path_m: Array, shift: Array, from_xyz: Array
) -> Array:
    """Reflectance (P, 3) of two interfaces.

    Args:
        first, second, product: reflectances (P, 1) and (P, 3), and their product.
        path_m: difference of path, shape (P,).
        shift: of the phase, shape (3,) or (P, 3).
        from_xyz: matrix to RGB.
    """
    passed = 1.0 - first
    inner = passed**2 * second / (1.0 - product)
    total, term = first + inner, inner - passed
    for order in range(1, _ORDERS + 1):
        term = term * np.sqrt(product)
        total = total + 2.0 * term * (_sensitivity(order * path_m, order * shift) @ from_xyz.T)
    return total


def _sensitivity(path_m: Array, shift: Array) -> Array:
    """The colour matching functions' response (P, 3) to a cosine of the wave number."""
    phase = 2.0 * np.pi * path_m[:, None]
    shifts = np.concatenate([shift, shift[..., :1]], axis=-1)
    waves = _HEIGHT * np.sqrt(2.0 * np.pi * _VARIANCE) * np.cos(_WAVE_NUMBER * phase + shifts)
    waves = waves * np.exp(-_VARIANCE * phase**2) / _NORM
    waves[:, 0] += waves[:, 3]
    return waves[:, :3]


def _polarised(cosine: Array, n: Array, k: Array) -> tuple[Array, Array]:
    """Reflectances of an interface, parallel and perpendicular, (P, C) each, of relative indices n + i k (C,)."""
    c = cosine[:, None]
    c2, s2 = c * c, 1.0 - c * c
    t0 = n * n - k * k - s2
    a2b2 = np.sqrt(t0 * t0 + 4.0 * n * n * k * k)
    t1 = a2b2 + c2
    t2 = 2.0 * c * np.sqrt(np.maximum(0.5 * (a2b2 + t0), 0.0))
    perpendicular = (t1 - t2) / (t1 + t2)
    t3, t4 = c2 * a2b2 + s2 * s2, t2 * s2
    return perpendicular * (t3 - t4) / (t3 + t4), perpendicular


def _phases(cosine: Array, outside: float, n: Array, k: Array) -> tuple[Array, Array]:
    """Phases of reflection at an interface to n + i k (3,), parallel and perpendicular, (P, 3) each."""
    c = cosine[:, None]
    ratio = k / n
    a = n * n * (1.0 - ratio * ratio) - outside**2 * (1.0 - c * c)
    b = np.sqrt(a * a + (2.0 * n * n * ratio) ** 2)
    u, v = np.sqrt((a + b) / 2.0), np.sqrt(np.maximum((b - a) / 2.0, 0.0))
    perpendicular = np.arctan2(2.0 * outside * v * c, u * u + v * v - (outside * c) ** 2)
    parallel = np.arctan2(
        2.0 * outside * n * n * c * (2.0 * ratio * u - (1.0 - ratio * ratio) * v),
        (n * n * (1.0 + ratio * ratio) * c) ** 2 - outside**2 * (u * u + v * v),
    )
    return parallel, perpendicular
