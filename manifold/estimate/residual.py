"""Interpolates the residual at readings to nearby directions by a Gaussian process.

Non-negative combinations of atoms cannot fit every BRDF; with many readings, a residual remains that is similar at
neighbouring readings. It is applied as a factor on the cube roots, so that they stay non-negative.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from manifold.brdf.interface import BRDF
from manifold.brdf.wrapper import WrappedBRDF
from manifold.core.defaults import RIDGE, TINY
from manifold.core.directions import half_vector
from manifold.core.records import Array, Indices

# Multiplied or divided by 1.5, _LENGTHS and _CELL change the geometric mean of errors of left-out completions by at
# most 2 %, the other constants by at most 0.3 % (`tools/constants.py estimate.residual`).
NOISE = 0.3
"""Variance of the independent part of each reading's residual, over that of the part shared with neighbours."""

DARK = 0.1
"""Share of the mean reading below which differences are relative to this share, not to the reading itself."""

_OWN = 0.4  # length of what a reading has for itself, over the others


_LENGTHS = np.array([0.12, 0.3, 0.3])  # correlation lengths of the three coordinates
_MOST = 0.5  # relative residual: larger ones come from a wrong mixture, and say nothing of nearby directions
_CELL = 0.5  # width of a cell, whose readings are averaged, in correlation lengths
_MOST_CELLS = 256
_NOT_RECIPROCAL = 3.0  # standard deviations, the usual limit
_BLOCK = 4096  # direction pairs at a time


@dataclass(frozen=True, eq=False)
class ResidualFactors:
    """Factors of cube roots at any direction pair.

    Attributes:
        centres: coordinates of C readings or averages of readings, shape (C, 3).
        strength: weight of each centre in every band, shape (B, C).
        not_reciprocal: relative difference of values at neighbouring directions of different incidences, if their
            distance and noise do not explain it; otherwise 0.
    """

    centres: Array
    strength: Array
    not_reciprocal: float = 0.0

    def at(self, where: Array) -> Array:
        """Return the factors (B, M), between 1/2 and 2, at coordinates (M, 3)."""
        change = np.empty((len(self.strength), len(where)))
        for start in range(0, len(where), _BLOCK):
            rows = slice(start, start + _BLOCK)
            change[:, rows] = self.strength @ _with_own(self.centres, where[rows])
        return np.clip(1.0 + change, 0.5, 2.0)


class AdjustedBRDF(WrappedBRDF):
    """A BRDF whose cube roots are multiplied by `ResidualFactors`; sampling ignores the factors."""

    _albedo_nodes: ClassVar[int] = 48  # as of predictions

    def __init__(self, brdf: BRDF, factors: ResidualFactors):
        """Wrap a BRDF; the factors are in its bands."""
        super().__init__(brdf)
        self._factors = factors

    def eval(self, wi: Array, wo: Array) -> Array:
        """Return f in 1/sr, shape (..., B); arguments and errors as in the wrapped BRDF."""
        f = self._brdf.eval(wi, wo)
        wi, wo = np.broadcast_arrays(np.asarray(wi, np.float64), np.asarray(wo, np.float64))
        factors = self._factors.at(coordinates(wi.reshape(-1, 3), wo.reshape(-1, 3)))
        return np.asarray(f * factors.T.reshape(f.shape) ** 3)


def coordinates(wi: Array, wo: Array) -> Array:
    """Return coordinates of direction pairs (P, 3) in units of the correlation length, shape (P, 3).

    The coordinates are the square root of the half vector's polar angle, the difference angle, and the difference of
    the two cosines. Pairs at which every isotropic, reciprocal, bilaterally symmetric material has the same value
    have the same coordinates.
    """
    half = half_vector(wi, wo)
    elevation, difference = (
        np.arccos(np.clip(c, -1.0, 1.0)) for c in (half[..., 2], np.sum(wi * half, axis=-1))
    )
    lower = np.abs(wi[..., 2] - wo[..., 2])
    return np.asarray(np.stack([np.sqrt(elevation), difference, lower], axis=-1) / _LENGTHS)


def residual_factors(
    measured: Array,
    predicted: Array,
    where: Array,
    incidences_deg: Array,
    weights: Array,
    repeatability: float,
) -> ResidualFactors:
    """Return the factors by which measured cube roots (B, P) at coordinates (P, 3) differ from their prediction.

    NaN marks missing readings; `incidences_deg` (P,) are their incidences.

    The corrected values match the readings, with weights (P,), within the repeatability: the relative standard
    deviation of repeated readings (that of cube roots is a third of it). If neighbouring readings scatter more, their
    scatter is used.

    Source: Rasmussen & Williams 2006, eq. 2.25; the kernel is squared exponential.
    """
    cell = cells(where)
    count = int(cell.max()) + 1
    residual = (measured - predicted) / np.maximum(predicted, DARK * predicted.mean(axis=1, keepdims=True))
    residual = np.clip(residual, -_MOST, _MOST)  # 0 / 0 is NaN, which is left out: no factor changes black
    is_known = np.isfinite(residual) & (weights > 0.0)
    totals, sums = (
        np.array([np.bincount(cell, row, count) for row in rows])
        for rows in (is_known * weights, np.where(is_known, residual, 0.0) * weights)
    )
    shares = weights + np.finfo(float).tiny
    of_cell = np.bincount(cell, shares, count)
    centres = np.array([np.bincount(cell, shares * axis, count) for axis in where.T]).T / of_cell[:, None]
    noise = _noise(np.where(is_known, residual, 0.0), is_known * weights, sums, totals, repeatability)
    of_centres = _with_own(centres, centres)
    is_same = _same_incidence(cell, shares / of_cell[cell], incidences_deg)
    is_near = np.triu((covariance(centres, centres) > np.exp(-0.5 * _CELL**2)) & (is_same < 0.5), 1)
    not_reciprocal = _not_reciprocal(sums, totals, noise, of_centres, np.argwhere(is_near).T)
    strength = np.zeros((len(measured), count))
    for mask in np.unique(totals, axis=0):
        used, rows = np.flatnonzero(mask > 0.0), np.flatnonzero((totals == mask).all(axis=1))
        K = of_centres[np.ix_(used, used)] + np.diag(noise / mask[used])
        strength[np.ix_(rows, used)] = np.linalg.solve(K, (sums[np.ix_(rows, used)] / mask[used]).T).T
    return ResidualFactors(centres, strength, not_reciprocal)


def _same_incidence(cell: Indices, shares: Array, incidences_deg: Array) -> Array:
    """Return the share of pairs of readings of two cells that have the same incidence, to a degree, shape (C, C).

    Readings are in cells (P,), of which each is a share (P,).
    """
    _, incidence = np.unique(np.round(incidences_deg), return_inverse=True)
    of_cells = np.zeros((int(cell.max()) + 1, int(incidence.max()) + 1))
    np.add.at(of_cells, (cell, incidence), shares)
    return np.asarray(of_cells @ of_cells.T)


def _not_reciprocal(sums: Array, totals: Array, noise: float, K: Array, pairs: Indices) -> float:
    """Return the relative difference of values in pairs of near cells of different incidences, indices (2, M).

    It is 0 unless the residuals differ by more than `_NOT_RECIPROCAL` of what their distance and the noise explain.
    Sums of residuals over cells and of their weights have shape (B, C); K (C, C) is the covariance of their means
    over the variance of the shared part.
    """
    is_read = totals > 0.0
    means = np.divide(sums, totals, out=np.zeros_like(sums), where=is_read)
    both = is_read[:, pairs[0]] & is_read[:, pairs[1]]  # [B, M]
    if not both.any():
        return 0.0
    variance = max(float(np.sum(means**2) / is_read.sum() / K[0, 0]), TINY**2)
    expected = (K[0, 0] - K[pairs[0], pairs[1]] + noise)[None].repeat(len(means), axis=0)[both]
    squared = (means[:, pairs[0]] - means[:, pairs[1]])[both] ** 2
    if np.mean(0.5 * squared / variance / expected) <= _NOT_RECIPROCAL**2:
        return 0.0
    return 3.0 * float(np.sqrt(np.mean(squared)))  # of values, not of their cube roots


def _with_own(a: Array, b: Array) -> Array:
    """Return the covariance of the residuals at coordinates (C, 3) and (M, 3): shared and own parts."""
    return covariance(a, b) + NOISE * covariance(a / _OWN, b / _OWN)


def _noise(residual: Array, weights: Array, sums: Array, totals: Array, repeatability: float) -> float:
    """Return the variance of readings' noise as a share of the residual's variance.

    If the readings within a cell vary more, their variance is used. `residual` and `weights` belong to the readings
    (B, P); `sums` and `totals` are their sums over the cells (B, C).
    """
    tiny = np.finfo(float).tiny
    total = max(float(totals.sum()), tiny)
    between = float(np.sum(sums**2 / np.maximum(totals, tiny))) / total
    within = max(float(np.sum(weights * residual**2)) / total - between, 0.0)
    return float(np.clip(max((repeatability / 3.0) ** 2, within) / max(between, tiny), RIDGE, 1.0))


def covariance(a: Array, b: Array) -> Array:
    """Return the covariance (C, M) of the residuals at coordinates (C, 3) and (M, 3), with variance 1."""
    square = np.sum(a**2, axis=1)[:, None] + np.sum(b**2, axis=1) - 2.0 * a @ b.T
    return np.asarray(np.exp(-0.5 * np.maximum(square, 0.0)))


def cells(where: Array) -> Indices:
    """Return the index of the cell of each of the coordinates (P, 3), shape (P,).

    Cells are half a correlation length wide, or wider so that there are at most 256.
    """
    width = _CELL
    while True:
        _, cell = np.unique(np.floor(where / width), axis=0, return_inverse=True)
        if cell.max() < _MOST_CELLS:
            return np.asarray(cell).ravel()
        width *= 2.0
