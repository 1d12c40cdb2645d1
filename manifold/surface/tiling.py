"""Makes tiling textures of any size from the pictures of a specimen, with the same density of marks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import (
    binary_dilation,
    binary_opening,
    center_of_mass,
    distance_transform_edt,
    find_objects,
    gaussian_filter,
    label,
)

from manifold.core.defaults import TINY
from manifold.core.errors import UsageError
from manifold.core.records import Array, Indices, Mask
from manifold.surface.estimate import Surface
from manifold.surface.quilting import CANDIDATES, quilt

_LEAST_SIZE, _MOST_SIZE = 192, 8192
_MOST_EDGE = 0.125  # of a side, that may be cropped
_EDGE_DIFFERENCE = 0.12  # of the median brightness of a row or column from the sample's: an aperture's shadow
_DUST = 6.0  # robust standard deviations of smoothed colour
_ALIKE = 4.0  # of spots that are compared with dust
_DUST_PX = 2.0  # standard deviation of that smoothing; dust is replaced within twice as much around it
_MOST_DUST_PX = 1024  # area; what is larger is a part of the sample
_FEW = 3  # spots of a colour, fewer than which do not tell how frequent they are
_SAME_DIRECTION, _SAME_STRENGTH = 0.9, 0.4  # of differences from the sample's colour: cosine, and ratio


@dataclass(frozen=True, eq=False)
class Textures:
    """Tiling textures of a surface, S rows and columns.

    Attributes:
        albedo: albedo relative to the mean, shape (S, S, 3), above 0, with mean 1.
        slope: x and y components of the normal over its z component, shape (S, S, 2); rows run against y.
        height: heights in pixels, with mean 0, shape (S, S).
        notes: the parts of the specimen that are omitted, in sentences.
    """

    albedo: Array
    slope: Array
    height: Array
    notes: tuple[str, ...] = ()

    def cut_share(self, mean: Array) -> float:
        """Return the share of points whose albedo, for a mean colour (3,), exceeds 1 in a channel and is clipped."""
        return float(np.mean(np.any(mean * self.albedo > 1.0, axis=-1)))

    @property
    def normal(self) -> Array:
        """Unit normals, shape (S, S, 3)."""
        normal = np.concatenate([self.slope, np.ones((*self.slope.shape[:2], 1))], axis=-1)
        return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))


def tile(surface: Surface, size: int = 1024, seed: int = 0) -> Textures:
    """Return tiling textures of a surface.

    Args:
        surface: the estimated surface; its edges may differ in brightness.
        size: side of the textures in pixels.
        seed: seed of the random positions of patches.

    Raises:
        UsageError: the size is less than two cells of the grid, or more than 8192.
    """
    if not _LEAST_SIZE <= size <= _MOST_SIZE:
        raise UsageError(f"found a texture of {size} pixels, expected {_LEAST_SIZE} to {_MOST_SIZE}")
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
    return Textures(
        albedo / albedo.mean(axis=(0, 1)), slope, height, _left_out(surface.albedo, rows, columns, dust)
    )


def _left_out(albedo: Array, rows: slice, columns: slice, dust: Mask) -> tuple[str, ...]:
    """Return notes about the parts of a sample (H, W, 3) that textures do not show."""
    h, w = albedo.shape[:2]
    notes: tuple[str, ...] = ()
    if dust.size < h * w:
        edges = (columns.start, w - columns.stop, rows.start, h - rows.stop)
        sides = [
            f"{n} pixels at the {side}"
            for n, side in zip(edges, ("left", "right", "top", "bottom"), strict=True)
            if n
        ]
        notes += (f"edges of different brightness are cropped: {', '.join(sides)}",)
    labels, count = label(dust)
    if count:
        places = [
            f"column {column + columns.start:.0f}, row {row + rows.start:.0f}"
            for row, column in center_of_mass(dust, labels, range(1, min(count, _FEW) + 1))
        ]
        more = ", ..." if count > _FEW else ""
        notes += (
            f"left out as dust, because too few spots have this colour: {100.0 * dust.mean():.2g} % of the sample, at "
            f"{'; '.join(places)}{more}",
        )
    return notes


def uncropped(albedo: Array) -> tuple[slice, slice]:
    """Return the rows and columns that are left after cropping edges shaded by the aperture."""
    grey = albedo.mean(axis=-1)
    kept = []
    for axis in range(2):
        differs = np.abs(np.median(grey, axis=1 - axis) / np.median(grey) - 1.0) > _EDGE_DIFFERENCE
        # Single lines differ by chance: a shadow has a width.
        is_shaded = binary_opening(np.pad(differs, 1, mode="edge"), np.ones(3))[1:-1]
        most = int(_MOST_EDGE * len(differs))
        first, last = (
            1 + max(np.flatnonzero(edge[:most]), default=-1) for edge in (is_shaded, is_shaded[::-1])
        )
        kept.append(slice(int(first), len(differs) - int(last)))
    return kept[0], kept[1]


def dust_in(logs: Array) -> Mask:
    """Return a mask (H, W) of small spots whose colour is rare on the specimen, given logarithms of colours (H, W, 3).

    A colour that occurs in three spots or more is kept as part of the specimen; the frequency of rarer spots is
    unknown. The mask includes the two pixels around each spot.
    """
    smooth = gaussian_filter(logs, (_DUST_PX, _DUST_PX, 0.0))
    from_median = smooth - np.median(smooth, axis=(0, 1))
    from_median /= 1.4826 * np.median(np.abs(from_median), axis=(0, 1)) + 0.01
    labels, spots, colours = _spots(from_median, _DUST)
    _, _, others = _spots(from_median, _ALIKE)
    strength = np.linalg.norm(colours, axis=1, keepdims=True)
    along = (colours / strength) @ others.T  # [spot, other]
    is_alike = (along > _SAME_STRENGTH * strength) & (
        along > _SAME_DIRECTION * np.linalg.norm(others, axis=1)
    )
    is_small = np.bincount(labels.ravel())[spots] <= _MOST_DUST_PX
    dust = np.isin(labels, spots[is_small & (np.sum(is_alike, axis=1) < _FEW)])
    return np.asarray(binary_dilation(dust, iterations=2)) if dust.any() else dust


def _spots(differences: Array, threshold: float) -> tuple[Indices, Indices, Array]:
    """Return labels of connected pixels that differ (H, W), those of spots (N,), and their mean differences (N, 3)."""
    labels, _ = label(np.any(np.abs(differences) > threshold, axis=-1))
    areas = np.bincount(labels.ravel())
    areas[0] = 0
    spots = np.flatnonzero(areas >= np.pi * _DUST_PX**2)  # smaller ones are noise that was smoothed
    sums = [np.bincount(labels.ravel(), channel.ravel()) for channel in np.moveaxis(differences, -1, 0)]
    return labels, spots, np.stack(sums, axis=-1)[spots] / areas[spots, None]


def blend(sample: Array, size: int, rng: np.random.Generator, *, avoided: Mask | None = None) -> Array:
    """Return a periodic texture in which all parts of a sample are used about equally often.

    Args:
        sample: values of the sample, shape (H, W, C).
        size: side of the texture in pixels.
        rng: random generator of the positions of patches.
        avoided: mask of pixels of the sample that are replaced by others, shape (H, W).

    Returns:
        Values of the texture, shape (size, size, C).

    Raises:
        UsageError: the sample is too small.
    """
    avoided = np.full(sample.shape[:2], False) if avoided is None else avoided
    mean, std = sample[~avoided].mean(axis=0), sample[~avoided].std(axis=0)
    healed = _healed((sample - mean) / np.maximum(std, TINY), avoided, rng)
    return np.asarray(mean + std * quilt(healed, size, rng).blended(healed))


def _healed(values: Array, avoided: Mask, rng: np.random.Generator) -> Array:
    """Return values (H, W, C) whose avoided pixels (H, W) are replaced by others of the sample that fit around them."""
    healed = values.copy()
    for box in find_objects(label(binary_dilation(avoided, iterations=int(2.0 * _DUST_PX)))[0]):
        is_bad = avoided[box]
        height, width = is_bad.shape
        tops = rng.integers(0, len(values) - height + 1, CANDIDATES).tolist()
        lefts = rng.integers(0, values.shape[1] - width + 1, CANDIDATES).tolist()
        places = [
            np.s_[top : top + height, left : left + width] for top, left in zip(tops, lefts, strict=True)
        ]
        best = min(
            places,
            key=lambda place: (np.sum(avoided[place]), np.mean((values[place] - values[box])[~is_bad] ** 2)),
        )
        distance = distance_transform_edt(~is_bad)
        weight = np.clip(1.0 - distance / (2.0 * _DUST_PX), 0.0, 1.0)[..., None]
        healed[box] += weight * (values[best] - healed[box])
    return healed


def _integrated_periodic(slope: Array) -> Array:
    k_y = 2j * np.pi * np.fft.fftfreq(slope.shape[0])[:, None]
    k_x = 2j * np.pi * np.fft.rfftfreq(slope.shape[1])[None, :]
    along_x, along_y = (np.fft.rfft2(slope[..., axis]) for axis in range(2))
    power = np.abs(k_x) ** 2 + np.abs(k_y) ** 2
    power[0, 0] = 1.0
    heights = np.fft.irfft2((k_x * along_x - k_y * along_y) / power, s=slope.shape[:2])
    return np.asarray(heights - heights.mean())
