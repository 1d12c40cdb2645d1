"""The direction pairs at which the page tabulates every material."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from manifold.brdf.plausibility import mirrored_quadrature
from manifold.core.directions import from_rusinkiewicz, from_spherical
from manifold.core.records import Array
from manifold.estimate.gloss import half_gloss_meter
from manifold.model.decoding import REFLECTANCE_INCIDENCE_DEG

SLICE_INCIDENCES_DEG = (20.0, 40.0, 60.0)
_SPHERE_NODES = 20  # nodes in polar angle and in azimuth


GRID_SHAPE = (45, 23, 12)
"""Numbers of nodes over theta_h, theta_d and phi_d.

Phi_d covers 0 to 180 degrees, including both ends, and runs fastest.
"""

THETA_H_MAX_RAD = float(np.deg2rad(89.0))
THETA_H_POWER = 2.5
"""Largest theta_h, and the power of the node's index that spaces theta_h densely around the mirror direction."""

THETA_D_SHARE = 0.995
"""Largest tabulated theta_d, as a share of the largest possible one."""


def grid_directions() -> tuple[Array, Array]:
    """Return wi and wo of all nodes of the grid, shape (P, 3) each.

    theta_d is a share of the largest value at which both directions are above the horizon,
    `tan(theta_d) = 1 / (tan(theta_h) |cos(phi_d)|)`, so that every node is above the horizon.
    """
    h, d, p = (np.arange(n) / (n - 1) for n in GRID_SHAPE)
    angles = np.meshgrid(h**THETA_H_POWER * THETA_H_MAX_RAD, d * THETA_D_SHARE, p * np.pi, indexing="ij")
    theta_h, share, phi_d = (a.ravel() for a in angles)
    return from_rusinkiewicz(theta_h, share * largest_theta_d(theta_h, phi_d), phi_d)


def largest_theta_d(theta_h: Array, phi_d: Array) -> Array:
    """Return the theta_d at which one of the directions reaches the horizon, in radians."""
    return np.asarray(np.arctan2(1.0, np.tan(theta_h) * np.abs(np.cos(phi_d))))


@dataclass(frozen=True, eq=False)
class TabulatedPairs:
    """All direction pairs of a page: first the grid, then slices, the gloss meter, 45/0, and the integrating sphere.

    Attributes:
        wi, wo: unit vectors, shape (P, 3).
        slice_angles_deg: angles of wo from the normal, towards the mirror direction, for each incidence.
        gloss_weights: gloss units per 1/sr at the pairs of the gloss meter at 60 degrees.
        sphere_measure: weights that integrate values at the last pairs to a reflectance.
        n_grid: number of pairs of the grid.
    """

    wi: Array
    wo: Array
    slice_angles_deg: tuple[Array, ...]
    gloss_weights: Array
    sphere_measure: Array
    n_grid: int

    @property
    def amplitude(self) -> Array:
        """Factor on tabulated cube roots: the cube root of cos(theta_i) cos(theta_o), shape (P,)."""
        return np.cbrt(self.wi[:, 2] * self.wo[:, 2])


def tabulated_pairs() -> TabulatedPairs:
    """Return the pairs of a page on one side of the plane of incidence; values are the mean of both sides."""
    wi, wo = [], []
    meter_wi, meter_wo, gloss_weights = half_gloss_meter(60)
    spot = from_spherical(np.pi / 4, 0.0)[None], from_spherical(0.0, 0.0)[None]
    for directions in (
        grid_directions(),
        *map(_slice, SLICE_INCIDENCES_DEG),
        (meter_wi, meter_wo),
        spot,
    ):
        wi.append(directions[0])
        wo.append(directions[1])
    sphere_wi = from_spherical(np.deg2rad(REFLECTANCE_INCIDENCE_DEG), 0.0)
    sphere_wo, measure = mirrored_quadrature(sphere_wi, _SPHERE_NODES, _SPHERE_NODES)
    one_side = sphere_wo[:, 1] > 0.0
    sphere_wo = sphere_wo[one_side]
    wi.append(np.broadcast_to(sphere_wi, sphere_wo.shape))
    wo.append(sphere_wo)
    angles = tuple(_slice_angles(incidence) for incidence in SLICE_INCIDENCES_DEG)
    measure = 2.0 * measure[one_side] * sphere_wo[:, 2]
    return TabulatedPairs(np.vstack(wi), np.vstack(wo), angles, gloss_weights, measure, len(wi[0]))


def _slice_angles(incidence_deg: float) -> Array:
    """Return degrees from -85 to 85, dense around the mirror direction."""
    near = incidence_deg + np.arange(-10.0, 10.25, 0.5)
    return np.unique(np.concatenate([np.arange(-85.0, 85.5, 2.5), near]))


def _slice(incidence_deg: float) -> tuple[Array, Array]:
    angles = np.deg2rad(_slice_angles(incidence_deg))
    wo = np.stack([-np.sin(angles), np.zeros_like(angles), np.cos(angles)], axis=1)
    return np.broadcast_to(from_spherical(np.deg2rad(incidence_deg), 0.0), wo.shape), wo
