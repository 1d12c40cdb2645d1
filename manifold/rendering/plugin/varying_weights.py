"""Weights of the materials at latents that differ from lane to lane, on Dr.Jit.

No array of weights crosses a loop: Dr.Jit 1.5 cannot compile `dr.alloc_local` across loops inside a virtual call. Sums
over the materials are kept, and the weight of a material is computed where it is used. So are the slopes of weights:
Dr.Jit 1.5 loses derivatives by what a loop inside a virtual call reads from outside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from manifold.latent.blending import NEGLIGIBLE
from manifold.rendering.plugin.mixture import Mixture


@dataclass(frozen=True, eq=False)
class Lobes:
    """Sums over the materials at latents, per lane.

    Attributes:
        latent: Q arrays, float64, without derivatives.
        sums: two arrays that `VaryingWeights.weight` needs.
        slopes: those of a sum by the latents, Q arrays; none where no derivatives are asked for.
        magnitude: sum of the absolute weights.
        offsets: Q arrays of value 0 with the derivatives of the latents.
    """

    latent: list[Any]
    sums: tuple[Any, Any]
    slopes: list[Any]
    magnitude: Any
    offsets: Sequence[Any] = ()


class VaryingWeights:
    """A function from latents to weights: a Gaussian process, or the blend of a map."""

    def __init__(self, mi: Any, dr: Any, mixture: Mixture) -> None:
        """Upload the latents of a mixture that has a process."""
        assert mixture.gp is not None
        self._mi, self._dr, self._gp, self._is_blend = mi, dr, mixture.gp, mixture.is_blend
        self._n, order = len(mixture.names), list(mixture.order)
        self._latents = [mi.Float64(np.ascontiguousarray(c)) for c in self._gp.X[order].T]
        if not self._is_blend:
            inverse = np.linalg.inv(self._gp.K)[np.ix_(order, order)]
            self._inverse_K, self._column_sums = mi.Float64(inverse.ravel()), mi.Float64(inverse.sum(axis=0))

    def at(self, latent: list[Any]) -> Lobes:
        """What the weights at latents, Q arrays, have in common."""
        dr = self._dr
        x = [self._mi.Float64(v) for v in dr.detach(latent)]
        has_slopes = dr.grad_enabled(latent)
        lobes = self._of_blend(x, has_slopes) if self._is_blend else self._of_posterior(x, has_slopes)
        return replace(lobes, offsets=[v - dr.detach(v) for v in latent]) if has_slopes else lobes

    def weight(self, lobes: Lobes, j: Any) -> tuple[Any, list[Any]]:
        """Weight of material j, and its slopes by the latents where `lobes` has slopes."""
        mi, dr = self._mi, self._dr
        has_slopes = len(lobes.slopes) > 0
        if self._is_blend:
            least, total = lobes.sums
            share, *slopes = self._share(lobes.latent, j, least, has_slopes)
            v = share / total
            return mi.Float(v), [
                mi.Float((a - v * b) / total) for a, b in zip(slopes, lobes.slopes, strict=True)
            ]
        match, rest = lobes.sums
        v, *slopes = self._sum(
            lambda k: self._similarity(lobes.latent, k, has_slopes), self._inverse_K, j * self._n, has_slopes
        )
        is_free = match == self._n
        return mi.Float(dr.select(is_free, v + rest, dr.select(match == j, 1.0, 0.0))), [
            mi.Float(dr.select(is_free, a + b, 0.0)) for a, b in zip(slopes, lobes.slopes, strict=True)
        ]

    def _sum(self, terms: Any, factors: Any, first: Any, has_slopes: bool) -> list[Any]:
        """Sums over the materials of terms(j), each a value and perhaps Q slopes, times factors from `first` on."""
        mi, dr = self._mi, self._dr

        def add(j: Any, sums: list[Any]) -> tuple[Any, list[Any]]:
            factor = 1.0 if factors is None else dr.gather(mi.Float64, factors, first + j)
            return j + 1, [dr.fma(factor, term, s) for term, s in zip(terms(j), sums, strict=True)]

        start = [mi.Float64(0.0)] * (1 + len(self._latents) * has_slopes)
        return list(dr.while_loop((mi.UInt32(0), start), lambda j, _: j < self._n, add)[1])

    def _first(self, start: Any, update: Any) -> Any:
        """The last state of a loop over the materials."""
        return self._dr.while_loop(
            (self._mi.UInt32(0), start), lambda j, _: j < self._n, lambda j, s: (j + 1, update(j, s))
        )[1]

    def _of_blend(self, latent: list[Any], has_slopes: bool) -> Lobes:
        """For `latent.blending.blend_weights`, relative to the nearest material."""
        mi, dr = self._mi, self._dr
        least = self._first(mi.Float64(1e300), lambda j, s: dr.minimum(s, self._cost(latent, j)[0]))
        total, *slopes = self._sum(lambda j: self._share(latent, j, least, has_slopes), None, 0, has_slopes)
        return Lobes(latent, (least, total), slopes, mi.Float(1.0))

    def _share(self, latent: list[Any], j: Any, least: Any, has_slopes: bool) -> list[Any]:
        """Share of material j before division by their sum, and its slopes."""
        dr = self._dr
        cost, slope = self._cost(latent, j)
        share = dr.exp(least - cost)
        kept = share - NEGLIGIBLE
        slopes = [-dr.select(kept > 0.0, share * slope * d, 0.0) for d in self._differences(latent, j)]
        return [dr.maximum(kept, 0.0), *slopes[: len(slopes) * has_slopes]]

    def _cost(self, latent: list[Any], j: Any) -> tuple[Any, Any]:
        """Negative logarithm of a share, and its slope over the difference of latents."""
        unit = 1.0 / self._gp.kernel.length_scale**2
        squared = self._dr.maximum(self._squared_distance(latent, j) * unit, 1e-12)
        return 0.5 * squared + self._dr.log(squared), (1.0 + 2.0 / squared) * unit

    def _of_posterior(self, latent: list[Any], has_slopes: bool) -> Lobes:
        """For weights of the Gaussian process; a unit vector at a training latent."""
        mi, dr, n = self._mi, self._dr, self._n
        match = self._first(
            mi.UInt32(n),
            lambda j, s: dr.select((self._squared_distance(latent, j) < 1e-12) & (s == n), j, s),
        )
        total, *slopes = self._sum(
            lambda j: self._similarity(latent, j, has_slopes), self._column_sums, 0, has_slopes
        )
        rest, slopes = (1.0 - total) / n, [-slope / n for slope in slopes]
        lobes = Lobes(latent, (match, rest), [], None)
        magnitude = self._first(mi.Float(0.0), lambda j, s: s + dr.abs(self.weight(lobes, j)[0]))
        return Lobes(latent, lobes.sums, slopes, magnitude)

    def _similarity(self, latent: list[Any], j: Any, has_slopes: bool) -> list[Any]:
        """Covariance with material j, and its slopes."""
        dr, kernel = self._dr, self._gp.kernel
        unit = 1.0 / kernel.length_scale**2
        k, slope = kernel.radial(self._squared_distance(latent, j) * unit, dr)
        slopes = [2.0 * unit * slope * d for d in self._differences(latent, j)]
        return [k, *slopes[: len(slopes) * has_slopes]]

    def _differences(self, latent: list[Any], j: Any) -> list[Any]:
        pairs = zip(latent, self._latents, strict=True)
        return [x - self._dr.gather(self._mi.Float64, c, j) for x, c in pairs]

    def _squared_distance(self, latent: list[Any], j: Any) -> Any:
        return sum(self._dr.square(d) for d in self._differences(latent, j))
