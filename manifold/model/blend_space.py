"""The latent space of blends: every point is a non-negative combination of the surrounding materials."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Protocol

import numpy as np
import scipy

from manifold.core.defaults import TINY
from manifold.core.errors import UsageError
from manifold.core.mapping import CubeRoot, ValueMapping
from manifold.core.metrics import relative_error
from manifold.core.pairs import Pairs
from manifold.core.records import AnyArray, Array, Indices
from manifold.gp.encoding import Decoder, encoding_pairs
from manifold.gp.kernels import Kernel, first_equal_row
from manifold.gpr import GaussianProcess
from manifold.model.blending import NEIGHBOURS, blend_weights, nearest_distance, widest_gap
from manifold.model.colour_paths import ColourPaths, between, interpolate, sample_rows
from manifold.model.combination import Combination
from manifold.model.decoding import appearance_pairs, appearance_weight, roots_at
from manifold.model.latent_space import Embedded, LatentSpace, LeftOutSearch, require_bands, require_shapes
from manifold.model.materials import MaterialCache, MaterialTable
from manifold.model.settings import Settings

# Places that the search for a new material's place tries, and refines.
_TRIED_PLACES, _REFINED_PLACES = 150, 3
_EVALUATIONS = 150  # evaluations of each refinement
_COORDINATES = 33  # coordinates of a path that the search tries
_FIRST_COORDINATE = 0.05
_ENDS, _SPARSE = ("dark", "bright"), ("_data", "_indices", "_indptr")


@dataclass(frozen=True, eq=False, repr=False)
class BlendSpace(LatentSpace):
    """The latent space of kind `blend`, whose predictions are non-negative combinations of materials.

    Predictions have colours blended from the materials, or given colours.

    Attributes:
        X: latents of the materials, in length scales, shape (N, Q).
        paths: colour path of every material from black to white, for given colours.
        bands: indices of the bands that are samples of the paths, increasing, shape (B_s,).
        reflectances: reflectances of the materials at 8 degrees, specular included, shape (N, B).
        kernel: covariance function that determines how far from the materials predictions are supported.
        landmarks: indices of the materials on whose map all others were located, in any order, shape (M,); None if
            all materials were laid out together.
        signatures: coordinates by which similar materials are found, shape (N, r); None without landmarks.
    """

    X: Array
    paths: ColourPaths
    bands: Indices
    reflectances: Array
    kernel: Kernel
    landmarks: Indices | None = None
    signatures: Array | None = None
    kind: ClassVar[str] = "blend"
    takes_colours: ClassVar[bool] = True
    is_nonnegative: ClassVar[bool] = True

    @property
    def arrays(self) -> dict[str, AnyArray]:
        """The arrays that a file stores, by name."""
        p = self.paths
        arrays = {
            "X": self.X, "bands": self.bands, "reflectances": self.reflectances,
            "dark_coordinate": p.dark_coordinate, "bright_coordinate": p.bright_coordinate,
            "sample_reflectances": p.reflectances,
        }  # fmt: skip
        for end in _ENDS:
            rows = getattr(p, end)
            arrays |= {end + part: getattr(rows, part[1:]) for part in _SPARSE}
        if self.landmarks is not None and self.signatures is not None:
            arrays |= {"landmarks": self.landmarks, "signatures": self.signatures}
        return arrays

    @classmethod
    def from_arrays(cls, stored: Mapping[str, Array], kernel: Kernel, n_bands: int) -> BlendSpace:
        """Restore the space from a file's arrays.

        Raises ValueError if the arrays have shapes that do not fit each other or the number of bands.
        """
        X, bands = stored["X"], require_bands(stored, n_bands)
        N, n = len(X), len(X) * len(bands)
        shapes = {
            "reflectances": (N, n_bands), "dark_coordinate": (N,), "bright_coordinate": (N,),
            "sample_reflectances": (n,),
        }  # fmt: skip
        reflectances, *of_paths = require_shapes(stored, shapes)
        ends = []
        for end in _ENDS:
            data, *where = (stored[end + part] for part in _SPARSE)
            rows = scipy.sparse.csr_array((data, *(part.astype(np.int64) for part in where)), (N, n))
            rows.check_format(full_check=True)
            ends.append(rows)
        paths = ColourPaths(*ends, *of_paths)
        if "landmarks" not in stored:
            return cls(X, paths, bands, reflectances, kernel)
        landmarks, signatures = stored["landmarks"].astype(np.int64), stored["signatures"]
        if len(set(landmarks.tolist())) < len(landmarks) or not set(landmarks.tolist()) <= set(range(N)):
            raise ValueError("dataset 'landmarks' holds no indices of different materials")
        require_shapes(stored, {"signatures": (N, signatures.shape[-1])})
        return cls(X, paths, bands, reflectances, kernel, landmarks, signatures)

    def subset(self, materials: Indices, length_scale: float = 1.0) -> BlendSpace:
        """Return a map of some of the materials (n,) at their latents, without landmarks.

        `length_scale` is a factor by which the kernel's length scale is multiplied.
        """
        kernel = replace(self.kernel, length_scale=self.kernel.length_scale * length_scale)
        paths, reflectances = self.paths.subset(materials), self.reflectances[materials]
        return BlendSpace(self.X[materials], paths, self.bands, reflectances, kernel)

    @cached_property
    def of_landmarks(self) -> BlendSpace:
        """Return the map of the landmarks, with a length scale that suits their distances.

        A map without landmarks is returned itself.
        """
        if self.landmarks is None:
            return self
        return self.subset(self.landmarks, (len(self.X) / len(self.landmarks)) ** (1.0 / self.X.shape[1]))

    @cached_property
    def gp(self) -> GaussianProcess:
        """Return the Gaussian process of the materials or, to bound its cubic cost, of the landmarks."""
        return super().gp if self.landmarks is None else self.of_landmarks.gp

    def around(self, x: Array) -> tuple[Indices, BlendSpace] | None:
        """Return the indices of the materials near x (Q,) and of the landmarks, and the map of only these.

        Predictions at x depend on no other materials: colour paths are made of the landmarks' samples. None without
        landmarks.
        """
        if self.landmarks is None:
            return None
        materials = np.union1d(self.landmarks, self.neighbours(x, NEIGHBOURS + 1))
        return materials, self.subset(materials)

    def neighbours(self, x: Array, count: int) -> Indices:
        """Return the indices of the `count` materials nearest to x (Q,), nearest first, or of all."""
        return np.argsort(np.sum((self.X - x) ** 2, axis=1), kind="stable")[:count]

    def printed(self, x: Array) -> tuple[str, ...]:
        """Return the coordinates of a point (Q,) as text; three decimals suffice to reproduce its prediction."""
        return tuple(f"{v:.3f}" for v in x)

    def weights(self, x: Array, colours: Array | None) -> Array:
        """Return the weights of a prediction at x (Q,).

        They are weights of materials, shape (N,), or with given colours, weights of samples in every band, shape (B,
        N B_s).
        """
        u = self.material_weights(x[None], None)[0]
        if colours is None:
            return u
        coordinates, gains = colours if colours.ndim == 2 else (colours, 1.0)
        return self.paths.weights(u, coordinates) * np.reshape(gains, (-1, 1))

    def combination(self, x: Array, colours: Array | None, mapping: ValueMapping) -> Combination:
        """Return the prediction at x (Q,) as a weighted sum of materials or, with given colours, of single bands."""
        k = self.training_index(x, colours)
        if k is not None:
            return Combination(mapping, np.eye(len(self.X))[k])
        return Combination(mapping, self.weights(x, colours), None if colours is None else self.bands)

    def material_weights(self, X: Array, colours: Array | None) -> Array:
        """Return the weights of the materials at latents X (M, Q), shape (M, N); they do not depend on the colours."""
        return blend_weights(X, self.X, self.kernel.length_scale)

    def weights_without(self, i: int, x: Array) -> Array:
        """Return the weights of the materials at x (Q,) if material i is left out, shape (N,)."""
        others = np.delete(np.arange(len(self.X)), i)
        u = np.zeros(len(self.X))
        u[others] = blend_weights(x[None], self.X[others], self.kernel.length_scale)[0]
        return u

    def training_index(self, x: Array, colours: Array | None) -> int | None:
        """Return the index of the material at x (Q,) if the colours are its own, otherwise None."""
        k = int(first_equal_row(x[None], self.X)[0])
        is_own = colours is None or np.array_equal(colours, self.own_colours[k])
        return k if k >= 0 and is_own else None

    def reflectance_of(self, x: Array, colours: Array, decoder: Decoder, measure: Array) -> Array:
        """Return the reflectance (B,) of the prediction at x (Q,) with given colours.

        `measure` (P,) integrates the decoder's outputs to a reflectance.
        """
        return (self.weights(x, colours) @ decoder.mapped) ** 3 @ measure

    def colours_of(
        self, x: Array, reflectance: Array, decoder: Decoder, measure: Array
    ) -> tuple[Array, Array]:
        """Return the colour coordinates (B,) for a reflectance (B,) at x (Q,), and the reflectance reached (B,)."""
        u = self.material_weights(x[None], None)[0]
        return self.paths.coordinates_of(u, reflectance, decoder.mapped, measure)

    @cached_property
    def own_colours(self) -> Array:  # type: ignore[override]
        """Return the colour coordinates of the materials' own reflectances, shape (N, B)."""
        return np.cbrt(np.maximum(self.reflectances, 0.0))

    def embedding_bands(self, n_bands: int) -> Indices:
        """Return the indices of the bands that are compared to locate a material: those on the colour paths."""
        return self.bands

    def embedding_pairs(self, is_isotropic: bool = True) -> Pairs:
        """Return the direction pairs of the encoding grid and of a ball."""
        return appearance_pairs(is_isotropic)

    def embed(self, decoder: Decoder, f: Array, settings: Settings) -> Embedded:
        """Locate a material with values f (B, P) in all bands: return its latent, colour coordinates and gains.

        The search minimises the cube-root error.
        """
        samples, n_grid = decoder.mapped, len(encoding_pairs())
        search = PlaceSearch(self, samples, appearance_weight(samples))
        x, colours, residual = search.find(np.cbrt(np.maximum(f, 0.0)), self.bands)
        predicted = (self.weights(x, colours) @ samples[:, :n_grid]) ** 3
        error = relative_error(f[:, :n_grid].T, predicted.T, decoder.cosines[:n_grid])
        return Embedded(x, colours, error, residual)

    def left_out_search(
        self, table: MaterialTable, materials: MaterialCache, settings: Settings
    ) -> LeftOutSearch:
        """Return a function that locates each material among the others.

        The colour paths stay as they are, even if they contain samples of the left-out material.
        """
        N, B, pairs = len(self.X), len(self.bands), self.embedding_pairs(materials.is_isotropic)
        at = np.searchsorted(table.bands, self.bands)
        roots = roots_at(table.materials, pairs).reshape(N, len(table.bands), -1)
        samples = roots[:, at].reshape(N * B, -1)
        search = PlaceSearch(self, samples, appearance_weight(samples), table.bands)

        def find(i: int) -> tuple[Array, Combination, float]:
            x, colours, residual = search.find(roots[i], at, without=i)
            every = np.zeros((self.reflectances.shape[1], N * B))
            in_colours = self.paths.weights(self.weights_without(i, x), colours[0])
            every[table.bands] = in_colours * colours[1][:, None]
            return x, Combination(CubeRoot(), every, self.bands), residual

        return find


def require_blends(space: LatentSpace) -> BlendSpace:
    """Return `space` if it is of kind `blend`. Raises UsageError for another kind."""
    if not isinstance(space, BlendSpace):
        raise UsageError(f"a map of kind {space.kind}, expected blend: embed the library with that kind")
    return space


class Rows(Protocol):
    """A table (n, P) whose rows may be read on demand."""

    def __getitem__(self, rows: Indices) -> Array:
        """Return rows (m, P) by their indices (m,)."""


class PlaceSearch:
    """Finds the latent at which a blend is nearest to a material, with a colour coordinate and a gain per band.

    Colour coordinates are tried on a grid; at the materials, their own colours are tried as well. `samples` are cube
    roots (n, P), and `weight` (P,) multiplies errors at direction pairs before they are squared. `target_bands` are
    the bands of the targets, by default all, and `candidates` the materials among which the search runs, by default
    all.
    """

    def __init__(
        self, space: BlendSpace, samples: Rows, weight: Array, target_bands: Indices | None = None,
        candidates: Indices | None = None,
    ) -> None:  # fmt: skip
        materials, n_bands = np.arange(len(space.X)) if candidates is None else candidates, len(space.bands)
        own = samples[sample_rows(materials, n_bands)]
        self._X, self._l, self._weight = (
            space.X[materials],
            space.kernel.length_scale,
            weight.astype(own.dtype),
        )
        self._own = own.reshape(len(materials), n_bands, -1) * self._weight
        own_colours = space.own_colours[materials]
        self._own_colours = own_colours if target_bands is None else own_colours[:, target_bands]
        paths = [space.paths.vertices[k] for k in materials.tolist()]
        self._coordinates = [coordinates for coordinates, _, _ in paths]
        self._starts = np.cumsum([0, *(len(coordinates) for coordinates in self._coordinates)])
        at_vertices = [W.astype(own.dtype) @ samples[made_of] for _, made_of, W in paths]
        self._at_vertices = np.concatenate(at_vertices) * self._weight  # [V, P]
        self._grid = np.linspace(_FIRST_COORDINATE, space.paths.last, _COORDINATES)
        found = [between(coordinates, self._grid) for coordinates in self._coordinates]
        lower = [start + k for start, (k, _) in zip(self._starts[:-1], found, strict=True)]
        self._lower = np.stack(lower, axis=1)  # [K, N']
        self._t = np.stack([t for _, t in found], axis=1)[..., None]  # [K, N', 1]
        products = (self._at_vertices @ self._at_vertices.T).astype(np.float64)
        of_rows = (self._on_grid(products, k).T for k in range(_COORDINATES))
        self._gram = np.stack([self._on_grid(rows, k) for k, rows in enumerate(of_rows)])  # [K, N', N']

    def find(self, target: Array, bands: Indices, without: int | None = None) -> tuple[Array, Array, float]:
        """Locate a target; return its latent (Q,), colour coordinates and gains (2, B), and cube-root residual.

        `target` (B, P) holds cube roots of the material in all bands. The latent is found from the sample bands,
        whose indices are `bands`. The candidate `without` is left out.
        """
        weighted, used, found = self._of(target, without)
        norm = float(np.sum(weighted[bands] ** 2))
        x, residual = found.place(bands, norm)
        # Materials in their own colours, each band by the best gain.
        own = self._own[used]
        inner = np.maximum(np.einsum("nbp,bp->nb", own, weighted[bands]), 0.0)
        squared = np.maximum(np.einsum("nbp,nbp->nb", own, own), TINY)
        of_own = norm - np.sum(inner**2 / squared, axis=1)
        nearest = int(np.argmin(of_own))
        relative = float(np.sqrt(max(min(of_own[nearest], residual), 0.0) / max(norm, TINY)))
        if of_own[nearest] >= residual:
            k, gains = found.coordinates(x)
            return x, np.stack([self._grid[k], gains]), relative
        material = int(used[nearest])
        vertices = self._at_vertices[self._starts[material] : self._starts[material + 1]]
        in_all = interpolate(self._coordinates[material], self._own_colours[material], vertices)  # [B, P]
        inner = np.maximum(np.einsum("bp,bp->b", in_all, weighted), 0.0)
        gains = inner / np.maximum(np.einsum("bp,bp->b", in_all, in_all), TINY)
        return self._X[material], np.stack([self._own_colours[material], gains]), relative

    def first_place(self, target: Array, bands: Indices, without: int | None) -> Array:
        """Return the best of the latents (Q,) from which `find` starts; the arguments are those of `find`."""
        weighted, _, found = self._of(target, without)
        return found.starts(bands, float(np.sum(weighted[bands] ** 2)))[0]

    def _of(self, target: Array, without: int | None) -> tuple[Array, Indices, _BestPlace]:
        """Return a weighted target, (B, P), the candidates for it, (M,), and the search among them."""
        weighted = target.astype(self._weight.dtype) * self._weight
        at_vertices = (self._at_vertices @ weighted.T).astype(np.float64)  # [V, B]
        cross = np.stack([self._on_grid(at_vertices, k) for k in range(_COORDINATES)], axis=1)  # [N', K, B]
        used, gram = np.arange(len(self._X)), self._gram
        if without is not None:
            used = np.delete(used, without)
            cross, gram = cross[used], gram[:, used][:, :, used]
        return weighted, used, _BestPlace(self._X[used], self._l, cross, gram)

    def _on_grid(self, at_vertices: Array, k: int) -> Array:
        """Interpolate values at the vertices of all paths, (V, ...), to coordinate k of the grid, (N', ...)."""
        lower, t = self._lower[k], self._t[k]
        return (1.0 - t) * at_vertices[lower] + t * at_vertices[lower + 1]


class _BestPlace:
    """The search for a point on the map of N materials at X (N, Q), from inner products only.

    `cross` (N, K, B) holds the products of the materials' paths at K coordinates with the target, `gram` (K, N, N) the
    products of the paths with each other.
    """

    def __init__(self, X: Array, length_scale: float, cross: Array, gram: Array) -> None:
        self._X, self._l, self._cross, self._gram = X, length_scale, cross, gram

    def place(self, bands: Indices, norm: float) -> tuple[Array, float]:
        """Return the point (Q,) with the smallest squared residual in some bands, and that residual.

        `norm` is the target's squared norm there.
        """
        residuals, Q = self._residuals(bands, norm), self._X.shape[1]
        steps = np.vstack([np.zeros(Q), 0.2 * self._l * np.eye(Q)])
        ends = [
            scipy.optimize.minimize(
                lambda x: float(residuals(x[None])[0]), x, method="Nelder-Mead",
                options={"initial_simplex": x + steps, "maxfev": _EVALUATIONS},
            )
            for x in self.starts(bands, norm)
        ]  # fmt: skip
        best = min(ends, key=lambda end: float(end.fun))
        return np.asarray(best.x), float(best.fun)

    def starts(self, bands: Indices, norm: float) -> Array:
        """Return the best of the materials' points and random blends of three, the best first, shape (S, Q)."""
        X, rng = self._X, np.random.default_rng(0)
        count = min(3, len(X))
        chosen = [rng.choice(len(X), count, replace=False) for _ in range(_TRIED_PLACES)]
        places = np.vstack([X, [rng.dirichlet(np.ones(count)) @ X[k] for k in chosen]])
        order = np.argsort(self._residuals(bands, norm)(places), kind="stable")
        return places[order[:_REFINED_PLACES]]

    def _residuals(self, bands: Indices, norm: float) -> Callable[[Array], Array]:
        """Return squared residuals (M,) as a function of points (M, Q); infinite if the data do not support blends."""
        X, cross, reach = self._X, self._cross[:, :, bands], widest_gap(self._X)

        def residuals(x: Array) -> Array:
            inner, squared = self._products(x, cross)
            residual = norm - np.sum(np.max(inner**2 / squared, axis=1), axis=1)
            return np.where(nearest_distance(x, X) <= reach, residual, np.inf)

        return residuals

    def coordinates(self, x: Array) -> tuple[Indices, Array]:
        """Return the index of each band's best path coordinate at a point x (Q,), and its gain, (B,) each."""
        inner, squared = (found[0] for found in self._products(x[None], self._cross))
        k = np.argmax(inner**2 / squared, axis=0)
        return k, inner[k, np.arange(len(k))] / squared[k, 0]

    def _products(self, x: Array, cross: Array) -> tuple[Array, Array]:
        """Return products of blends at points (M, Q) with a target, at least 0, and squared norms.

        Their shapes are (M, K, B) and (M, K, 1).
        """
        u = blend_weights(x, self._X, self._l)
        near = np.flatnonzero(u.any(axis=0))  # at a single place, few materials have a weight
        u, rows = u[:, near], self._gram[:, near[:, None], near].reshape(-1, len(near))  # [K n, n]
        squared = (u @ rows.T).reshape(len(u), -1, len(near)) @ u[:, :, None]
        return np.maximum(np.tensordot(u, cross[near], 1), 0.0), np.maximum(squared, TINY)
