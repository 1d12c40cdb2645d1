"""Finds saturated pixels of pictures whose largest value is not the largest code.

A camera's sensor saturates at one level. White balance, exposure, fewer bits or another scale move that level below
the largest code; interpolation of colours, noise and compression spread it. What stays is a plateau: many pixels
near the largest value, few slightly below it, and values that fall off around it. Near a smooth maximum, in contrast,
values are evenly distributed. An evenly lit object is as flat as a plateau, but ends at its edge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation, distance_transform_edt, find_objects, label, median_filter

from manifold.core.records import Array, Mask

SEARCHED = 800
"""Longer side in pixels, at least, of reduced pictures in which plateaus, outlines and lamps are sought."""

_WIDTHS = (0.01, 0.02, 0.04, 0.08)  # of plateaus, relative to their level: noise and compression widen them
_WIDER = 1.1  # least ratio of pixels for which a plateau is taken to be wider; more misses noisy pixels
_MANY = 6.0  # least ratio of pixels on a plateau to those slightly below; 2.4 at the ridge of a cylinder
_FEWEST = 16  # pixels of a plateau
_FEW = 4  # brighter pixels that sharpening and compression leave
_OF_BYTES = 257  # of which 16-bit codes are multiples that were eight bits
_CUT_OFF = 0.4  # largest share of a plateau's outline on the edge of the picture; of a background one half
_NEAR = 0.2  # distance from a plateau in its radii, beyond what blur mixes: 0.12 takes small even discs for plateaus
_BRIGHT = 0.75  # quantile of the values just beside a plateau, whose dark sides pull the median down
# Least share of the fall from a plateau to its surroundings that is farther away; blurred even discs have none.
_LEAST_FALL = 0.15


@dataclass(frozen=True, eq=False)
class Plateau:
    """The saturated pixels of a channel.

    Attributes:
        level: their stored value.
        pixels: mask of these pixels, shape (H, W).
    """

    level: float
    pixels: Mask


def find_plateau(channel: Array) -> Plateau | None:
    """Return the plateau at the top of a channel of codes or floats (H, W); None if there is none."""
    step = 1.0 if channel.dtype.kind == "u" else 0.0
    is_fine = channel.dtype == np.uint16
    values = np.where(np.isfinite(channel), channel, 0).astype(np.float32)
    factor = max(1, max(values.shape) // SEARCHED)
    h, w = (n // factor * factor for n in values.shape)
    small = values[:h, :w].reshape(h // factor, factor, w // factor, factor).mean(axis=(1, 3))
    smooth = median_filter(small, 3)
    top = float(np.partition(smooth.ravel(), -_FEW)[-_FEW]) if smooth.size > _FEW else 0.0
    if not top > 0.0:
        return None
    best, most = None, 0
    for width in sorted({max(relative * top, step) for relative in _WIDTHS}):
        found = _plateaus(smooth, top, width, is_fine and top % _OF_BYTES != 0.0)
        if (count := int(np.count_nonzero(found))) > _WIDER * most:
            best, most = (found, width), count
    if best is None:
        return None
    found, width = best
    around = np.repeat(np.repeat(binary_dilation(found), factor, axis=0), factor, axis=1)
    pixels = np.zeros(channel.shape, dtype=bool)
    pixels[:h, :w] = around & (values[:h, :w] > top - width)
    return Plateau(float(np.median(values[pixels])), pixels)


def _plateaus(values: Array, top: float, width: float, is_fine: bool) -> Mask:
    """Return the pixels of plateaus within a width of the largest value.

    In codes of more than eight bits, no light is so even that most pixels have the very same value.
    """
    on, near = values > top - width, values > top - 3.0 * width
    labels, count = label(near)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)
    flat = np.bincount(labels[on], minlength=count + 1)
    below = (sizes - flat) / 2.0  # in one width
    many = (flat >= _FEWEST) & (flat >= _MANY * (below + 1.0))
    found = np.zeros(values.shape, dtype=bool)
    places = find_objects(labels)
    for k in np.flatnonzero(many[1:]) + 1:
        part = labels == k  # without the holes that noise makes
        if _is_background(part):
            continue
        is_exact = is_fine and np.median(values[part]) == top
        if is_exact or _falls_off(values, part, places[k - 1], top):
            found |= on & part
    return found


def _is_background(part: Mask) -> bool:
    """Return whether much of the outline of a part of a picture is the picture's own."""
    inside = np.pad(part, 1)
    around = binary_dilation(inside) & ~inside
    count = np.count_nonzero(around)
    return bool(count - np.count_nonzero(around[1:-1, 1:-1]) > _CUT_OFF * count)


def _falls_off(values: Array, plateau: Mask, place: tuple[slice, slice], top: float) -> bool:
    """Return whether values fall off around a plateau, rather than at its edge."""
    radius = float(distance_transform_edt(np.pad(plateau[place], 1)).max())
    near = max(_NEAR * radius, 1.0)
    far = 3.0 * near
    margin = int(far) + 2
    rows, columns = (
        slice(max(part.start - margin, 0), min(part.stop + margin, n))
        for part, n in zip(place, values.shape, strict=True)
    )
    apart = distance_transform_edt(~plateau[rows, columns])
    around = values[rows, columns]
    beside, beyond = (around[np.abs(apart - d) <= 0.5] for d in (near, far))
    if not (len(beside) and len(beyond)):
        return False
    base = float(np.median(beyond))
    return float(np.quantile(beside, _BRIGHT)) - base >= _LEAST_FALL * (top - base)
