"""Layouts of thousands of samples: some are landmarks, laid out exactly; the others are located on their map.

The cost is linear in the number of samples: every sample is compared with the landmarks and with its neighbours, and
blends with the nearest samples only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from manifold.latent.blending import (
    DAMPING,
    RISING,
    Layout,
    LayoutObjective,
    Term,
    add_rows,
    inside_hull,
    kernel_radius,
    pulled_back,
    soft_weights,
)
from manifold.records import Array, Indices

_TRIED_PLACES, _STARTS = 150, 3  # of the search for the place of a sample among the landmarks
_STEPS = 60  # of each search
_AT_ONCE = 64  # samples whose places are tried together
_COMPARED = 12  # neighbours that a sample is compared with
_COMPARE_AGAIN = 4  # steps after which neighbours are found again
_BLENDED = 64  # nearest samples that make a blend
_LEAST_PLACES = 1500  # number of blends evaluated, if there are fewer samples
_LIMITS = {"maxiter": 40, "maxfun": 60, "ftol": 1e-9, "gtol": 1e-7, "maxcor": 10}  # of L-BFGS

LocalCost = Callable[[Array, Indices], tuple[Array, Array]]
"""From weights u (K, n) of blends of samples (K, n) to their cost (K,) and its gradient by u (K, n)."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """Samples beside others.

    Attributes:
        others: their indices, shape (N, n).
        distance, separation: target and least distances, shape (N, n).
    """

    others: Indices
    distance: Array
    separation: Array


def farthest_samples(count: int, distances_to: Callable[[int], Array]) -> Indices:
    """Samples that cover all: each is the farthest from those before it; fewer where the others are copies of these.

    Args:
        count: how many.
        distances_to: from the index of a sample to the distances of all from it, shape (N,).
    Source: Gonzalez 1985.
    """
    chosen = [0]
    apart = distances_to(0)
    while len(chosen) < count and apart.max() > 0.0:
        chosen.append(int(np.argmax(apart)))
        apart = np.minimum(apart, distances_to(chosen[-1]))
    return np.array(chosen)


def landmark_layout(
    landmarks: Indices,
    map_of_landmarks: Layout,
    to_landmarks: Comparison,
    compare: Callable[[Indices], Comparison],
    cost: LocalCost,
) -> Layout:
    """Places of N samples, in length scales of `blend_weights`, centred: what `blend_layout` finds, approximately.

    Every sample is located by its distances from the landmarks. Then all are refined: the stress over pairs with
    landmarks, which stand for all pairs, and with neighbours; least distances of the same pairs; and the cost of blends
    of the nearest samples, with rising weight in damped steps.

    Args:
        landmarks: which of the samples they are, shape (M,).
        map_of_landmarks: their layout.
        to_landmarks: all samples beside the landmarks, (N, M).
        compare: from others (N, n) to the comparison of all samples with them.
        cost: of blends.
    Source: de Silva & Tenenbaum 2004 (landmark scaling); Kruskal 1964 for the stress.
    """
    rng = np.random.default_rng(0)
    anchors = map_of_landmarks.X * map_of_landmarks.unit
    X = _located(anchors, to_landmarks.distance, rng)
    X[landmarks] = anchors
    start, N = X, len(X)
    for step, weight in enumerate(RISING):
        tree = KDTree(X)
        if step % _COMPARE_AGAIN == 0:
            near = compare(tree.query(X, min(_COMPARED + 1, N))[1][:, 1:])
            objective = _objective(landmarks, to_landmarks, near)
        shares = inside_hull(X[landmarks], max(_LEAST_PLACES, N), rng)
        nearest = tree.query(shares @ X[landmarks], min(_BLENDED, N))[1]
        blends = _local_blends(shares, landmarks, nearest, kernel_radius(X), cost, weight)
        X = objective.minimise(X, blends, DAMPING, _LIMITS)
    return objective.result(start, X, blends)


def _objective(landmarks: Indices, to_landmarks: Comparison, near: Comparison) -> LayoutObjective:
    N, M = to_landmarks.distance.shape
    rows, parts = np.arange(N)[:, None], []
    # Pairs with landmarks stand for all N (N - 1) / 2, those of neighbours for themselves.
    for compared, stands_for in ((to_landmarks, 0.5 * (N - 1) / M), (near, 0.5)):
        i, j = np.broadcast_arrays(rows, compared.others)
        is_pair = i != j
        parts.append(
            [i[is_pair], j[is_pair], compared.distance[is_pair], compared.separation[is_pair],
             np.full(np.count_nonzero(is_pair), stands_for)]
        )  # fmt: skip
    i, j, distance, separation, counts = (np.concatenate(both) for both in zip(*parts, strict=True))
    return LayoutObjective((i, j), distance, separation, counts)


def _located(anchors: Array, distance: Array, rng: np.random.Generator) -> Array:
    """Places (N, Q) whose distances from anchors (M, Q) are nearest to (N, M), relative: best of several searches.

    Source: de Leeuw 1977 (majorisation).
    """
    (N, M), Q = distance.shape, anchors.shape[1]
    count = min(Q + 1, M)
    chosen = [rng.choice(M, count, replace=False) for _ in range(_TRIED_PLACES)]
    tried = np.vstack([anchors, [rng.dirichlet(np.ones(count)) @ anchors[k] for k in chosen]])  # [T, Q]
    apart = np.linalg.norm(tried[:, None] - anchors[None], axis=2)  # [T, M]
    wanted = np.maximum(distance, 1e-2 * np.median(distance[distance > 0.0]))
    places = np.empty((N, Q))
    for first in range(0, N, _AT_ONCE):
        D = wanted[first : first + _AT_ONCE]  # [n, M]
        stress = np.sum((apart[None] - D[:, None]) ** 2 / D[:, None], axis=2)  # [n, T]
        starts = np.argsort(stress, axis=1, kind="stable")[:, :_STARTS]
        x = tried[starts]  # [n, S, Q]
        weight = 1.0 / D
        for _ in range(_STEPS):
            away = x[:, :, None] - anchors  # [n, S, M, Q]
            ratio = D[:, None] / np.sqrt(np.sum(away**2, axis=3) + 1e-12)
            x = (
                np.einsum("nm,nsmq->nsq", weight, anchors + ratio[..., None] * away)
                / weight.sum(axis=1)[:, None, None]
            )
        off = np.linalg.norm(x[:, :, None] - anchors, axis=3) - D[:, None]
        best = np.sum(off**2 * weight[:, None], axis=2).argmin(axis=1)
        places[first : first + _AT_ONCE] = x[np.arange(len(D)), best]
    return places


def _local_blends(
    shares: Array, landmarks: Indices, nearest: Indices, radius: float, cost: LocalCost, weight: float
) -> Term:
    """Mean cost, times a weight, of the blends of the nearest samples (K, n) at the places `shares @ X[landmarks]`."""

    def term(X: Array) -> tuple[float, Array]:
        D = np.ascontiguousarray(
            ((shares @ X[landmarks])[:, None] - X[nearest]).transpose(2, 0, 1)
        )  # [Q, K, n]
        u, squared = soft_weights(D, radius)
        value, slope = cost(u, nearest)
        d_D = pulled_back(D, u, squared, weight * slope / len(shares), radius)
        of_nearest = np.ascontiguousarray(d_D.reshape(len(d_D), -1).T)
        gradient = -add_rows(nearest.ravel(), of_nearest, len(X))
        gradient[landmarks] += shares.T @ d_D.sum(axis=2).T
        return weight * float(value.mean()), gradient

    return term
