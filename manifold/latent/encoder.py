"""Embed a new material: the latents that fit its data best, by one of several criteria.

A row is the values that one latent decodes to: all bands of a whole material, or a single band; bands of one material
share their structure coordinates. The search starts from the nearest training materials. Criteria of decoded values are
minimised from the minima of the mapped residual, which needs inner products only and is cheap.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dpotrs
from scipy.optimize import minimize

from manifold.latent.colour_table import ColourTable
from manifold.latent.criteria import (
    OF_VALUES,
    Criterion,
    Products,
    decoded_error,
    likelihood,
    mapped_residual,
)
from manifold.latent.decoder import Decoder
from manifold.latent.gp_weights import GPWeights
from manifold.records import Array

_STARTS = 5  # nearest training materials to start from
_REFINED = 3  # minima of the first search that the second one starts from
_APART = 1e-2  # in latents: minima nearer to each other are one
_MAX_ITER = 200


@dataclass(frozen=True, eq=False)
class Encoder:
    """Finds latents (R, Q) of a new material: R rows that share their structure coordinates.

    Minimises a criterion plus `prior / 2 ||x_r||^2` of every row.

    Attributes:
        gp: of the n training samples, material by material.
        S: Gram matrix of the mapped samples, not centred, shape (n, n).
        n_outputs: D, outputs behind S.
        n_structure: leading latent coordinates that all rows of a material share.
        group: samples per training material: 1 for whole materials, B for single bands.
        prior: weight of the Gaussian prior on each row's latent, or one per axis, shape (Q,).
        criterion: one of `CRITERIA`.
        decoder: of the values at which materials are compared; None where only inner products are known, which serve
            the criteria `mapped` and `likelihood`.
    """

    gp: GPWeights
    S: Array
    n_outputs: int
    n_structure: int
    group: int = 1
    prior: float | Array = 0.0
    criterion: str = "decoded"
    decoder: Decoder | None = None

    @classmethod
    def of_decoder(
        cls,
        decoder: Decoder,
        n_structure: int,
        group: int = 1,
        prior: float | Array = 0.0,
        criterion: str = "decoded",
    ) -> Encoder:
        """An encoder that compares materials at the outputs of a decoder, weighted by the cosines."""
        S = (decoder.mapped * decoder.cosines) @ decoder.mapped.T
        P = decoder.mapped.shape[1]
        return cls(decoder.gp, S, P, n_structure, group, prior, criterion, decoder)

    # -- encoding ------------------------------------------------------------------------------------------

    def encode(self, f: Array) -> Array:
        """Latents (R, Q) of a new material with values f (R, P) at the decoder's outputs."""
        products = self._products(f)
        if self.criterion not in OF_VALUES:
            return self._best(self._by_products(products), self.starts(products))
        first = mapped_residual(products)
        ends = [self.minimise(first, start) for start in self.starts(products)]
        return self._best(self._by_values(f), _best_apart(ends))

    def encode_products(self, cross: Array, norm: Array) -> Array:
        """Latents (R, Q) of a new material by inner products with the samples, about the origin that S is about.

        Args:
            cross: products of each row with the training samples, shape (R, n).
            norm: squared norms of the rows, shape (R,).
        """
        products = Products.centred(self.S, cross, norm)
        return self._best(self._by_products(products), self.starts(products))

    def encode_colours(self, structure: Array, f: Array) -> Array:
        """Colour coordinates of bands with values f (R, P), structure (Q_s,) kept: (R, Q_c).

        One colour coordinate is looked up in a table, which serves any number of bands at once; more of them are
        searched for band by band.
        """
        if self.gp.X.shape[1] - self.n_structure > 1:
            return np.concatenate([self.search_colour(structure, row[None]) for row in f])
        scale = self._scale if self.criterion == "likelihood" else None
        return ColourTable(self._of_values, structure).nearest(f, self._in_domain, scale)[:, None]

    def search_colour(self, structure: Array, f: Array) -> Array:
        """Colour coordinates (1, Q_c) of one band with values f (1, P), from those of the nearest training samples."""
        Qs, products = self.n_structure, self._products(f)
        criterion = self._by_values(f) if self.criterion in OF_VALUES else self._by_products(products)
        samples = np.argsort(products.distances[0], kind="stable")[:_STARTS]
        starts = [np.hstack([structure, self.gp.X[k, Qs:]])[None] for k in samples]
        return self._best(criterion, starts, fixed=True)[:, Qs:]

    # -- criteria ------------------------------------------------------------------------------------------

    def _by_products(self, products: Products) -> Criterion:
        if self.criterion == "mapped":
            return mapped_residual(products)
        return likelihood(products, self._scale)

    def _by_values(self, f: Array) -> Criterion:
        return decoded_error(self._of_values, f, cube_root=self.criterion == "cube-root")

    def _in_domain(self, f: Array) -> Array:
        """Values (R, P) in the domain in which the criterion measures differences."""
        decoder = self._of_values
        if self.criterion in OF_VALUES:
            weighted = decoder.cosines * f
            return np.cbrt(weighted) if self.criterion == "cube-root" else weighted
        return np.sqrt(decoder.cosines) * decoder.map(f)

    @cached_property
    def output_variance(self) -> float:
        """s^2 of the training samples."""
        return max(self.gp.output_variance(self.S, self.n_outputs), np.finfo(float).tiny)

    @property
    def _scale(self) -> float:
        """D s^2."""
        return self.n_outputs * self.output_variance

    def _products(self, f: Array) -> Products:
        decoder = self._of_values
        T = decoder.map(f)
        weighted = T * decoder.cosines
        return Products.centred(self.S, weighted @ decoder.mapped.T, np.sum(weighted * T, axis=1))

    @property
    def _of_values(self) -> Decoder:
        assert self.decoder is not None
        return self.decoder

    # -- searching -----------------------------------------------------------------------------------------

    def starts(self, products: Products) -> list[Array]:
        """Latents (R, Q) of the nearest training materials, with the colours of their own or of any samples."""
        distance, Qs = products.distances, self.n_structure
        by_material = distance.reshape(len(distance), -1, self.group)  # [R, N, group]
        nearest = np.argsort(by_material.min(axis=2).sum(axis=0), kind="stable")[:_STARTS]
        anywhere = self.gp.X[distance.argmin(axis=1), Qs:]
        starts: list[Array] = []
        for material in nearest:
            own = material * self.group + by_material[:, material].argmin(axis=1)
            structure = np.repeat(self.gp.X[material * self.group, :Qs][None], len(distance), axis=0)
            starts.append(np.hstack([structure, self.gp.X[own, Qs:]]))
            if self.group > 1:
                starts.append(np.hstack([structure, anywhere]))
        return starts

    def _best(self, criterion: Criterion, starts: Sequence[Array], *, fixed: bool = False) -> Array:
        ends = [self.minimise(criterion, start, fixed=fixed) for start in starts]
        return min(ends, key=lambda end: end[1])[0]

    def minimise(self, criterion: Criterion, start: Array, *, fixed: bool = False) -> tuple[Array, float]:
        """Latents (R, Q) at the local minimum of criterion plus prior near a start, and its value.

        With `fixed` the structure is kept.
        """
        R, Q = start.shape
        Qs = self.n_structure

        def unpack(z: Array) -> Array:
            return np.hstack([np.broadcast_to(z[:Qs], (R, Qs)), z[Qs:].reshape(R, Q - Qs)])

        def value_and_gradient(z: Array) -> tuple[float, Array]:
            value, gradient = self.value_and_gradient(criterion, unpack(z))
            shared = np.zeros(Qs) if fixed else gradient[:, :Qs].sum(axis=0)
            return value, np.concatenate([shared, gradient[:, Qs:].ravel()])

        z0 = np.concatenate([start[0, :Qs], start[:, Qs:].ravel()])
        found = minimize(value_and_gradient, z0, jac=True, method="L-BFGS-B", options={"maxiter": _MAX_ITER})
        return unpack(found.x), float(found.fun)

    def value_and_gradient(self, criterion: Criterion, x: Array) -> tuple[float, Array]:
        """Criterion and prior at latents x (R, Q), and the gradient (R, Q) with every row free."""
        gp = self.gp
        k, slope = gp.kernel.smooth_and_slope(x, gp.X)  # [R, n]
        W = dpotrs(gp.L, k.T, lower=1)[0].T  # as cho_solve, whose checks take longer than solving for so few
        V = W + (1.0 - W.sum(axis=1, keepdims=True)) / gp.n_samples
        v = gp.kernel.prior_variance(x) - np.sum(k * W, axis=1)
        value, dV, dv = criterion(V, v)
        # Pull the derivatives back through the centring, the solve, and the kernel.
        solved = dpotrs(gp.L, (dV - dV.mean(axis=1, keepdims=True)).T, lower=1)[0].T
        dk = solved - 2.0 * dv[:, None] * W
        gradient = gp.kernel.pull_back(x, gp.X, dk, slope) + gp.kernel.pull_back_variance(x, dv)
        gradient += self.prior * x
        return value + 0.5 * float(np.sum(self.prior * x * x)), gradient


def _best_apart(ends: list[tuple[Array, float]]) -> list[Array]:
    """The latents of the `_REFINED` best minima that are `_APART`."""
    kept: list[Array] = []
    for latents, _ in sorted(ends, key=lambda end: end[1]):
        if all(np.abs(latents - other).max() > _APART for other in kept):
            kept.append(latents)
    return kept[:_REFINED]
