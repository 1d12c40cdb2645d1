"""Evaluates weighted sums of measured BRDFs, or of their cube roots, at direction pairs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from manifold.brdf.measured import MeasuredBRDF
from manifold.core.compiled import loops
from manifold.core.pairs import Pairs, Symmetry
from manifold.core.records import Array


class WeightedSum:
    """The sum of weight * f of measured materials, or of weight times the signed cube root of f."""

    dtype = np.float32  # of totals

    def __init__(
        self, materials: Sequence[MeasuredBRDF], weights: Sequence[float] | Array, *, cube_root: bool
    ):
        """Prepare a sum of f, or of its cube roots, over materials of the same bands.

        The weights are rounded to single precision.
        """
        self._cube_root = cube_root
        terms: dict[
            Symmetry, list[tuple[loops.Tables, float]]
        ] = {}  # one symmetry shares the places of pairs
        for material, weight in zip(materials, weights, strict=True):
            if weight != 0.0:
                terms.setdefault(material.symmetry, []).append((material.tables, float(weight)))
        self._groups = [
            (symmetry, [tables for tables, _ in alike], np.array([weight for _, weight in alike], np.float32))
            for symmetry, alike in terms.items()
        ]

    def add_to(self, total: Array, pairs: Pairs) -> None:
        """Add the sum at K direction pairs to `total` (K, B), a C-contiguous array of `dtype`.

        The loop runs on one core, without the interpreter's lock. Pairs below the horizon add 0.
        """
        for symmetry, tables, weights in self._groups:
            loops.add_located(pairs.located(*symmetry), tables, weights, self._cube_root, total)
