"""The forward model: the pixels of a photographed ball as linear functionals of its BRDF.

The ball floats in a distant environment; light reflected by nearby objects is ignored. Pixels are averaged in
blocks, which are small where the picture varies. The light that a block sends to the camera is a sum over direction
pairs. Half of them are sampled from the incident light, half from half vectors that are densest around the normal;
both halves are weighted by the balance heuristic, so that small lamps and sharp highlights are resolved equally well.

Source: Veach & Guibas 1995, "Optimally Combining Sampling Techniques for Monte Carlo Rendering".
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from manifold.colour import lights
from manifold.core.directions import from_spherical, normalize, rotate_z
from manifold.core.errors import UsageError
from manifold.core.names import percent
from manifold.core.records import Array, Indices, Mask
from manifold.estimate.outlines import Circle, Cylinder, Photograph, reduced

_ROWS, _PARTS = 64, 8  # rows of cells, twice as many columns; parts of a cell along a side
_MOST_BLOCKS, _MOST_IN_ALL = 400, 4000  # blocks of a picture, and of all together
_FEWEST_BLOCKS = 60  # blocks of a picture of many
_LARGEST, _SMALLEST, _CLIPPED = 16, 2, 8  # pixels a side
_DIAMETER = 256  # pixels to which larger balls are reduced
_RIM = 0.97  # share of the radius, beyond which errors of the outline are largest
_LEAST_SPAN_DEG = 40.0  # range of normals; flatter pieces gain nothing over two analytic lobes
_LEAST_SHARE = 0.1  # share of the ball that must have been seen
SAMPLES = 256
"""Number of direction pairs per block."""

_POWER = 4  # power of the uniform variate in the elevation of half vectors

_STEPS = (
    np.array([0.8566748838545029, 0.733891856627126, 0.6287067210378087, 0.5385972572236101, 0.46140274])
    % 1.0
)
"""Steps of a low-discrepancy sequence (Roberts 2018, "The Unreasonable Effectiveness of Quasirandom Sequences")."""


@dataclass(frozen=True, eq=False)
class Environment:
    """Distant light in fine pixels of equal angles, grouped into cells.

    Attributes:
        radiance: radiance in the channels of a camera, with the layout of `lights.studio`, shape (512, 1024, C).
    """

    radiance: Array

    @classmethod
    def of(cls, image: Array) -> Environment:
        """Return the environment of a latitude-longitude image (H, W, C) of any resolution."""
        image = np.asarray(image, dtype=np.float64)
        lights.require_light(image)
        size = _ROWS * _PARTS
        resized = _resized(_resized(image, size, 0), 2 * size, 1)
        return cls(np.ascontiguousarray(resized))

    def at(self, directions: Array) -> tuple[Array, Indices]:
        """Return the radiance (..., C) from world directions (..., 3), and the indices of their fine pixels."""
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
        """Return the solid angles of the fine pixels of every row, in sr."""
        size = _ROWS * _PARTS
        edges = np.cos(np.pi * np.arange(size + 1) / size)
        return (edges[:-1] - edges[1:]) * np.pi / size

    @cached_property
    def _centres(self) -> Array:
        """Directions to the middle of the light of every cell, shape (cells, 3)."""
        return _direction(np.arange(2 * _ROWS**2), np.full(2 * _ROWS**2, 0.5), np.full(2 * _ROWS**2, 0.5))

    def cell_probabilities(self, normals: Array) -> Array:
        """Return probabilities (K, cells) proportional to the light that cells send to surfaces of normals (K, 3)."""
        cosines = np.maximum(normals @ self._centres.T, 0.0) + 0.02  # normals of a block differ
        product = cosines * self._power.sum(axis=1)
        return product / product.sum(axis=1, keepdims=True)

    def sample(self, probabilities: Array, u: Array) -> Array:
        """Sample directions (K, S, 3) with variates u (K, S, 3) in [0, 1) from cells of probabilities (K, cells)."""
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
        """Return the density (K, S) in 1/sr of `sample` at fine pixels (K, S), for probabilities (K, cells)."""
        cell, part = np.divmod(pixel, _PARTS**2)
        share = self._power / np.maximum(self._power.sum(axis=1, keepdims=True), 1e-300)
        row = (cell // (2 * _ROWS)) * _PARTS + part // _PARTS
        return np.take_along_axis(probabilities, cell, 1) * share[cell, part] / self._solid_angles[row]


def _direction(cell: Indices, down: Array, right: Array) -> Array:
    """Return world directions at a place within cells, from their upper left corner, 0 to 1."""
    row, column = np.divmod(cell, 2 * _ROWS)
    theta, azimuth = np.pi * (row + down) / _ROWS, np.pi * (column + right) / _ROWS
    s = np.sin(theta)
    return np.stack([s * np.sin(azimuth), s * np.cos(azimuth), np.cos(theta)], axis=-1)


def _resized(image: Array, count: int, axis: int) -> Array:
    """Return means over `count` equal parts of an axis."""
    n = image.shape[axis]
    total = np.concatenate([np.zeros_like(image.take([0], axis)), np.cumsum(image, axis)], axis)
    at = np.linspace(0.0, n, count + 1)
    low = np.minimum(at.astype(int), n - 1)
    share = (at - low).reshape((-1, 1, 1) if axis == 0 else (1, -1, 1))
    summed = total.take(low, axis) + share * image.take(low, axis)
    return np.diff(summed, axis=axis) * (count / n)


@dataclass(frozen=True, eq=False)
class Blocks:
    """K blocks of M pixels of a picture.

    Attributes:
        x, y: right and up of the centre of every pixel in radii of the outline, shape (M,), block by block.
        starts: first pixel of each block, shape (K,).
        size: width of a pixel in radii.
        values: mean of every block, shape (K, 3).
        is_clipped: whether each channel of a block is at least as bright as its value, because the camera clipped it,
            shape (K, 3).
        is_cylinder: whether the blocks show an upright cylinder instead of a ball.
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
        """Number of pixels of each block."""
        return np.diff(np.append(self.starts, len(self.x)))


def blocks_of(photograph: Photograph, circle: Circle, pictures: int = 1) -> Blocks:
    """Return the blocks of a ball or cylinder in a photograph.

    With more than ten `pictures`, each has fewer blocks.
    """
    path = photograph.path
    is_cylinder = isinstance(circle, Cylinder)
    if is_cylinder:
        _require_curved(photograph, circle)
    else:
        circle.require_inside(photograph)
    factor = max(1, round(2.0 * circle.radius / _DIAMETER))
    values = reduced(photograph.values, factor)
    is_clipped = reduced(photograph.is_clipped.astype(np.float32), factor) > 0.0
    rows, columns = values.shape[:2]
    x = ((np.arange(columns) + 0.5) * factor - circle.x) / circle.radius
    y = (circle.y - (np.arange(rows) + 0.5) * factor) / circle.radius
    x, y = (np.broadcast_to(a, (rows, columns)) for a in (x, y[:, None]))
    inside = circle.contains(x, y, _RIM)
    is_finite = inside & np.isfinite(values).all(axis=2)
    clipped = is_finite & is_clipped.any(axis=2)
    seen = is_finite & ~clipped
    if not seen.sum() >= max(_LEAST_SHARE * inside.sum(), 1.0):
        raise UsageError(
            f"{path}: {percent(clipped.sum() / max(inside.sum(), 1))} of the ball at {circle} is clipped and "
            f"{percent(seen.sum() / max(inside.sum(), 1))} was seen, expected at least {percent(_LEAST_SHARE)}; "
            "expose it less"
        )
    if not values[seen].max() > 0.0:
        raise UsageError(f"{path}: the ball at {circle} is black, expected some light")
    roots = np.cbrt(np.maximum(values, 0.0))
    most = max(_FEWEST_BLOCKS, min(_MOST_BLOCKS, _MOST_IN_ALL // pictures))
    squares = [(seen, square) for square in _squares(roots, seen, _LARGEST, most)]
    channels = is_clipped @ [1, 2, 4]  # a number for each set of clipped channels
    for k in np.unique(channels[clipped]).tolist():
        alike = clipped & (channels == k)
        squares += [(alike, square) for square in _squares(roots, alike, _CLIPPED, 0)]
    parts = [np.argwhere(some[r : r + s, c : c + s]) + np.array([r, c]) for some, (r, c, s) in squares]
    counts = np.array([len(part) for part in parts])
    starts = np.cumsum(counts) - counts
    i, j = np.concatenate(parts).T
    means = np.add.reduceat(values[i, j].astype(float), starts) / counts[:, None]
    return Blocks(
        x[i, j], y[i, j], starts, factor / circle.radius, means, is_clipped[i, j][starts], is_cylinder
    )


def _require_curved(photograph: Photograph, cylinder: Circle) -> None:
    """Raise UsageError if the visible normals of a cylinder span too small an angle."""
    edges = (np.array([0.0, photograph.values.shape[1]]) - cylinder.x) / cylinder.radius
    span = float(np.rad2deg(np.ptp(np.arcsin(np.clip(edges, -_RIM, _RIM)))))
    if span < _LEAST_SPAN_DEG:
        raise UsageError(
            f"{photograph.path}: the normals of the visible part of the cylinder at {cylinder} span {span:.0f} "
            f"degrees, expected {_LEAST_SPAN_DEG:g} or more: a nearly flat piece determines little; bend it over a "
            "thinner cylinder, or give readings"
        )


def _squares(roots: Array, seen: Mask, side: int, most: int) -> list[tuple[int, int, int]]:
    """Return row, column and side of at most `most` squares of seen pixels; the most varied are split first."""
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


@dataclass(frozen=True)
class Camera:
    """The position of a camera that looks at the centre of the ball.

    Attributes:
        turn_deg: azimuth of the viewing direction in the environment, counted to the right from its first column.
        elevation_deg: elevation of the camera above the ball.
        distance: distance of the camera from the centre of the ball, in radii.
    """

    turn_deg: float = 0.0
    elevation_deg: float = 0.0
    distance: float = np.inf

    @property
    def axes(self) -> tuple[Array, Array, Array]:
        """Unit vectors to the right, up, and towards the camera, in a world whose +y is straight ahead."""
        e = np.deg2rad(self.elevation_deg)
        return (
            np.array([1.0, 0.0, 0.0]),
            np.array([0.0, np.sin(e), np.cos(e)]),
            np.array([0.0, -np.cos(e), np.sin(e)]),
        )

    def cylinder(self, x: Array) -> tuple[Array, Array]:
        """Return the normals of an upright cylinder, and the directions to a distant, level camera.

        x is the distance to the right of the axis in radii, from -1 to 1.
        """
        right, _, towards = self.axes
        normal = x[..., None] * right + np.sqrt(np.maximum(1.0 - x * x, 0.0))[..., None] * towards
        return normal, np.broadcast_to(towards, normal.shape)

    def surface(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the normals (..., 3) of points of the ball, and the directions (..., 3) to the camera.

        x (right) and y (up from the centre) are in radii and lie within the outline.
        """
        right, up, towards = self.axes
        flat = x[..., None] * right + y[..., None] * up
        r2 = np.minimum(x * x + y * y, 1.0)[..., None]
        if np.isinf(self.distance):
            return normalize(flat + np.sqrt(1.0 - r2) * towards), np.broadcast_to(towards, flat.shape)
        D = self.distance
        ray = normalize(flat / np.sqrt(D * D - 1.0) - towards)
        along = D * (ray @ towards)[..., None]  # negative
        t = -along - np.sqrt(np.maximum(along**2 - (D * D - 1.0), 0.0))
        return normalize(D * towards + t * ray), -ray


def direction_pairs(
    blocks: Blocks, camera: Camera, environment: Environment, samples: int = SAMPLES
) -> tuple[Array, Array, Array]:
    """Return the direction pairs of blocks, wi to the camera, wo to the light, (K, S, 3), and the light (K, S, C).

    The directions are in frames of the surface. The light is radiance times cosine over density, so that the value of
    a block is the sum of light times f.
    """
    normal, view, u = sampled_surface(blocks, camera, samples)
    turn = np.deg2rad(camera.turn_deg)

    half = np.arange(samples) % 2 == 0
    m = _half_vectors(u[:, half, 1], u[:, half, 2])
    frame = frames(normal)
    wi = np.einsum("ksij,ksj->ksi", frame, view)
    mirrored = 2.0 * np.sum(wi[:, half] * m, axis=-1, keepdims=True) * m - wi[:, half]
    of_light = environment.cell_probabilities(rotate_z(normalize(normal.mean(axis=1)), -turn))
    sampled = rotate_z(environment.sample(of_light, u[:, ~half][..., [1, 2, 3]]), turn)
    wo = np.empty_like(wi)
    wo[:, half] = mirrored
    wo[:, ~half] = np.einsum("ksij,ksj->ksi", frame[:, ~half], sampled)

    world = np.einsum("ksij,ksi->ksj", frame, wo)
    radiance, pixel = environment.at(rotate_z(world, -turn))
    h = normalize(wi + wo)
    by_half = _half_density(h[..., 2]) / np.maximum(4.0 * np.abs(np.sum(wi * h, axis=-1)), 1e-9)
    density = 0.5 * samples * (by_half + environment.density(of_light, pixel))
    lit = (wo[..., 2] > 1e-6) & (wi[..., 2] > 1e-6)
    light = np.where(lit, wo[..., 2] / density, 0.0)[..., None] * radiance
    return wi, np.where(lit[..., None], normalize(wo), [0.0, 0.0, 1.0]), light


def sampled_surface(blocks: Blocks, camera: Camera, samples: int) -> tuple[Array, Array, Array]:
    """Return normals and directions to the camera at random points of blocks, each (K, S, 3), and variates (K, S, 5).

    The first and last variates have selected the points; the others are unused.
    """
    K = len(blocks.starts)
    u = (np.random.default_rng(0).random((K, 1, 5)) + np.arange(samples)[:, None] * _STEPS) % 1.0
    chosen = blocks.starts[:, None] + (u[..., 0] * blocks.counts[:, None]).astype(int)
    shift = (u[..., 0] * blocks.counts[:, None]) % 1.0
    x = blocks.x[chosen] + blocks.size * (shift - 0.5)
    y = blocks.y[chosen] + blocks.size * (u[..., 4] - 0.5)
    if blocks.is_cylinder:
        return *camera.cylinder(np.clip(x, -1.0, 1.0)), u
    beyond = np.maximum(np.hypot(x, y), 1.0) * (1.0 + 1e-9)
    normal, view = camera.surface(x / beyond, y / beyond)
    return normal, view, u


def _half_vectors(u: Array, v: Array) -> Array:
    """Return half vectors whose elevation grows with a power of u: dense around the normal, where mirrors reflect."""
    return from_spherical(0.5 * np.pi * u**_POWER, 2.0 * np.pi * v)


def _half_density(cos_theta_h: Array) -> Array:
    """Return the density of `_half_vectors` in 1/sr."""
    theta = np.maximum(np.arccos(np.clip(cos_theta_h, -1.0, 1.0)), 1e-7)
    slope = _POWER * 0.5 * np.pi * (2.0 * theta / np.pi) ** (1.0 - 1.0 / _POWER)  # derivative of theta by u
    return np.where(theta < 0.5 * np.pi, 1.0 / (slope * np.sin(theta) * 2.0 * np.pi), 0.0)


def frames(normal: Array) -> Array:
    """Return orthonormal frames (..., 3, 3) whose last row is the normal."""
    helper = np.where(np.abs(normal[..., 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    tangent = normalize(np.cross(helper, normal))
    return np.stack([tangent, np.cross(normal, tangent), normal], axis=-2)


def block_sums(
    values: Callable[[Array, Array], Array], wi: Array, wo: Array, light: Array, at_once: int = 16384
) -> Array:
    """Return the pixels of n BRDFs, shape (n, C, K): sums of light times f over the direction pairs of every block."""
    K, S = light.shape[:2]
    per = max(1, at_once // S)
    parts = []
    for k in range(0, K, per):
        f = values(wi[k : k + per].reshape(-1, 3), wo[k : k + per].reshape(-1, 3))
        parts.append(np.einsum("nks,ksc->nck", f.reshape(len(f), -1, S), light[k : k + per], optimize=True))
    return np.concatenate(parts, axis=-1)
