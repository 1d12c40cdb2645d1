"""Computes the weights of blends, and the layout of the samples that blends need.

The weights are never negative, sum to 1, and are a unit vector at each sample. A Gaussian process interpolates with
weights of alternating sign, which cause dark rings in highlights. The values of a blend lie between the values of the
surrounding materials and change as smoothly as the weights. Blending needs a layout in which neighbours look alike,
and materials that look alike are neighbours.
"""

from __future__ import annotations

import numpy as np
import scipy

from manifold.core.compiled import loops
from manifold.core.defaults import ROUNDING
from manifold.core.errors import ShapeError
from manifold.core.records import Array, Indices
from manifold.gp.kernels import squared_distances
from manifold.gp.likelihood import fix_gauge

NEIGHBOURS = 128
"""Number of nearest samples that can have a weight in a blend."""

NEGLIGIBLE = 3e-4
"""Share of the largest weight below which weights are set to 0 to save evaluations.

Together these weights change a rendered ball by less than a tenth of a visible difference in every light
(tests/model/test_model.py).
"""

PERPLEXITY = 10.0
"""Effective number of neighbours that a layout keeps beside each sample; a third of fewer than 31 samples."""

_LEAST_PERPLEXITY = 3.0  # with fewer, groups of few samples drift apart without end
START_NOISE = 1e-3
"""Noise added to the starting positions of a layout, in standard deviations.

It separates identical samples, and samples that lie on a line, where the gradient across the line is zero.
"""

_FREEDOM = 3.0
"""Degrees of freedom of the t distribution.

With 1 (t-SNE) 73 % of the hull of 143 neural fits of measured materials is within reach of one of them, with 3 it is
93 %, at the same detours. The compiled loop `loops.repel` contains the same number.
"""
_POWER = 0.5 * (_FREEDOM + 1.0)  # of the similarity
_EXAGGERATIONS = (
    4.0,
    2.0,
    1.0,
)  # of the attraction, one after the other: the first arrange, the last is the objective
_COLLAPSED = 1e-3  # of the extent before
_BISECTIONS = 60
_MOST_DISTANCES = 100_000  # that are computed; a tree takes longer for fewer
_RADIUS = 0.9  # radius of the kernel, in sides of a sample's share of the convex hull
_NEAREST = 2.5  # length scales between neighbours, at most, in the median: in many dimensions the hull is all but flat
_TIGHT = {"maxiter": 2000, "maxfun": 10000, "ftol": 1e-13, "gtol": 1e-9, "maxcor": 20}  # options of L-BFGS


def blend_weights(x: Array, X: Array, length_scale: float = 1.0) -> Array:
    """Return the weights u of samples X (N, Q) at points x (M, Q), shape (M, N); they are never negative and sum to 1.

    `u_i ~ exp(-d_i^2 / (2 l^2)) / d_i^2`. The weights are continuous, and at a sample a unit vector with slope 0.
    Only the `NEIGHBOURS` nearest samples have a weight; the weight of the next one is subtracted to keep them
    continuous.
    Source: Shepard 1968, with the squared exponential in place of his cut-off.
    """
    if len(X) <= NEIGHBOURS:
        return _weights(squared_distances(x, X) / length_scale**2)
    squared, nearest = _nearest(x, X, NEIGHBOURS + 1)
    u = np.zeros((len(x), len(X)))
    shares = _weights(squared / length_scale**2, is_cut=True)
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
    """Return the distance of each point x (M, Q) from the nearest of the samples X (N, Q), shape (M,)."""
    return np.sqrt(_nearest(x, X, 1)[0][:, 0])


def widest_gap(X: Array) -> float:
    """Return the largest distance of a sample of X (N, Q) from its nearest neighbour; infinity for a single sample."""
    return float(_gaps(X).max())


def _gaps(X: Array) -> Array:
    """Return the distance of every sample of X (N, Q) from its nearest other one, shape (N,)."""
    return np.sqrt(_nearest(X, X, 2)[0][:, 1]) if len(X) > 1 else np.array([np.inf])


def _nearest(x: Array, X: Array, count: int) -> tuple[Array, Indices]:
    """Return the squared distances of points x (M, Q) from the `count` nearest of X (N, Q), and their indices.

    Both have the shape (M, count), the nearest first.
    """
    if len(x) * len(X) > _MOST_DISTANCES:
        distances, nearest = scipy.spatial.KDTree(X).query(x, np.arange(1, count + 1))
        return distances**2, nearest
    squared, rows = squared_distances(x, X), np.arange(len(x))[:, None]
    nearest = np.argpartition(squared, count - 1, axis=1)[:, :count]
    nearest = nearest[rows, np.argsort(squared[rows, nearest], axis=1)]
    return squared[rows, nearest], nearest


def blend_layout(distance: Array, n_components: int) -> Array:
    """Return positions (N, Q) of N samples from their distances (N, N); `scaled` brings them to the final scale.

    It minimises the divergence `sum p_ij log(p_ij / q_ij)` between the affinities p of the samples and the
    similarities q of their positions, q_ij ~ (1 + d_ij^2 / 3)^-2. The search starts at principal coordinates with
    exaggerated attraction and ends at a minimum, so that rounding does not change the map.
    Source: van der Maaten & Hinton 2008 (t-SNE), van der Maaten 2009 for the degrees of freedom, Torgerson 1952 for
    the start.
    """
    N = len(distance)
    if not np.any(distance > 0.0):
        raise ShapeError(f"all {N} samples are identical, expected at least two different ones")
    others = np.array([np.delete(np.arange(N), i) for i in range(N)])
    apart = np.take_along_axis(distance, others, axis=1)
    objective = LayoutObjective(others, affinities(apart))
    X = fix_gauge(_principal_coordinates(distance, n_components))
    X, rng = X / max(float(X[:, 0].std()), np.finfo(float).tiny), np.random.default_rng(0)
    for exaggeration in _EXAGGERATIONS:
        noise = START_NOISE * X[:, 0].std() * rng.normal(size=X.shape)
        found = objective.minimise(X + noise, exaggeration)
        if found.std() > _COLLAPSED * X.std():  # an exaggerated attraction can pull few samples into a point
            X = found
    return X


def affinities(distance: Array) -> Array:
    """Return the affinities (N, n) of N samples to others at distances (N, n); each row sums to 1.

    They are Gaussians of the squared distance, whose widths give each row the same perplexity. Where samples are
    dense, the Gaussians are narrow, and near copies do not outweigh the other neighbours.
    """
    N, n = distance.shape
    entropy = np.log(min(PERPLEXITY, max((N - 1) / 3.0, _LEAST_PERPLEXITY), n))
    is_known = np.isfinite(distance)
    squared = np.where(is_known, distance, 0.0) ** 2 - np.min(distance, axis=1, keepdims=True) ** 2
    squared = np.where(is_known, squared, 0.0)
    squared /= np.maximum(np.mean(squared, axis=1, keepdims=True), np.finfo(float).tiny)
    low, high = np.full((2, N, 1), [[[-20.0]], [[60.0]]])  # of the logarithm of the precision
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        log = -np.exp(middle) * squared
        p = np.exp(log) * is_known
        total = p.sum(axis=1, keepdims=True)
        is_wide = np.log(total) - np.sum(p * log, axis=1, keepdims=True) / total > entropy
        low, high = np.where(is_wide, middle, low), np.where(is_wide, high, middle)
    return np.asarray(p / total)


class LayoutObjective:
    """The divergence between affinities and a layout of N samples, without the constant entropy term, and its gradient.

    Each sample is attracted by others, with indices (N, n) and affinities (N, n), and repelled by all.
    """

    def __init__(self, others: Indices, affinity: Array) -> None:
        used = affinity > ROUNDING
        i = np.broadcast_to(np.arange(len(others))[:, None], others.shape)
        self._i, self._j, self._p = i[used], others[used], affinity[used] / len(others)

    def value(self, X: Array, exaggeration: float = 1.0) -> tuple[float, Array]:
        """Return the objective at positions X (N, Q), and its gradient."""
        D = X[self._i] - X[self._j]
        near = 1.0 + np.sum(D * D, axis=1) / _FREEDOM
        value = exaggeration * _POWER * float(self._p @ np.log(near))
        pull = (exaggeration * 2.0 * _POWER / _FREEDOM * self._p / near)[:, None] * D
        similarity, force = np.empty(len(X)), np.empty(X.T.shape)
        loops.repel(X.T, similarity, force)
        total = float(similarity.sum())
        gradient = add_rows(self._i, pull, len(X)) - add_rows(self._j, pull, len(X))
        return value + float(np.log(total)), gradient - 4.0 * _POWER / _FREEDOM / total * force.T

    def minimise(self, start: Array, exaggeration: float = 1.0, limits: dict[str, float] = _TIGHT) -> Array:
        """Return the positions (N, Q) of a minimum near the start (N, Q)."""

        def flat(z: Array) -> tuple[float, Array]:
            value, gradient = self.value(z.reshape(start.shape), exaggeration)
            return value, gradient.ravel()

        found = scipy.optimize.minimize(flat, start.ravel(), jac=True, method="L-BFGS-B", options=limits)
        return np.asarray(found.x).reshape(start.shape)


def scaled(X: Array, lightness: Array) -> Array:
    """Return positions X (N, Q) centred, turned to readable axes, and scaled to length scales of `blend_weights`.

    The last axis is the direction in which the lightness (N,) increases most. The others are the principal axes
    perpendicular to it, each with its longer tail positive. See `kernel_radius` for the length scale.
    """
    X = X - X.mean(axis=0)
    upwards = np.linalg.lstsq(X, lightness - lightness.mean())[0]
    norm = float(np.linalg.norm(upwards))
    up = upwards / norm if norm > 0.0 else np.eye(X.shape[1])[-1]
    across = X - np.outer(X @ up, up)
    axes = np.linalg.svd(across, full_matrices=False)[2][: X.shape[1] - 1]
    return np.column_stack([fix_gauge(X @ axes.T), X @ up]) / kernel_radius(X)


def add_rows(index: Indices, rows: Array, count: int) -> Array:
    """Add up the rows (R, Q) that have the same index (R,); return the sums, shape (count, Q)."""
    return np.stack([np.bincount(index, column, count) for column in rows.T], axis=1)


def _principal_coordinates(distance: Array, n_components: int) -> Array:
    """Return points (N, Q) by classical scaling, whose inner products are nearest to those of the distances."""
    N = len(distance)
    centring = np.eye(N) - 1.0 / N
    values, vectors = np.linalg.eigh(-0.5 * centring @ distance**2 @ centring)
    X = np.zeros((N, n_components))
    Q = min(N, n_components)
    X[:, :Q] = vectors[:, ::-1][:, :Q] * np.sqrt(np.maximum(values[::-1][:Q], 0.0))
    return X


def kernel_radius(X: Array) -> float:
    """Return a length scale: about the side of a cube whose volume is the convex hull's volume per sample.

    It is at least the distance between neighbours, because otherwise blends would be copies of the nearest sample.
    """
    N, Q = X.shape
    extent = np.ptp(X, axis=0)
    try:
        volume = float(scipy.spatial.ConvexHull(X).volume) if Q > 1 else float(extent[0])
    except (scipy.spatial.QhullError, ValueError):  # too few samples, or all in a plane
        volume = float(np.prod(np.maximum(extent, 1e-3 * extent.max())))
    return max(_RADIUS * (volume / N) ** (1.0 / Q), float(np.median(_gaps(X))) / _NEAREST, 1e-9)
