"""A table over the single colour coordinate of a structure, to find the colour of given values or albedo."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from manifold.latent.decoder import Decoder
from manifold.records import Array

_NODES = 257  # colours that are decoded
_MARGIN = 0.25  # of the training colours' range, on either side
# Error of the albedo that costs as much as a prediction with the variance of the prior.
_COST_OF_DEVIATION = 0.1


class ColourTable:
    """Decoded values of a structure over the range of the training colours and a margin.

    Attributes:
        colours: the colour coordinates, shape (K,).
        latents: of the structure in these colours, shape (K, Q_s + 1).
        values: decoded, shape (K, P).
    """

    def __init__(self, decoder: Decoder, structure: Array) -> None:
        """Decode a structure (Q_s,) in all colours."""
        trained = decoder.gp.X[:, -1]
        margin = _MARGIN * (trained.max() - trained.min())
        self.colours = np.linspace(trained.min() - margin, trained.max() + margin, _NODES)
        self.latents = np.column_stack([np.tile(structure, (_NODES, 1)), self.colours])
        self.values = decoder.decode(self.latents)
        self._decoder = decoder

    def nearest(
        self, f: Array, domain: Callable[[Array], Array], likelihood_scale: float | None = None
    ) -> Array:
        """Colours (R,) whose values are nearest to those of bands, f (R, P); between nodes by a parabola.

        Args:
            f: values in 1/sr.
            domain: maps values (R, P) to the domain in which distances are measured.
            likelihood_scale: D s^2, see `criteria.likelihood`, which is then maximised; None minimises the distance.
        """
        table, wanted = domain(self.values), domain(f)
        cost = np.sum(table * table, axis=1) - 2.0 * wanted @ table.T  # [R, K], less what f alone contributes
        if likelihood_scale is not None:
            variance = self._decoder.gp.variance(self.latents)
            squared = np.maximum(cost + np.sum(wanted * wanted, axis=1)[:, None], 0.0)
            cost = np.log(variance) + squared / (likelihood_scale * variance)
        k = np.clip(cost.argmin(axis=1), 1, _NODES - 2)
        left, middle, right = (cost[np.arange(len(f)), k + shift] for shift in (-1, 0, 1))
        curvature = left - 2.0 * middle + right
        step = np.divide(0.5 * (left - right), curvature, out=np.zeros(len(f)), where=curvature > 0)
        return self.colours[k] + np.clip(step, -1.0, 1.0) * (self.colours[1] - self.colours[0])

    def of_albedo(self, albedo: Array, measure: Array) -> tuple[Array, Array]:
        """Colours at which the structure has albedos (R,), and the albedos reached, (R,).

        Albedo need not grow with the colour coordinate everywhere. The colours of all rows are in one interval where it
        does, so that neighbouring bands are similar: that with the least error of the albedos and the least posterior
        deviation. The product of `measure` (P,) and values at the outputs is the albedo.
        """
        reached, std = self.values @ measure, np.sqrt(self._decoder.gp.variance(self.latents))
        best: tuple[float, Array, Array] | None = None
        for first, last in _growing_stretches(reached):
            part = slice(first, last + 1)
            found = np.clip(albedo, reached[first], reached[last])
            colours = np.interp(found, reached[part], self.colours[part])
            residual = np.mean(np.abs(found - albedo))
            cost = float(residual + _COST_OF_DEVIATION * np.mean(np.interp(colours, self.colours, std)))
            if best is None or cost < best[0]:
                best = (cost, colours, found)
        assert best is not None
        return best[1], best[2]


def _growing_stretches(values: Array) -> list[tuple[int, int]]:
    """First and last index of every run in which values grow; the largest value alone where none does."""
    rises = np.concatenate([[False], np.diff(values) > 0, [False]])
    edges = np.flatnonzero(rises[1:] != rises[:-1])
    runs = [(int(first), int(last)) for first, last in edges.reshape(-1, 2)]
    return runs or [(int(np.argmax(values)),) * 2]
