"""Gives materials other colours with non-negative weights, along a path from black to white for every material.

A sample is a single band of a material, in cube roots. A vertex of a path is a set of weights of samples, and the
reflectance of their combination. A material's own bands are vertices, in the order of their reflectance. Towards
black, its Lambertian part vanishes first and its highlight last; towards white, a Lambertian part is added, or, for a
material without one, all values grow. Vertices that are not measured bands are approximated by non-negative
combinations of all bands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from manifold.core.records import Array, Indices
from manifold.gp.nonnegative import nonnegative_weights

WHITE = 0.9
"""Reflectance at the white end of a path, unless the albedo would exceed 1."""

_BODY_QUANTILE = 0.05  # quantile of the values above the horizon: the Lambertian part
_LEAST_STEP = 1e-4  # least step between the coordinates of vertices
# Coordinate of the dark vertex relative to the darkest band, of materials without a Lambertian part.
_NO_BODY = 0.3
_TABLE = 65  # coordinates at which a blend's reflectance is tabulated
_NEWTON_STEPS, _LARGEST_STEP, _PROBE = 2, 0.02, 1e-3


@dataclass(frozen=True, eq=False)
class ColourPaths:
    """The colour paths of N materials over n samples; the coordinate along a path is the cube root of the reflectance.

    Attributes:
        dark, bright: weights of the vertices below the darkest and above the brightest band, sparse, shape (N, n).
        dark_coordinate, bright_coordinate: coordinates of these vertices, shape (N,); 0 if a path has no such vertex.
        reflectances: reflectances of the samples, material by material, shape (n,).
    """

    dark: scipy.sparse.csr_array
    bright: scipy.sparse.csr_array
    dark_coordinate: Array
    bright_coordinate: Array
    reflectances: Array

    @cached_property
    def vertices(self) -> list[tuple[Array, Indices, Array]]:
        """Return the V vertices of every path, black first: coordinates (V,), and weights (V, c) of c samples.

        Each item is `(coordinates, samples, weights)`, where `samples` (c,) are the indices of the samples.
        """
        N = len(self.dark_coordinate)
        return [self._path(i, len(self.reflectances) // N) for i in range(N)]

    @cached_property
    def last(self) -> float:
        """Return the largest coordinate of any path."""
        return max(float(coordinates[-1]) for coordinates, _, _ in self.vertices)

    def weights(self, u: Array, coordinates: Array) -> Array:
        """Return the weights of the samples, shape (B, n), for a blend of materials with weights u (N,).

        `coordinates` is (B,), or (N, B) if each material has its own colour.
        """
        total = np.zeros((coordinates.shape[-1], len(self.reflectances)))
        each = np.broadcast_to(coordinates, (len(u), coordinates.shape[-1]))
        for i in np.flatnonzero(u).tolist():
            vertices, samples, W = self.vertices[i]
            total[:, samples] += u[i] * interpolate(vertices, each[i], W)
        return total

    def subset(self, materials: Indices) -> ColourPaths:
        """Return the paths of some materials (N',), made only of the samples of these materials."""
        samples = sample_rows(materials, len(self.reflectances) // len(self.dark_coordinate))
        dark, bright = (rows[materials][:, samples] for rows in (self.dark, self.bright))
        ends = (self.dark_coordinate[materials], self.bright_coordinate[materials])
        return ColourPaths(dark, bright, *ends, self.reflectances[samples])

    def coordinates_of(
        self, u: Array, reflectance: Array, samples: Array, measure: Array
    ) -> tuple[Array, Array]:
        """Return the coordinates (B,) at which a blend u (N,) has a reflectance (B,), and the reflectance reached (B,).

        `samples` are cube roots (n, P) at the direction pairs of an integrating sphere; `measure` (P,) integrates
        values there.
        """

        def reached(at: Array) -> Array:
            return (self.weights(u, at) @ samples) ** 3 @ measure

        grid = np.linspace(0.0, self.last, _TABLE)
        table = np.maximum.accumulate(reached(grid))
        at = np.interp(reflectance, table, grid)
        for _ in range(_NEWTON_STEPS):
            slope = (np.interp(at + _PROBE, grid, table) - np.interp(at - _PROBE, grid, table)) / (
                2.0 * _PROBE
            )
            off = reflectance - reached(at)
            step = np.divide(off, slope, out=np.zeros_like(at), where=slope > 1e-6)
            at = np.clip(at + np.clip(step, -_LARGEST_STEP, _LARGEST_STEP), 0.0, grid[-1])
        return at, reached(at)

    def _path(self, i: int, n_bands: int) -> tuple[Array, Indices, Array]:
        own = i * n_bands + np.argsort(self.reflectances[i * n_bands : (i + 1) * n_bands], kind="stable")
        roots = np.cbrt(np.maximum(self.reflectances[own], 0.0))
        ends = [(rows, slice(*rows.indptr[i : i + 2])) for rows in (self.dark, self.bright)]
        samples = np.unique(np.concatenate([own, *(rows.indices[here] for rows, here in ends)]))
        (dark, bright), unit = np.zeros((2, len(samples))), np.eye(len(samples))
        for end, (rows, here) in zip((dark, bright), ends, strict=True):
            end[np.searchsorted(samples, rows.indices[here])] = rows.data[here]
        coordinates, weights = [0.0], [np.zeros(len(samples))]
        first, at_own = float(roots[0]), unit[np.searchsorted(samples, own)]
        if _LEAST_STEP < self.dark_coordinate[i] < first - _LEAST_STEP:
            coordinates.append(float(self.dark_coordinate[i]))
            weights.append(dark)
        elif _NO_BODY * first > _LEAST_STEP:
            coordinates.append(_NO_BODY * first)
            weights.append(_NO_BODY * at_own[0])
        for root, w in [*zip(roots, at_own, strict=True), (float(self.bright_coordinate[i]), bright)]:
            if root > coordinates[-1] + _LEAST_STEP:
                coordinates.append(float(root))
                weights.append(w)
        if len(coordinates) == 1:  # black in every band
            coordinates.append(1.0)
            weights.append(np.zeros(len(samples)))
        return np.array(coordinates), samples, np.array(weights)


def between(vertices: Array, coordinates: Array) -> tuple[Indices, Array]:
    """Return the index of the vertex below each coordinate (B,), and the fraction of the way to the next one."""
    at = np.clip(coordinates, vertices[0], vertices[-1])
    k = np.clip(np.searchsorted(vertices, at, side="right") - 1, 0, len(vertices) - 2)
    return k, (at - vertices[k]) / (vertices[k + 1] - vertices[k])


def interpolate(vertices: Array, coordinates: Array, at_vertices: Array) -> Array:
    """Interpolate values (V, C), given at the vertices (V,) of a path, to coordinates (B,) on it; shape (B, C)."""
    k, t = between(vertices, coordinates)
    t = t[:, None].astype(at_vertices.dtype)
    return np.asarray((1.0 - t) * at_vertices[k] + t * at_vertices[k + 1])


def sample_rows(materials: Indices, n_bands: int) -> Indices:
    """Return indices of the samples of materials (N,), shape (N n_bands,)."""
    return (materials[:, None] * n_bands + np.arange(n_bands)).reshape(-1)


def fit_paths(
    samples: Array,
    cosines: Array,
    n_bands: int,
    sphere: tuple[Array, Array],
    albedo: Sequence[tuple[Array, Array]],
    landmarks: Indices | None = None,
) -> ColourPaths:
    """Fit the colour paths of materials and return them.

    Args:
        samples: cube roots of the samples at direction pairs, material by material, shape (n, P).
        cosines: cosines of the direction pairs, shape (P,).
        n_bands: number of samples per material.
        sphere: samples (n, P') at the direction pairs of an integrating sphere, and its measure (P',).
        albedo: like `sphere`, at several incidences; no path ends above an albedo of 1.
        landmarks: materials whose samples make the paths, in addition to a material's own; by default all.
    """
    reflectances = sphere[0] ** 3 @ sphere[1]
    N = len(samples) // n_bands
    shared = sample_rows(np.arange(N) if landmarks is None else landmarks, n_bands)
    atoms = samples[shared] * cosines
    gram = atoms @ atoms.T
    is_shared = np.zeros(N, dtype=bool)
    is_shared[shared // n_bands] = True

    def targets(i: int) -> Array:
        """Return the vertices of material i below its darkest and above its brightest band, (2, P); 0 for none."""
        own = np.arange(i * n_bands, (i + 1) * n_bands)
        low, high = own[np.argmin(reflectances[own])], own[np.argmax(reflectances[own])]
        f = samples[low].astype(np.float64) ** 3
        ends = [f - _body(f, cosines), np.zeros_like(f)]
        f, r = samples[high].astype(np.float64) ** 3, reflectances[high]
        if r < WHITE:
            body_share = min(np.pi * _body(f, cosines) / max(r, 1e-9), 1.0)
            gain = 1.0 + (1.0 - body_share) * (WHITE - r) / max(r, 1e-9)
            ends[1] = gain * f + body_share * (WHITE - r) / np.pi
        return np.cbrt(np.maximum(ends, 0.0)) * cosines

    found: list[tuple[Indices, Array]] = [(shared, np.zeros((2, len(shared))))] * N
    of_shared, rest = np.flatnonzero(is_shared).tolist(), np.flatnonzero(~is_shared).tolist()
    solved = nonnegative_weights(gram, np.concatenate([targets(i) @ atoms.T for i in of_shared]))
    for i, w in zip(of_shared, solved.reshape(len(of_shared), 2, -1), strict=True):
        found[i] = shared, w
    for i in rest:
        own = np.arange(i * n_bands, (i + 1) * n_bands)
        mine = samples[own] * cosines
        cross, target = atoms @ mine.T, targets(i)
        with_own = np.block([[gram, cross], [cross.T, mine @ mine.T]])
        products = np.hstack([target @ atoms.T, target @ mine.T])
        found[i] = np.append(shared, own), nonnegative_weights(with_own, products)
    dark, bright = (_rows([(columns, w[end]) for columns, w in found], len(samples)) for end in (0, 1))
    most = np.max([(bright @ values) ** 3 @ measure for values, measure in albedo], axis=0)
    bright.data *= np.repeat(np.minimum(1.0, np.cbrt(1.0 / np.maximum(most, 1e-9))), np.diff(bright.indptr))
    ends = [np.cbrt(np.maximum((rows @ sphere[0]) ** 3 @ sphere[1], 0.0)) for rows in (dark, bright)]
    return ColourPaths(dark, bright, ends[0], ends[1], reflectances)


def _rows(rows: Sequence[tuple[Indices, Array]], count: int) -> scipy.sparse.csr_array:
    """Return a sparse matrix (N, count) from rows of columns and values."""
    kept = [(columns[values > 0.0], values[values > 0.0]) for columns, values in rows]
    starts = np.cumsum([0, *(len(columns) for columns, _ in kept)])
    columns, values = (np.concatenate(parts) for parts in zip(*kept, strict=True))
    return scipy.sparse.csr_array((values, columns, starts), (len(rows), count))


def _body(f: Array, cosines: Array) -> float:
    """Return the Lambertian part of values f (P,) in 1/sr."""
    return max(float(np.quantile(f[cosines > 0.05], _BODY_QUANTILE)), 0.0)
