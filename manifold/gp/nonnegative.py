"""Non-negative least squares from inner products.

The problem is convex, so there is one optimum; most weights are zero at it.
"""

from __future__ import annotations

import numpy as np

from manifold.core.compiled import loops
from manifold.core.defaults import TINY
from manifold.core.errors import ShapeError
from manifold.core.records import Array

_RIDGE = 1e-10  # on a unit diagonal: atoms that are alike leave the Gram matrix singular


def nonnegative_weights(gram: Array, cross: Array) -> Array:
    """Return weights v (R, n) >= 0 that minimise `v gram v - 2 v cross_r` for every row r, of n atoms and R vectors.

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
    weights = np.empty(cross.shape)
    loops.solve_nonnegative(unit, cross / scale, TINY, weights)
    return weights / scale
