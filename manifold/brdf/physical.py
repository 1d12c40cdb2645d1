"""Projection of a file to a physical one: non-negative, reciprocal, albedo at most 1.

What is rendered is what a file interpolates, not the BRDF that it was measured from. So the nodes are projected, and
values between them are checked.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from manifold.brdf import goniometer
from manifold.brdf.measured import BRDF, MeasuredBRDF
from manifold.brdf.plausibility import largest_albedo, mirrored_quadrature, plausibility
from manifold.brdf.wrapped import WrappedBRDF
from manifold.directions import from_spherical
from manifold.records import Array, BsdfFile

RECIPROCITY_ERROR = 0.05
"""The most that a physical file has."""

_AIM = 0.9 * RECIPROCITY_ERROR  # also where bands are scaled by different factors afterwards
_ALBEDO = 0.99  # at most: quadratures of sharp highlights at 85 degrees err by 1 %
_ELEVATIONS_RAD = np.deg2rad(np.arange(0.0, 86.0, 5.0))  # of incidence, at which the scale is found
_BALANCES = 30  # rounds, after which no albedo of a test is above 0.991
_AVERAGES = 6  # of a file with its exchanged self, at most, before its grids are refined
_GAIN = 0.97  # of the error: what another average has to gain
# Factors of the numbers of incidences and of outgoing nodes.
_REFINED = ((1.0, 1.0), (2.0, 1.0), (2.0, 1.5), (3.0, 2.0), (3.0, 3.0))


class ReciprocalBRDF(WrappedBRDF):
    """A BRDF and the one with directions exchanged, averaged by their cosines, negative values cut to zero.

    `f = (f_cos(wi, wo) + f_cos(wo, wi)) / (cos(theta_i) + cos(theta_o))`: each value counts by the cosine that it was
    measured with. Files extrapolate to the horizon, where the other value, divided by a vanishing cosine, is huge.
    """

    def eval(self, wi: Array, wo: Array) -> Array:
        """f in 1/sr, at least 0 and the same for exchanged directions, shape (..., B)."""
        wi, wo = np.broadcast_arrays(wi, wo)
        is_above = ((wi[..., 2] > 0.0) & (wo[..., 2] > 0.0))[..., None]
        both = np.maximum(self._brdf.eval_cos(wi, wo), 0.0) + np.maximum(self._brdf.eval_cos(wo, wi), 0.0)
        cosines = (wi[..., 2] + wo[..., 2])[..., None]
        return np.asarray(np.divide(both, cosines, out=np.zeros_like(both), where=is_above))


def physical_file(
    brdf: BRDF, name: str, *, n_theta_i: int = 8, resolution: int = 32, keeps_hue: bool = False, **how: Any
) -> BsdfFile:
    """Measure a BRDF into a file that is physical itself, between its nodes too; arguments as of `goniometer.measure`.

    Both orders of directions are averaged, before and after measuring; while the file is not reciprocal within 5 %,
    incidences are refined, then both grids, up to three times as many nodes per axis: what is not smooth there
    keeps a larger error. Then bands with an albedo above 1, at an incidence up to 85 degrees, are scaled down
    there, with `keeps_hue` all bands alike.
    """
    best, least = None, np.inf
    for incidences, nodes in _REFINED:
        file = goniometer.measure(
            ReciprocalBRDF(brdf), name, compensate=False,
            n_theta_i=round(incidences * n_theta_i), resolution=round(nodes * resolution), **how,
        )  # fmt: skip
        last = np.inf
        for _ in range(1 + _AVERAGES):
            measured = MeasuredBRDF(file)
            error = plausibility(measured).reciprocity_error
            if best is None or error < least:
                best, least = file, error
            if error <= _AIM or error > _GAIN * last:
                break
            last, file = error, goniometer.remeasure(ReciprocalBRDF(measured), file)
        if least <= _AIM:
            break
    assert best is not None
    return _limit_albedo(best, keeps_hue)


class AlbedoScaledBRDF(ReciprocalBRDF):
    """The same times s(theta_i) s(theta_o), with s just small enough that no albedo is above about 0.99."""

    def __init__(self, brdf: BRDF, keeps_hue: bool):
        """Find s at elevations: s <- s sqrt(0.99 / albedo) where that is larger, as in symmetric Sinkhorn scaling.

        Args:
            brdf: the BRDF to be scaled.
            keeps_hue: by one s for all bands, not one each.
        Source: Sinkhorn & Knopp 1967, for sums that may not exceed a limit.
        """
        super().__init__(brdf)
        wi = from_spherical(_ELEVATIONS_RAD, 0.0)
        count = len(wi)
        self._scale = np.ones((count, brdf.bands.count))  # [T, B]
        light = np.empty((count, count, brdf.bands.count))  # from wi to the elevations of wo
        for k, w in enumerate(wi):
            wo, measure = mirrored_quadrature(w)
            light[k] = _hats(wo).T @ (measure[:, None] * self.eval_cos(w, wo))
        for _ in range(_BALANCES):
            albedo = self._scale * np.einsum("iob,ob->ib", light, self._scale)
            if keeps_hue:
                albedo = albedo.max(axis=1, keepdims=True)
            self._scale *= np.sqrt(np.minimum(1.0, _ALBEDO / np.maximum(albedo, _ALBEDO)))

    def eval(self, wi: Array, wo: Array) -> Array:
        """f in 1/sr, shape (..., B)."""
        return super().eval(wi, wo) * (_hats(wi) @ self._scale) * (_hats(wo) @ self._scale)


def _hats(w: Array) -> Array:
    """Weights (..., T) of the elevations between which directions lie; constant beyond the last."""
    theta = np.arccos(np.clip(np.asarray(w)[..., 2], 0.0, 1.0))
    return np.stack([np.interp(theta, _ELEVATIONS_RAD, hat) for hat in np.eye(_ELEVATIONS_RAD.size)], axis=-1)


def _limit_albedo(file: BsdfFile, keeps_hue: bool) -> BsdfFile:
    """The file, scaled down where its albedo exceeds 1; remaining excess between nodes is scaled uniformly."""
    if largest_albedo(MeasuredBRDF(file)).max() > _ALBEDO:
        file = goniometer.remeasure(AlbedoScaledBRDF(MeasuredBRDF(file), keeps_hue), file)
    scale = np.minimum(1.0, _ALBEDO / np.maximum(largest_albedo(MeasuredBRDF(file)), _ALBEDO))
    if keeps_hue:
        scale[:] = scale.min()
    spectra = file.spectra * scale.astype(np.float32)[:, None, None]
    return goniometer.with_luminance(replace(file, spectra=spectra))
