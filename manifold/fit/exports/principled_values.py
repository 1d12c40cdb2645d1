"""The parameters of Mitsuba's `principled` that exports start from, and quantities of its lobes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from manifold.analytic.principled import LUMINANCE
from manifold.core.errors import UsageError
from manifold.core.records import Array

_END = 1e-4  # values nearer than this to an end of their range are set to the end


@dataclass(frozen=True)
class PrincipledValues:
    """An opaque surface of Mitsuba's `principled`; defaults are Mitsuba's.

    Attributes:
        base_color: linear sRGB, 0 to 1.
        metallic, roughness, specular, clearcoat, clearcoat_gloss, sheen, spec_tint, sheen_tint, flatness,
            anisotropic: 0 to 1, as in Mitsuba's documentation.
        is_diffuse: whether the surface is only a Lambertian base.
        rotation_rad: azimuth along which anisotropic highlights are wide, from 0 to pi, counterclockwise seen from
            outside; Mitsuba's own value is 0, along x.
    """

    base_color: tuple[float, float, float]
    metallic: float = 0.0
    roughness: float = 0.5
    specular: float = 0.5
    clearcoat: float = 0.0
    clearcoat_gloss: float = 0.0
    sheen: float = 0.0
    spec_tint: float = 0.0
    sheen_tint: float = 0.0
    flatness: float = 0.0
    anisotropic: float = 0.0
    is_diffuse: bool = False
    rotation_rad: float = 0.0

    @classmethod
    def from_fit(
        cls, bsdf: Mapping[str, Any], values: Mapping[str, Any], rotation_deg: float = 0.0
    ) -> PrincipledValues:
        """Return the values of a fit, base colours clipped to 0 to 1.

        Args:
            bsdf: description of the fitted family, as `BsdfFamily.to_json` gives it.
            values: parameter values by name.
            rotation_deg: rotation of the fit; ignored if the fit is isotropic.

        Raises:
            UsageError: the fit is neither of `principled` nor of `diffuse`, or transmits light.
        """
        known = {**bsdf.get("fixed", {}), **values}
        if bsdf["type"] == "diffuse":
            return cls(_colour(known["reflectance"]), specular=0.0, is_diffuse=True)
        if bsdf["type"] != "principled":
            raise UsageError(f"a fit of {bsdf['type']} has no counterpart in engines; fit principled")
        if known.get("spec_trans", 0.0):
            raise UsageError(
                "a fit with spec_trans transmits light, which exports do not support; fit without it"
            )
        numbers: dict[str, Any] = {
            k: snapped(known[k]) for k in cls.__dataclass_fields__ if k in known and k != "base_color"
        }
        if "specular" not in known and "eta" in known:
            numbers["specular"] = float(ior_to_f0(float(known["eta"])) / 0.08)
        if numbers.get("anisotropic"):
            numbers["rotation_rad"] = float(np.deg2rad(rotation_deg % 180.0))
        return cls(base_color=_colour(known.get("base_color", 0.5)), **numbers)

    @property
    def ior(self) -> float:
        """Index of refraction, `2 / (1 - sqrt(0.08 specular)) - 1`, for a specular of at least 0.001."""
        return float(2.0 / (1.0 - np.sqrt(0.08 * max(self.specular, 1e-3))) - 1.0)

    @property
    def tint(self) -> Array:
        """The base colour over its luminance, shape (3,); white for black."""
        colour = np.asarray(self.base_color)
        luminance = float(colour @ LUMINANCE)
        return colour / luminance if luminance > 0 else np.ones(3)

    @property
    def coat_weight(self) -> float:
        """The weight of a target's coat of index 1.5 that corresponds to Mitsuba's clear coat.

        Mitsuba's clear coat is not divided by both cosines. It has full strength along the normal and decreases with
        the product of the cosines, whose mean over a sphere lit from the viewer is one half.
        """
        return 0.5 * self.clearcoat

    @property
    def coat_alpha(self) -> float:
        """GGX alpha of a coat whose distribution has the peak of Mitsuba's GTR1; both are normalised."""
        a2 = (0.1 + (0.001 - 0.1) * self.clearcoat_gloss) ** 2
        return float(np.sqrt(a2 * np.log(1.0 / a2) / (1.0 - a2)))

    @property
    def coat_roughness(self) -> float:
        """The roughness of the coat, the square root of `coat_alpha`."""
        return float(np.sqrt(self.coat_alpha))

    @property
    def specular_tint(self) -> Array:
        """Factor of the reflectance at normal incidence, shape (3,), possibly above 1."""
        return 1.0 + self.spec_tint * (self.tint - 1.0)

    @property
    def sheen_colour(self) -> Array:
        """Factor of `(1 - cos(theta_d))^5` in 1/sr, shape (3,)."""
        return self.sheen * (1.0 - self.metallic) * (1.0 + self.sheen_tint * (self.tint - 1.0))

    @property
    def alphas(self) -> tuple[float, float]:
        """GGX alpha along x and y: the square of roughness, stretched by the aspect `sqrt(1 - 0.9 anisotropic)`."""
        aspect = float(np.sqrt(1.0 - 0.9 * self.anisotropic))
        return self.roughness**2 / aspect, self.roughness**2 * aspect

    @property
    def around_mean(self) -> tuple[float, float]:
        """Roughness r and anisotropy a for targets whose alphas are (1 + a) r^2 and (1 - a) r^2."""
        if self.anisotropic == 0.0:
            return self.roughness, 0.0
        x, y = self.alphas
        return float(np.sqrt(min(0.5 * (x + y), 1.0))), (x - y) / (x + y)

    def coat(self, weight: str, roughness: str) -> dict[str, float]:
        """Return the values of a target's coat by the names of its parameters; empty without a coat."""
        return {weight: self.coat_weight, roughness: self.coat_roughness} if self.coat_weight > 0.0 else {}

    def scaled_sheen(
        self, weight: str, colour: str, roughness: str, scale: float, target_roughness: float
    ) -> dict[str, Any]:
        """Return the values of a target's sheen by the names of its parameters; empty without a sheen.

        Args:
            weight, colour, roughness: names of the target's parameters.
            scale: ratio of the target's sheen to Mitsuba's; the weight is at most 1.
            target_roughness: roughness of the target's sheen that is nearest to Mitsuba's sheen.
        """
        most = float(self.sheen_colour.max())
        if most <= 0.0:
            return {}
        colours = (self.sheen_colour / most).tolist()
        return {weight: min(scale * most, 1.0), colour: colours, roughness: target_roughness}


def _colour(value: Any) -> tuple[float, float, float]:
    red, green, blue = np.broadcast_to(np.asarray(value, float), 3)
    return snapped(red), snapped(green), snapped(blue)


def snapped(value: Any) -> float:
    """Return a value from 0 to 1, set to 0 or 1 if it is as near to them as a fit can come."""
    value = min(max(float(value), 0.0), 1.0)
    return 0.0 if value < _END else 1.0 if value > 1.0 - _END else value


def ior_to_f0(ior: float) -> float:
    """Return the reflectance at normal incidence of a dielectric with an index of refraction."""
    return ((ior - 1.0) / (ior + 1.0)) ** 2
