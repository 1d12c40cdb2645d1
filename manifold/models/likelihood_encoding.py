"""Embed a material that a process has not seen by its likelihood, so that the variance there tells its error.

`manifold.models.encoding` finds the latent whose prediction is nearest to the data, however sure the process is of
something else there; its standard deviations then say little about the error that is left. Here the latent
weighs one against the other.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import cho_solve
from scipy.optimize import minimize

from manifold.gpr import GPWeights, centre_gram
from manifold.records import Array

_STARTS = 5  # nearest training materials to start from


class LikelihoodEncoder:
    """Latents of new materials, R rows each: one of a whole material, or one per band.

    Minimises, over structure coordinates that all rows share and colour coordinates of every row,

        sum_r ( 1/2 log v_r + e_r^2 / (2 D s^2 v_r) + prior/2 ||x_r||^2 ),

    with `v` the posterior variance in units of the output variance s^2, and `e` the distance between a row's
    mapped values and its posterior mean.

    Args:
        gp: of the n training samples.
        S: their Gram matrix, not centred, shape (n, n).
        n_outputs: D, values per sample.
        n_structure: leading latent coordinates that all rows share.
        group: samples per training material, material by material.
        prior: weight of the Gaussian prior on each row's latent.
    Source: Lawrence 2005, section 3.1; Rasmussen & Williams 2006, eq. 5.8.
    """

    def __init__(
        self, gp: GPWeights, S: Array, n_outputs: int, n_structure: int, group: int = 1, prior: float = 0.0
    ) -> None:
        self.gp, self.prior, self.n_structure, self.group = gp, prior, n_structure, group
        self.output_variance = gp.output_variance(S, n_outputs)
        self._scale = n_outputs * max(self.output_variance, np.finfo(float).tiny)
        self._S = centre_gram(S)
        self._row_mean, self._mean = S.mean(axis=1), float(S.mean())

    def encode(self, cross: Array, norm: Array) -> Array:
        """Latents (R, Q) of a material known by its products with the training samples.

        Args:
            cross: products of each row with the training samples, shape (R, n).
            norm: squared norms of the rows, shape (R,).
        """
        mean_cross = cross.mean(axis=1)
        cross = cross - mean_cross[:, None] - self._row_mean[None] + self._mean
        norm = np.maximum(norm - 2.0 * mean_cross + self._mean, 0.0)
        objective = self.objective(cross, norm)
        best, least = None, np.inf
        for start in self._starts(cross, norm):
            found = minimize(objective, start, jac=True, method="L-BFGS-B")
            if best is None or found.fun < least:
                best, least = found.x, float(found.fun)
        assert best is not None
        return self.unpack(best, len(norm))

    def unpack(self, z: Array, rows: int) -> Array:
        """Latents (R, Q) of the vector that is searched: structure, then the colours of every row."""
        shared = np.broadcast_to(z[: self.n_structure], (rows, self.n_structure))
        return np.hstack([shared, z[self.n_structure :].reshape(rows, -1)])

    def objective(self, cross: Array, norm: Array) -> Callable[[Array], tuple[float, Array]]:
        """What is minimised, with its gradient, for centred products (R, n) and squared norms (R,)."""
        gp, X, Qs = self.gp, self.gp.X, self.n_structure
        floor = 1e-14 * (
            norm + float(np.trace(self._S)) / gp.n_samples
        )  # e^2 is a difference of such numbers

        def value_and_gradient(z: Array) -> tuple[float, Array]:
            x = self.unpack(z, len(norm))
            k, slope = gp.kernel.smooth_and_slope(x, X)  # [R, n]
            w = cho_solve((gp.L, True), k.T).T
            Sw = w @ self._S
            error = np.maximum(norm - 2.0 * np.sum(w * cross, axis=1) + np.sum(w * Sw, axis=1), floor)
            variance = gp.kernel.prior_variance(x) - np.sum(k * w, axis=1)
            value = np.sum(0.5 * np.log(variance) + 0.5 * error / (self._scale * variance))
            d_error = 2.0 * cho_solve((gp.L, True), (Sw - cross).T).T  # by k, [R, n]
            d_variance = 0.5 / variance - 0.5 * error / (self._scale * variance**2)
            d_k = 0.5 / (self._scale * variance)[:, None] * d_error - 2.0 * d_variance[:, None] * w
            gradient = gp.kernel.pull_back(x, X, d_k, slope) + gp.kernel.pull_back_variance(x, d_variance)
            gradient += self.prior * x
            total = float(value + 0.5 * self.prior * np.sum(x * x))
            return total, np.concatenate([gradient[:, :Qs].sum(axis=0), gradient[:, Qs:].ravel()])

        return value_and_gradient

    def _starts(self, cross: Array, norm: Array) -> list[Array]:
        """Structures of the nearest training materials, in the colours of their nearest samples."""
        distance = norm[:, None] + np.diag(self._S)[None] - 2.0 * cross  # [R, n]
        by_material = distance.reshape(len(norm), -1, self.group)  # [R, N, group]
        nearest = np.argsort(by_material.min(axis=2).sum(axis=0), kind="stable")[:_STARTS]
        starts = []
        for material in nearest:
            own = material * self.group + by_material[:, material].argmin(axis=1)
            structure = self.gp.X[material * self.group, : self.n_structure]
            starts.append(np.concatenate([structure, self.gp.X[own, self.n_structure :].ravel()]))
        return starts
