"""Computes specular gloss, the reading of a gloss meter at 20, 60 or 85 degrees, from a BRDF.

Light from a narrow aperture falls on the specimen, and a wider aperture around the mirror direction collects it;
polished black glass has 100 gloss units.

Source: ISO 2813, ASTM D523: angles, apertures, and the glass.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import numpy as np

from manifold.analytic.fresnel import fresnel_dielectric
from manifold.brdf.interface import EvaluableBRDF
from manifold.brdf.measured import values_at
from manifold.colour.ball_colours import Picture, sums_of_runs
from manifold.colour.conversion import luminance
from manifold.core.directions import from_spherical, normalize
from manifold.core.errors import UsageError
from manifold.core.records import Array

RECEPTORS_DEG = {20: (1.8, 3.6), 60: (4.4, 11.7), 85: (4.0, 6.0)}  # widths in plane, and across it
SOURCE_DEG = (0.75, 2.5)
_SOURCE_NODES, _RECEPTOR_NODES = (2, 5), (21, 41)  # gloss of measured mirrors within 2 % of finer grids
_HALF_NODES = (19, 12)  # nodes in the plane of incidence, and across it on one side
_GLASS_INDEX = 1.567


@cache
def gloss_meter(angle_deg: float) -> Picture:
    """Return the measurement of a gloss meter at one of `GLOSS_ANGLES_DEG`, a picture of one value in gloss units."""
    if angle_deg not in RECEPTORS_DEG:
        raise UsageError(f"gloss at {angle_deg:g} degrees, expected 20, 60 or 85 (ISO 2813)")
    theta = np.deg2rad(angle_deg)
    source, _ = _aperture(theta, np.pi, SOURCE_DEG, _SOURCE_NODES)
    receptor, solid_angles = _aperture(theta, 0.0, RECEPTORS_DEG[int(angle_deg)], _RECEPTOR_NODES)
    light = source[:, 2] / source[:, 2].sum()
    collected = np.outer(light, solid_angles * receptor[:, 2]).ravel()  # weights of f, in sr
    wi, wo = np.repeat(source, len(receptor), axis=0), np.tile(receptor, (len(source), 1))
    return Picture(wi, wo, sums_of_runs(100.0 * collected / black_glass(angle_deg), np.zeros(1, int)))


def half_gloss_meter(angle_deg: int) -> tuple[Array, Array, Array]:
    """Return a gloss meter with few direction pairs: wi and wo (P, 3), and gloss units per 1/sr of each pair (P,).

    The pairs lie on one side of the plane of incidence, dense around the mirror direction. All have the light at the
    centre of the source; the weights include the width of the source as a wider receptor.
    """
    theta, (half_in, half_across) = np.deg2rad(angle_deg), 0.5 * np.deg2rad(RECEPTORS_DEG[angle_deg])
    source_in, source_across = 0.5 * np.deg2rad(SOURCE_DEG)
    n_in, n_across = _HALF_NODES
    x_edges, y_edges = np.linspace(-1.0, 1.0, n_in + 1), np.linspace(0.0, 1.0, n_across + 1)
    x_edges = (half_in + source_in) * x_edges * np.abs(x_edges)  # dense around the mirror direction
    y_edges = (half_across + source_across) * y_edges**2
    x, y = (0.5 * (edges[1:] + edges[:-1]) for edges in (x_edges, y_edges))
    X, Y = (a.ravel() for a in np.meshgrid(x, y, indexing="ij"))
    seen = np.clip((half_in + source_in - np.abs(X)) / (2.0 * source_in), 0.0, 1.0)
    seen *= np.clip((half_across + source_across - Y) / (2.0 * source_across), 0.0, 1.0)
    centre, across = from_spherical(theta, 0.0), np.array([0.0, 1.0, 0.0])
    wo = normalize(centre + np.tan(X)[:, None] * np.cross(across, centre) + np.tan(Y)[:, None] * across)
    cell = 2.0 * np.outer(np.diff(x_edges), np.diff(y_edges)).ravel()  # on both sides
    weights = 100.0 * seen * cell * wo[:, 2] / black_glass(angle_deg)
    return np.broadcast_to(from_spherical(theta, np.pi), wo.shape), wo, weights


def black_glass(angle_deg: float) -> float:
    """Return the share of the light that polished black glass reflects, 100 gloss units."""
    cosine = np.array([np.cos(np.deg2rad(angle_deg))])
    return float(fresnel_dielectric(cosine, np.array([_GLASS_INDEX]))[0, 0])


def value_of_unit(angle_deg: float) -> float:
    """Return the mean of f over the receptor, in 1/sr, that corresponds to one gloss unit."""
    return 1.0 / float(gloss_meter(angle_deg).light.sum())


def gloss_units(brdf: EvaluableBRDF, angles_deg: Iterable[float]) -> dict[float, float]:
    """Return the gloss units of a BRDF, from its luminance, by angle: some of `GLOSS_ANGLES_DEG`.

    Measured files resolve highlights no better than the goniometer did, so the gloss of polished materials is too
    low.
    """
    units = {}
    for angle in angles_deg:
        meter = gloss_meter(angle)
        units[angle] = float(meter.of(luminance(values_at(brdf, meter), brdf.bands))[0])
    return units


def gloss_differences(made: Array, read: Array) -> Array:
    """Return relative differences of cube roots between computed and measured gloss, 0 within one unit, shape (G,)."""
    nearest = np.clip(made, np.maximum(read - 1.0, 0.0), read + 1.0)
    root, near = np.cbrt(made), np.cbrt(nearest)
    return np.asarray(np.abs(root - near) / np.maximum(np.maximum(root, near), np.finfo(float).tiny))


def _aperture(
    theta: float, phi: float, size_deg: tuple[float, float], nodes: tuple[int, int]
) -> tuple[Array, Array]:
    """Return directions (P, 3) to cells of a rectangular aperture around a direction, and solid angles (P,)."""
    centre = from_spherical(theta, phi)
    across = np.array([0.0, 1.0, 0.0])
    x, y = (
        ((np.arange(n) + 0.5) / n - 0.5) * 2.0 * np.tan(0.5 * np.deg2rad(size))
        for size, n in zip(size_deg, nodes, strict=True)
    )
    X, Y = (grid.ravel()[:, None] for grid in np.meshgrid(x, y, indexing="ij"))
    towards = centre + X * np.cross(across, centre) + Y * across
    distance = np.linalg.norm(towards, axis=1)
    cell = 4.0 * np.prod(np.tan(0.5 * np.deg2rad(size_deg))) / X.size
    return towards / distance[:, None], cell / distance**3
