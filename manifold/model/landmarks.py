"""Lays out maps of thousands of materials: first the landmarks, as on a small map, then the others among them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy

from manifold.core.defaults import RIDGE
from manifold.core.metrics import relative_error
from manifold.core.pairs import Pairs
from manifold.core.records import Array, Indices
from manifold.gp.encoding import encoding_pairs
from manifold.model.blend_space import BlendSpace, PlaceSearch, Rows
from manifold.model.blending import START_NOISE, LayoutObjective, affinities
from manifold.model.colour_paths import sample_rows
from manifold.model.decoding import appearance_weight, roots_at
from manifold.model.latent_space import Embedded
from manifold.model.materials import MaterialCache

_COMPARED = 30  # samples that each sample is compared with
_LIMITS = {"maxiter": 240, "maxfun": 360, "ftol": 1e-9, "gtol": 1e-7, "maxcor": 10}  # options of L-BFGS


def farthest_samples(count: int, distances_to: Callable[[int], Array]) -> Indices:
    """Return the indices of at most `count` samples that cover all N, each the farthest from the samples before it.

    `distances_to` returns the distances (N,) of all samples from one of them. The result is shorter if the remaining
    samples are copies.
    Source: Gonzalez 1985.
    """
    chosen = [0]
    apart = distances_to(0)
    while len(chosen) < count and apart.max() > 0.0:
        chosen.append(int(np.argmax(apart)))
        apart = np.minimum(apart, distances_to(chosen[-1]))
    return np.array(chosen)


def landmark_layout(
    landmarks: Indices, anchors: Array, to_landmarks: Array, compare: Callable[[Indices], Array]
) -> Array:
    """Return positions (N, Q) of N samples like `blend_layout`, approximately.

    Args:
        landmarks: indices of the landmarks, shape (M,).
        anchors: positions of the landmarks, shape (M, Q).
        to_landmarks: distances of all samples from the landmarks, shape (N, M).
        compare: function that returns the distances (N, n) of all samples from samples with indices (N, n).

    Every other sample starts at the mean of the anchors, weighted by its affinities. Then all positions are refined.
    A sample is attracted by landmarks and by samples with similar distances from the landmarks, and repelled by all.
    For each sample, distances to a fixed number of others are computed. Only the repulsion, a compiled loop, takes a
    time quadratic in N.

    Source: van der Maaten & Hinton 2008, section 6, for landmarks among many samples.
    """
    N = len(to_landmarks)
    X: Array = affinities(to_landmarks) @ anchors
    X[landmarks] = anchors
    X += START_NOISE * X.std() * np.random.default_rng(0).normal(size=X.shape)
    of_landmarks = np.broadcast_to(landmarks, to_landmarks.shape)
    from_landmarks = np.where(of_landmarks == np.arange(N)[:, None], np.inf, to_landmarks)
    near = _similar(to_landmarks, min(_COMPARED, N - 1))
    distance = np.where(np.isin(near, landmarks), np.inf, compare(near))
    affinity = affinities(np.hstack([from_landmarks, distance]))
    objective = LayoutObjective(np.hstack([of_landmarks, near]), affinity)
    return objective.minimise(X, limits=_LIMITS)


def _similar(to_landmarks: Array, count: int) -> Indices:
    """Return the `count` others (N, count) of each sample with the most similar distances from the landmarks (N, M)."""
    found = scipy.spatial.KDTree(to_landmarks).query(to_landmarks, count + 1)[1]
    is_other = found != np.arange(len(found))[:, None]
    is_other[is_other.all(axis=1), -1] = False  # copies of the sample came first
    return np.asarray(found[is_other].reshape(len(found), count))


SIGNATURE = 32
"""Largest number of landmarks whose inner products with a material are used to find similar materials."""

_AROUND, _ALIKE = 64, 16  # candidates: nearest on the map, and most alike in their own colours
_ROUNDS = 3  # searches, each around the place that the one before found
_MOVED = 1.0  # length scales: a place farther than this from where it was looked for is looked for again


def signatures(gram: Array, products: Array) -> Array:
    """Return coordinates (N, r) of materials in an orthonormal basis of the span of r landmarks.

    `gram` (r, r) holds the inner products of the landmarks, `products` (N, r) the inner products of materials with
    landmarks.

    Distances between coordinates equal distances between the materials' cube roots, projected on the span.
    """
    gram = gram.astype(np.float64)
    L = scipy.linalg.cholesky(gram + RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram)), lower=True)
    return np.asarray(scipy.linalg.solve_triangular(L, products.T.astype(np.float64), lower=True).T)


class LandmarkSearch:
    """Locates materials on a map with landmarks, like `PlaceSearch` but among only a few materials."""

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
        """Return the latent (Q,), colours (2, B) and residual of the material with cube roots `target` (B, P)."""
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
    """Return weighted sums (B, P) of samples with weights (B, n); only samples with a nonzero weight are read."""
    used = np.flatnonzero(np.any(weights, axis=0))
    return np.asarray(weights[:, used].astype(np.float32) @ samples[used].astype(np.float32))


class SamplesOnDemand:
    """The cube roots of a map's samples at direction pairs, (N B_s, P).

    Each material is read when it is first needed.
    """

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
