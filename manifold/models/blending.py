"""Blends: weights that are never negative, sum to 1, and are a unit vector at each sample; their layout.

A Gaussian process interpolates with weights of alternating sign, which cause dark holes in highlights. The values of a
blend lie between those of the surrounding materials, and change as smoothly as its weights. It needs a layout in which
neighbours have a similar appearance, and their blends look like materials.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.spatial import ConvexHull, Delaunay, QhullError
from scipy.spatial.distance import cdist

from manifold.errors import ShapeError
from manifold.records import Array

_NEGLIGIBLE = 1e-6  # relative to the largest weight: smaller ones are invisible, and cost a look-up each
_RANDOM_STARTS = 3
_REFINED = 2  # starts that are refined with the cost of blends
_PLACES, _PLACES_OF_EACH = 1500, 75  # number of blends evaluated: at most, and per sample
_MOST_BLENDED = 4  # samples of a convex combination
_ROUNDS = 2  # of the last refinement, each at new places inside the hull
_STRENGTH = 3.0  # weight of implausible blends against stress
_SEPARATION = 10.0  # weight of the least distances against stress
_RADIUS = 0.9  # of the kernel, in sides of a sample's share of the convex hull
_NEAREST = 2.5  # length scales between neighbours, at most, in the median: in many dimensions the hull is all but flat
_ITERATIONS = 300

Cost = Callable[[Array], tuple[Array, Array]]
"""From weights u (K, N) of blends to their cost (K,) and its gradient by u (K, N)."""


@dataclass(frozen=True, eq=False)
class Layout:
    """Places of N samples.

    Attributes:
        X: shape (N, Q).
        objective_start, objective: objective at the principal coordinates and at the end.
    """

    X: Array
    objective_start: float
    objective: float


def blend_weights(x: Array, X: Array, length_scale: float = 1.0) -> Array:
    """Weights u of the samples at places x, never negative and of sum 1, shape (M, N).

    `u_i ~ exp(-d_i^2 / (2 l^2)) / d_i^2`: a unit vector at a sample, continuous, with a slope of 0 at the samples.

    Args:
        x: places, shape (M, Q).
        X: samples, shape (N, Q).
        length_scale: l.
    Source: Shepard 1968, with the squared exponential in place of his cut-off.
    """
    squared = cdist(x, X, "sqeuclidean") / length_scale**2
    with np.errstate(divide="ignore"):
        log = -0.5 * squared - np.log(squared)
    is_sample = np.isposinf(log)
    log = np.where(is_sample.any(axis=1, keepdims=True), np.where(is_sample, 0.0, -np.inf), log)
    u = np.exp(log - log.max(axis=1, keepdims=True))
    u = np.maximum(u - _NEGLIGIBLE, 0.0)  # continuous where a weight vanishes
    return u / u.sum(axis=1, keepdims=True)


def widest_gap(X: Array) -> float:
    """The largest distance of a sample of X (N, Q) from its nearest other one; infinity for a single sample."""
    return float(_gaps(X).max())


def _gaps(X: Array) -> Array:
    """The distance of every sample of X (N, Q) from its nearest other one, shape (N,)."""
    apart = cdist(X, X)
    np.fill_diagonal(apart, np.inf)
    return np.asarray(apart.min(axis=1))


def blend_layout(
    distance: Array, separation: Array, implausible: Array, n_components: int, cost: Cost | None = None
) -> Layout:
    """Places of N samples, in length scales of `blend_weights`, centred.

    Minimises the relative stress `sum (d_ij - distance_ij)^2 / distance_ij`, plus the squares by which distances fall
    short of `separation`, plus the mean of `u^T implausible u` over blends u inside the convex hull, from principal
    coordinates and a few random starts; then, from the best end, with the mean of `cost(u)` added, at places drawn
    uniformly from the present hull. The unit is then chosen so that a kernel of length scale 1 spans about the side of
    a sample's share of the hull, and reaches neighbours.

    Args:
        distance: target distances, shape (N, N), positive off the diagonal.
        separation: least distances, in the same unit, shape (N, N).
        implausible: cost of a blend of two, at least 0, shape (N, N).
        n_components: Q.
        cost: of blends of any number.
    Raises:
        ShapeError: the matrices are not (N, N), or not finite, or all distances are zero.
    Source: Kruskal 1964 for the stress, Torgerson 1952 for the start.
    """
    N = len(distance)
    for name, matrix in (("distance", distance), ("separation", separation), ("implausible", implausible)):
        if matrix.shape != (N, N) or not np.all(np.isfinite(matrix)):
            raise ShapeError(f"{name} has shape {matrix.shape}, expected ({N}, {N}) finite values")
    if not np.any(distance > 0.0):
        raise ShapeError(f"all {N} samples are identical, expected at least two different ones")
    objective = _LayoutObjective(distance, separation, implausible)
    rng = np.random.default_rng(0)
    spread = _typical(distance[objective.pairs])
    starts = [_principal_coordinates(distance, n_components)]
    starts += [spread * rng.normal(size=(N, n_components)) for _ in range(_RANDOM_STARTS)]
    jitter = 1e-3 * spread
    ends = [objective.minimise(start + jitter * rng.normal(size=start.shape)) for start in starts]
    best = sorted(ends, key=lambda end: end[0])[:_REFINED]
    radius = _kernel_radius(best[0][1])
    shares = _convex_combinations(N, rng)
    value, X = min((objective.minimise(X, shares, radius) for _, X in best), key=lambda end: end[0])
    objective.cost, few = cost, shares[::2]
    for _ in range(_ROUNDS if cost is not None else 0):
        radius, shares = _kernel_radius(X), np.vstack([_inside_hull(X, rng), few])
        value, X = objective.minimise(X, shares, radius)
    first = objective.value(starts[0], shares, radius)
    X = X - X.mean(axis=0)
    return Layout(X / _kernel_radius(X), first, value)


def _typical(distances: Array) -> float:
    """The median of the non-zero distances: those between copies of a sample are left out."""
    return float(np.median(distances[distances > 0.0]))


class _LayoutObjective:
    """Stress, separation and, at given blends, their cost, with gradients."""

    cost: Cost | None = None

    def __init__(self, distance: Array, separation: Array, implausible: Array) -> None:
        self.pairs = np.triu_indices(len(distance), 1)
        floor = 1e-2 * _typical(distance[self.pairs])
        self._wanted = np.maximum(distance[self.pairs], floor)
        self._least, self._implausible = separation[self.pairs], implausible
        weight = 1.0 / self._wanted
        self._stress, self._hinge = weight / weight.sum(), _SEPARATION / len(weight)

    def value(self, X: Array, shares: Array, radius: float) -> float:
        """The objective at places X (N, Q), with the cost of blends."""
        return self._apart(X)[0] + _STRENGTH * self._blends(X, shares, radius)[0]

    def minimise(self, start: Array, shares: Array | None = None, radius: float = 1.0) -> tuple[float, Array]:
        """The objective at the nearest minimum, and the places (N, Q) there."""

        def flat(z: Array) -> tuple[float, Array]:
            X = z.reshape(start.shape)
            value, gradient = self._apart(X)
            if shares is not None:
                blend, slope = self._blends(X, shares, radius)
                value, gradient = value + _STRENGTH * blend, gradient + _STRENGTH * slope
            return value, gradient.ravel()

        found = minimize(flat, start.ravel(), jac=True, method="L-BFGS-B", options={"maxiter": _ITERATIONS})
        return float(found.fun), found.x.reshape(start.shape)

    def _apart(self, X: Array) -> tuple[float, Array]:
        i, j = self.pairs
        D = X[i] - X[j]
        d = np.sqrt(np.sum(D * D, axis=1) + 1e-12)
        off, near = d - self._wanted, np.maximum(self._least - d, 0.0)
        value = np.sum(self._stress * off**2) + self._hinge * np.sum(near**2)
        pull = (2.0 * (self._stress * off - self._hinge * near) / d)[:, None] * D
        gradient = np.zeros_like(X)
        np.add.at(gradient, i, pull)
        np.add.at(gradient, j, -pull)
        return float(value), gradient

    def _blends(self, X: Array, shares: Array, radius: float) -> tuple[float, Array]:
        """Mean of u^T V u, and of the cost, at the places `shares @ X`, shares (K, N), and its gradient by X."""
        places, X = (np.ascontiguousarray(points.T) for points in (shares @ X, X))
        D = places[:, :, None] - X[:, None]  # [Q, K, N]: numpy is slow along a short last axis
        squared = np.sum(D * D, axis=0) + 1e-6 * radius**2
        log = -0.5 * squared / radius**2 - np.log(squared)
        u = np.exp(log - log.max(axis=1, keepdims=True))
        u /= u.sum(axis=1, keepdims=True)
        Vu = u @ self._implausible
        value, slope = np.sum(u * Vu, axis=1), 2.0 * Vu
        if self.cost is not None:
            more, steeper = self.cost(u)
            value, slope = value + more / _STRENGTH, slope + steeper / _STRENGTH
        d_log = u * (slope - np.sum(u * slope, axis=1, keepdims=True)) / len(shares)
        d_D = -d_log * (1.0 / radius**2 + 2.0 / squared) * D
        # Summed sample by sample: the last refinement is not smooth, so that rounding decides where it ends.
        of_places = np.moveaxis(d_D, 2, 0).copy().sum(axis=0)  # [Q, K]
        return float(value.mean()), shares.T @ of_places.T - d_D.sum(axis=1).T


def _principal_coordinates(distance: Array, n_components: int) -> Array:
    """Classical scaling: places (N, Q) whose inner products are nearest to those of the distances."""
    N = len(distance)
    centring = np.eye(N) - 1.0 / N
    values, vectors = np.linalg.eigh(-0.5 * centring @ distance**2 @ centring)
    X = np.zeros((N, n_components))
    Q = min(N, n_components)
    X[:, :Q] = vectors[:, ::-1][:, :Q] * np.sqrt(np.maximum(values[::-1][:Q], 0.0))
    return X


def _convex_combinations(N: int, rng: np.random.Generator) -> Array:
    """Shares (K, N) of random places inside the hull, of at most four samples each."""
    shares = np.zeros((_places(N), N))
    for row in shares:
        count = int(rng.integers(2, min(_MOST_BLENDED, N) + 1))
        row[rng.choice(N, count, replace=False)] = rng.dirichlet(np.ones(count))
    return shares


def _inside_hull(X: Array, rng: np.random.Generator) -> Array:
    """Shares (K, N) of the samples around places drawn uniformly from the hull of X (N, Q); none where it is flat."""
    N, Q = X.shape
    try:
        simplices = Delaunay(X).simplices  # [S, Q + 1]
    except (QhullError, ValueError):  # one dimension, too few samples, or all in a plane
        return np.zeros((0, N))
    volume = np.abs(np.linalg.det(X[simplices[:, 1:]] - X[simplices[:, :1]]))
    places = _places(N)
    around = simplices[rng.choice(len(simplices), places, p=volume / volume.sum())]
    shares = np.zeros((places, N))
    np.put_along_axis(shares, around, rng.dirichlet(np.ones(Q + 1), places), axis=1)
    return shares


def _places(N: int) -> int:
    return min(_PLACES, _PLACES_OF_EACH * N)


def _kernel_radius(X: Array) -> float:
    """Length scale of the kernel: about the side of a sample's share of the convex hull's volume.

    No less than what reaches neighbours: else blends would be copies of the nearest sample.
    """
    N, Q = X.shape
    extent = np.ptp(X, axis=0)
    try:
        volume = float(ConvexHull(X).volume) if Q > 1 else float(extent[0])
    except (QhullError, ValueError):  # too few samples, or all in a plane
        volume = float(np.prod(np.maximum(extent, 1e-3 * extent.max())))
    return max(_RADIUS * (volume / N) ** (1.0 / Q), float(np.median(_gaps(X))) / _NEAREST, 1e-9)
