"""The direction pairs that a page tabulates: a grid of half and difference angles without pairs below the horizon.

A page interpolates on the grid to light a ball from anywhere. Plots and reflectances use pairs of their own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from manifold.brdf.plausibility import mirrored_quadrature
from manifold.completion.gloss import RECEPTORS_DEG, SOURCE_DEG, gloss_meter
from manifold.directions import from_rusinkiewicz, from_spherical, normalize
from manifold.model.decoding import REFLECTANCE_INCIDENCE_DEG
from manifold.records import Array

SLICE_INCIDENCES_DEG = (20.0, 40.0, 60.0)
GLOSS_DEG = 60
_GLOSS_NODES = (19, 12)  # in the plane of incidence, and across on one side
_SPHERE_NODES = 20  # in elevation and in azimuth


@dataclass(frozen=True)
class AngleGrid:
    """Nodes over theta_h, theta_d and phi_d in [0, 180] degrees; phi_d runs fastest.

    theta_d is given as a share of the largest at which both directions are above the horizon, so that the whole grid
    can be looked up: `tan(theta_d) = 1 / (tan(theta_h) |cos(phi_d)|)` there.

    Attributes:
        n_theta_h, n_theta_d, n_phi_d: nodes per angle, both ends included.
        theta_h_max_rad: last theta_h.
        theta_h_power: theta_h goes with this power of its index, dense around the mirror direction.
        theta_d_share: last share of theta_d.
    """

    n_theta_h: int = 45
    n_theta_d: int = 23
    n_phi_d: int = 12
    theta_h_max_rad: float = float(np.deg2rad(89.0))
    theta_h_power: float = 2.5
    theta_d_share: float = 0.995

    @property
    def shape(self) -> tuple[int, int, int]:
        """Nodes per angle."""
        return self.n_theta_h, self.n_theta_d, self.n_phi_d

    def directions(self) -> tuple[Array, Array]:
        """wi and wo of all nodes, shape (P, 3) each."""
        h, d, p = (np.arange(n) / (n - 1) for n in self.shape)
        theta_h, share, phi_d = (
            a.ravel()
            for a in np.meshgrid(
                h**self.theta_h_power * self.theta_h_max_rad, d * self.theta_d_share, p * np.pi, indexing="ij"
            )
        )
        return from_rusinkiewicz(theta_h, share * largest_theta_d(theta_h, phi_d), phi_d)

    def coordinates(self, theta_h: Array, theta_d: Array, phi_d: Array) -> tuple[Array, Array, Array]:
        """Positions of pairs on the grid, in nodes along each axis: the inverse of `directions`, angles in radians."""
        phi_d = np.abs(phi_d)
        h = np.clip(theta_h / self.theta_h_max_rad, 0.0, 1.0) ** (1.0 / self.theta_h_power)
        d = np.clip(theta_d / largest_theta_d(theta_h, phi_d) / self.theta_d_share, 0.0, 1.0)
        return h * (self.n_theta_h - 1), d * (self.n_theta_d - 1), phi_d / np.pi * (self.n_phi_d - 1)


def largest_theta_d(theta_h: Array, phi_d: Array) -> Array:
    """theta_d at which one of the directions reaches the horizon, in radians."""
    return np.asarray(np.arctan2(1.0, np.tan(theta_h) * np.abs(np.cos(phi_d))))


@dataclass(frozen=True, eq=False)
class TabulatedPairs:
    """All pairs of a page: of the grid, then of the slices, of the gloss meter, 45/0, and of the integrating sphere.

    Attributes:
        wi, wo: unit vectors, shape (P, 3).
        slice_angles_deg: of wo from the normal, towards the mirror direction, per incidence.
        gloss_weights: gloss units per 1/sr at the pairs of the gloss meter.
        sphere_measure: what makes a reflectance of values at the last pairs.
        n_grid: pairs of the grid.
    """

    wi: Array
    wo: Array
    slice_angles_deg: tuple[Array, ...]
    gloss_weights: Array
    sphere_measure: Array
    n_grid: int

    @property
    def amplitude(self) -> Array:
        """Cube roots of cos(theta_i) cos(theta_o), shape (P,): values are tabulated times that."""
        return np.cbrt(self.wi[:, 2] * self.wo[:, 2])


def tabulated_pairs(grid: AngleGrid) -> TabulatedPairs:
    """The pairs of a page, mirror images left out: materials are tabulated as the mean of both sides."""
    wi, wo = [], []
    *gloss, gloss_weights = _gloss_meter()
    spot = from_spherical(np.pi / 4, 0.0)[None], from_spherical(0.0, 0.0)[None]
    for directions in (grid.directions(), *map(_slice, SLICE_INCIDENCES_DEG), gloss, spot):
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


def _gloss_meter() -> tuple[Array, Array, Array]:
    """Pairs of the gloss meter at 60 degrees, on one side of the plane of incidence, and gloss units per 1/sr at each.

    All have the light at the centre of the source: that the source is wide is in the weights, as the wider receptor.
    """
    theta, (half_in, half_across) = np.deg2rad(GLOSS_DEG), 0.5 * np.deg2rad(RECEPTORS_DEG[GLOSS_DEG])
    source_in, source_across = 0.5 * np.deg2rad(SOURCE_DEG)
    n_in, n_across = _GLOSS_NODES
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
    weights = 100.0 * seen * cell * wo[:, 2] / gloss_meter(GLOSS_DEG).full_scale
    return np.broadcast_to(from_spherical(theta, np.pi), wo.shape), wo, weights


def _slice_angles(incidence_deg: float) -> Array:
    """Degrees from -85 to 85, dense around the mirror direction."""
    near = incidence_deg + np.arange(-10.0, 10.25, 0.5)
    return np.unique(np.concatenate([np.arange(-85.0, 85.5, 2.5), near]))


def _slice(incidence_deg: float) -> tuple[Array, Array]:
    angles = np.deg2rad(_slice_angles(incidence_deg))
    wo = np.stack([-np.sin(angles), np.zeros_like(angles), np.cos(angles)], axis=1)
    return np.broadcast_to(from_spherical(np.deg2rad(incidence_deg), 0.0), wo.shape), wo
