"""Evaluates the lobes, Fresnel terms and layers of the engines' shading models with NumPy.

Directions are unit vectors (P, 3) above the horizon, z the normal; values are in 1/sr without cosines.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache, wraps
from typing import Any, TypeVar, cast

import numpy as np

from manifold.analytic.fresnel import fresnel_dielectric
from manifold.analytic.ggx import GGX
from manifold.core.directions import gauss_legendre, normalize, rotate_z
from manifold.core.records import Array, Indices
from manifold.fit.exports.principled_values import ior_to_f0

# Nodes of albedo tables: cosines, and the azimuths and steepnesses of facets over which each cosine is integrated.
_NODES, _AZIMUTHS, _STEEPNESSES = 33, 16, 48
_ROUGHNESSES = 32  # steps of these tables by the root of alpha
_COSINES = np.maximum(np.linspace(0.0, 1.0, _NODES) ** 2, 1e-3)  # with the normal: dense at grazing
_LEAST_ALPHA = 1e-4
_KEPT = 96  # results that pairs keep: more than the derivatives of a model take from it

Function = TypeVar("Function", bound=Callable[..., Any])


@dataclass(frozen=True, eq=False)
class ShadingPairs:
    """P pairs of directions to the viewer and to the light, with their half vectors.

    Attributes:
        view, light, half: unit vectors (P, 3).
        cos_v, cos_l, cos_h: cosines of these with the normal, shape (P,).
        cos_d: cosines between view and half vector, shape (P,).
        kept: cached results of functions decorated by `per_pairs`.
    """

    view: Array
    light: Array
    half: Array
    cos_v: Array
    cos_l: Array
    cos_h: Array
    cos_d: Array
    kept: OrderedDict[Any, Any] = field(default_factory=OrderedDict, repr=False)

    @classmethod
    def of(cls, view: Array, light: Array) -> ShadingPairs:
        """Make pairs from directions (P, 3), which are kept a little above the horizon."""
        half = normalize(view + light)
        least = 1e-6
        return cls(
            view, light, half, np.maximum(view[:, 2], least), np.maximum(light[:, 2], least),
            np.clip(half[:, 2], least, 1.0), np.clip(np.sum(view * half, axis=1), least, 1.0),
        )  # fmt: skip

    def turned(self, rotation_rad: float) -> ShadingPairs:
        """Return the pairs in the frame of a surface that is turned by an azimuth."""
        return _turned(self, rotation_rad) if rotation_rad else self


def per_pairs(function: Function) -> Function:
    """Decorate a function of `ShadingPairs` so that the pairs cache its last results, which are read-only.

    Fits vary one parameter at a time, so most results are used again.
    """

    @wraps(function)
    def kept(pairs: ShadingPairs, *arguments: Any) -> Any:
        key = (function, *(a.tobytes() if isinstance(a, np.ndarray) else a for a in arguments))
        if key in pairs.kept:
            pairs.kept.move_to_end(key)
        else:
            pairs.kept[key] = function(pairs, *arguments)
            if len(pairs.kept) > _KEPT:
                pairs.kept.popitem(last=False)
        return pairs.kept[key]

    return cast(Function, kept)


@per_pairs
def _turned(pairs: ShadingPairs, rotation_rad: float) -> ShadingPairs:
    return ShadingPairs.of(rotate_z(pairs.view, -rotation_rad), rotate_z(pairs.light, -rotation_rad))


@lru_cache(maxsize=64)
def surface(alpha_x: float, alpha_y: float) -> GGX:
    """Return the GGX surface with these roughnesses, which are kept above 0."""
    return GGX.anisotropic(max(alpha_x, _LEAST_ALPHA), max(alpha_y, _LEAST_ALPHA))


@per_pairs
def specular_correlated(pairs: ShadingPairs, alpha_x: float, alpha_y: float) -> Array:
    """Return `D G2 / (4 cos cos)` of GGX, (P,), G2 by the geometric mean of the alphas, as in MaterialX."""
    mean = float(np.sqrt(alpha_x * alpha_y))
    return surface(alpha_x, alpha_y).D(pairs.half) * surface(mean, mean).masking(pairs.view, pairs.light)


@per_pairs
def specular_joint(pairs: ShadingPairs, alpha_x: float, alpha_y: float) -> Array:
    """Return `D G2 / (4 cos cos)` of GGX, (P,), G2 height-correlated with both alphas."""
    both = surface(alpha_x, alpha_y)
    return both.D(pairs.half) * both.masking(pairs.view, pairs.light)


def schlick(f0: Array | float, f90: Array | float, cosine: Array) -> Array:
    """Return Schlick's Fresnel term, shape (P, 3) for colours, otherwise (P, 1)."""
    f0, f90, away = np.atleast_1d(f0), np.atleast_1d(f90), 1.0 - cosine[:, None]
    return f0 + (f90 - f0) * (away * (away * away) ** 2)


def fresnel_f82(f0: Array, edge: Array, cosine: Array) -> Array:
    """Return Schlick's term with a colour at 82 degrees (F82-tint), (P, 3). Source: Hoffman 2019; Kutz et al. 2021."""
    return schlick(f0, 1.0, cosine) - f82_dip(f0, edge) * (cosine * (1.0 - cosine) ** 6)[:, None]


def f82_dip(f0: Array, edge: Array) -> Array:
    """Return the factor of `cos (1 - cos)^6` that F82-tint subtracts from Schlick's term, (3,)."""
    at = 1.0 / 7.0
    return (f0 + (1.0 - f0) * (1.0 - at) ** 5) * (1.0 - edge) / (at * (1.0 - at) ** 6)


def artistic_index(reflectivity: Array, edge: Array, most: float = 0.99) -> tuple[Array, Array]:
    """Return the indices n and k, each (3,), of a metal with these colours (Gulbrandsen 2014, as in MaterialX).

    Args:
        reflectivity, edge: colours at normal incidence and towards grazing incidence, each (3,).
        most: upper limit of the reflectivity.
    """
    r = np.clip(reflectivity, 0.0, most)
    root = np.sqrt(r)
    n = (1.0 - edge) * (1.0 + root) / (1.0 - root) + edge * (1.0 - r) / (1.0 + r)
    k2 = ((n + 1.0) ** 2 * r - (n - 1.0) ** 2) / (1.0 - r)
    return n, np.sqrt(np.maximum(k2, 0.0))


def mean_f82(f0: Array, edge: Array) -> Array:
    """Return the mean of F82-tint over the hemisphere, shape (3,)."""
    return f0 + (1.0 - f0) / 21.0 - f82_dip(f0, edge) / 126.0


def mean_dielectric(ior: float) -> float:
    """Return the mean of a dielectric's reflectance over the hemisphere. Source: Kulla & Conty 2017."""
    return (ior - 1.0) / (4.08567 + 1.00071 * ior)


@per_pairs
def split_sum(pairs: ShadingPairs, alpha: float) -> tuple[Array, Array]:
    """Return A and B of the viewer's albedo `f0 A + f90 B` of a correlated GGX lobe with Schlick's Fresnel, each (P,).

    Source: Karis 2013; by quadrature over the distribution of visible normals (Heitz 2018).
    """
    a, b = _at_alpha(_split_sum_table, alpha)
    return np.interp(pairs.cos_v, _COSINES, a), np.interp(pairs.cos_v, _COSINES, b)


@per_pairs
def single_scattering(pairs: ShadingPairs, alpha: float) -> tuple[Array, float]:
    """Return the viewer's albedo (P, 1) of a correlated GGX lobe without Fresnel, and its mean over the hemisphere."""
    single = np.sum(_at_alpha(_split_sum_table, alpha), axis=0)
    mean = float(np.trapezoid(2.0 * _COSINES * single, _COSINES))
    return np.interp(pairs.cos_v, _COSINES, single)[:, None], mean


def _at_alpha(table: Callable[..., Array], alpha: float, *arguments: Any) -> Array:
    """Interpolate a table in alpha by cubics between the nodes of roughness, whose number `table` takes first."""
    first, weights = cubic(np.sqrt(min(alpha, 1.0)) * _ROUGHNESSES, _ROUGHNESSES + 1)
    return np.asarray(sum(w * table(int(first) + k, *arguments) for k, w in enumerate(weights)))


def cubic(at: Array | float, count: int) -> tuple[Indices, tuple[Array, Array, Array, Array]]:
    """Interpolate by cubics between `count` nodes at 0, 1, 2 and so on.

    Returns the index of the first of the four nodes around each position, and the weights of the four.
    """
    first = np.clip(np.asarray(at).astype(int) - 1, 0, count - 4)
    a = at - first
    b, c, d = a - 1.0, a - 2.0, a - 3.0
    return first, (b * c * d / -6.0, a * c * d / 2.0, a * b * d / -2.0, a * b * c / 6.0)


@lru_cache(maxsize=_ROUGHNESSES + 1)
def _split_sum_table(node: int) -> Array:
    weight, cos_d = _visible_reflections(node)
    f = (1.0 - cos_d) ** 5
    return np.stack([(weight * (1.0 - f)).sum(axis=1), (weight * f).sum(axis=1)])


@per_pairs
def dielectric_fresnel(pairs: ShadingPairs, ior: float) -> Array:
    """Return the reflectance of a dielectric at the half vector, (P, 1)."""
    return fresnel_dielectric(pairs.cos_d, np.array([ior]))


@per_pairs
def dielectric_share(pairs: ShadingPairs, alpha: float, ior: float) -> Array:
    """Return the mean (P,) of `(F - F0) / (1 - F0)` over a correlated GGX lobe seen by the viewer.

    F is the Fresnel reflectance of a dielectric.
    """
    return np.interp(pairs.cos_v, _COSINES, _at_alpha(_dielectric_table, alpha, round(float(ior), 6)))


@lru_cache(maxsize=256)
def _dielectric_table(node: int, ior: float) -> Array:
    weight, cos_d = _visible_reflections(node)
    f = fresnel_dielectric(cos_d.ravel(), np.array([ior])).reshape(cos_d.shape)
    f0 = ((ior - 1.0) / (ior + 1.0)) ** 2
    return np.asarray((weight * (f - f0)).sum(axis=1) / (weight.sum(axis=1) * (1.0 - f0)))


@lru_cache(maxsize=_ROUGHNESSES + 1)
def _visible_reflections(node: int) -> tuple[Array, Array]:
    """Return `visible_reflections` of height-correlated masking at a node of roughness, at each of `_COSINES`."""
    return visible_reflections((node / _ROUGHNESSES) ** 2, _COSINES)


def visible_reflections(alpha: float, cosines: Array, *, is_correlated: bool = True) -> tuple[Array, Array]:
    """Return weights (C, S) and facet cosines (C, S) of S quadrature nodes, for a GGX lobe's albedo without Fresnel.

    The nodes cover the distribution of visible normals: azimuths on one side of the plane of incidence, and
    Gauss-Legendre nodes that are denser towards steep facets. A facet cosine is that between the view and the facet.

    Args:
        alpha: alpha of the lobe, kept above 0.
        cosines: cosines between view and normal, above 0, shape (C,).
        is_correlated: whether the masking of both directions is height-correlated; otherwise it is a product.
    """
    ggx = surface(max(alpha, 1e-3), max(alpha, 1e-3))
    x, share = gauss_legendre(_STEEPNESSES)
    nodes = 0.5 * (x + 1.0)
    azimuths = 0.5 * (np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS
    u = np.stack(np.meshgrid(azimuths, 1.0 - nodes**2, indexing="ij"), axis=-1).reshape(-1, 2)
    weight = np.tile(nodes * share, _AZIMUTHS) / _AZIMUTHS
    view = np.stack([np.sqrt(1.0 - cosines**2), np.zeros(len(cosines)), cosines], axis=1)[
        :, None
    ]  # [C, 1, 3]
    normal = ggx.sample_visible_normal(view, u)
    cos_d = np.sum(view * normal, axis=-1)
    light = 2.0 * cos_d[..., None] * normal - view
    lit = light[..., 2] > 0.0
    light[~lit] = (0.0, 0.0, 1.0)
    if is_correlated:
        kept = light[..., 2] * ggx.reflection_factor(view, light) / ggx.pdf_reflection(view, light)
    else:
        kept = 2.0 * light[..., 2] / (light[..., 2] + ggx.stretched_length(light))
    return np.where(lit, weight * kept, 0.0), np.clip(cos_d, 0.0, 1.0)


def charlie(pairs: ShadingPairs, roughness: float) -> Array:
    """Return the Charlie sheen distribution (P,) with alpha = roughness^2. Source: Estevez & Kulla 2017, eq. 2."""
    return _sine_power(pairs.cos_h, max(roughness, 0.05) ** 2)


def _sine_power(cos_h: Array, alpha: float) -> Array:
    power = 1.0 / max(alpha, 0.005)
    return (2.0 + power) * (1.0 - cos_h**2) ** (0.5 * power) / (2.0 * np.pi)


def imageworks_sheen(pairs: ShadingPairs, roughness: float) -> Array:
    """Return the sheen (P,) of standard_surface with alpha = roughness. Source: MaterialX 1.39, sheen_bsdf."""
    d = _sine_power(pairs.cos_h, roughness)
    return d / (4.0 * (pairs.cos_l + pairs.cos_v - pairs.cos_l * pairs.cos_v))


# Layers as in MaterialX 1.39 (pbrlib): what is below is scaled by one minus the layer's albedo.


def dielectric_layer(
    pairs: ShadingPairs, below: Array, ior: float, alpha_x: float, alpha_y: float, *, weight: float = 1.0,
    tint: Array | float = 1.0, fresnel: Array | None = None,
) -> Array:  # fmt: skip
    """Return the BRDF (P, 3) of a rough dielectric interface over a BRDF `below` (P, 3).

    `fresnel` replaces its Fresnel term.
    """
    if not weight:
        return below
    if fresnel is None:
        fresnel = dielectric_fresnel(pairs, ior)
    a, b = split_sum(pairs, float(np.sqrt(alpha_x * alpha_y)))
    single = (a * ior_to_f0(ior) + b)[:, None]
    albedo = single * _compensation(pairs, fresnel, alpha_x, alpha_y)
    return weight * tint * metal(pairs, fresnel, alpha_x, alpha_y) + (1.0 - weight * albedo) * below


def metal(pairs: ShadingPairs, fresnel: Array, alpha_x: float, alpha_y: float) -> Array:
    """Return the BRDF (P, 3) of a rough opaque interface with a Fresnel term (P, 3)."""
    lobe = specular_correlated(pairs, alpha_x, alpha_y)[:, None]
    return lobe * fresnel * _compensation(pairs, fresnel, alpha_x, alpha_y)


def _compensation(pairs: ShadingPairs, fresnel: Array, alpha_x: float, alpha_y: float) -> Array:
    """Return the factor of scattering between facets. Source: Turquin 2019."""
    a, b = split_sum(pairs, float(np.sqrt(alpha_x * alpha_y)))
    single = (a + b)[:, None]
    return 1.0 + fresnel * (1.0 - single) / single


def imageworks_layer(
    pairs: ShadingPairs, below: Array, weight: float, colour: Array, roughness: float
) -> Array:
    """Return the BRDF (P, 3) of standard_surface's sheen over a BRDF `below` (P, 3)."""
    if not weight:
        return below
    x, y = pairs.cos_v, roughness
    up = 13.673 - 68.78018 * x + 799.08825 * y - 905.00061 * x * y + 60.28956 * x * x + 1086.96473 * y * y
    down = 1.0 + 61.57746 * x + 442.78211 * y + 2597.49308 * x * y + 121.81241 * x * x + 3045.55075 * y * y
    albedo = np.clip(up / down, 0.0, 1.0)[:, None]
    return weight * colour * imageworks_sheen(pairs, roughness)[:, None] + (1.0 - weight * albedo) * below


def zeltner_layer(pairs: ShadingPairs, below: Array, weight: float, colour: Array, roughness: float) -> Array:
    """Return the BRDF (P, 3) of OpenPBR's fuzz over a BRDF `below` (P, 3). Source: Zeltner et al. 2022."""
    if not weight:
        return below
    lobe, albedo = _zeltner(pairs, roughness)
    return weight * colour * lobe + (1.0 - weight * albedo) * below


@per_pairs
def _zeltner(pairs: ShadingPairs, roughness: float) -> tuple[Array, Array]:
    """Return the lobe of a white fuzz, and the viewer's albedo of it, (P, 1) each."""
    y, x = min(max(roughness, 0.01), 1.0), pairs.cos_v
    s = y * (0.0206607 + 1.58491 * y) / (0.0379424 + y * (1.32227 + y))
    m = y * (-0.193854 + y * (-1.14885 + y * (1.7932 - 0.95943 * y * y))) / (0.046391 + y)
    o = y * (0.000654023 + (-0.0207818 + 0.119681 * y) * y) / (1.26264 + y * (-1.92021 + y))
    albedo = np.exp(-0.5 * ((x - m) / s) ** 2) / (s * np.sqrt(2.0 * np.pi)) + o
    a = (2.58126 * x + 0.813703 * y) * y / (1.0 + 0.310327 * x * x + 2.60994 * x * y)
    b = np.sqrt(np.maximum(1.0 - x, 0.0)) * (y - 1.0) * y**3
    b = b / (0.0000254053 + 1.71228 * x - 1.71506 * x * y + 1.34174 * y * y)
    across = pairs.view[:, :2]
    length = np.linalg.norm(across, axis=1, keepdims=True)
    tangent = np.where(length > 1e-9, across / np.maximum(length, 1e-9), [1.0, 0.0])
    along = np.sum(tangent * pairs.light[:, :2], axis=1)
    aside = tangent[:, 0] * pairs.light[:, 1] - tangent[:, 1] * pairs.light[:, 0]
    squared = (a * along + b * pairs.cos_l) ** 2 + (a * aside) ** 2 + pairs.cos_l**2
    density = pairs.cos_l / np.pi * (a / squared) ** 2  # of light, times its cosine
    return (albedo * density / pairs.cos_l)[:, None], albedo[:, None]
