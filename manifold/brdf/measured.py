"""The protocol that all BRDFs share, and the measured BRDF of an RGL file."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np

from manifold.brdf import lookup
from manifold.brdf.pairs import DirectionPairs, flat_samples
from manifold.brdf.warp import Warp
from manifold.directions import require_directions
from manifold.errors import ShapeError, UsageError
from manifold.records import Array, Bands, BsdfFile


@runtime_checkable
class BRDF(Protocol):
    """The interface of a BRDF: B bands at once, directions (..., 3) that broadcast, z the normal."""

    @property
    def bands(self) -> Bands:
        """The spectral axis."""

    @property
    def is_isotropic(self) -> bool:
        """Whether f is invariant under rotation of both directions about the normal."""

    def eval(self, wi: Array, wo: Array) -> Array:
        """BRDF f in 1/sr, shape (..., B); 0 where a direction is not above the horizon."""

    def eval_cos(self, wi: Array, wo: Array) -> Array:
        """f * cos(theta_o) in 1/sr, shape (..., B): what Mitsuba's `eval` returns."""

    def sample(self, wi: Array, u: Array) -> tuple[Array, Array]:
        """Outgoing directions (..., 3) for uniform variates (..., 2), and their pdf (...) in 1/sr.

        A pdf of 0 marks an invalid sample.
        """

    def pdf(self, wi: Array, wo: Array) -> Array:
        """Density in 1/sr with which `sample` returns wo, shape (...)."""

    def albedo(self, wi: Array) -> Array:
        """Directional albedo, the integral of f * cos(theta_o) over outgoing directions, shape (..., B)."""


def all_isotropic(brdfs: Iterable[BRDF]) -> bool:
    """Whether every one is isotropic, so that direction pairs of one azimuth tell all of them."""
    return all(brdf.is_isotropic for brdf in brdfs)


def require_brdf(brdf: object, where: str) -> None:
    """Raise UsageError unless something has what evaluating a `BRDF` takes: a file or a path has not.

    Args:
        brdf: given by a user.
        where: what it was given to.
    """
    missing = [name for name in ("bands", "is_isotropic", "eval", "eval_cos") if not hasattr(brdf, name)]
    if missing:
        raise UsageError(
            f"{where}: found {type(brdf).__name__}, without {', '.join(missing)}, expected a BRDF; a file becomes one "
            "by MeasuredBRDF(read_bsdf(path))"
        )


def require_resolution(resolution: int) -> None:
    """Raise UsageError unless a quadrature has a node."""
    if resolution < 1:
        raise UsageError(f"resolution is {resolution}, expected 1 or more nodes")


def _samplable(luminance: Array) -> Array:
    """Luminance (P, T, H, W) as a density: RGB files have a few values just below zero, black ones only zeros."""
    density = np.maximum(luminance, 0.0)
    black = density.sum(axis=(2, 3), keepdims=True) <= 0
    return np.where(black, 1.0, density)


def require_rows(rows: Array, n_pairs: int, n_bands: int) -> None:
    """Validate an output array of the compiled loops.

    Raises:
        ShapeError: rows is not (K, B), float64 and C-contiguous.
    """
    expected = (n_pairs, n_bands)
    if rows.shape != expected or rows.dtype != np.float64 or not rows.flags.c_contiguous:
        raise ShapeError(
            f"array of values has shape {rows.shape} of {rows.dtype}, expected {expected} of float64, contiguous"
        )


class MeasuredBRDF:
    """The BRDF of an RGL file, all bands of a direction pair from one warp inversion.

    Source: Dupuy & Jakob 2018, section 5; f * cos(theta_o) = spectra * ndf / (4 sigma).
    """

    def __init__(self, file: BsdfFile):
        """Normalise the warps of `file` and lay its bands out contiguously (a copy only where needed).

        Raises:
            UsageError: `file` is something else, such as a path, which `read_bsdf` reads.
        """
        if not isinstance(file, BsdfFile):
            raise UsageError(f"found {type(file).__name__}, expected a file that was read: read_bsdf(path)")
        self.name = file.name
        self._bands = file.bands
        self._isotropic = file.is_isotropic
        self._jacobian = file.jacobian
        # Files that exploit a symmetry of the sample hold half or a quarter of the azimuths.
        span = float(file.phi_i_rad[-1] - file.phi_i_rad[0])
        self._reduction = 1 if self._isotropic else round(2.0 * np.pi / span)
        phi, theta = file.phi_i_rad, file.theta_i_rad
        self._ndf = np.ascontiguousarray(file.ndf, dtype=np.float64)
        self._sigma = np.ascontiguousarray(file.sigma, dtype=np.float64)
        self._vndf = Warp.from_values(file.vndf, phi, theta)
        self._luminance = Warp.from_values(_samplable(file.luminance), phi, theta)
        band_last = np.moveaxis(file.spectra, 2, -1)  # (P, T, H, W, B)
        self._spectra = np.ascontiguousarray(band_last).reshape(-1, *band_last.shape[2:])

    def __repr__(self) -> str:
        return f"MeasuredBRDF({self.name!r}, {self._bands})"

    def select_bands(self, bands: Sequence[int]) -> MeasuredBRDF:
        """The same material in some of its bands; warps are shared.

        Args:
            bands: indices, increasing. All three of an RGB material, or any of a spectral one.
        Raises:
            UsageError: a spectral axis cannot be made of these.
        """
        if list(bands) == list(range(self._bands.count)):
            return self
        if self._bands.is_rgb:
            raise UsageError(f"bands {list(bands)} of an RGB material, expected all three")
        selected = copy.copy(self)
        selected._bands = self._bands.select(bands)
        selected._spectra = np.ascontiguousarray(self._spectra[..., list(bands)])
        return selected

    @property
    def bands(self) -> Bands:
        """The spectral axis."""
        return self._bands

    @property
    def is_isotropic(self) -> bool:
        """Whether the file depends on the difference of the azimuths only."""
        return self._isotropic

    @property
    def symmetry(self) -> tuple[bool, int]:
        """The arguments of `DirectionPairs.located`: whether it is isotropic, and how often the azimuths repeat."""
        return self._isotropic, self._reduction

    @property
    def tables(self) -> tuple[Any, ...]:
        """The tables that `manifold.brdf.lookup` reads."""
        return (
            self._jacobian, self._ndf, self._sigma, *self._vndf.tables, self._vndf.phi_nodes, self._vndf.theta_nodes,
            self._spectra,
        )  # fmt: skip

    def _evaluate(self, wi: Array, wo: Array, divide: bool) -> Array:
        pairs = DirectionPairs(wi, wo)
        out = np.empty((len(pairs), self._bands.count))
        lookup.eval_pairs(pairs.wi, pairs.wo, self._isotropic, self._reduction, divide, self.tables, out)
        return out.reshape(*pairs.shape, out.shape[1])

    def eval_into(self, pairs: DirectionPairs, out: Array) -> None:
        """`eval` of K pairs into a given array, on one core and outside the interpreter's lock.

        For callers that distribute materials or blocks of pairs over threads.

        Args:
            pairs: K direction pairs.
            out: overwritten, float64, C-contiguous, shape (K, B).
        Raises:
            ShapeError: out is anything else.
        """
        require_rows(out, len(pairs), self._bands.count)
        located = pairs.located(*self.symmetry)
        lookup.eval_located(located, self.tables, out)

    def eval_at(self, pairs: DirectionPairs) -> Array:
        """`eval_into` of K pairs into a new array (K, B)."""
        out = np.empty((len(pairs), self._bands.count))
        self.eval_into(pairs, out)
        return out

    def eval(self, wi: Array, wo: Array) -> Array:
        """BRDF f in 1/sr, shape (..., B).

        Args:
            wi, wo: unit vectors (..., 3) that broadcast against each other.
        Raises:
            ShapeError: a direction array is not (..., 3), not finite, or not of unit length.
        """
        return self._evaluate(wi, wo, True)

    def eval_cos(self, wi: Array, wo: Array) -> Array:
        """f * cos(theta_o) in 1/sr, shape (..., B); arguments and errors as in `eval`."""
        return self._evaluate(wi, wo, False)

    def pdf(self, wi: Array, wo: Array) -> Array:
        """Density of `sample` in 1/sr, shape (...); arguments and errors as in `eval`."""
        pairs = DirectionPairs(wi, wo)
        out = np.empty(len(pairs))
        lookup.pdf_of_pairs(
            pairs.wi, pairs.wo, self._isotropic, self._reduction, self.tables, self._luminance.data, out
        )
        return out.reshape(pairs.shape)

    def sample(self, wi: Array, u: Array) -> tuple[Array, Array]:
        """Outgoing directions (..., 3) and their pdf (...) in 1/sr; pdf 0 marks an invalid sample.

        Args:
            wi: incident unit vectors (..., 3).
            u: uniform variates in [0, 1), shape (..., 2), that broadcast against wi.
        Raises:
            ShapeError: as in `eval`, or u is not (..., 2) in [0, 1].
        """
        flat_wi, flat_u, shape = flat_samples(wi, u)
        wo = np.empty_like(flat_wi)
        pdf = np.empty(flat_wi.shape[0])
        lookup.sample_directions(
            flat_wi, flat_u, self._isotropic, self._reduction, self.tables, self._luminance.tables, wo, pdf,
        )  # fmt: skip
        return wo.reshape(*shape, 3), pdf.reshape(shape)

    def albedo(self, wi: Array, resolution: int = 64) -> Array:
        """Directional albedo, shape (..., B): the midpoint rule on resolution^2 points of the warped square.

        There f * cos(theta_o) / pdf of the visible normals is nearly the smooth stored spectrum.

        Raises:
            ShapeError: as in `eval`.
            UsageError: the resolution is below 1.
        """
        wi = require_directions(wi, "wi")
        require_resolution(resolution)
        flat = np.ascontiguousarray(wi.reshape(-1, 3))
        sums = np.empty((flat.shape[0], resolution, self._bands.count))
        lookup.integrate(flat, self._isotropic, self._reduction, self.tables, sums)
        return (sums.sum(axis=1) / resolution**2).reshape(*wi.shape[:-1], sums.shape[2])
