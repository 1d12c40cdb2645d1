"""Lobes and Fresnel terms of the engines' shading models, evaluated with NumPy.

Directions are unit vectors (P, 3) above the horizon, z the normal; values are in 1/sr without cosines.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from manifold.analytic.fresnel import fresnel_dielectric
from manifold.directions import normalize, rotate_z
from manifold.records import Array

_NODES, _SAMPLES = (
    33,
    24,
)  # of albedo tables: cosines, and samples per axis of the distribution of visible normals
_LEAST_ALPHA = 1e-4


@dataclass(frozen=True, eq=False)
class Pairs:
    """Directions to the viewer and to the light, with their half vectors.

    Attributes:
        view, light, half: unit vectors (P, 3).
        cos_v, cos_l, cos_h: with the normal, shape (P,).
        cos_d: between view and half vector, shape (P,).
    """

    view: Array
    light: Array
    half: Array
    cos_v: Array
    cos_l: Array
    cos_h: Array
    cos_d: Array

    @classmethod
    def of(cls, view: Array, light: Array, rotation_rad: float = 0.0) -> Pairs:
        """Pairs of directions, at least a little above the horizon, as a surface turned by an azimuth sees them."""
        if rotation_rad:
            view, light = rotate_z(view, -rotation_rad), rotate_z(light, -rotation_rad)
        half = normalize(view + light)
        least = 1e-6
        return cls(
            view, light, half, np.maximum(view[:, 2], least), np.maximum(light[:, 2], least),
            np.clip(half[:, 2], least, 1.0), np.clip(np.sum(view * half, axis=1), least, 1.0),
        )  # fmt: skip


def ggx(pairs: Pairs, alpha_x: float, alpha_y: float) -> Array:
    """GGX (Trowbridge-Reitz) distribution of half vectors, (P,). Source: Burley 2012, eq. 13."""
    ax, ay = max(alpha_x, _LEAST_ALPHA), max(alpha_y, _LEAST_ALPHA)
    x, y, z = (pairs.half[:, k] for k in range(3))
    return 1.0 / (np.pi * ax * ay * ((x / ax) ** 2 + (y / ay) ** 2 + z * z) ** 2)


def smith_g1(direction: Array, alpha_x: float, alpha_y: float) -> Array:
    """Smith's masking of GGX in one direction, (P,). Source: Walter et al. 2007, eq. 34."""
    x, y, z = (direction[:, k] for k in range(3))
    slope = ((alpha_x * x) ** 2 + (alpha_y * y) ** 2) / np.maximum(z * z, 1e-12)
    return 2.0 / (1.0 + np.sqrt(1.0 + slope))


def smith_correlated(cos_l: Array, cos_v: Array, alpha: float) -> Array:
    """Height-correlated Smith masking and shadowing. Source: Heitz 2014, eq. 99."""
    a2 = alpha * alpha
    of_l = np.sqrt(a2 + (1.0 - a2) * cos_l**2)
    of_v = np.sqrt(a2 + (1.0 - a2) * cos_v**2)
    return 2.0 * cos_l * cos_v / (of_l * cos_v + of_v * cos_l)


def specular_correlated(pairs: Pairs, alpha_x: float, alpha_y: float) -> Array:
    """`D G2 / (4 cos cos)` of GGX, (P,), G2 by the geometric mean of the alphas, as MaterialX has it."""
    g = smith_correlated(pairs.cos_l, pairs.cos_v, np.sqrt(alpha_x * alpha_y))
    return ggx(pairs, alpha_x, alpha_y) * g / (4.0 * pairs.cos_v * pairs.cos_l)


def specular_joint(pairs: Pairs, alpha_x: float, alpha_y: float) -> Array:
    """`D G2 / (4 cos cos)` of GGX, (P,), G2 height-correlated with both alphas. Source: Heitz 2014, eq. 99."""
    g = 1.0 / smith_g1(pairs.view, alpha_x, alpha_y) + 1.0 / smith_g1(pairs.light, alpha_x, alpha_y) - 1.0
    return ggx(pairs, alpha_x, alpha_y) / (4.0 * pairs.cos_v * pairs.cos_l * g)


def schlick(f0: Array | float, f90: Array | float, cosine: Array) -> Array:
    """Schlick's Fresnel term, (P, 3) for colours, else (P, 1)."""
    f0, f90 = np.atleast_1d(f0), np.atleast_1d(f90)
    return f0 + (f90 - f0) * (1.0 - cosine[:, None]) ** 5


def fresnel_f82(f0: Array, edge: Array, cosine: Array) -> Array:
    """Schlick's term with a colour at 82 degrees (F82-tint), (P, 3). Source: Hoffman 2019; Kutz et al. 2021."""
    return schlick(f0, 1.0, cosine) - f82_dip(f0, edge) * (cosine * (1.0 - cosine) ** 6)[:, None]


def f82_dip(f0: Array, edge: Array) -> Array:
    """Factor of `cos (1 - cos)^6` that F82-tint subtracts from Schlick's term, (3,)."""
    at = 1.0 / 7.0
    return (f0 + (1.0 - f0) * (1.0 - at) ** 5) * (1.0 - edge) / (at * (1.0 - at) ** 6)


def artistic_index(reflectivity: Array, edge: Array, most: float = 0.99) -> tuple[Array, Array]:
    """Indices n and k, (3,) each, of a metal by its colours, (3,). Source: Gulbrandsen 2014, as in MaterialX.

    Args:
        reflectivity, edge: along the normal and towards grazing.
        most: to which reflectivity is limited.
    """
    r = np.clip(reflectivity, 0.0, most)
    root = np.sqrt(r)
    n = (1.0 - edge) * (1.0 + root) / (1.0 - root) + edge * (1.0 - r) / (1.0 + r)
    k2 = ((n + 1.0) ** 2 * r - (n - 1.0) ** 2) / (1.0 - r)
    return n, np.sqrt(np.maximum(k2, 0.0))


def split_sum(alpha: float, cosine: Array) -> tuple[Array, Array]:
    """A and B of the directional albedo `f0 A + f90 B` of a correlated GGX lobe with Schlick's Fresnel, each (P,).

    Source: Karis 2013; by quadrature over the distribution of visible normals (Heitz 2018).
    """
    nodes, a, b = _split_sum_table(round(float(alpha), 6))
    return np.interp(cosine, nodes, a), np.interp(cosine, nodes, b)


def single_scattering(alpha: float, cosine: Array) -> tuple[Array, float]:
    """Directional albedo (P, 1) of a correlated GGX lobe without Fresnel, and its mean over the hemisphere."""
    nodes, a, b = _split_sum_table(round(float(alpha), 6))
    return np.interp(cosine, nodes, a + b)[:, None], float(np.trapezoid(2.0 * nodes * (a + b), nodes))


@lru_cache(maxsize=256)
def _split_sum_table(alpha: float) -> tuple[Array, Array, Array]:
    nodes, weight, cos_d = _visible_reflections(alpha)
    f = (1.0 - cos_d) ** 5
    return nodes, (weight * (1.0 - f)).mean(axis=1), (weight * f).mean(axis=1)


def dielectric_share(alpha: float, ior: float, cosine: Array) -> Array:
    """Mean of `(F - F0) / (1 - F0)` over a correlated GGX lobe seen along `cosine`, F of a dielectric, (P,)."""
    nodes, share = _dielectric_table(round(float(alpha), 6), round(float(ior), 6))
    return np.interp(cosine, nodes, share)


@lru_cache(maxsize=256)
def _dielectric_table(alpha: float, ior: float) -> tuple[Array, Array]:
    nodes, weight, cos_d = _visible_reflections(alpha)
    f = fresnel_dielectric(cos_d.ravel(), np.array([ior])).reshape(cos_d.shape)
    f0 = ((ior - 1.0) / (ior + 1.0)) ** 2
    return nodes, (weight * (f - f0)).mean(axis=1) / (weight.mean(axis=1) * (1.0 - f0))


@lru_cache(maxsize=16)
def _visible_reflections(alpha: float) -> tuple[Array, Array, Array]:
    """Cosines with the normal (C,), weights (C, S) and cosines with the half vector (C, S) of a lobe's samples."""
    alpha = max(alpha, 1e-3)
    nodes = np.linspace(0.0, 1.0, _NODES) ** 2  # dense at grazing
    nodes[0] = 1e-3
    u = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    u1, u2 = (a.ravel() for a in np.meshgrid(u, u))
    view = np.stack([np.sqrt(1.0 - nodes**2), np.zeros(_NODES), nodes], axis=1)
    stretched = normalize(view * [alpha, alpha, 1.0])[:, None]  # [C, 1, 3]
    z = (1.0 - u2) * (1.0 + stretched[..., 2]) - stretched[..., 2]
    r = np.sqrt(np.clip(1.0 - z * z, 0.0, 1.0))
    normal = np.stack([r * np.cos(2 * np.pi * u1), r * np.sin(2 * np.pi * u1), z], axis=-1) + stretched
    normal = normalize(normal * [alpha, alpha, 1.0])
    cos_d = np.einsum("ck,csk->cs", view, normal)
    cos_l = 2.0 * cos_d * normal[..., 2] - nodes[:, None]
    lit = cos_l > 0
    safe = np.where(lit, cos_l, 1.0)
    cos_v = np.broadcast_to(nodes[:, None], safe.shape)
    g1 = 2.0 / (1.0 + np.sqrt(1.0 + alpha**2 * (1.0 / cos_v**2 - 1.0)))
    weight = np.where(lit, smith_correlated(safe, cos_v, alpha) / g1, 0.0)
    return nodes, weight, np.clip(cos_d, 0.0, 1.0)


def charlie(pairs: Pairs, roughness: float) -> Array:
    """Distribution of sheen, (P,), alpha the square of roughness. Source: Estevez & Kulla 2017, eq. 2."""
    return _sine_power(pairs.cos_h, max(roughness, 0.05) ** 2)


def _sine_power(cos_h: Array, alpha: float) -> Array:
    power = 1.0 / max(alpha, 0.005)
    return (2.0 + power) * (1.0 - cos_h**2) ** (0.5 * power) / (2.0 * np.pi)


def imageworks_sheen(pairs: Pairs, roughness: float) -> Array:
    """Sheen of standard_surface, (P,): alpha is roughness itself. Source: MaterialX 1.39, sheen_bsdf."""
    d = _sine_power(pairs.cos_h, roughness)
    return d / (4.0 * (pairs.cos_l + pairs.cos_v - pairs.cos_l * pairs.cos_v))
