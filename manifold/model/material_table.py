"""Values of the materials of a library in a few bands, with which left-out predictions are compared."""

from __future__ import annotations

from functools import cached_property

from manifold.brdf.measured import MeasuredBRDF, all_isotropic
from manifold.colour import panel
from manifold.encoding import encoding_pairs
from manifold.metrics import Errors
from manifold.model.combination import Combination, Values, evaluate
from manifold.records import Indices


class MaterialTable:
    """Materials in some bands (B,), and how far predictions of them are from what they measure.

    Attributes:
        bands: indices, increasing, shape (B,).
        materials: in these bands.
    """

    def __init__(self, materials: list[MeasuredBRDF], bands: Indices) -> None:
        """Select the bands of all materials."""
        self.bands = bands
        self.materials = [material.select_bands(bands.tolist()) for material in materials]
        self._lights, self._pairs = panel.judged(), encoding_pairs(all_isotropic(materials))

    @cached_property
    def _on_ball(self) -> Values:
        return Values.at(self.materials, self._lights)

    @cached_property
    def _in_grid(self) -> Values:
        return Values.at(self.materials, self._pairs)

    def errors(self, i: int, combination: Combination) -> Errors[float]:
        """Errors of a prediction of material i."""
        here = combination.in_bands(self.bands)
        on_ball, in_grid = (evaluate([here], values)[0] for values in (self._on_ball, self._in_grid))
        look = self._lights.errors(self._on_ball.f[i], on_ball, self.materials[0].bands)
        return look | Errors.of_values(self._in_grid.f[i], in_grid, self._pairs.cosines)
