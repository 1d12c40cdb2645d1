"""Image differences: CIEDE2000 and Delta E_ITP per pixel, and FLIP.

Source: Andersson, Nilsson, Akenine-Moller, Oskarsson, Astrom, Fairchild 2020, FLIP: A Difference Evaluator for
Alternating Images, Proc. ACM Comput. Graph. Interact. Tech. 3(2), DOI 10.1145/3406183. Its low-dynamic-range form.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from manifold.colour.conversion import decode_srgb, srgb_to_xyz, xyz_to_srgb
from manifold.colour.difference import delta_e_2000, delta_e_itp, to_lab
from manifold.errors import ShapeError
from manifold.records import Array

PIXELS_PER_DEGREE = 67.0
"""Of a viewer 0.7 m from a 0.7 m wide display with 3840 columns."""

# Contrast sensitivity of the achromatic, red-green and blue-yellow channels: two Gaussians each, table 1.
_SENSITIVITY = (
    ((1.0, 0.0047), (0.0, 1e-5)),
    ((1.0, 0.0053), (0.0, 1e-5)),
    ((34.1, 0.04), (13.5, 0.025)),
)
_COLOUR_EXPONENT, _KNEE, _KNEE_VALUE = 0.7, 0.4, 0.95
_FEATURE_WIDTH_DEG, _FEATURE_EXPONENT = 0.082, 0.5
_WHITE = np.array([1.0, 1.0, 1.0])


@dataclass(frozen=True)
class Summary:
    """Statistics of a map of differences."""

    mean: float
    median: float
    p95: float
    max: float

    @classmethod
    def of(cls, values: Array) -> Summary:
        """Of all values of an array."""
        return cls(
            float(np.mean(values)),
            float(np.median(values)),
            float(np.quantile(values, 0.95)),
            float(np.max(values)),
        )


def ciede2000_map(display: Array, other: Array) -> Array:
    """CIEDE2000 between display values in [0, 1], shapes (H, W, 3), relative to the display's white; shape (H, W)."""
    require_pictures(display, other)
    xyz, xyz_other = (srgb_to_xyz(decode_srgb(np.clip(p, 0.0, 1.0))) for p in (display, other))
    return delta_e_2000(xyz, xyz_other, srgb_to_xyz(_WHITE))


def itp_map(display: Array, other: Array) -> Array:
    """Delta E_ITP between display values in [0, 1], shapes (H, W, 3); shape (H, W)."""
    require_pictures(display, other)
    return delta_e_itp(*(srgb_to_xyz(decode_srgb(np.clip(p, 0.0, 1.0))) for p in (display, other)))


def flip_map(reference: Array, test: Array, pixels_per_degree: float = PIXELS_PER_DEGREE) -> Array:
    """FLIP between display values in [0, 1], shapes (H, W, 3): 0 alike to 1 as different as can be, shape (H, W).

    Raises:
        ShapeError: the pictures do not have the same size, or no three channels.
    """
    require_pictures(reference, test)
    a, b = (_opponent(decode_srgb(np.clip(p, 0.0, 1.0))) for p in (reference, test))
    colour = _colour_difference(a, b, pixels_per_degree)
    feature = _feature_difference(a[..., 0], b[..., 0], pixels_per_degree)
    return colour ** (1.0 - feature)


def require_pictures(a: Array, b: Array) -> None:
    """Raise ShapeError unless two pictures have the same size and three channels."""
    if a.shape != b.shape or a.ndim != 3 or a.shape[2] != 3:
        raise ShapeError(
            f"pictures have shapes {a.shape} and {b.shape}, expected the same (height, width, 3); render both alike"
        )


# -- colour ---------------------------------------------------------------------------------------------------


def _colour_difference(a: Array, b: Array, pixels_per_degree: float) -> Array:
    """Section 4.1: HyAB between what an eye resolves, compressed to [0, 1]."""
    seen = (_uniform(_filtered(picture, pixels_per_degree)) for picture in (a, b))
    difference = _hyab(*seen) ** _COLOUR_EXPONENT
    green, blue = _uniform(np.array([0.0, 1.0, 0.0])), _uniform(np.array([0.0, 0.0, 1.0]))
    largest = _hyab(green, blue) ** _COLOUR_EXPONENT
    knee = _KNEE * largest
    low = _KNEE_VALUE / knee * difference
    high = _KNEE_VALUE + (difference - knee) / (largest - knee) * (1.0 - _KNEE_VALUE)
    return np.where(difference < knee, low, high)


def _opponent(linear: Array) -> Array:
    """Linear sRGB (..., 3) as `Y Cx Cz`: CIELAB without its cube root."""
    x, y, z = np.moveaxis(srgb_to_xyz(linear) / srgb_to_xyz(_WHITE), -1, 0)
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=-1)


def _from_opponent(opponent: Array) -> Array:
    """The inverse of `_opponent`."""
    y = (opponent[..., 0] + 16.0) / 116.0
    xyz = np.stack([y + opponent[..., 1] / 500.0, y, y - opponent[..., 2] / 200.0], axis=-1)
    return xyz_to_srgb(xyz * srgb_to_xyz(_WHITE))


def _filtered(opponent: Array, pixels_per_degree: float) -> Array:
    """A picture in linear sRGB in [0, 1], filtered by contrast sensitivity."""
    widest = max(b for channel in _SENSITIVITY for _a, b in channel)
    radius = int(np.ceil(3.0 * np.sqrt(widest / (2.0 * np.pi**2)) * pixels_per_degree))
    x2 = (np.arange(-radius, radius + 1) / pixels_per_degree) ** 2
    channels = []
    for k, gaussians in enumerate(_SENSITIVITY):
        blurred: Array | float = 0.0
        total = 0.0
        for a, b in gaussians:
            if a == 0.0:
                continue
            # A sum of round Gaussians: each is a product of one per axis.
            profile = np.exp(-(np.pi**2) * x2 / b)
            height = a * np.sqrt(np.pi / b)
            blurred = blurred + height * _blur(opponent[..., k], profile, profile)
            total += height * profile.sum() ** 2
        channels.append(np.asarray(blurred) / total)
    return np.clip(_from_opponent(np.stack(channels, axis=-1)), 0.0, 1.0)


def _uniform(linear: Array) -> Array:
    """CIELAB of linear sRGB (..., 3), colours weighted by lightness as by the Hunt effect."""
    lab = to_lab(srgb_to_xyz(linear), srgb_to_xyz(_WHITE))
    return np.concatenate([lab[..., :1], 0.01 * lab[..., :1] * lab[..., 1:]], axis=-1)


def _hyab(a: Array, b: Array) -> Array:
    """City-block distance in lightness plus Euclidean distance in chroma."""
    d = a - b
    return np.abs(d[..., 0]) + np.hypot(d[..., 1], d[..., 2])


# -- features -------------------------------------------------------------------------------------------------


def _feature_difference(a: Array, b: Array, pixels_per_degree: float) -> Array:
    """Section 4.2: how much edges and points of two achromatic channels differ."""
    sigma = 0.5 * _FEATURE_WIDTH_DEG * pixels_per_degree
    radius = int(np.ceil(3.0 * sigma))
    x = np.arange(-radius, radius + 1.0)
    gaussian = np.exp(-(x**2) / (2.0 * sigma**2))
    edge, point = -x * gaussian, (x**2 / sigma**2 - 1.0) * gaussian
    differences = []
    for profile in (edge, point):
        in_a, in_b = (_strength((picture + 16.0) / 116.0, profile, gaussian) for picture in (a, b))
        differences.append(np.abs(in_a - in_b))
    largest: Array = np.maximum(*differences)
    return np.asarray((largest / np.sqrt(2.0)) ** _FEATURE_EXPONENT)


def _strength(picture: Array, profile: Array, gaussian: Array) -> Array:
    """Length of the response to a profile along both axes, positive and negative weights normalised each."""
    weights = np.outer(gaussian, profile)
    positive, negative = weights[weights > 0].sum(), -weights[weights < 0].sum()
    up, down = np.maximum(profile, 0.0) / positive, np.minimum(profile, 0.0) / negative
    horizontal = _blur(picture, gaussian, up + down)
    vertical = _blur(picture, up + down, gaussian)
    return np.hypot(horizontal, vertical)


def _blur(picture: Array, down: Array, across: Array) -> Array:
    """Correlation with one profile per axis; edge pixels are repeated."""
    from scipy.ndimage import correlate1d  # which pictures that are not compared do without

    blurred: Array = correlate1d(picture, down, axis=0, mode="nearest")
    return np.asarray(correlate1d(blurred, across, axis=1, mode="nearest"))
