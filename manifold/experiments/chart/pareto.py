"""Pareto fronts with tolerances."""

from __future__ import annotations

import numpy as np

from manifold.records import Array


def dominators(costs: Array, tolerance: Array | float = 0.0) -> list[list[int]]:
    """Per row, the rows that are better in one column and worse in none.

    Every cost is an interval, known to +- tolerance: it is better, or worse, where intervals do not meet.

    Args:
        costs: less is better, shape (M, C).
        tolerance: broadcasts against the costs.
    """
    low, high = costs - tolerance, costs + tolerance
    better = high[:, None] < low[None]  # [row, than row, C]
    wins = np.asarray(better.any(axis=2))
    dominated_by = (wins & ~wins.T).T
    return [np.flatnonzero(row).tolist() for row in dominated_by]


def front(costs: Array, tolerance: Array | float = 0.0) -> Array:
    """Whether no other row dominates a row, bool, shape (M,)."""
    return np.array([not others for others in dominators(costs, tolerance)], dtype=bool)
