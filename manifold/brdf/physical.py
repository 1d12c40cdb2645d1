"""Makes a file physical: non-negative, reciprocal, and with an albedo of at most 1.

Renderers show the values that a file interpolates, not the BRDF from which it was measured. Therefore the values at
the nodes are changed, and the values between them checked. A file that is already physical stays unchanged, bit for
bit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from manifold.brdf import goniometer
from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import (
    FILE_INCIDENCES_DEG,
    incident_directions,
    mirrored_quadrature,
    plausibility,
)
from manifold.brdf.wrapper import WrappedBRDF
from manifold.core.directions import HORIZON
from manifold.core.records import Array, BsdfFile, Mask

RECIPROCITY_ERROR = 0.05
"""Largest reciprocity error of a physical file, and largest relative difference of f(wi, wo) and f(wo, wi) in it."""

_AIM = 0.9 * RECIPROCITY_ERROR  # also where bands are scaled by different factors afterwards
# Albedo to which those above 1 are scaled: quadratures of sharp highlights at 85 degrees err by 1 %.
_ALBEDO = 0.99
_BALANCES = 30  # rounds, after which no albedo of a test is above 0.991
_DIMMINGS = 4  # rounds of scaling, before what is left above 1 between incidences is taken from these alone
_AVERAGES = 6  # most averages of a file with its exchanged self, before its grids are refined
_GAIN = 0.97  # share of the error that another average has to reach
# Factors of the numbers of incidences and of outgoing nodes.
_REFINED = ((2.0, 1.0), (2.0, 1.5), (3.0, 2.0), (3.0, 3.0))


class ReciprocalBRDF(WrappedBRDF):
    """A BRDF made reciprocal: f(wi, wo) and f(wo, wi) differ by at most 5 % of their mean, and neither is negative.

    The mean is `f = (f_cos(wi, wo) + f_cos(wo, wi)) / (cos(theta_i) + cos(theta_o))`. It weights each value by the
    cosine with which it was measured, because values at the horizon are extrapolated and divided by a cosine near 0.
    Only values that differ by more are moved towards the mean.
    """

    def eval(self, wi: Array, wo: Array) -> Array:
        """Return f in 1/sr, at least 0, shape (..., B)."""
        f_cos, cos_o = self.eval_cos(wi, wo), np.asarray(wo)[..., 2:]
        return np.asarray(np.divide(f_cos, cos_o, out=np.zeros_like(f_cos), where=cos_o > 0.0))

    def eval_cos(self, wi: Array, wo: Array) -> Array:
        """Return f * cos(theta_o) in 1/sr, shape (..., B)."""
        wi, wo = np.broadcast_arrays(wi, wo)
        is_above = ((wi[..., 2] > 0.0) & (wo[..., 2] > 0.0))[..., None]
        f_cos, exchanged = (np.maximum(self._brdf.eval_cos(*pair), 0.0) for pair in ((wi, wo), (wo, wi)))
        share = np.divide(
            wo[..., 2:], wi[..., 2:] + wo[..., 2:], out=np.zeros(is_above.shape), where=is_above
        )
        mean = share * (f_cos + exchanged)
        half = 0.5 * RECIPROCITY_ERROR
        return np.clip(f_cos, (1.0 - half) * mean, (1.0 + half) * mean)


def physical_file(
    file: BsdfFile, measure: Callable[[int, int], BsdfFile] | None = None, *, keeps_hue: bool = False
) -> BsdfFile:
    """Return the file made physical at and between its nodes; a physical file is returned unchanged.

    Negative values become zero. If the file is not reciprocal within 5 %, values of swapped directions are averaged.
    If the interpolated values are still not reciprocal, first the incidences and then both grids are refined, up to
    three times as many nodes per axis; `measure` then measures the same BRDF with these numbers of incidences and
    nodes. Finally, bands whose albedo exceeds 1 at an incidence up to 85 degrees are scaled down there; with
    `keeps_hue`, all bands are scaled by the same factor.
    """
    best, least = _reciprocal(file)
    for incidences, nodes in _REFINED if measure is not None else ():
        if least <= RECIPROCITY_ERROR:
            break
        assert measure is not None
        count, resolution = round(incidences * len(file.theta_i_rad)), round(nodes * file.spectra.shape[-1])
        made, error = _reciprocal(measure(count, resolution))
        if error < least:
            best, least = made, error
    return _limit_albedo(best, keeps_hue)


def _reciprocal(file: BsdfFile) -> tuple[BsdfFile, float]:
    """Average non-reciprocal values with those of exchanged directions; return file and reciprocity error."""
    file = replace(file, spectra=np.maximum(file.spectra, 0.0))
    measured = MeasuredBRDF(file)
    error = plausibility(measured).reciprocity_error
    if error <= RECIPROCITY_ERROR:
        return file, error
    movable: Mask | None = None
    best, least = file, error
    for _ in range(_AVERAGES):
        file, changed = _changed(file, ReciprocalBRDF(measured), movable)
        movable = changed if movable is None else movable
        measured = MeasuredBRDF(file)
        last, error = error, plausibility(measured).reciprocity_error
        if error < least:
            best, least = file, error
        if error <= _AIM or error > _GAIN * last:
            break
    return best, least


def _changed(file: BsdfFile, brdf: BRDF, movable: Mask | None = None) -> tuple[BsdfFile, Mask]:
    """Return the file with a BRDF's values at its nodes, and a mask of changed values (shape of `spectra`).

    Only movable values, by default all, are changed.
    """
    changed = goniometer.remeasure(brdf, file).spectra
    is_changed = changed != goniometer.remeasure(MeasuredBRDF(file), file).spectra
    if movable is not None:
        is_changed &= movable
    spectra = np.where(is_changed, changed, file.spectra)
    return goniometer.with_luminance(replace(file, spectra=spectra)), is_changed


class AlbedoScaledBRDF(WrappedBRDF):
    """A BRDF multiplied by s(theta_i) s(theta_o), where s is below 1 only at polar angles whose albedo exceeds 1."""

    def __init__(self, brdf: BRDF, theta_rad: Array, albedo: Array, keeps_hue: bool):
        """Find s at increasing polar angles (T,) with albedo (T, B), so that no scaled albedo exceeds 1.

        The iteration is s <- s sqrt(0.99 / albedo), as in symmetric Sinkhorn scaling. Between polar angles s is
        interpolated; with `keeps_hue` it is equal in all bands. Source: Sinkhorn & Knopp 1967, for sums that
        may not exceed a limit.
        """
        super().__init__(brdf)
        self._theta = np.minimum(theta_rad, HORIZON)
        azimuths = incident_directions(np.rad2deg(self._theta), brdf.is_isotropic)
        per_elevation = azimuths.reshape(len(self._theta), -1, 3)
        light = np.zeros((*per_elevation.shape[:2], len(self._theta), brdf.bands.count))  # [T, A, T, B]
        for at in np.ndindex(light.shape[:2]):
            wo, measure = mirrored_quadrature(per_elevation[at])
            light[at] = self._hats(wo).T @ (measure[:, None] * brdf.eval_cos(per_elevation[at], wo))
        total = light.sum(axis=2).max(axis=1)
        light *= np.divide(albedo, total, out=np.zeros_like(total), where=total > 0.0)[:, None, None]
        if keeps_hue:
            albedo = albedo.max(axis=1, keepdims=True)
        limit = np.where(albedo > 1.0, _ALBEDO, np.inf)
        scale = np.ones((len(self._theta), brdf.bands.count))
        for _ in range(_BALANCES):
            left = scale * np.einsum("taob,ob->tab", light, scale).max(axis=1)
            if keeps_hue:
                left = left.max(axis=1, keepdims=True)
            scale *= np.sqrt(np.minimum(1.0, limit / np.maximum(left, 1e-9)))
        self._loss = 1.0 - scale  # exactly 0 where nothing is scaled

    def _hats(self, w: Array) -> Array:
        """Return weights (..., T) of the polar angles between which directions lie; constant beyond the last."""
        theta = np.arccos(np.clip(np.asarray(w)[..., 2], 0.0, 1.0))
        return np.stack([np.interp(theta, self._theta, hat) for hat in np.eye(self._theta.size)], axis=-1)

    def _scale(self, w: Array) -> Array:
        return np.asarray(1.0 - self._hats(w) @ self._loss)

    def eval(self, wi: Array, wo: Array) -> Array:
        """Return f in 1/sr, shape (..., B)."""
        return self._brdf.eval(wi, wo) * self._scale(wi) * self._scale(wo)

    def eval_cos(self, wi: Array, wo: Array) -> Array:
        """Return f * cos(theta_o) in 1/sr, shape (..., B)."""
        return self._brdf.eval_cos(wi, wo) * self._scale(wi) * self._scale(wo)


def _limit_albedo(file: BsdfFile, keeps_hue: bool) -> BsdfFile:
    """Scale the file down at the incidences where its albedo exceeds 1."""
    for _ in range(_DIMMINGS):
        excess = _excess_albedo(file)
        if excess.max() <= 1.0:
            return file
        scaled = AlbedoScaledBRDF(MeasuredBRDF(file), file.theta_i_rad.astype(float), excess, keeps_hue)
        file, _ = _changed(file, scaled)
    excess = _excess_albedo(file)
    if keeps_hue:
        excess[:] = excess.max(axis=1, keepdims=True)
    scale = np.where(excess > 1.0, _ALBEDO / np.maximum(excess, _ALBEDO), 1.0).astype(np.float32)
    return goniometer.with_luminance(replace(file, spectra=file.spectra * scale[:, :, None, None]))


def _excess_albedo(file: BsdfFile) -> Array:
    """Return the albedo at the file's incidences (T, B); an excess between two of them counts for both."""
    measured = MeasuredBRDF(file)
    nodes_deg = np.rad2deg(np.minimum(file.theta_i_rad.astype(float), HORIZON))
    at_nodes, between = (
        measured.albedo(incident_directions(deg, file.is_isotropic))
        .reshape(len(deg), -1, file.bands.count)
        .max(axis=1)
        for deg in (nodes_deg, np.array(FILE_INCIDENCES_DEG, dtype=float))
    )
    is_excess = between.max(axis=1) > 1.0
    if not np.any(is_excess):
        return np.minimum(at_nodes, 1.0)
    if at_nodes.max() <= 1.0:
        for deg, albedo in zip(np.array(FILE_INCIDENCES_DEG)[is_excess], between[is_excess], strict=True):
            k = int(np.clip(np.searchsorted(nodes_deg, deg), 1, len(nodes_deg) - 1))
            at_nodes[k - 1 : k + 1] = np.maximum(at_nodes[k - 1 : k + 1], albedo)
    return np.asarray(at_nodes)
