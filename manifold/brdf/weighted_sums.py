"""Weighted sums of measured BRDFs, or of their cube roots, evaluated together for each direction pair."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numba as nb
import numpy as np

from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.pairs import DirectionPairs, Symmetry
from manifold.brdf.summed_lookup import GROUP, add_located
from manifold.records import Array


class WeightedSum:
    """The sum of weight * f of measured materials, or of weight times the signed cube root of f."""

    def __init__(
        self, materials: Sequence[MeasuredBRDF], weights: Sequence[float] | Array, *, cube_root: bool
    ):
        """Prepare a sum.

        Args:
            materials: of the same bands.
            weights: one per material, used in single precision.
            cube_root: add roots instead of f.
        """
        self._cube_root = cube_root
        alike: dict[Any, list[tuple[Any, float]]] = {}  # compiled loops take tables of the same types
        for material, weight in zip(materials, weights, strict=True):
            tables = material.tables
            alike.setdefault((material.symmetry, nb.typeof(tables)), []).append((tables, weight))
        self._groups: list[tuple[Symmetry, Any, Array]] = []
        for (symmetry, _), terms in alike.items():
            for first in range(0, len(terms), GROUP):
                group = terms[first : first + GROUP]
                group += [(group[0][0], 0.0)] * (GROUP - len(group))
                tables, shares = zip(*group, strict=True)
                self._groups.append((symmetry, tables, np.array(shares, dtype=np.float32)))

    def add_to(self, total: Array, pairs: DirectionPairs) -> None:
        """Add the sum at K direction pairs, on one core and outside the interpreter's lock.

        Args:
            total: added to, float64, C-contiguous, shape (K, B).
            pairs: those below the horizon add nothing.
        """
        for symmetry, tables, weights in self._groups:
            add_located(pairs.located(*symmetry), tables, weights, self._cube_root, total)
