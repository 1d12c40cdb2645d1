"""OpenPBR surface 1.1: its parameters, and the BRDF of its implementation in MaterialX."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.optimize import brentq

from manifold.core.records import Array
from manifold.fit.exports import lobes
from manifold.fit.exports.document import Parameter, defaults, tint_parameter
from manifold.fit.exports.lobes import ShadingPairs, dielectric_layer, metal, per_pairs, zeltner_layer
from manifold.fit.exports.principled_values import PrincipledValues, ior_to_f0
from manifold.fit.exports.thin_film import film_over_f82_materialx, film_over_index

FUZZ_SCALE, FUZZ_ROUGHNESS = 0.126, 0.45  # nearest in directional albedo

PARAMETERS = {
    "base_weight": Parameter(1.0),
    "base_color": Parameter([0.8, 0.8, 0.8], is_free=True),
    "base_metalness": Parameter(0.0, is_free=True),
    "specular_weight": Parameter(1.0, is_free=True),
    "specular_color": tint_parameter(),
    "specular_roughness": Parameter(0.3, is_free=True, low=0.02),
    "specular_ior": Parameter(1.5, is_free=True, low=1.0, high=2.0),
    "specular_roughness_anisotropy": Parameter(0.0, low=0.02),
    "geometry_tangent": Parameter(0.0),
    "coat_weight": Parameter(0.0, is_free=True),
    "coat_roughness": Parameter(0.0, is_free=True, low=0.02),
    "coat_ior": Parameter(1.6, low=1.0, high=2.0),
    "coat_darkening": Parameter(1.0),
    "fuzz_weight": Parameter(0.0, is_free=True),
    "fuzz_color": Parameter([1.0, 1.0, 1.0]),
    "fuzz_roughness": Parameter(0.5, is_free=True, low=FUZZ_ROUGHNESS),
    "thin_film_weight": Parameter(0.0),
    "thin_film_thickness": Parameter(0.5, low=0.05, high=1.2),  # in micrometres
    "thin_film_ior": Parameter(1.4, low=1.0, high=2.5),
}
"""Every parameter that exports may set; the tangent stands for the angle, in degrees, by which nodes turn it."""

DEFAULTS = defaults(PARAMETERS)

BASE_COLOUR = "base_color"
COAT = ("coat_weight", "coat_roughness", "coat_ior", "coat_darkening")
SHEEN = ("fuzz_weight", "fuzz_color", "fuzz_roughness")
FILM = ("thin_film_weight", "thin_film_thickness", "thin_film_ior")


def parameters(material: PrincipledValues) -> dict[str, Any]:
    """Return all parameters in `DEFAULTS` for a material, as the start of a fit."""
    made = DEFAULTS | {
        "base_color": list(material.base_color),
        "base_metalness": material.metallic,
        "specular_weight": 0.0 if material.is_diffuse else 1.0,
        "specular_roughness": material.roughness,
        "specular_ior": material.ior,
    }
    if material.metallic == 0.0:  # for metals it is the edge's colour
        made["specular_color"] = np.clip(material.specular_tint, 0.0, 1.0).tolist()
    if material.anisotropic > 0.0:
        alpha_x, alpha_y = material.alphas
        ratio = alpha_y / alpha_x
        made["specular_roughness_anisotropy"] = 1.0 - ratio
        made["geometry_tangent"] = float(np.rad2deg(material.rotation_rad))
        made["specular_roughness"] = float(min(np.sqrt(alpha_x / np.sqrt(2.0 / (1.0 + ratio**2))), 1.0))
    if material.coat_weight > 0.0:
        made |= material.coat(*COAT[:2])
        made |= {"coat_ior": 1.5, "coat_darkening": 0.0}  # principled's coat does not darken what is below
        made["specular_roughness"] = _below_coat(made)
    return made | material.scaled_sheen(*SHEEN, FUZZ_SCALE, FUZZ_ROUGHNESS)


def _below_coat(values: Mapping[str, Any]) -> float:
    """Return the roughness that the coat roughens to the wanted one; 0 if the coat is rougher by itself."""

    def excess(roughness: float) -> float:
        return roughened(roughness, 2.0 * values["coat_roughness"] ** 4, values["coat_weight"]) - wanted

    wanted = float(values["specular_roughness"])
    if excess(wanted) <= 0.0:
        return wanted
    return 0.0 if excess(0.0) >= 0.0 else float(brentq(excess, 0.0, wanted, xtol=1e-9))


def roughened(roughness: float, added: float, weight: float) -> float:
    """Return the roughness below a layer, `(1 - weight) roughness + weight (roughness^4 + added)^(1/4)`."""
    return (1.0 - weight) * roughness + weight * min(roughness**4 + added, 1.0) ** 0.25


def brdf(values: Mapping[str, Any], pairs: ShadingPairs) -> Array:
    """Return the material's BRDF, f in 1/sr, shape (P, 3).

    Args:
        values: values of all parameters in `DEFAULTS`.
        pairs: P direction pairs.

    The BRDF below a layer is scaled by one minus the layer's directional albedo towards the viewer.

    Source: OpenPBR 1.1; layers as MaterialX 1.39 implements them.
    """
    pairs = pairs.turned(np.deg2rad(values["geometry_tangent"]))
    base = np.asarray(values["base_color"]) * values["base_weight"]
    weight = values["coat_weight"]
    alpha_x, alpha_y = alphas(
        roughened(values["specular_roughness"], 2.0 * values["coat_roughness"] ** 4, weight),
        values["specular_roughness_anisotropy"],
    )
    ratio = values["specular_ior"] / values["coat_ior"]
    ior = (1.0 - weight) * values["specular_ior"] + weight * max(ratio, 1.0 / ratio)
    root = np.sign(ior - 1.0) * np.sqrt(min(values["specular_weight"] * ior_to_f0(ior), 0.99999))
    ior, tint = (1.0 + root) / (1.0 - root), np.asarray(values["specular_color"])
    m, film = values["base_metalness"], values["thin_film_weight"]
    diffuse = np.broadcast_to(base / np.pi, (len(pairs.view), 3))

    def substrate(fresnel: Array | None, edge: Array) -> Array:
        below = dielectric_layer(pairs, diffuse, ior, alpha_x, alpha_y, tint=tint, fresnel=fresnel)
        return (1.0 - m) * below + m * values["specular_weight"] * metal(pairs, edge, alpha_x, alpha_y)

    f = substrate(None, lobes.fresnel_f82(base, tint, pairs.cos_d))
    if film:
        layer = values["thin_film_ior"], 1e3 * values["thin_film_thickness"]
        filmed = substrate(_dielectric_film(pairs, *layer, ior), _metal_film(pairs, *layer, base, tint))
        f = (1.0 - film) * f + film * filmed
    f = f * _darkening(values, base)
    coat_x, coat_y = alphas(values["coat_roughness"], 0.0)
    f = dielectric_layer(pairs, f, values["coat_ior"], coat_x, coat_y, weight=weight)
    return zeltner_layer(
        pairs, f, values["fuzz_weight"], np.asarray(values["fuzz_color"]), values["fuzz_roughness"]
    )


@per_pairs
def _dielectric_film(pairs: ShadingPairs, film_ior: float, thickness_nm: float, ior: float) -> Array:
    return film_over_index(film_ior, thickness_nm, np.full(3, ior), np.zeros(3), pairs.cos_d)


@per_pairs
def _metal_film(pairs: ShadingPairs, film_ior: float, thickness_nm: float, f0: Array, edge: Array) -> Array:
    return film_over_f82_materialx(film_ior, thickness_nm, f0, edge, pairs.cos_d)


def alphas(roughness: float, anisotropy: float) -> tuple[float, float]:
    """Return GGX alpha along and across the tangent."""
    across = 1.0 - anisotropy
    alpha_x = roughness**2 * float(np.sqrt(2.0 / (1.0 + across**2)))
    return alpha_x, across * alpha_x


def _darkening(values: Mapping[str, Any], base: Array) -> Array:
    """Return the factor by which reflections between coat and base darken the base, (3,)."""
    kept = 1.0 - (1.0 - ior_to_f0(values["coat_ior"])) / values["coat_ior"] ** 2
    m = values["base_metalness"]
    albedo: Array = base * ((1.0 - m) + m * values["specular_weight"])
    share: float = values["coat_weight"] * values["coat_darkening"]
    return np.asarray(1.0 + share * ((1.0 - kept) / (1.0 - albedo * kept) - 1.0))
