"""The light that falls on a ball from a distant environment, and samples of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from manifold.colour import lights
from manifold.errors import UsageError
from manifold.records import Array, Indices

_ROWS, _PARTS = 64, 8  # rows of cells, twice as many columns; parts of a cell along a side


@dataclass(frozen=True, eq=False)
class Environment:
    """Distant light in fine pixels of equal angles, grouped into cells.

    Attributes:
        radiance: in the channels of a camera, laid out as `studio.studio` does, shape (512, 1024, C).
    """

    radiance: Array

    @classmethod
    def of(cls, image: Array) -> Environment:
        """From a picture by latitude and longitude of any resolution, shape (H, W, C).

        Raises:
            UsageError: it is not twice as wide as high, a value is not finite or negative, or it is black.
        """
        image = np.asarray(image, dtype=np.float64)
        H, W = image.shape[:2]
        if abs(W - 2 * H) > 0.05 * W:
            raise UsageError(
                f"an environment of {W} x {H} pixels, expected twice as wide as high: latitude by longitude"
            )
        lights.require_light(image)
        size = _ROWS * _PARTS
        resized = _resized(_resized(image, size, 0), 2 * size, 1)
        return cls(np.ascontiguousarray(resized))

    def at(self, directions: Array) -> tuple[Array, Indices]:
        """Radiance (..., C) from world directions (..., 3), and the index of the fine pixel, cell by cell, (...)."""
        size = _ROWS * _PARTS
        row = np.minimum(
            (np.arccos(np.clip(directions[..., 2], -1.0, 1.0)) / np.pi * size).astype(int), size - 1
        )
        turn = np.arctan2(directions[..., 0], directions[..., 1]) / (2.0 * np.pi) % 1.0
        column = np.minimum((turn * 2 * size).astype(int), 2 * size - 1)
        cell = (row // _PARTS) * 2 * _ROWS + column // _PARTS
        return self.radiance[row, column], cell * _PARTS**2 + (row % _PARTS) * _PARTS + column % _PARTS

    @cached_property
    def _power(self) -> Array:
        """Mean radiance over channels times solid angle of every fine pixel, cell by cell: shape (cells, parts)."""
        power = self.radiance.mean(axis=-1) * self._solid_angles[:, None]
        split = power.reshape(_ROWS, _PARTS, 2 * _ROWS, _PARTS)
        return np.ascontiguousarray(split.transpose(0, 2, 1, 3)).reshape(-1, _PARTS**2)

    @cached_property
    def _solid_angles(self) -> Array:
        """Of the fine pixels of every row, in sr."""
        size = _ROWS * _PARTS
        edges = np.cos(np.pi * np.arange(size + 1) / size)
        return (edges[:-1] - edges[1:]) * np.pi / size

    @cached_property
    def _centres(self) -> Array:
        """Directions to the middle of the light of every cell, shape (cells, 3)."""
        return _direction(np.arange(2 * _ROWS**2), np.full(2 * _ROWS**2, 0.5), np.full(2 * _ROWS**2, 0.5))

    def cell_probabilities(self, normals: Array) -> Array:
        """Probabilities of cells, proportional to the light that falls from them on normals (K, 3): (K, cells)."""
        cosines = np.maximum(normals @ self._centres.T, 0.0) + 0.02  # normals of a block differ
        product = cosines * self._power.sum(axis=1)
        return product / product.sum(axis=1, keepdims=True)

    def sample(self, probabilities: Array, u: Array) -> Array:
        """Directions of variates u (K, S, 3) in [0, 1) with cells of probabilities (K, cells): shape (K, S, 3)."""
        cumulative = np.cumsum(probabilities, axis=1)
        cell = np.empty(u.shape[:2], dtype=int)
        for k, row in enumerate(cumulative):
            cell[k] = np.minimum(np.searchsorted(row, u[k, :, 0] * row[-1], side="right"), len(row) - 1)
        within = np.cumsum(self._power + 1e-30, axis=1)
        within /= within[:, -1:]
        part = (within[cell] < u[..., 1, None]).sum(axis=-1)
        row, column = np.divmod(part, _PARTS)
        below = np.where(
            part > 0, np.take_along_axis(within[cell], np.maximum(part - 1, 0)[..., None], -1)[..., 0], 0.0
        )
        rest = (u[..., 1] - below) / (np.take_along_axis(within[cell], part[..., None], -1)[..., 0] - below)
        return _direction(cell, (row + np.clip(rest, 0.0, 1.0)) / _PARTS, (column + u[..., 2]) / _PARTS)

    def density(self, probabilities: Array, pixel: Indices) -> Array:
        """Density in 1/sr of samples in fine pixels (K, S) for probabilities of cells (K, cells): shape (K, S)."""
        cell, part = np.divmod(pixel, _PARTS**2)
        share = self._power / np.maximum(self._power.sum(axis=1, keepdims=True), 1e-300)
        row = (cell // (2 * _ROWS)) * _PARTS + part // _PARTS
        return np.take_along_axis(probabilities, cell, 1) * share[cell, part] / self._solid_angles[row]


def _direction(cell: Indices, down: Array, right: Array) -> Array:
    """World directions at a place within cells, from their upper left corner, 0 to 1."""
    row, column = np.divmod(cell, 2 * _ROWS)
    theta, azimuth = np.pi * (row + down) / _ROWS, np.pi * (column + right) / _ROWS
    s = np.sin(theta)
    return np.stack([s * np.sin(azimuth), s * np.cos(azimuth), np.cos(theta)], axis=-1)


def _resized(image: Array, count: int, axis: int) -> Array:
    """Means over `count` equal parts of an axis."""
    n = image.shape[axis]
    total = np.concatenate([np.zeros_like(image.take([0], axis)), np.cumsum(image, axis)], axis)
    at = np.linspace(0.0, n, count + 1)
    low = np.minimum(at.astype(int), n - 1)
    share = (at - low).reshape((-1, 1, 1) if axis == 0 else (1, -1, 1))
    summed = total.take(low, axis) + share * image.take(low, axis)
    return np.diff(summed, axis=axis) * (count / n)
