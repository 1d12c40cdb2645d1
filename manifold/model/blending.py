"""Blends: weights that are never negative, sum to 1, and are a unit vector at each sample; their layout.

A Gaussian process interpolates with weights of alternating sign, which cause dark holes in highlights. The values of a
blend lie between those of the surrounding materials, and change as smoothly as its weights. It needs a layout in which
neighbours have a similar appearance, and their blends look like materials.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from manifold.core.errors import ShapeError
from manifold.core.records import Array, Indices
from manifold.gp.kernels import squared_distances
from manifold.gp.likelihood import fix_gauge

NEIGHBOURS = 128
"""Number of nearest samples among which a blend finds its weights."""

NEGLIGIBLE = 3e-4
"""Weights up to this share of the largest are set to 0, and cost no look-up.

All of them together change a ball by less than a tenth of a visible difference, in every light
(tests/model/test_model.py).
"""

_FLATTENING = 10.0 ** np.arange(
    -2.0, 2.0, 0.25
)  # rising weights of the extent along a dimension beyond the map's
_PLACES, _PLACES_OF_EACH = 1500, 75  # number of blends evaluated: at most, and per sample
_MOST_BLENDED = 4  # samples of a convex combination
RISING = 10.0 ** np.linspace(-2.0, 0.0, 8)  # weights of the cost, each at new places inside the hull
DAMPING = 20.0  # damping of the steps with these weights
_STRENGTH = 3.0  # weight of implausible blends against stress
_SEPARATION = 10.0  # weight of the least distances against stress
_RADIUS = 0.9  # radius of the kernel, in sides of a sample's share of the convex hull
_NEAREST = 2.5  # length scales between neighbours, at most, in the median: in many dimensions the hull is all but flat
_TIGHT = {"maxiter": 2000, "maxfun": 10000, "ftol": 1e-13, "gtol": 1e-7, "maxcor": 20}  # options of L-BFGS
_LEAST_SHARE_OF_UNIT = 1e-2  # share of the typical distance: smaller target distances count as this

Cost = Callable[[Array], tuple[Array, Array]]
"""A function from weights u (K, N) of blends to their cost (K,) and its gradient by u (K, N)."""
Term = Callable[[Array], tuple[float, Array]]
"""A function from places X (N, Q) to a term of the objective and its gradient (N, Q)."""


@dataclass(frozen=True, eq=False)
class Layout:
    """Places of N samples.

    Attributes:
        X: shape (N, Q).
        unit: length scale in the unit of the target distances.
        objective_start: at the principal coordinates.
    """

    X: Array
    unit: float
    objective_start: float
    objective: float


def blend_weights(x: Array, X: Array, length_scale: float = 1.0) -> Array:
    """Return the weights u of samples X (N, Q) at places x (M, Q), never negative and with sum 1, shape (M, N).

    `u_i ~ exp(-d_i^2 / (2 l^2)) / d_i^2`: a unit vector at a sample, continuous, with a slope of 0 at the samples. Of
    more than `NEIGHBOURS` samples only the nearest have a weight, less that of the next one.
    Source: Shepard 1968, with the squared exponential in place of his cut-off.
    """
    if len(X) <= NEIGHBOURS:
        return _weights(squared_distances(x, X) / length_scale**2)
    distances, nearest = scipy.spatial.KDTree(X).query(x, NEIGHBOURS + 1)
    u = np.zeros((len(x), len(X)))
    shares = _weights((distances / length_scale) ** 2, is_cut=True)
    np.put_along_axis(u, nearest[:, :-1], shares, axis=1)
    return u


def _weights(squared: Array, *, is_cut: bool = False) -> Array:
    """Return weights (M, N) from squared distances in length scales (M, N).

    If these have N + 1 columns, the last one gets weight 0.
    """
    with np.errstate(divide="ignore"):
        log = -0.5 * squared - np.log(squared)
    is_sample = np.isposinf(log)
    log = np.where(is_sample.any(axis=1, keepdims=True), np.where(is_sample, 0.0, -np.inf), log)
    u = np.exp(log - log.max(axis=1, keepdims=True))
    none: Array | float = NEGLIGIBLE
    if is_cut:
        u, none = u[:, :-1], np.maximum(u[:, -1:], NEGLIGIBLE)
    u = np.maximum(u - none, 0.0)  # continuous where a weight vanishes
    return u / u.sum(axis=1, keepdims=True)


def nearest_distance(x: Array, X: Array) -> Array:
    """Return the distances of places x (M, Q) from the nearest of the samples X (N, Q), shape (M,)."""
    if len(X) > NEIGHBOURS:
        return np.asarray(scipy.spatial.KDTree(X).query(x)[0])
    return np.sqrt(squared_distances(x, X).min(axis=1))


def widest_gap(X: Array) -> float:
    """Return the largest distance of a sample of X (N, Q) from its nearest other one; infinity for a single sample."""
    return float(_gaps(X).max())


def _gaps(X: Array) -> Array:
    """Return the distance of every sample of X (N, Q) from its nearest other one, shape (N,)."""
    if len(X) > NEIGHBOURS:
        return np.asarray(scipy.spatial.KDTree(X).query(X, 2)[0][:, 1])
    squared = squared_distances(X, X)
    np.fill_diagonal(squared, np.inf)
    return np.sqrt(squared.min(axis=1))


def blend_layout(
    distance: Array, separation: Array, implausible: Array, n_components: int, cost: Cost | None = None
) -> Layout:
    """Return places of N samples, in length scales of `blend_weights`, centred.

    Target distances, positive off the diagonal, least distances in the same unit, and costs of blends of two, at least
    0, are (N, N); `cost` is that of blends of any number. Minimises the relative stress `sum (d_ij - distance_ij)^2 /
    distance_ij`, plus the squares by which distances fall short of `separation`, plus the mean of `u^T implausible u`
    over blends u inside the convex hull, plus that of `cost(u)`, at places drawn uniformly from the present hull. There
    are many minima. One is followed from principal coordinates in Q + 1 dimensions, where there are few: the last
    dimension is flattened little by little, then the terms of blends are added, the cost with rising weight in damped
    steps. Each has one minimum nearby, where it ends whatever rounding did on the way: small differences of the
    distances make small differences of the map. The unit is then chosen so that a kernel of length scale 1 spans about
    the side of a sample's share of the hull, and reaches neighbours; the axes are principal axes, each with its longer
    tail positive.
    Source: Kruskal 1964 for the stress, Torgerson 1952 for the start, Rockafellar 1976 for the damped steps.
    """
    N = len(distance)
    if not np.any(distance > 0.0):
        raise ShapeError(f"all {N} samples are identical, expected at least two different ones")
    pairs = np.triu_indices(N, 1)
    objective, rng = LayoutObjective(pairs, distance[pairs], separation[pairs]), np.random.default_rng(0)
    start = fix_gauge(_principal_coordinates(distance, n_components + 1))
    X, few = objective.unfold(start, rng), _convex_combinations(N, rng)
    blends = _blends(few, kernel_radius(X), implausible)
    X = objective.minimise(X, blends)
    for weight in RISING if cost is not None else ():
        shares = np.vstack([inside_hull(X, _places(N), rng), few[::2]])
        blends = _blends(shares, kernel_radius(X), implausible, cost, weight)
        X = objective.minimise(X, blends, DAMPING)
    return objective.result(start[:, :n_components], X, blends)


class LayoutObjective:
    """An objective of stress and separation of pairs of samples, by target and least distances (R,), and its gradient.

    It may have other terms; a pair may stand for several, (R,).
    """

    def __init__(
        self,
        pairs: tuple[Indices, Indices],
        distance: Array,
        separation: Array,
        stands_for: Array | None = None,
    ) -> None:
        self._pairs, self._least = pairs, separation
        self._unit = float(np.median(distance[distance > 0.0]))  # copies of a sample are left out
        self._wanted = np.maximum(distance, _LEAST_SHARE_OF_UNIT * self._unit)
        count = np.ones(len(distance)) if stands_for is None else stands_for
        weight = count / self._wanted
        self._stress, self._hinge = weight / weight.sum(), _SEPARATION * count / count.sum()

    def value(self, X: Array, more: Term) -> tuple[float, Array]:
        """Return the objective at places X (N, Q) plus another term, and its gradient."""
        (value, gradient), (added, slope) = self._apart(X), more(X)
        return value + added, gradient + slope

    def minimise(
        self, start: Array, more: Term, damping: float = 0.0, limits: dict[str, float] = _TIGHT
    ) -> Array:
        """Return places (N, Q) at the nearest minimum, with a damping of the mean squared distance from the start."""
        held = damping / len(start)

        def flat(z: Array) -> tuple[float, Array]:
            X = z.reshape(start.shape)
            value, gradient = self.value(X, more)
            moved = X - start
            return value + held * float(np.sum(moved * moved)), (gradient + 2.0 * held * moved).ravel()

        found = scipy.optimize.minimize(flat, start.ravel(), jac=True, method="L-BFGS-B", options=limits)
        return np.asarray(found.x).reshape(start.shape)

    def unfold(self, start: Array, rng: np.random.Generator) -> Array:
        """Return places (N, Q) near a minimum, from a start in one more dimension.

        The start, (N, Q + 1), is flattened slowly.
        """
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
        value = np.sum(self._stress * off**2 + self._hinge * near**2)
        pull = (2.0 * (self._stress * off - self._hinge * near) / d)[:, None] * D
        return float(value), add_rows(i, pull, len(X)) - add_rows(j, pull, len(X))

    def result(self, start: Array, X: Array, more: Term) -> Layout:
        """Return the layout of places X (N, Q) that were found from a start (N, Q)."""
        first, value = (self.value(places, more)[0] for places in (start, X))
        axes, unit = np.linalg.svd(X - X.mean(axis=0), full_matrices=False)[2], kernel_radius(X)
        return Layout(fix_gauge(X @ axes.T) / unit, unit, first, value)


def add_rows(index: Indices, rows: Array, count: int) -> Array:
    """Sum rows (R, Q) by their index (R,), shape (count, Q)."""
    return np.stack([np.bincount(index, column, count) for column in rows.T], axis=1)


def _blends(
    shares: Array, radius: float, implausible: Array, cost: Cost | None = None, weight: float = 0.0
) -> Term:
    """Return the mean over places `shares @ X`, shares (K, N), of u^T implausible u, plus the weighted cost."""

    def term(X: Array) -> tuple[float, Array]:
        places, at = (np.ascontiguousarray(points.T) for points in (shares @ X, X))
        D = places[:, :, None] - at[:, None]  # [Q, K, N]: numpy is slow along a short last axis
        u, squared = soft_weights(D, radius)
        Vu = _STRENGTH * u @ implausible
        value, slope = np.sum(u * Vu, axis=1), 2.0 * Vu
        if cost is not None:
            more, steeper = cost(u)
            value, slope = value + weight * more, slope + weight * steeper
        d_D = pulled_back(D, u, squared, slope / len(shares), radius)
        return float(value.mean()), shares.T @ d_D.sum(axis=2).T - d_D.sum(axis=1).T

    return term


def soft_weights(D: Array, radius: float) -> tuple[Array, Array]:
    """Return weights u (K, N) of blends from differences D (Q, K, N), smooth at the samples as well; and |D|^2."""
    squared = np.sum(D * D, axis=0) + 1e-6 * radius**2
    log = -0.5 * squared / radius**2 - np.log(squared)
    u = np.exp(log - log.max(axis=1, keepdims=True))
    u /= u.sum(axis=1, keepdims=True)
    return u, squared


def pulled_back(D: Array, u: Array, squared: Array, slope: Array, radius: float) -> Array:
    """Return the gradient by D (Q, K, N) of a function of `soft_weights(D, radius)`, from its gradient by u (K, N)."""
    d_log = u * (slope - np.sum(u * slope, axis=1, keepdims=True))
    return np.asarray(-d_log * (1.0 / radius**2 + 2.0 / squared) * D)


def _principal_coordinates(distance: Array, n_components: int) -> Array:
    """Return places (N, Q) by classical scaling, whose inner products are nearest to those of the distances."""
    N = len(distance)
    centring = np.eye(N) - 1.0 / N
    values, vectors = np.linalg.eigh(-0.5 * centring @ distance**2 @ centring)
    X = np.zeros((N, n_components))
    Q = min(N, n_components)
    X[:, :Q] = vectors[:, ::-1][:, :Q] * np.sqrt(np.maximum(values[::-1][:Q], 0.0))
    return X


def _convex_combinations(N: int, rng: np.random.Generator) -> Array:
    """Return shares (K, N) of random places inside the hull, of at most four samples each."""
    shares = np.zeros((_places(N), N))
    for row in shares:
        count = int(rng.integers(2, min(_MOST_BLENDED, N) + 1))
        row[rng.choice(N, count, replace=False)] = rng.dirichlet(np.ones(count))
    return shares


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


def _places(N: int) -> int:
    return min(_PLACES, _PLACES_OF_EACH * N)


def kernel_radius(X: Array) -> float:
    """Return the kernel's length scale: about the side of a sample's share of the convex hull's volume.

    It is no less than the distance to neighbours, since otherwise blends would be copies of the nearest
    sample.
    """
    N, Q = X.shape
    extent = np.ptp(X, axis=0)
    try:
        volume = float(scipy.spatial.ConvexHull(X).volume) if Q > 1 else float(extent[0])
    except (scipy.spatial.QhullError, ValueError):  # too few samples, or all in a plane
        volume = float(np.prod(np.maximum(extent, 1e-3 * extent.max())))
    return max(_RADIUS * (volume / N) ** (1.0 / Q), float(np.median(_gaps(X))) / _NEAREST, 1e-9)
