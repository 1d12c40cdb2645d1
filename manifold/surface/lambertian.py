"""Fits a Lambertian surface to pictures from above, point by point (photometric stereo).

    N_j = A (1 + slope . t_j)

N_j is the brightness of a point in picture j relative to the picture's mean, `t_j` the tangent of the lamp's angle
along x and y, and A the albedo times the z component of the normal. Ratios to means do not depend on the strengths of
lamps, and a sample that lies flat has no mean slope. The noise of the pictures follows from their residuals, and the
prior of the slopes from the slopes themselves (empirical Bayes), so that slopes shrink as far as noise requires.
Source: Woodham 1980, "Photometric method for determining surface orientation from multiple images".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from manifold.core.defaults import TINY
from manifold.core.records import Array
from manifold.surface.lamp_pictures import SurfacePictures
from manifold.surface.response import CODE_NOISE, SLOPE_STD

_ROUNDS = 6  # of the fit, its noise, its prior and its outliers
OUTLIER = 4.0
"""Standard deviations, beyond which residuals count much less: 3 leaves out true relief, larger values keep glints."""

# Slope of 79 degrees: points without light have steeper ones; and standard deviation of slopes in the first round.
_STEEPEST = 5.0
_UNKNOWNS = 3  # albedo and two slopes
# Largest ratio of a picture's noise to that of all, and inverse of the smallest: residuals of few pictures determine
# it poorly.
_NOISIER = 4.0
_TO_STD = 1.4826  # of a median absolute deviation
# Least share of a slope after shrinking, from which its size is estimated; 0 across a row of lamps.
_LEAST_KEPT = 0.1
_SAMPLED = 40_000  # points, by which noise and prior are estimated
_BLOCK = 65_536  # points that are fitted at once


@dataclass(frozen=True, eq=False)
class LambertianFit:
    """A Lambertian surface of H x W points.

    Attributes:
        albedo: relative albedo of every point, shape (H, W, 3).
        slope: x and y components of the normal over its z component, shape (H, W, 2).
        slope_std: standard deviations of both components, shape (2,).
        residual: difference of the logarithms of brightness and fit, shape (J, H, W).
    """

    albedo: Array
    slope: Array
    slope_std: Array
    residual: Array


def tangents(lamps: Array) -> Array:
    """Return the tangents of the lamps' angles along x and y, shape (J, 2); 0 for diffuse light."""
    return np.asarray(np.nan_to_num(lamps[:, :2] / lamps[:, 2:]))


def fit_lambertian(pictures: SurfacePictures) -> LambertianFit:
    """Fit albedo and slope of every point to pictures, robust to glints and shadows."""
    J, H, W, _ = pictures.values.shape
    means = pictures.values.mean(axis=(1, 2))
    values = pictures.values.reshape(J, H * W, 3)
    design = np.column_stack([np.ones(J), tangents(pictures.lamps)])
    some = np.sort(np.random.default_rng(0).permutation(H * W)[:_SAMPLED])
    rounds = _rounds(_relative(values[:, some], means), design, _first_noise(pictures))
    albedo, slope, variance, residual = (
        np.empty((H * W, 3)), np.empty((H * W, 2)), np.zeros(2), np.empty((J, H * W)),
    )  # fmt: skip
    for first in range(0, H * W, _BLOCK):
        part = slice(first, first + _BLOCK)
        relative = _relative(values[:, part], means)
        weights: Array = np.ones(relative.shape[:2])
        for spread in rounds:
            points = _solve(relative, design, weights, spread)
            weights = _trust(points.off, spread.noise)
        slope[part] = points.slope
        albedo[part] = _colours(relative, points.shading, weights / spread.noise**2)
        variance += points.slope_variance.sum(axis=0)
        fitted = points.level[:, None] * np.maximum(points.shading, TINY)
        residual[:, part] = np.log(np.maximum(points.grey, TINY) / fitted).T
    albedo *= np.sqrt(1.0 + np.sum(slope**2, axis=1, keepdims=True))
    return LambertianFit(
        albedo.reshape(H, W, 3),
        slope.reshape(H, W, 2),
        np.sqrt(variance / (H * W)),
        residual.reshape(J, H, W),
    )


def _relative(values: Array, means: Array) -> Array:
    """Return values (J, P, 3) divided by the means of their pictures (J, 3), shape (P, J, 3)."""
    return np.ascontiguousarray(np.moveaxis(values / means[:, None], 0, 1))


def _first_noise(pictures: SurfacePictures) -> Array:
    """Return the noise of the pictures (J,) relative to their means, before their residuals are known.

    Three pictures leave no residual: their noise is what differs from pixel to pixel, at most that of a camera.
    """
    noise = np.full(len(pictures.labels), CODE_NOISE / float(pictures.values.mean()))
    if len(noise) > _UNKNOWNS:
        return noise
    grey = pictures.values.mean(axis=3)
    return np.minimum(noise, _pixel_noise(grey / grey.mean(axis=(1, 2), keepdims=True)))


class _Spread(NamedTuple):
    """Noise of the J pictures, (J,), relative; standard deviation of slopes; weights of channels (3,), with sum 1."""

    noise: Array
    prior_std: float
    of_channel: Array


def _rounds(relative: Array, design: Array, noise: Array) -> list[_Spread]:
    """Return the spreads of each round of a fit to some points (P, J, 3), which every point repeats."""
    weights: Array = np.ones(relative.shape[:2])
    rounds = [_Spread(noise, _STEEPEST, np.full(3, 1.0 / 3.0))]
    while len(rounds) < _ROUNDS:
        spread = rounds[-1]
        points = _solve(relative, design, weights, spread)
        weights = _trust(points.off, spread.noise)
        colour = _colours(relative, points.shading, weights / spread.noise**2)
        rounds.append(
            _Spread(
                _noise_of(points, design, spread.noise) if len(noise) > _UNKNOWNS else noise,
                # Not in the first round, whose noise is a guess.
                _std_of_slopes(points, spread.prior_std) if len(rounds) > 1 else SLOPE_STD,
                _channel_weights(relative, colour, points.shading),
            )
        )
    return rounds


class _Points(NamedTuple):
    """P points that are fitted to J pictures.

    Attributes:
        grey: brightness, the weighted mean of the channels, shape (P, J).
        level: A, shape (P,).
        slope: shape (P, 2).
        covariance: covariance of A and A slope, relative to A, shape (P, 3, 3).
        off: brightness over A, less the fitted shading, shape (P, J).
        shading: fitted brightness over A, never negative, shape (P, J).
    """

    grey: Array
    level: Array
    slope: Array
    covariance: Array
    off: Array
    shading: Array

    @property
    def slope_variance(self) -> Array:
        """Return the variances of both components of the slopes, shape (P, 2)."""
        return np.diagonal(self.covariance, axis1=1, axis2=2)[:, 1:]


def _solve(relative: Array, design: Array, weights: Array, spread: _Spread) -> _Points:
    """Fit points to values (P, J, 3) with weights (P, J)."""
    noise, prior_std, of_channel = spread
    grey = relative @ of_channel
    products = (design[:, :, None] * design[:, None, :] / noise[:, None, None] ** 2).reshape(len(design), 9)
    prior = np.diag([0.0, prior_std**-2, prior_std**-2])
    covariance = np.linalg.inv((weights @ products).reshape(-1, 3, 3) + prior)
    right = (weights * grey) @ (design / noise[:, None] ** 2)
    fitted = np.einsum("pkl,pl->pk", covariance, right)
    level = np.maximum(fitted[:, 0], TINY)
    slope = np.clip(fitted[:, 1:] / level[:, None], -_STEEPEST, _STEEPEST)
    shading = 1.0 + slope @ design[:, 1:].T
    return _Points(grey, level, slope, covariance, grey / level[:, None] - shading, np.maximum(shading, 0.0))


def _colours(relative: Array, shading: Array, weights: Array) -> Array:
    """Return A in each channel (P, 3) from values (P, J, 3), for known shading (P, J)."""
    lit = weights * shading
    total = np.maximum(np.sum(lit * shading, axis=1, keepdims=True), TINY)
    return np.maximum(np.einsum("pj,pjc->pc", lit, relative) / total, TINY)


def _noise_of(points: _Points, design: Array, noise: Array) -> Array:
    """Return the noise of the pictures (J,) from their residuals, by the degrees of freedom left."""
    leverage = np.einsum("jk,kl,jl->j", design, points.covariance.mean(axis=0), design) / noise**2
    spread = _TO_STD * np.median(np.abs(points.off), axis=0)
    common = float(np.sqrt(np.mean(spread**2) / max(1.0 - float(leverage.mean()), TINY)))
    own = spread / np.sqrt(np.maximum(1.0 - leverage, TINY))
    return np.maximum(np.clip(own, common / _NOISIER, common * _NOISIER), TINY)


def _std_of_slopes(points: _Points, prior_std: float) -> float:
    """Return the standard deviation of slopes without noise, from fitted ones and their variances.

    A prior shrinks a slope by the factor 1 - variance / prior variance, and its noise alike.
    """
    slope, variance = points.slope, points.slope_variance.mean(axis=0)
    kept = 1.0 - variance / prior_std**2
    is_known = kept > _LEAST_KEPT
    if not is_known.any():
        return prior_std
    of_truth = (np.mean(slope**2, axis=0) / kept**2 - variance / kept)[is_known]
    return float(np.sqrt(max(float(np.mean(of_truth)), TINY**2)))


def _trust(off: Array, noise: Array) -> Array:
    """Return weights (P, J): small ones of residuals far beyond the noise and the point's other residuals."""
    own = _TO_STD * np.median(np.abs(off), axis=1, keepdims=True)
    return np.asarray(1.0 / (1.0 + (off / (OUTLIER * np.maximum(noise, own))) ** 2) ** 2)


def _channel_weights(relative: Array, colour: Array, shading: Array) -> Array:
    """Return weights of the channels (3,), with sum 1, from their residuals (P, J, 3) relative to a point's colour."""
    off = np.median(np.abs(relative / colour[:, None] - shading[..., None]), axis=(0, 1))
    weights = 1.0 / np.maximum(_TO_STD * off, TINY) ** 2
    return np.asarray(weights / weights.sum())


def _pixel_noise(grey: Array) -> float:
    """Return the noise of pictures (J, H, W) that share their albedo, from differences of neighbouring pixels.

    Source: Donoho & Johnstone 1994, "Ideal spatial adaptation by wavelet shrinkage" (diagonal Haar coefficients).
    """
    apart = grey - grey.mean(axis=0)
    diagonal = 0.5 * (apart[:, 1:, 1:] - apart[:, :-1, 1:] - apart[:, 1:, :-1] + apart[:, :-1, :-1])
    squares = np.median(np.abs(diagonal), axis=(1, 2)) ** 2
    return max(_TO_STD * float(np.sqrt(np.mean(squares) / (1.0 - 1.0 / len(grey)))), TINY)
