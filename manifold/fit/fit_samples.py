"""The data of fits: reflectance samples from arrays, readings or any BRDF, and the pixels of a rendered ball."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from manifold.brdf.interface import EvaluableBRDF
from manifold.colour import panel
from manifold.colour.conversion import to_srgb
from manifold.colour.narrow_bands import with_spectra
from manifold.colour.panel import Panel
from manifold.core.directions import require_directions, require_real, rotate_z
from manifold.core.errors import ShapeError, UsageError
from manifold.core.pairs import RusinkiewiczGrid
from manifold.core.records import Array, Bands, Indices
from manifold.formats.readings import Readings

MIN_PAIRS = 4
MAX_PAIRS = 2048
_GRAZING_COS = 0.05  # 87 degrees: beyond, instruments and files extrapolate
_BALL = (6, 18, 8)  # pixels, rings and spokes: 3,900 direction pairs with those under suns


@dataclass(frozen=True, eq=False)
class Pixels:
    """Small pictures of a ball in the lights used for fitting: linear radiance relative to white, shape (K, B).

    Errors are reported in other lights.
    """

    lights: Panel
    values: Array

    @classmethod
    def of_values(cls, f: Callable[[Array, Array], Array]) -> Pixels:
        """Return the pixels of a ball from a function that evaluates its BRDF; negative values are treated as 0."""
        lights = panel.fitted(*_BALL, sun_pixels=panel.FITTED_SUN_PIXELS)
        empty = cls(lights, np.zeros(0))
        return replace(empty, values=empty.of(np.maximum(f(lights.wi, lights.wo), 0.0) * lights.wo[:, 2:]))

    def every(self, step: int) -> Pixels:
        """Return every `step`-th pixel in each light."""
        lights, rows = self.lights.every(step)
        return Pixels(lights, self.values[rows])

    def of(self, f_cos: Array) -> Array:
        """Return the pixels (..., K, B) from values f cos(theta_o) (..., P, B) at the direction pairs of the ball."""
        f = np.moveaxis(f_cos / self.lights.wo[:, 2:], -2, 0)
        return np.moveaxis(self.lights.of(f), 0, -2)


@dataclass(frozen=True, eq=False)
class FitSamples:
    """M reflectance samples.

    Attributes:
        wi, wo: unit vectors, shape (M, 3), above the horizon.
        f: BRDF in 1/sr, shape (M, B).
        weight: weight of each direction pair, with mean 1, shape (M,).
        is_isotropic: whether the material is isotropic or assumed to be.
        pixels: pixels of the material's ball in the same bands; None if the material is known only at the samples.
    """

    wi: Array
    wo: Array
    f: Array
    weight: Array
    bands: Bands
    is_isotropic: bool = True
    pixels: Pixels | None = None

    @classmethod
    def from_arrays(
        cls, wi: Array, wo: Array, f: Array, *, bands: Bands | None = None, weight: Array | None = None
    ) -> FitSamples:
        """Make samples from a table of f (M, B) in 1/sr, without the cosine, at unit vectors (M, 3) above the horizon.

        Bands are linear sRGB by default.

        Weights (M,) must not be negative; by default they are `cos(theta_i)`. Because residuals compare f times
        `cos(theta_o)`, errors are then weighted by both cosines.
        """
        bands = Bands(None) if bands is None else bands
        wi, wo = require_directions(wi, "wi"), require_directions(wo, "wo")
        f = np.asarray(require_real(f, "values"), float)
        if wi.ndim != 2 or wo.shape != wi.shape:
            raise ShapeError(f"wi has shape {wi.shape} and wo {wo.shape}, expected the same (M, 3)")
        if f.shape != (len(wi), bands.count):
            raise ShapeError(
                f"values have shape {f.shape}, expected {(len(wi), bands.count)}: one row per pair, {bands}"
            )
        for bad, what, error in (
            (~np.isfinite(f), "not finite", ShapeError),
            (f < 0, "negative", UsageError),
        ):
            if np.any(bad):
                first = tuple(np.argwhere(bad)[0].tolist())
                raise error(
                    f"{np.count_nonzero(bad)} of {f.size} values are {what} (first at {first}); drop those"
                )
        if not np.any(f > 0):
            raise UsageError("values are all 0: there is nothing to fit; check the measurement")
        below = int(np.count_nonzero((wi[:, 2] <= 0) | (wo[:, 2] <= 0)))
        if below:
            raise ShapeError(f"{below} of {len(wi)} direction pairs lie below the horizon; drop them")
        if len(np.unique(np.round(np.hstack([wi, wo]), 6), axis=0)) < MIN_PAIRS:
            raise UsageError(f"fewer than {MIN_PAIRS} different direction pairs; measure more directions")
        weight = wi[:, 2] if weight is None else np.asarray(weight, float)
        if weight.shape != (len(wi),) or not np.all(np.isfinite(weight)) or np.any(weight < 0):
            raise ShapeError(
                f"weights have shape {weight.shape}, expected {(len(wi),)} of finite numbers, none negative"
            )
        if not np.any(weight[np.any(f > 0, axis=1)] > 0):
            raise UsageError("every pair with values above 0 has weight 0; raise some weights")
        return cls(wi, wo, f, weight / weight.mean(), bands)

    def __len__(self) -> int:
        return len(self.wi)

    @property
    def f_cos(self) -> Array:
        """Values f * cos(theta_o) in 1/sr, shape (M, B), like those of Mitsuba's `eval`."""
        return self.f * self.wo[:, 2:]

    def subsample(self, n: int) -> FitSamples:
        """Return at most n of the samples, evenly spaced in the order of the table."""
        if len(self) <= n:
            return self
        # Irrational strides visit every part of a gridded table without beating against its rows.
        order = np.argsort(np.modf(np.arange(len(self)) * (0.5 * (np.sqrt(5.0) - 1.0)))[0], kind="stable")
        return self.subset(np.sort(order[:n]))

    def subset(self, rows: Indices) -> FitSamples:
        """Return the samples of the given rows."""
        weight = self.weight[rows]
        wi, wo, f = self.wi[rows], self.wo[rows], self.f[rows]
        return replace(self, wi=wi, wo=wo, f=f, weight=weight / weight.mean())

    def as_rgb(self) -> FitSamples:
        """Return the samples in linear sRGB under D65; colours outside Rec. 709 keep their negative values."""
        if self.bands.is_rgb:
            return self
        pixels = self.pixels
        if pixels is not None:
            pixels = replace(pixels, values=to_srgb(pixels.values, self.bands))
        return replace(self, f=to_srgb(self.f, self.bands), bands=Bands(None), pixels=pixels)


def from_readings(readings: Readings) -> FitSamples:
    """Return samples from an instrument's readings that were measured in all bands, at most 87 degrees from the normal.

    Three narrow bands are converted to spectra, see `colour.narrow_bands`.
    """
    readings = with_spectra(readings)
    far = np.minimum(readings.wi[:, 2], readings.wo[:, 2]) >= _GRAZING_COS
    kept = np.flatnonzero(far & readings.measured.all(axis=1) & (readings.weights > 0.0))
    if len(kept) < MIN_PAIRS:
        raise UsageError(
            f"{readings.name}: {len(kept)} readings in all bands below 87 degrees, expected {MIN_PAIRS} or more"
        )
    read = readings.select_pairs(kept)
    f = np.maximum(read.values, 0.0)
    weight = read.weights * read.wi[:, 2]
    return FitSamples.from_arrays(read.wi, read.wo, f, bands=read.bands, weight=weight).subsample(MAX_PAIRS)


def from_brdf(brdf: EvaluableBRDF, rotation_rad: float = 0.0) -> FitSamples:
    """Return samples of a BRDF, dense around the mirror direction, with its ball; negative values are treated as 0.

    `rotation_rad` is the azimuth by which the specimen was rotated; the samples are rotated back.
    """

    def of(wi: Array, wo: Array) -> Array:
        return brdf.eval(rotate_z(wi, rotation_rad), rotate_z(wo, rotation_rad))

    wi, wo, above = RusinkiewiczGrid().suited_to(brdf.is_isotropic).directions()
    keep = np.flatnonzero(above & (np.minimum(wi[:, 2], wo[:, 2]) >= _GRAZING_COS))
    if len(keep) > MAX_PAIRS:
        keep = np.sort(np.random.default_rng(0).permutation(keep)[:MAX_PAIRS])
    wi, wo = wi[keep], wo[keep]
    samples = FitSamples.from_arrays(wi, wo, np.maximum(of(wi, wo), 0.0), bands=brdf.bands)
    return replace(samples, is_isotropic=brdf.is_isotropic, pixels=Pixels.of_values(of))
