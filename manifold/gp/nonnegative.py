"""Non-negative least squares from inner products.

The problem is convex, so there is a single optimum, at which most weights are zero.
"""

from __future__ import annotations

import numpy as np

from manifold.core.compiled import loops
from manifold.core.defaults import ROUNDING
from manifold.core.errors import ShapeError
from manifold.core.records import Array

_RIDGE = 1e-10  # on a unit diagonal: atoms that are alike leave the Gram matrix singular


def nonnegative_weights(gram: Array, cross: Array) -> Array:
    """Return weights v (R, n) >= 0 of n atoms that minimise `v gram v - 2 v cross_r` for each of R vectors.

    `gram` (n, n) holds the inner products of the atoms, `cross` (R, n) those of the vectors with the atoms. Each
    vector starts from the atoms of the vector before, because neighbouring bands are similar.

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
    loops.solve_nonnegative(unit, cross / scale, ROUNDING, weights)
    return weights / scale
