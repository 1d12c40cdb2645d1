"""Weighted sums of measured BRDFs, or of their cube roots, evaluated together for each direction pair."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numba as nb
import numpy as np

from manifold.brdf import warp
from manifold.brdf.lookup import FASTMATH
from manifold.brdf.measured import MeasuredBRDF
from manifold.pairs import Pairs, Symmetry, phi_to_u, theta_to_u
from manifold.records import Array

_MAGNITUDE = np.int32(0x7FFFFFFF)
_SIGN = np.int32(~_MAGNITUDE)
# The bits of a single are nearly its logarithm: x^(-1/3) has _START - bits / 3. The constant makes the error
# e = 1 - x r^3 of that guess as large upwards as downwards: 0.102.
_START = np.float32(1419966976.0)
_THIRD = np.float32(1.0 / 3.0)
_ONE = np.float32(1.0)
_E0, _E1, _E2, _E3 = (
    np.float32(c) for c in (0.999998016923318, 0.3333284320755125, 0.22373763441167005, 0.1745595941927751)
)
_TWO_THIRDS = np.float32(2.0 / 3.0)


@nb.njit(cache=True)
def cube_root(x):
    """Signed cube root of a single, within a unit in the last place; exact at zero.

    Holds for zero and normal numbers (1.2e-38 to 3.4e38); what is smaller gives less than 1e-12.

    No division: one step refines the reciprocal root r by a cubic in e (minimax over the guess's error, leaving
    2e-6), one more refines x r^2 to the precision of a single.
    """
    bits = np.float32(x).view(np.int32)
    magnitude = np.int32(bits & _MAGNITUDE)
    a = magnitude.view(np.float32)
    r = np.int32(_START - np.float32(magnitude) * _THIRD).view(np.float32)
    e = _ONE - a * r * (r * r)
    r *= _E0 + e * (_E1 + e * (_E2 + e * _E3))
    y = a * r * r
    e = _ONE - y * r
    y += y * e * _TWO_THIRDS
    return np.int32(np.float32(y).view(np.int32) | (bits & _SIGN)).view(np.float32)


GROUP = 4
"""Materials of one call: more take long to compile, fewer load and store the sums more often."""

_TILE = 32  # direction pairs; 195 bands of sums are 25 kB
_LANES = 16  # rows of values are padded to whole vectors of singles


@nb.njit(**warp.WITHOUT_REFERENCE_COUNTS)
def _are_equal(nodes, others):
    """Whether two grids of one axis are the same."""
    if nodes.shape != others.shape:
        return False
    different = 0
    for k in range(nodes.shape[0]):
        different += nodes[k] != others[k]
    return different == 0


@nb.njit(**warp.WITHOUT_REFERENCE_COUNTS)
def _share_grids(tables, others):
    """Whether two materials have the same grids of incident directions, half vectors, `ndf` and `sigma`."""
    _, ndf, sigma, data, _, _, phi_nodes, theta_nodes, _ = tables
    _, other_ndf, other_sigma, other_data, _, _, other_phi, other_theta, _ = others
    return (
        _are_equal(phi_nodes, other_phi)
        and _are_equal(theta_nodes, other_theta)
        and ndf.shape == other_ndf.shape
        and sigma.shape == other_sigma.shape
        and data.shape == other_data.shape
    )


@nb.njit(**warp.WITHOUT_REFERENCE_COUNTS)
def _locate_tile(located, tables, slices, shares, nodes, offsets):
    """The locations that materials with the same grids share: slices around wi, cells of half vectors, ndf, sigma."""
    _, ndf, sigma, data, _, _, phi_nodes, theta_nodes, _ = tables
    for k in range(located.shape[0]):
        theta_i, phi_i, x, y, cos_o = located[k]
        if cos_o <= 0.0:
            continue
        s, w = warp.blend(phi_nodes, theta_nodes, phi_i, theta_i)
        for q in range(4):
            # A slice without weight is not read: it may hold NaN.
            slices[k, q] = s[q] if w[q] != 0.0 else s[q ^ 1]
            shares[k, q] = w[q]
        nodes[k, 0], offsets[k, 0] = warp.cell(y, data.shape[1])
        nodes[k, 1], offsets[k, 1] = warp.cell(x, data.shape[2])
        nodes[k, 2], offsets[k, 2] = warp.cell(y, ndf.shape[0])
        nodes[k, 3], offsets[k, 3] = warp.cell(x, ndf.shape[1])
        nodes[k, 4], offsets[k, 4] = warp.cell(phi_to_u(phi_i), sigma.shape[0])
        nodes[k, 5], offsets[k, 5] = warp.cell(theta_to_u(theta_i), sigma.shape[1])


@nb.njit(**warp.WITHOUT_REFERENCE_COUNTS, fastmath=FASTMATH)
def _locate_spectra(located, tables, slices, shares, nodes, offsets, cells, corners):
    """Locations in one material's spectra: cells (K, 2), and weights of their corners (K, 4, 4) in each slice."""
    jacobian, ndf, sigma, data, conditional, marginal, _, _, spectra = tables
    for k in range(located.shape[0]):
        cos_o = located[k, 4]
        if cos_o <= 0.0:
            continue
        s = (slices[k, 0], slices[k, 1], slices[k, 2], slices[k, 3])
        w = (shares[k, 0], shares[k, 1], shares[k, 2], shares[k, 3])
        u, v, _ = warp.invert_in_cell(
            data, conditional, marginal, s, w, nodes[k, 0], nodes[k, 1], offsets[k, 0], offsets[k, 1]
        )
        scale = 1.0 / cos_o
        if jacobian:
            scale = warp.bilinear_in_cell(ndf, nodes[k, 2], nodes[k, 3], offsets[k, 2], offsets[k, 3]) / (
                4.0
                * cos_o
                * warp.bilinear_in_cell(sigma, nodes[k, 4], nodes[k, 5], offsets[k, 4], offsets[k, 5])
            )
        i, ty = warp.cell(v, spectra.shape[1])
        j, tx = warp.cell(u, spectra.shape[2])
        cells[k, 0], cells[k, 1] = i, j
        low, high = (1.0 - ty) * scale, ty * scale
        for q in range(4 if w[2] != 0.0 or w[3] != 0.0 else 2):
            corners[k, q, 0], corners[k, q, 1] = w[q] * (low * (1.0 - tx)), w[q] * (low * tx)
            corners[k, q, 2], corners[k, q, 3] = w[q] * (high * (1.0 - tx)), w[q] * (high * tx)


@nb.njit(**warp.WITHOUT_REFERENCE_COUNTS, fastmath=FASTMATH)
def _read(spectra, a, b, i, j, at_a, at_b, is_first, row):
    """Write, or after the first add, what two slices hold in one cell to row (B,)."""
    a00, a01, a10, a11 = at_a[0], at_a[1], at_a[2], at_a[3]
    b00, b01, b10, b11 = at_b[0], at_b[1], at_b[2], at_b[3]
    # One name per row: the compiler then sees eight streams with stride one.
    p00, p01 = spectra[a, i, j], spectra[a, i, j + 1]
    p10, p11 = spectra[a, i + 1, j], spectra[a, i + 1, j + 1]
    q00, q01 = spectra[b, i, j], spectra[b, i, j + 1]
    q10, q11 = spectra[b, i + 1, j], spectra[b, i + 1, j + 1]
    for k in range(spectra.shape[3]):
        value = (a00 * p00[k] + a01 * p01[k] + a10 * p10[k] + a11 * p11[k]) + (
            b00 * q00[k] + b01 * q01[k] + b10 * q10[k] + b11 * q11[k]
        )
        row[k] = value if is_first else row[k] + value


@nb.njit(**warp.WITHOUT_REFERENCE_COUNTS, fastmath=FASTMATH)
def _read_two(spectra, a, b, i, j, at, at_next, row, next_row):
    """`_read` of two pairs in the same cell of the same slices; `at` are weights of corners (4, 4)."""
    a00, a01, a10, a11 = at[0, 0], at[0, 1], at[0, 2], at[0, 3]
    b00, b01, b10, b11 = at[1, 0], at[1, 1], at[1, 2], at[1, 3]
    c00, c01, c10, c11 = at_next[0, 0], at_next[0, 1], at_next[0, 2], at_next[0, 3]
    d00, d01, d10, d11 = at_next[1, 0], at_next[1, 1], at_next[1, 2], at_next[1, 3]
    p00, p01 = spectra[a, i, j], spectra[a, i, j + 1]
    p10, p11 = spectra[a, i + 1, j], spectra[a, i + 1, j + 1]
    q00, q01 = spectra[b, i, j], spectra[b, i, j + 1]
    q10, q11 = spectra[b, i + 1, j], spectra[b, i + 1, j + 1]
    for k in range(spectra.shape[3]):
        row[k] = (a00 * p00[k] + a01 * p01[k] + a10 * p10[k] + a11 * p11[k]) + (
            b00 * q00[k] + b01 * q01[k] + b10 * q10[k] + b11 * q11[k]
        )
        next_row[k] = (c00 * p00[k] + c01 * p01[k] + c10 * p10[k] + c11 * p11[k]) + (
            d00 * q00[k] + d01 * q01[k] + d10 * q10[k] + d11 * q11[k]
        )


@nb.njit(**warp.WITHOUT_REFERENCE_COUNTS, fastmath=FASTMATH)
def _add_row(row, weight, take_root, sums):
    """Add weight times a row, or times its cube roots, to sums, both padded."""
    if take_root:
        for b in range(row.shape[0]):
            sums[b] += weight * cube_root(row[b])
    else:
        for b in range(row.shape[0]):
            sums[b] += weight * row[b]


@nb.njit(**warp.WITHOUT_REFERENCE_COUNTS, fastmath=FASTMATH)
def _add_material(located, spectra, slices, shares, cells, corners, weight, take_root, rows, sums):
    """Add one material, where its spectra are located, to the sums of a tile."""
    k, n = 0, located.shape[0]
    while k < n:
        if located[k, 4] <= 0.0:
            k += 1
            continue
        i, j, a, b = cells[k, 0], cells[k, 1], slices[k, 0], slices[k, 1]
        m, count = k + 1, 1
        is_in_cell = m < n and located[m, 4] > 0.0 and cells[m, 0] == i and cells[m, 1] == j
        if is_in_cell and slices[m, 0] == a and slices[m, 1] == b:
            count = 2
            _read_two(spectra, a, b, i, j, corners[k], corners[m], rows[0], rows[1])
        else:
            _read(spectra, a, b, i, j, corners[k, 0], corners[k, 1], True, rows[0])
        for r in range(count):
            if shares[k, 2] != 0.0 or shares[k, 3] != 0.0:
                _read(spectra, slices[k, 2], slices[k, 3], i, j, corners[k, 2], corners[k, 3], False, rows[r])
            _add_row(rows[r], weight, take_root, sums[k])
            k += 1


@nb.njit(cache=True, nogil=True, fastmath=FASTMATH)
def add_located(located, group, weights, take_root, total):
    """Add the sum of weights f, or of weights times cube roots of f, of K pairs to total (K, B).

    Pairs are as `Pairs.located` gives them, (K, 5); `group` is tables of `GROUP` materials, of the same types, and
    weights are single precision, (GROUP,): a material with none is not read.
    """
    width = -(-total.shape[1] // _LANES) * _LANES
    slices, shares = np.zeros((_TILE, 4), np.int64), np.zeros((_TILE, 4))
    nodes, offsets = np.zeros((_TILE, 6), np.int64), np.zeros((_TILE, 6))
    cells, corners = np.zeros((_TILE, 2), np.int64), np.zeros((_TILE, 4, 4), np.float32)
    rows, sums = np.zeros((2, width), np.float32), np.zeros((_TILE, width), np.float32)
    for start in range(0, located.shape[0], _TILE):
        tile = located[start : start + _TILE]
        sums[:] = 0.0
        known = -1  # material in whose grids the tile is located
        for m in range(len(group)):
            if weights[m] == 0.0:
                continue
            if known < 0 or not _share_grids(group[m], group[known]):
                _locate_tile(tile, group[m], slices, shares, nodes, offsets)
                known = m
            _locate_spectra(tile, group[m], slices, shares, nodes, offsets, cells, corners)
            spectra = group[m][8]
            _add_material(tile, spectra, slices, shares, cells, corners, weights[m], take_root, rows, sums)
        for k in range(tile.shape[0]):
            to, added = total[start + k], sums[k]
            for b in range(to.shape[0]):
                to[b] += added[b]


class WeightedSum:
    """The sum of weight * f of measured materials, or of weight times the signed cube root of f."""

    dtype = np.float32  # of totals

    def __init__(
        self, materials: Sequence[MeasuredBRDF], weights: Sequence[float] | Array, *, cube_root: bool
    ):
        """Prepare a sum of f, or of its cube roots, over materials of the same bands, by weights used in single
        precision.
        """
        self._cube_root = cube_root
        alike: dict[Any, list[tuple[Any, float]]] = {}  # compiled loops take tables of the same types
        for material, weight in zip(materials, weights, strict=True):
            tables = material.tables
            alike.setdefault((material.symmetry, nb.typeof(tables)), []).append((tables, weight))
        self._groups: list[tuple[Symmetry, Any, Array]] = []
        for (symmetry, _), terms in alike.items():
            for first in range(0, len(terms), GROUP):
                group = terms[first : first + GROUP]
                group += [(group[0][0], 0.0)] * (GROUP - len(group))
                tables, shares = zip(*group, strict=True)
                self._groups.append((symmetry, tables, np.array(shares, dtype=np.float32)))

    def add_to(self, total: Array, pairs: Pairs) -> None:
        """Add the sum at K direction pairs to a total (K, B), of `dtype`, C-contiguous, on one core and outside the
        interpreter's lock; pairs below the horizon add nothing.
        """
        for symmetry, tables, weights in self._groups:
            add_located(pairs.located(*symmetry), tables, weights, self._cube_root, total)
