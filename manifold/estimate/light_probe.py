"""The ball as its own light probe: its outline and the lamps of photographs, from its highlights and shading.

Circle, lamps, gains of pictures, a Lambertian and one GGX lobe are fitted to the pixels together. That the lobe is not
the material's matters little: lamps follow from where pixels are bright, not from how bright.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.optimize import least_squares

from manifold.errors import UsageError
from manifold.estimate.lamps import Lamp
from manifold.estimate.outlines import Circle, Photograph, outlines_in
from manifold.records import Array, Indices, Mask, evenly_spaced

_SIDES = (24, 64)  # pixels across a ball that are compared, to choose a start and to refine it
_RIM = 0.95  # share of the radius that is compared
_FLATNESS = (
    0.3  # standard deviation of the log exponent of the cosine: rough matte materials have less than 1
)
_OUTLINE = 0.003  # standard deviation of the outline that was found, in radii; pictures err alike
_NOISE = 0.03  # error of cube roots, relative to the picture's largest, from which residuals count less
_INDEPENDENT = 30.0  # pixels of a picture whose residuals are independent
_LARGEST_RESIDUAL = 0.12  # relative error of cube roots beyond which no lamp explains a picture
_TOGETHER = 12  # pictures that are fitted together; of more, some evenly spaced
_DOUBTED_DEG = 10.0  # least doubtful angle; lamps are found within 7 degrees in pictures of a matte ball
_BRIGHT = 0.995  # quantile of pixels that are taken for a highlight
_LOBES = (0.1, 0.35)  # alphas from which the fit starts


@dataclass(frozen=True, eq=False)
class Probe:
    """The estimated light of photographs of one ball.

    Attributes:
        circle: the outline, alike in all.
        gains: of every photograph, relative to the first.
        lamp_deg: standard deviation of every lamp's direction, in degrees.
        circle_error: standard deviation of centre and radius, in radii.
        residual: of every photograph's cube roots, relative.
    """

    circle: Circle
    lamps: tuple[Lamp, ...]
    gains: tuple[float, ...]
    lamp_deg: tuple[float, ...]
    circle_error: float
    residual: tuple[float, ...]

    @property
    def notes(self) -> tuple[str, ...]:
        """Return sentences on the estimated lamps and outline, with their uncertainties."""
        shown = "; ".join(
            f"{lamp} +- {off:.1f} degrees" for lamp, off in zip(self.lamps, self.lamp_deg, strict=True)
        )
        return (f"lamps found: {shown}; outline within {100.0 * self.circle_error:.1f} % of the radius",)


def find_light(
    photographs: Sequence[Photograph], circle: Circle | None = None, distance: float = np.inf
) -> Probe:
    """Estimate a fixed ball's outline, and the one lamp of every photograph; photographs have one size.

    A circle that is known nearly is refined; lamps are `distance` radii from the middle of the ball.
    """
    sizes = {one.values.shape[:2] for one in photographs}
    if len(sizes) > 1:
        raise UsageError(
            "photographs of different sizes, expected one camera that stays where it is to find lamps; give the lamps"
        )
    circles = [circle] if circle is not None else [one.circle for one in outlines_in(photographs)]
    factor = photographs[0].factor
    smaller = [one.reduced(factor) for one in photographs]
    fits = [_fit_to(smaller, one.scaled(1.0 / factor), distance) for one in circles]
    pixels, best = min(fits, key=lambda fit: fit[1].cost)
    found = pixels.probe(best, [one.path for one in photographs])
    return replace(found, circle=found.circle.scaled(factor))


def given_lamp_notes(photograph: Photograph, circle: Circle, lamp: Lamp) -> tuple[str, ...]:
    """Return a doubt about a given lamp if the ball looks lit from elsewhere.

    Of materials that are no sum of a diffuse part and a highlight a picture alone says nothing, nor of near lamps.
    """
    if np.isfinite(lamp.distance):
        return ()
    try:
        seen = find_light([photograph], circle)
    except UsageError:
        return ()
    apart = float(np.rad2deg(np.arccos(np.clip(seen.lamps[0].direction @ lamp.direction, -1.0, 1.0))))
    if apart <= max(_DOUBTED_DEG, 3.0 * seen.lamp_deg[0]):
        return ()
    return (
        f"{photograph.path.name}: the lamp was given at {lamp}, but the ball looks lit from {seen.lamps[0]}, "
        f"{apart:.0f} degrees away: is it the lamp of this picture, and x to the right, y up, z to the camera?",
    )


def _fit_to(photographs: Sequence[Photograph], circle: Circle, distance: float) -> tuple[_Pixels, _Fit]:
    """Return the best fit of several starts near an outline.

    If there are many pictures, some determine everything except the others' lamps.
    """
    chosen = evenly_spaced(len(photographs), _TOGETHER)
    some = [photographs[k] for k in chosen]
    coarse, pixels = (_Pixels.of(some, circle, distance, side) for side in _SIDES)
    tried = [coarse.fitted(coarse.start(lamps, alpha)) for lamps in coarse.lamps() for alpha in _LOBES]
    best = pixels.fitted(min(tried, key=lambda fit: fit.cost).x)
    if len(some) == len(photographs):
        return pixels, best
    every = _Pixels.of(photographs, circle, distance, _SIDES[1])
    return every, every.with_others(best, chosen)


@dataclass(frozen=True, eq=False)
class _Fit:
    x: Array
    cost: float
    curvature: Array


@dataclass(frozen=True, eq=False)
class _Pixels:
    """Grey pixels of P photographs that are compared: cube roots relative to the largest of each."""

    circle: Circle
    distance: float
    columns: Array
    rows: Array
    roots: Array
    is_clipped: Mask
    is_seen: Mask
    levels: Array

    @classmethod
    def of(cls, photographs: Sequence[Photograph], circle: Circle, distance: float, side: int) -> _Pixels:
        """Return evenly spaced pixels within the outline, each a mean over its neighbourhood."""
        step = max(2.0 * circle.radius / side, 1.0)
        across = np.arange(-circle.radius, circle.radius, step)
        x, y = (grid.ravel() for grid in np.meshgrid(across, across))
        inside = np.hypot(x, y) < _RIM * circle.radius
        height, width = photographs[0].values.shape[:2]
        columns, rows = circle.x + x[inside], circle.y + y[inside]
        in_picture = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        columns, rows = columns[in_picture], rows[in_picture]
        j, i = columns.astype(int), rows.astype(int)
        roots, clipped, seen, levels = [], [], [], []
        for one in photographs:
            grey = one.values.mean(axis=2)
            is_seen = np.isfinite(grey)
            grey = np.where(is_seen, np.maximum(grey, 0.0), 0.0)
            if step > 1.5:
                grey = gaussian_filter(grey, 0.4 * step)
            level = float(np.quantile(grey[i, j], _BRIGHT))
            if not level > 0.0:
                raise UsageError(f"{one.path}: the ball at {circle} is black, expected a lamp")
            levels.append(level)
            roots.append(np.cbrt(grey[i, j] / level))
            clipped.append(one.is_clipped[i, j])
            seen.append(is_seen[i, j])
        return cls(
            circle,
            distance,
            columns,
            rows,
            np.array(roots),
            np.array(clipped),
            np.array(seen),
            np.array(levels),
        )

    def lamps(self) -> list[Array]:
        """Return directions of the lamps (P, 3), in two versions.

        They take the brightest pixels as a highlight, or as facing the lamp.
        """
        n = self._normals(np.zeros(3))
        bright = np.array(
            [
                np.mean(n[row >= np.quantile(row, _BRIGHT)], axis=0)
                for row in np.where(self.is_seen, self.roots, 0.0)
            ]
        )
        bright /= np.linalg.norm(bright, axis=1, keepdims=True)
        mirrored = 2.0 * bright[:, 2:] * bright - [0.0, 0.0, 1.0]
        return [mirrored, bright]

    def _normals(self, shift: Array) -> Array:
        """Return normals (M, 3) of a far camera's pixels for an outline moved and grown by shares of its radius."""
        radius = self.circle.radius * (1.0 + shift[2])
        x = (self.columns - self.circle.x - shift[0] * self.circle.radius) / radius
        y = (self.circle.y - self.rows - shift[1] * self.circle.radius) / radius
        r = np.maximum(np.hypot(x, y), 1.0)
        x, y = x / r, y / r
        return np.stack([x, y, np.sqrt(np.maximum(1.0 - x * x - y * y, 0.0))], axis=1)

    def _split(self, x: Array) -> tuple[Array, Array, Array, Array]:
        P = len(self.roots)
        return x[:3], x[3:7], x[7 : 7 + 2 * P].reshape(P, 2), x[7 + 2 * P :]

    def predicted(self, x: Array) -> Array:
        """Return cube roots (P, M) of an outline (3), a material (4), lamps (P, 2) and gains (P)."""
        shift, (diffuse, flatness, specular, log_alpha), slopes, gains = self._split(x)
        n = self._normals(shift)
        lamps = _directions(slopes)
        towards, falloff = lamps[None], 1.0  # [1 or M, P, 3]
        if np.isfinite(self.distance):
            away = self.distance * lamps - n[:, None]
            length = np.linalg.norm(away, axis=2, keepdims=True)
            towards, falloff = away / length, (self.distance / length[..., 0]) ** 2
        cos_lamp = np.maximum(np.sum(n[:, None] * towards, axis=2), 0.0)
        half = towards + np.array([0.0, 0.0, 1.0])
        half /= np.linalg.norm(half, axis=2, keepdims=True)
        a2 = np.exp(2.0 * log_alpha)
        cos_half = np.clip(np.sum(n[:, None] * half, axis=2), 0.0, 1.0)
        lobe = a2 / (cos_half**2 * (a2 - 1.0) + 1.0) ** 2 / np.maximum(4.0 * n[:, 2:], 0.1)
        # A fit that is lost does not overflow.
        exponent, strength = np.exp(np.clip(flatness, -5.0, 5.0)), np.exp(min(specular, 50.0))
        shading = np.exp(diffuse) * cos_lamp**exponent + strength * lobe * (cos_lamp > 0.0)
        return np.asarray(np.cbrt(shading * falloff * np.exp(gains) + 1e-6).T)

    def start(self, lamps: Array, alpha: float) -> Array:
        """Return parameters from directions of lamps (P, 3) and roughness."""
        return np.concatenate(
            [np.zeros(3), [0.0, 0.0, -3.0, np.log(alpha)], _slopes(lamps).ravel(), np.zeros(len(lamps))]
        )

    def fitted(self, start: Array) -> _Fit:
        """Fit from some parameters."""
        P, M = self.roots.shape
        scale = np.sqrt(_INDEPENDENT / M) / _NOISE

        def residuals(x: Array) -> Array:
            # Gains and the material have one factor in common.
            return np.concatenate(
                [
                    scale * self._off(x).ravel(),
                    np.sqrt(P) * x[:3] / _OUTLINE,
                    [np.sum(x[-P:]), x[4] / _FLATNESS],
                    (x[5:7] - start[5:7]) / 3.0,
                ]
            )

        depends = np.zeros((P * M + 7, len(start)))
        depends[:, :7] = depends[P * M :] = 1.0
        for p in range(P):
            depends[p * M : (p + 1) * M, [7 + 2 * p, 8 + 2 * p, 7 + 2 * P + p]] = 1.0
        found = least_squares(
            residuals, start, loss="soft_l1", x_scale="jac", jac_sparsity=depends, max_nfev=60
        )
        return _Fit(found.x, float(found.cost), (found.jac.T @ found.jac).toarray())

    def _off(self, x: Array) -> Array:
        """Return predicted less observed cube roots (P, M); clipped pixels count only if the prediction is darker."""
        off = self.predicted(x) - self.roots
        return np.where(self.is_seen, np.where(self.is_clipped, np.minimum(off, 0.0), off), 0.0)

    def with_others(self, fit: _Fit, chosen: Indices) -> _Fit:
        """Return a fit of some pictures with lamp and gain of every other one, which share its outline and material."""
        P, n = len(self.roots), len(chosen)
        x, curvature = np.zeros(7 + 3 * P), np.zeros((7 + 3 * P, 7 + 3 * P))
        own = np.concatenate([np.arange(7), *(7 + 2 * chosen[:, None] + [0, 1]), 7 + 2 * P + chosen]).astype(
            int
        )
        x[own], curvature[np.ix_(own, own)] = fit.x, fit.curvature
        scale, cost = np.sqrt(_INDEPENDENT / self.roots.shape[1]) / _NOISE, fit.cost * P / n
        for p in np.setdiff1d(np.arange(P), chosen):
            one = replace(
                self, roots=self.roots[p : p + 1], is_clipped=self.is_clipped[p : p + 1],
                is_seen=self.is_seen[p : p + 1], levels=self.levels[p : p + 1],
            )  # fmt: skip
            tried = [
                least_squares(
                    lambda y, one=one: scale * one._off(np.concatenate([fit.x[:7], y])).ravel(),
                    np.append(_slopes(lamps), 0.0), loss="soft_l1", max_nfev=60,
                )
                for lamps in one.lamps()
            ]  # fmt: skip
            best = min(tried, key=lambda each: each.cost)
            at = np.array([7 + 2 * p, 8 + 2 * p, 7 + 2 * P + p])
            x[at], curvature[np.ix_(at, at)] = best.x, best.jac.T @ best.jac
        return _Fit(x, cost, curvature)

    def probe(self, fit: _Fit, paths: Sequence[Path]) -> Probe:
        """Return the estimate of a fit."""
        shift, _, slopes, gains = self._split(fit.x)
        residual = np.sqrt(
            np.sum(self._off(fit.x) ** 2, axis=1)
            / np.maximum(np.sum((self.roots * self.is_seen) ** 2, axis=1), 1e-12)
        )
        lost = [str(path.name) for path, one in zip(paths, residual, strict=True) if one > _LARGEST_RESIDUAL]
        if lost:
            raise UsageError(
                f"{', '.join(lost)}: no single lamp explains the ball (residual {residual.max():.0%}, expected at most "
                f"{_LARGEST_RESIDUAL:.0%}); give its --circle, or the lamp by --lamp X,Y,Z or the light by --light"
            )
        covariance = np.linalg.pinv(fit.curvature)
        deviation = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
        circle, radius = self.circle, self.circle.radius
        found = Circle(circle.x + shift[0] * radius, circle.y + shift[1] * radius, radius * (1.0 + shift[2]))
        of_lamps = _directions(slopes)
        # A step of the parameters turns the lamp by about as much in radians: see `_directions`.
        degrees = np.rad2deg(np.hypot(*self._split(deviation)[2].T))
        strength = np.exp(gains) * self.levels
        lamps = tuple(Lamp(direction, self.distance) for direction in of_lamps)
        return Probe(
            found, lamps, tuple((strength / strength[0]).tolist()), tuple(degrees.tolist()),
            float(np.linalg.norm(deviation[:3])), tuple(residual.tolist()),
        )  # fmt: skip


def _directions(slopes: Array) -> Array:
    """Return unit vectors (P, 3) from the halves of their angles from the camera, stereographic: (P, 2)."""
    square = np.sum(slopes**2, axis=1, keepdims=True) / 4.0
    return np.hstack([slopes / (1.0 + square), (1.0 - square) / (1.0 + square)])


def _slopes(directions: Array) -> Array:
    return np.asarray(2.0 * directions[:, :2] / np.maximum(1.0 + directions[:, 2:], 1e-3))
