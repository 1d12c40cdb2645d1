"""Evaluates, inverts and samples the warps of `manifold.brdf.warp` in packed tables, on Dr.Jit arrays.

Functions take the modules `mi` and `dr` of the current variant; arrays have one entry per lane.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from manifold.render.plugin.packed_tables import WARP_VALUES

_FLAT = 1e-4  # relative slope under which a linear density is treated as constant, as in `manifold.brdf.warp`


@dataclass(frozen=True, eq=False)
class Family:
    """One warp per lane: where its cells and its marginal begin in memory, and its numbers of rows and columns."""

    cells: Any
    marginals: Any
    rows: Any
    columns: Any


@dataclass(frozen=True, eq=False)
class Slices:
    """The densities around an incident direction, for each lane: two polar angles at one or two azimuths.

    Attributes:
        at: for each azimuth, the index of the packet of both polar angles, and the two indices of the polar angles.
        t: weight of the second polar angle.
        s: weight of the second azimuth.
    """

    at: list[tuple[Any, Any, Any]]
    t: Any
    s: Any


def bisect(mi: Any, dr: Any, n: Any, n_steps: int, is_below: Any) -> tuple[Any, Any]:
    """Return the last index below n - 1 at which `is_below` holds, or 0, and the next index."""
    low, high = mi.UInt32(0), mi.UInt32(n - 1)
    for _ in range(n_steps):
        middle = (low + high) >> 1
        is_open = high - low > 1
        holds = is_below(middle)
        low = dr.select(is_open & holds, middle, low)
        high = dr.select(is_open & ~holds, middle, high)
    return low, high


class PackedWarps:
    """Warps in packed tables; see `packed_tables.PackedTables`."""

    def __init__(self, mi: Any, dr: Any, warps: Any, marginals: Any, most_nodes: int) -> None:
        """Take the flat Dr.Jit arrays of cells and marginals."""
        self._mi, self._dr = mi, dr
        self._warps, self._marginals = warps, marginals
        self._n_steps = max(1, (most_nodes - 1).bit_length())

    def cell(self, x: Any, n: Any) -> tuple[Any, Any]:
        """Return the index of the cell of n nodes that contains x in [0, 1], and the position in it, 0 to 1."""
        mi, dr = self._mi, self._dr
        scaled = dr.clip(x, 0.0, 1.0) * mi.Float(n - 1)
        i = dr.minimum(mi.UInt32(scaled), n - 2)
        return i, scaled - mi.Float(i)

    def _between_azimuths(self, slices: Slices, values: list[Any]) -> Any:
        """Return values at the one azimuth, or interpolated between the two."""
        return values[0] if len(values) == 1 else self._dr.lerp(*values, slices.s)

    def _indices(self, family: Family, slices: Slices, i: Any, j: Any) -> list[Any]:
        """Return the packet numbers of a cell, each with both polar angles."""
        return [
            family.cells + (pair * (family.rows - 1) + i) * (family.columns - 1) + j
            for pair, _, _ in slices.at
        ]

    def _marginal(self, family: Family, slices: Slices, i: Any, active: Any) -> Any:
        dr, mi = self._dr, self._mi

        def gather(k: Any) -> Any:
            return dr.gather(mi.Float, self._marginals, family.marginals + k * family.rows + i, active)

        return self._between_azimuths(
            slices, [dr.lerp(gather(low), gather(high), slices.t) for _, low, high in slices.at]
        )

    def _blended(self, family: Family, slices: Slices, i: Any, j: Any, active: Any) -> list[Any]:
        """Return the values of a cell at the incident direction; see `packed_tables.WARP_VALUES`."""
        packets = [
            self._dr.gather(
                self._mi.ArrayXf, self._warps, n, active, shape=(2 * WARP_VALUES, self._dr.width(n))
            )
            for n in self._indices(family, slices, i, j)
        ]
        return [
            self._between_azimuths(
                slices, [self._dr.lerp(packet[k], packet[WARP_VALUES + k], slices.t) for packet in packets]
            )
            for k in range(WARP_VALUES)
        ]

    def invert(self, family: Family, slices: Slices, x: Any, y: Any, active: Any) -> tuple[Any, Any, Any]:
        """Return the variates that `sample` maps to (x, y), and the density there."""
        dr, mi = self._dr, self._mi
        j, tx = self.cell(x, family.columns)
        i, ty = self.cell(y, family.rows)
        d00, d01, d10, d11, b0, b1, r0, r1 = self._blended(family, slices, i, j, active)
        c0, c1 = dr.lerp(d00, d10, ty), dr.lerp(d01, d11, ty)
        density = dr.lerp(c0, c1, tx) * mi.Float((family.rows - 1) * (family.columns - 1))
        total = dr.lerp(r0, r1, ty)
        u = (tx * (c0 + 0.5 * tx * (c1 - c0)) + dr.lerp(b0, b1, ty)) / total
        v = ty * (r0 + 0.5 * ty * (r1 - r0)) + self._marginal(family, slices, i, active)
        return dr.select(total > 0.0, u, 0.0), v, density

    def density(self, family: Family, slices: Slices, x: Any, y: Any, active: Any) -> Any:
        """Return the density at (x, y), which integrates to 1 over the unit square."""
        dr, mi = self._dr, self._mi
        j, tx = self.cell(x, family.columns)
        i, ty = self.cell(y, family.rows)
        corners = []
        for index in self._indices(family, slices, i, j):
            first = 2 * WARP_VALUES // 4 * index  # corners are the first of each half
            a, b = (dr.gather(mi.Vector4f, self._warps, first + k, active) for k in (0, WARP_VALUES // 4))
            corners.append(dr.lerp(a, b, slices.t))
        d = self._between_azimuths(slices, corners)
        value = dr.lerp(dr.lerp(d.x, d.y, tx), dr.lerp(d.z, d.w, tx), ty)
        return value * mi.Float((family.rows - 1) * (family.columns - 1))

    def sample(self, family: Family, slices: Slices, u: Any, v: Any, active: Any) -> tuple[Any, Any]:
        """Return the point (x, y) to which uniform variates (u, v) are mapped."""
        dr, mi = self._dr, self._mi
        u, v = dr.clip(u, 1e-7, 1.0 - 1e-7), dr.clip(v, 1e-7, 1.0 - 1e-7)
        i = self._below(family.rows, v, lambda m: self._marginal(family, slices, m, active))
        first = self._blended(family, slices, i, mi.UInt32(0), active)
        r0, r1 = first[6], first[7]
        ty = self._invert_linear(r0, r1, v - self._marginal(family, slices, i, active))
        target = u * dr.lerp(r0, r1, ty)

        def reached(m: Any) -> Any:
            packet = self._blended(family, slices, i, m, active)
            return dr.lerp(packet[4], packet[5], ty)

        j = self._below(family.columns, target, reached)
        d00, d01, d10, d11, b0, b1, _r0, _r1 = self._blended(family, slices, i, j, active)
        c0, c1 = dr.lerp(d00, d10, ty), dr.lerp(d01, d11, ty)
        tx = self._invert_linear(c0, c1, target - dr.lerp(b0, b1, ty))
        x = (mi.Float(j) + tx) / mi.Float(family.columns - 1)
        y = (mi.Float(i) + ty) / mi.Float(family.rows - 1)
        return x, y

    def _below(self, n: Any, value: Any, at: Any) -> Any:
        """Return the last index below n - 1 at which an increasing function is still below a value."""
        return bisect(self._mi, self._dr, n, self._n_steps, lambda m: at(m) < value)[0]

    def _invert_linear(self, f0: Any, f1: Any, area: Any) -> Any:
        """Return the position t in [0, 1] where the integral of the line from f0 to f1 over [0, t] is `area`."""
        dr = self._dr
        total, fall = f0 + f1, f0 - f1
        is_flat = (dr.abs(fall) < _FLAT * total) | (total <= 0.0)
        flat = dr.select(total > 0.0, 2.0 * area / total, 0.0)
        steep = (f0 - dr.sqrt(dr.maximum(f0 * f0 - 2.0 * area * fall, 0.0))) / fall
        return dr.clip(dr.select(is_flat, flat, steep), 0.0, 1.0)
