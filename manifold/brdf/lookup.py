"""Compiled loops over direction pairs that read an RGL file's tables: all bands of a pair from one warp inversion.

`tables` is (jacobian, ndf, sigma, data, conditional and marginal of the visible normals' warp, its azimuths, its
elevations, spectra (slice, row, column, band)).
"""

from __future__ import annotations

import numba as nb
import numpy as np

from manifold.brdf import warp
from manifold.pairs import LEVEL, elevation, locate, phi_to_u, signs, theta_to_u
from manifold.threads import serialised


@nb.njit(cache=True, inline="always")
def _half_vector_jacobian(ux, theta_m, cos_im):
    """Solid angle of outgoing directions per area of the half vector's unit square."""
    return max(2.0 * np.pi * np.pi * ux * np.sin(theta_m), 1e-6) * 4.0 * cos_im


FASTMATH = {"contract", "reassoc", "nsz"}
"""No assumption that values are finite: a masked cell may be NaN."""


@nb.njit(**warp.WITHOUT_REFERENCE_COUNTS, fastmath=FASTMATH)
def _eval_row(theta_i, phi_i, ux, uy, cos_o, divide, tables, row):
    """All bands of one located pair above the horizon, into row (B,)."""
    _, _, _, data, conditional, marginal, phi_nodes, theta_nodes, _ = tables
    slices, weights = warp.blend(phi_nodes, theta_nodes, phi_i, theta_i)
    u, v, _pdf = warp.invert(data, conditional, marginal, slices, weights, ux, uy)
    _interpolate_row(theta_i, phi_i, ux, uy, u, v, slices, weights, cos_o, divide, tables, row)


@nb.njit(**warp.WITHOUT_REFERENCE_COUNTS, fastmath=FASTMATH)
def _interpolate_row(theta_i, phi_i, ux, uy, u, v, slices, weights, cos_o, divide, tables, row):
    """All bands of one half vector at (ux, uy), which the warp brings to (u, v), into row (B,)."""
    jacobian, ndf, sigma, _, _, _, _, _, spectra = tables
    real = row.dtype.type  # single precision where the row is: twice as many bands at once
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
        # A slice without weight is not read: it may hold NaN.
        if weights[s] == 0.0:
            a = b
        if weights[s + 1] == 0.0:
            b = a
        wa, wb = weights[s] * scale, weights[s + 1] * scale
        w00, w01, w10, w11 = (1 - ty) * (1 - tx), (1 - ty) * tx, ty * (1 - tx), ty * tx
        a00, a01, a10, a11 = real(wa * w00), real(wa * w01), real(wa * w10), real(wa * w11)
        b00, b01, b10, b11 = real(wb * w00), real(wb * w01), real(wb * w10), real(wb * w11)
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


@serialised
@nb.njit(cache=True, parallel=True, fastmath=FASTMATH)
def eval_pairs(wi, wo, isotropic, reduction, divide, tables, out):
    """All bands of K pairs (K, 3), of f or, without `divide`, of f cos(theta_o), into out (K, B)."""
    for k in nb.prange(wi.shape[0]):
        if wi[k, 2] <= LEVEL or wo[k, 2] <= LEVEL:
            out[k] = 0.0
            continue
        theta_i, phi_i, ux, uy, _theta_m, _c = locate(wi[k], wo[k], isotropic, reduction)
        _eval_row(theta_i, phi_i, ux, uy, wo[k, 2], divide, tables, out[k])


@nb.njit(cache=True, nogil=True, fastmath=FASTMATH)
def eval_located(located, divide, tables, out):
    """`eval_pairs` of K located pairs, on one core: they are few, or callers have several blocks to share out."""
    for k in range(located.shape[0]):
        theta_i, phi_i, ux, uy, cos_o = located[k]
        if cos_o <= 0.0:
            out[k] = 0.0
            continue
        _eval_row(theta_i, phi_i, ux, uy, cos_o, divide, tables, out[k])


@serialised
@nb.njit(cache=True, parallel=True)
def pdf_of_pairs(wi, wo, isotropic, reduction, tables, luminance, out):
    """Density of sampling wo from wi, K pairs, into out (K,)."""
    _, _, _, data, conditional, marginal, phi_nodes, theta_nodes, _ = tables
    for k in nb.prange(wi.shape[0]):
        out[k] = 0.0
        if wi[k, 2] <= LEVEL or wo[k, 2] <= LEVEL:
            continue
        theta_i, phi_i, ux, uy, theta_m, cos_im = locate(wi[k], wo[k], isotropic, reduction)
        slices, weights = warp.blend(phi_nodes, theta_nodes, phi_i, theta_i)
        u, v, vndf_pdf = warp.invert(data, conditional, marginal, slices, weights, ux, uy)
        lum_pdf = warp.density(luminance, slices, weights, u, v)
        out[k] = vndf_pdf * lum_pdf / _half_vector_jacobian(ux, theta_m, cos_im)


@nb.njit(cache=True, inline="always")
def _half_vector(ux, uy, phi_i, isotropic):
    """The half vector of a point of the unit square, and its elevation."""
    theta_m = ux * ux * (0.5 * np.pi)
    phi_m = (2.0 * uy - 1.0) * np.pi
    if isotropic:
        phi_m += phi_i
    sin_m = np.sin(theta_m)
    return np.cos(phi_m) * sin_m, np.sin(phi_m) * sin_m, np.cos(theta_m), theta_m


@serialised
@nb.njit(cache=True, parallel=True)
def integrate(wi, isotropic, reduction, tables, out):
    """Sums of f cos(theta_o) / pdf of the visible normals over n x n points of the unit square.

    Of K incident directions (K, 3), row by row, into out (K, n, B).
    """
    _, _, _, data, conditional, marginal, phi_nodes, theta_nodes, _ = tables
    n = out.shape[1]
    for r in nb.prange(wi.shape[0] * n):
        k, i = r // n, r % n
        sums = out[k, i]
        sums[:] = 0.0
        if wi[k, 2] <= 0.0:
            continue
        sx, sy = signs(reduction, wi[k, 0], wi[k, 1])
        ix, iy, iz = wi[k, 0] * sx, wi[k, 1] * sy, wi[k, 2]
        theta_i, phi_i = elevation(ix, iy, iz), np.arctan2(iy, ix)
        slices, weights = warp.blend(phi_nodes, theta_nodes, phi_i, theta_i)
        row = np.empty(out.shape[2])
        for j in range(n):
            u, v = (j + 0.5) / n, (i + 0.5) / n
            ux, uy, pdf = warp.sample(data, conditional, marginal, slices, weights, u, v)
            mx, my, mz, theta_m = _half_vector(ux, uy, phi_i, isotropic)
            cos_im = ix * mx + iy * my + iz * mz
            cos_o = 2.0 * cos_im * mz - iz
            if cos_im <= 0.0 or cos_o <= 0.0 or pdf <= 0.0:
                continue
            _interpolate_row(theta_i, phi_i, ux, uy, u, v, slices, weights, cos_o, False, tables, row)
            inverse = _half_vector_jacobian(ux, theta_m, cos_im) / pdf
            for b in range(row.shape[0]):
                sums[b] += inverse * row[b]


@serialised
@nb.njit(cache=True, parallel=True)
def sample_directions(wi, uniforms, isotropic, reduction, tables, luminance, wo, pdf):
    """Outgoing directions of wi (K, 3) and uniforms (K, 2) into wo (K, 3), their densities into pdf (K,)."""
    _, _, _, data, conditional, marginal, phi_nodes, theta_nodes, _ = tables
    lum_data, lum_conditional, lum_marginal = luminance
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
        x, y, lum_pdf = warp.sample(
            lum_data, lum_conditional, lum_marginal, slices, weights, uniforms[k, 1], uniforms[k, 0]
        )
        ux, uy, vndf_pdf = warp.sample(data, conditional, marginal, slices, weights, x, y)
        mx, my, mz, theta_m = _half_vector(ux, uy, phi_i, isotropic)
        cos_im = ix * mx + iy * my + iz * mz
        if cos_im <= 0.0:
            continue
        oz = 2.0 * cos_im * mz - iz
        wo[k, 0] = sx * (2.0 * cos_im * mx - ix)
        wo[k, 1] = sy * (2.0 * cos_im * my - iy)
        wo[k, 2] = oz
        if oz > 0.0:
            pdf[k] = vndf_pdf * lum_pdf / _half_vector_jacobian(ux, theta_m, cos_im)
