"""Unity's High Definition pipeline: properties of the Lit shader, their conventions, and its BRDF."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from manifold.colour.conversion import decode_srgb, encode_srgb
from manifold.core.records import Array
from manifold.fit.exports import lobes
from manifold.fit.exports.document import Parameter, defaults
from manifold.fit.exports.lobes import ShadingPairs
from manifold.fit.exports.principled_values import PrincipledValues
from manifold.fit.exports.targets import Target, uncompared

SHADER = "HDRP/Lit"

PARAMETERS = {
    "_BaseColor": Parameter([1.0, 1.0, 1.0], is_free=True),
    "_Metallic": Parameter(0.0, is_free=True),
    "_Smoothness": Parameter(0.5, is_free=True, high=0.98),
    "_Anisotropy": Parameter(0.0),
    "tangent_deg": Parameter(0.0),
    "_CoatMask": Parameter(0.0, is_free=True),
}
"""Every property that exports may set, including the angle of the tangent."""

DEFAULTS = defaults(PARAMETERS)

BASE_COLOUR = "_BaseColor"
COAT = ("_CoatMask",)

CONVENTIONS: dict[str, str] = {
    "_BaseColor": "sRGB-encoded, 0 to 1, as Unity's colour properties are",
    "_Metallic": "0 to 1",
    "_Smoothness": "0 to 1; perceptual roughness is 1 minus it, GGX alpha the square of that",
    "_Anisotropy": "-1 to 1; alpha along the tangent (1 + a), across (1 - a) times the square of roughness",
    "tangent_deg": "degrees, counterclockwise seen from outside, by which the tangent is turned; no property of the "
    "shader: turn the UVs, or paint a tangent map (_TangentMap) of this direction",
    "_CoatMask": "0 to 1; the coat has index 1.5 and a fixed smoothness",
}


def settings(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the shader, its material type, and the keywords without which coat and anisotropy have no effect.

    Unity's inspector sets the keywords from the properties; scripts must set them explicitly.

    Source: `Lit.shader` of HDRP 14.
    """
    features = {"ANISOTROPY": values["_Anisotropy"], "CLEAR_COAT": values["_CoatMask"]}
    return {
        "shader": SHADER,
        "material_type": "Anisotropy" if values["_Anisotropy"] else "Standard",
        "keywords": [f"_MATERIAL_FEATURE_{feature}" for feature, value in features.items() if value],
    }


_SMOOTH_COAT = 0.1  # GGX alpha: a rougher coat would turn into a sharp highlight
_COAT_ALPHA, _F0 = 0.01, 0.04


def parameters(material: PrincipledValues) -> dict[str, Any]:
    """Return all properties in `DEFAULTS` for a material; the reflectance at normal incidence is Unity's 0.04."""
    roughness, anisotropy = material.around_mean
    coat = material.coat_weight if material.coat_alpha <= _SMOOTH_COAT else 0.0
    return DEFAULTS | {
        "_BaseColor": encode_srgb(np.asarray(material.base_color)).tolist(),
        "_Metallic": material.metallic,
        "_Smoothness": 1.0 - float(np.sqrt(_widened(roughness**2, 1.0 / _narrowing(coat)))),
        "_Anisotropy": anisotropy,
        "tangent_deg": float(np.rad2deg(material.rotation_rad)),
        "_CoatMask": coat,
    }


def brdf(values: Mapping[str, Any], pairs: ShadingPairs) -> Array:
    """Return the material's BRDF for lights without extent, f in 1/sr, shape (P, 3).

    Args:
        values: values of all properties in `DEFAULTS`.
        pairs: P direction pairs.
    Source: Lit.hlsl, CommonMaterial.hlsl and BSDF.hlsl of HDRP 14: Burley's diffuse term over 1.03571, GGX, Schlick,
    and multiple scattering between facets after Turquin 2019.
    """
    pairs = pairs.turned(np.deg2rad(values["tangent_deg"]))
    base, m, coat = decode_srgb(np.asarray(values["_BaseColor"])), values["_Metallic"], values["_CoatMask"]
    f0 = _F0 + m * (base - _F0)
    f90 = min(16.5 * float(f0.sum()), 1.0)  # nothing below 2 % is a surface: shadowing
    alpha = _widened((1.0 - values["_Smoothness"]) ** 2, _narrowing(coat))
    below_air = f0 * (0.326846 + (0.978946 - 0.283835 * f0) * f0) - 0.0256868  # below the coat's index of 1.5
    f0 = f0 + coat * (np.clip(below_air, 0.0, 1.0) - f0)
    a = values["_Anisotropy"]
    specular: Array = lobes.specular_joint(pairs, alpha * (1.0 + a), alpha * (1.0 - a))[:, None]
    specular = specular * lobes.schlick(f0, f90, pairs.cos_d)
    diffuse: Array = (1.0 - m) * base * _burley(pairs, float(np.sqrt(alpha)))
    if coat:
        fresnel = coat * lobes.schlick(_F0, 1.0, pairs.cos_d)
        layer = lobes.specular_joint(pairs, _COAT_ALPHA, _COAT_ALPHA)[:, None]
        specular = specular * (1.0 - fresnel) ** 2 + fresnel * layer
        diffuse = diffuse * (1.0 - coat * fresnel)
    single, _ = lobes.single_scattering(pairs, alpha)
    specular = specular * (1.0 + f0 * (1.0 / single - 1.0))
    return diffuse + specular


def _narrowing(coat: float) -> float:
    """Return the factor by which a coat multiplies the `2 / alpha^2 - 2` of the base below it."""
    return (1.0 + coat * (1.0 / 1.5 - 1.0)) ** 2


def _widened(alpha: float, factor: float) -> float:
    """Return the GGX alpha whose `2 / alpha^2 - 2` is `factor` times that of another."""
    if factor == 1.0:
        return alpha
    return float(np.sqrt(2.0 / (factor * (2.0 / max(alpha, 1e-4) ** 2 - 2.0) + 2.0)))


def _burley(pairs: ShadingPairs, roughness: float) -> Array:
    """Return Burley's diffuse term in 1/sr, (P, 1), with Unity's normalisation."""
    f90 = 0.5 + 2.0 * roughness * pairs.cos_d**2
    at_light = 1.0 + (f90 - 1.0) * (1.0 - pairs.cos_l) ** 5
    at_view = 1.0 + (f90 - 1.0) * (1.0 - pairs.cos_v) ** 5
    return (at_light * at_view / (1.03571 * np.pi))[:, None]


UNITY = Target(
    name="unity",
    suffix=".json",
    title="Unity, High Definition pipeline, Lit",
    entries=PARAMETERS,
    parameters=parameters,
    brdf=brdf,
    content=lambda export: export.json_file(CONVENTIONS, **settings(export.parameters)),
    base_colour=BASE_COLOUR,
    coat=COAT,
    colour_space="sRGB-encoded, as Unity's colour properties are",
    caveat=uncompared("Unity"),
)
