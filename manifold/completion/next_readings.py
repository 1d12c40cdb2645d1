"""Suggested readings: those that reduce the expected error of a completion most.

Three deviations of a completion are unknown: which hypothesis is right, the colours, and the residual of all
hypotheses. Each is a Gaussian, given by equally probable deviations at the candidate readings and at the values of
interest. A reading reduces the variance v of such a value to `v - c^2 / (s + noise)`, s being the variance of the
reading and c the covariance of both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from manifold.records import Array, Indices

_BALL = 3.0  # weight of the ball against all directions
_LEAST = 1e-4  # added to the standard deviation of every pixel


@dataclass(frozen=True, eq=False)
class Deviations:
    """H equally probable deviations from a completion, of mean zero.

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
        """By how much each candidate reduces the variance of values that deviate by (H, W), shape (D, W)."""
        variance = np.sum(self.at_candidates**2, axis=0) + self.noise
        # A black completion deviates by nothing.
        return np.asarray((self.at_candidates.T @ wanted) ** 2 / (variance + np.finfo(float).tiny)[:, None])

    def after(self, reading: Array, noise: float) -> Deviations:
        """The deviations given a reading, at which they are (H,) now."""
        variance = float(reading @ reading)
        if variance == 0.0:
            return self
        # (I - k r r^T) C, with k such that the covariance becomes the posterior one.
        k = (1.0 - np.sqrt(noise / (variance + noise))) / variance
        tables = (self.at_candidates, self.on_ball, self.everywhere)
        left = [table - k * np.outer(reading, reading @ table) for table in tables]
        return Deviations(left[0], left[1], left[2], self.noise)


def next_readings(unknowns: Sequence[Deviations], count: int) -> Indices:
    """The readings that reduce the expected errors most, chosen greedily.

    The errors are the root mean square over all directions and the mean over the pixels of a ball of their standard
    deviation. The product of the first and the cube of the second is minimised.

    Args:
        unknowns: independent of each other, all at the same D candidates.
        count: how many to choose, at most D.
    Returns:
        Indices of candidates in the order in which to read them, each once, shape (count,).
    """
    left = list(unknowns)
    chosen: list[int] = []
    for _ in range(count):
        cost = _log_errors(left)
        cost[chosen] = np.inf
        best = int(np.argmin(cost))
        chosen.append(best)
        left = [u.after(u.at_candidates[:, best], float(u.noise[best])) for u in left]
    return np.array(chosen, dtype=np.intp)


def _log_errors(unknowns: Sequence[Deviations]) -> Array:
    """Logarithm of the product of both errors after each reading, shape (D,)."""
    all_variance = sum(
        np.sum(u.everywhere**2) - u.variance_reduction(u.everywhere).sum(axis=1) for u in unknowns
    )
    on_ball = sum(np.sum(u.on_ball**2, axis=0) - u.variance_reduction(u.on_ball) for u in unknowns)
    deviation = np.sqrt(np.maximum(on_ball, 0.0)) + _LEAST  # [D, K]
    tiny = np.finfo(float).tiny
    return np.asarray(0.5 * np.log(np.maximum(all_variance, tiny)) + _BALL * np.log(deviation.mean(axis=1)))
