"""Reads photographs as linear values, and finds the outline of the ball in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates, zoom
from scipy.optimize import minimize

from manifold.colour.conversion import encode_srgb
from manifold.colour.picture_files import read_picture
from manifold.colour.saturation import SEARCHED
from manifold.core.errors import FileFormatError, UsageError
from manifold.core.names import percent
from manifold.core.records import Array, Mask

BRIGHT = 0.995
"""Quantile of the pixels that is treated as white in the search for outlines, and as a highlight in that for lamps."""

_LEAST_SIZE = 16
_LEAST_RADIUS = 8.0  # pixels
_COARSE = 128  # pixels of the longer side in which circles are searched
_RADII = 0.08, 0.62  # smallest and largest radius of circles, relative to that
_LEAST_SUPPORT = 0.5  # share of the outline that is an edge
_REFINED = 6  # circles of most votes
_LARGER = 1.3  # least ratio of the radii of an outline and a highlight within it
_ANGLES = 180
_SPANS = (0.2, 0.1, 0.05, 0.03)  # shares of the radius within which edges are sought
_ROUNDS = 8  # rounds in each span
_ON_IT = 0.015  # share of the radius: edges this near lie on a circle
_DIFFERENT = 0.02  # share of the radius: circles this far apart are two
_LEAST_SHARE = 0.7  # share of edges; circles that are drawn to the terminator of real balls have 0.50 to 0.67


@dataclass(frozen=True, eq=False)
class Photograph:
    """A picture in linear values.

    Attributes:
        values: shape (H, W, 3), float32; NaN where the picture is transparent or not finite.
        is_clipped: whether each channel of a pixel is at least as bright as its value, because the camera clipped it,
            shape (H, W, 3).
        notes: assumptions about the file, in sentences.
        is_encoded: whether the values of the file were decoded as sRGB.
        is_certain: whether that follows from the format or was given; otherwise it may be wrong.
    """

    path: Path
    values: Array
    is_clipped: Mask
    notes: tuple[str, ...] = ()
    is_encoded: bool = False
    is_certain: bool = False

    @property
    def factor(self) -> int:
        """Return the factor by which the picture is reduced for the search for outlines and lamps."""
        return max(1, max(self.values.shape[:2]) // SEARCHED)

    def reduced(self, factor: int) -> Photograph:
        """Downsample by `factor`; a channel of a block is clipped if that of any of its pixels is."""
        if factor == 1:
            return self
        clipped = reduced(self.is_clipped.astype(np.float32), factor) > 0.0
        return replace(self, values=reduced(self.values, factor), is_clipped=clipped)


def read_photograph(path: Path, is_linear: bool | None = None) -> Photograph:
    """Read a photograph, see `colour.picture_files.read_picture`."""
    picture = read_picture(path, is_linear, finds_plateaus=True)
    height, width = picture.values.shape[:2]
    if min(height, width) < _LEAST_SIZE:
        raise FileFormatError(
            f"{path}: {width} x {height} pixels, expected at least {_LEAST_SIZE} pixels a side"
        )
    seen: Mask = np.isfinite(picture.values).all(axis=2) & picture.is_opaque
    values = np.where(seen[..., None], picture.values, np.float32(np.nan))
    grey = (f"{path.name}: a grey picture, which does not determine the colour",) * picture.is_grey
    clipped = picture.is_clipped & seen[..., None]
    return Photograph(path, values, clipped, picture.notes + grey, picture.is_encoded, picture.is_certain)


def reduced(values: Array, factor: int) -> Array:
    """Return the means of blocks of `factor` x `factor` pixels; a mean is NaN if one of its pixels is NaN."""
    if factor == 1:
        return values
    H, W = (n // factor * factor for n in values.shape[:2])
    return np.asarray(values[:H, :W].reshape(H // factor, factor, W // factor, factor, -1).mean(axis=(1, 3)))


@dataclass(frozen=True)
class Circle:
    """An outline of centre (x, y), to the right and down, in pixels from the upper left corner of the picture."""

    x: float
    y: float
    radius: float

    def __str__(self) -> str:
        return f"{self.x:.1f},{self.y:.1f},{self.radius:.1f}"

    def scaled(self, factor: float) -> Circle:
        """Return the circle in a picture of `factor` times the size."""
        return Circle(factor * self.x, factor * self.y, factor * self.radius)

    def contains(self, x: Array, y: Array, rim: float) -> Mask:
        """Return whether points (x right, y up from the centre, in radii) lie within a share `rim` of the radius."""
        return np.asarray(x * x + y * y < rim**2)

    def require_inside(self, photograph: Photograph) -> None:
        """Raise UsageError unless the centre lies in the photograph, and the radius suits its size."""
        height, width = photograph.values.shape[:2]
        if not (
            0.0 <= self.x <= width
            and 0.0 <= self.y <= height
            and _LEAST_RADIUS <= self.radius <= np.hypot(width, height)
        ):
            raise UsageError(
                f"{photograph.path}: circle {self.x:.6g},{self.y:.6g},{self.radius:.6g} in a picture of {width} x "
                f"{height}, expected one inside it, of a radius from {_LEAST_RADIUS:g} pixels to its diagonal"
            )

    @classmethod
    def parse(cls, text: str) -> Circle:
        """Parse a circle from `X,Y,R`, or the outline of an upright cylinder from `X,Y,R,H`."""
        try:
            numbers = [float(part) for part in text.split(",")]
        except ValueError:
            numbers = []
        if len(numbers) not in (3, 4) or not np.isfinite(numbers).all() or min(numbers[2:]) <= 0.0:
            raise UsageError(
                f"circle '{text}', expected X,Y,R: centre and radius in pixels, such as 320,240,150; of a cylinder "
                "X,Y,R,H with its height"
            )
        return Circle(*numbers) if len(numbers) == 3 else Cylinder(*numbers)


@dataclass(frozen=True)
class Cylinder(Circle):
    """The outline of an upright cylinder, with `height` pixels used, half of them above the centre."""

    height: float

    def __str__(self) -> str:
        return f"{super().__str__()},{self.height:.1f}"

    def contains(self, x: Array, y: Array, rim: float) -> Mask:
        """Return whether points (x right, y up, in radii from the centre) lie within a share `rim` of the outline."""
        return np.asarray((np.abs(x) < rim) & (np.abs(y) < 0.5 * self.height / self.radius))


def outside(photograph: Photograph, circle: Circle) -> float:
    """Return the share of the area of a circle that lies outside a photograph."""
    across = np.linspace(-circle.radius, circle.radius, _ANGLES)
    x, y = np.meshgrid(circle.x + across, circle.y + across)
    within = np.hypot(x - circle.x, y - circle.y) <= circle.radius
    height, width = photograph.values.shape[:2]
    return float(np.mean((x < 0.0) | (x > width) | (y < 0.0) | (y > height), where=within))


class Outline(NamedTuple):
    """A circle that may be the outline of a ball, with the share of the nearby edges that lie on it."""

    circle: Circle
    share: float

    @property
    def notes(self) -> tuple[str, ...]:
        """A warning if the outline is uncertain, in a sentence; otherwise empty."""
        if self.share >= _LEAST_SHARE:
            return ()
        return (
            f"outline {self.circle}: {percent(self.share)} of the edges near it lie on it; on a ball lit from one "
            "side the others may be its terminator; give its --circle, or pictures under other lamps",
        )


def outlines_in(photographs: Sequence[Photograph]) -> list[Outline]:
    """Return possible outlines of a ball in photographs of the same size, the most likely first.

    The search uses the maximum of the photographs at each pixel, which shows no terminator (the edge of the shadow)
    if the lamps differ.
    """
    for one in photographs:
        if not np.any(np.isfinite(one.values).all(axis=2) & ~one.is_clipped.any(axis=2)):
            raise UsageError(
                f"{one.path}: every pixel is clipped, transparent or not finite, expected a ball; expose it less"
            )
    shown, factor = _display(photographs)
    found = find_outlines(shown, str(photographs[0].path))
    return [one._replace(circle=one.circle.scaled(factor)) for one in found]


def given_outline_notes(photographs: Sequence[Photograph], circle: Circle) -> tuple[str, ...]:
    """Return a warning about a given outline if the edges near it lie on another circle."""
    shown, factor = _display(photographs)
    grey, given = _grey(shown), circle.scaled(1.0 / factor)
    if given.radius < _LEAST_RADIUS:  # its edges are a few pixels
        return ()
    edges = _through_edges(grey, given)
    off = max(float(np.hypot(edges.x - given.x, edges.y - given.y)), abs(edges.radius - given.radius))
    share = _share_of_edges(grey, edges)
    if off < _DIFFERENT * given.radius or share < max(_LEAST_SHARE, _share_of_edges(grey, given)):
        return ()
    return (
        f"the circle {circle} was given, but {percent(share)} of the edges near it lie on {edges.scaled(factor)}, "
        f"{percent(off / given.radius)} of its radius away: check that it is the ball's outline",
    )


def _display(photographs: Sequence[Photograph]) -> tuple[Array, int]:
    """Return the maximum of photographs in display values, and the factor by which it is reduced."""
    factor = photographs[0].factor
    shown = np.max([np.nan_to_num(one.reduced(factor).values) for one in photographs], axis=0)
    return encode_srgb(shown / max(float(np.quantile(shown, BRIGHT)), np.finfo(float).tiny)), factor


def _grey(display: Array) -> Array:
    return np.asarray(gaussian_filter(np.cbrt(np.maximum(display.mean(axis=2), 0.0)), 0.5))


def find_outlines(display: Array, where: str) -> list[Outline]:
    """Return the most pronounced circular edge of a picture of display values in [0, 1] (H, W, 3), in two versions.

    For every radius, gradients vote for centres along their direction; the best circle is refined to a fraction of a
    pixel. If the ball is lit from one side, the edge of its shadow pulls this circle; the other version passes
    through the strongest edges around it. The more likely version comes first. Edges that cover less than half of a
    circle are ignored.

    Source: Ballard 1981, "Generalizing the Hough transform to detect arbitrary shapes".
    """
    grey = np.cbrt(np.maximum(display.mean(axis=2), 0.0))
    factor = min(1.0, _COARSE / max(grey.shape))
    small = zoom(gaussian_filter(grey, 0.5 / factor) if factor < 1.0 else grey, factor, order=1)
    rows, columns = np.gradient(gaussian_filter(small, 1.0))
    strength = np.hypot(rows, columns)
    edges = strength > max(np.quantile(strength, 0.8), 0.05 * strength.max(), 1e-6)
    i, j = np.nonzero(edges)
    down, right = rows[edges] / strength[edges], columns[edges] / strength[edges]
    vote = np.minimum(strength[edges] / np.quantile(strength[edges], 0.9), 1.0) if i.size else strength[edges]
    found: list[tuple[float, Circle]] = []
    for radius in np.arange(max(_RADII[0] * max(small.shape), 4.0), _RADII[1] * max(small.shape)):
        votes = np.zeros(small.shape)
        for sign in (-1.0, 1.0):
            y, x = (
                np.rint(i + sign * radius * down).astype(int),
                np.rint(j + sign * radius * right).astype(int),
            )
            inside = (y >= 0) & (x >= 0) & (y < small.shape[0]) & (x < small.shape[1])
            np.add.at(votes, (y[inside], x[inside]), vote[inside])
        votes = gaussian_filter(votes, 1.0) / radius
        best = np.unravel_index(int(votes.argmax()), votes.shape)
        found.append((float(votes.max()), Circle(float(best[1]), float(best[0]), float(radius))))
    found.sort(key=lambda pair: -pair[0])
    smooth = _grey(display)
    refined = [_refined(smooth, circle, 1.0 / factor) for _, circle in found[:_REFINED]]
    support, circle = max(refined, key=lambda pair: pair[0], default=(0.0, Circle(0.0, 0.0, 0.0)))
    if support < _LEAST_SUPPORT:
        raise UsageError(
            f"{where}: no ball found (edges cover {percent(support)} of the best circle, expected "
            f"{percent(_LEAST_SUPPORT)}); give its circle"
        )
    # A highlight on a dark ball has the sharper edge, but lies within the outline.
    larger = [one for _, one in found if _encloses(one.scaled(1.0 / factor), circle)]
    around = [_refined(smooth, one, 1.0 / factor) for one in larger[:_REFINED]]
    still = [pair for pair in around if pair[1].radius > _LARGER * circle.radius]
    support, enclosing = max(still, key=lambda pair: pair[0], default=(0.0, circle))
    if support >= _LEAST_SUPPORT and _is_within(enclosing, grey):
        circle = enclosing
    both = [Outline(one, _share_of_edges(smooth, one)) for one in (circle, _through_edges(smooth, circle))]
    return sorted(both, key=lambda one: -one.share)


def _encloses(circle: Circle, other: Circle) -> bool:
    """Return whether a circle is clearly larger than another one and contains it."""
    apart = float(np.hypot(circle.x - other.x, circle.y - other.y))
    return circle.radius > _LARGER * other.radius and apart + other.radius < circle.radius


def _is_within(circle: Circle, grey: Array) -> bool:
    """Return whether a circle lies within a picture (H, W)."""
    height, width = grey.shape
    return bool(
        circle.radius <= min(circle.x, width - circle.x) and circle.radius <= min(circle.y, height - circle.y)
    )


def _through_edges(grey: Array, circle: Circle) -> Circle:
    """Return the circle through the strongest edges on rays around another, robust against outliers."""
    for span in _SPANS:
        x, y, gradient, _ = _rays(grey, circle, span)
        at = gradient.argmax(axis=0)
        every = np.arange(len(at))
        strength, x, y = gradient[at, every], x[at, every], y[at, every]
        terms, squares = np.stack([x, y, np.ones(len(x))], axis=1), x**2 + y**2
        weights = strength
        for _ in range(_ROUNDS):
            a, b, c = np.linalg.lstsq(terms * weights[:, None], squares * weights, rcond=None)[0]
            centre, radius = np.array([a, b]) / 2.0, float(np.sqrt(max(c + (a * a + b * b) / 4.0, 1.0)))
            off = np.hypot(x - centre[0], y - centre[1]) - radius
            scale = max(1.5, 1.5 * float(np.median(np.abs(off[strength > 0.3 * strength.max()]))))
            weights = strength / (1.0 + (off / scale) ** 2)
        circle = Circle(float(centre[0]) + 0.5, float(centre[1]) + 0.5, radius)
    return circle


def _share_of_edges(grey: Array, circle: Circle) -> float:
    """Return the share of the strongest edges on rays that lies on a circle."""
    _, _, gradient, radii = _rays(grey, circle, _SPANS[0])
    near = np.abs(radii / circle.radius - 1.0) < _ON_IT
    if not near.any():  # of a pixel's size
        return 0.0
    return float(gradient[near].max(axis=0).sum() / max(gradient.max(axis=0).sum(), np.finfo(float).tiny))


def _rays(grey: Array, circle: Circle, span: float) -> tuple[Array, Array, Array, Array]:
    """Return points x, y (R, A) on rays near a circle, the strength of edges across them there, and radii (R,)."""
    angle = 2.0 * np.pi * np.arange(2 * _ANGLES) / (2 * _ANGLES)
    radii = np.arange((1.0 - span) * circle.radius, (1.0 + span) * circle.radius, 0.5)
    x = circle.x - 0.5 + radii[:, None] * np.cos(angle)
    y = circle.y - 0.5 - radii[:, None] * np.sin(angle)
    profile = map_coordinates(grey, [y, x], order=1, mode="nearest")
    return x, y, np.abs(np.gradient(profile, axis=0)), radii


def _refined(grey: Array, coarse: Circle, scale: float) -> tuple[float, Circle]:
    """Return the share of the outline that is an edge, and a circle at full resolution near a coarse one."""
    angle = 2.0 * np.pi * np.arange(_ANGLES) / _ANGLES

    def contrast(circle: Array, width: float) -> Array:
        x, y, radius = circle
        within, beyond = (
            map_coordinates(grey, [y - r * np.sin(angle), x + r * np.cos(angle)], order=1, mode="nearest")
            for r in (radius - width, radius + width)
        )
        return np.abs(beyond - within)

    found = np.array([(coarse.x + 0.5) * scale - 0.5, (coarse.y + 0.5) * scale - 0.5, coarse.radius * scale])
    for width in (2.0 * scale, scale, 1.0):
        start = found + np.vstack([np.zeros(3), np.eye(3) * width])
        found = minimize(
            lambda circle, width=width: -float(np.mean(np.sqrt(contrast(circle, width)))), found,
            method="Nelder-Mead", options={"initial_simplex": start, "xatol": 0.02, "fatol": 1e-6, "maxiter": 200},
        ).x  # fmt: skip
    width = max(1.0, 0.02 * found[2])
    beside = np.concatenate([contrast(found * np.array([1.0, 1.0, k]), width) for k in (0.85, 1.15)])
    support = float(np.mean(contrast(found, width) > max(2.0 * float(np.median(beside)), 0.01)))
    return support, Circle(float(found[0]) + 0.5, float(found[1]) + 0.5, float(found[2]))
