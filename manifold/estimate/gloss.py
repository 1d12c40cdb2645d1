"""Specular gloss: what a gloss meter shows of a BRDF at 20, 60 or 85 degrees.

Light through a narrow aperture falls on the sample, and a wider one around the mirror direction collects it; the same
from polished black glass is 100 gloss units.

Source: ISO 2813, ASTM D523: angles, apertures, and the glass.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache

import numpy as np

from manifold.analytic.fresnel import fresnel_dielectric
from manifold.brdf.measured import EvaluableBRDF
from manifold.colour.conversion import luminance
from manifold.directions import from_spherical
from manifold.errors import UsageError
from manifold.formats.readings import GLOSS_ANGLES_DEG
from manifold.records import Array

RECEPTORS_DEG = {20: (1.8, 3.6), 60: (4.4, 11.7), 85: (4.0, 6.0)}  # in the plane of incidence, and across it
SOURCE_DEG = (0.75, 2.5)
_SOURCE_NODES, _RECEPTOR_NODES = (2, 5), (21, 41)  # gloss of measured mirrors within 2 % of finer grids
_GLASS_INDEX = 1.567


@dataclass(frozen=True, eq=False)
class GlossMeter:
    """One geometry of a gloss meter.

    Attributes:
        wi, wo: direction pairs from the source to the receptor, shape (P, 3).
        weights: of f at them, in sr: their sum with f is the share of the light that is collected, shape (P,).
        full_scale: that share of black glass, 100 gloss units.
    """

    wi: Array
    wo: Array
    weights: Array
    full_scale: float

    def units(self, values: Array) -> Array:
        """Gloss units of f in 1/sr at its pairs, shape (P, ...); shape (...)."""
        return np.asarray(100.0 * np.tensordot(self.weights, values, 1) / self.full_scale)

    def mean_value(self, units: float) -> float:
        """The mean of f over the receptor, in 1/sr, that makes so many gloss units."""
        return float(0.01 * units * self.full_scale / self.weights.sum())

    def mean(self, values: Array) -> Array:
        """The mean over the receptor of f in 1/sr at its pairs, shape (P, ...); shape (...)."""
        return np.asarray(np.tensordot(self.weights, values, 1) / self.weights.sum())


@cache
def gloss_meter(angle_deg: float) -> GlossMeter:
    """The geometry at one of `GLOSS_ANGLES_DEG`.

    Raises:
        UsageError: gloss meters have no such angle.
    """
    if angle_deg not in RECEPTORS_DEG:
        raise UsageError(f"gloss at {angle_deg:g} degrees, expected 20, 60 or 85 (ISO 2813)")
    theta = np.deg2rad(angle_deg)
    source, _ = _aperture(theta, np.pi, SOURCE_DEG, _SOURCE_NODES)
    receptor, solid_angles = _aperture(theta, 0.0, RECEPTORS_DEG[int(angle_deg)], _RECEPTOR_NODES)
    light = source[:, 2] / source[:, 2].sum()
    return GlossMeter(
        np.repeat(source, len(receptor), axis=0),
        np.tile(receptor, (len(source), 1)),
        np.outer(light, solid_angles * receptor[:, 2]).ravel(),
        float(fresnel_dielectric(np.array([np.cos(theta)]), np.array([_GLASS_INDEX]))[0, 0]),
    )


def gloss_units(brdf: EvaluableBRDF, angles_deg: Iterable[float] = GLOSS_ANGLES_DEG) -> dict[float, float]:
    """Gloss units of a BRDF, by its luminance, at some incidences in degrees.

    Files hold highlights as wide as the goniometer resolved: the gloss of what is polished comes out too low.

    Raises:
        UsageError: gloss meters have no such angle.
    """
    units = {}
    for angle in angles_deg:
        meter = gloss_meter(angle)
        units[angle] = float(meter.units(luminance(brdf.eval(meter.wi, meter.wo), brdf.bands)))
    return units


def gloss_differences(made: Array, read: Array) -> Array:
    """Relative differences of cube roots between units of gloss and what was read within a unit, shape (G,)."""
    nearest = np.clip(made, np.maximum(read - 1.0, 0.0), read + 1.0)
    root, near = np.cbrt(made), np.cbrt(nearest)
    return np.asarray(np.abs(root - near) / np.maximum(np.maximum(root, near), np.finfo(float).tiny))


def _aperture(
    theta: float, phi: float, size_deg: tuple[float, float], nodes: tuple[int, int]
) -> tuple[Array, Array]:
    """Directions (P, 3) to the cells of a rectangular aperture around one direction, and their solid angles (P,)."""
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
