"""Weights of the materials at latents that differ from lane to lane, on Dr.Jit.

No array of weights crosses a loop: Dr.Jit 1.5 cannot compile `dr.alloc_local` across loops inside a virtual call. Sums
over the materials are kept, and the weight of a material is computed where it is used.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from manifold.rendering.plugin.mixture import Mixture


@dataclass(frozen=True, eq=False)
class Lobes:
    """Sums over the materials at latents, per lane.

    Attributes:
        latent: Q arrays.
        sums: two arrays that `VaryingWeights.weight` needs.
        magnitude: sum of the absolute weights.
    """

    latent: list[Any]
    sums: tuple[Any, Any]
    magnitude: Any


class VaryingWeights:
    """A function from latents to weights: a Gaussian process, or the blend of a map."""

    def __init__(self, mi: Any, dr: Any, mixture: Mixture) -> None:
        """Upload the latents of a mixture that has a process."""
        assert mixture.gp is not None
        self._mi, self._dr, self._gp, self._is_blend = mi, dr, mixture.gp, mixture.is_blend
        self._n, order = len(mixture.names), list(mixture.order)
        self._latents = [mi.Float(c.astype(np.float32)) for c in self._gp.X[order].T]
        if not self._is_blend:
            inverse = np.linalg.inv(self._gp.K)[np.ix_(order, order)]
            self._inverse_K, self._column_sums = mi.Float64(inverse.ravel()), mi.Float64(inverse.sum(axis=0))

    def at(self, latent: list[Any]) -> Lobes:
        """What the weights at latents, Q arrays, have in common."""
        return self._of_blend(latent) if self._is_blend else self._of_posterior(latent)

    def weight(self, lobes: Lobes, j: Any) -> Any:
        """Weight of material j."""
        mi, dr = self._mi, self._dr
        if self._is_blend:
            least, total = lobes.sums
            return mi.Float(dr.exp(least - self._cost(lobes.latent, j))) / mi.Float(total)
        match, rest = lobes.sums

        def add(k: Any, s: Any) -> Any:
            row = dr.gather(mi.Float64, self._inverse_K, j * self._n + k)
            return k + 1, dr.fma(row, self._similarity(lobes.latent, k)[0], s)

        w = mi.Float(self._sum(mi.Float64(0.0), add))
        return dr.select(match < self._n, dr.select(match == j, 1.0, 0.0), w + rest)

    def _sum(self, start: Any, add: Any) -> Any:
        """The last state of a loop over the materials."""
        n = self._n
        return self._dr.while_loop((self._mi.UInt32(0), start), lambda j, _: j < n, add)[1]

    def _of_blend(self, latent: list[Any]) -> Lobes:
        """For `latent.blending.blend_weights`, in logarithms relative to the nearest material."""
        mi, dr = self._mi, self._dr
        least = self._sum(mi.Float64(1e300), lambda j, s: (j + 1, dr.minimum(s, self._cost(latent, j))))
        total = self._sum(mi.Float64(0.0), lambda j, s: (j + 1, s + dr.exp(least - self._cost(latent, j))))
        return Lobes(latent, (least, total), mi.Float(1.0))

    def _cost(self, latent: list[Any], j: Any) -> Any:
        squared = self._mi.Float64(self._squared_distance(latent, j)) / self._gp.kernel.length_scale**2
        squared = self._dr.maximum(squared, 1e-12)
        return 0.5 * squared + self._dr.log(squared)

    def _of_posterior(self, latent: list[Any]) -> Lobes:
        """For weights of the Gaussian process; a unit vector at a training latent."""
        mi, dr, n = self._mi, self._dr, self._n

        def add(j: Any, total: Any, match: Any) -> Any:
            k, squared = self._similarity(latent, j)
            total = dr.fma(dr.gather(mi.Float64, self._column_sums, j), k, total)
            return j + 1, total, dr.select((squared < 1e-12) & (match == n), j, match)

        _, total, match = dr.while_loop(
            (mi.UInt32(0), mi.Float64(0.0), mi.UInt32(n)), lambda j, total, match: j < n, add
        )
        lobes = Lobes(latent, (match, mi.Float((1.0 - total) / n)), None)
        magnitude = self._sum(mi.Float(0.0), lambda j, s: (j + 1, s + dr.abs(self.weight(lobes, j))))
        return Lobes(latent, lobes.sums, magnitude)

    def _similarity(self, latent: list[Any], j: Any) -> tuple[Any, Any]:
        """Covariance with material j, and the squared distance to its latent."""
        mi, dr, kernel = self._mi, self._dr, self._gp.kernel
        squared = self._squared_distance(latent, j)
        k = kernel.radial(mi.Float64(squared) / kernel.length_scale**2, dr)[0]
        if kernel.linear:
            pairs = zip(latent, self._latents, strict=True)
            k += kernel.slope_of_linear * mi.Float64(sum(x * dr.gather(mi.Float, c, j) for x, c in pairs))
        return k, squared

    def _squared_distance(self, latent: list[Any], j: Any) -> Any:
        dr, pairs = self._dr, zip(latent, self._latents, strict=True)
        return sum(dr.square(x - dr.gather(self._mi.Float, c, j)) for x, c in pairs)
