"""Measures the physical plausibility of a BRDF: negative values, reciprocity, and albedo."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.core.compiled import loops
from manifold.core.defaults import TINY
from manifold.core.directions import (
    from_spherical,
    gauss_legendre,
    hemisphere_quadrature,
    require_directions,
    rotate_z,
)
from manifold.core.records import Array, BsdfFile

ASSESSED_INCIDENCES_DEG = (30.0, 45.0, 60.0)
"""Angles of incidence, in degrees, of the profiles in which dips are searched."""
REACH_DEG = 20.0
"""Largest angle of a profile from the mirror direction, in degrees."""


def profile_pairs(
    incidences_deg: Sequence[float] = ASSESSED_INCIDENCES_DEG, azimuths_deg: Sequence[float] = (0.0,)
) -> tuple[Array, Array]:
    """Return directions wi (I, 1, 3) and wo (I, D, 3) in the plane of incidence, around the mirror direction.

    I is the number of incidences times the number of azimuths.
    """
    offset = np.arange(-REACH_DEG, REACH_DEG + 1.0)
    incidence = np.array(incidences_deg)
    outgoing = np.deg2rad(np.minimum(incidence[:, None] + offset, 85.0))
    wo = np.stack([-np.sin(outgoing), np.zeros_like(outgoing), np.cos(outgoing)], axis=2)
    wi = from_spherical(np.deg2rad(incidence), 0.0)[:, None]
    azimuths = np.deg2rad(azimuths_deg)
    turned = [np.concatenate([rotate_z(w, azimuth) for azimuth in azimuths]) for w in (wi, wo)]
    return turned[0], turned[1]


def valley_depth(f: Array) -> Array:
    """Return the relative depth of the deepest minimum of profiles f (..., D), shape (...); 0 for black profiles.

    The depth is relative to the lower of the two maxima on either side of the minimum.
    """
    f = np.asarray(f, dtype=np.float64)
    depth = np.empty(f.shape[:-1])
    loops.valley_depths(f.reshape(-1, f.shape[-1]), TINY, depth.reshape(-1))
    return depth[()]


Evaluate = Callable[[Array, Array], Array]
"""A function that returns f in 1/sr of M BRDFs at direction pairs wi, wo (P, 3), shape (M, P, B)."""

_INCIDENCES_DEG = (5.0, 20.0, 35.0, 50.0, 65.0, 80.0)  # incidences for negative values and reciprocity
_MIRROR_INCIDENCES_DEG = tuple(range(15, 76, 5))
ALBEDO_INCIDENCES_DEG = (0.0, 30.0, 60.0, 75.0)
FILE_INCIDENCES_DEG = tuple(range(0, 86, 5))
"""Angles of incidence, in degrees, at which the albedo of a file is measured."""

AZIMUTHS_DEG = tuple(range(0, 360, 45))
"""Azimuths of incidence for anisotropic BRDFs, in degrees."""


@dataclass(frozen=True)
class Plausibility:
    """How physical a BRDF is: its negative values, reciprocity error, albedo, and dips in the highlight.

    Attributes:
        negative_share: share of values below zero over direction pairs and bands: the larger of the share over the
            hemisphere and the share around the mirror direction, where a narrow lobe can be negative.
        reciprocity_error: cosine-weighted norm of f(wi, wo) - f(wo, wi) over the norm of f; the larger of the errors
            over the hemisphere and around the mirror direction. Measured materials are not exactly reciprocal.
        max_albedo: largest directional albedo over bands and incidences: 0, 30, 60 and 75 degrees for a BRDF; 0, 5,
            ... 85 degrees for a file.
        highlight_valley: relative depth of the deepest in-plane minimum within 20 degrees of the mirror direction, at
            incidences of 30, 45 and 60 degrees, averaged over the bands. The depth is relative to the lower of the
            two maxima on either side of the minimum. It is limited to the depth in the geometric mean of both sides
            of the mirror direction, because a rise towards grazing on one side is not a dip.
        albedo_incidence_deg: angle of incidence at which the albedo is largest.

    Anisotropic BRDFs are evaluated at eight azimuths of incidence, isotropic ones at one.
    """

    negative_share: float
    reciprocity_error: float
    max_albedo: float
    highlight_valley: float
    albedo_incidence_deg: float = 0.0


def plausibility(brdf: BRDF) -> Plausibility:
    """Return the plausibility of a BRDF, measured on fixed direction pairs."""
    return plausibilities(lambda wi, wo: brdf.eval(wi, wo)[None], brdf.is_isotropic)[0]


def plausibilities(evaluate: Evaluate, is_isotropic: bool = True) -> list[Plausibility]:
    """Return the plausibility of M BRDFs that are evaluated together, in blocks of direction pairs.

    Anisotropic BRDFs are evaluated at eight azimuths of incidence.
    """
    wo, _ = hemisphere_quadrature(12, 16)
    wide = [(wi, wo, np.ones(len(wo))) for wi in incident_directions(_INCIDENCES_DEG, is_isotropic)]
    narrow = [
        (wi, *mirrored_quadrature(wi)) for wi in incident_directions(ALBEDO_INCIDENCES_DEG, is_isotropic)
    ]
    wide_negative, wide_error, _ = _over_incidences(evaluate, wide)
    negative, error, albedo = _over_incidences(evaluate, narrow)
    valley = _highlight_valley(evaluate, is_isotropic)
    at = np.repeat(ALBEDO_INCIDENCES_DEG, len(narrow) // len(ALBEDO_INCIDENCES_DEG))[albedo.argmax(axis=0)]
    rows = zip(
        np.maximum(wide_negative, negative), np.maximum(wide_error, error), albedo.max(axis=0), valley, at,
        strict=True,
    )  # fmt: skip
    return [Plausibility(*map(float, row)) for row in rows]


def plausibility_of_file(file: BsdfFile) -> Plausibility:
    """Return the plausibility of a file as renderers interpolate it, with albedos from 0 to 85 degrees."""
    measured = MeasuredBRDF(file)
    albedo = albedo_at(measured, FILE_INCIDENCES_DEG)
    at = int(albedo.argmax())
    return replace(
        plausibility(measured),
        max_albedo=float(albedo[at]),
        albedo_incidence_deg=float(FILE_INCIDENCES_DEG[at]),
    )


def albedo_at(brdf: BRDF, elevations_deg: Sequence[float]) -> Array:
    """Return the largest directional albedo at K angles of incidence, shape (K,).

    The largest value is taken over the bands and, for anisotropic BRDFs, over eight azimuths.
    """
    wi = incident_directions(elevations_deg, brdf.is_isotropic)
    return np.asarray(brdf.albedo(wi).reshape(len(elevations_deg), -1).max(axis=1))


def _highlight_valley(evaluate: Evaluate, is_isotropic: bool) -> Array:
    """Return the depth of the deepest valley around the mirror direction, shape (M,).

    It is the smaller of two depths: that of the profiles and that of the geometric means of their two sides.
    Neither a rise towards grazing beside a weak highlight nor retro-reflection is a valley.
    """
    azimuths = (0,) if is_isotropic else AZIMUTHS_DEG
    wi, wo = np.broadcast_arrays(*profile_pairs(azimuths_deg=azimuths))
    f = evaluate(wi.reshape(-1, 3), wo.reshape(-1, 3)).mean(axis=2)
    profiles = np.maximum(f, 0.0).reshape(len(f), *wo.shape[:2])
    both_sides = np.sqrt(profiles * profiles[..., ::-1])
    return np.asarray(np.minimum(valley_depth(profiles), valley_depth(both_sides)).max(axis=1))


def incident_directions(elevations_deg: Sequence[float] | Array, is_isotropic: bool) -> Array:
    """Return incident directions (K, 3) at angles of incidence; for anisotropic BRDFs, at eight azimuths each."""
    azimuths = (0,) if is_isotropic else AZIMUTHS_DEG
    return from_spherical(np.deg2rad(elevations_deg)[:, None], np.deg2rad(azimuths)).reshape(-1, 3)


def _over_incidences(
    evaluate: Evaluate, quadratures: Iterable[tuple[Array, Array, Array]]
) -> tuple[Array, Array, Array]:
    """Return the share of negative values and the reciprocity error of M BRDFs (M,), and their albedo (K, M).

    Each of the K quadratures has wi (3,), wo (P, 3) and their weights in sr (P,).
    """
    negative, squared, difference, albedo = [], [], [], []
    for incident, wo, measure in quadratures:
        wi = np.broadcast_to(incident, wo.shape)
        f, swapped = evaluate(wi, wo), evaluate(wo, wi)  # [M, P, B]
        squared_weight = measure * (wi[:, 2] * wo[:, 2]) ** 2
        negative.append(np.mean(f < 0, axis=(1, 2)))
        squared.append(np.einsum("mpb,p->m", f**2, squared_weight))
        difference.append(np.einsum("mpb,p->m", (f - swapped) ** 2, squared_weight))
        albedo.append(np.einsum("mpb,p->mb", f, measure * wo[:, 2]).max(axis=1))
    norm, distance = (np.sqrt(np.sum(a, axis=0)) for a in (squared, difference))
    error = np.divide(distance, norm, out=np.zeros_like(norm), where=norm > 0)
    return np.mean(negative, axis=0), error, np.array(albedo)


def mirror_difference(brdf: BRDF, other: BRDF) -> float:
    """Return the relative difference of two BRDFs near mirror directions.

    It is the largest value of `sum |f* - f| / sum f` over incidences of 15, 20, ... 75 degrees and over azimuths. The
    sums run over bands and over directions within five degrees of the mirror direction. Negative values count as 0.
    """
    wi = incident_directions(_MIRROR_INCIDENCES_DEG, brdf.is_isotropic and other.is_isotropic)
    m = from_spherical(np.deg2rad([0.0, 0.5, 1.0, 1.5, 2.0, 2.5])[:, None], np.deg2rad(range(0, 360, 45)))
    m, wi = m.reshape(1, -1, 3), wi[:, None]
    wo = 2.0 * np.sum(m * wi, axis=-1, keepdims=True) * m - wi  # within twice the angle of m
    f, other_f = (np.maximum(each.eval(wi, wo), 0.0) for each in (brdf, other))
    apart, total = np.abs(other_f - f).sum(axis=(1, 2)), f.sum(axis=(1, 2))
    return float(np.max(np.divide(apart, total, out=np.zeros_like(total), where=total > 0.0)))


def quadrature_albedo(brdf: BRDF, wi: Array, resolution: int) -> Array:
    """Return the directional albedo at unit vectors wi (..., 3) by quadrature over half vectors, shape (..., B).

    `resolution` is the number of nodes in polar angle and in azimuth.
    """
    wi = require_directions(wi, "wi")
    flat = wi.reshape(-1, 3)
    out = np.empty((len(flat), brdf.bands.count))
    for k, w in enumerate(flat):
        wo, measure = mirrored_quadrature(w, resolution, resolution)
        out[k] = measure @ brdf.eval_cos(w, wo)
    return out.reshape(*wi.shape[:-1], out.shape[1])


def mirrored_quadrature(wi: Array, n_theta: int = 32, n_phi: int = 32) -> tuple[Array, Array]:
    """Return outgoing directions (P, 3) above the horizon and their weights in sr, dense around the mirror direction.

    The nodes are half vectors m: Gauss-Legendre nodes in the fourth root of the polar angle, which resolve lobes down
    to alpha = 0.02. The weights follow from d omega_o = 4 <wi, m> d omega_m.
    """
    x, weights = gauss_legendre(n_theta)
    t = 0.5 * (x + 1.0)
    theta = t**4 * (0.5 * np.pi)
    d_theta = 0.5 * weights * 4.0 * t**3 * (0.5 * np.pi)
    phi = (np.arange(n_phi) + 0.5) * (2.0 * np.pi / n_phi)
    m = from_spherical(theta[:, None], phi[None, :]).reshape(-1, 3)
    measure = np.repeat(d_theta * np.sin(theta) * (2.0 * np.pi / n_phi), n_phi)
    cos_im = m @ wi
    wo = 2.0 * cos_im[:, None] * m - wi
    keep = (cos_im > 0) & (wo[:, 2] > 0)
    return wo[keep], (4.0 * cos_im * measure)[keep]
