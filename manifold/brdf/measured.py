"""The protocol that all BRDFs share, and the measured BRDF of an RGL file."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import numba as nb
import numpy as np

from manifold.brdf import warp
from manifold.brdf.cube_root import cube_root
from manifold.brdf.pairs import DirectionPairs, elevation, locate, phi_to_u, signs, theta_to_u
from manifold.brdf.warp import Warp
from manifold.directions import require_directions
from manifold.errors import ShapeError, UsageError
from manifold.parallel import in_turn
from manifold.records import Array, Bands, BsdfFile


@runtime_checkable
class BRDF(Protocol):
    """What a reflectance is asked here: B bands at once, directions (..., 3) that broadcast, z the normal."""

    @property
    def bands(self) -> Bands:
        """The spectral axis."""

    @property
    def is_isotropic(self) -> bool:
        """Whether turning both directions about the normal changes nothing."""

    def eval(self, wi: Array, wo: Array) -> Array:
        """BRDF f in 1/sr, shape (..., B); 0 where a direction is not above the horizon."""

    def eval_cos(self, wi: Array, wo: Array) -> Array:
        """f * cos(theta_o) in 1/sr, shape (..., B): what Mitsuba's `eval` returns."""

    def sample(self, wi: Array, u: Array) -> tuple[Array, Array]:
        """Outgoing directions (..., 3) for uniform variates (..., 2), and their pdf (...) in 1/sr.

        A pdf of 0 marks a sample to throw away.
        """

    def pdf(self, wi: Array, wo: Array) -> Array:
        """Density in 1/sr with which `sample` returns wo, shape (...)."""

    def albedo(self, wi: Array) -> Array:
        """Directional albedo, the integral of f * cos(theta_o) over outgoing directions, shape (..., B)."""


@nb.njit(cache=True, inline="always")
def _half_vector_jacobian(ux, theta_m, cos_im):
    """Solid angle of outgoing directions per area of the half vector's unit square."""
    return max(2.0 * np.pi * np.pi * ux * np.sin(theta_m), 1e-6) * 4.0 * cos_im


_FASTMATH = {"contract", "reassoc", "nsz"}  # no assumption that values are finite: a masked cell may be NaN


@nb.njit(cache=True, fastmath=_FASTMATH)
def _eval_row(
    theta_i,
    phi_i,
    ux,
    uy,
    cos_o,
    jacobian,
    divide,
    ndf,
    sigma,
    data,
    conditional,
    marginal,
    phi_nodes,
    theta_nodes,
    spectra,
    row,
):
    """All bands of one located pair above the horizon, into row (B,)."""
    slices, weights = warp.blend(phi_nodes, theta_nodes, phi_i, theta_i)
    u, v, _pdf = warp.invert(data, conditional, marginal, slices, weights, ux, uy)
    scale = 1.0
    if jacobian:
        scale = warp.bilinear(ndf, ux, uy) / (
            4.0 * warp.bilinear(sigma, theta_to_u(theta_i), phi_to_u(phi_i))
        )
    if divide:
        scale /= cos_o
    j, tx = warp.cell(u, spectra.shape[2])
    i, ty = warp.cell(v, spectra.shape[1])
    # Two slices a pass: the elevations around theta_i, at the one or two azimuths around phi_i.
    for s in range(0, 4, 2):
        if s > 0 and weights[s] == 0.0 and weights[s + 1] == 0.0:
            continue
        a, b = slices[s], slices[s + 1]
        # A slice without weight is not read: it may hold what is not a number.
        if weights[s] == 0.0:
            a = b
        if weights[s + 1] == 0.0:
            b = a
        wa, wb = weights[s] * scale, weights[s + 1] * scale
        w00, w01, w10, w11 = (1 - ty) * (1 - tx), (1 - ty) * tx, ty * (1 - tx), ty * tx
        a00, a01, a10, a11 = wa * w00, wa * w01, wa * w10, wa * w11
        b00, b01, b10, b11 = wb * w00, wb * w01, wb * w10, wb * w11
        # One name per row: the compiler then sees eight streams with stride one.
        p00, p01 = spectra[a, i, j], spectra[a, i, j + 1]
        p10, p11 = spectra[a, i + 1, j], spectra[a, i + 1, j + 1]
        q00, q01 = spectra[b, i, j], spectra[b, i, j + 1]
        q10, q11 = spectra[b, i + 1, j], spectra[b, i + 1, j + 1]
        if s == 0:
            for k in range(row.shape[0]):
                row[k] = (a00 * p00[k] + a01 * p01[k] + a10 * p10[k] + a11 * p11[k]) + (
                    b00 * q00[k] + b01 * q01[k] + b10 * q10[k] + b11 * q11[k]
                )
        else:
            for k in range(row.shape[0]):
                row[k] += (a00 * p00[k] + a01 * p01[k] + a10 * p10[k] + a11 * p11[k]) + (
                    b00 * q00[k] + b01 * q01[k] + b10 * q10[k] + b11 * q11[k]
                )


@in_turn
@nb.njit(cache=True, parallel=True, fastmath=_FASTMATH)
def _eval_loop(
    wi, wo, isotropic, reduction, jacobian, divide, ndf, sigma, data, conditional, marginal, phi_nodes,
    theta_nodes, spectra, out,
):  # fmt: skip
    for k in nb.prange(wi.shape[0]):
        if wi[k, 2] <= 0.0 or wo[k, 2] <= 0.0:
            out[k] = 0.0
            continue
        theta_i, phi_i, ux, uy, _theta_m, _c = locate(wi[k], wo[k], isotropic, reduction)
        _eval_row(
            theta_i, phi_i, ux, uy, wo[k, 2], jacobian, divide, ndf, sigma, data, conditional, marginal,
            phi_nodes, theta_nodes, spectra, out[k],
        )  # fmt: skip


# The next two run on one core and let go of the interpreter: their callers have several blocks to share out.


@nb.njit(cache=True, nogil=True, fastmath=_FASTMATH)
def _eval_located(
    located, jacobian, ndf, sigma, data, conditional, marginal, phi_nodes, theta_nodes, spectra, out
):
    for k in range(located.shape[0]):
        theta_i, phi_i, ux, uy, cos_o = located[k]
        if cos_o <= 0.0:
            out[k] = 0.0
            continue
        _eval_row(
            theta_i, phi_i, ux, uy, cos_o, jacobian, True, ndf, sigma, data, conditional, marginal, phi_nodes,
            theta_nodes, spectra, out[k],
        )  # fmt: skip


@nb.njit(cache=True, nogil=True, fastmath=_FASTMATH)
def _add_located(
    located, jacobian, ndf, sigma, data, conditional, marginal, phi_nodes, theta_nodes, spectra, weight,
    take_root, total,
):  # fmt: skip
    row = np.empty(total.shape[1])  # stays in the first cache
    for k in range(located.shape[0]):
        theta_i, phi_i, ux, uy, cos_o = located[k]
        if cos_o <= 0.0:
            continue
        _eval_row(
            theta_i, phi_i, ux, uy, cos_o, jacobian, True, ndf, sigma, data, conditional, marginal, phi_nodes,
            theta_nodes, spectra, row,
        )  # fmt: skip
        sums = total[k]
        if take_root:
            for b in range(row.shape[0]):
                sums[b] += weight * cube_root(row[b])
        else:
            for b in range(row.shape[0]):
                sums[b] += weight * row[b]


@in_turn
@nb.njit(cache=True, parallel=True)
def _pdf_loop(
    wi, wo, isotropic, reduction, phi_nodes, theta_nodes, data, conditional, marginal, luminance, out
):
    for k in nb.prange(wi.shape[0]):
        out[k] = 0.0
        if wi[k, 2] <= 0.0 or wo[k, 2] <= 0.0:
            continue
        theta_i, phi_i, ux, uy, theta_m, cos_im = locate(wi[k], wo[k], isotropic, reduction)
        slices, weights = warp.blend(phi_nodes, theta_nodes, phi_i, theta_i)
        u, v, vndf_pdf = warp.invert(data, conditional, marginal, slices, weights, ux, uy)
        lum_pdf = warp.density(luminance, slices, weights, u, v)
        out[k] = vndf_pdf * lum_pdf / _half_vector_jacobian(ux, theta_m, cos_im)


@in_turn
@nb.njit(cache=True, parallel=True)
def _sample_loop(
    wi, uniforms, use_luminance, isotropic, reduction, phi_nodes, theta_nodes, data, conditional, marginal,
    lum_data, lum_conditional, lum_marginal, wo, pdf,
):  # fmt: skip
    for k in nb.prange(wi.shape[0]):
        pdf[k] = 0.0
        wo[k, 0], wo[k, 1], wo[k, 2] = 0.0, 0.0, 1.0
        if wi[k, 2] <= 0.0:
            continue
        sx, sy = signs(reduction, wi[k, 0], wi[k, 1])
        ix, iy, iz = wi[k, 0] * sx, wi[k, 1] * sy, wi[k, 2]
        theta_i = elevation(ix, iy, iz)
        phi_i = np.arctan2(iy, ix)
        slices, weights = warp.blend(phi_nodes, theta_nodes, phi_i, theta_i)
        x, y, lum_pdf = uniforms[k, 1], uniforms[k, 0], 1.0
        if use_luminance:
            x, y, lum_pdf = warp.sample(lum_data, lum_conditional, lum_marginal, slices, weights, x, y)
        ux, uy, vndf_pdf = warp.sample(data, conditional, marginal, slices, weights, x, y)
        theta_m = ux * ux * (0.5 * np.pi)
        phi_m = (2.0 * uy - 1.0) * np.pi
        if isotropic:
            phi_m += phi_i
        sin_m = np.sin(theta_m)
        mx, my, mz = np.cos(phi_m) * sin_m, np.sin(phi_m) * sin_m, np.cos(theta_m)
        cos_im = ix * mx + iy * my + iz * mz
        if cos_im <= 0.0:
            continue
        oz = 2.0 * cos_im * mz - iz
        wo[k, 0] = sx * (2.0 * cos_im * mx - ix)
        wo[k, 1] = sy * (2.0 * cos_im * my - iy)
        wo[k, 2] = oz
        if oz > 0.0:
            pdf[k] = vndf_pdf * lum_pdf / _half_vector_jacobian(ux, theta_m, cos_im)


def _samplable(luminance: Array) -> Array:
    """Luminance (P, T, H, W) as a density: RGB files have a few values just below zero, black ones only zeros."""
    density = np.maximum(luminance, 0.0)
    black = density.sum(axis=(2, 3), keepdims=True) <= 0
    return np.where(black, 1.0, density)


class MeasuredBRDF:
    """The BRDF of an RGL file, all bands of a direction pair from one warp inversion.

    Source: Dupuy & Jakob 2018, section 5; f * cos(theta_o) = spectra * ndf / (4 sigma).
    """

    def __init__(self, file: BsdfFile):
        """Normalise the warps of `file` and lay its bands out contiguously (a copy only where needed)."""
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
        """The same material in a few of its bands, warps shared.

        Args:
            bands: indices, increasing. All three of an RGB material, or any of a spectral one.
        Raises:
            UsageError: a spectral axis cannot be made of these.
        """
        if list(bands) == list(range(self._bands.count)):
            return self
        if self._bands.wavelengths_nm is None:
            raise UsageError(f"bands {list(bands)} of an RGB material, expected all three")
        selected = copy.copy(self)
        selected._bands = Bands(tuple(self._bands.wavelengths_nm[b] for b in bands))
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
    def _lookup(self) -> Any:
        """What the compiled loops look a located pair up in."""
        return (
            self._ndf, self._sigma, *self._vndf.tables, self._vndf.phi_nodes, self._vndf.theta_nodes,
            self._spectra,
        )  # fmt: skip

    def _evaluate(self, wi: Array, wo: Array, divide: bool) -> Array:
        pairs = DirectionPairs(wi, wo)
        out = np.empty((len(pairs), self._bands.count))
        _eval_loop(  # type: ignore[call-arg]
            pairs.wi, pairs.wo, self._isotropic, self._reduction, self._jacobian, divide, *self._lookup, out
        )
        return out.reshape(*pairs.shape, out.shape[1])

    def eval_into(self, pairs: DirectionPairs, out: Array) -> None:
        """`eval` of K pairs into a given array, on one core and outside the interpreter's lock.

        For those who share materials or blocks of pairs out among threads.

        Args:
            pairs: K direction pairs.
            out: overwritten, float64, C-contiguous, shape (K, B).
        Raises:
            ShapeError: out is anything else.
        """
        self._require_rows(pairs, out)
        located = pairs.located(self._isotropic, self._reduction)
        _eval_located(located, self._jacobian, *self._lookup, out)  # type: ignore[call-arg]

    def add_weighted(self, pairs: DirectionPairs, weight: float, total: Array, *, cube_root: bool) -> None:
        """Add weight * f, or weight times the signed cube root of f, in one pass; threads as in `eval_into`.

        Args:
            pairs: K direction pairs; those below the horizon add nothing.
            weight: the factor.
            total: added to, float64, C-contiguous, shape (K, B).
            cube_root: add the root instead of f.
        Raises:
            ShapeError: total is anything else.
        """
        self._require_rows(pairs, total)
        located = pairs.located(self._isotropic, self._reduction)
        _add_located(located, self._jacobian, *self._lookup, weight, cube_root, total)  # type: ignore[call-arg]

    def _require_rows(self, pairs: DirectionPairs, rows: Array) -> None:
        expected = (len(pairs), self._bands.count)
        if rows.shape != expected or rows.dtype != np.float64 or not rows.flags.c_contiguous:
            raise ShapeError(
                f"array of values has shape {rows.shape} of {rows.dtype}, expected {expected} of float64, contiguous"
            )

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
        _pdf_loop(
            pairs.wi, pairs.wo, self._isotropic, self._reduction, self._vndf.phi_nodes, self._vndf.theta_nodes,
            *self._vndf.tables, self._luminance.data, out,
        )  # fmt: skip
        return out.reshape(pairs.shape)

    def sample(self, wi: Array, u: Array) -> tuple[Array, Array]:
        """Outgoing directions (..., 3) and their pdf (...) in 1/sr; pdf 0 marks a sample to throw away.

        Args:
            wi: incident unit vectors (..., 3).
            u: uniform variates in [0, 1), shape (..., 2), that broadcast against wi.
        Raises:
            ShapeError: as in `eval`, or u is not (..., 2).
        """
        return self._sample(wi, u, True)

    def _sample(self, wi: Array, u: Array, use_luminance: bool) -> tuple[Array, Array]:
        wi = require_directions(wi, "wi")
        u = np.asarray(u, dtype=np.float64)
        if u.ndim == 0 or u.shape[-1] != 2:
            raise ShapeError(f"u has shape {u.shape}, expected (..., 2)")
        shape = np.broadcast_shapes(wi.shape[:-1], u.shape[:-1])
        flat_wi = np.ascontiguousarray(np.broadcast_to(wi, (*shape, 3)).reshape(-1, 3))
        flat_u = np.ascontiguousarray(np.broadcast_to(u, (*shape, 2)).reshape(-1, 2))
        wo = np.empty_like(flat_wi)
        pdf = np.empty(flat_wi.shape[0])
        _sample_loop(
            flat_wi, flat_u, use_luminance, self._isotropic, self._reduction, self._vndf.phi_nodes,
            self._vndf.theta_nodes, *self._vndf.tables, *self._luminance.tables, wo, pdf,
        )  # fmt: skip
        return wo.reshape(*shape, 3), pdf.reshape(shape)

    def albedo(self, wi: Array, resolution: int = 64) -> Array:
        """Directional albedo, shape (..., B): the midpoint rule on resolution^2 points of the warped square.

        There f * cos(theta_o) / pdf of the visible normals is nearly the smooth stored spectrum.
        """
        wi = require_directions(wi, "wi")
        t = (np.arange(resolution) + 0.5) / resolution
        u = np.stack(np.meshgrid(t, t, indexing="ij"), axis=-1).reshape(-1, 2)
        flat = wi.reshape(-1, 3)
        out = np.empty((flat.shape[0], self._bands.count))
        for k, w in enumerate(flat):
            wo, pdf = self._sample(w, u, False)
            keep = pdf > 0
            weights = 1.0 / pdf[keep] / u.shape[0]
            out[k] = weights @ self._evaluate(w, wo[keep], False)
        return out.reshape(*wi.shape[:-1], out.shape[1])
