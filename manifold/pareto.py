"""Which of several settings no other one beats."""

from __future__ import annotations

import numpy as np

from manifold.records import Array


def dominators(costs: Array) -> list[list[int]]:
    """Per row, the rows that are no worse in every column and better in one.

    Args:
        costs: less is better, shape (M, C).
    """
    no_worse = np.all(costs[:, None] <= costs[None], axis=2)
    better = np.any(costs[:, None] < costs[None], axis=2)
    return [[int(j) for j in np.flatnonzero(column)] for column in (no_worse & better).T]


def front(costs: Array) -> Array:
    """Whether no other row dominates a row, bool, shape (M,)."""
    return np.array([not beaten for beaten in dominators(costs)], dtype=bool)
