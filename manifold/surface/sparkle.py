"""Sparkle: points that light up under one lamp but not under the next, and flakes that reproduce it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label, maximum_filter, uniform_filter
from scipy.optimize import brentq

from manifold.analytic.base import AnalyticBRDF
from manifold.analytic.ggx import GGX
from manifold.core.records import Array, Bands, Indices, Mask
from manifold.surface.estimate import SPARKLE, Surface

_PER = 1e4  # pixels that densities are counted by
_LARGEST_GLINT_PX = 40.0  # area; what is larger is relief, or dust
_MOST_SPREAD = 0.7  # of slopes: lamps within 50 degrees tell no more
_ALPHAS = (0.03, 0.5)  # range of GGX alpha of a flake
_ROOTS = (0.51, 0.95)  # range of q / (1 + q)
_LEAST_SEEN = 0.02  # of the square of the radius, in alphas, in which flakes glint
_MOST_COVERED = 0.3  # share of the pixels
_DRAWS = 40_000  # flakes, by which shares are computed


@dataclass(frozen=True)
class Flakes:
    """Flakes with normally distributed slopes that reproduce the number of counted glints.

    Attributes:
        density: number of flakes per 10,000 pixels.
        size_px: area of a flake in pixels.
        slope_std: standard deviation of each component of their slopes, at most 0.7.
        roughness: GGX alpha of a flake.
        reflectance: reflectance at normal incidence.
    """

    density: float
    size_px: float
    slope_std: float
    roughness: float
    reflectance: float

    def drawn(self, size: int, rng: np.random.Generator) -> DrawnFlakes:
        """Draw random flakes on a periodic square with a side of `size` pixels."""
        count = rng.poisson(self.density * size**2 / _PER)
        centre = size * rng.random((count, 2))
        slopes = self.slope_std * rng.standard_normal((count, 2))
        radius = np.sqrt(self.size_px / np.pi)
        reach = int(np.ceil(radius))
        normal, mask = np.zeros((size, size, 3)), np.zeros((size, size), dtype=bool)
        normal[..., 2] = 1.0
        first = np.floor(centre).astype(int)
        for step in np.ndindex(2 * reach + 1, 2 * reach + 1):
            at = first + np.array(step) - reach
            covered = np.sum((at + 0.5 - centre) ** 2, axis=-1) <= radius**2
            covered |= np.all(at == first, axis=-1)  # one pixel at least
            rows, columns = (at[covered] % size).T
            normal[rows, columns, :2] = slopes[covered]
            mask[rows, columns] = True
        return DrawnFlakes(self, normal / np.linalg.norm(normal, axis=-1, keepdims=True), mask)


@dataclass(frozen=True, eq=False)
class Facet(AnalyticBRDF):
    """The BRDF of a flake: a rough mirror without colour, in linear sRGB."""

    ggx: GGX
    reflectance: float
    bands: Bands = Bands(None)  # noqa: RUF009

    def _eval(self, wi: Array, wo: Array) -> Array:
        return self.reflectance * self.ggx.reflection_factor(wi, wo)[:, None]


@dataclass(frozen=True, eq=False)
class DrawnFlakes:
    """Flakes drawn into tiling textures.

    Attributes:
        flakes: statistics of the flakes.
        normal: normals of the flakes, upwards between them, shape (S, S, 3).
        mask: mask of the flakes, shape (S, S).
    """

    flakes: Flakes
    normal: Array
    mask: Mask

    @property
    def facet(self) -> Facet:
        """Return the facet that covers this share of a pixel."""
        return Facet(GGX.isotropic(self.flakes.roughness), self.flakes.reflectance / self.share)

    @property
    def share(self) -> float:
        """Share of a flake's pixel that its facet covers.

        The facet reflects a quarter of the light. If the flake is brighter, the facet covers the whole pixel and
        reflects more.
        """
        return min(4.0 * self.flakes.reflectance, 1.0)


@dataclass(frozen=True)
class Sparkle:
    """Statistics of the glints of a surface; densities are per 10,000 pixels and lamp.

    Attributes:
        density: number of glints, mean over lamps within 50 degrees of the normal.
        size_px: median area of a glint in pixels; 0 without glints.
        brightness: median ratio of the brightest pixel of a glint to its surroundings; 1 without glints.
        seen_once: share of glints that only one lamp shows, corrected for chance.
        flakes: flakes that would show these glints; None if fewer than three lamps show any.
    """

    density: float
    size_px: float
    brightness: float
    seen_once: float
    flakes: Flakes | None


def sparkle_of(surface: Surface) -> Sparkle:
    """Count the glints of a surface, lamp by lamp."""
    pictures = surface.pictures
    middle = np.flatnonzero(surface.is_middle)
    sizes, brightness, once, counts = [], [], [], np.zeros(len(middle))
    near = {j: maximum_filter(surface.glints[j], 3) for j in middle}
    for k, j in enumerate(middle):
        labels, count = label(surface.glints[j], structure=np.ones((3, 3)))
        area = np.bincount(labels.ravel(), minlength=count + 1)[1:]
        kept = np.flatnonzero(area <= _LARGEST_GLINT_PX) + 1
        counts[k] = len(kept)
        grey = pictures.values[j].mean(axis=-1)
        relative = grey / uniform_filter(grey, 15, mode="nearest")
        peaks = np.zeros(count + 1)
        np.maximum.at(peaks, labels.ravel(), relative.ravel())
        others = np.any([near[i] for i in middle if i != j] or [np.zeros_like(near[j])], axis=0)
        elsewhere = np.zeros(count + 1)
        np.maximum.at(elsewhere, labels.ravel(), others.ravel())
        sizes += area[kept - 1].tolist()
        brightness += peaks[kept].tolist()
        once += ((elsewhere[kept] == 0.0) / (1.0 - others.mean())).tolist()
    if not sizes:
        return Sparkle(0.0, 0.0, 1.0, 0.0, None)
    size_px, excess = float(np.median(sizes)), float(np.median(brightness)) - 1.0
    seen_once, density = min(float(np.mean(once)), 1.0), _PER * counts / surface.third.size
    flakes = (
        _flakes(surface, middle, density, size_px, excess, seen_once) if np.sum(counts > 0) >= 3 else None
    )
    return Sparkle(float(density.mean()), size_px, 1.0 + excess, seen_once, flakes)


def _flakes(
    surface: Surface, middle: Indices, density: Array, size_px: float, excess: float, seen_once: float
) -> Flakes:
    """Return flakes whose glints have the counted densities, brightness, and share that only one lamp shows.

    A flake of slope m adds P (1 + |m - h|^2 / alpha^2)^-2 to the brightness of its surroundings, h being the slope of
    the half vector: GGX. It is counted where that is above the threshold t of glints: within `alpha sqrt(q - 1)` of h,
    with q^2 = P / t; the median of those that are has the excess 4 t q^2 / (1 + q)^2.
    """
    pictures, threshold = surface.pictures, SPARKLE - 1.0
    halves = pictures.lamps[middle] + pictures.camera
    halves = halves[:, :2] / halves[:, 2:]
    root = np.sqrt(np.clip(excess / (4.0 * threshold), *_ROOTS))
    q = root / (1.0 - root)
    # A facet that faces the half vector is F / (4 alpha^2 cos cos) bright, a white diffuser 1, its surroundings N.
    cosines = pictures.lamps[middle, 2] * pictures.camera[2]
    bright = cosines * pictures.values[middle].mean(axis=(1, 2, 3))
    typical = float(np.average(bright, weights=density))
    # Radius of what each lamp shows, over alpha.
    seen_at = np.sqrt(np.maximum(q * np.sqrt(typical / bright) - 1.0, _LEAST_SEEN))
    spread = _spread(halves, density / seen_at**2)
    slopes = spread * np.random.default_rng(0).standard_normal((_DRAWS, 1, 2))
    apart = np.linalg.norm(slopes - halves, axis=-1)

    def too_many_seen_once(alpha: float) -> float:
        seen = apart < alpha * seen_at
        return float(np.sum(np.sum(seen, axis=-1) == 1) / max(np.sum(seen), 1) - seen_once)

    alpha, high = _ALPHAS
    if too_many_seen_once(alpha) > 0.0:
        alpha = (
            high
            if too_many_seen_once(high) > 0.0
            else float(brentq(too_many_seen_once, alpha, high, xtol=1e-3))
        )
    expected = np.exp(-0.5 * np.sum(halves**2, axis=-1) / spread**2) * seen_at**2 / (2.0 * spread**2)
    shown = float(np.sum(density) / np.sum(expected))  # density of flakes times alpha squared
    alpha = max(alpha, np.sqrt(shown * size_px / (_PER * _MOST_COVERED)))
    white = float(np.nanmedian(pictures.factors)) if np.isfinite(pictures.means).any() else 1.0
    reflectance = 4.0 * alpha**2 * threshold * q**2 * typical / white
    return Flakes(shown / alpha**2, size_px, spread, alpha, min(float(reflectance), 1.0))


def _spread(halves: Array, density: Array) -> float:
    """Return the standard deviation of normally distributed slopes, from the fall of densities with slope."""
    seen = density > 0.0
    steepness = np.sum(halves[seen] ** 2, axis=-1)
    fall = np.polyfit(steepness, np.log(density[seen]), 1, w=np.sqrt(density[seen]))[0]
    return float(min(np.sqrt(-0.5 / fall), _MOST_SPREAD)) if fall < 0.0 else _MOST_SPREAD
