"""The outline of a ball in a photograph."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates, zoom
from scipy.optimize import minimize

from manifold.errors import UsageError
from manifold.records import Array

_COARSE = 128  # pixels of the longer side in which circles are searched
_RADII = 0.08, 0.62  # of circles, relative to that
_LEAST_SUPPORT = 0.5  # share of the outline that is an edge
_ANGLES = 180


@dataclass(frozen=True)
class Circle:
    """An outline, in pixels from the upper left corner of the picture.

    Attributes:
        x, y: centre, to the right and down.
        radius: of the outline.
    """

    x: float
    y: float
    radius: float

    def __str__(self) -> str:
        return f"{self.x:.1f},{self.y:.1f},{self.radius:.1f}"

    def scaled(self, factor: float) -> Circle:
        """The same in a picture of so many times the size."""
        return Circle(factor * self.x, factor * self.y, factor * self.radius)

    @classmethod
    def parse(cls, text: str) -> Circle:
        """A circle of `X,Y,R`.

        Raises:
            UsageError: these are not three finite numbers, or the radius is not positive.
        """
        try:
            x, y, radius = (float(part) for part in text.split(","))
        except ValueError:
            x = y = radius = np.nan
        if not np.isfinite([x, y, radius]).all() or radius <= 0.0:
            raise UsageError(
                f"circle '{text}', expected X,Y,R: centre and radius in pixels, such as 320,240,150"
            )
        return cls(x, y, radius)


def find_circle(display: Array, where: str) -> Circle:
    """The most pronounced circular edge of a picture of display values in [0, 1], shape (H, W, 3).

    Gradients vote for centres along their direction, radius by radius; the best is refined to parts of a pixel.

    Raises:
        UsageError: no circle is an edge over half of its length.
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
    smooth = gaussian_filter(grey, 0.5)
    refined = [_refined(smooth, circle, 1.0 / factor) for _, circle in found[:6]]
    support, circle = max(refined, key=lambda pair: pair[0], default=(0.0, Circle(0.0, 0.0, 0.0)))
    if support < _LEAST_SUPPORT:
        raise UsageError(
            f"{where}: no ball found (the best circle is an edge over {support:.0%} of its length, expected "
            f"{_LEAST_SUPPORT:.0%}); give its circle"
        )
    return circle


def _refined(grey: Array, coarse: Circle, scale: float) -> tuple[float, Circle]:
    """Share of the outline that is an edge, and a circle at full resolution near a coarse one."""
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
