"""Suggested readings: those that reduce the expected error of a completion most.

Three deviations of a completion are unknown: which hypothesis is right, the colours, and the residual of all
hypotheses. Each is a Gaussian, given by samples of zero mean at the candidate readings and at the values of interest.
A reading reduces the variance v of such a value to `v - c^2 / (s + noise)`, s being the variance of the reading and c
the covariance of both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from manifold.models.nearby import NOISE, covariance
from manifold.records import Array

_NOISE = 0.02  # of a reading's cube root under a hypothesis, relative
_COLOUR_NOISE = 0.05  # of a band's difference from the mean of all, as a share of the reading's cube root
_FLOOR = 0.1  # of the root mean square over directions: the noise of smaller values is relative to this
_BALL = 3.0  # weight of the ball against all directions
_MISSED = 0.1  # standard deviation of the residual of all hypotheses, relative to cube roots
_JITTER = 1e-6  # on the diagonal of covariances: candidates may coincide
_LEAST = 1e-4  # added to the standard deviation of every pixel


@dataclass(frozen=True, eq=False)
class ErrorSamples:
    """Equally probable zero-mean samples of the unknown deviation of a completion.

    Attributes:
        at_candidates: cube roots at the candidate readings, shape (H, D).
        on_ball: of the pixels of a ball, shape (H, K).
        everywhere: at all directions, times the square roots of their weights, shape (H, P); P may be 0.
        noise: variance of the noise of the candidates, shape (D,).
    """

    at_candidates: Array
    on_ball: Array
    everywhere: Array
    noise: Array

    def variance_reduction(self, wanted: Array) -> Array:
        """By how much each candidate reduces the variance of values with samples (H, W), shape (D, W)."""
        told = np.sum(self.at_candidates**2, axis=0) + self.noise
        return np.asarray((self.at_candidates.T @ wanted) ** 2 / told[:, None])

    def after(self, reading: Array, noise: float) -> ErrorSamples:
        """The samples conditioned on a reading, at which they are (H,) now."""
        variance = float(reading @ reading)
        if variance == 0.0:
            return self
        # (I - k r r^T) C, with k such that the covariance becomes the posterior one.
        k = (1.0 - np.sqrt(noise / (variance + noise))) / variance
        tables = (self.at_candidates, self.on_ball, self.everywhere)
        left = [table - k * np.outer(reading, reading @ table) for table in tables]
        return ErrorSamples(left[0], left[1], left[2], self.noise)


def hypotheses(
    everywhere: Array, on_ball: Array, candidates: Array, probability: Array, weights: Array
) -> ErrorSamples:
    """Deviations of H hypotheses from their mean.

    Args:
        everywhere: cube roots of the hypotheses in all directions, shape (H, P).
        on_ball: of pixels of a ball, shape (H, K).
        candidates: at the candidate readings, shape (H, D).
        probability: of the hypotheses, of sum 1, shape (H,).
        weights: of the directions, shape (P,).
    """
    root = np.sqrt(probability)[:, None]
    at_candidates, at_pixels, at_directions = (
        root * (table - probability @ table) for table in (candidates, on_ball, everywhere * np.sqrt(weights))
    )
    return ErrorSamples(at_candidates, at_pixels, at_directions, _noise(probability @ candidates**2, _NOISE))


def colours(
    on_ball: Array, candidates: Array, square: Array, taken: Array, taken_square: Array
) -> ErrorSamples:
    """Deviations of bands from the mean over the bands of their material, given the readings that were taken.

    Args:
        on_ball: cube roots of pixels in single bands of materials, less those of the mean over bands, shape (M, K).
        candidates: the same at the candidate readings, shape (M, D).
        square: expected squares of cube roots there, shape (D,).
        taken: as `candidates`, at readings that were taken, shape (M, T).
        taken_square: as `square` there, shape (T,).
    """
    root = 1.0 / np.sqrt(len(on_ball))
    read = root * taken
    left = ErrorSamples(
        np.hstack([root * candidates, read]), root * on_ball, np.zeros((len(on_ball), 0)),
        _noise(np.append(square, taken_square), _COLOUR_NOISE),
    )  # fmt: skip
    count = len(square)
    for d in range(count, left.at_candidates.shape[1]):
        left = left.after(left.at_candidates[:, d], float(left.noise[d]))
    return ErrorSamples(left.at_candidates[:, :count], left.on_ball, left.everywhere, left.noise[:count])


def missed(
    where: Array, taken: Array, level: Array, lit: Array, light: Array, starts: Array, pixels: Array
) -> ErrorSamples:
    """Residuals of all hypotheses, relative to cube roots and correlated as in `nearby`, given the readings taken.

    Args:
        where: places of the candidate readings, shape (D, 3).
        taken: of the readings that were taken, shape (T, 3).
        level: expected cube roots at the candidates, shape (D,).
        lit: places of the direction pairs that light the pixels of a ball, shape (P_b, 3).
        light: from each, shape (P_b,).
        starts: first pair of each pixel, shape (K,).
        pixels: cube roots of the pixels, shape (K,).
    """
    total = np.maximum(np.add.reduceat(light, starts), np.finfo(float).tiny)

    def with_pixels(places: Array) -> Array:
        return np.asarray(np.add.reduceat(covariance(places, lit) * light, starts, axis=1) / total)

    own, of_pixels = covariance(where, where), with_pixels(where)
    if len(taken):
        between = covariance(where, taken)
        told = np.linalg.solve(covariance(taken, taken) + NOISE * np.eye(len(taken)), between.T).T
        own, of_pixels = own - told @ between.T, of_pixels - told @ with_pixels(taken)
    L = np.linalg.cholesky(own + _JITTER * np.eye(len(own)))
    on_ball = solve_triangular(L, of_pixels, lower=True)
    return ErrorSamples(
        _MISSED * L.T * level,
        _MISSED * on_ball * pixels,
        np.zeros((len(L), 0)),
        NOISE * (_MISSED * level) ** 2,
    )


def _noise(square: Array, share: float) -> Array:
    """Variance of the noise of cube roots whose expected squares are (D,)."""
    return np.asarray(share**2 * (square + _FLOOR**2 * square.mean()))


def next_readings(unknowns: Sequence[ErrorSamples], count: int) -> Array:
    """The readings that reduce the expected errors most, chosen greedily.

    The errors are the root mean square over all directions and the mean over the pixels of a ball of their standard
    deviation. The product of the first and the cube of the second is minimised.

    Args:
        unknowns: independent of each other, all at the same D candidates.
        count: how many to choose, at most D.
    Returns:
        Indices of candidates in the order in which to read them, each once, shape (count,).
    """
    held = list(unknowns)
    chosen: list[int] = []
    for _ in range(count):
        cost = _log_errors(held)
        cost[chosen] = np.inf
        best = int(np.argmin(cost))
        chosen.append(best)
        held = [u.after(u.at_candidates[:, best], float(u.noise[best])) for u in held]
    return np.array(chosen, dtype=int)


def _log_errors(unknowns: Sequence[ErrorSamples]) -> Array:
    """Logarithm of the product of both errors after each reading, shape (D,)."""
    all_variance = sum(
        np.sum(u.everywhere**2) - u.variance_reduction(u.everywhere).sum(axis=1) for u in unknowns
    )
    on_ball = sum(np.sum(u.on_ball**2, axis=0) - u.variance_reduction(u.on_ball) for u in unknowns)
    deviation = np.sqrt(np.maximum(on_ball, 0.0)) + _LEAST  # [D, K]
    tiny = np.finfo(float).tiny
    return np.asarray(0.5 * np.log(np.maximum(all_variance, tiny)) + _BALL * np.log(deviation.mean(axis=1)))
