"""Textures of any size from one sample: without seams, and without a repetition that the eye finds.

Tiles at random offsets are blended such that every pixel keeps the sample's distribution of values: they are first
mapped to a normal distribution, channel by channel, blended with weights that keep its variance, and mapped back.
Source: Heitz & Neyret 2018, High-performance by-example noise using a histogram-preserving blending operator; on a
square grid that closes on itself, so that the texture repeats without a seam.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation, gaussian_filter, label
from scipy.special import ndtr, ndtri

from manifold.errors import UsageError
from manifold.records import Array, Indices, Mask
from manifold.surface.estimate import Surface

_CELL_PX = 96  # of the grid; a tile spans two cells
_MOST_SIZE = 8192
_MOST_EDGE = 0.125  # of a side, that may be cropped
_EDGE_DIFFERENCE = (
    0.12  # of a row's or column's median brightness from the sample's: a shadow of the aperture
)
_DUST = 6.0  # robust standard deviations of smoothed colour
_DUST_PX = 2.0  # standard deviation of that smoothing
_LEAST_DUST_PX = 12  # area
_QUANTILES = 1025  # of the distribution, evenly spaced in standard deviations
_OFFSETS = 16  # random offsets of a tile, of which the one with the least dust is taken


@dataclass(frozen=True, eq=False)
class Textures:
    """Textures of a surface that continue across their edges; S rows and columns.

    Attributes:
        albedo: relative to the mean, shape (S, S, 3), above 0, of mean 1.
        slope: x and y components of the normal over its z component; rows run against y; shape (S, S, 2).
        height: in pixels, of mean 0, shape (S, S).
    """

    albedo: Array
    slope: Array
    height: Array

    def cut_share(self, mean: Array) -> float:
        """Return the share of points that are cut where the albedo of a mean colour (3,) exceeds 1 in a channel."""
        return float(np.mean(np.any(mean * self.albedo > 1.0, axis=-1)))

    @property
    def normal(self) -> Array:
        """Unit normals, shape (S, S, 3)."""
        normal = np.concatenate([self.slope, np.ones((*self.slope.shape[:2], 1))], axis=-1)
        return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))


def tile(surface: Surface, size: int = 1024, seed: int = 0) -> Textures:
    """Return textures of a surface.

    Args:
        surface: the sample; its edges may differ in brightness.
        size: pixels of a side.
        seed: of the random offsets.

    Raises:
        UsageError: the size is less than two cells of the grid, or more than 8192.
    """
    if not 2 * _CELL_PX <= size <= _MOST_SIZE:
        raise UsageError(f"found a texture of {size} pixels, expected {2 * _CELL_PX} to {_MOST_SIZE}")
    rows, columns = uncropped(surface.albedo)
    logs = np.log(surface.albedo[rows, columns])
    dust = dust_in(logs)
    # Along principal axes, or channels that are blended apart make colours that the sample does not have.
    axes = np.linalg.eigh(np.cov(logs[~dust].T))[1]
    sample = np.concatenate([logs @ axes, surface.relief[rows, columns]], axis=-1)
    blended = blend(sample, size, np.random.default_rng(seed), avoided=dust)
    albedo = np.exp(blended[..., :3] @ axes.T)
    slope = blended[..., 3:] - blended[..., 3:].mean(axis=(0, 1))
    height = _integrated_periodic(slope)
    return Textures(albedo / albedo.mean(axis=(0, 1)), slope, height)


def uncropped(albedo: Array) -> tuple[slice, slice]:
    """Return rows and columns without an aperture's shade: edges whose brightness differs from the sample's."""
    grey = albedo.mean(axis=-1)
    kept = []
    for axis in range(2):
        lines = np.abs(np.median(grey, axis=1 - axis) / np.median(grey) - 1.0) > _EDGE_DIFFERENCE
        most = int(_MOST_EDGE * len(lines))
        first, last = (1 + max(np.flatnonzero(edge[:most]), default=-1) for edge in (lines, lines[::-1]))
        kept.append(slice(int(first), len(lines) - int(last)))
    return kept[0], kept[1]


def dust_in(logs: Array) -> Mask:
    """Return a mask (H, W) of spots of another colour with their surroundings, from logs of colours (H, W, 3)."""
    smooth = gaussian_filter(logs, (_DUST_PX, _DUST_PX, 0.0))
    from_median = np.abs(smooth - np.median(smooth, axis=(0, 1)))
    spread = 1.4826 * np.median(from_median, axis=(0, 1)) + 0.01
    labels, _ = label(np.any(from_median > _DUST * spread, axis=-1))
    is_large = np.bincount(labels.ravel()) >= _LEAST_DUST_PX
    is_large[0] = False
    return np.asarray(binary_dilation(is_large[labels], iterations=2))


def blend(sample: Array, size: int, rng: np.random.Generator, *, avoided: Mask | None = None) -> Array:
    """Return a periodic texture whose values are distributed like those of a sample.

    Args:
        sample: shape (H, W, C).
        size: pixels of a side.
        rng: draws the offsets.
        avoided: pixels of the sample that tiles avoid where they can, and whose values are not the sample's, (H, W).

    Returns:
        Values, shape (size, size, C).
    """
    avoided = np.full(sample.shape[:2], False) if avoided is None else avoided
    h, w, _ = sample.shape
    gaussian, back = _to_gaussian(sample, ~avoided)
    cells = max(2, round(size / _CELL_PX))
    edges = np.round(np.linspace(0.0, size, cells + 1)).astype(int)
    span = int(2 * np.max(np.diff(edges)))
    if span > min(h, w):
        raise UsageError(f"found a sample of {w} x {h} pixels, expected at least {span} each way")
    made = np.zeros((size, size, sample.shape[2]))
    power = np.zeros((size, size))
    for row in range(cells):
        for column in range(cells):
            rows, weight_rows = _tent(edges, row, size)
            columns, weight_columns = _tent(edges, column, size)
            offsets = zip(
                rng.integers(0, h - len(rows) + 1, _OFFSETS),
                rng.integers(0, w - len(columns) + 1, _OFFSETS),
                strict=True,
            )
            top, left = min(
                offsets, key=lambda o: np.sum(avoided[o[0] : o[0] + len(rows), o[1] : o[1] + len(columns)])
            )
            weight = weight_rows[:, None] * weight_columns
            at = np.ix_(rows, columns)
            made[at] += weight[..., None] * gaussian[top : top + len(rows), left : left + len(columns)]
            power[at] += weight**2
    return back(made / np.sqrt(power)[..., None])


def _tent(edges: Indices, cell: int, size: int) -> tuple[Indices, Array]:
    """Return indices, modulo the size, and weights of a tile that rises over one cell and falls over the next."""
    rise, fall = edges[cell + 1] - edges[cell], np.diff(edges)[(cell + 1) % (len(edges) - 1)]
    indices = (edges[cell] + np.arange(rise + fall)) % size
    return indices, np.concatenate([(np.arange(rise) + 0.5) / rise, 1.0 - (np.arange(fall) + 0.5) / fall])


def _to_gaussian(sample: Array, counted: Mask) -> tuple[Array, Callable[[Array], Array]]:
    """Return a sample whose channels are normally distributed over counted pixels, and the inverse function."""
    ordered = np.sort(sample[counted], axis=0)
    ranks = ndtri(0.5 / len(ordered)) * np.linspace(1.0, -1.0, _QUANTILES)
    at = np.round(len(ordered) * ndtr(ranks) - 0.5).astype(int)
    quantiles = ordered[at]

    def mapped(values: Array, forth: bool) -> Array:
        tables = [(own, ranks) if forth else (ranks, own) for own in quantiles.T]
        return np.stack([np.interp(values[..., c], *table) for c, table in enumerate(tables)], axis=-1)

    return mapped(sample, True), lambda values: mapped(values, False)


def _integrated_periodic(slope: Array) -> Array:
    k_y = 2j * np.pi * np.fft.fftfreq(slope.shape[0])[:, None]
    k_x = 2j * np.pi * np.fft.rfftfreq(slope.shape[1])[None, :]
    along_x, along_y = (np.fft.rfft2(slope[..., axis]) for axis in range(2))
    power = np.abs(k_x) ** 2 + np.abs(k_y) ** 2
    power[0, 0] = 1.0
    heights = np.fft.irfft2((k_x * along_x - k_y * along_y) / power, s=slope.shape[:2])
    return np.asarray(heights - heights.mean())
