"""The BRDF of OpenPBR's parameters as Adobe's openpbr-bsdf implements it, which differs from MaterialX.

The coat roughens the layers below it by less, depending on both weights. The diffuse base loses light at the
interface on the way in and on the way out. Masking is not height-correlated. Thin films are evaluated at three
wavelengths and, over metals, with complex indices, as the specification suggests.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from manifold.analytic.fresnel import fresnel_dielectric
from manifold.core.records import Array
from manifold.fit.exports import lobes
from manifold.fit.exports.lobes import ShadingPairs, per_pairs, surface, zeltner_layer
from manifold.fit.exports.openpbr import alphas, roughened
from manifold.fit.exports.principled_values import ior_to_f0
from manifold.fit.exports.thin_film import film_at_wavelengths

WAVELENGTHS_NM = (620.0, 540.0, 450.0)
"""Wavelengths at which a thin film is evaluated for red, green and blue, the base wavelengths of openpbr-bsdf."""

_NODES = 32  # of its tables by the root of alpha and by the cosine
_IORS = np.linspace(1.0, 2.0, 11)  # of its tables, as far as exports need them
_FUZZ_ROUGHENS = 0.005  # share of the fuzz's roughness^4 that is added to the coat's
_LEAST_ALPHA = 0.04**2  # of metals whose facets scatter light to each other


def brdf(values: Mapping[str, Any], pairs: ShadingPairs) -> Array:
    """Return the material's BRDF, f in 1/sr, shape (P, 3).

    Args:
        values: values of all parameters in `openpbr.DEFAULTS`.
        pairs: P direction pairs.
    Source: github.com/adobe/openpbr-bsdf at a29da96, reflection of opaque surfaces seen from outside.
    """
    pairs = pairs.turned(np.deg2rad(values["geometry_tangent"]))
    base, tint = (
        np.asarray(values["base_color"]) * values["base_weight"],
        np.asarray(values["specular_color"]),
    )
    m, coat, coat_ior = values["base_metalness"], values["coat_weight"], values["coat_ior"]
    metalness = m * values["specular_weight"]
    outside, inside, ior = _indices(values)
    coat_roughness = _coat_roughness(values)
    roughness = roughened(values["specular_roughness"], (1.0 - 1.0 / coat_ior) * coat_roughness**4, coat)
    alpha = roughness**2
    mean_metal = np.clip(lobes.mean_f82(base, tint), 0.0, 1.0)
    fresnel = (1.0 - m) * tint * lobes.dielectric_fresnel(pairs, ior)
    fresnel = fresnel + metalness * np.clip(lobes.fresnel_f82(base, tint, pairs.cos_d), 0.0, 1.0)
    film = values["thin_film_weight"]
    if film:
        layer = outside, values["thin_film_ior"], 1e3 * values["thin_film_thickness"]
        filmed = (1.0 - m) * tint * _film(pairs, *layer, np.full(3, inside), np.zeros(3))
        if metalness:
            filmed = filmed + metalness * _film(pairs, *layer, *lobes.artistic_index(base, tint))
        fresnel = fresnel + film * (filmed - fresnel)
    f = _specular(pairs, *alphas(roughness, values["specular_roughness_anisotropy"]))[:, None] * fresnel
    f = f + metalness * mean_metal**2 * _scattered(pairs, alpha)
    f = f + (1.0 - m) * base / np.pi * _passed(pairs, alpha, ior)
    if coat:
        coat_alpha = coat_roughness**2
        lobe = _specular(pairs, coat_alpha, coat_alpha)[:, None] * lobes.dielectric_fresnel(pairs, coat_ior)
        reflected = coat * (1.0 - _complement(pairs.cos_v, coat_alpha, coat_ior))[:, None]
        darkening = _darkening(values, base, metalness * mean_metal, roughness, ior)
        f = coat * lobe + (1.0 - reflected) * darkening * f
    return zeltner_layer(
        pairs, f, values["fuzz_weight"], np.asarray(values["fuzz_color"]), values["fuzz_roughness"]
    )


def _indices(values: Mapping[str, Any]) -> tuple[float, float, float]:
    """Return the refractive indices above and below the base's interface; their ratio is at least 1."""
    outside = 1.0 + values["coat_weight"] * (values["coat_ior"] - 1.0)
    ratio = values["specular_ior"] / outside
    root = np.sqrt(min(values["specular_weight"] * ior_to_f0(ratio), 0.9999))
    scaled = float((1.0 + root) / (1.0 - root))
    return outside, outside * (scaled if ratio >= 1.0 else 1.0 / scaled), scaled


def _coat_roughness(values: Mapping[str, Any]) -> float:
    fuzz = values["fuzz_roughness"]
    added = _FUZZ_ROUGHENS * float(np.mean(values["fuzz_color"])) * fuzz**5
    return roughened(values["coat_roughness"], added, values["fuzz_weight"])


def _darkening(values: Mapping[str, Any], base: Array, metal: Array, roughness: float, ior: float) -> Array:
    """Return the factor by which reflections between coat and base darken the base, (3,).

    Args:
        values: of the parameters.
        base: colour.
        metal: mean reflectance of the metal, times its share.
        roughness, ior: of the base below the coat.
    """
    m = values["base_metalness"]
    of_coat, of_base = lobes.mean_dielectric(values["coat_ior"]), lobes.mean_dielectric(ior)
    diffuse = 1.0 - (1.0 - of_coat) / values["coat_ior"] ** 2
    share = (1.0 - m) * of_base + m
    kept = of_coat + (1.0 + share * (roughness - 1.0)) * (diffuse - of_coat)
    albedo = metal + (1.0 - m) * (base + of_base * (1.0 - base))
    darkened = (1.0 - kept) / (1.0 - albedo * kept)
    return np.asarray(1.0 + values["coat_weight"] * values["coat_darkening"] * (darkened - 1.0))


@per_pairs
def _specular(pairs: ShadingPairs, alpha_x: float, alpha_y: float) -> Array:
    """Return `D G1 G1 / (4 cos cos)` of GGX, (P,)."""
    both = surface(alpha_x, alpha_y)
    view, light = (
        c + both.stretched_length(w) for c, w in ((pairs.cos_v, pairs.view), (pairs.cos_l, pairs.light))
    )
    return both.D(pairs.half) / (view * light)


@per_pairs
def _film(pairs: ShadingPairs, outside: float, ior: float, thickness_nm: float, n: Array, k: Array) -> Array:
    return film_at_wavelengths(WAVELENGTHS_NM, outside, ior, thickness_nm, n, k, pairs.cos_d)


@per_pairs
def _scattered(pairs: ShadingPairs, alpha: float) -> Array:
    """Return light that facets of a white metal scatter to each other, in 1/sr, (P, 1)."""
    if alpha < _LEAST_ALPHA:
        return np.zeros((len(pairs.view), 1))
    of_view, of_light = (_complement(c, alpha, np.inf) for c in (pairs.cos_v, pairs.cos_l))
    product = of_view * of_light / max(_mean_complement(alpha, np.inf), 1e-12)
    return (np.minimum(product, 1.0 / pairs.cos_l) / np.pi)[:, None]


@per_pairs
def _passed(pairs: ShadingPairs, alpha: float, ior: float) -> Array:
    """Return the share of a diffuse base's light that passes the interface in and out, (P, 1)."""
    of_view, of_light = (_complement(c, alpha, ior) for c in (pairs.cos_v, pairs.cos_l))
    return (of_view * of_light / _mean_complement(alpha, ior))[:, None]


def _complement(cosine: Array, alpha: float, ior: float) -> Array:
    """Return one minus the directional albedo of GGX over a dielectric, or of a white metal for an infinite index."""
    return np.interp(cosine, np.linspace(0.0, 1.0, _NODES), _at(_tables()[0], alpha, ior))


def _mean_complement(alpha: float, ior: float) -> float:
    """Return the mean of `_complement` over the hemisphere."""
    return float(_at(_tables()[1], alpha, ior))


def _at(table: Array, alpha: float, ior: float) -> Array:
    """Interpolate a table (I + 1, R, ...) linearly in index and root of alpha; its last row is that of white metals."""
    row = min(np.sqrt(alpha), 1.0) * (_NODES - 1)
    low = min(int(row), _NODES - 2)
    rough = table[:, low] + (row - low) * (table[:, low + 1] - table[:, low])
    if np.isinf(ior):
        return np.asarray(rough[-1])
    step = (ior - 1.0) / (_IORS[1] - _IORS[0])
    first = min(int(step), len(_IORS) - 2)
    return np.asarray(rough[first] + (step - first) * (rough[first + 1] - rough[first]))


@lru_cache(maxsize=1)
def _tables() -> tuple[Array, Array]:
    """Return one minus directional albedos, by quadrature: (I + 1, R, C), and means over the hemisphere (I + 1, R)."""
    cosines = np.linspace(0.0, 1.0, _NODES)
    made = np.empty((len(_IORS) + 1, _NODES, _NODES))
    for row in range(_NODES):
        alpha = (row / (_NODES - 1)) ** 2
        weight, cos_d = lobes.visible_reflections(alpha, np.maximum(cosines, 1e-4), is_correlated=False)
        fresnel = fresnel_dielectric(cos_d.ravel(), _IORS).reshape(*cos_d.shape, -1)
        made[:-1, row] = 1.0 - np.einsum("cs,csi->ic", weight, fresnel)
        made[-1, row] = 1.0 - np.sum(weight, axis=1)
    return made, np.asarray(np.trapezoid(2.0 * cosines * made, cosines, axis=-1))
