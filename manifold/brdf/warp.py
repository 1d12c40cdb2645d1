"""Piecewise-bilinear warps of the unit square: a marginal over rows, then a conditional over columns.

A warp holds one density for each incident azimuth and polar angle, on a grid of R x C nodes over [0, 1]^2; x runs over
columns, y over rows. Between these parameters, both the densities and their cumulative sums are interpolated
linearly, so that `evaluate`, `sample` and `invert` stay consistent.

Source: Dupuy & Jakob 2018, section 4; the interpolation is that of Mitsuba's `Marginal2D`.
"""

from __future__ import annotations

import numpy as np

from manifold.core.compiled import loops
from manifold.core.records import Array
from manifold.core.threads import share_rows

_FEW = 4096  # points of a block: fewer take less time than starting a thread
_DENSITY, _SAMPLE, _INVERT = range(3)  # modes of `map_points`


def interpolate(table: Array, points: Array) -> Array:
    """Return the values of an (R, C) table at points (K, 2) of the unit square, clamped to it, shape (K,)."""
    out = np.empty(len(points))
    loops.interpolate(table, points, out)
    return out


def cumulative_sums(values: Array) -> tuple[Array, Array, Array]:
    """Normalise densities (P, T, R, C) so that each integrates to 1, and compute their cumulative sums.

    Returns the densities (P * T, R, C), their cumulative sums along each row, and the cumulative sums over the rows
    (P * T, R).
    """
    data = values.astype(np.float64).reshape(-1, *values.shape[2:])
    conditional = np.zeros_like(data)
    np.cumsum(0.5 * (data[:, :, :-1] + data[:, :, 1:]), axis=2, out=conditional[:, :, 1:])
    rows = conditional[:, :, -1]
    marginal = np.zeros_like(rows)
    np.cumsum(0.5 * (rows[:, :-1] + rows[:, 1:]), axis=1, out=marginal[:, 1:])
    total = marginal[:, -1]
    return data / total[:, None, None], conditional / total[:, None, None], marginal / total[:, None]


class Warp:
    """A family of densities on the unit square, one for each (phi, theta); each integrates to 1.

    Attributes:
        tables: normalised densities and their cumulative sums, in the form that the compiled loops read.
    """

    def __init__(self, values: Array, phi_nodes: Array, theta_nodes: Array) -> None:
        """Normalise node values (P, T, R, C) and add them up.

        Args:
            values: values at least 0, of which one in each slice is above 0; used in single precision.
            phi_nodes, theta_nodes: in radians, shapes (P,) and (T,).
        """
        self.tables = loops.Warp(values.reshape(-1, *values.shape[2:]), phi_nodes, theta_nodes)

    def _run(self, mode: int, points: Array, phi: Array | float, theta: Array | float) -> Array:
        points = np.asarray(points, dtype=np.float64)
        flat = np.ascontiguousarray(points.reshape(-1, 2))
        shape = points.shape[:-1]
        phi, theta = (
            np.ascontiguousarray(np.broadcast_to(a, shape), float).reshape(-1) for a in (phi, theta)
        )
        out = np.empty((flat.shape[0], 3))
        share_rows(
            lambda k: loops.map_points(mode, self.tables, phi[k], theta[k], flat[k], out[k]), len(flat), _FEW
        )
        return out.reshape(*shape, 3)

    def evaluate(self, points: Array, phi: Array | float = 0.0, theta: Array | float = 0.0) -> Array:
        """Return the density at points (..., 2) of the unit square for parameters in radians, shape (...)."""
        return self._run(_DENSITY, points, phi, theta)[..., 2]

    def sample(
        self, variates: Array, phi: Array | float = 0.0, theta: Array | float = 0.0
    ) -> tuple[Array, Array]:
        """Return points (..., 2) for uniform variates (..., 2), and their densities (...)."""
        out = self._run(_SAMPLE, variates, phi, theta)
        return out[..., :2], out[..., 2]

    def invert(
        self, points: Array, phi: Array | float = 0.0, theta: Array | float = 0.0
    ) -> tuple[Array, Array]:
        """Return the uniform variates (..., 2) that `sample` maps to these points (..., 2), and the densities (...)."""
        out = self._run(_INVERT, points, phi, theta)
        return out[..., :2], out[..., 2]
