"""Places inside a map, at which tests and benchmarks look."""

from __future__ import annotations

import numpy as np
import scipy

from manifold.core.records import Array


def inside_hull(X: Array, count: int, rng: np.random.Generator) -> Array:
    """Return shares (K, N) of the samples around `count` places drawn uniformly from the hull of X (N, Q).

    A flat hull has no such places, and K is 0.
    """
    N, Q = X.shape
    try:
        simplices = np.sort(scipy.spatial.Delaunay(X).simplices, axis=1)  # [S, Q + 1]
    except (scipy.spatial.QhullError, ValueError):  # one dimension, too few samples, or all in a plane
        return np.zeros((0, N))
    simplices = simplices[np.lexsort(simplices.T)]  # sorted: the order does not depend on rounding
    volume = np.abs(np.linalg.det(X[simplices[:, 1:]] - X[simplices[:, :1]]))
    around = simplices[rng.choice(len(simplices), count, p=volume / volume.sum())]
    shares = np.zeros((count, N))
    np.put_along_axis(shares, around, rng.dirichlet(np.ones(Q + 1), count), axis=1)
    return shares
