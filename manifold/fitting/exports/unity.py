"""Unity, High Definition pipeline: properties of the Lit shader, with their conventions."""

from __future__ import annotations

from typing import Any

import numpy as np

from manifold.colour.conversion import encode_srgb
from manifold.fitting.exports.principled_values import Principled

DEFAULTS: dict[str, Any] = {
    "_BaseColor": [1.0, 1.0, 1.0],
    "_Metallic": 0.0,
    "_Smoothness": 0.5,
    "_Anisotropy": 0.0,
    "_CoatMask": 0.0,
}
"""Every property that exports may set, with its default."""

CONVENTIONS: dict[str, str] = {
    "_BaseColor": "sRGB-encoded, 0 to 1, as Unity's colour properties are",
    "_Metallic": "0 to 1",
    "_Smoothness": "0 to 1; perceptual roughness is 1 minus it, GGX alpha the square of that",
    "_Anisotropy": "-1 to 1; alpha along the tangent (1 + a), across (1 - a) times the square of roughness",
    "_CoatMask": "0 to 1; the coat has index 1.5 and a fixed smoothness",
}

_SMOOTH_COAT = 0.1  # GGX alpha: a rougher coat would turn into a sharp highlight


def parameters(material: Principled) -> dict[str, Any]:
    """Properties of a material, all of `DEFAULTS`; reflectance at normal incidence is Unity's 0.04."""
    roughness, anisotropy = material.around_mean
    made = DEFAULTS | {
        "_BaseColor": encode_srgb(np.asarray(material.base_color)).tolist(),
        "_Metallic": material.metallic,
        "_Smoothness": 1.0 - roughness,
        "_Anisotropy": anisotropy,
    }
    if material.coat_weight > 0.0 and material.coat_alpha <= _SMOOTH_COAT:
        made["_CoatMask"] = material.coat_weight
    return made
