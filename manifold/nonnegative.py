"""Non-negative least squares from inner products alone.

The problem is convex, so there is one optimum; most weights are zero at it.
"""

from __future__ import annotations

import numba as nb
import numpy as np

from manifold.errors import ShapeError
from manifold.records import Array, Indices, Mask

_RIDGE = 1e-10  # on a unit diagonal: atoms that are alike leave the Gram matrix singular
_TOLERANCE = 1e-9  # smallest slope, relative to the largest inner product


def nonnegative_weights(gram: Array, cross: Array) -> Array:
    """Weights v (R, n) >= 0 that minimise `v gram v - 2 v cross_r` for every row r, of n atoms and R vectors.

    Rows are solved in order, each starting from the atoms that the one before uses: neighbouring bands are alike. Inner
    products are `gram` (n, n) of atoms, `cross` (R, n) of vectors with them.

    >>> nonnegative_weights(np.eye(2), np.array([[0.5, -1.0]])).round(6)
    array([[0.5, 0. ]])

    Source: Lawson & Hanson 1974, "Solving Least Squares Problems", chapter 23; Bro & De Jong 1997 (normal equations).
    """
    n = len(gram)
    if not (np.all(np.isfinite(gram)) and np.all(np.isfinite(cross))):
        raise ShapeError("gram or cross is not finite, expected inner products; drop atoms that are not")
    scale = np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
    unit = gram / scale[:, None] / scale
    unit[np.diag_indices(n)] = 1.0 + _RIDGE
    return np.asarray(_solve_rows(unit, np.ascontiguousarray(cross / scale)) / scale)


@nb.njit(cache=True)
def _solve_rows(gram: Array, cross: Array) -> Array:
    rows, n = cross.shape
    weights = np.zeros((rows, n))
    used = np.empty(n, np.int64)
    count = int(np.int64(0))  # a literal would be a type of its own, compiled for apart
    for r in range(rows):
        count = _warm_start(gram, cross[r], used, count, weights[r])
        _active_set(gram, cross[r], used, count, weights[r])
        count = int(np.int64(0))
        for k in range(n):
            if weights[r, k] > 0.0:
                used[count] = k
                count += 1
    return weights


@nb.njit(cache=True)
def _solve_on(gram: Array, cross: Array, used: Indices, count: int) -> Array:
    """Least squares on the atoms used, signs free."""
    A, y = np.empty((count, count)), np.empty(count)
    for a in range(count):
        y[a] = cross[used[a]]
        for b in range(count):
            A[a, b] = gram[used[a], used[b]]
    return np.asarray(np.linalg.solve(A, y), np.float64)


@nb.njit(cache=True)
def _warm_start(gram: Array, cross: Array, used: Indices, count: int, weights: Array) -> int:
    """Drop atoms of negative weight until the solution on those used is feasible; how many are left."""
    while count > 0:
        solution = _solve_on(gram, cross, used, count)
        kept = 0
        for a in range(count):
            if solution[a] > 0.0:
                used[kept] = used[a]
                kept += 1
        if kept == count:
            for a in range(count):
                weights[used[a]] = solution[a]
            return count
        count = kept
    return 0


@nb.njit(cache=True)
def _active_set(gram: Array, cross: Array, used: Indices, count: int, weights: Array) -> None:
    """Add the atom of steepest slope until none reduces the residual, from a feasible solution on those used."""
    n = cross.size
    limit = _TOLERANCE * np.max(np.abs(cross))
    refused = np.zeros(n, np.bool_)
    for _ in range(5 * n):
        enter = _steepest(gram, cross, used, count, weights, refused, limit)
        if enter < 0:
            return
        used[count] = enter
        solution = _solve_on(gram, cross, used, count + 1)
        if solution[count] <= 0.0:  # its slope was rounding
            refused[enter] = True
            continue
        count += 1
        while count > 0 and solution.min() <= 0.0:
            count = _step_back(used, count, weights, solution)
            if count > 0:
                solution = _solve_on(gram, cross, used, count)
        for a in range(count):
            weights[used[a]] = solution[a]


@nb.njit(cache=True)
def _steepest(
    gram: Array,
    cross: Array,
    used: Indices,
    count: int,
    weights: Array,
    refused: Mask,
    limit: float,
) -> int:
    """The unused atom of steepest slope above the limit, or -1."""
    slope = cross.copy()
    for a in range(count):
        slope -= weights[used[a]] * gram[used[a]]
        slope[used[a]] = -np.inf
    enter, best = -1, limit
    for k in range(cross.size):
        if slope[k] > best and not refused[k]:
            enter, best = k, slope[k]
    return enter


@nb.njit(cache=True)
def _step_back(used: Indices, count: int, weights: Array, solution: Array) -> int:
    """Go towards a solution until the first weight is zero, and drop it; how many are left."""
    step, first = 1.0, -1
    for a in range(count):
        if solution[a] <= 0.0:
            w = weights[used[a]]
            share = w / max(w - solution[a], 1e-300)
            if first < 0 or share < step:
                step, first = share, a
    kept = 0
    for a in range(count):
        k = used[a]
        weights[k] += step * (solution[a] - weights[k])
        if a == first or weights[k] <= 0.0:
            weights[k] = 0.0
        else:
            used[kept] = k
            kept += 1
    return kept
