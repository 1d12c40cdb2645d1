"""Unreal Engine 5: inputs of the shading models Default Lit and Clear Coat, their conventions, and their BRDFs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from manifold.core.records import Array
from manifold.fit.exports import lobes
from manifold.fit.exports.document import CURVE_COSINES, Parameter, defaults
from manifold.fit.exports.lobes import ShadingPairs
from manifold.fit.exports.principled_values import PrincipledValues
from manifold.fit.exports.targets import Target, uncompared

PARAMETERS = {
    "BaseColor": Parameter([0.5, 0.5, 0.5], is_free=True),
    "Metallic": Parameter(0.0, is_free=True),
    "Specular": Parameter(0.5, is_free=True),
    "Roughness": Parameter(0.5, is_free=True, low=0.02),
    "Anisotropy": Parameter(0.0),
    "Tangent": Parameter(0.0),
    "ClearCoat": Parameter(0.0, is_free=True),
    "ClearCoatRoughness": Parameter(0.1, is_free=True, low=0.02),
    "BaseColorCurve": Parameter([]),
}
"""Every input that exports may set, with the value of an unconnected input."""

DEFAULTS = defaults(PARAMETERS)

BASE_COLOUR = "BaseColor"
COAT = ("ClearCoat", "ClearCoatRoughness")

CURVE = ("BaseColorCurve", "BaseColor")

CONVENTIONS: dict[str, str] = {
    "BaseColor": "linear Rec. 709 (sRGB primaries), 0 to 1; encode as sRGB for an sRGB texture",
    "Metallic": "0 to 1",
    "Specular": "0 to 1; reflectance at normal incidence is 0.08 times it",
    "Roughness": "0 to 1; GGX alpha is its square",
    "Anisotropy": "-1 to 1; alpha along the tangent (1 + a), across (1 - a) times the square of Roughness",
    "Tangent": "degrees, counterclockwise seen from outside, by which that input turns the tangent",
    "ClearCoat": "0 to 1, shading model Clear Coat, index 1.5",
    "ClearCoatRoughness": "0 to 1; GGX alpha is its square",
    "BaseColorCurve": "linear Rec. 709, 0 to 1, in place of BaseColor unless it is empty: red, green and blue at the "
    f"dot products {', '.join(f'{c:g}' for c in CURVE_COSINES)} of PixelNormalWS and CameraVectorWS, linear between",
}


def shading_model(values: Mapping[str, Any]) -> str:
    """Return the name of the shading model that uses all of the values."""
    return "Clear Coat" if values["ClearCoat"] > 0.0 else "Default Lit"


def parameters(material: PrincipledValues) -> dict[str, Any]:
    """Return all inputs in `DEFAULTS` for a material; sheen and tints have no counterpart."""
    roughness, anisotropy = material.around_mean
    return (
        DEFAULTS
        | material.coat(*COAT)
        | {
            "BaseColor": list(material.base_color),
            "Metallic": material.metallic,
            "Specular": 0.0 if material.is_diffuse else material.specular,
            "Roughness": roughness,
            "Anisotropy": anisotropy,
            "Tangent": float(np.rad2deg(material.rotation_rad)),
        }
    )


def brdf(values: Mapping[str, Any], pairs: ShadingPairs) -> Array:
    """Return the material's BRDF, f in 1/sr, shape (P, 3).

    Args:
        values: values of all inputs in `DEFAULTS`.
        pairs: P direction pairs.

    The coat attenuates the layers below by its Fresnel term, on the way in and on the way out.

    Source: Karis 2013 (Lambert, GGX, Schlick).
    """
    pairs = pairs.turned(np.deg2rad(values["Tangent"]))
    base, m = _base(values, pairs.cos_v), values["Metallic"]
    alpha, a = values["Roughness"] ** 2, values["Anisotropy"]
    f0 = (1.0 - m) * 0.08 * values["Specular"] + m * base
    f90 = np.minimum(50.0 * f0[:, 1:2], 1.0)  # nothing below 2 % is a surface: shadowing
    specular = lobes.specular_correlated(pairs, max(alpha * (1.0 + a), 1e-3), max(alpha * (1.0 - a), 1e-3))
    f: Array = (1.0 - m) * base / np.pi + specular[:, None] * lobes.schlick(f0, f90, pairs.cos_d)
    if values["ClearCoat"]:
        coat_alpha = values["ClearCoatRoughness"] ** 2
        fresnel = values["ClearCoat"] * lobes.schlick(0.04, 1.0, pairs.cos_d)
        coat = lobes.specular_correlated(pairs, coat_alpha, coat_alpha)[:, None]
        f = f * (1.0 - fresnel) ** 2 + fresnel * coat
    return f


def _base(values: Mapping[str, Any], cosine: Array) -> Array:
    """Return the base colour at cosines between normal and view (P,), shape (P, 3)."""
    nodes = np.reshape(values["BaseColorCurve"] or values["BaseColor"], (-1, 3))
    return np.stack([np.interp(cosine, CURVE_COSINES[-len(nodes) :], channel) for channel in nodes.T], axis=1)


UNREAL = Target(
    name="unreal",
    suffix=".json",
    title="Unreal Engine 5, Default Lit or Clear Coat",
    entries=PARAMETERS,
    parameters=parameters,
    brdf=brdf,
    content=lambda export: export.json_file(CONVENTIONS, shading_model=shading_model(export.parameters)),
    base_colour=BASE_COLOUR,
    coat=COAT,
    curve=CURVE,
    caveat=uncompared("Unreal Engine"),
)
