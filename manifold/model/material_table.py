"""Values of the materials of a library in a few bands, with which predictions are compared."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

from manifold.brdf.measured import MeasuredBRDF, all_isotropic
from manifold.colour import panel
from manifold.encoding import encoding_pairs
from manifold.metrics import Errors
from manifold.model.combination import Combination, Values, evaluate
from manifold.records import Array, Indices

_AT_ONCE = 8  # predictions evaluated together


class MaterialTable:
    """Materials in some bands (B,), and how far predictions of them are from what they measure.

    Attributes:
        bands: indices, increasing, shape (B,).
        materials: in these bands.
        lights: in which their balls are judged.
    """

    def __init__(self, materials: Sequence[MeasuredBRDF], bands: Indices) -> None:
        """Select the bands of all materials."""
        self.bands = bands
        self.materials = [material.select_bands(bands.tolist()) for material in materials]
        self.lights, self._pairs = panel.judged(), encoding_pairs(all_isotropic(materials))

    @cached_property
    def on_ball(self) -> Values:
        """At the direction pairs that light the balls."""
        return Values.at(self.materials, self.lights)

    @cached_property
    def _xyz(self) -> list[Array]:
        return [self.lights.xyz(f, self.materials[0].bands) for f in self.on_ball.f]

    @cached_property
    def _in_grid(self) -> Values:
        return Values.at(self.materials, self._pairs)

    def look(self, i: int, f: Array) -> Errors[float]:
        """How differently the balls of material i and of values f (P, B) in 1/sr look."""
        return self.lights.compare(self._xyz[i], self.lights.xyz(f, self.materials[0].bands))

    def looks(self, combinations: Sequence[Combination]) -> Errors[Array]:
        """How differently the balls of all materials and of a prediction of each look."""
        here = [c.in_bands(self.bands) for c in combinations]
        found: list[Errors[float]] = []
        for first in range(0, len(here), _AT_ONCE):
            predicted = evaluate(here[first : first + _AT_ONCE], self.on_ball)
            found += [self.look(first + k, f) for k, f in enumerate(predicted)]
        return Errors.of_several(found)

    def errors(self, i: int, combination: Combination) -> Errors[float]:
        """Errors of a prediction of material i."""
        here = combination.in_bands(self.bands)
        on_ball, in_grid = (evaluate([here], values)[0] for values in (self.on_ball, self._in_grid))
        return self.look(i, on_ball) | Errors.of_values(self._in_grid.f[i], in_grid, self._pairs.cosines)
