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
from manifold.latent.objective import fix_gauge
from manifold.records import Array

_NEGLIGIBLE = 1e-6  # relative to the largest weight: smaller ones are invisible, and cost a look-up each
_FLATTENING = 10.0 ** np.arange(
    -2.0, 2.0, 0.25
)  # rising weights of the extent along a dimension beyond the map's
_PLACES, _PLACES_OF_EACH = 1500, 75  # number of blends evaluated: at most, and per sample
_MOST_BLENDED = 4  # samples of a convex combination
_RISING = 10.0 ** np.linspace(-2.0, 0.0, 8)  # weights of the cost, each at new places inside the hull
_DAMPING = 20.0  # of these steps
_STRENGTH = 3.0  # weight of implausible blends against stress
_SEPARATION = 10.0  # weight of the least distances against stress
_RADIUS = 0.9  # of the kernel, in sides of a sample's share of the convex hull
_NEAREST = 2.5  # length scales between neighbours, at most, in the median: in many dimensions the hull is all but flat
_TIGHT = {"maxiter": 2000, "maxfun": 10000, "ftol": 1e-13, "gtol": 1e-7, "maxcor": 20}  # of L-BFGS

Cost = Callable[[Array], tuple[Array, Array]]
"""From weights u (K, N) of blends to their cost (K,) and its gradient by u (K, N)."""
Term = Callable[[Array], tuple[float, Array]]
"""From places X (N, Q) to a term of the objective and its gradient (N, Q)."""


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
    short of `separation`, plus the mean of `u^T implausible u` over blends u inside the convex hull, plus that of
    `cost(u)`, at places drawn uniformly from the present hull. There are many minima. One is followed from principal
    coordinates in Q + 1 dimensions, where there are few: the last dimension is flattened little by little, then the
    terms of blends are added, the cost with rising weight in damped steps. Each has one minimum nearby, where it ends
    whatever rounding did on the way: small differences of the distances make small differences of the map.
    The unit is then chosen so that a kernel of length scale 1 spans about the side of a sample's share of the hull, and
    reaches neighbours; the axes are principal axes, each with its longer tail positive.

    Args:
        distance: target distances, shape (N, N), positive off the diagonal.
        separation: least distances, in the same unit, shape (N, N).
        implausible: cost of a blend of two, at least 0, shape (N, N).
        n_components: Q.
        cost: of blends of any number.
    Raises:
        ShapeError: all distances are zero.
    Source: Kruskal 1964 for the stress, Torgerson 1952 for the start, Rockafellar 1976 for the damped steps.
    """
    N = len(distance)
    if not np.any(distance > 0.0):
        raise ShapeError(f"all {N} samples are identical, expected at least two different ones")
    objective, rng = _LayoutObjective(distance, separation, implausible), np.random.default_rng(0)
    start = fix_gauge(_principal_coordinates(distance, n_components + 1))
    X, few = objective.unfold(start, rng), _convex_combinations(N, rng)
    blends = objective.blends(few, _kernel_radius(X))
    X = objective.minimise(X, blends)
    for weight in _RISING if cost is not None else ():
        shares = np.vstack([_inside_hull(X, rng), few[::2]])
        blends = objective.blends(shares, _kernel_radius(X), cost, weight)
        X = objective.minimise(X, blends, _DAMPING)
    first, value = (objective.value(places, blends)[0] for places in (start[:, :n_components], X))
    axes = np.linalg.svd(X - X.mean(axis=0), full_matrices=False)[2]
    return Layout(fix_gauge(X @ axes.T) / _kernel_radius(X), first, value)


def _typical(distances: Array) -> float:
    """The median of the non-zero distances: those between copies of a sample are left out."""
    return float(np.median(distances[distances > 0.0]))


class _LayoutObjective:
    """Stress and separation, with other terms, and their gradients."""

    def __init__(self, distance: Array, separation: Array, implausible: Array) -> None:
        self._pairs = np.triu_indices(len(distance), 1)
        self._unit = _typical(distance[self._pairs])
        self._wanted = np.maximum(distance[self._pairs], 1e-2 * self._unit)
        self._least, self._implausible = separation[self._pairs], implausible
        weight = 1.0 / self._wanted
        self._stress, self._hinge = weight / weight.sum(), _SEPARATION / len(weight)

    def value(self, X: Array, more: Term) -> tuple[float, Array]:
        """The objective at places X (N, Q) with another term, and its gradient."""
        (value, gradient), (added, slope) = self._apart(X), more(X)
        return value + added, gradient + slope

    def minimise(self, start: Array, more: Term, damping: float = 0.0) -> Array:
        """Places (N, Q) at the nearest minimum, with the mean squared distance from the start times a damping added."""
        held = damping / len(start)

        def flat(z: Array) -> tuple[float, Array]:
            X = z.reshape(start.shape)
            value, gradient = self.value(X, more)
            moved = X - start
            return value + held * float(np.sum(moved * moved)), (gradient + 2.0 * held * moved).ravel()

        found = minimize(flat, start.ravel(), jac=True, method="L-BFGS-B", options=_TIGHT)
        return np.asarray(found.x).reshape(start.shape)

    def unfold(self, start: Array, rng: np.random.Generator) -> Array:
        """Places (N, Q) near a minimum, from a start in one dimension more, (N, Q + 1), that is flattened slowly."""
        X: Array = start + 1e-3 * self._unit * rng.normal(size=start.shape)
        for weight in _FLATTENING / self._unit**2:

            def thickness(X: Array, weight: float = weight) -> tuple[float, Array]:
                last = np.zeros_like(X)
                last[:, -1] = X[:, -1]
                return weight * float(np.mean(X[:, -1] ** 2)), 2.0 * weight / len(X) * last

            X = self.minimise(X, thickness)
        return X[:, :-1]

    def _apart(self, X: Array) -> tuple[float, Array]:
        i, j = self._pairs
        D = X[i] - X[j]
        d = np.sqrt(np.sum(D * D, axis=1) + 1e-12)
        off, near = d - self._wanted, np.maximum(self._least - d, 0.0)
        value = np.sum(self._stress * off**2) + self._hinge * np.sum(near**2)
        pull = (2.0 * (self._stress * off - self._hinge * near) / d)[:, None] * D
        gradient = np.zeros_like(X)
        np.add.at(gradient, i, pull)
        np.add.at(gradient, j, -pull)
        return float(value), gradient

    def blends(self, shares: Array, radius: float, cost: Cost | None = None, weight: float = 0.0) -> Term:
        """Mean over the places `shares @ X`, shares (K, N), of u^T V u, and of the cost times a weight."""

        def term(X: Array) -> tuple[float, Array]:
            places, at = (np.ascontiguousarray(points.T) for points in (shares @ X, X))
            D = places[:, :, None] - at[:, None]  # [Q, K, N]: numpy is slow along a short last axis
            squared = np.sum(D * D, axis=0) + 1e-6 * radius**2
            log = -0.5 * squared / radius**2 - np.log(squared)
            u = np.exp(log - log.max(axis=1, keepdims=True))
            u /= u.sum(axis=1, keepdims=True)
            Vu = _STRENGTH * u @ self._implausible
            value, slope = np.sum(u * Vu, axis=1), 2.0 * Vu
            if cost is not None:
                more, steeper = cost(u)
                value, slope = value + weight * more, slope + weight * steeper
            d_log = u * (slope - np.sum(u * slope, axis=1, keepdims=True)) / len(shares)
            d_D = -d_log * (1.0 / radius**2 + 2.0 / squared) * D
            return float(value.mean()), shares.T @ d_D.sum(axis=2).T - d_D.sum(axis=1).T

        return term


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
        simplices = np.sort(Delaunay(X).simplices, axis=1)  # [S, Q + 1]
    except (QhullError, ValueError):  # one dimension, too few samples, or all in a plane
        return np.zeros((0, N))
    simplices = simplices[np.lexsort(simplices.T)]  # in an order that does not depend on rounding
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
