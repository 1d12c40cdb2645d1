"""Tables of reflectance samples that BSDFs are fitted to: from arrays, files, or any BRDF."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from manifold.brdf.cells import cells_of
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured import unmeasured_cells
from manifold.colour.conversion import to_srgb
from manifold.directions import normalize, require_directions
from manifold.errors import ShapeError, UsageError
from manifold.formats.readings import Readings
from manifold.metrics import RusinkiewiczGrid
from manifold.records import Array, Bands, BsdfFile

MIN_PAIRS = 4
MAX_PAIRS = 2048
_GRAZING_COS = 0.05  # 87 degrees: beyond, instruments and files extrapolate


class EvaluableBRDF(Protocol):
    """The interface of a BRDF that fits and balls need."""

    @property
    def bands(self) -> Bands:
        """The spectral axis."""

    @property
    def is_isotropic(self) -> bool:
        """Whether f is invariant under rotation of both directions about the normal."""

    def eval(self, wi: Array, wo: Array) -> Array:
        """BRDF f in 1/sr, shape (..., B)."""


@dataclass(frozen=True, eq=False)
class FitSamples:
    """M reflectance samples.

    Attributes:
        wi, wo: unit vectors, shape (M, 3), above the horizon.
        f: BRDF in 1/sr, shape (M, B).
        weight: importance of each direction pair, mean 1, shape (M,).
        bands: the B bands.
        is_isotropic: whether the material is; also where nobody knows.
    """

    wi: Array
    wo: Array
    f: Array
    weight: Array
    bands: Bands
    is_isotropic: bool = True

    @classmethod
    def from_arrays(
        cls, wi: Array, wo: Array, f: Array, *, bands: Bands | None = None, weight: Array | None = None
    ) -> FitSamples:
        """Samples of a table.

        Args:
            wi, wo: unit vectors, shape (M, 3).
            f: BRDF (not times the cosine) in 1/sr, shape (M, B).
            bands: their wavelengths; linear sRGB if None.
            weight: importance per pair, shape (M,), not negative; `cos(theta_i)` if None, which with values
                times `cos(theta_o)` weighs errors by both cosines.
        Raises:
            ShapeError: a shape is wrong, a value is not finite, or a direction is not above the horizon.
            UsageError: values are negative or all zero, or there are too few different pairs.
        """
        bands = Bands(None) if bands is None else bands
        wi, wo, f = require_directions(wi, "wi"), require_directions(wo, "wo"), np.asarray(f, float)
        if wi.ndim != 2 or wo.shape != wi.shape:
            raise ShapeError(f"wi has shape {wi.shape} and wo {wo.shape}, expected the same (M, 3)")
        if f.shape != (len(wi), bands.count):
            raise ShapeError(
                f"values have shape {f.shape}, expected {(len(wi), bands.count)}: one row per pair, {bands}"
            )
        _require_values(f)
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
            raise UsageError("every pair that reflects anything has weight 0; raise some weights")
        return cls(wi, wo, f, weight / weight.mean(), bands)

    def __len__(self) -> int:
        return len(self.wi)

    @property
    def f_cos(self) -> Array:
        """f * cos(theta_o) in 1/sr, shape (M, B): what Mitsuba's `eval` returns."""
        return self.f * self.wo[:, 2:]

    def subsample(self, n: int) -> FitSamples:
        """At most n of the samples, the same ones each time, spread over the table's order."""
        if len(self) <= n:
            return self
        # Irrational strides visit every part of a gridded table without beating against its rows.
        order = np.argsort(np.modf(np.arange(len(self)) * (0.5 * (np.sqrt(5.0) - 1.0)))[0], kind="stable")
        return self.subset(np.sort(order[:n]))

    def subset(self, rows: Array) -> FitSamples:
        """The samples of the given rows."""
        weight = self.weight[rows]
        wi, wo, f = self.wi[rows], self.wo[rows], self.f[rows]
        return replace(self, wi=wi, wo=wo, f=f, weight=weight / weight.mean())

    def as_rgb(self) -> FitSamples:
        """The same samples in linear sRGB under D65; colours outside Rec. 709 keep their negative values."""
        if self.bands.is_rgb:
            return self
        return replace(self, f=to_srgb(self.f, self.bands), bands=Bands(None))


def _require_values(f: Array) -> None:
    bad = ~np.isfinite(f)
    if np.any(bad):
        at = tuple(int(i) for i in np.argwhere(bad)[0])
        raise ShapeError(f"values: {int(bad.sum())} of {f.size} are not finite (first at {at}); drop those")
    if np.any(f < 0):
        at = tuple(int(i) for i in np.argwhere(f < 0)[0])
        raise UsageError(
            f"values: {int((f < 0).sum())} of {f.size} are negative (first at {at}), expected 1/sr; "
            "clip noise to 0 or drop those pairs"
        )
    if f.size and not np.any(f > 0):
        raise UsageError("values are all 0: there is nothing to fit; check the measurement")


def file_pairs(file: BsdfFile) -> tuple[Array, Array]:
    """The direction pairs at which a file was measured: wi and wo, each (M, 3).

    Left out are cells that the file marks as unmeasured or that hold nothing, and elevations above 87 degrees.

    Raises:
        UsageError: nothing is left.
    """
    mask = file.measured_mask & ~unmeasured_cells(file)
    all_wi, all_wo = [], []
    for p, t, cells in cells_of(file):
        far = (cells.wo[..., 2] >= _GRAZING_COS) & (cells.wi[2] >= _GRAZING_COS)
        wo = cells.wo[mask[p, t] & cells.is_above & far]
        all_wo.append(normalize(wo))
        all_wi.append(np.broadcast_to(cells.wi, wo.shape))
    if not any(map(len, all_wo)):
        raise UsageError(
            "no measured cell below 87 degrees is above 0: there is nothing to fit; check the file"
        )
    return np.concatenate(all_wi), np.concatenate(all_wo)


def from_file(file: BsdfFile, *, max_pairs: int = MAX_PAIRS) -> FitSamples:
    """Samples of a file at the direction pairs at which it was measured, at most `max_pairs` of them."""
    wi, wo = file_pairs(file)
    brdf = MeasuredBRDF(file)
    f = np.maximum(brdf.eval(wi, wo), 0.0)
    samples = FitSamples.from_arrays(wi, wo, f, bands=brdf.bands).subsample(max_pairs)
    return replace(samples, is_isotropic=file.is_isotropic)


def from_readings(readings: Readings) -> FitSamples:
    """Samples of an instrument's readings: those measured in all bands, 87 degrees from the normal at most.

    Raises:
        UsageError: fewer than four different pairs are left, or all values are 0.
    """
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


def from_brdf(brdf: EvaluableBRDF) -> FitSamples:
    """Samples of a BRDF, dense around the mirror direction; negative values of a prediction count as 0."""
    wi, wo, above = RusinkiewiczGrid().suited_to(brdf.is_isotropic).directions()
    keep = np.flatnonzero(above & (np.minimum(wi[:, 2], wo[:, 2]) >= _GRAZING_COS))
    if len(keep) > MAX_PAIRS:
        keep = np.sort(np.random.default_rng(0).permutation(keep)[:MAX_PAIRS])
    wi, wo = wi[keep], wo[keep]
    samples = FitSamples.from_arrays(wi, wo, np.maximum(brdf.eval(wi, wo), 0.0), bands=brdf.bands)
    return replace(samples, is_isotropic=brdf.is_isotropic)
