"""Colours with non-negative weights: a path from black to white for every material.

A vertex of a path is a set of weights over monochrome samples (single bands of materials, in cube roots) and their
reflectance. A material's own bands are vertices, in the order of their reflectance. Towards black, its Lambertian part
vanishes first and its highlight last; towards white, a Lambertian part is added, or, where there is none, all values
grow. Vertices that are no measured band are approximated by non-negative combinations of all bands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import nnls

from manifold.records import Array

WHITE = 0.9
"""Reflectance at which paths end, unless their albedo would exceed 1."""

_BODY_QUANTILE = 0.05  # of the values above the horizon: the Lambertian part
_LEAST_STEP = 1e-4  # between the coordinates of vertices
# Coordinate of the dark vertex relative to the darkest band, of materials without a Lambertian part.
_NO_BODY = 0.3
_TABLE = 65  # coordinates at which a blend's reflectance is tabulated
_NEWTON_STEPS, _LARGEST_STEP, _PROBE = 2, 0.02, 1e-3


@dataclass(frozen=True, eq=False)
class ColourPaths:
    """Paths of N materials over n samples.

    Attributes:
        dark, bright: weights of the vertices below the darkest and above the brightest band, shape (N, n).
        dark_coordinate, bright_coordinate: cube roots of their reflectance, (N,); 0 where there is no such vertex.
        reflectances: of the samples, (n,), material by material.

    The coordinate of a path is the cube root of its reflectance.
    """

    dark: Array
    bright: Array
    dark_coordinate: Array
    bright_coordinate: Array
    reflectances: Array

    @cached_property
    def vertices(self) -> list[tuple[Array, Array]]:
        """Coordinates (V,) and weights (V, n) of every path, black first."""
        n_bands = len(self.reflectances) // len(self.dark)
        return [self._path(i, n_bands) for i in range(len(self.dark))]

    @property
    def last(self) -> float:
        """The largest coordinate of any path."""
        return max(float(coordinate[-1]) for coordinate, _ in self.vertices)

    def weights(self, u: Array, coordinates: Array) -> Array:
        """Weights of the samples where materials are blended by u (N,), at coordinates (B,), shape (B, n)."""
        total = np.zeros((len(coordinates), len(self.reflectances)))
        for share, (vertices, W) in zip(u, self.vertices, strict=True):
            if share > 0.0:
                at = np.clip(coordinates, vertices[0], vertices[-1])
                k = np.clip(np.searchsorted(vertices, at, side="right") - 1, 0, len(vertices) - 2)
                t = ((at - vertices[k]) / (vertices[k + 1] - vertices[k]))[:, None]
                total += share * ((1.0 - t) * W[k] + t * W[k + 1])
        return total

    def coordinates_of(
        self, u: Array, reflectance: Array, samples: Array, measure: Array
    ) -> tuple[Array, Array]:
        """Coordinates (B,) at which a blend u (N,) has a reflectance (B,), and the reflectance reached, (B,).

        Args:
            u: shares of the materials.
            reflectance: the target.
            samples: cube roots inside an integrating sphere, shape (n, P).
            measure: weights whose product with values there is the reflectance, shape (P,).
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

    def _path(self, i: int, n_bands: int) -> tuple[Array, Array]:
        """Coordinates (V,) and weights (V, n) of the vertices of material i, black first."""
        own = i * n_bands + np.argsort(self.reflectances[i * n_bands : (i + 1) * n_bands], kind="stable")
        roots = np.cbrt(np.maximum(self.reflectances[own], 0.0))
        coordinates, weights = [0.0], [np.zeros(len(self.reflectances))]
        unit = np.eye(len(self.reflectances))
        first = float(roots[0])
        if _LEAST_STEP < self.dark_coordinate[i] < first - _LEAST_STEP:
            coordinates.append(float(self.dark_coordinate[i]))
            weights.append(self.dark[i])
        elif _NO_BODY * first > _LEAST_STEP:
            coordinates.append(_NO_BODY * first)
            weights.append(_NO_BODY * unit[own[0]])
        ends = [*zip(roots, unit[own], strict=True), (float(self.bright_coordinate[i]), self.bright[i])]
        for root, w in ends:
            if root > coordinates[-1] + _LEAST_STEP:
                coordinates.append(float(root))
                weights.append(w)
        if len(coordinates) == 1:  # black in every band
            coordinates.append(1.0)
            weights.append(np.zeros(len(self.reflectances)))
        return np.array(coordinates), np.array(weights)


def fit_paths(
    samples: Array,
    cosines: Array,
    n_bands: int,
    sphere: tuple[Array, Array],
    albedo: Sequence[tuple[Array, Array]],
) -> ColourPaths:
    """Paths from samples that are ordered material by material.

    Args:
        samples: cube roots of BRDF values, shape (n, P).
        cosines: cos(theta_i) cos(theta_o) of the direction pairs, shape (P,).
        n_bands: samples per material.
        sphere: samples (n, P') inside an integrating sphere, and its measure (P',).
        albedo: the same at several incidences; no path ends above an albedo of 1.
    """
    reflectances = sphere[0] ** 3 @ sphere[1]
    n = len(samples)
    weighted = samples * cosines
    gram = weighted @ weighted.T
    L = cholesky(gram + 1e-9 * np.trace(gram) / n * np.eye(n), lower=True)

    def approximate(f: Array) -> Array:
        target = weighted @ (np.cbrt(np.maximum(f, 0.0)) * cosines)
        return nnls(L.T, solve_triangular(L, target, lower=True), maxiter=20 * n)[0]

    N = n // n_bands
    dark, bright = np.zeros((N, n)), np.zeros((N, n))
    for i in range(N):
        own = np.arange(i * n_bands, (i + 1) * n_bands)
        low, high = own[np.argmin(reflectances[own])], own[np.argmax(reflectances[own])]
        f = samples[low] ** 3
        dark[i] = approximate(f - _body(f, cosines))
        f, r = samples[high] ** 3, reflectances[high]
        if r < WHITE:
            body_share = min(np.pi * _body(f, cosines) / max(r, 1e-9), 1.0)
            gain = 1.0 + (1.0 - body_share) * (WHITE - r) / max(r, 1e-9)
            w = approximate(gain * f + body_share * (WHITE - r) / np.pi)
            most = max(float((w @ values) ** 3 @ measure) for values, measure in albedo)
            bright[i] = w * min(1.0, np.cbrt(1.0 / max(most, 1e-9)))
    ends = [np.cbrt(np.maximum((w @ sphere[0]) ** 3 @ sphere[1], 0.0)) for w in (dark, bright)]
    return ColourPaths(dark, bright, ends[0], ends[1], reflectances)


def _body(f: Array, cosines: Array) -> float:
    """The Lambertian part of values f (P,) in 1/sr."""
    return max(float(np.quantile(f[cosines > 0.05], _BODY_QUANTILE)), 0.0)
