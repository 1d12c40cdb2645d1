"""A virtual goniometer, which measures any BRDF and returns an RGL file.

The normal distribution comes from the retro-reflected values by power iteration; projected area and visible
normals follow from it; then the BRDF is evaluated where the warp puts the nodes of a regular grid.

Source: Dupuy & Jakob 2018, sections 4 and 5; the power iteration is Dupuy et al. 2015.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from manifold.brdf.interface import BRDF, require_brdf
from manifold.brdf.unmeasured_cells import Cells, cells_of
from manifold.brdf.warp import Warp, interpolate
from manifold.colour.conversion import luminance as luminance_of
from manifold.core.compiled import loops
from manifold.core.directions import HORIZON, from_spherical, u_to_phi, u_to_theta
from manifold.core.errors import UsageError
from manifold.core.records import Array, BsdfFile, Mask

Floats = NDArray[np.float32]  # precision of files

WARP_NODES = 128  # nodes per axis of ndf, sigma and vndf, as in the measured files
# Retro-reflection is read no further out: there f_cos falls to zero, and a normal distribution that drops by
# orders of magnitude within its last cell cannot be interpolated in single precision.
_RETRO_LIMIT = np.deg2rad(85.0)
_POWER_ITERATIONS = 12
_OVERSAMPLING = 4  # quadrature points per node of the normal distribution
_TURNS_DEG = (20.0, 40.0, 60.0, 80.0)  # angles of incident and outgoing directions to the sides of a normal
_LEAST_SHARE = 0.95  # share of what a normal reflects to the side; GGX metals send more than that back
_STEEPEST = 2.0**0.5  # factor by which retro-reflection may fall from one node to the next
SOFT_BEND = 0.3
"""Value of `bend` that adds no dips above 10 % to files of neural fits; see docs/explanation/rgl-files.md."""
_WARP_EXPONENT = 0.5  # exponent of the visible normals in the warp; docs/explanation/rgl-files.md
_BELOW_HORIZON = 0.1  # weight of normals that mirror light below the horizon, where cells hold zeros
_FADE = 0.5  # sine of the angle below the horizon at which their weight would be 0


def default_theta_i(n: int) -> Array:
    """Return n angles of incidence in radians, shape (n,), spaced for a small interpolation error.

    Source: docs/explanation/rgl-files.md.

    >>> np.rad2deg(default_theta_i(4)).round(1)
    array([ 0. , 40.9, 66.3, 90. ])
    """
    if n < 2:
        raise UsageError(f"theta_i needs at least 2 nodes, found {n}")
    t = np.linspace(0.0, 1.0, n)
    return 0.4 * (0.5 * np.pi * t) + 0.6 * np.arccos(1.0 - t)


def _retro_reflection(brdf: BRDF, theta: Array, phi: Array | float, steepest: float) -> Array:
    """Return the band mean of f_cos(w, w), shape of theta and phi broadcast; the nodes of theta on the last axis.

    A prediction may have no retro-reflection at normals that reflect brightly in other directions, and the normal
    distribution would give these no cells: a share of what they reflect to the side is taken as a lower bound.
    """
    theta = np.minimum(theta, _RETRO_LIMIT)
    w = from_spherical(theta, phi)
    side = np.stack(np.broadcast_arrays(-np.sin(phi), np.cos(phi), np.zeros(w.shape[:-1])), axis=-1)
    retro = np.maximum(brdf.eval_cos(w, w).mean(axis=-1), 0.0)
    aside = np.zeros_like(retro)
    for turn in np.deg2rad(_TURNS_DEG):
        wi, wo = (np.cos(turn) * w + sign * np.sin(turn) * side for sign in (1.0, -1.0))
        # times cos^2, so that facets which mirror alike at all angles count alike at every turn
        f = np.maximum(brdf.eval(wi, wo).mean(axis=-1), 0.0)
        aside += f * np.cos(turn) ** 2 * w[..., 2] / len(_TURNS_DEG)
    return _without_pits(np.maximum(retro, _LEAST_SHARE * aside), steepest)


def _without_pits(retro: Array, steepest: float) -> Array:
    """Return the smallest values (..., n) of at least `retro` with bounded ratios between neighbouring nodes.

    If a normal distribution has pits, or cliffs between two nodes of the outgoing grid, huge stored values lie beside
    small ones, and interpolation between them is wrong. Measured materials and GGX have neither and do not change.
    Raised values only cause a few more samples.
    """
    with np.errstate(divide="ignore"):
        height = np.log(retro)
    slope = np.arange(retro.shape[-1]) * np.log(steepest)
    outward = np.maximum.accumulate(height + slope, axis=-1) - slope
    inward = np.maximum.accumulate((height - slope)[..., ::-1], axis=-1)[..., ::-1] + slope
    envelope = np.maximum(outward, inward)
    return np.where(envelope > height, np.exp(envelope), retro)


def _without_knees(retro: Array, bend: float, exponent: float, resolution: int) -> Array:
    """Return the smallest values (..., n) above `retro` whose logarithm has no valley sharper than `bend t^2`.

    t counts nodes of the outgoing grid at normal incidence. If a peak ends on a pedestal within a cell, and at other
    incidences somewhere else, stored values do not interpolate well, and the file has a valley beside the peak. The
    operation is the closing of mathematical morphology, by a parabola.
    """
    u = np.linspace(0.0, 1.0, retro.shape[-1])
    density = (retro * u * np.sin(u_to_theta(u))) ** exponent
    cumulated = np.cumsum(density, axis=-1) - 0.5 * density
    t = cumulated / cumulated[..., -1:] * (resolution - 1)
    parabola = bend * (t[..., :, None] - t[..., None, :]) ** 2
    with np.errstate(divide="ignore"):
        raised = np.max(np.log(retro)[..., None, :] - parabola, axis=-1)
    return np.asarray(np.exp(np.min(raised[..., None, :] + parabola, axis=-1)))


def _isotropic_ndf(retro: Array) -> tuple[Array, Array]:
    """Return the normal distribution and projected area at the WARP_NODES polar angles, each shape (WARP_NODES,)."""
    u = np.linspace(0.0, 1.0, WARP_NODES)
    fine = (np.arange((WARP_NODES - 1) * _OVERSAMPLING) + 0.5) / ((WARP_NODES - 1) * _OVERSAMPLING)
    theta = u_to_theta(fine)
    # d omega = sin(theta) d theta d phi, and d theta = pi u du.
    measure = np.sin(theta) * np.pi * fine / fine.size
    # The integral of max(0, <w, m>) over the azimuth, in closed form.
    cos_w, cos_m = np.cos(u_to_theta(u))[:, None], np.cos(theta)[None, :]
    a = cos_w * cos_m
    b = np.sqrt(np.maximum(1 - cos_w**2, 0.0) * np.maximum(1 - cos_m**2, 0.0))
    phi_0 = np.arccos(np.clip(-a / np.maximum(b, 1e-300), -1.0, 1.0))
    projection = 2.0 * (a * phi_0 + b * np.sin(phi_0)) * measure
    D = np.ones(WARP_NODES)
    for _ in range(_POWER_ITERATIONS):
        sigma = projection @ np.interp(fine, u, D)
        D = retro * sigma
        D /= 2.0 * np.pi * np.sum(np.interp(fine, u, D) * np.cos(theta) * measure)
    sigma = projection @ np.interp(fine, u, D)
    return D, sigma / sigma[0]


def _anisotropic_ndf(retro: Array) -> tuple[Array, Array]:
    """Return the normal distribution and projected area, each (rows = phi, columns = theta), WARP_NODES^2."""
    u = np.linspace(0.0, 1.0, WARP_NODES)
    theta, phi = u_to_theta(u), u_to_phi(u)
    m = from_spherical(theta[None, :], phi[:, None]).reshape(-1, 3)
    edge = np.ones(WARP_NODES)
    edge[[0, -1]] = 0.5  # trapezoid rule in both coordinates
    step = 1.0 / (WARP_NODES - 1)
    measure = (edge[:, None] * 2.0 * np.pi * step) * (edge * np.sin(theta) * np.pi * u * step)[None, :]
    # The projected area is smooth: a quarter of the nodes per axis carries it.
    coarse = np.linspace(0.0, 1.0, 33)
    nodes = np.stack(np.meshgrid(u, u, indexing="xy"), axis=-1).reshape(-1, 2)
    w = from_spherical(u_to_theta(coarse)[None, :], u_to_phi(coarse)[:, None]).reshape(-1, 3)
    facing, cosine = np.ascontiguousarray(m.T), m[:, 2] * measure.reshape(-1)

    def projected_area(D: Array) -> Array:
        table = np.empty((33, 33))
        loops.project_facets(w, facing, (measure * D).reshape(-1), table.reshape(-1))
        return interpolate(table, nodes).reshape(WARP_NODES, WARP_NODES)

    D = np.ones((WARP_NODES, WARP_NODES))
    for _ in range(_POWER_ITERATIONS):
        D = retro * projected_area(D)
        D /= cosine @ D.reshape(-1)
    return D, projected_area(D)


def node_normals(n: int) -> Array:
    """Return the normals (n, n, 3) at the nodes of a square grid whose rows are azimuths and columns polar angles."""
    u = np.linspace(0.0, 1.0, n)
    return from_spherical(u_to_theta(u)[None, :], u_to_phi(u)[:, None])


def visible_normals(ndf: Array, cos_im: Array) -> Array:
    """Return the unnormalised density of visible normals over the unit square, shape (C, C).

    `ndf` is the normal distribution at the nodes, and `cos_im` the cosines of their normals with `wi`.
    """
    u = np.linspace(0.0, 1.0, ndf.shape[1])
    if len(ndf) != ndf.shape[1]:  # rows are alike in isotropic files
        ndf = ndf[:1]
    jacobian = 2.0 * np.pi**2 * u * np.sin(u_to_theta(u))
    return ndf * np.maximum(cos_im, 0.0) * jacobian


def _node_density(ndf: Array, m: Array, wi: Array, exponent: float) -> Array:
    """Return the nodes' density over the unit square (C, C), not normalised: a power of the visible normals' density.

    Normals m (C, C, 3) that mirror `wi` below the horizon count less, unless the density is the instrument's own
    (exponent 1).
    """
    cos_im = m @ wi
    visible = visible_normals(ndf, cos_im)
    if exponent == 1.0:
        return visible
    cos_o = 2.0 * cos_im * m[..., 2] - wi[2]
    return np.asarray((visible * np.clip(1.0 + cos_o / _FADE, _BELOW_HORIZON, 1.0)) ** exponent)


def measure(
    brdf: BRDF,
    name: str,
    *,
    description: str = "",
    resolution: int = 32,
    theta_i_rad: Array | None = None,
    n_theta_i: int = 8,
    n_phi_i: int | None = None,
    compensate: bool = True,
    warp_exponent: float = _WARP_EXPONENT,
    steepest: float = _STEEPEST,
    bend: float | None = None,
    version: tuple[int, int] = (3, 1),
) -> BsdfFile:
    """Measure a BRDF as the RGL goniometer does, and return an RGL file that interpolates it.

    Args:
        brdf: the BRDF to measure; its bands become the bands of the file.
        name, description: identification of the material.
        resolution: nodes per axis of the outgoing grid, H = W.
        theta_i_rad: angles of incidence in radians, increasing, shape (T,); default `default_theta_i(n_theta_i)`.
        n_theta_i: number of angles of incidence T, if `theta_i_rad` is None.
        n_phi_i: number of incident azimuths P, over half a turn; default 1 for an isotropic BRDF and 17 otherwise.
        compensate: adjust the node values to minimise the error of linear interpolation between the nodes; if False,
            the file is exact at the nodes and has about twice the error elsewhere (docs/explanation/rgl-files.md).
        warp_exponent: power of the density of visible normals that spaces the outgoing grid; 1 is the grid of the
            real instrument, which has few nodes beside a sharp highlight and half of its nodes below the horizon.
        steepest: largest ratio of the normal distribution at neighbouring nodes.
        bend: limit on the curvature of the logarithm of the normal distribution beside a peak, as the coefficient of
            a parabola over the nodes of the outgoing grid. `SOFT_BEND` suits data whose peaks differ in width between
            incidences. None sets no limit, which gives smaller errors for blends of measured materials.
        version: pipeline version, which determines the meaning of a set bit of `valid`.

    Returns:
        A file whose evaluation interpolates the BRDF; cells whose outgoing direction lies below the horizon
        are marked as not measured.

    Raises:
        UsageError: an axis has fewer than 2 nodes, there are 2 azimuths, or the BRDF has no retro-reflection at any
            polar angle.
    """
    require_brdf(brdf, "goniometer.measure")
    if n_phi_i == 2:
        raise UsageError("2 incident azimuths make an isotropic file; give 1, or at least 3")
    if resolution < 2:
        raise UsageError(f"the outgoing grid has {resolution} nodes per axis, expected at least 2")
    theta_i = default_theta_i(n_theta_i) if theta_i_rad is None else np.asarray(theta_i_rad, dtype=float)
    n_phi_i = (1 if brdf.is_isotropic else 17) if n_phi_i is None else n_phi_i
    isotropic = n_phi_i == 1
    # Half a turn is enough where the material looks the same after a half turn about its normal.
    phi_i = np.zeros(1) if isotropic else np.linspace(-np.pi, 0.0, n_phi_i)

    u = np.linspace(0.0, 1.0, WARP_NODES)
    theta, phi = u_to_theta(u), u_to_phi(u)
    if isotropic:
        retro = _retro_reflection(brdf, theta, 0.0, steepest)
    else:
        retro = _retro_reflection(brdf, theta[None, :], phi[:, None], steepest)
    if not np.any(retro > 0):
        raise UsageError(
            f"{name}: no light is reflected back at any elevation, so no normal distribution can be computed"
        )
    if bend is not None:
        retro = _without_knees(retro, bend, warp_exponent, resolution)
    if isotropic:
        D, area = _isotropic_ndf(retro)
        ndf, sigma = np.tile(D, (2, 1)), np.tile(area, (2, 1))
    else:
        ndf, sigma = _anisotropic_ndf(retro)
    ndf, sigma = ndf.astype(np.float32), sigma.astype(np.float32)

    vndf = np.empty((len(phi_i), len(theta_i), WARP_NODES, WARP_NODES), dtype=np.float32)
    m = node_normals(WARP_NODES)
    for p, t in np.ndindex(vndf.shape[:2]):
        wi = from_spherical(min(theta_i[t], HORIZON), phi_i[p])
        vndf[p, t] = _node_density(ndf, m, wi, warp_exponent)
    warp = Warp(vndf, phi_i.astype(np.float32), theta_i.astype(np.float32))
    cells = [
        Cells.seen_from(warp, float(phi), float(theta), (resolution, resolution), is_isotropic=isotropic)
        for phi in phi_i
        for theta in theta_i
    ]
    spectra, measured = _at_nodes(brdf, ndf, sigma, cells, phi_i, theta_i)
    if compensate:
        spectra = _compensate(spectra, measured, phi_i, theta_i)
    spectra = np.moveaxis(spectra, -1, 2)
    wavelengths = brdf.bands.wavelengths_nm
    file = BsdfFile(
        name=name,
        description=description,
        version=version,
        phi_i_rad=phi_i.astype(np.float32),
        theta_i_rad=theta_i.astype(np.float32),
        wavelengths_nm=None if wavelengths is None else np.array(wavelengths, dtype=np.float32),
        sigma=sigma,
        ndf=ndf,
        vndf=vndf,
        luminance=np.zeros_like(spectra[:, :, 0]),
        spectra=spectra,
        jacobian=True,
        valid=pack_valid(measured, version),
    )
    return with_luminance(file, cells)


def remeasure(brdf: BRDF, file: BsdfFile) -> BsdfFile:
    """Return the file with its values replaced by the values of a BRDF at the same nodes; the warps stay the same."""
    cells = [one for _, _, one in cells_of(file)]
    spectra, _ = _at_nodes(brdf, file.ndf, file.sigma, cells, file.phi_i_rad, file.theta_i_rad)
    return with_luminance(replace(file, spectra=np.moveaxis(spectra, -1, 2)), cells)


def with_luminance(file: BsdfFile, cells: list[Cells] | None = None) -> BsdfFile:
    """Return the file with the field `luminance`, the density by which renderers sample the file.

    If the outgoing grid is warped by the visible normals, as in measured files, the density is the luminance of
    `spectra`. `cells` holds the cells of every slice of the outgoing grid; None computes them.
    """
    density = np.maximum(luminance_of(np.moveaxis(file.spectra, 2, -1), file.bands), 0.0)  # [P, T, H, W]
    if not file.jacobian:
        return replace(file, luminance=density.astype(np.float32))
    m = node_normals(file.ndf.shape[1])
    cells = [one for _, _, one in cells_of(file)] if cells is None else cells
    for (p, t), one in zip(np.ndindex(density.shape[:2]), cells, strict=True):
        phi_i, theta_i = float(file.phi_i_rad[p]), float(file.theta_i_rad[t])
        wi = from_spherical(min(theta_i, HORIZON), 0.0 if file.is_isotropic else phi_i)
        points = np.ascontiguousarray(one.points).reshape(-1, 2)
        visible = interpolate(visible_normals(file.ndf, m @ wi), points).reshape(density.shape[2:])
        density[p, t] *= np.divide(visible, one.density, out=np.zeros_like(visible), where=one.density > 0.0)
    return replace(file, luminance=density.astype(np.float32))


def _at_nodes(
    brdf: BRDF, ndf: Array, sigma: Array, cells: list[Cells], phi_i: Array, theta_i: Array
) -> tuple[Floats, Mask]:
    """Return stored values (P, T, n, n, B) and a mask of those that were measured (P, T, n, n)."""
    shape = (len(phi_i), len(theta_i), *cells[0].is_above.shape)
    spectra, measured = np.zeros((*shape, brdf.bands.count), dtype=np.float32), np.empty(shape, dtype=bool)
    for (p, t), one in zip(np.ndindex(shape[:2]), cells, strict=True):
        phi, theta, above = float(phi_i[p]), float(theta_i[t]), one.is_above
        D = interpolate(ndf, one.points[above])
        area = interpolate(sigma, np.array([[np.sqrt(theta * 2.0 / np.pi), (phi + np.pi) / (2.0 * np.pi)]]))
        scale = np.divide(4.0 * area, D, out=np.zeros_like(D), where=D > 0)
        spectra[p, t, above] = brdf.eval_cos(one.wi, one.wo[above]) * scale[:, None]
        measured[p, t] = above
    return spectra, measured


def _compensate(spectra: Floats, measured: Mask, phi_i: Array, theta_i: Array) -> Floats:
    """Return node values whose piecewise-linear interpolant is closest in the mean square: f - h^2 f'' / 12 per axis.

    Linear interpolation of exact values overestimates f if f is convex and underestimates it if f is concave. The
    adjustment is limited to a fifth of the value, so that sharp edges do not ring and no value becomes negative.
    """
    grid = np.arange(spectra.shape[2], dtype=float)
    # in the precision of the values: these are the largest arrays of a measurement
    ahead, behind = np.zeros((2, 4, max(spectra.shape[:4])), dtype=spectra.dtype)
    for axis, nodes in enumerate((phi_i, theta_i, grid, grid)):
        if len(nodes) >= 3:
            h = np.diff(nodes)
            factor = -1.0 / 12.0 * (h[1:] ** 2 + h[:-1] ** 2) / (h[1:] + h[:-1])
            ahead[axis, 1 : len(h)], behind[axis, 1 : len(h)] = factor / h[1:], factor / h[:-1]
    out = np.zeros_like(spectra)
    loops.add_shift(spectra, measured, ahead, behind, out)
    return out


def pack_valid(measured: Mask, version: tuple[int, ...]) -> NDArray[np.uint8]:
    """Pack bits of the `valid` field: "measured" up to pipeline version 3.1, "not measured" from 3.2 on."""
    return np.packbits(measured if tuple(version) < (3, 2) else ~measured)
