"""A tiling texture that is quilted from patches of a picture (the *sample*).

Patches lie on a periodic grid and overlap their neighbours. Between two of them runs the seam along which they differ
least (Efros & Freeman 2001, Image quilting, by dynamic programming). Fine detail changes abruptly at
the seam, so that marks stay whole; slow variations are blended over a whole patch (Burt & Adelson 1983, A
multiresolution spline), with weights that keep its variance (Heitz & Neyret 2018, Histogram-preserving blending).
All parts of the sample are used about equally often: patches come from parts that were used rarely, and seams prefer
the side that is used less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter

from manifold.core.errors import UsageError
from manifold.core.records import Array, Indices

_CELL_PX = 96  # of the grid
_OVERLAP_PX = 32  # of neighbouring patches
_JITTER = 1.0 / 6.0  # of a cell: marks of patches do not stand in rows
CANDIDATES = 64
"""Number of random places among which the best replaces dust or becomes a patch; with more, marks repeat visibly."""

_SMOOTH_PX = 1.0  # standard deviation of the smoothing of differences along which seams run
_USE = 1.0 / 16.0  # weight of a place's use against the difference across a seam
_SEAM_PX = 2.0  # standard deviation of the blend of fine detail
_SLOW_PX = 16.0  # standard deviation of the smoothing that parts slow variation from detail
_REACH_PX = 24  # of the blend of slow variation, beyond a patch


@dataclass(frozen=True, eq=False)
class Patch:
    """A rectangle of the sample, and its position on the tiling texture.

    Attributes:
        rows, columns: rows and columns of the texture, modulo its size.
        top, left: top row and left column in the sample.
    """

    rows: Indices
    columns: Indices
    top: int
    left: int

    @property
    def at(self) -> tuple[Indices, ...]:
        """Index arrays that select the patch's pixels in the texture."""
        return np.ix_(self.rows, self.columns)

    def of(self, sample: Array) -> Array:
        """Return the part of a sample, (H, W, ...)."""
        return sample[self.top : self.top + len(self.rows), self.left : self.left + len(self.columns)]


@dataclass(frozen=True, eq=False)
class Quilt:
    """The patches that make up a tiling texture.

    Attributes:
        strips: the patches by rows of the grid.
        owner: index of the patch that each pixel shows, counted strip by strip, shape (S, S).
    """

    strips: Sequence[Sequence[Patch]]
    owner: Indices

    @property
    def patches(self) -> list[Patch]:
        """All patches, in the order of their indices."""
        return [patch for strip in self.strips for patch in strip]

    def uses(self, shape: tuple[int, int]) -> Array:
        """Return how often each pixel of a sample (H, W) is shown, (H, W)."""
        uses = np.zeros(shape)
        for index, patch in enumerate(self.patches):
            patch.of(uses)[...] += self.owner[patch.at] == index
        return uses

    def blended(self, values: Array) -> Array:
        """Return the blended texture (S, S, C) of a sample's values (H, W, C) with mean 0."""
        slow = gaussian_filter(values, (_SLOW_PX, _SLOW_PX, 0.0), mode="mirror")
        size, channels = len(self.owner), values.shape[2]
        texture, weights = np.zeros((size, size, channels)), np.zeros((size, size))
        for index, patch in enumerate(self.patches):
            weight = gaussian_filter(
                (self.owner[patch.at] == index).astype(np.float64), _SEAM_PX, mode="constant"
            )
            texture[patch.at] += weight[..., None] * patch.of(values - slow)
            weights[patch.at] += weight
        texture /= weights[..., None]
        around = np.pad(slow, ((_REACH_PX, _REACH_PX), (_REACH_PX, _REACH_PX), (0, 0)), mode="symmetric")
        changes, power = np.zeros_like(texture), np.zeros((size, size))
        for patch in self.patches:
            wide = Patch(_widened(patch.rows, size), _widened(patch.columns, size), patch.top, patch.left)
            weight = _ramp(len(wide.rows), _OVERLAP_PX + 2 * _REACH_PX)[:, None]
            weight = weight * _ramp(len(wide.columns), _OVERLAP_PX + 2 * _REACH_PX)
            changes[wide.at] += weight[..., None] * wide.of(around)
            power[wide.at] += weight**2
        texture += changes / np.sqrt(power)[..., None]
        return texture


def quilt(values: Array, size: int, rng: np.random.Generator) -> Quilt:
    """Cover a tiling texture with patches of a sample.

    Args:
        values: values of the sample by which seams are chosen, shape (H, W, C).
        size: pixels of a side of the texture.
        rng: random generator of the grid and the positions of patches.

    Raises:
        UsageError: the sample is smaller than a patch.
    """
    h, w, _ = values.shape
    cells = max(2, round(size / _CELL_PX))
    needed = int(np.ceil(size / cells * (1.0 + 2.0 * _JITTER))) + _OVERLAP_PX
    if needed > min(h, w):
        raise UsageError(f"found a sample of {w} x {h} pixels, expected at least {needed} each way")
    edges = _edges(size, cells, rng)
    strips: list[list[Patch]] = []
    uses = np.zeros((h, w))
    for row in range(cells):
        rows = np.arange(edges[row], edges[row + 1] + _OVERLAP_PX) % size
        across = _edges(size, cells, rng) + rng.integers(size)
        columns = [np.arange(a, b + _OVERLAP_PX) % size for a, b in pairwise(across)]
        strips.append([_least_used(uses, rows, each, rng) for each in columns])
    return Quilt(strips, _owners(values, strips, uses / uses.mean(), size))


def _edges(size: int, cells: int, rng: np.random.Generator) -> Indices:
    """Return the edges of a row of cells, from 0 to the size, at about equal distances."""
    at = np.linspace(0.0, size, cells + 1)
    at[1:-1] += size / cells * rng.uniform(-_JITTER, _JITTER, cells - 1)
    return np.round(at).astype(int)


def _least_used(uses: Array, rows: Indices, columns: Indices, rng: np.random.Generator) -> Patch:
    """Return the least-used of some random patches, and count its use."""
    (h, w), height, width = uses.shape, len(rows), len(columns)
    weight = _ramp(height, _OVERLAP_PX)[:, None] * _ramp(width, _OVERLAP_PX)
    # Beyond the sample and back: its edges are reached by few places.
    tops, lefts = (
        np.clip(rng.integers(-_OVERLAP_PX, room + _OVERLAP_PX + 1, CANDIDATES), 0, room)
        for room in (h - height, w - width)
    )
    candidates = [
        Patch(rows, columns, top, left) for top, left in zip(tops.tolist(), lefts.tolist(), strict=True)
    ]
    patch = min(candidates, key=lambda each: np.sum(weight * each.of(uses)))
    patch.of(uses)[...] += weight
    return patch


def _owners(values: Array, strips: Sequence[Sequence[Patch]], uses: Array, size: int) -> Indices:
    """Return the index of the patch that each pixel of a texture shows, (S, S)."""
    joined = np.concatenate([values, uses[..., None]], axis=-1)
    owner = np.empty((size, size), dtype=int)
    shown, owners = [], []
    for row, strip in enumerate(strips):
        rows, first = len(strip[0].rows), row * len(strip)
        own, picture = np.empty((rows, size), dtype=int), np.empty((rows, size, joined.shape[2]))
        before = [strip[column - 1].of(joined)[:, -_OVERLAP_PX:] for column in range(len(strip))]
        after = [patch.of(joined)[:, :_OVERLAP_PX] for patch in strip]
        seams = _seams(np.stack(before), np.stack(after))
        for column, patch in enumerate(strip):
            own[:, patch.columns[:-_OVERLAP_PX]] = first + column
            picture[:, patch.columns[:-_OVERLAP_PX]] = patch.of(joined)[:, :-_OVERLAP_PX]
        for column, patch in enumerate(strip):
            is_before = np.arange(_OVERLAP_PX) < seams[column][:, None]
            at = patch.columns[:_OVERLAP_PX]
            own[:, at] = np.where(is_before, first + (column - 1) % len(strip), first + column)
            picture[:, at] = np.where(is_before[..., None], before[column], after[column])
        owner[strip[0].rows[:-_OVERLAP_PX]] = own[:-_OVERLAP_PX]
        shown.append(picture)
        owners.append(own)
    for row, strip in enumerate(strips):
        above, below = shown[row - 1][-_OVERLAP_PX:], shown[row][:_OVERLAP_PX]
        (seam,) = _seams(above.swapaxes(0, 1)[None], below.swapaxes(0, 1)[None], is_closed=True)
        is_above = np.arange(_OVERLAP_PX)[:, None] < seam
        owner[strip[0].rows[:_OVERLAP_PX]] = np.where(
            is_above, owners[row - 1][-_OVERLAP_PX:], owners[row][:_OVERLAP_PX]
        )
    return owner


def _seams(before: Array, after: Array, *, is_closed: bool = False) -> Indices:
    """Return, for each line, the number of pixels taken from the patch before the seam, (K, N).

    Args:
        before, after: overlaps of K pairs of patches, N lines across the seam; the last channel is the use of each
            pixel, relative to the mean, shape (K, N, O, C + 1).
        is_closed: whether the last line lies beside the first.
    """
    differences = np.sum((before - after)[..., :-1] ** 2, axis=-1)
    mode = "wrap" if is_closed else "nearest"
    differences = gaussian_filter(
        differences, (0.0, _SMOOTH_PX, _SMOOTH_PX), mode=("nearest", mode, "nearest")
    )
    across = np.pad(differences, ((0, 0), (0, 0), (1, 1)), mode="edge")
    use = np.cumsum(np.pad((before - after)[..., -1], ((0, 0), (0, 0), (1, 0))), axis=-1)
    costs = (across[..., 1:] + across[..., :-1]) / 2.0 + _USE * differences.mean(
        axis=(1, 2), keepdims=True
    ) * use
    if not is_closed:
        return _cheapest(costs)
    lines = costs.shape[1]
    start = _cheapest(np.concatenate([costs, costs], axis=1))[:, lines]
    ends = np.full((len(costs), 1, costs.shape[2]), np.inf)
    np.put_along_axis(ends, start[:, None, None], 0.0, axis=2)
    costs[:, [0, -1]] += ends
    return _cheapest(costs)


def _cheapest(costs: Array) -> Indices:
    """Return the cheapest path through each of K tables of costs (K, N, M): one column per line, steps of at most 1."""
    total = costs.copy()
    for line in range(1, costs.shape[1]):
        padded = np.pad(total[:, line - 1], ((0, 0), (1, 1)), constant_values=np.inf)
        total[:, line] += np.minimum(np.minimum(padded[:, :-2], padded[:, 1:-1]), padded[:, 2:])
    path = np.empty(costs.shape[:2], dtype=int)
    path[:, -1] = np.argmin(total[:, -1], axis=-1)
    columns = np.arange(costs.shape[2])
    for line in range(costs.shape[1] - 2, -1, -1):
        is_near = np.abs(columns - path[:, line + 1, None]) <= 1
        path[:, line] = np.argmin(np.where(is_near, total[:, line], np.inf), axis=-1)
    return path


def _widened(indices: Indices, size: int) -> Indices:
    return np.arange(indices[0] - _REACH_PX, indices[0] + len(indices) + _REACH_PX) % size


def _ramp(length: int, edge: int) -> Array:
    """Return weights that rise to 1 over an edge, and fall over another."""
    at = np.arange(length) + 0.5
    return np.minimum(np.minimum(at, length - at) / edge, 1.0)
