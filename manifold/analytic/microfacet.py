"""Analytic BRDFs of rough surfaces: conductors, dielectrics, thin films and plastic.

Every class follows the protocol that all BRDFs of this package share: `bands`, `is_isotropic`, `eval`,
`eval_cos`, `sample`, `pdf`, `albedo`. Directions point away from the surface, are unit vectors (..., 3) and
broadcast against each other; a direction at or below the horizon gives 0. All models are reciprocal and
reflect at most what arrives.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from manifold.analytic.base import AnalyticBRDF, choose_lobe, cosine_hemisphere, set_per_band
from manifold.analytic.fresnel import fresnel_conductor, fresnel_dielectric, fresnel_thin_film
from manifold.analytic.ggx import GGX, AlbedoTable, GGXMixture, MixedAlbedo, facet_cosines
from manifold.core.directions import gauss_legendre
from manifold.core.errors import UsageError
from manifold.core.records import Array, Bands


class _RoughReflector(AnalyticBRDF):
    """Base class of reflection by a GGX surface; subclasses give the Fresnel reflectance of its facets.

    Single scattering is F D G2 / (4 cos_i cos_o). The light that is scattered more than once is added as a lobe (1 -
    E(wi)) (1 - E(wo)) / (pi (1 - E_avg)) times the colour of two or more reflections, F_avg^2 E_avg / (1 - F_avg (1 -
    E_avg)), E being the albedo of single scattering with F = 1.

    Sources: Kulla & Conty 2017, "Revisiting Physically Based Shading at Imageworks"; F_avg squared, because
    the lobe starts at the second reflection, as in Jakob et al. 2014 and Hill 2018.
    """

    ggx: GGX | GGXMixture
    multiple_scattering: bool

    @abstractmethod
    def reflectance(self, cos_theta: Array) -> Array:
        """Return the Fresnel reflectance of a facet at cosines (n,), shape (n, B) or (n, 1)."""

    @property
    def is_isotropic(self) -> bool:
        """Return whether f is invariant under rotation of both directions about the normal."""
        return self.ggx.is_isotropic

    @cached_property
    def single_scattering(self) -> AlbedoTable | MixedAlbedo:
        """Directional albedo of single scattering, as a table."""
        return self.ggx.albedo_table(self.reflectance(facet_cosines()))

    @cached_property
    def _white(self) -> AlbedoTable | MixedAlbedo:
        return self.ggx.albedo_table(np.ones((facet_cosines().size, 1)))

    @cached_property
    def _multiple_colour(self) -> Array:
        """Albedo per band of the light scattered more than once, shape (B,); see the class."""
        x, w = gauss_legendre(64)
        cosine = 0.5 * (x + 1.0)
        f_avg = (w * cosine) @ self.reflectance(cosine)
        e_avg = float(self._white.hemispherical[0])
        return f_avg**2 * e_avg / (1.0 - f_avg * (1.0 - e_avg))

    @cached_property
    def _lost(self) -> float:
        """1 - E_avg with multiple scattering, 0 without."""
        lost = 1.0 - float(self._white.hemispherical[0])
        return lost if self.multiple_scattering and lost > 1e-9 else 0.0

    def _loss(self, w: Array) -> Array:
        """Return 1 - E(w), shape (n,)."""
        return np.maximum(1.0 - self._white(w)[:, 0], 0.0)

    def _eval(self, wi: Array, wo: Array) -> Array:
        # <wi, h> = <wo, h>, in a form that is symmetric to the last bit
        cosine = np.sqrt(np.clip(0.5 * (1.0 + np.sum(wi * wo, axis=-1)), 0.0, 1.0))
        f = self.reflectance(cosine)
        f *= self.ggx.reflection_factor(wi, wo)[:, None]
        if self._lost:
            lobe = self._loss(wi) * self._loss(wo) / (np.pi * self._lost)
            f += lobe[:, None] * self._multiple_colour
        return f

    @cached_property
    def _lobes(self) -> Array:
        """Probabilities of sampling the mirrored visible normals and the lobe of multiple scattering."""
        p = min(max(self._lost, 0.02), 0.5) if self._lost else 0.0
        return np.array([1.0 - p, p])

    def _sample(self, wi: Array, u: Array) -> Array:
        lobe, u = choose_lobe(self._lobes, u)
        wo = cosine_hemisphere(u)
        single = lobe == 0
        wi = wi[single]
        h = self.ggx.sample_visible_normal(wi, u[single])
        wo[single] = 2.0 * np.sum(wi * h, axis=-1, keepdims=True) * h - wi
        return wo

    def _pdf(self, wi: Array, wo: Array) -> Array:
        p = self._lobes
        return np.asarray(p[0] * self.ggx.pdf_reflection(wi, wo) + p[1] * wo[:, 2] / np.pi)

    def _albedo(self, wi: Array) -> Array:
        albedo = self.single_scattering(wi)
        if self._lost:
            albedo = albedo + self._loss(wi)[:, None] * self._multiple_colour
        return albedo


@dataclass(frozen=True, eq=False)
class RoughConductor(_RoughReflector):
    """A rough metal: reflection by GGX facets of a complex refractive index.

    Attributes:
        ggx: the microsurface.
        eta, k: complex index eta + i k, shape (B,) each; `colour.metal_ior` returns measured indices.
        bands: the spectral bands.
        multiple_scattering: whether to return the light that single scattering loses.
    """

    ggx: GGX | GGXMixture
    eta: Array
    k: Array
    bands: Bands
    multiple_scattering: bool = True

    def __post_init__(self) -> None:
        set_per_band(self, "eta", 0.0)
        set_per_band(self, "k", 0.0)

    def reflectance(self, cos_theta: Array) -> Array:
        """Return the Fresnel reflectance of a facet at cosines (n,), shape (n, B) or (n, 1)."""
        return fresnel_conductor(cos_theta, self.eta, self.k)


@dataclass(frozen=True, eq=False)
class ThinFilm(_RoughReflector):
    """A rough base under a thin transparent film, whose interference colours are exact in every band.

    Attributes:
        film_eta: index of the film, at least 1, shape (B,) or a single number.
        thickness_nm: thickness of the film, at least 0.
        eta, k: complex index of the base, shape (B,) each; k = 0 is a dielectric.
        bands: the spectral bands; RGB is evaluated at 611.4, 549.1 and 464.3 nm.
        multiple_scattering: whether to return the light that single scattering loses.

    Source: see `fresnel_thin_film`.
    """

    ggx: GGX | GGXMixture
    film_eta: Array
    thickness_nm: float
    eta: Array
    k: Array
    bands: Bands
    multiple_scattering: bool = True

    def __post_init__(self) -> None:
        set_per_band(self, "film_eta", 1.0)
        set_per_band(self, "eta", 0.0)
        set_per_band(self, "k", 0.0)
        if not (np.isfinite(self.thickness_nm) and self.thickness_nm >= 0.0):
            raise UsageError(f"thickness_nm is {self.thickness_nm}, expected a thickness of at least 0 nm")

    def reflectance(self, cos_theta: Array) -> Array:
        """Return the Fresnel reflectance of a facet at cosines (n,), shape (n, B) or (n, 1)."""
        # Dominant wavelengths of the sRGB primaries: RGB has no wavelengths of its own.
        wavelengths_nm = np.array(self.bands.wavelengths_nm or (611.4, 549.1, 464.3))
        return fresnel_thin_film(
            cos_theta, wavelengths_nm, self.film_eta, self.thickness_nm, self.eta, self.k
        )


@dataclass(frozen=True, eq=False)
class RoughDielectric(_RoughReflector):
    """The reflection of a rough dielectric boundary with index `eta` relative to air, (B,) or one number.

    Transmitted light is lost (see `Plastic`, `Layered`).
    """

    ggx: GGX | GGXMixture
    eta: Array
    bands: Bands
    # What leaves the first facet downwards mostly enters the medium: no white lobe is owed.
    multiple_scattering = False

    def __post_init__(self) -> None:
        set_per_band(self, "eta", 1e-3)

    def reflectance(self, cos_theta: Array) -> Array:
        """Return the Fresnel reflectance of a facet at cosines (n,), shape (n, B) or (n, 1)."""
        return fresnel_dielectric(cos_theta, self.eta)


@dataclass(frozen=True, eq=False)
class Plastic(AnalyticBRDF):
    """A rough dielectric boundary over a diffuse base.

    f = f_boundary + R (1 - E(wi)) (1 - E(wo)) / (pi (1 - E_avg)), where E is the directional albedo of the
    boundary. The result is reciprocal, and a white base (R = 1) returns exactly the light that the boundary
    transmits.

    Attributes:
        ggx: the microsurface of the boundary.
        eta: index of refraction of the boundary relative to air, shape (B,) or a single number (1.5).
        reflectance: reflectance of the diffuse base, in [0, 1], shape (B,) or a single number.
        bands: the spectral bands.
    Source: Kelemen & Szirmay-Kalos 2001, "A Microfacet Based Coupled Specular-Matte BRDF Model"; in the
    manner of Ashikhmin & Shirley 2000.
    """

    ggx: GGX | GGXMixture
    eta: Array
    reflectance: Array
    bands: Bands

    def __post_init__(self) -> None:
        set_per_band(self, "eta", 1e-3)
        set_per_band(self, "reflectance", 0.0, 1.0)

    @property
    def is_isotropic(self) -> bool:
        """Return whether f is invariant under rotation of both directions about the normal."""
        return self.ggx.is_isotropic

    @cached_property
    def boundary(self) -> RoughDielectric:
        """The specular part: the reflection at the rough boundary."""
        return RoughDielectric(self.ggx, self.eta, self.bands)

    def _passed(self, w: Array) -> Array:
        """Return 1 - E(w), the share that the boundary does not reflect, shape (n, B) or (n, 1)."""
        return np.maximum(1.0 - self.boundary.single_scattering(w), 0.0)

    @cached_property
    def _passed_average(self) -> Array:
        return np.maximum(1.0 - self.boundary.single_scattering.hemispherical, 1e-9)

    @cached_property
    def _lobes(self) -> Array:
        boundary = float(np.mean(1.0 - self._passed_average))
        base = float(np.mean(self.reflectance * self._passed_average))
        p = min(max(boundary / max(boundary + base, 1e-9), 0.2), 1.0 if base == 0.0 else 0.8)
        return np.array([p, 1.0 - p])

    def _eval(self, wi: Array, wo: Array) -> Array:
        scalar = self._passed(wi) * self._passed(wo)
        base = scalar * (self.reflectance / (np.pi * self._passed_average))
        base += self.boundary._eval(wi, wo)
        return base

    def _sample(self, wi: Array, u: Array) -> Array:
        lobe, u = choose_lobe(self._lobes, u)
        wo = cosine_hemisphere(u)
        wo[lobe == 0] = self.boundary._sample(wi[lobe == 0], u[lobe == 0])
        return wo

    def _pdf(self, wi: Array, wo: Array) -> Array:
        p = self._lobes
        return np.asarray(p[0] * self.boundary._pdf(wi, wo) + p[1] * wo[:, 2] / np.pi)

    def _albedo(self, wi: Array) -> Array:
        passed = self._passed(wi)
        return (1.0 - passed) + passed * self.reflectance
