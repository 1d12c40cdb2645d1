"""Embed a new material: the latent that fits its data best.

The search starts from the nearest training materials. The error of decoded values is minimised from the minima of the
residual in the mapped domain, which needs inner products only and is cheap.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dpotrs
from scipy.optimize import minimize

from manifold.gpr import GaussianProcess
from manifold.latent.criteria import Criterion, Products, decoded_error, likelihood, mapped_residual
from manifold.latent.decoder import Decoder
from manifold.records import Array

_STARTS = 5  # nearest training materials to start from
_REFINED = 3  # minima of the first search that the second one starts from
_APART = 1e-2  # in latents: minima nearer to each other are one
_MAX_ITER = 200


@dataclass(frozen=True, eq=False)
class Encoder:
    """Finds the latent (Q,) of a new material: minimises a criterion plus `prior / 2 ||x||^2`.

    Attributes:
        gp: of the n training materials.
        S: Gram matrix of the mapped materials, not centred, shape (n, n).
        n_outputs: D, outputs behind S.
        prior: weight of the Gaussian prior on the latent, or one per axis, shape (Q,).
    """

    gp: GaussianProcess
    S: Array
    n_outputs: int
    prior: float | Array = 0.0

    @classmethod
    def of_decoder(cls, decoder: Decoder, prior: float | Array = 0.0) -> Encoder:
        """An encoder that compares materials at the outputs of a decoder, weighted by the cosines."""
        S = (decoder.mapped * decoder.cosines) @ decoder.mapped.T
        return cls(decoder.gp, S, decoder.mapped.shape[1], prior)

    # -- encoding ------------------------------------------------------------------------------------------

    def by_values(self, decoder: Decoder, f: Array) -> Array:
        """The latent (Q,) whose decoded values are nearest to f (P,) at the decoder's outputs, in cube roots."""
        T = decoder.map(f[None])[0]
        weighted = T * decoder.cosines
        products = Products.centred(self.S, decoder.mapped @ weighted, float(weighted @ T))
        first = mapped_residual(products)
        ends = [self.minimise(first, start) for start in self.starts(products)]
        return self._best(decoded_error(decoder, f), _best_apart(ends))

    def by_residual(self, cross: Array, norm: float) -> Array:
        """The latent (Q,) of least residual in the mapped domain, by inner products: see `by_likelihood`."""
        products = Products.centred(self.S, cross, norm)
        return self._best(mapped_residual(products), self.starts(products))

    def by_likelihood(self, cross: Array, norm: float) -> Array:
        """The latent (Q,) of largest likelihood, by inner products with the samples about the origin of S.

        Args:
            cross: products with the training materials, shape (n,).
            norm: squared norm.
        """
        products = Products.centred(self.S, cross, norm)
        return self._best(likelihood(products, self.n_outputs * self.output_variance), self.starts(products))

    @cached_property
    def output_variance(self) -> float:
        """s^2 of the training materials."""
        return max(self.gp.output_variance(self.S, self.n_outputs), np.finfo(float).tiny)

    # -- searching -----------------------------------------------------------------------------------------

    def starts(self, products: Products) -> list[Array]:
        """Latents (Q,) of the nearest training materials."""
        nearest = np.argsort(products.distances, kind="stable")[:_STARTS]
        return list(self.gp.X[nearest])

    def _best(self, criterion: Criterion, starts: Sequence[Array]) -> Array:
        ends = [self.minimise(criterion, start) for start in starts]
        return min(ends, key=lambda end: end[1])[0]

    def minimise(self, criterion: Criterion, start: Array) -> tuple[Array, float]:
        """The latent (Q,) at the local minimum of criterion plus prior near a start, and its value."""
        found = minimize(
            lambda x: self.value_and_gradient(criterion, x), start, jac=True, method="L-BFGS-B",
            options={"maxiter": _MAX_ITER},
        )  # fmt: skip
        return found.x, float(found.fun)

    def value_and_gradient(self, criterion: Criterion, x: Array) -> tuple[float, Array]:
        """Criterion and prior at a latent x (Q,), and the gradient (Q,)."""
        gp, row = self.gp, x[None]
        k, slope = gp.kernel.smooth_and_slope(row, gp.X)  # [1, n]
        W = dpotrs(gp.L, k.T, lower=1)[0].T  # as cho_solve, whose checks take longer than solving for so few
        V = W + (1.0 - W.sum(axis=1, keepdims=True)) / gp.n_samples
        v = gp.kernel.prior_variance - float(k[0] @ W[0])
        value, dV, dv = criterion(V[0], v)
        # Pull the derivatives back through the centring, the solve, and the kernel.
        solved = dpotrs(gp.L, (dV - dV.mean())[:, None], lower=1)[0].T
        gradient = gp.kernel.pull_back(row, gp.X, solved - 2.0 * dv * W, slope)[0] + self.prior * x
        return value + 0.5 * float(np.sum(self.prior * x * x)), gradient


def _best_apart(ends: list[tuple[Array, float]]) -> list[Array]:
    """The latents of the `_REFINED` best minima that are `_APART`."""
    kept: list[Array] = []
    for latent, _ in sorted(ends, key=lambda end: end[1]):
        if all(np.abs(latent - other).max() > _APART for other in kept):
            kept.append(latent)
    return kept[:_REFINED]
