"""Layering as in MaterialX: what is below is scaled by one minus the layer's albedo.

Source: MaterialX 1.39, pbrlib.
"""

from __future__ import annotations

import numpy as np

from manifold.analytic.fresnel import fresnel_dielectric
from manifold.fit.exports import lobes
from manifold.fit.exports.lobes import Pairs
from manifold.fit.exports.principled_values import ior_to_f0
from manifold.records import Array


def dielectric_layer(
    pairs: Pairs, below: Array, ior: float, alpha_x: float, alpha_y: float, *, weight: float = 1.0,
    tint: Array | float = 1.0, fresnel: Array | None = None,
) -> Array:  # fmt: skip
    """A rough dielectric interface over a BRDF `below` (P, 3); a Fresnel term other than its own may be given."""
    if not weight:
        return below
    if fresnel is None:
        fresnel = fresnel_dielectric(pairs.cos_d, np.array([ior]))
    a, b = lobes.split_sum(np.sqrt(alpha_x * alpha_y), pairs.cos_v)
    single = (a * ior_to_f0(ior) + b)[:, None]
    albedo = single * _compensation(pairs, fresnel, alpha_x, alpha_y)
    return weight * tint * metal(pairs, fresnel, alpha_x, alpha_y) + (1.0 - weight * albedo) * below


def metal(pairs: Pairs, fresnel: Array, alpha_x: float, alpha_y: float) -> Array:
    """A rough interface with a Fresnel term (P, 3), nothing below."""
    lobe = lobes.specular_correlated(pairs, alpha_x, alpha_y)[:, None]
    return lobe * fresnel * _compensation(pairs, fresnel, alpha_x, alpha_y)


def _compensation(pairs: Pairs, fresnel: Array, alpha_x: float, alpha_y: float) -> Array:
    """Scattering between facets, as a factor. Source: Turquin 2019."""
    a, b = lobes.split_sum(np.sqrt(alpha_x * alpha_y), pairs.cos_v)
    single = (a + b)[:, None]
    return 1.0 + fresnel * (1.0 - single) / single


def imageworks_layer(pairs: Pairs, below: Array, weight: float, colour: Array, roughness: float) -> Array:
    """standard_surface's sheen over a BRDF `below`."""
    if not weight:
        return below
    x, y = pairs.cos_v, roughness
    up = 13.673 - 68.78018 * x + 799.08825 * y - 905.00061 * x * y + 60.28956 * x * x + 1086.96473 * y * y
    down = 1.0 + 61.57746 * x + 442.78211 * y + 2597.49308 * x * y + 121.81241 * x * x + 3045.55075 * y * y
    albedo = np.clip(up / down, 0.0, 1.0)[:, None]
    return (
        weight * colour * lobes.imageworks_sheen(pairs, roughness)[:, None] + (1.0 - weight * albedo) * below
    )


def zeltner_layer(pairs: Pairs, below: Array, weight: float, colour: Array, roughness: float) -> Array:
    """OpenPBR's fuzz over a BRDF `below`: a linearly transformed cosine. Source: Zeltner et al. 2022."""
    if not weight:
        return below
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
    lobe: Array = weight * colour * (albedo * density / pairs.cos_l)[:, None]
    return lobe + (1.0 - weight * albedo[:, None]) * below
