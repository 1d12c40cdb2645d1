"""BRDFs made of other BRDFs: weighted mixtures, and one layer over another."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from manifold.analytic.base import AnalyticBRDF, choose_lobe, set_per_band
from manifold.brdf.interface import BRDF
from manifold.core.directions import hemisphere_quadrature
from manifold.core.errors import UsageError
from manifold.core.records import Array


@dataclass(frozen=True, eq=False)
class Immersed(AnalyticBRDF):
    """A BRDF under a transparent, absorbing layer.

    Its value is t^(1 / cos_i' + 1 / cos_o') f(wi', wo') / eta^2, where primes mark refracted directions.

    The reflection at the boundary of the layer is not included (see `Layered`). Light that the boundary reflects
    back inside is lost.

    Attributes:
        brdf: the BRDF below the layer.
        eta: index of refraction of the layer, at least 1.
        transmittance: transmittance of the layer along its normal, one way, in [0, 1], shape (B,) or a single number.

    Source: Weidlich & Wilkie 2007, "Arbitrarily Layered Micro-Facet Surfaces", with the radiance's factor 1 / eta^2.
    """

    brdf: BRDF
    eta: float
    transmittance: Array = field(default_factory=lambda: np.ones(1))

    def __post_init__(self) -> None:
        if not (np.isfinite(self.eta) and self.eta >= 1.0):
            raise UsageError(f"eta is {self.eta}, expected an index of refraction of at least 1")
        object.__setattr__(self, "bands", self.brdf.bands)
        set_per_band(self, "transmittance", 0.0, 1.0)

    @property
    def is_isotropic(self) -> bool:
        """Return whether f is invariant under rotation of both directions about the normal."""
        return self.brdf.is_isotropic

    def _inside(self, w: Array) -> Array:
        """Return directions (n, 3) after refraction."""
        plane = w[:, :2] / self.eta
        return np.column_stack([plane, np.sqrt(1.0 - np.sum(plane**2, axis=-1))])

    def _outside(self, inner: Array) -> Array:
        """Return directions (n, 3) refracted to `inner`, below the horizon if `inner` is or the light stays inside."""
        plane = inner[:, :2] * self.eta
        squared = np.sum(plane**2, axis=-1)
        outer = np.column_stack([plane, np.sqrt(np.maximum(1.0 - squared, 0.0))])
        outer[(squared >= 1.0) | (inner[:, 2] <= 0.0)] = (0.0, 0.0, -1.0)
        return outer

    def _eval(self, wi: Array, wo: Array) -> Array:
        inner_i, inner_o = self._inside(wi), self._inside(wo)
        f = self.brdf.eval(inner_i, inner_o) / self.eta**2
        if np.any(self.transmittance != 1.0):
            f *= self.transmittance ** (1.0 / inner_i[:, 2:] + 1.0 / inner_o[:, 2:])
        return f

    def _sample(self, wi: Array, u: Array) -> Array:
        return self._outside(self.brdf.sample(self._inside(wi), u)[0])

    def _pdf(self, wi: Array, wo: Array) -> Array:
        inner = self._inside(wo)
        return self.brdf.pdf(self._inside(wi), inner) * wo[:, 2] / (self.eta**2 * inner[:, 2])


@dataclass(frozen=True, eq=False)
class Retroreflection(AnalyticBRDF):
    """A retro-reflective BRDF: an isotropic BRDF, evaluated with wi turned by half a turn about the normal.

    A lobe around the mirror direction becomes a lobe around wi. Anisotropic BRDFs raise an error, because the result
    would not be reciprocal.
    Source: the back vector of Belcour et al. 2014, "Bidirectional reflectance distribution function measurements and
    analysis of retroreflective materials".
    """

    brdf: BRDF

    def __post_init__(self) -> None:
        if not self.brdf.is_isotropic:
            raise UsageError("found an anisotropic BRDF, expected an isotropic one for Retroreflection")
        object.__setattr__(self, "bands", self.brdf.bands)

    def _eval(self, wi: Array, wo: Array) -> Array:
        return self.brdf.eval(_half_turn(wi), wo)

    def _sample(self, wi: Array, u: Array) -> Array:
        return self.brdf.sample(_half_turn(wi), u)[0]

    def _pdf(self, wi: Array, wo: Array) -> Array:
        return self.brdf.pdf(_half_turn(wi), wo)

    def _albedo(self, wi: Array) -> Array:
        return self.brdf.albedo(wi)


def _half_turn(w: Array) -> Array:
    return w * (-1.0, -1.0, 1.0)


class _Compound(AnalyticBRDF):
    """Base class of BRDFs with several parts, of which one is chosen for each sample."""

    @property
    @abstractmethod
    def _parts(self) -> Sequence[BRDF]: ...

    @property
    @abstractmethod
    def _lobes(self) -> Array:
        """Probability with which each part is chosen."""

    @property
    def is_isotropic(self) -> bool:
        """Return whether f is invariant under rotation of both directions about the normal."""
        return all(brdf.is_isotropic for brdf in self._parts)

    def _sample(self, wi: Array, u: Array) -> Array:
        lobe, u = choose_lobe(self._lobes, u)
        wo = np.empty_like(wi)
        for i, brdf in enumerate(self._parts):
            wo[lobe == i] = brdf.sample(wi[lobe == i], u[lobe == i])[0]
        return wo

    def _pdf(self, wi: Array, wo: Array) -> Array:
        densities = [p * brdf.pdf(wi, wo) for p, brdf in zip(self._lobes, self._parts, strict=True)]
        return np.asarray(np.sum(densities, axis=0))


@dataclass(frozen=True, eq=False)
class MixedBRDF(_Compound):
    """A weighted sum of BRDFs with the same bands, such as several kinds of flakes side by side.

    Components are pairs (weight, BRDF); the weights are at least 0, and their sum is above 0 and at most 1.
    """

    components: Sequence[tuple[float, BRDF]]

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
        object.__setattr__(self, "components", parts)
        object.__setattr__(self, "bands", parts[0][1].bands)

    @property
    def _parts(self) -> Sequence[BRDF]:
        return [brdf for _, brdf in self.components]

    @cached_property
    def _lobes(self) -> Array:
        weights = np.array([w for w, _ in self.components])
        return np.asarray(weights / weights.sum())

    def _eval(self, wi: Array, wo: Array) -> Array:
        f = np.zeros((wi.shape[0], self.bands.count))
        for weight, brdf in self.components:
            f += weight * brdf.eval(wi, wo)
        return f

    def _albedo(self, wi: Array) -> Array:
        albedo = np.zeros((wi.shape[0], self.bands.count))
        for weight, brdf in self.components:
            albedo += weight * brdf.albedo(wi)
        return albedo


@dataclass(frozen=True, eq=False)
class Layered(_Compound):
    """One BRDF on top of another with the same bands, such as a coat on paint or sheen on felt.

    f = f_top + (1 - E(wi)) (1 - E(wo)) f_base, where E is the albedo of the top. Light that the top does not
    reflect passes it undeflected, both ways. The result is reciprocal, and conserves energy if both layers do. Light
    that would be reflected back and forth between the layers is lost (`Plastic` loses none).
    Source: the albedo scaling of Kulla & Conty 2017, made symmetric.
    """

    top: BRDF
    base: BRDF

    def __post_init__(self) -> None:
        self.top.bands.require_same(self.base.bands, "base of the layers", "resample one of them")
        object.__setattr__(self, "bands", self.top.bands)

    @property
    def _parts(self) -> Sequence[BRDF]:
        return self.top, self.base

    @cached_property
    def _lobes(self) -> Array:
        nodes, weights = hemisphere_quadrature(6, 8)
        top, base = (
            float((weights * nodes[:, 2]) @ brdf.albedo(nodes).mean(axis=-1)) / np.pi for brdf in self._parts
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
