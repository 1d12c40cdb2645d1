"""UsdPreviewSurface 2.6: parameters, and its BRDF."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from manifold.core.records import Array
from manifold.fit.exports import lobes
from manifold.fit.exports.document import Parameter, defaults
from manifold.fit.exports.lobes import ShadingPairs, per_pairs
from manifold.fit.exports.principled_values import PrincipledValues, ior_to_f0

PARAMETERS = {
    "useSpecularWorkflow": Parameter(0),
    "diffuseColor": Parameter([0.18, 0.18, 0.18], is_free=True),
    "specularColor": Parameter([0.0, 0.0, 0.0], is_free=True),
    "roughness": Parameter(0.5, is_free=True, low=0.02),
    "clearcoat": Parameter(0.0, is_free=True),
    "clearcoatRoughness": Parameter(0.01, is_free=True, low=0.02),
}
"""Every parameter that exports may set."""

DEFAULTS = defaults(PARAMETERS)

BASE_COLOUR = "diffuseColor"
COAT = ("clearcoat", "clearcoatRoughness")

HUED = ("specularColor",)
"""Colours whose hue no fit changes, because renderers treat them differently.

The diffuse part loses the Fresnel reflectance per channel in OpenUSD, and its mean in MaterialX. A fitted colour of
highlights that compensates the diffuse colour would therefore look right in only one of them.
"""

_IOR = 1.5  # the default, which here is the coat's alone


def parameters(material: PrincipledValues) -> dict[str, Any]:
    """Return all parameters in `DEFAULTS` for a material; sheen and anisotropy have no counterpart.

    They use the specular workflow, because with the metallic workflow a material of metallic 0.3 would reflect 0.3 of
    white.
    """
    base, m = np.asarray(material.base_color), material.metallic
    f0 = 0.0 if material.is_diffuse else ior_to_f0(material.ior)
    tinted = f0 * material.specular_tint
    return (
        DEFAULTS
        | material.coat(*COAT)
        | {
            "useSpecularWorkflow": 1,
            "diffuseColor": ((1.0 - m) * base).tolist(),
            "specularColor": np.clip((1.0 - m) * tinted + m * base, 0.0, 1.0).tolist(),
            "roughness": material.roughness,
        }
    )


def brdf(values: Mapping[str, Any], pairs: ShadingPairs) -> Array:
    """Return the material's BRDF, f in 1/sr, shape (P, 3).

    Args:
        values: values of all parameters in `DEFAULTS`.
        pairs: P direction pairs.

    The lobes, which the specification leaves open, are those of OpenUSD's own previewSurface: GGX with Schlick's
    masking, the diffuse part scaled by one minus the Fresnel term, and the coat added.

    Source: UsdPreviewSurface specification 2.6, specular workflow.
    """
    white = np.ones(3)
    fresnel = lobes.schlick(np.asarray(values["specularColor"]), white, pairs.cos_d)
    coat = lobes.schlick(ior_to_f0(_IOR) * white, white, pairs.cos_d)
    f: Array = (
        np.asarray(values["diffuseColor"]) / np.pi * (1.0 - fresnel)
        + fresnel * _lobe(pairs, values["roughness"])
        + values["clearcoat"] * coat * _lobe(pairs, values["clearcoatRoughness"])
    )
    return f


@per_pairs
def _lobe(pairs: ShadingPairs, roughness: float) -> Array:
    """Return `D G / (4 cos cos)`, (P, 1)."""
    alpha = max(roughness, 0.001) ** 2
    k = 0.5 * alpha
    masking = (pairs.cos_v * (1.0 - k) + k) * (pairs.cos_l * (1.0 - k) + k)
    return (lobes.surface(alpha, alpha).D(pairs.half) / (4.0 * masking))[:, None]
