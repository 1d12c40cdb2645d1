"""Piecewise-bilinear warps of the unit square: a marginal over rows, then a conditional over columns.

A warp holds one density per pair of conditional parameters (incident azimuth, incident elevation) on a grid
of R x C nodes over [0, 1]^2; x runs over columns, y over rows. Between parameters the densities *and* their
cumulative sums are blended linearly, so that evaluate, sample and invert stay consistent.

The functions in lower case at module level are compiled and work on one point; `brdf` calls them in its loops.

Source: Dupuy & Jakob 2018, section 4; the interpolation is that of Mitsuba's `Marginal2D`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba as nb
import numpy as np
from numba.core import options

from manifold.records import Array
from manifold.threads import serialised

WITHOUT_REFERENCE_COUNTS: dict[str, Any] = {"cache": True}
if hasattr(options.DefaultOptions, "_nrt"):  # not documented
    WITHOUT_REFERENCE_COUNTS["_nrt"] = False
"""For loops over points: counting references to tables that outlive the loop takes longer than a lookup."""

_FEW = 4096  # points
_FLAT = 1e-4  # relative slope under which a linear density is treated as constant


@nb.njit(cache=True, inline="always")
def _bracket(nodes, value):
    """Index k with nodes[k] <= value < nodes[k + 1], clamped, and the weight of node k + 1."""
    n = nodes.shape[0]
    if n == 1:
        return 0, 0.0
    lo, hi = 0, n - 1
    while hi - lo > 1:
        mid = (lo + hi) // 2
        if nodes[mid] <= value:
            lo = mid
        else:
            hi = mid
    t = (value - nodes[lo]) / (nodes[lo + 1] - nodes[lo])
    return lo, min(max(t, 0.0), 1.0)


@nb.njit(**WITHOUT_REFERENCE_COUNTS)
def blend(phi_nodes, theta_nodes, phi, theta):
    """The four parameter slices around (phi, theta), and their weights.

    Returns slice indices into the flattened (P * T) axis and weights that sum to 1.
    """
    ip, tp = _bracket(phi_nodes, phi)
    it, tt = _bracket(theta_nodes, theta)
    n_theta = theta_nodes.shape[0]
    dp = n_theta if phi_nodes.shape[0] > 1 else 0
    dt = 1 if n_theta > 1 else 0
    k = ip * n_theta + it
    slices = (k, k + dt, k + dp, k + dp + dt)
    weights = ((1 - tp) * (1 - tt), (1 - tp) * tt, tp * (1 - tt), tp * tt)
    return slices, weights


@nb.njit(**WITHOUT_REFERENCE_COUNTS)
def _at2(table, slices, weights, i):
    """Blended entry of a (slices, R) table."""
    v = weights[0] * table[slices[0], i] + weights[1] * table[slices[1], i]
    if weights[2] != 0.0 or weights[3] != 0.0:
        v += weights[2] * table[slices[2], i] + weights[3] * table[slices[3], i]
    return v


@nb.njit(**WITHOUT_REFERENCE_COUNTS)
def _at3(table, slices, weights, i, j):
    """Blended entry of a (slices, R, C) table."""
    v = weights[0] * table[slices[0], i, j] + weights[1] * table[slices[1], i, j]
    if weights[2] != 0.0 or weights[3] != 0.0:
        v += weights[2] * table[slices[2], i, j] + weights[3] * table[slices[3], i, j]
    return v


@nb.njit(cache=True, inline="always")
def cell(coordinate, n):
    """Index of the grid cell that holds a coordinate in [0, 1] on n nodes, and the position inside it."""
    scaled = min(max(coordinate, 0.0), 1.0) * (n - 1)
    i = min(int(scaled), n - 2)
    return i, scaled - i


@nb.njit(**WITHOUT_REFERENCE_COUNTS)
def bilinear_in_cell(table, i, j, ty, tx):
    """Value of an (R, C) table in the cell of rows i, i + 1 and columns j, j + 1, at (tx, ty) in it."""
    return (1 - ty) * ((1 - tx) * table[i, j] + tx * table[i, j + 1]) + ty * (
        (1 - tx) * table[i + 1, j] + tx * table[i + 1, j + 1]
    )


@nb.njit(**WITHOUT_REFERENCE_COUNTS)
def bilinear(table, x, y):
    """Value of an (R, C) table at (x, y) in the unit square, clamped to it."""
    j, tx = cell(x, table.shape[1])
    i, ty = cell(y, table.shape[0])
    return bilinear_in_cell(table, i, j, ty, tx)


@nb.njit(cache=True, nogil=True)
def interpolate(table, points):
    """Values of an (R, C) table at points (K, 2) of the unit square, shape (K,)."""
    out = np.empty(points.shape[0])
    for k in range(points.shape[0]):
        out[k] = bilinear(table, points[k, 0], points[k, 1])
    return out


@nb.njit(**WITHOUT_REFERENCE_COUNTS)
def density(data, slices, weights, x, y):
    """Blended density at (x, y); integrates to 1 over the unit square."""
    n_rows, n_cols = data.shape[1], data.shape[2]
    j, tx = cell(x, n_cols)
    i, ty = cell(y, n_rows)
    c0 = (1 - ty) * _at3(data, slices, weights, i, j) + ty * _at3(data, slices, weights, i + 1, j)
    c1 = (1 - ty) * _at3(data, slices, weights, i, j + 1) + ty * _at3(data, slices, weights, i + 1, j + 1)
    return ((1 - tx) * c0 + tx * c1) * (n_rows - 1) * (n_cols - 1)


@nb.njit(**WITHOUT_REFERENCE_COUNTS)
def invert(data, conditional, marginal, slices, weights, x, y):
    """The uniform variates that `sample` maps to (x, y), and the density there."""
    j, tx = cell(x, data.shape[2])
    i, ty = cell(y, data.shape[1])
    return invert_in_cell(data, conditional, marginal, slices, weights, i, j, ty, tx)


@nb.njit(**WITHOUT_REFERENCE_COUNTS)
def invert_in_cell(data, conditional, marginal, slices, weights, i, j, ty, tx):
    """`invert` at (tx, ty) in the cell of rows i, i + 1 and columns j, j + 1."""
    n_rows, n_cols = data.shape[1], data.shape[2]
    c0 = (1 - ty) * _at3(data, slices, weights, i, j) + ty * _at3(data, slices, weights, i + 1, j)
    c1 = (1 - ty) * _at3(data, slices, weights, i, j + 1) + ty * _at3(data, slices, weights, i + 1, j + 1)
    pdf = ((1 - tx) * c0 + tx * c1) * (n_rows - 1) * (n_cols - 1)

    below = (1 - ty) * _at3(conditional, slices, weights, i, j) + ty * _at3(
        conditional, slices, weights, i + 1, j
    )
    r0 = _at3(conditional, slices, weights, i, n_cols - 1)
    r1 = _at3(conditional, slices, weights, i + 1, n_cols - 1)
    row_total = (1 - ty) * r0 + ty * r1
    u = (tx * (c0 + 0.5 * tx * (c1 - c0)) + below) / row_total if row_total > 0.0 else 0.0
    v = ty * (r0 + 0.5 * ty * (r1 - r0)) + _at2(marginal, slices, weights, i)
    return u, v, pdf


@nb.njit(cache=True, inline="always")
def _invert_linear(f0, f1, area):
    """Position t in [0, 1] where the integral of the line from f0 to f1 over [0, t] is `area`."""
    if abs(f0 - f1) < _FLAT * (f0 + f1) or f0 + f1 <= 0.0:
        t = 2.0 * area / (f0 + f1) if f0 + f1 > 0.0 else 0.0
    else:
        t = (f0 - np.sqrt(max(f0 * f0 - 2.0 * area * (f0 - f1), 0.0))) / (f0 - f1)
    return min(max(t, 0.0), 1.0)


@nb.njit(**WITHOUT_REFERENCE_COUNTS)
def sample(data, conditional, marginal, slices, weights, u, v):
    """The point (x, y) of uniform variates (u, v), and the density there."""
    n_rows, n_cols = data.shape[1], data.shape[2]
    v = min(max(v, 1e-12), 1.0 - 1e-12)
    u = min(max(u, 1e-12), 1.0 - 1e-12)

    lo, hi = 0, n_rows - 1
    while hi - lo > 1:
        mid = (lo + hi) // 2
        if _at2(marginal, slices, weights, mid) < v:
            lo = mid
        else:
            hi = mid
    i = lo
    r0 = _at3(conditional, slices, weights, i, n_cols - 1)
    r1 = _at3(conditional, slices, weights, i + 1, n_cols - 1)
    ty = _invert_linear(r0, r1, v - _at2(marginal, slices, weights, i))

    target = u * ((1 - ty) * r0 + ty * r1)
    lo, hi = 0, n_cols - 1
    while hi - lo > 1:
        mid = (lo + hi) // 2
        reached = (1 - ty) * _at3(conditional, slices, weights, i, mid) + ty * _at3(
            conditional, slices, weights, i + 1, mid
        )
        if reached < target:
            lo = mid
        else:
            hi = mid
    j = lo
    below = (1 - ty) * _at3(conditional, slices, weights, i, j) + ty * _at3(
        conditional, slices, weights, i + 1, j
    )
    c0 = (1 - ty) * _at3(data, slices, weights, i, j) + ty * _at3(data, slices, weights, i + 1, j)
    c1 = (1 - ty) * _at3(data, slices, weights, i, j + 1) + ty * _at3(data, slices, weights, i + 1, j + 1)
    tx = _invert_linear(c0, c1, target - below)
    pdf = ((1 - tx) * c0 + tx * c1) * (n_rows - 1) * (n_cols - 1)
    return (j + tx) / (n_cols - 1), (i + ty) / (n_rows - 1), pdf


@nb.njit(**WITHOUT_REFERENCE_COUNTS)
def _map_point(mode, data, conditional, marginal, phi_nodes, theta_nodes, phi, theta, point, out):
    slices, weights = blend(phi_nodes, theta_nodes, phi, theta)
    x, y = point[0], point[1]
    if mode == 0:
        out[2] = density(data, slices, weights, x, y)
    elif mode == 1:
        out[0], out[1], out[2] = sample(data, conditional, marginal, slices, weights, x, y)
    else:
        out[0], out[1], out[2] = invert(data, conditional, marginal, slices, weights, x, y)


@nb.njit(cache=True, nogil=True)
def _map_few_points(mode, data, conditional, marginal, phi_nodes, theta_nodes, phi, theta, points, out):
    for k in range(points.shape[0]):
        _map_point(
            mode, data, conditional, marginal, phi_nodes, theta_nodes, phi[k], theta[k], points[k], out[k]
        )


@serialised
@nb.njit(cache=True, parallel=True)
def _map_points(mode, data, conditional, marginal, phi_nodes, theta_nodes, phi, theta, points, out):
    for k in nb.prange(points.shape[0]):
        _map_point(
            mode, data, conditional, marginal, phi_nodes, theta_nodes, phi[k], theta[k], points[k], out[k]
        )


@dataclass(frozen=True, eq=False)
class Warp:
    """A family of densities on the unit square, one per (phi, theta), with their cumulative sums.

    Attributes:
        phi_nodes, theta_nodes: conditional parameters in radians, shapes (P,), (T,).
        data: node values scaled so that each slice integrates to 1, shape (P * T, R, C).
        conditional: cumulative sums along each row, shape (P * T, R, C).
        marginal: cumulative sums of the rows, shape (P * T, R).
    """

    phi_nodes: Array
    theta_nodes: Array
    data: Array
    conditional: Array
    marginal: Array

    @classmethod
    def from_values(cls, values: Array, phi_nodes: Array, theta_nodes: Array) -> Warp:
        """Normalise node values of shape (P, T, R, C) and build their cumulative sums.

        Args:
            values: at least 0, and above it somewhere in each slice.
            phi_nodes, theta_nodes: in radians, shapes (P,) and (T,).
        """
        data = values.astype(np.float64).reshape(-1, *values.shape[2:])
        conditional = np.zeros_like(data)
        np.cumsum(0.5 * (data[:, :, :-1] + data[:, :, 1:]), axis=2, out=conditional[:, :, 1:])
        rows = conditional[:, :, -1]
        marginal = np.zeros_like(rows)
        np.cumsum(0.5 * (rows[:, :-1] + rows[:, 1:]), axis=1, out=marginal[:, 1:])
        total = marginal[:, -1]
        return cls(
            np.ascontiguousarray(phi_nodes, dtype=np.float64),
            np.ascontiguousarray(theta_nodes, dtype=np.float64),
            data / total[:, None, None],
            conditional / total[:, None, None],
            marginal / total[:, None],
        )

    def _run(self, mode: int, points: Array, phi: Array | float, theta: Array | float) -> Array:
        points = np.asarray(points, dtype=np.float64)
        flat = np.ascontiguousarray(points.reshape(-1, 2))
        shape = points.shape[:-1]
        # Copies, because a view is read-only, and read-only arrays are another type to compile for.
        phi, theta = (np.broadcast_to(np.asarray(a, float), shape).copy().reshape(-1) for a in (phi, theta))
        out = np.empty((flat.shape[0], 3))
        tables = (self.data, self.conditional, self.marginal, self.phi_nodes, self.theta_nodes)
        # Threads cost more than a few points do, and callers with many such calls have threads of their own.
        run = _map_few_points if len(flat) <= _FEW else _map_points
        run(mode, *tables, phi, theta, flat, out)
        return out.reshape(*shape, 3)

    def evaluate(self, points: Array, phi: Array | float = 0.0, theta: Array | float = 0.0) -> Array:
        """Density at points (..., 2) of the unit square for parameters in radians, shape (...)."""
        return self._run(0, points, phi, theta)[..., 2]

    def sample(
        self, variates: Array, phi: Array | float = 0.0, theta: Array | float = 0.0
    ) -> tuple[Array, Array]:
        """Points (..., 2) for uniform variates (..., 2), and their densities (...)."""
        out = self._run(1, variates, phi, theta)
        return out[..., :2], out[..., 2]

    def invert(
        self, points: Array, phi: Array | float = 0.0, theta: Array | float = 0.0
    ) -> tuple[Array, Array]:
        """Uniform variates (..., 2) that `sample` maps to these points (..., 2), and the densities (...)."""
        out = self._run(2, points, phi, theta)
        return out[..., :2], out[..., 2]
