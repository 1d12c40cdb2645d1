"""Weights of the materials at latents that differ from lane to lane, on Dr.Jit."""

from __future__ import annotations

from typing import Any

import numpy as np

from manifold.rendering.plugin.mixture import Mixture


class Lobes:
    """Weights per lane, or the same ones everywhere (None)."""

    def __init__(self, local: Any = None, total: Any = None) -> None:
        self.local, self.total = local, total


class VaryingWeights:
    """A function from latents to weights: a Gaussian process, or the blend of a map."""

    def __init__(self, mi: Any, dr: Any, mixture: Mixture) -> None:
        """Upload the latents of a mixture that has a process."""
        assert mixture.gp is not None
        self._mi, self._dr, self._gp, self._is_blend = mi, dr, mixture.gp, mixture.is_blend
        self._n, order = len(mixture.names), list(mixture.order)
        self._latents = [mi.Float(c.astype(np.float32)) for c in self._gp.X[order].T]
        if not self._is_blend:
            self._inverse_K = mi.Float64(np.linalg.inv(self._gp.K)[np.ix_(order, order)].ravel())

    def at(self, latent: list[Any]) -> Lobes:
        """Weights at latents, a list of Q arrays."""
        return self._blend_weights(latent) if self._is_blend else self._posterior_weights(latent)

    def _squared_distance(self, latent: list[Any], j: Any) -> Any:
        """From latents to that of material j, in length scales."""
        pairs = [
            (x, self._dr.gather(self._mi.Float, c, j)) for x, c in zip(latent, self._latents, strict=True)
        ]
        squared = self._mi.Float64(sum(self._dr.square(x - c) for x, c in pairs))
        return squared / self._gp.kernel.length_scale**2

    def _blend_weights(self, latent: list[Any]) -> Lobes:
        """`models.blending.blend_weights`, in logarithms relative to the nearest material."""
        mi, dr, n = self._mi, self._dr, self._n

        def cost(j: Any) -> Any:
            squared = dr.maximum(self._squared_distance(latent, j), 1e-12)
            return 0.5 * squared + dr.log(squared)

        def nearest(j: Any, least: Any) -> Any:
            return j + 1, dr.minimum(least, cost(j))

        _, least = dr.while_loop((mi.UInt32(0), mi.Float64(1e300)), lambda j, least: j < n, nearest)

        def fill(j: Any, w: Any, total: Any) -> Any:
            share = dr.exp(least - cost(j))
            w[j] = mi.Float(share)
            return j + 1, w, total + share

        weights = dr.alloc_local(mi.Float, n)
        _, weights, total = dr.while_loop(
            (mi.UInt32(0), weights, mi.Float64(0.0)), lambda j, w, t: j < n, fill
        )

        def normalise(j: Any, w: Any) -> Any:
            w[j] = w[j] / mi.Float(total)
            return j + 1, w

        _, weights = dr.while_loop((mi.UInt32(0), weights), lambda j, w: j < n, normalise)
        return Lobes(weights, mi.Float(1.0))

    def _posterior_weights(self, latent: list[Any]) -> Lobes:
        """Weights of the Gaussian process; a unit vector at a training latent."""
        mi, dr = self._mi, self._dr
        n, kernel = self._n, self._gp.kernel
        inverse_l2 = 1.0 / kernel.length_scale**2
        similarity = dr.alloc_local(mi.Float64, n)
        weights = dr.alloc_local(mi.Float, n)

        def fill(j: Any, k: Any, match: Any) -> Any:
            pairs = [(x, dr.gather(mi.Float, c, j)) for x, c in zip(latent, self._latents, strict=True)]
            d2 = sum(dr.square(x - c) for x, c in pairs)
            k[j] = kernel.radial(inverse_l2 * mi.Float64(d2), dr)[0]
            if kernel.linear:
                k[j] += kernel.slope_of_linear * mi.Float64(sum(x * c for x, c in pairs))
            return j + 1, k, dr.select((d2 < 1e-12) & (match == n), j, match)

        _, similarity, match = dr.while_loop(
            (mi.UInt32(0), similarity, mi.UInt32(n)), lambda j, k, m: j < n, fill, labels=("j", "k", "match")
        )

        def solve(i: Any, w: Any, total: Any) -> Any:
            def add(j: Any, s: Any) -> Any:
                return j + 1, dr.fma(dr.gather(mi.Float64, self._inverse_K, i * n + j), similarity[j], s)

            _, s = dr.while_loop((mi.UInt32(0), mi.Float64(0.0)), lambda j, s: j < n, add)
            w[i] = mi.Float(s)
            return i + 1, w, total + s

        _, weights, total = dr.while_loop(
            (mi.UInt32(0), weights, mi.Float64(0.0)), lambda i, w, t: i < n, solve
        )
        rest = mi.Float((1.0 - total) / n)

        def finish(i: Any, w: Any, magnitude: Any) -> Any:
            v = dr.select(match < n, dr.select(match == i, 1.0, 0.0), w[i] + rest)
            w[i] = v
            return i + 1, w, magnitude + dr.abs(v)

        _, weights, magnitude = dr.while_loop(
            (mi.UInt32(0), weights, mi.Float(0.0)), lambda i, w, m: i < n, finish
        )
        return Lobes(weights, magnitude)
