"""Autodesk Standard Surface 1.0.1: parameters, and the BRDF of MaterialX's implementation of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from manifold.analytic.fresnel import fresnel_conductor
from manifold.core.records import Array
from manifold.fit.exports import lobes
from manifold.fit.exports.document import Parameter, defaults, tint_parameter
from manifold.fit.exports.lobes import ShadingPairs, dielectric_layer, imageworks_layer, metal, per_pairs
from manifold.fit.exports.principled_values import PrincipledValues
from manifold.fit.exports.thin_film import film_over_index

SHEEN_SCALE, SHEEN_ROUGHNESS = 0.091, 0.125  # nearest in directional albedo

PARAMETERS = {
    "base": Parameter(1.0),
    "base_color": Parameter([0.8, 0.8, 0.8], is_free=True),
    "metalness": Parameter(0.0, is_free=True),
    "specular": Parameter(1.0, is_free=True),
    "specular_color": tint_parameter(),
    "specular_roughness": Parameter(0.2, is_free=True, low=0.02),
    "specular_IOR": Parameter(1.5, is_free=True, low=1.0, high=2.0),
    "specular_anisotropy": Parameter(0.0),
    "specular_rotation": Parameter(0.0),
    "coat": Parameter(0.0, is_free=True),
    "coat_roughness": Parameter(0.1, is_free=True, low=0.02),
    "coat_IOR": Parameter(1.5, low=1.0, high=2.0),
    "sheen": Parameter(0.0, is_free=True),
    "sheen_color": Parameter([1.0, 1.0, 1.0]),
    "sheen_roughness": Parameter(0.3, is_free=True, low=SHEEN_ROUGHNESS),
    "thin_film_thickness": Parameter(0.0, low=50.0, high=1200.0),
    "thin_film_IOR": Parameter(1.5, low=1.0, high=2.5),
}
"""Every parameter that exports may set."""

DEFAULTS = defaults(PARAMETERS)

BASE_COLOUR = "base_color"
COAT = ("coat", "coat_roughness")
SHEEN = ("sheen", "sheen_color", "sheen_roughness")
FILM = ("thin_film_thickness", "thin_film_IOR")


def parameters(material: PrincipledValues) -> dict[str, Any]:
    """Return all parameters in `DEFAULTS` for a material, as the start of a fit."""
    made = DEFAULTS | {
        "base_color": list(material.base_color),
        "metalness": material.metallic,
        "specular": 0.0 if material.is_diffuse else 1.0,
        "specular_roughness": material.roughness,
        "specular_IOR": material.ior,
    }
    if material.metallic == 0.0:
        made["specular_color"] = np.clip(material.specular_tint, 0.0, 1.0).tolist()
    if material.anisotropic > 0.0:  # the same aspect: alpha / sqrt(1 - a), alpha * sqrt(1 - a)
        made["specular_anisotropy"] = 0.9 * material.anisotropic
        made["specular_rotation"] = -material.rotation_rad % np.pi / (2.0 * np.pi)  # turns, clockwise
    return made | material.coat(*COAT) | material.scaled_sheen(*SHEEN, SHEEN_SCALE, SHEEN_ROUGHNESS)


def brdf(values: Mapping[str, Any], pairs: ShadingPairs) -> Array:
    """Return the material's BRDF, f in 1/sr, shape (P, 3).

    Args:
        values: values of all parameters in `DEFAULTS`.
        pairs: P direction pairs.
    Source: Georgiev et al. 2019; layers as MaterialX 1.39 implements them.
    """
    pairs = pairs.turned(-2.0 * np.pi * values["specular_rotation"])
    base = np.asarray(values["base_color"]) * values["base"]
    alpha = values["specular_roughness"] ** 2
    aspect = float(np.sqrt(1.0 - min(values["specular_anisotropy"], 0.98)))
    alpha_x, alpha_y = min(alpha / aspect, 1.0), alpha * aspect
    tint = np.asarray(values["specular_color"])
    f = np.broadcast_to(base / np.pi, (len(pairs.view), 3))
    f = imageworks_layer(
        pairs, f, values["sheen"], np.asarray(values["sheen_color"]), values["sheen_roughness"]
    )
    ior, thickness_nm, film_ior = (values[name] for name in ("specular_IOR", *FILM))
    fresnel = None
    if thickness_nm:
        fresnel = _film(pairs, film_ior, thickness_nm, np.full(3, ior), np.zeros(3))
    f = dielectric_layer(
        pairs, f, ior, alpha_x, alpha_y, weight=values["specular"], tint=tint, fresnel=fresnel
    )
    m = values["metalness"]
    if m:
        n, k = lobes.artistic_index(base, tint * values["specular"])
        film = (film_ior, thickness_nm, n, k)
        fresnel = _film(pairs, *film) if thickness_nm else fresnel_conductor(pairs.cos_d, n, k)
        f = (1.0 - m) * f + m * metal(pairs, fresnel, alpha_x, alpha_y)
    coat_alpha = values["coat_roughness"] ** 2
    return dielectric_layer(pairs, f, values["coat_IOR"], coat_alpha, coat_alpha, weight=values["coat"])


@per_pairs
def _film(pairs: ShadingPairs, film_ior: float, thickness_nm: float, n: Array, k: Array) -> Array:
    return film_over_index(film_ior, thickness_nm, n, k, pairs.cos_d)
