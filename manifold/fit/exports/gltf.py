"""glTF 2.0 (metallic-roughness with extensions): its parameters, the JSON of a material, and its BRDF."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from manifold.core.directions import from_spherical
from manifold.core.records import Array
from manifold.fit.exports import lobes
from manifold.fit.exports.document import Parameter, defaults, tint_parameter
from manifold.fit.exports.lobes import ShadingPairs, per_pairs
from manifold.fit.exports.principled_values import PrincipledValues, ior_to_f0
from manifold.fit.exports.thin_film import film_over_f0

SHEEN_SCALE, SHEEN_ROUGHNESS = 0.124, 0.375  # nearest in directional albedo

PARAMETERS = {
    "baseColorFactor": Parameter([1.0, 1.0, 1.0], is_free=True),
    "metallicFactor": Parameter(1.0, is_free=True),
    "roughnessFactor": Parameter(1.0, is_free=True, low=0.02),
    "ior": Parameter(1.5, is_free=True, low=1.0, high=2.0),
    "specularFactor": Parameter(1.0),
    "specularColorFactor": tint_parameter(),
    "clearcoatFactor": Parameter(0.0, is_free=True),
    "clearcoatRoughnessFactor": Parameter(0.0, is_free=True, low=0.02),
    "sheenColorFactor": Parameter([0.0, 0.0, 0.0], is_free=True),
    "sheenRoughnessFactor": Parameter(0.0, is_free=True, low=SHEEN_ROUGHNESS),
    "anisotropyStrength": Parameter(0.0),
    "anisotropyRotation": Parameter(0.0),
    "iridescenceFactor": Parameter(0.0),
    "iridescenceIor": Parameter(1.3, low=1.0, high=2.5),
    "iridescenceThicknessMaximum": Parameter(400.0, low=50.0, high=1200.0),
}
"""Every parameter that exports may set, with the specification's defaults."""

DEFAULTS = defaults(PARAMETERS)

BASE_COLOUR = "baseColorFactor"
COAT = ("clearcoatFactor", "clearcoatRoughnessFactor")
SHEEN = ("sheenColorFactor", "sheenRoughnessFactor")
FILM = ("iridescenceFactor", "iridescenceThicknessMaximum", "iridescenceIor")

EXTENSIONS: dict[str, tuple[str, ...]] = {
    "KHR_materials_ior": ("ior",),
    "KHR_materials_specular": ("specularFactor", "specularColorFactor"),
    "KHR_materials_clearcoat": ("clearcoatFactor", "clearcoatRoughnessFactor"),
    "KHR_materials_sheen": ("sheenColorFactor", "sheenRoughnessFactor"),
    "KHR_materials_anisotropy": ("anisotropyStrength", "anisotropyRotation"),
    "KHR_materials_iridescence": FILM,
}

_LAMBDA_ROUGH = np.array([21.5473, 3.82987, 0.19823, -1.97760, -4.32054])
_LAMBDA_SMOOTH = np.array([25.3245, 3.32435, 0.16801, -1.27393, -4.85967])


def parameters(material: PrincipledValues) -> dict[str, Any]:
    """Return all parameters in `DEFAULTS` for a material, as the start of a fit."""
    alpha_x, alpha_y = material.alphas
    made = DEFAULTS | {
        "baseColorFactor": list(material.base_color),
        "metallicFactor": material.metallic,
        "roughnessFactor": float(np.sqrt(min(alpha_y, 1.0))),
    }
    if material.metallic < 1.0:
        made["ior"] = material.ior
        made["specularFactor"] = 0.0 if material.is_diffuse else 1.0
        made["specularColorFactor"] = material.specular_tint.tolist()
    made |= material.coat(*COAT)
    if np.any(material.sheen_colour > 0.0):
        made["sheenColorFactor"] = np.clip(SHEEN_SCALE * material.sheen_colour, 0.0, 1.0).tolist()
        made["sheenRoughnessFactor"] = SHEEN_ROUGHNESS
    if material.anisotropic > 0.0:
        made["anisotropyStrength"] = float(np.sqrt(min((alpha_x - alpha_y) / max(1.0 - alpha_y, 1e-6), 1.0)))
        made["anisotropyRotation"] = material.rotation_rad
    return made


def to_json(values: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return a material of glTF; extensions appear only if they differ from their defaults."""
    material: dict[str, Any] = {
        "name": name,
        "pbrMetallicRoughness": {
            "baseColorFactor": [*values["baseColorFactor"], 1.0],
            "metallicFactor": values["metallicFactor"],
            "roughnessFactor": values["roughnessFactor"],
        },
    }
    extensions = {}
    for extension, names in EXTENSIONS.items():
        entries = {key: values[key] for key in names if values[key] != DEFAULTS[key]}
        if entries:
            extensions[extension] = entries
    if extensions:
        material["extensions"] = extensions
    return material


def brdf(values: Mapping[str, Any], pairs: ShadingPairs) -> Array:
    """Return the material's BRDF, f in 1/sr, shape (P, 3).

    Args:
        values: values of all parameters in `DEFAULTS`.
        pairs: P direction pairs.

    It follows three.js and Khronos' renderer where these differ from the specification: the diffuse part loses the
    Fresnel reflectance per channel; a thin film is evaluated at the angle between viewer and normal; and multiple
    scattering between facets is that of three.js.

    Source: glTF 2.0 specification, appendix B, and the implementation notes of the KHR_materials extensions.
    """
    pairs = pairs.turned(values["anisotropyRotation"])
    base = np.asarray(values["baseColorFactor"])
    alpha = values["roughnessFactor"] ** 2
    along = alpha + (1.0 - alpha) * values["anisotropyStrength"] ** 2
    f0 = np.minimum(ior_to_f0(values["ior"]) * np.asarray(values["specularColorFactor"]), 1.0)
    strength, m = values["specularFactor"], values["metallicFactor"]
    single, _ = lobes.single_scattering(pairs, alpha)
    scattered = 1.0 + (f0 * strength + m * (base - f0 * strength)) * (1.0 / single - 1.0)  # Turquin 2019
    specular = lobes.specular_joint(pairs, along, alpha)[:, None] * scattered
    metal = specular * _filmed(values, pairs, lobes.schlick(base, 1.0, pairs.cos_d), base)
    bare = lobes.schlick(f0 * strength, np.full(3, strength), pairs.cos_d)
    dielectric = (1.0 - bare) * base / np.pi + specular * _filmed(values, pairs, bare, f0 * strength)
    f: Array = dielectric + m * (metal - dielectric)
    f = _sheen(values, pairs, f)
    if values["clearcoatFactor"]:
        coat_alpha = values["clearcoatRoughnessFactor"] ** 2
        coat = lobes.specular_joint(pairs, coat_alpha, coat_alpha)[:, None]
        share = values["clearcoatFactor"] * lobes.schlick(0.04, 1.0, pairs.cos_v)
        f = f + share * (coat - f)
    return f


def _filmed(values: Mapping[str, Any], pairs: ShadingPairs, bare: Array, f0: Array) -> Array:
    """Return a Fresnel term (P, 3) with the share of the thin film."""
    weight, thickness_nm, ior = (float(values[name]) for name in FILM)
    if not weight:
        return bare
    return bare + weight * (_film(pairs, ior, thickness_nm, f0) - bare)


@per_pairs
def _film(pairs: ShadingPairs, ior: float, thickness_nm: float, f0: Array) -> Array:
    return film_over_f0(ior, thickness_nm, f0, pairs.cos_v)


def _sheen(values: Mapping[str, Any], pairs: ShadingPairs, base: Array) -> Array:
    colour: Array = np.asarray(values["sheenColorFactor"])
    if not np.any(colour):
        return base
    roughness = values["sheenRoughnessFactor"]
    scale = 1.0 - colour.max() * _sheen_albedo(pairs, roughness)[:, None]
    return _sheen_lobe(pairs, roughness)[:, None] * colour + scale * base


@per_pairs
def _sheen_lobe(pairs: ShadingPairs, roughness: float) -> Array:
    """Return `D V` of the sheen, (P,)."""
    alpha = max(roughness, 0.05) ** 2
    shadowing = 1.0 + _lambda(pairs.cos_v, alpha) + _lambda(pairs.cos_l, alpha)
    return lobes.charlie(pairs, roughness) / (4.0 * shadowing * pairs.cos_v * pairs.cos_l)


def _lambda(cosine: Array, alpha: float) -> Array:
    a, b, c, d, e = _LAMBDA_ROUGH + (1.0 - alpha) ** 2 * (_LAMBDA_SMOOTH - _LAMBDA_ROUGH)

    def fit(x: Array | float) -> Array:
        return np.asarray(a / (1.0 + b * np.power(x, c)) + d * np.asarray(x) + e)

    return np.exp(np.where(cosine < 0.5, fit(cosine), 2.0 * fit(0.5) - fit(np.maximum(1.0 - cosine, 0.0))))


@per_pairs
def _sheen_albedo(pairs: ShadingPairs, roughness: float) -> Array:
    """Return a white sheen's directional albedo at wi or wo, whichever is larger, (P,)."""
    nodes, albedo = _sheen_table(round(float(roughness), 6))
    return np.maximum(*(np.interp(cosine, nodes, albedo) for cosine in (pairs.cos_v, pairs.cos_l)))


@lru_cache(maxsize=64)
def _sheen_table(roughness: float) -> tuple[Array, Array]:
    """Return the directional albedo of a white sheen, by quadrature."""
    nodes = np.linspace(0.02, 1.0, 24)
    cos_l, phi = (np.arange(48) + 0.5) / 48, (np.arange(48) + 0.5) / 48 * np.pi
    c, p = (a.ravel() for a in np.meshgrid(cos_l, phi))
    light = from_spherical(np.arccos(c), p)
    albedo = []
    for node in nodes:
        view = np.broadcast_to([np.sqrt(1.0 - node**2), 0.0, node], light.shape)
        albedo.append(np.mean(_sheen_lobe(ShadingPairs.of(view, light), roughness) * c) * 2.0 * np.pi)
    return nodes, np.minimum(albedo, 1.0)
