"""Colour errors of predictions: the mean CIEDE2000 of the ball under the studio light, by quadrature."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.pairs import DirectionPairs
from manifold.colour import ball_colours
from manifold.model.combination import Combination, Values, evaluate
from manifold.records import Array

_AT_ONCE = 8  # predictions evaluated together


class BallErrors:
    """Balls of N materials in some of their bands, and how predictions of them differ.

    Attributes:
        pairs: direction pairs (P,) that light a ball; see `ball_colours.Ball`.
        values: of the materials there.
    """

    def __init__(self, materials: Sequence[MeasuredBRDF], bands: Array) -> None:
        """Colour the balls in bands (B',)."""
        self._ball = ball_colours.ball()
        self._bands = materials[0].bands.select(bands)
        self.pairs = DirectionPairs(self._ball.wi, self._ball.wo)
        self.values = Values.at([material.select_bands(bands.tolist()) for material in materials], self.pairs)
        self._chosen = bands
        self._xyz = [self._ball.xyz(f, self._bands) for f in self.values.f]

    def delta_e(self, i: int, f: Array) -> float:
        """Mean CIEDE2000 between material i and values f (P, B') in 1/sr."""
        return self.differences(i, f)[0]

    def differences(self, i: int, f: Array) -> tuple[float, float]:
        """Mean CIEDE2000 and mean Delta E_ITP between material i and values f (P, B') in 1/sr."""
        pair = self._xyz[i], self._ball.xyz(f, self._bands)
        return ball_colours.delta_e(*pair), ball_colours.delta_e_itp(*pair)

    def of(self, combinations: Sequence[Combination]) -> Array:
        """Mean CIEDE2000 of a prediction per material, shape (N,)."""
        return self.with_itp(combinations)[0]

    def with_itp(self, combinations: Sequence[Combination]) -> tuple[Array, Array]:
        """Mean CIEDE2000 and mean Delta E_ITP of a prediction per material, shape (N,) each."""
        here = [c.in_bands(self._chosen) for c in combinations]
        found: list[tuple[float, float]] = []
        for first in range(0, len(here), _AT_ONCE):
            predicted = evaluate(here[first : first + _AT_ONCE], self.values)
            found += [self.differences(first + k, f) for k, f in enumerate(predicted)]
        ciede2000, itp = np.array(found).T
        return ciede2000, itp
