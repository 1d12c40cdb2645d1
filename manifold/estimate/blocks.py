"""A photograph of a ball, averaged in blocks: small where it varies, none where the camera saw nothing."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np

from manifold.errors import UsageError
from manifold.estimate.circle import Circle, Cylinder
from manifold.estimate.photo_files import Photograph, reduced
from manifold.records import Array, Indices, Mask

_MOST_BLOCKS, _MOST_IN_ALL, _FEWEST_BLOCKS = (
    400,
    4000,
    60,
)  # of a picture, of all together, and of a picture of many
_LARGEST, _SMALLEST, _CLIPPED = 16, 2, 8  # pixels a side
_DIAMETER = 256  # to which larger balls are reduced
_RIM = 0.97  # of the radius: beyond, errors of the outline are largest
_LEAST_SPAN_DEG = 40.0  # of normals; flatter ones gain nothing over two analytic lobes
_LEAST_SHARE = 0.1  # of the ball that must have been seen


@dataclass(frozen=True, eq=False)
class Blocks:
    """K blocks of M pixels of a picture.

    Attributes:
        x, y: right and up of the centre of every pixel in radii of the outline, shape (M,), block by block.
        starts: first pixel of each block, shape (K,).
        size: width of a pixel in radii.
        values: mean of every block, shape (K, 3).
        is_clipped: blocks that were at least as bright as their values, shape (K,).
        is_cylinder: whether they are of an upright cylinder instead of a ball.
    """

    x: Array
    y: Array
    starts: Indices
    size: float
    values: Array
    is_clipped: Mask
    is_cylinder: bool = False

    @property
    def counts(self) -> Indices:
        """Pixels of each block."""
        return np.diff(np.append(self.starts, len(self.x)))


def blocks_of(photograph: Photograph, circle: Circle, pictures: int = 1) -> Blocks:
    """The blocks of a ball, or of a cylinder.

    Args:
        photograph: of it.
        circle: its outline.
        pictures: how many there are of it: each of more than ten has fewer blocks.
    Raises:
        UsageError: the circle is not in the picture, the ball is black, most of it is clipped or unseen, or what is
            seen of a cylinder is nearly flat.
    """
    path, (H, W) = photograph.path, photograph.values.shape[:2]
    is_cylinder = isinstance(circle, Cylinder)
    if is_cylinder:
        _require_curved(photograph, circle)
    elif not (0.0 <= circle.x <= W and 0.0 <= circle.y <= H and 8.0 <= circle.radius <= np.hypot(W, H)):
        raise UsageError(
            f"{path}: circle {circle.x:.6g},{circle.y:.6g},{circle.radius:.6g} in a picture of {W} x {H}, expected one "
            "inside it, of a radius from 8 pixels to its diagonal"
        )
    factor = max(1, round(2.0 * circle.radius / _DIAMETER))
    values = reduced(photograph.values, factor)
    is_clipped = reduced(photograph.is_clipped[..., None].astype(np.float32), factor)[..., 0] > 0.0
    rows, columns = values.shape[:2]
    x = ((np.arange(columns) + 0.5) * factor - circle.x) / circle.radius
    y = (circle.y - (np.arange(rows) + 0.5) * factor) / circle.radius
    x, y = (np.broadcast_to(a, (rows, columns)) for a in (x, y[:, None]))
    inside = circle.contains(x, y, _RIM)
    clipped = inside & np.isfinite(values).all(axis=2) & is_clipped
    seen = inside & np.isfinite(values).all(axis=2) & ~is_clipped
    if not seen.sum() >= max(_LEAST_SHARE * inside.sum(), 1.0):
        raise UsageError(
            f"{path}: {clipped.sum() / max(inside.sum(), 1):.0%} of the ball at {circle} is clipped and "
            f"{seen.sum() / max(inside.sum(), 1):.0%} was seen, expected at least {_LEAST_SHARE:.0%}; expose it less"
        )
    if not values[seen].max() > 0.0:
        raise UsageError(f"{path}: the ball at {circle} is black, expected some light")
    roots = np.cbrt(np.maximum(values, 0.0))
    most = max(_FEWEST_BLOCKS, min(_MOST_BLOCKS, _MOST_IN_ALL // pictures))
    squares = [(seen, square) for square in _squares(roots, seen, _LARGEST, most)]
    squares += [(clipped, square) for square in _squares(roots, clipped, _CLIPPED, 0)]
    parts = [np.argwhere(some[r : r + s, c : c + s]) + np.array([r, c]) for some, (r, c, s) in squares]
    counts = np.array([len(part) for part in parts])
    starts = np.cumsum(counts) - counts
    i, j = np.concatenate(parts).T
    means = np.add.reduceat(values[i, j].astype(float), starts) / counts[:, None]
    return Blocks(
        x[i, j], y[i, j], starts, factor / circle.radius, means, is_clipped[i, j][starts], is_cylinder
    )


def _require_curved(photograph: Photograph, cylinder: Circle) -> None:
    """Raise UsageError where the normals that a picture shows of a cylinder differ by little."""
    edges = (np.array([0.0, photograph.values.shape[1]]) - cylinder.x) / cylinder.radius
    span = float(np.rad2deg(np.ptp(np.arcsin(np.clip(edges, -_RIM, _RIM)))))
    if span < _LEAST_SPAN_DEG:
        raise UsageError(
            f"{photograph.path}: the normals of what is seen of the cylinder at {cylinder} span {span:.0f} degrees, "
            f"expected {_LEAST_SPAN_DEG:g} or more: a nearly flat piece says little; bend it over a thinner one, or "
            "give readings"
        )


def _squares(roots: Array, seen: Mask, side: int, most: int) -> list[tuple[int, int, int]]:
    """Row, column and side of squares that hold seen pixels: up to so many, those that vary most are split first."""
    heap: list[tuple[float, int, int, int]] = []

    def push(r: int, c: int, s: int) -> None:
        some = roots[r : r + s, c : c + s][seen[r : r + s, c : c + s]]
        if len(some):
            varies = float(np.sum((some - some.mean(axis=0)) ** 2)) if s > _SMALLEST else 0.0
            heapq.heappush(heap, (-varies, r, c, s))

    for r in range(0, seen.shape[0], side):
        for c in range(0, seen.shape[1], side):
            push(r, c, side)
    while 0 < len(heap) < most and heap[0][0] < 0.0:
        _, r, c, s = heapq.heappop(heap)
        half = s // 2
        for r2, c2 in ((r, c), (r, c + half), (r + half, c), (r + half, c + half)):
            push(r2, c2, half)
    return sorted((r, c, s) for _, r, c, s in heap)
