"""Analytic BRDFs: rough conductors, dielectrics and thin films, plastic, sheen, layers and mixtures.

Every class follows the protocol that all BRDFs of this package share: `bands`, `is_isotropic`, `eval`,
`eval_cos`, `sample`, `pdf`, `albedo`. Directions point away from the surface, are unit vectors (..., 3) and
broadcast against each other; a direction at or below the horizon gives 0. All models are reciprocal and
reflect at most what arrives.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Protocol

import numpy as np

from manifold.directions import from_spherical, hemisphere_quadrature, require_directions
from manifold.errors import ShapeError, UsageError
from manifold.fresnel import fresnel_conductor, fresnel_dielectric, fresnel_thin_film
from manifold.ggx import GGX, AlbedoTable, facet_cosines
from manifold.records import Array, Bands

__all__ = [
    "GGX",
    "Lambert",
    "Layered",
    "MixedBRDF",
    "Plastic",
    "RoughConductor",
    "RoughDielectric",
    "Sheen",
    "ThinFilm",
    "fresnel_conductor",
    "fresnel_dielectric",
    "fresnel_thin_film",
]


class Component(Protocol):
    """What `MixedBRDF` and `Layered` need of their parts: the protocol of all BRDFs."""

    @property
    def bands(self) -> Bands: ...
    @property
    def is_isotropic(self) -> bool: ...
    def eval(self, wi: Array, wo: Array) -> Array: ...
    def sample(self, wi: Array, u: Array) -> tuple[Array, Array]: ...
    def pdf(self, wi: Array, wo: Array) -> Array: ...
    def albedo(self, wi: Array) -> Array: ...


class AnalyticBRDF(ABC):
    """Validation, broadcasting and horizon handling that all models share.

    Subclasses hold `bands` and implement `_eval`, `_sample`, `_pdf` and `_albedo` for flat arrays (n, 3) of
    directions above the horizon.
    """

    bands: Bands

    @property
    @abstractmethod
    def is_isotropic(self) -> bool:
        """Whether turning both directions about the normal changes nothing."""

    @abstractmethod
    def _eval(self, wi: Array, wo: Array) -> Array:
        """f in 1/sr, shape (n, B) or (n, 1) where all bands agree."""

    @abstractmethod
    def _sample(self, wi: Array, u: Array) -> Array:
        """Directions (n, 3), possibly below the horizon."""

    @abstractmethod
    def _pdf(self, wi: Array, wo: Array) -> Array:
        """Density of `_sample` in 1/sr, shape (n,)."""

    @abstractmethod
    def _albedo(self, wi: Array) -> Array:
        """Directional albedo, shape (n, B) or (n, 1)."""

    def eval(self, wi: Array, wo: Array) -> Array:
        """BRDF value f in 1/sr, shape (..., B); 0 where a direction is at or below the horizon.

        Raises:
            ShapeError: a direction is not a unit vector (..., 3), or the shapes do not broadcast.
        """
        wi, wo, shape = _pairs(wi, wo)
        return _scatter(self._eval, shape, self.bands.count, wi, wo)

    def eval_cos(self, wi: Array, wo: Array) -> Array:
        """f * cos(theta_o) in 1/sr, shape (..., B). Raises: as `eval`."""
        f_cos = self.eval(wi, wo)
        f_cos *= np.maximum(np.asarray(wo, float)[..., 2], 0.0)[..., None]
        return f_cos

    def sample(self, wi: Array, u: Array) -> tuple[Array, Array]:
        """Draw outgoing directions.

        Args:
            wi: directions (..., 3).
            u: uniform numbers in [0, 1), shape (..., 2).
        Returns:
            wo (..., 3) and their density in 1/sr (...); the density is 0 where the sample fell below the
            horizon or `wi` lies there, and such samples count as black.
        Raises:
            ShapeError: `wi` is not made of unit vectors, or u is not (..., 2) in [0, 1].
        """
        wi, u = require_directions(wi, "wi"), np.asarray(u, float)
        if u.ndim == 0 or u.shape[-1] != 2 or not np.all((u >= 0.0) & (u <= 1.0)):
            raise ShapeError(f"u has shape {u.shape}, expected (..., 2) with values in [0, 1]")
        shape = _broadcast(wi, u)
        wi = np.broadcast_to(wi, (*shape, 3)).reshape(-1, 3)
        u = np.broadcast_to(u, (*shape, 2)).reshape(-1, 2)
        wo = np.zeros_like(wi)
        wo[:, 2] = -1.0
        up = wi[:, 2] > 0.0
        wo[up] = self._sample(wi[up], u[up])
        pdf = _scatter(lambda a, b: self._pdf(a, b)[:, None], shape, 1, wi, wo)
        return wo.reshape(*shape, 3), pdf[..., 0]

    def pdf(self, wi: Array, wo: Array) -> Array:
        """Density of `sample` in 1/sr of solid angle, shape (...). Raises: as `eval`."""
        wi, wo, shape = _pairs(wi, wo)
        return _scatter(lambda a, b: self._pdf(a, b)[:, None], shape, 1, wi, wo)[..., 0]

    def albedo(self, wi: Array) -> Array:
        """Directional albedo, the integral of f cos(theta_o) over wo, shape (..., B); 0 below the horizon.

        Numerical: within 1e-3 of the exact integral for the microfacet models and their mixtures, and
        within 5e-3 for `Sheen` and `Layered`.

        Raises:
            ShapeError: `wi` is not made of unit vectors (..., 3).
        """
        wi = require_directions(wi, "wi")
        flat = wi.reshape(-1, 3)
        return _scatter(lambda a, _: self._albedo(a), wi.shape[:-1], self.bands.count, flat, flat)


@dataclass(frozen=True, eq=False)
class Lambert(AnalyticBRDF):
    """Ideal diffuse reflection.

    Attributes:
        reflectance: in [0, 1], shape (B,) or a single number.
        bands: the spectral axis.
    """

    reflectance: Array
    bands: Bands

    def __post_init__(self) -> None:
        _set(self, "reflectance", _per_band(self.reflectance, self.bands, "reflectance", 0.0, 1.0))

    @property
    def is_isotropic(self) -> bool:
        return True

    def _eval(self, wi: Array, wo: Array) -> Array:
        return np.broadcast_to(self.reflectance / np.pi, (wi.shape[0], self.reflectance.size))

    def _sample(self, wi: Array, u: Array) -> Array:
        return _cosine_hemisphere(u)

    def _pdf(self, wi: Array, wo: Array) -> Array:
        return wo[:, 2] / np.pi

    def _albedo(self, wi: Array) -> Array:
        return np.broadcast_to(self.reflectance, (wi.shape[0], self.reflectance.size))


class _RoughReflector(AnalyticBRDF):
    """Reflection by a GGX surface whose facets have any Fresnel reflectance.

    Single scattering is F D G2 / (4 cos_i cos_o). Light that is scattered more than once, which it omits, is
    put back as a lobe (1 - E(wi)) (1 - E(wo)) / (pi (1 - E_avg)) times the colour of two and more reflections,
    F_avg^2 E_avg / (1 - F_avg (1 - E_avg)), E being the albedo of single scattering with F = 1.

    Sources: Kulla & Conty 2017, "Revisiting Physically Based Shading at Imageworks"; F_avg squared, because
    the lobe starts at the second reflection, as in Jakob et al. 2014 and Hill 2018.
    """

    ggx: GGX
    multiple_scattering: bool

    @abstractmethod
    def reflectance(self, cos_theta: Array) -> Array:
        """Fresnel reflectance of a facet at cosines (n,), shape (n, B) or (n, 1)."""

    @property
    def is_isotropic(self) -> bool:
        return self.ggx.is_isotropic

    @cached_property
    def single_scattering(self) -> AlbedoTable:
        """Directional albedo of single scattering."""
        return self.ggx.albedo_table(self.reflectance(facet_cosines()))

    @cached_property
    def _white(self) -> AlbedoTable:
        return self.ggx.albedo_table(np.ones((facet_cosines().size, 1)))

    @cached_property
    def _multiple_colour(self) -> Array:
        """Albedo per band of the light scattered more than once, shape (B,); see the class."""
        x, w = np.polynomial.legendre.leggauss(64)
        cosine = 0.5 * (x + 1.0)
        f_avg = (w * cosine) @ self.reflectance(cosine)
        e_avg = float(self._white.hemispherical[0])
        return f_avg**2 * e_avg / (1.0 - f_avg * (1.0 - e_avg))

    @cached_property
    def _lost(self) -> float:
        """1 - E_avg where multiple scattering is on, else 0."""
        lost = 1.0 - float(self._white.hemispherical[0])
        return lost if self.multiple_scattering and lost > 1e-9 else 0.0

    def _loss(self, w: Array) -> Array:
        """1 - E(w), shape (n,)."""
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
        lobe, u = _choose(self._lobes, u)
        wo = _cosine_hemisphere(u)
        single = lobe == 0
        wi = wi[single]
        h = self.ggx.sample_visible_normal(wi, u[single])
        wo[single] = 2.0 * np.sum(wi * h, axis=-1, keepdims=True) * h - wi
        return wo

    def _pdf(self, wi: Array, wo: Array) -> Array:
        p = self._lobes
        return p[0] * self.ggx.pdf_reflection(wi, wo) + p[1] * wo[:, 2] / np.pi

    def _albedo(self, wi: Array) -> Array:
        albedo = self.single_scattering(wi)
        if self._lost:
            albedo = albedo + self._loss(wi)[:, None] * self._multiple_colour
        return albedo


@dataclass(frozen=True, eq=False)
class RoughConductor(_RoughReflector):
    """A rough metal.

    Attributes:
        ggx: the microsurface.
        eta, k: complex index eta + i k, shape (B,) each; `spectra.metal_ior` has measured ones.
        bands: the spectral axis.
        multiple_scattering: whether to return the light that single scattering loses.
    """

    ggx: GGX
    eta: Array
    k: Array
    bands: Bands
    multiple_scattering: bool = True

    def __post_init__(self) -> None:
        _set(self, "eta", _per_band(self.eta, self.bands, "eta", 0.0))
        _set(self, "k", _per_band(self.k, self.bands, "k", 0.0))

    def reflectance(self, cos_theta: Array) -> Array:
        return fresnel_conductor(cos_theta, self.eta, self.k)


@dataclass(frozen=True, eq=False)
class ThinFilm(_RoughReflector):
    """A rough base under a thin transparent film: iridescence by interference, exact per band.

    Attributes:
        ggx: the microsurface.
        film_eta: index of the film, at least 1, shape (B,) or a single number.
        thickness_nm: thickness of the film in nm, at least 0.
        eta, k: complex index of the base, shape (B,) each; k = 0 is a dielectric.
        bands: the spectral axis; RGB is taken at 611.4, 549.1 and 464.3 nm.
        multiple_scattering: whether to return the light that single scattering loses.
    Source: see `fresnel_thin_film`.
    """

    ggx: GGX
    film_eta: Array
    thickness_nm: float
    eta: Array
    k: Array
    bands: Bands
    multiple_scattering: bool = True

    def __post_init__(self) -> None:
        _set(self, "film_eta", _per_band(self.film_eta, self.bands, "film_eta", 1.0))
        _set(self, "eta", _per_band(self.eta, self.bands, "eta", 0.0))
        _set(self, "k", _per_band(self.k, self.bands, "k", 0.0))
        if not (np.isfinite(self.thickness_nm) and self.thickness_nm >= 0.0):
            raise UsageError(f"thickness_nm is {self.thickness_nm}, expected a thickness of at least 0 nm")

    def reflectance(self, cos_theta: Array) -> Array:
        # Dominant wavelengths of the sRGB primaries: RGB has no wavelengths of its own.
        wavelengths_nm = np.array(self.bands.wavelengths_nm or (611.4, 549.1, 464.3))
        return fresnel_thin_film(
            cos_theta, wavelengths_nm, self.film_eta, self.thickness_nm, self.eta, self.k
        )


@dataclass(frozen=True, eq=False)
class RoughDielectric(_RoughReflector):
    """What a rough dielectric boundary reflects; what it transmits is lost (see `Plastic`, `Layered`).

    Attributes:
        ggx: the microsurface.
        eta: index of refraction relative to air, above 0, shape (B,) or a single number.
        bands: the spectral axis.
    """

    ggx: GGX
    eta: Array
    bands: Bands
    # What leaves the first facet downwards mostly enters the medium: no white lobe is owed.
    multiple_scattering = False

    def __post_init__(self) -> None:
        _set(self, "eta", _per_band(self.eta, self.bands, "eta", 1e-3))

    def reflectance(self, cos_theta: Array) -> Array:
        return fresnel_dielectric(cos_theta, self.eta)


@dataclass(frozen=True, eq=False)
class Plastic(AnalyticBRDF):
    """A rough dielectric boundary over a diffuse base.

    f = f_boundary + R (1 - E(wi)) (1 - E(wo)) / (pi (1 - E_avg)), E being the boundary's directional albedo:
    reciprocal, and a white base (R = 1) returns exactly what the boundary lets through.

    Attributes:
        ggx: the microsurface of the boundary.
        eta: its index of refraction relative to air, shape (B,) or a single number (1.5).
        reflectance: of the diffuse base, in [0, 1], shape (B,) or a single number.
        bands: the spectral axis.
    Source: Kelemen & Szirmay-Kalos 2001, "A Microfacet Based Coupled Specular-Matte BRDF Model"; in the
    manner of Ashikhmin & Shirley 2000.
    """

    ggx: GGX
    eta: Array
    reflectance: Array
    bands: Bands

    def __post_init__(self) -> None:
        _set(self, "eta", _per_band(self.eta, self.bands, "eta", 1e-3))
        _set(self, "reflectance", _per_band(self.reflectance, self.bands, "reflectance", 0.0, 1.0))

    @property
    def is_isotropic(self) -> bool:
        return self.ggx.is_isotropic

    @cached_property
    def boundary(self) -> RoughDielectric:
        """The specular part."""
        return RoughDielectric(self.ggx, self.eta, self.bands)

    def _passed(self, w: Array) -> Array:
        """1 - E(w): what the boundary does not reflect, shape (n, B) or (n, 1)."""
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
        lobe, u = _choose(self._lobes, u)
        wo = _cosine_hemisphere(u)
        wo[lobe == 0] = self.boundary._sample(wi[lobe == 0], u[lobe == 0])
        return wo

    def _pdf(self, wi: Array, wo: Array) -> Array:
        p = self._lobes
        return p[0] * self.boundary._pdf(wi, wo) + p[1] * wo[:, 2] / np.pi

    def _albedo(self, wi: Array) -> Array:
        passed = self._passed(wi)
        return (1.0 - passed) + passed * self.reflectance


@dataclass(frozen=True, eq=False)
class Sheen(AnalyticBRDF):
    """Back-scattering fuzz of cloth: fibres that stand off the surface.

    D(h) = (2 + 1/r) sin(theta_h)^(1/r) / (2 pi) with the shadowing term 1 / (4 (cos_i + cos_o - cos_i cos_o)),
    scaled by one number per roughness where its albedo would pass 1, which keeps it reciprocal.

    Attributes:
        roughness: r in [0.05, 1]: small is a narrow rim near grazing, 1 is broad.
        colour: in [0, 1], shape (B,) or a single number.
        bands: the spectral axis.
    Sources: Estevez & Kulla 2017, "Production Friendly Microfacet Sheen BRDF" (the distribution);
    Ashikhmin & Premoze 2007, "Distribution-based BRDFs" (the shadowing term, symmetric and cheap).
    """

    roughness: float
    colour: Array
    bands: Bands

    def __post_init__(self) -> None:
        if not 0.05 <= self.roughness <= 1.0:
            raise UsageError(f"roughness is {self.roughness}, expected a number from 0.05 to 1")
        _set(self, "colour", _per_band(self.colour, self.bands, "colour", 0.0, 1.0))

    @property
    def is_isotropic(self) -> bool:
        return True

    def _eval(self, wi: Array, wo: Array) -> Array:
        scale = 1.0 / max(float(_sheen_albedo(self.roughness).max()), 1.0)
        return (scale * _sheen(self.roughness, wi, wo))[:, None] * self.colour

    def _sample(self, wi: Array, u: Array) -> Array:
        return _uniform_hemisphere(u)

    def _pdf(self, wi: Array, wo: Array) -> Array:
        return np.full(wi.shape[0], 0.5 / np.pi)

    def _albedo(self, wi: Array) -> Array:
        table = _sheen_albedo(self.roughness)
        value = np.interp(np.sqrt(wi[:, 2]), np.linspace(0.0, 1.0, table.size), table / max(table.max(), 1.0))
        return value[:, None] * self.colour


@dataclass(frozen=True, eq=False)
class MixedBRDF(AnalyticBRDF):
    """A weighted sum of BRDFs with the same bands, such as flakes of several kinds side by side.

    Attributes:
        components: pairs (weight, BRDF), weights at least 0 with a sum above 0 and at most 1.
    Raises:
        UsageError: there are no components, or the weights are not as said.
        BandMismatchError: the components have different bands.
    """

    components: Sequence[tuple[float, Component]]

    def __post_init__(self) -> None:
        parts = tuple((float(w), brdf) for w, brdf in self.components)
        weights = [w for w, _ in parts]
        # 1e-9: thirds and tenths do not sum to 1 in binary
        if not parts or not all(0.0 <= w <= 1.0 for w in weights) or not 0.0 < sum(weights) <= 1.0 + 1e-9:
            raise UsageError(f"mixture weights are {weights}, expected numbers >= 0 with a sum in (0, 1]")
        for i, (_, brdf) in enumerate(parts):
            parts[0][1].bands.require_same(
                brdf.bands, f"component {i} of the mixture", "resample one of them"
            )
        _set(self, "components", parts)
        _set(self, "bands", parts[0][1].bands)

    @property
    def is_isotropic(self) -> bool:
        return all(brdf.is_isotropic for _, brdf in self.components)

    @cached_property
    def _lobes(self) -> Array:
        weights = np.array([w for w, _ in self.components])
        return weights / weights.sum()

    def _eval(self, wi: Array, wo: Array) -> Array:
        f = np.zeros((wi.shape[0], self.bands.count))
        for weight, brdf in self.components:
            f += weight * brdf.eval(wi, wo)
        return f

    def _sample(self, wi: Array, u: Array) -> Array:
        lobe, u = _choose(self._lobes, u)
        wo = np.empty_like(wi)
        for i, (_, brdf) in enumerate(self.components):
            wo[lobe == i] = brdf.sample(wi[lobe == i], u[lobe == i])[0]
        return wo

    def _pdf(self, wi: Array, wo: Array) -> Array:
        return sum(
            (p * brdf.pdf(wi, wo) for p, (_, brdf) in zip(self._lobes, self.components, strict=True)),
            np.zeros(wi.shape[0]),
        )

    def _albedo(self, wi: Array) -> Array:
        albedo = np.zeros((wi.shape[0], self.bands.count))
        for weight, brdf in self.components:
            albedo += weight * brdf.albedo(wi)
        return albedo


@dataclass(frozen=True, eq=False)
class Layered(AnalyticBRDF):
    """One BRDF over another: a coat over metallic paint, sheen over felt.

    f = f_top + (1 - E(wi)) (1 - E(wo)) f_base, E being the albedo of the top: what the top does not reflect
    reaches the base, undeflected, and leaves likewise. Reciprocal, and reflects at most what arrives if both
    layers do; light that would go back and forth between them is lost (`Plastic` loses none).

    Attributes:
        top, base: BRDFs with the same bands.
    Raises:
        BandMismatchError: they have different bands.
    Source: the albedo scaling of Kulla & Conty 2017, made symmetric.
    """

    top: Component
    base: Component

    def __post_init__(self) -> None:
        self.top.bands.require_same(self.base.bands, "base of the layers", "resample one of them")
        _set(self, "bands", self.top.bands)

    @property
    def is_isotropic(self) -> bool:
        return self.top.is_isotropic and self.base.is_isotropic

    @cached_property
    def _lobes(self) -> Array:
        nodes, weights = hemisphere_quadrature(6, 8)
        top, base = (
            float((weights * nodes[:, 2]) @ brdf.albedo(nodes).mean(axis=-1)) / np.pi
            for brdf in (self.top, self.base)
        )
        passed = base * (1.0 - top) ** 2
        p = min(max(top / max(top + passed, 1e-9), 0.1), 0.9)
        return np.array([p, 1.0 - p])

    def _passed(self, w: Array) -> Array:
        return np.maximum(1.0 - self.top.albedo(w), 0.0)

    def _eval(self, wi: Array, wo: Array) -> Array:
        f = self._passed(wi) * self._passed(wo)
        f *= self.base.eval(wi, wo)
        f += self.top.eval(wi, wo)
        return f

    def _sample(self, wi: Array, u: Array) -> Array:
        lobe, u = _choose(self._lobes, u)
        wo = np.empty_like(wi)
        for i, brdf in enumerate((self.top, self.base)):
            wo[lobe == i] = brdf.sample(wi[lobe == i], u[lobe == i])[0]
        return wo

    def _pdf(self, wi: Array, wo: Array) -> Array:
        return self._lobes[0] * self.top.pdf(wi, wo) + self._lobes[1] * self.base.pdf(wi, wo)

    def _albedo(self, wi: Array) -> Array:
        # By the base's own sampling on an even grid of numbers, one direction at a time to bound memory.
        n = 48
        u = (np.stack(np.meshgrid(np.arange(n), np.arange(n)), axis=-1).reshape(-1, 2) + 0.5) / n
        through = np.empty((wi.shape[0], self.bands.count))
        for i, w in enumerate(wi):
            wo, pdf = self.base.sample(w, u)
            kept = pdf > 0.0
            f = self._passed(wo[kept]) * self.base.eval(w, wo[kept])
            through[i] = (wo[kept, 2] / pdf[kept]) @ f / (n * n)
        return self.top.albedo(wi) + self._passed(wi) * through


def _sheen(roughness: float, wi: Array, wo: Array) -> Array:
    """The sheen lobe in 1/sr, before scaling, shape (n,)."""
    h = wi + wo
    # sin^2 = |h_xy|^2 / |h|^2 keeps its digits near the normal, where 1 - cos^2 does not
    sin_squared = (h[:, 0] ** 2 + h[:, 1] ** 2) / np.sum(h * h, axis=-1)
    d = (2.0 + 1.0 / roughness) * sin_squared ** (0.5 / roughness) / (2.0 * np.pi)
    ci, co = wi[:, 2], wo[:, 2]
    return d / (4.0 * (ci + co - ci * co))


@lru_cache(maxsize=64)
def _sheen_albedo(roughness: float) -> Array:
    """Albedo of the unscaled sheen lobe at 65 elevations evenly spaced in sqrt(cos), grazing first."""
    cosines = np.maximum(np.linspace(0.0, 1.0, 65) ** 2, 1e-6)
    nodes, weights = hemisphere_quadrature(96, 96)
    directions = from_spherical(np.arccos(cosines), 0.0)
    table = [
        float((weights * nodes[:, 2]) @ _sheen(roughness, np.broadcast_to(w, nodes.shape), nodes))
        for w in directions
    ]
    return np.array(table)


def _choose(probabilities: Array, u: Array) -> tuple[Array, Array]:
    """Pick a lobe with u[:, 0], which is stretched back to [0, 1) so that it can be used again."""
    edges = np.concatenate([[0.0], np.cumsum(probabilities)])
    lobe = np.minimum(np.searchsorted(edges, u[:, 0], side="right") - 1, probabilities.size - 1)
    # u = 1 would fall into a last lobe of probability 0
    lobe = np.minimum(lobe, np.flatnonzero(probabilities)[-1])
    rest = (u[:, 0] - edges[lobe]) / probabilities[lobe]
    return lobe, np.stack([np.clip(rest, 0.0, 1.0), u[:, 1]], axis=-1)


def _cosine_hemisphere(u: Array) -> Array:
    """Directions (n, 3) of density cos(theta) / pi."""
    r, phi = np.sqrt(u[:, 1]), 2.0 * np.pi * u[:, 0]
    return np.stack([r * np.cos(phi), r * np.sin(phi), np.sqrt(1.0 - u[:, 1])], axis=-1)


def _uniform_hemisphere(u: Array) -> Array:
    """Directions (n, 3) of density 1 / (2 pi)."""
    z, phi = 1.0 - u[:, 1], 2.0 * np.pi * u[:, 0]
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=-1)


def _broadcast(a: Array, b: Array) -> tuple[int, ...]:
    """The common leading shape of two arrays whose last axis is a vector."""
    try:
        return np.broadcast_shapes(a.shape[:-1], b.shape[:-1])
    except ValueError:
        raise ShapeError(f"shapes {a.shape} and {b.shape} do not broadcast against each other") from None


def _pairs(wi: Array, wo: Array) -> tuple[Array, Array, tuple[int, ...]]:
    """Checked pairs of directions, flat (n, 3) each, and the shape they came in."""
    wi, wo = require_directions(wi, "wi"), require_directions(wo, "wo")
    shape = _broadcast(wi, wo)
    return (
        np.broadcast_to(wi, (*shape, 3)).reshape(-1, 3),
        np.broadcast_to(wo, (*shape, 3)).reshape(-1, 3),
        shape,
    )


def _scatter(function: Any, shape: tuple[int, ...], count: int, wi: Array, wo: Array) -> Array:
    """`function` of the pairs above the horizon, zeros elsewhere, in shape (*shape, count)."""
    up = (wi[:, 2] > 0.0) & (wo[:, 2] > 0.0)
    if up.all():
        values = function(wi, wo)
        if values.shape[1] != count or not values.flags.writeable:
            values = np.broadcast_to(values, (wi.shape[0], count)).copy()
        return values.reshape(*shape, count)
    out = np.zeros((wi.shape[0], count))
    out[up] = function(wi[up], wo[up])
    return out.reshape(*shape, count)


def _per_band(value: Array, bands: Bands, name: str, low: float, high: float = np.inf) -> Array:
    """A read-only copy, shape (B,) or (1,) for a single number, checked to lie in [low, high].

    Raises:
        ShapeError: it is neither of shape (B,) nor a single number.
        UsageError: a value is out of range or not finite.
    """
    a = np.atleast_1d(np.array(value, dtype=np.float64))
    if a.shape not in ((bands.count,), (1,)):
        raise ShapeError(f"{name} has shape {a.shape}, expected ({bands.count},) for {bands}, or one number")
    if not np.all(np.isfinite(a) & (a >= low) & (a <= high)):
        raise UsageError(
            f"{name} spans {a.min():.4g} to {a.max():.4g}, expected values in [{low:g}, {high:g}]"
        )
    a.setflags(write=False)
    return a


def _set(record: object, name: str, value: object) -> None:
    """Replace a field of a frozen record by its checked form."""
    object.__setattr__(record, name, value)
