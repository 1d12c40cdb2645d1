"""Which readings to take next: those that tell most of what hypotheses about a material still differ in."""

from __future__ import annotations

import numpy as np

from manifold.records import Array

_NOISE = 0.02  # of a reading's cube root, as a share of it
_FLOOR = 0.1  # of the root mean square over directions: where values are small, noise is of this


def next_readings(
    everywhere: Array,
    candidates: Array,
    probability: Array,
    weights: Array,
    count: int,
    relative: float = 1.0,
) -> Array:
    """The readings that lower the expected variance most, one after the other, as in a Gaussian process.

    Variance is that of cube roots over hypotheses, relative to each one's norm: what is known of a dull material counts
    as much as what is known of a mirror.

    Args:
        everywhere: cube roots of H hypotheses in all directions, shape (H, P).
        candidates: the same at the directions to choose from, shape (H, D).
        probability: of the hypotheses, of sum 1, shape (H,).
        weights: of the directions, shape (P,).
        count: how many to choose, at most D.
        relative: exponent of the norm by which variances are divided.
    Returns:
        Indices of candidates in the order in which to read them, each once, shape (count,).
    """
    norm = np.maximum(everywhere**2 @ weights, np.finfo(float).tiny)
    likely = probability * norm ** (-0.5 * relative)
    likely = likely / likely.sum()
    root = np.sqrt(likely)[:, None]
    C = root * (candidates - likely @ candidates)  # covariances are products of these, [H, D]
    F = root * (everywhere - likely @ everywhere) * np.sqrt(weights)
    square = likely @ candidates**2
    noise = _NOISE**2 * (square + _FLOOR**2 * square.mean())
    chosen: list[int] = []
    for _ in range(min(count, candidates.shape[1])):
        variance = np.sum(C**2, axis=0)
        gain = np.sum((C.T @ F) ** 2, axis=1) / (variance + noise)
        gain[chosen] = -1.0
        best = int(np.argmax(gain))
        chosen.append(best)
        c = C[:, best].copy()
        # What the reading leaves: (1 - k c c') C, with k so that the covariance is that after it.
        total = variance[best] + noise[best]
        k = (1.0 - np.sqrt(noise[best] / total)) / variance[best] if variance[best] > 0.0 else 0.0
        C = C - k * np.outer(c, c @ C)
        F = F - k * np.outer(c, c @ F)
    return np.array(chosen)
