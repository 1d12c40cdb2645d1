"""Reduces measured files to fewer bands or angles, chosen for the light and views of a scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from manifold.brdf import goniometer
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured_cells import Cells
from manifold.brdf.warp import Warp, interpolate
from manifold.colour.conversion import interpolation_matrix, sensor_responses
from manifold.colour.illuminants import Illuminant
from manifold.core.directions import HORIZON
from manifold.core.records import Array, Bands, BsdfFile

_SEEN_NM = np.arange(380.0, 781.0, 1.0)
_COLOUR_WEIGHT = 30.0  # weight of colours against spectra, in standard deviations


def band_nodes(bands: Bands, light: Array, count: int) -> Array:
    """Return the increasing wavelengths in nm, (count,), at which a few bands represent spectra best.

    Half of them are placed by the light's spectral power (L,) times the observer's sensitivity; half are spread over
    the visible range.
    """
    seen = _sensed(bands, light).sum(axis=1)
    even = ((_SEEN_NM >= 400.0) & (_SEEN_NM <= 700.0)).astype(float)
    density = 0.5 * seen / seen.sum() + 0.5 * even / even.sum()
    share = (np.cumsum(density) - 0.5 * density) / density.sum()
    return np.interp((np.arange(count) + 0.5) / count, share, _SEEN_NM)


def few_bands(source: Bands, bands: Bands, light: Array, count: int) -> tuple[Array, Array]:
    """Return nodes in nm (r,) that represent a spectrum under a light, and the matrix (r, B) from its B values.

    `bands`, `light` and `count` are those of `band_nodes`.

    The matrix minimises squared errors of spectra that are linear between the nodes and constant beyond them. The
    colour under the light has the largest weight, which three nodes preserve; the other nodes preserve the visible
    spectrum.
    """
    nodes, sensed = band_nodes(bands, light, count), _sensed(bands, light)
    level = np.sqrt(sensed.sum(axis=1) / sensed.sum() + 1e-3 / len(_SEEN_NM))[:, None]
    rows = np.concatenate([_COLOUR_WEIGHT * sensed.T / sensed[:, 1].sum(), level * np.eye(len(_SEEN_NM))])
    to_nodes, to_source = (
        rows @ interpolation_matrix(nm, _SEEN_NM) for nm in (nodes, np.array(source.wavelengths_nm))
    )
    return nodes, np.linalg.lstsq(to_nodes, to_source, rcond=None)[0]


def _sensed(bands: Bands, light: Array) -> Array:
    """Return the spectral weights of the observer's channels for reflectances under a light, (len(_SEEN_NM), 3)."""
    nm, matching = sensor_responses(Illuminant.named("E"))
    power = np.interp(_SEEN_NM, np.asarray(bands.wavelengths_nm), light)
    return np.stack([np.interp(_SEEN_NM, nm, column) for column in matching.T], axis=1) * power[:, None]


def with_bands(file: BsdfFile, nodes: Array, projection: Array) -> BsdfFile:
    """Return a spectral file in other bands: nodes in nm (r,), and the matrix (r, B) to them.

    Negative values become 0.
    """
    P, T, B, H, W = file.spectra.shape
    flat = file.spectra.transpose(2, 0, 1, 3, 4).reshape(B, -1)
    values = np.maximum(projection.astype(np.float32) @ flat, 0.0).reshape(len(nodes), P, T, H, W)
    return replace(
        file,
        wavelengths_nm=nodes.astype(np.float32),
        spectra=np.ascontiguousarray(values.transpose(1, 2, 0, 3, 4)),
        extra={},
    )


def with_angles(file: BsdfFile, theta_i: Array, *, resolution: int, warp_nodes: int) -> BsdfFile:
    """Return a file at some angles of incidence, by their increasing indices.

    `resolution` and `warp_nodes` are nodes per axis of the outgoing grid and of the distribution of visible
    normals.
    """
    brdf = MeasuredBRDF(replace(file, rotation_rad=0.0))  # nodes are where the sample was measured
    vndf = _resampled(file.vndf[:, theta_i], warp_nodes)
    theta, phi = file.theta_i_rad[theta_i], file.phi_i_rad
    warp = Warp(vndf, phi, theta)
    shape = (len(phi), len(theta), resolution, resolution)
    values = np.zeros((*shape, file.bands.count), dtype=np.float32)
    measured = np.zeros(shape, dtype=bool)
    for p, t in np.ndindex(shape[:2]):
        phi_i_rad, theta_i_rad = float(phi[p]), float(theta[t])
        cells = Cells.seen_from(
            warp, phi_i_rad, theta_i_rad, (resolution, resolution), is_isotropic=file.is_isotropic
        )
        above = cells.is_above
        f_cos = brdf.eval_cos(cells.wi, cells.wo[above])
        if file.jacobian:
            D = interpolate(file.ndf, cells.points[above])
            u = np.sqrt(min(theta_i_rad, HORIZON) * 2.0 / np.pi)
            area = interpolate(file.sigma, np.array([[u, (phi_i_rad + np.pi) / (2.0 * np.pi)]]))
            f_cos *= np.divide(4.0 * area, D, out=np.zeros_like(D), where=D > 0)[:, None]
        values[p, t, above], measured[p, t] = np.maximum(f_cos, 0.0), above
    reduced = replace(
        file,
        theta_i_rad=theta.copy(),
        vndf=vndf,
        spectra=np.ascontiguousarray(np.moveaxis(values, -1, 2)),
        valid=goniometer.pack_valid(measured, file.version),
        extra={},
    )
    return goniometer.with_luminance(reduced)


def _resampled(values: Array, n: int) -> Array:
    """Interpolate node values (..., R, C) to n nodes per axis, float32."""
    at = np.linspace(0.0, 1.0, n)
    rows, columns = (interpolation_matrix(np.linspace(0.0, 1.0, size), at) for size in values.shape[-2:])
    return np.ascontiguousarray(rows @ values @ columns.T, dtype=np.float32)


def kept_elevations(file: BsdfFile, theta_rad: Array, count: int) -> Array:
    """Return increasing indices (count,) of the angles of incidence that a scene needs most.

    `theta_rad` (M,) are the polar angles that occur in the scene. Nodes are removed one by one. Each step removes the
    node that its neighbours interpolate best, weighted by the frequency of polar angles near it. The first and the last
    node stay.
    """
    nodes = np.asarray(file.theta_i_rad, dtype=float)
    mean = file.spectra.mean(axis=(0, 2))  # (T, H, W)
    occurs = np.bincount(np.abs(theta_rad[:, None] - nodes).argmin(axis=1), minlength=len(nodes)) + 1.0
    kept = list(range(len(nodes)))
    while len(kept) > count:
        losses = []
        for a, k, b in zip(kept[:-2], kept[1:-1], kept[2:], strict=True):
            between = slice(a + 1, b)
            t = ((nodes[between] - nodes[a]) / (nodes[b] - nodes[a]))[:, None, None]
            wrong = np.mean((mean[between] - (1 - t) * mean[a] - t * mean[b]) ** 2, axis=(1, 2))
            losses.append((float(np.sum(occurs[between] * wrong)), k))
        kept.remove(min(losses)[1])
    return np.array(kept)
