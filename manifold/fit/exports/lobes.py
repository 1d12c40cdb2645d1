"""Lobes and Fresnel terms of the engines' shading models, evaluated with NumPy.

Directions are unit vectors (P, 3) above the horizon, z the normal; values are in 1/sr without cosines.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from manifold.analytic.fresnel import fresnel_dielectric
from manifold.analytic.ggx import GGX
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


@lru_cache(maxsize=64)
def surface(alpha_x: float, alpha_y: float) -> GGX:
    """The GGX surface of these roughnesses, neither of them a mirror's."""
    return GGX.anisotropic(max(alpha_x, _LEAST_ALPHA), max(alpha_y, _LEAST_ALPHA))


def specular_correlated(pairs: Pairs, alpha_x: float, alpha_y: float) -> Array:
    """`D G2 / (4 cos cos)` of GGX, (P,), G2 by the geometric mean of the alphas, as MaterialX has it."""
    mean = float(np.sqrt(alpha_x * alpha_y))
    return surface(alpha_x, alpha_y).D(pairs.half) * surface(mean, mean).masking(pairs.view, pairs.light)


def specular_joint(pairs: Pairs, alpha_x: float, alpha_y: float) -> Array:
    """`D G2 / (4 cos cos)` of GGX, (P,), G2 height-correlated with both alphas."""
    both = surface(alpha_x, alpha_y)
    return both.D(pairs.half) * both.masking(pairs.view, pairs.light)


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
    ggx = surface(max(alpha, 1e-3), max(alpha, 1e-3))
    nodes = np.linspace(0.0, 1.0, _NODES) ** 2  # dense at grazing
    nodes[0] = 1e-3
    u = np.stack(np.meshgrid(*[(np.arange(_SAMPLES) + 0.5) / _SAMPLES] * 2), axis=-1).reshape(-1, 2)
    view = np.stack([np.sqrt(1.0 - nodes**2), np.zeros(_NODES), nodes], axis=1)[:, None]  # [C, 1, 3]
    normal = ggx.sample_visible_normal(view, u)
    cos_d = np.sum(view * normal, axis=-1)
    light = 2.0 * cos_d[..., None] * normal - view
    lit = light[..., 2] > 0.0
    light[~lit] = (0.0, 0.0, 1.0)
    weight = light[..., 2] * ggx.reflection_factor(view, light) / ggx.pdf_reflection(view, light)
    return nodes, np.where(lit, weight, 0.0), np.clip(cos_d, 0.0, 1.0)


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
