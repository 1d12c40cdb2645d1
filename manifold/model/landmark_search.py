"""Places of new materials on a map by landmarks: first among the landmarks, then among the materials around."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from manifold.latent.colour_paths import sample_rows
from manifold.latent.decoder import EncodingPairs
from manifold.metrics import relative_error
from manifold.model.appearance import appearance_pairs, roots_at
from manifold.model.blend_space import BlendSpace, PlaceSearch, Rows
from manifold.model.latent_space import Embedded
from manifold.model.materials import MaterialCache
from manifold.records import Array, Indices

SIGNATURE = 32
"""Number of landmarks by whose products with a material those like it are found, at most."""

_AROUND, _ALIKE = 64, 16  # candidates: nearest on the map, and most alike in their own colours
_ROUNDS = 3  # of searches, each around the place that the one before found
_MOVED = 1.0  # length scales: a place farther than this from where it was looked for is looked for again
_RIDGE = 1e-6  # relative to the mean squared norm: landmarks may be alike


def signatures(gram: Array, products: Array) -> Array:
    """Coordinates (N, r) of materials in an orthonormal basis of the span of r landmarks.

    Distances of coordinates are those of the materials, in cube roots, as far as they lie in the span.

    Args:
        gram: inner products of the landmarks, shape (r, r).
        products: of materials with the landmarks, shape (N, r).
    """
    gram = gram.astype(np.float64)
    L = cholesky(gram + _RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram)), lower=True)
    return np.asarray(solve_triangular(L, products.T.astype(np.float64), lower=True).T)


class LandmarkSearch:
    """`PlaceSearch` on a map by landmarks, among few of the materials.

    Args:
        space: the map.
        samples: cube roots of its samples, shape (N B_s, P).
        target_bands: which bands targets have; by default all of the space.
    """

    def __init__(self, space: BlendSpace, samples: Rows, target_bands: Indices | None = None) -> None:
        assert space.landmarks is not None
        assert space.signatures is not None
        self._space, self._samples, self._target_bands = space, samples, target_bands
        self._landmarks, self._signatures = space.landmarks, space.signatures
        of_landmarks = samples[sample_rows(self._landmarks, len(space.bands))]
        self._weight = appearance_pairs().weight(of_landmarks)
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
        """The latent of a material with values f (B, P) in all bands at the embedding pairs."""
        space, pairs = self._space, appearance_pairs()
        x, colours, residual = self.find(np.cbrt(np.maximum(f, 0.0)), space.bands)
        predicted = combined(space.weights(x, colours), self._samples)[:, : pairs.n_grid] ** 3
        grid = slice(None, pairs.n_grid)
        error = relative_error(f[:, grid].T, predicted.T, pairs.pairs.cosines[grid])
        return Embedded(x, colours, error, residual)

    def _alike(self, row: Array) -> Indices:
        """Materials whose own values are nearest to those of a row (1, B_s P)."""
        signature = signatures(self._some_gram, row @ self._some.T)
        apart = np.sum((self._signatures - signature) ** 2, axis=1)
        return np.argsort(apart, kind="stable")[:_ALIKE]


def combined(weights: Array, samples: Rows) -> Array:
    """Sums (B, P) of samples, of which only those that have a weight (B, n) in any band are asked for."""
    used = np.flatnonzero(np.any(weights, axis=0))
    return np.asarray(weights[:, used].astype(np.float32) @ samples[used].astype(np.float32))


class SamplesOnDemand:
    """Cube roots of the samples of a map at direction pairs, (N B_s, P); materials are read once, when asked for."""

    def __init__(self, space: BlendSpace, materials: MaterialCache, pairs: EncodingPairs) -> None:
        self._materials, self._pairs, self._bands = materials, pairs, space.bands
        self._is_known = np.zeros(len(space.X), dtype=bool)
        # Memory that is not written is not taken.
        self._values = np.empty((len(space.X) * len(space.bands), len(pairs.cosines)), dtype=np.float32)

    def __getitem__(self, rows: Indices) -> Array:
        """Rows (m, P) by their indices (m,)."""
        asked = np.unique(rows // len(self._bands))
        new = asked[~self._is_known[asked]]
        if len(new):
            names = [self._materials.names[i] for i in new]
            read = self._materials.in_bands(self._bands.tolist(), names=names)
            self._values[sample_rows(new, len(self._bands))] = roots_at(read, self._pairs)
            self._is_known[new] = True
        return np.asarray(self._values[rows])
