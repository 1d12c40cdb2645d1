"""Evaluates Mitsuba's `principled` for opaque surfaces in NumPy, with derivatives with respect to its parameters.

At a direction pair the model is affine in the base colour `c` and in its tint `c / luminance(c)`; the shared
parameters change only the three coefficients. `Principled` evaluates the coefficients for many parameter vectors at
once.

Source: Burley 2012, "Physically-based shading at Disney", and 2015, "Extending the Disney BRDF to a BSDF with
integrated subsurface scattering", as Mitsuba 3 documents them: the metal is Schlick's, the dielectric exact, the
clear coat is not divided by the cosines.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from manifold.core.directions import normalize
from manifold.core.records import Array, Indices

DEFAULTS = {
    "metallic": 0.0, "roughness": 0.5, "specular": 0.5, "clearcoat": 0.0, "clearcoat_gloss": 0.0, "sheen": 0.0,
    "spec_tint": 0.0, "sheen_tint": 0.0, "flatness": 0.0, "anisotropic": 0.0,
}  # fmt: skip
"""Mitsuba's default values of the shared parameters."""

LUMINANCE = np.array([0.212671, 0.715160, 0.072169])
"""Mitsuba's weights of linear sRGB in the luminance."""

_LEAST_ALPHA = 1e-3  # Mitsuba's
_COAT_ALPHA = 0.25  # of the masking
_COAT_F0 = 0.04
_COAT_ENDS = 0.1, 0.001  # alpha at gloss 0 and 1


class PrincipledFactors(NamedTuple):
    """The factors of the model that depend nonlinearly on parameters; `f0` has shape (..., 1), the others (..., M).

    Attributes:
        specular: `D G / (4 cos(theta_i))` of GGX.
        fresnel, f0: reflectance of the dielectric, at the half vector and at normal incidence.
        retro, flat: retroreflection of the rough base, and Burley's approximate subsurface scattering.
        coat: distribution of the clear coat, GTR of exponent 1.
    """

    specular: Array
    fresnel: Array
    f0: Array
    retro: Array
    flat: Array
    coat: Array


class Diffuse:
    """Mitsuba's `diffuse` at M direction pairs, with the interface of `Principled` but no shared parameters."""

    type: ClassVar[str] = "diffuse"
    colour: ClassVar[str] = "reflectance"
    defaults: ClassVar[Mapping[str, float]] = MappingProxyType({})

    def __init__(self, wi: Array, wo: Array) -> None:
        """Take unit vectors (M, 3)."""
        self._directions = wi, wo
        self._white = np.where((wi[:, 2] > 0.0) & (wo[:, 2] > 0.0), wo[:, 2] / np.pi, 0.0)

    def at(self, rows: Indices) -> Self:
        """Return the model at some of the pairs."""
        wi, wo = self._directions
        return type(self)(wi[rows], wo[rows])

    def coefficients(self, values: Mapping[str, Array | float]) -> Array:
        """Return a, b and c of f cos(theta_o) = a + b colour + c tint in 1/sr, shape (3, 1, M)."""
        return np.stack([0.0 * self._white, self._white, 0.0 * self._white])[:, None]

    def slopes(self, values: Mapping[str, float], names: Collection[str]) -> tuple[Array, dict[str, Array]]:
        """Return the coefficients a, b, c (3, M) of `coefficients`, and no derivatives."""
        return self.coefficients(values)[:, 0], {}


class Principled:
    """Mitsuba's `principled` at M direction pairs, as coefficients of the base colour and its tint.

    Parameter values are passed by name as arrays (P, 1), or numbers. Coefficients have shape (3, P, M): f
    cos(theta_o) in 1/sr is the first, plus the second times the base colour, plus the third times its tint.

    Attributes:
        type: Mitsuba's name of the plugin.
        colour: name of the parameter with a value per band.
        defaults: Mitsuba's default values of the shared parameters; families with other parameters are evaluated by
            Mitsuba.
    """

    type: ClassVar[str] = "principled"
    colour: ClassVar[str] = "base_color"
    defaults: ClassVar[Mapping[str, float]] = MappingProxyType(DEFAULTS)

    def __init__(self, wi: Array, wo: Array) -> None:
        """Take unit vectors (M, 3); the coefficients of pairs with a direction below the horizon are 0."""
        self._directions = wi, wo
        above = (wi[:, 2] > 0.0) & (wo[:, 2] > 0.0)
        up = np.array([0.0, 0.0, 1.0])
        wi, wo = np.where(above[:, None], wi, up), np.where(above[:, None], wo, up)
        half = normalize(wi + wo)
        self._cos_i, self._cos_o, self._cos_h2 = wi[:, 2], wo[:, 2], half[:, 2] ** 2
        self._cos_d = np.clip(np.sum(wi * half, axis=1), 0.0, 1.0)
        self._away = (1.0 - self._cos_d) ** 5
        self._facing = 1.0 - self._away
        lit = np.where(above, self._cos_o, 0.0)
        self._lambert, self._rim = lit / np.pi, lit * self._away
        self._per_cos_i = np.where(above, 0.25 / self._cos_i, 0.0)
        self._half2 = half[:, :2].T ** 2
        self._slopes = [(w[:, :2].T / w[:, 2]) ** 2 for w in (wi, wo)]  # squared slopes along x and y
        away_i, away_o = (1.0 - self._cos_i) ** 5, (1.0 - self._cos_o) ** 5
        self._smooth = (1.0 - 0.5 * away_i) * (1.0 - 0.5 * away_o)
        self._both, self._either = away_i * away_o, away_i + away_o
        self._sum = 1.0 / (self._cos_i + self._cos_o) - 0.5
        masking = [2.0 / (1.0 + np.sqrt(1.0 + _COAT_ALPHA**2 * s.sum(axis=0))) for s in self._slopes]
        coat_fresnel = _COAT_F0 + (1.0 - _COAT_F0) * self._away
        self._coat = 0.25 * coat_fresnel * masking[0] * masking[1] * lit

    def at(self, rows: Indices) -> Self:
        """Return the model at some of the pairs."""
        wi, wo = self._directions
        return type(self)(wi[rows], wo[rows])

    def coefficients(self, values: Mapping[str, Array | float]) -> Array:
        """Return the coefficients (3, P, M) for values of all shared parameters."""
        return self._assemble(values, self._lobes(values)[0])

    def slopes(self, values: Mapping[str, float], names: Collection[str]) -> tuple[Array, dict[str, Array]]:
        """Return the coefficients (3, M) for one vector of shared parameters, and their derivatives in the named ones.

        The coefficients are affine in the lobes that a parameter changes, and in parameters that change no lobe, so
        finite differences are exact derivatives.
        """
        lobes, slopes = self._lobes(values, with_slopes=True)
        here = self._assemble(values, lobes)
        by_name: dict[str, Array] = {}
        for name in names:
            if name in slopes:
                moved = lobes._replace(**{k: getattr(lobes, k) + slope for k, slope in slopes[name].items()})
                by_name[name] = self._assemble(values, moved) - here
            else:
                end = 0.0 if values[name] > 0.5 else 1.0  # far away: no digits are lost
                by_name[name] = (self._assemble({**values, name: end}, lobes) - here) / (end - values[name])
        return here, by_name

    def _assemble(self, values: Mapping[str, Array | float], lobes: PrincipledFactors) -> Array:
        metallic, tint, flat, sheen_tint = (
            values[name] for name in ("metallic", "spec_tint", "flatness", "sheen_tint")
        )
        dielectric = 1.0 - metallic
        base = self._smooth + lobes.retro
        if np.any(flat):
            base += flat * (lobes.flat - base)
        sheen = (values["sheen"] * dielectric) * self._rim
        fresnel = (dielectric * (1.0 - tint)) * lobes.fresnel + (metallic + dielectric * tint) * self._away
        facing = lobes.specular * self._facing
        out = np.empty((3, *np.broadcast_shapes(np.shape(metallic), facing.shape)))
        np.multiply(lobes.specular, fresnel, out=out[0])
        out[0] += values["clearcoat"] * (self._coat * lobes.coat)
        out[0] += sheen * (1.0 - sheen_tint)
        np.multiply(metallic, facing, out=out[1])
        out[1] += dielectric * (base * self._lambert)
        np.multiply(dielectric * tint * lobes.f0, facing, out=out[2])
        out[2] += sheen * sheen_tint
        return out

    def _lobes(
        self, values: Mapping[str, Array | float], *, with_slopes: bool = False
    ) -> tuple[PrincipledFactors, dict[str, dict[str, Array]]]:
        """Return the lobes and, by parameter and lobe, their derivatives."""
        roughness, anisotropic, gloss = (
            np.asarray(values[name], float) for name in ("roughness", "anisotropic", "clearcoat_gloss")
        )
        aspect = np.sqrt(1.0 - 0.9 * anisotropic)
        alphas = [np.maximum(alpha, _LEAST_ALPHA) for alpha in (roughness**2 / aspect, roughness**2 * aspect)]
        stretched = self._half2[0] / alphas[0] ** 2 + self._half2[1] / alphas[1] ** 2 + self._cos_h2
        masking = [np.sqrt(1.0 + alphas[0] ** 2 * s[0] + alphas[1] ** 2 * s[1]) for s in self._slopes]
        g = 4.0 / ((1.0 + masking[0]) * (1.0 + masking[1]))
        specular = self._per_cos_i * g / (np.pi * alphas[0] * alphas[1] * stretched**2)

        root = np.sqrt(0.08 * np.asarray(values["specular"], float))
        eta = (1.0 + root) / (1.0 - root)
        cos_t = np.sqrt(eta**2 - 1.0 + self._cos_d**2)  # times the index
        perpendicular = (self._cos_d - cos_t) / (self._cos_d + cos_t)
        parallel = (eta**2 * self._cos_d - cos_t) / (eta**2 * self._cos_d + cos_t)
        fresnel = 0.5 * (perpendicular**2 + parallel**2)

        rim = 2.0 * roughness * self._cos_d**2
        retro = rim * (self._either + self._both * (rim - 1.0))
        fss = 1.0 + (0.5 * rim - 1.0) * self._either + (0.5 * rim - 1.0) ** 2 * self._both
        flat = 1.25 * (fss * self._sum + 0.5)

        alpha = _COAT_ENDS[0] + (_COAT_ENDS[1] - _COAT_ENDS[0]) * gloss
        a2 = alpha**2
        below = 1.0 + (a2 - 1.0) * self._cos_h2
        coat = (a2 - 1.0) / (np.pi * np.log(a2) * below)
        lobes = PrincipledFactors(specular, fresnel, root**2, retro, flat, coat)
        if not with_slopes:
            return lobes, {}

        by_alpha = [  # of the specular lobe
            specular
            * (
                -1.0 / a
                + 4.0 * h2 / (a**3 * stretched)
                - sum(a * s[axis] / (m * (1.0 + m)) for s, m in zip(self._slopes, masking, strict=True))
            )
            * (a > _LEAST_ALPHA)
            for axis, (a, h2) in enumerate(zip(alphas, self._half2, strict=True))
        ]
        by_roughness = (by_alpha[0] / aspect + by_alpha[1] * aspect) * 2.0 * roughness
        by_anisotropic = (by_alpha[0] / aspect**3 - by_alpha[1] / aspect) * 0.45 * roughness**2
        by_rim = (
            self._either + self._both * (2.0 * rim - 1.0),
            0.625 * self._sum * (self._either + self._both * (rim - 2.0)),
        )
        rim_slope = 2.0 * self._cos_d**2
        by_specular = 0.04 / np.maximum(root, 1e-9)  # of the root
        eta_slope = 2.0 / (1.0 - root) ** 2
        cos_slope = eta / cos_t  # by eta
        square_slope = 2.0 * eta * self._cos_d
        by_eta = (
            perpendicular * -2.0 * self._cos_d * cos_slope / (self._cos_d + cos_t) ** 2
            + parallel
            * 2.0
            * (square_slope * cos_t - eta**2 * self._cos_d * cos_slope)
            / (eta**2 * self._cos_d + cos_t) ** 2
        )
        by_square = coat * (1.0 / (a2 - 1.0) - 1.0 / (a2 * np.log(a2)) - self._cos_h2 / below)
        return lobes, {
            "roughness": {
                "specular": by_roughness,
                "retro": by_rim[0] * rim_slope,
                "flat": by_rim[1] * rim_slope,
            },
            "anisotropic": {"specular": by_anisotropic},
            "specular": {"fresnel": by_eta * eta_slope * by_specular, "f0": 2.0 * root * by_specular},
            "clearcoat_gloss": {"coat": by_square * 2.0 * alpha * (_COAT_ENDS[1] - _COAT_ENDS[0])},
        }


MODELS: dict[str, type[Any]] = {model.type: model for model in (Principled, Diffuse)}
"""The BSDFs that `render.bsdf_evaluation` evaluates in NumPy, by their names as plugins of Mitsuba."""
