"""Places of new materials on a map by landmarks: first among the landmarks, then among the materials around."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from manifold.latent.blending import blend_weights
from manifold.latent.decoder import EncodingPairs
from manifold.mapping import CubeRoot
from manifold.metrics import relative_error
from manifold.model.appearance import appearance_pairs, roots_at
from manifold.model.blend_space import BlendSpace, PlaceSearch
from manifold.model.combination import Combination
from manifold.model.latent_space import Embedded, LeftOutSearch
from manifold.model.material_table import MaterialTable
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


def roots_of(
    space: BlendSpace, materials: MaterialCache, pairs: EncodingPairs, bands: Indices
) -> Callable[[int], Array]:
    """From the index of a material, read in some bands (B',), to cube roots of its samples at pairs, (B_s, P)."""
    at = np.searchsorted(bands, space.bands)

    def read(i: int) -> Array:
        return roots_at(materials.in_bands(bands.tolist(), names=[materials.names[i]]), pairs)[at]

    return read


def embed_among_landmarks(
    space: BlendSpace, materials: MaterialCache, pairs: EncodingPairs, f: Array
) -> Embedded:
    """The latent of a material with values f (B, P) in all bands at the embedding pairs."""
    search = LandmarkSearch(space, roots_of(space, materials, pairs, space.bands))
    x, colours, residual = search.find(np.cbrt(np.maximum(f, 0.0)), space.bands)
    used, combination = Combination(CubeRoot(), space.weights(x, colours), space.bands).used
    grid = slice(None, appearance_pairs().n_grid)
    predicted = (combination.weights @ search.samples(used)[:, grid]) ** 3
    error = relative_error(f[:, grid].T, predicted.T, pairs.cosines[grid])
    return Embedded(x, colours, error, residual)


def landmark_left_out(
    space: BlendSpace, materials: MaterialCache, bands: Indices
) -> tuple[LeftOutSearch, Callable[[int, Combination], tuple[float, float]]]:
    """A search for a material among the others, and what tells the errors of its prediction in some bands (B',).

    The errors are those of `MaterialTable.errors`; only the materials that a prediction needs are read.
    """
    pairs, at = space.embedding_pairs(materials.is_isotropic), np.searchsorted(bands, space.bands)
    search = LandmarkSearch(space, roots_of(space, materials, pairs, bands), bands)

    def find(i: int) -> tuple[Array, Combination, float]:
        (brdf,) = materials.in_bands(bands.tolist(), names=[materials.names[i]])
        x, colours, residual = search.find(roots_at([brdf], pairs), at, without=i)
        others = np.delete(np.arange(len(space.X)), i)
        u = np.zeros(len(space.X))
        u[others] = blend_weights(x[None], space.X[others], space.kernel.length_scale)[0]
        return (
            x,
            Combination(CubeRoot(), space.paths.weights(u, colours[0]) * colours[1][:, None], at),
            residual,
        )

    def measure(i: int, combination: Combination) -> tuple[float, float]:
        used, some = combination.used
        brdfs = materials.in_bands(bands.tolist(), names=[materials.names[k] for k in used])
        (truth,) = materials.with_negative_values(names=[materials.names[i]])
        table = MaterialTable([*brdfs, truth.select_bands(bands.tolist())], np.arange(len(bands)))
        weights = np.pad(some.weights, ((0, 0), (0, len(space.bands))))  # the material itself has none
        return table.errors(len(used), replace(some, weights=weights))

    return find, measure


class LandmarkSearch:
    """`PlaceSearch` on a map by landmarks, which reads the landmarks and few other materials.

    Args:
        space: the map.
        roots: from the index of a material to cube roots of its samples, (B_s, P); asked once for each.
        target_bands: which bands targets have; by default all of the space.
    """

    def __init__(
        self, space: BlendSpace, roots: Callable[[int], Array], target_bands: Indices | None = None
    ) -> None:
        assert space.landmarks is not None
        assert space.signatures is not None
        self._space, self._target_bands = space, target_bands
        self._landmarks, self._signatures = space.landmarks, space.signatures
        self._read, self._known = roots, dict[int, Array]()
        samples = self.samples(self._landmarks)
        self.weight = appearance_pairs().weight(samples)
        self._coarse = PlaceSearch(space.of_landmarks, samples, self.weight, target_bands)
        self._some = (samples * self.weight).reshape(len(self._landmarks), -1)[: self._signatures.shape[1]]

    def find(self, target: Array, bands: Indices, without: int | None = None) -> tuple[Array, Array, float]:
        """Place (Q,), colours (2, B) and residual of a material, as `PlaceSearch.find`."""
        left_out = None
        if without is not None and without in self._landmarks:
            left_out = int(np.flatnonzero(self._landmarks == without)[0])
        x, *_ = self._coarse.find(target, bands, left_out)
        alike = self._alike((target[bands] * self.weight).reshape(1, -1))
        for _ in range(_ROUNDS):
            before = x
            chosen = np.unique(np.append(self._space.neighbours(x, _AROUND), alike))
            x, colours, residual = self._search(chosen[chosen != without]).find(target, bands)
            if np.linalg.norm(x - before) <= _MOVED * self._space.kernel.length_scale:
                break
        return x, colours, residual

    def _search(self, chosen: Indices) -> PlaceSearch:
        """Among some materials (n,), whose colour paths are made of samples of the landmarks too."""
        table = np.union1d(chosen, self._landmarks)
        some, candidates = self._space.subset(table), np.searchsorted(table, chosen)
        return PlaceSearch(some, self.samples(table), self.weight, self._target_bands, candidates)

    def samples(self, materials: Indices) -> Array:
        """Cube roots of the samples of materials (n,), shape (n B_s, P)."""
        for i in materials.tolist():
            if i not in self._known:
                self._known[i] = self._read(i).astype(np.float32)
        return np.concatenate([self._known[i] for i in materials.tolist()])

    def _alike(self, row: Array) -> Indices:
        """Materials whose own values are nearest to those of a row (1, B_s P)."""
        signature = signatures(self._some @ self._some.T, row @ self._some.T)
        apart = np.sum((self._signatures - signature) ** 2, axis=1)
        return np.argsort(apart, kind="stable")[:_ALIKE]
