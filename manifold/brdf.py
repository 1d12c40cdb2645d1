"""The protocol that all BRDFs share, and the measured BRDF of an RGL file."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numba as nb
import numpy as np

from manifold import warp
from manifold.directions import require_directions
from manifold.errors import ShapeError
from manifold.records import Array, Bands, BsdfFile
from manifold.warp import Warp


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
def _elevation(x, y, z):
    """Angle from the normal, stable near it."""
    d = np.sqrt(x * x + y * y + (z - 1.0) * (z - 1.0))
    return 2.0 * np.arcsin(min(0.5 * d, 1.0))


@nb.njit(cache=True, inline="always")
def _theta_to_u(theta):
    return np.sqrt(theta * (2.0 / np.pi))


@nb.njit(cache=True, inline="always")
def _phi_to_u(phi):
    return (phi + np.pi) / (2.0 * np.pi)


@nb.njit(cache=True, inline="always")
def _signs(reduction, wx, wy):
    """Signs that move an incident direction into the measured range of azimuths of a symmetric file."""
    if reduction < 2:
        return 1.0, 1.0
    sy = -1.0 if wy >= 0.0 else 1.0
    if reduction == 4:
        return (-1.0 if wx >= 0.0 else 1.0), sy
    return sy, sy


@nb.njit(cache=True)
def _locate(wi, wo, isotropic, reduction):
    """Angles of the incident direction and unit-square coordinates of the half vector."""
    sx, sy = _signs(reduction, wi[0], wi[1])
    ix, iy, iz = wi[0] * sx, wi[1] * sy, wi[2]
    mx, my, mz = ix + wo[0] * sx, iy + wo[1] * sy, iz + wo[2]
    norm = np.sqrt(mx * mx + my * my + mz * mz)
    mx, my, mz = mx / norm, my / norm, mz / norm
    theta_i = _elevation(ix, iy, iz)
    phi_i = np.arctan2(iy, ix)
    theta_m = _elevation(mx, my, mz)
    phi_m = np.arctan2(my, mx)
    ux = _theta_to_u(theta_m)
    uy = _phi_to_u(phi_m - phi_i if isotropic else phi_m)
    uy -= np.floor(uy)
    cos_im = ix * mx + iy * my + iz * mz
    return theta_i, phi_i, ux, uy, theta_m, cos_im


@nb.njit(cache=True, inline="always")
def _half_vector_jacobian(ux, theta_m, cos_im):
    """Solid angle of outgoing directions per area of the half vector's unit square."""
    return max(2.0 * np.pi * np.pi * ux * np.sin(theta_m), 1e-6) * 4.0 * cos_im


@nb.njit(cache=True, parallel=True, fastmath={"contract", "reassoc", "nsz"})
def _eval_loop(
    wi, wo, isotropic, reduction, jacobian, divide, ndf, sigma, data, conditional, marginal, phi_nodes,
    theta_nodes, spectra, out,
):  # fmt: skip
    n_rows, n_cols = spectra.shape[1], spectra.shape[2]
    n_bands = out.shape[1]
    for k in nb.prange(wi.shape[0]):
        if wi[k, 2] <= 0.0 or wo[k, 2] <= 0.0:
            for b in range(n_bands):
                out[k, b] = 0.0
            continue
        theta_i, phi_i, ux, uy, _theta_m, _c = _locate(wi[k], wo[k], isotropic, reduction)
        slices, weights = warp.blend(phi_nodes, theta_nodes, phi_i, theta_i)
        u, v, _pdf = warp.invert(data, conditional, marginal, slices, weights, ux, uy)
        scale = 1.0
        if jacobian:
            scale = warp.bilinear(ndf, ux, uy) / (
                4.0 * warp.bilinear(sigma, _theta_to_u(theta_i), _phi_to_u(phi_i))
            )
        if divide:
            scale /= wo[k, 2]
        j, tx = warp.cell(u, n_cols)
        i, ty = warp.cell(v, n_rows)
        first = True
        for s in range(4):
            w = weights[s] * scale
            if weights[s] == 0.0:
                continue
            grid = spectra[slices[s]]
            w00, w01 = w * (1 - ty) * (1 - tx), w * (1 - ty) * tx
            w10, w11 = w * ty * (1 - tx), w * ty * tx
            r00 = grid[i, j]
            r01 = grid[i, j + 1]
            r10 = grid[i + 1, j]
            r11 = grid[i + 1, j + 1]
            row = out[k]
            if first:
                for b in range(n_bands):
                    row[b] = w00 * r00[b] + w01 * r01[b] + w10 * r10[b] + w11 * r11[b]
                first = False
            else:
                for b in range(n_bands):
                    row[b] += w00 * r00[b] + w01 * r01[b] + w10 * r10[b] + w11 * r11[b]


@nb.njit(cache=True, parallel=True)
def _pdf_loop(
    wi, wo, isotropic, reduction, phi_nodes, theta_nodes, data, conditional, marginal, luminance, out
):
    for k in nb.prange(wi.shape[0]):
        out[k] = 0.0
        if wi[k, 2] <= 0.0 or wo[k, 2] <= 0.0:
            continue
        theta_i, phi_i, ux, uy, theta_m, cos_im = _locate(wi[k], wo[k], isotropic, reduction)
        slices, weights = warp.blend(phi_nodes, theta_nodes, phi_i, theta_i)
        u, v, vndf_pdf = warp.invert(data, conditional, marginal, slices, weights, ux, uy)
        lum_pdf = warp.density(luminance, slices, weights, u, v)
        out[k] = vndf_pdf * lum_pdf / _half_vector_jacobian(ux, theta_m, cos_im)


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
        sx, sy = _signs(reduction, wi[k, 0], wi[k, 1])
        ix, iy, iz = wi[k, 0] * sx, wi[k, 1] * sy, wi[k, 2]
        theta_i = _elevation(ix, iy, iz)
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


def _flat_pairs(wi: Array, wo: Array) -> tuple[Array, Array, tuple[int, ...]]:
    """Two direction arrays broadcast against each other, as contiguous (K, 3), and their common shape."""
    wi, wo = require_directions(wi, "wi"), require_directions(wo, "wo")
    try:
        wi, wo = np.broadcast_arrays(wi, wo)
    except ValueError as error:
        raise ShapeError(f"wi has shape {wi.shape} and wo {wo.shape}; they do not broadcast") from error
    shape = wi.shape[:-1]
    return np.ascontiguousarray(wi.reshape(-1, 3)), np.ascontiguousarray(wo.reshape(-1, 3)), shape


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

    @property
    def bands(self) -> Bands:
        """The spectral axis."""
        return self._bands

    @property
    def is_isotropic(self) -> bool:
        """Whether the file depends on the difference of the azimuths only."""
        return self._isotropic

    def _evaluate(self, wi: Array, wo: Array, divide: bool) -> Array:
        wi, wo, shape = _flat_pairs(wi, wo)
        out = np.empty((wi.shape[0], self._bands.count))
        _eval_loop(
            wi, wo, self._isotropic, self._reduction, self._jacobian, divide, self._ndf, self._sigma,
            *self._vndf.tables, self._vndf.phi_nodes, self._vndf.theta_nodes, self._spectra, out,
        )  # fmt: skip
        return out.reshape(*shape, -1)

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
        wi, wo, shape = _flat_pairs(wi, wo)
        out = np.empty(wi.shape[0])
        _pdf_loop(
            wi, wo, self._isotropic, self._reduction, self._vndf.phi_nodes, self._vndf.theta_nodes,
            *self._vndf.tables, self._luminance.data, out,
        )  # fmt: skip
        return out.reshape(shape)

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
        return out.reshape(*wi.shape[:-1], -1)
