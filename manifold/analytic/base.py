"""Base class of analytic BRDFs, and the two simplest: Lambert and sheen.

Directions point away from the surface, are unit vectors (..., 3) and broadcast against each other.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from manifold.brdf.notebook import NotebookPicture
from manifold.core.directions import from_spherical, hemisphere_quadrature, require_directions
from manifold.core.errors import ShapeError, UsageError
from manifold.core.pairs import Pairs, flat_samples
from manifold.core.records import Array, Bands

_ALBEDO_SAMPLES = 4096


class AnalyticBRDF(NotebookPicture, ABC):
    """Base class that validates and broadcasts directions, and returns 0 below the horizon.

    Subclasses hold `bands` and implement `_eval` for arrays (n, 3) of directions above the horizon. They override
    `_albedo` if it is known in closed form, `_sample` and `_pdf` if the cosine is a bad sampling density, and
    `is_isotropic` if it may be false.
    """

    bands: Bands

    @property
    def is_isotropic(self) -> bool:
        """Return whether f is invariant under rotation of both directions about the normal."""
        return True

    @abstractmethod
    def _eval(self, wi: Array, wo: Array) -> Array:
        """Return f in 1/sr, shape (n, B) or (n, 1) if all bands agree."""

    def _albedo(self, wi: Array) -> Array:
        """Return the directional albedo, shape (n, B) or (n, 1), estimated by the model's own sampling."""
        u = even_points(_ALBEDO_SAMPLES)
        albedo = np.empty((len(wi), self.bands.count))
        for i, w in enumerate(wi):  # one direction at a time to bound memory
            wo, pdf = self.sample(w, u)
            kept = pdf > 0.0
            albedo[i] = (1.0 / pdf[kept]) @ self.eval_cos(w, wo[kept]) / len(u)
        return albedo

    def _sample(self, wi: Array, u: Array) -> Array:
        """Return directions (n, 3), possibly below the horizon."""
        return cosine_hemisphere(u)

    def _pdf(self, wi: Array, wo: Array) -> Array:
        """Return the density of `_sample` in 1/sr, shape (n,)."""
        return wo[:, 2] / np.pi

    def eval(self, wi: Array, wo: Array) -> Array:
        """Return f in 1/sr, shape (..., B); 0 for a direction at or below the horizon."""
        pairs = Pairs(wi, wo)
        return _scatter(self._eval, pairs.shape, self.bands.count, pairs.wi, pairs.wo)

    def eval_cos(self, wi: Array, wo: Array) -> Array:
        """Return f * cos(theta_o) in 1/sr, shape (..., B)."""
        f_cos = self.eval(wi, wo)
        f_cos *= np.maximum(np.asarray(wo, float)[..., 2], 0.0)[..., None]
        return f_cos

    def sample(self, wi: Array, u: Array) -> tuple[Array, Array]:
        """Draw outgoing directions in proportion to the density `pdf`.

        Args:
            wi: directions (..., 3).
            u: uniform numbers in [0, 1), shape (..., 2).

        Returns:
            wo (..., 3) and their density in 1/sr (...). A density of 0 marks an invalid direction: wo or wi is below
            the
                horizon.
        """
        wi, u, shape = flat_samples(wi, u)
        wo = np.zeros_like(wi)
        wo[:, 2] = -1.0
        up = wi[:, 2] > 0.0
        wo[up] = self._sample(wi[up], u[up])
        pdf = _scatter(lambda a, b: self._pdf(a, b)[:, None], shape, 1, wi, wo)
        return wo.reshape(*shape, 3), pdf[..., 0]

    def pdf(self, wi: Array, wo: Array) -> Array:
        """Return the density of `sample` in 1/sr of solid angle, shape (...)."""
        pairs = Pairs(wi, wo)
        pdf = _scatter(lambda a, b: self._pdf(a, b)[:, None], pairs.shape, 1, pairs.wi, pairs.wo)
        return pdf[..., 0]

    def albedo(self, wi: Array) -> Array:
        """Return the directional albedo, the integral of f cos(theta_o) over wo, shape (..., B); 0 below the horizon.

        The numerical result is within 1e-3 of the exact integral for the microfacet models and their mixtures, and
        within 5e-3 for `Sheen` and `Layered`.
        """
        wi = require_directions(wi, "wi")
        flat = wi.reshape(-1, 3)
        return _scatter(lambda a, _: self._albedo(a), wi.shape[:-1], self.bands.count, flat, flat)


@dataclass(frozen=True, eq=False)
class Lambert(AnalyticBRDF):
    """A Lambertian BRDF: f = reflectance / pi at all directions above the horizon.

    Attributes:
        reflectance: reflectance in [0, 1], shape (B,) or a single number.
        bands: the spectral bands.

    >>> white = Lambert(np.array(1.0), Bands((450.0, 550.0)))
    >>> normal = np.array([0.0, 0.0, 1.0])
    >>> white.eval(normal, normal) * np.pi, white.albedo(normal)
    (array([1., 1.]), array([1., 1.]))
    """

    reflectance: Array
    bands: Bands

    def __post_init__(self) -> None:
        set_per_band(self, "reflectance", 0.0, 1.0)

    def _eval(self, wi: Array, wo: Array) -> Array:
        return np.broadcast_to(self.reflectance / np.pi, (wi.shape[0], self.reflectance.size))

    def _albedo(self, wi: Array) -> Array:
        return np.broadcast_to(self.reflectance, (wi.shape[0], self.reflectance.size))


@dataclass(frozen=True, eq=False)
class Sheen(AnalyticBRDF):
    """The sheen of cloth, whose protruding fibres scatter light at grazing angles.

    D(h) = (2 + 1/r) sin(theta_h)^(1/r) / (2 pi), shadowing is 1 / (4 (cos_i + cos_o - cos_i cos_o)). If the albedo
    would exceed 1, the whole lobe is scaled down by one number per roughness, which keeps it reciprocal.

    Attributes:
        roughness: r in [0.05, 1]: a small value gives a narrow rim near grazing, 1 a broad one.
        colour: colour of the sheen in [0, 1], shape (B,) or a single number.

    Sources: Estevez & Kulla 2017, "Production Friendly Microfacet Sheen BRDF" (the distribution); Ashikhmin & Premoze
    2007, "Distribution-based BRDFs" (the shadowing term, symmetric and cheap).
    """

    roughness: float
    colour: Array
    bands: Bands

    def __post_init__(self) -> None:
        if not 0.05 <= self.roughness <= 1.0:
            raise UsageError(f"roughness is {self.roughness}, expected a number from 0.05 to 1")
        set_per_band(self, "colour", 0.0, 1.0)

    def _eval(self, wi: Array, wo: Array) -> Array:
        scale = 1.0 / max(float(_sheen_albedo(self.roughness).max()), 1.0)
        return (scale * _sheen(self.roughness, wi, wo))[:, None] * self.colour

    def _sample(self, wi: Array, u: Array) -> Array:
        return uniform_hemisphere(u)

    def _pdf(self, wi: Array, wo: Array) -> Array:
        return np.full(wi.shape[0], 0.5 / np.pi)

    def _albedo(self, wi: Array) -> Array:
        table = _sheen_albedo(self.roughness)
        value = np.interp(np.sqrt(wi[:, 2]), np.linspace(0.0, 1.0, table.size), table / max(table.max(), 1.0))
        return np.asarray(value[:, None] * self.colour)


def _sheen(roughness: float, wi: Array, wo: Array) -> Array:
    """Return the sheen lobe in 1/sr, before scaling, shape (n,)."""
    h = wi + wo
    # sin^2 = |h_xy|^2 / |h|^2 keeps its digits near the normal, where 1 - cos^2 does not
    sin_squared = (h[:, 0] ** 2 + h[:, 1] ** 2) / np.sum(h * h, axis=-1)
    d = (2.0 + 1.0 / roughness) * sin_squared ** (0.5 / roughness) / (2.0 * np.pi)
    ci, co = wi[:, 2], wo[:, 2]
    return np.asarray(d / (4.0 * (ci + co - ci * co)))


@lru_cache(maxsize=64)
def _sheen_albedo(roughness: float) -> Array:
    """Return the albedo of the unscaled sheen lobe at 65 polar angles evenly spaced in sqrt(cos), grazing first."""
    cosines = np.maximum(np.linspace(0.0, 1.0, 65) ** 2, 1e-6)
    nodes, weights = hemisphere_quadrature(96, 96)
    directions = from_spherical(np.arccos(cosines), 0.0)
    table = [
        float((weights * nodes[:, 2]) @ _sheen(roughness, np.broadcast_to(w, nodes.shape), nodes))
        for w in directions
    ]
    return np.array(table)


def choose_lobe(probabilities: Array, u: Array) -> tuple[Array, Array]:
    """Choose a lobe by u[:, 0]; return its index, and u with this column rescaled to [0, 1) for further use."""
    edges = np.concatenate([[0.0], np.cumsum(probabilities)])
    lobe = np.minimum(np.searchsorted(edges, u[:, 0], side="right") - 1, probabilities.size - 1)
    # u = 1 would fall into a last lobe of probability 0
    lobe = np.minimum(lobe, np.flatnonzero(probabilities)[-1])
    rest = (u[:, 0] - edges[lobe]) / probabilities[lobe]
    return lobe, np.stack([np.clip(rest, 0.0, 1.0), u[:, 1]], axis=-1)


def even_points(n: int) -> Array:
    """Return points (n, 2) that are evenly spread over the unit square and along each axis.

    Source: Roberts 2018, "R2".
    """
    return np.asarray((0.5 + np.arange(n)[:, None] * (0.7548776662466927, 0.5698402909980532)) % 1.0)


def cosine_hemisphere(u: Array) -> Array:
    """Return directions (n, 3) with density cos(theta) / pi, for variates u (n, 2)."""
    r, phi = np.sqrt(u[:, 1]), 2.0 * np.pi * u[:, 0]
    return np.stack([r * np.cos(phi), r * np.sin(phi), np.sqrt(1.0 - u[:, 1])], axis=-1)


def uniform_hemisphere(u: Array) -> Array:
    """Return directions (n, 3) with density 1 / (2 pi), for variates u (n, 2)."""
    z, phi = 1.0 - u[:, 1], 2.0 * np.pi * u[:, 0]
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=-1)


def _scatter(
    function: Callable[[Array, Array], Array], shape: tuple[int, ...], count: int, wi: Array, wo: Array
) -> Array:
    """Return `function` of the pairs above the horizon and zeros for the others, shape (*shape, count)."""
    up = (wi[:, 2] > 0.0) & (wo[:, 2] > 0.0)
    if up.all():
        values = function(wi, wo)
        if values.shape[1] != count or not values.flags.writeable:
            values = np.broadcast_to(values, (wi.shape[0], count)).copy()
        return values.reshape(*shape, count)
    out = np.zeros((wi.shape[0], count))
    out[up] = function(wi[up], wo[up])
    return out.reshape(*shape, count)


def set_per_band(record: Any, name: str, low: float, high: float = np.inf) -> None:
    """Set a field of a frozen record to a read-only array of its values: (B,), or (1,) for a single number."""
    a = np.atleast_1d(np.array(getattr(record, name), dtype=np.float64))
    if a.shape not in ((record.bands.count,), (1,)):
        raise ShapeError(
            f"{name} has shape {a.shape}, expected ({record.bands.count},) for {record.bands}, or one number"
        )
    if not np.all(np.isfinite(a) & (a >= low) & (a <= high)):
        raise UsageError(
            f"{name} spans {a.min():.4g} to {a.max():.4g}, expected values in [{low:g}, {high:g}]"
        )
    a.setflags(write=False)
    object.__setattr__(record, name, a)
