"""Maps of thousands of materials: landmarks are laid out exactly, the others located among them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from manifold.core.metrics import relative_error
from manifold.core.pairs import Pairs
from manifold.core.records import Array, Indices
from manifold.gp.encoding import encoding_pairs
from manifold.model.blend_space import BlendSpace, PlaceSearch, Rows
from manifold.model.blending import (
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
from manifold.model.colour_paths import sample_rows
from manifold.model.decoding import appearance_weight, roots_at
from manifold.model.latent_space import Embedded
from manifold.model.materials import MaterialCache

_TRIED_PLACES, _STARTS = 150, 3  # places tried for a sample among the landmarks, and searches from them
_STEPS = 60  # steps of each search
_AT_ONCE = 64  # samples whose places are tried together
_COMPARED = 12  # neighbours that a sample is compared with
_COMPARE_AGAIN = 4  # steps after which neighbours are found again
_BLENDED = 64  # nearest samples that make a blend
_LEAST_PLACES = 1500  # number of blends evaluated, if there are fewer samples
_LIMITS = {"maxiter": 40, "maxfun": 60, "ftol": 1e-9, "gtol": 1e-7, "maxcor": 10}  # options of L-BFGS

LocalCost = Callable[[Array, Indices], tuple[Array, Array]]
"""A function from weights u (K, n) of blends of samples (K, n) to their cost (K,) and its gradient by u (K, n)."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """Samples beside others (N, n), by target and least distances (N, n)."""

    others: Indices
    distance: Array
    separation: Array


def farthest_samples(count: int, distances_to: Callable[[int], Array]) -> Indices:
    """Return at most `count` samples that cover all, each the farthest from those before it.

    Distances (N,) of all samples from one are given; the result is shorter if the other samples are copies.
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
    """Return places of N samples, in length scales of `blend_weights`, centred; an approximation of `blend_layout`.

    Every sample is located by its distances from the landmarks (M,), whose layout is given. Then all are refined: the
    stress over pairs with landmarks, which stand for all pairs, and with neighbours; least distances of the same pairs;
    and the cost of blends of the nearest samples, with rising weight in damped steps.
    Source: de Silva & Tenenbaum 2004 (landmark scaling); Kruskal 1964 for the stress.
    """
    rng = np.random.default_rng(0)
    anchors = map_of_landmarks.X * map_of_landmarks.unit
    X = _located(anchors, to_landmarks.distance, rng)
    X[landmarks] = anchors
    start, N = X, len(X)
    for step, weight in enumerate(RISING):
        tree = scipy.spatial.KDTree(X)
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
    """Return places (N, Q) whose distances from anchors (M, Q) are relatively nearest to (N, M), the best of several.

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
    """Return the mean cost, times a weight, of blends of the nearest samples (K, n).

    Blends lie at the places `shares @ X[landmarks]`.
    """

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


SIGNATURE = 32
"""Number of landmarks by whose products with a material those like it are found, at most."""

_AROUND, _ALIKE = 64, 16  # candidates: nearest on the map, and most alike in their own colours
_ROUNDS = 3  # searches, each around the place that the one before found
_MOVED = 1.0  # length scales: a place farther than this from where it was looked for is looked for again
_RIDGE = 1e-6  # relative to the mean squared norm: landmarks may be alike


def signatures(gram: Array, products: Array) -> Array:
    """Return coordinates (N, r) of materials in an orthonormal basis of the span of r landmarks.

    `gram` holds inner products of the landmarks, (r, r), `products` those of materials with them, (N, r).

    Distances of coordinates are those of the materials, in cube roots, as far as they lie in the span.
    """
    gram = gram.astype(np.float64)
    L = scipy.linalg.cholesky(gram + _RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram)), lower=True)
    return np.asarray(scipy.linalg.solve_triangular(L, products.T.astype(np.float64), lower=True).T)


class LandmarkSearch:
    """`PlaceSearch` on a map by landmarks, among few of the materials; samples and target bands as there."""

    def __init__(self, space: BlendSpace, samples: Rows, target_bands: Indices | None = None) -> None:
        assert space.landmarks is not None
        assert space.signatures is not None
        self._space, self._samples, self._target_bands = space, samples, target_bands
        self._landmarks, self._signatures = space.landmarks, space.signatures
        of_landmarks = samples[sample_rows(self._landmarks, len(space.bands))]
        self._weight = appearance_weight(of_landmarks)
        self._coarse = PlaceSearch(space.of_landmarks, of_landmarks, self._weight, target_bands)
        few = (of_landmarks * self._weight).reshape(len(self._landmarks), -1)
        self._some = few[: self._signatures.shape[1]]
        self._some_gram = self._some @ self._some.T

    def find(self, target: Array, bands: Indices, without: int | None = None) -> tuple[Array, Array, float]:
        """Place (Q,), colours (2, B) and residual of a material, as `PlaceSearch.find`."""
        left_out = None
        if without is not None and without in self._landmarks:
            left_out = int(np.flatnonzero(self._landmarks == without)[0])
        x = self._coarse.first_place(target, bands, left_out)
        alike = self._alike((target[bands] * self._weight).reshape(1, -1))
        for _ in range(_ROUNDS):
            before = x
            chosen = np.unique(np.append(self._space.neighbours(x, _AROUND), alike))
            candidates = chosen[chosen != without]
            search = PlaceSearch(self._space, self._samples, self._weight, self._target_bands, candidates)
            x, colours, residual = search.find(target, bands)
            if np.linalg.norm(x - before) <= _MOVED * self._space.kernel.length_scale:
                break
        return x, colours, residual

    def embed(self, f: Array) -> Embedded:
        """Return the latent of a material with values f (B, P) in all bands at the embedding pairs."""
        space, cosines = self._space, encoding_pairs().cosines
        x, colours, residual = self.find(np.cbrt(np.maximum(f, 0.0)), space.bands)
        predicted = combined(space.weights(x, colours), self._samples)[:, : len(cosines)] ** 3
        error = relative_error(f[:, : len(cosines)].T, predicted.T, cosines)
        return Embedded(x, colours, error, residual)

    def _alike(self, row: Array) -> Indices:
        """Return the materials whose own values are nearest to those of a row (1, B_s P)."""
        signature = signatures(self._some_gram, row @ self._some.T)
        apart = np.sum((self._signatures - signature) ** 2, axis=1)
        return np.argsort(apart, kind="stable")[:_ALIKE]


def combined(weights: Array, samples: Rows) -> Array:
    """Return sums (B, P) of samples; only samples with a weight (B, n) in any band are read."""
    used = np.flatnonzero(np.any(weights, axis=0))
    return np.asarray(weights[:, used].astype(np.float32) @ samples[used].astype(np.float32))


class SamplesOnDemand:
    """Cube roots of the samples of a map at direction pairs, (N B_s, P); materials are read once, when asked for."""

    def __init__(self, space: BlendSpace, materials: MaterialCache, pairs: Pairs) -> None:
        self._materials, self._pairs, self._bands = materials, pairs, space.bands
        self._is_known = np.zeros(len(space.X), dtype=bool)
        # Memory that is not written is not taken.
        self._values = np.empty((len(space.X) * len(space.bands), len(pairs)), dtype=np.float32)

    def __getitem__(self, rows: Indices) -> Array:
        """Return rows (m, P) by their indices (m,)."""
        asked = np.unique(rows // len(self._bands))
        new = asked[~self._is_known[asked]]
        if len(new):
            names = [self._materials.names[i] for i in new]
            read = self._materials.in_bands(self._bands.tolist(), names=names)
            self._values[sample_rows(new, len(self._bands))] = roots_at(read, self._pairs)
            self._is_known[new] = True
        return np.asarray(self._values[rows])
