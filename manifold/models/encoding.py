"""Embed a material that a manifold has not seen: the latent whose *decoded* prediction is nearest to its data.

Rows are what one latent each decodes: for a whole-material model a single row of all bands, for a monochrome
one a row per band, whose structure coordinates are shared. First the mapped residual is minimised from
several starts, through the Gram matrix alone; then, from the best few ends, the error of the decoded BRDF in the
metric that reports use, `||w (T^-1(V T(F)) - f)|| / ||w f||`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve
from scipy.optimize import minimize

from manifold.gpr import GPWeights
from manifold.mapping import Mapping
from manifold.metrics import RusinkiewiczGrid, cosine_weight, relative_error
from manifold.records import Array

PAIR_STRIDE = 6  # of a grid's direction pairs, one in this many serves to find a latent
_STARTS = 5  # nearest training materials to start from
_REFINED = 3  # ends of the first search that the second one starts from
_APART = 1e-2  # in latents: ends nearer to each other are one
_MAX_ITER = 200
_COLOUR_TABLE = 257  # values of a single colour coordinate that are decoded
_COST_OF_DOUBT = 0.1  # an albedo missed by this much is as bad as a prediction that knows nothing
_COLOUR_MARGIN = 0.25  # of the training colours' range, on either side


@dataclass(frozen=True, eq=False)
class EncodingPairs:
    """The direction pairs at which a material is compared with what latents decode.

    Attributes:
        wi, wo: unit vectors above the horizon, shape (P, 3).
    """

    wi: Array
    wo: Array

    @classmethod
    def of_grid(cls, grid: RusinkiewiczGrid) -> EncodingPairs:
        """Some of the pairs of a grid, evenly chosen."""
        wi, wo, above = grid.directions()
        return cls(wi[above][::PAIR_STRIDE], wo[above][::PAIR_STRIDE])

    @property
    def cosines(self) -> Array:
        """cos(theta_i) cos(theta_o), shape (P,)."""
        return cosine_weight(self.wi, self.wo)


@dataclass(frozen=True, eq=False)
class Decoder:
    """What turns latents into BRDF values at P outputs.

    Attributes:
        gp: of the n training samples.
        n_structure: leading latent coordinates that all rows of a material share.
        group: rows per training material: 1 for whole materials, B for monochrome samples.
        mapped: T of the training samples, shape (n, P).
        mapping: T.
        cosines: cos(theta_i) cos(theta_o) of each output, shape (P,).
        gram_weight: weight of each output in the mapped residual, shape (P,).
        prior: weight of the Gaussian prior on each row's latent.
    """

    gp: GPWeights
    n_structure: int
    group: int
    mapped: Array
    mapping: Mapping
    cosines: Array
    gram_weight: Array
    prior: float

    def decode(self, latents: Array) -> Array:
        """Values f at latents (R, Q), at least 0, shape (R, P)."""
        f = self.mapping.inverse(
            (self.gp.weights(latents) @ self.mapped)[..., None], self._row_cosines(len(latents))
        )
        return np.maximum(f[..., 0], 0.0)

    def encode(self, f: Array) -> Array:
        """Latents (R, Q) of a new material with values f (R, P)."""
        T = self.mapping.forward(f[..., None], self._row_cosines(len(f)))[..., 0]
        weighted = self.mapped * self.gram_weight
        S, cross = weighted @ self.mapped.T, T @ weighted.T
        norm = np.sum(T * T * self.gram_weight, axis=1)
        residual = self._mapped_residual(S, cross, norm)
        ends = [self._minimise(residual, start) for start in self._starts(S, cross, norm)]
        decoded = self._decoded_error(f)
        refined = [self._minimise(decoded, latents) for latents in _best_apart(ends)]
        return min(refined, key=lambda end: end[1])[0]

    def encode_colours(self, structure: Array, f: Array) -> Array:
        """Colour coordinates of bands with values f (R, P), structure (Q_s,) kept: (R, Q_c).

        One colour coordinate is looked up in a table of decoded values, which serves any number of bands at
        once; more of them are searched for band by band.
        """
        if self.gp.X.shape[1] - self.n_structure > 1:
            return np.concatenate([self._search_colour(structure, row[None]) for row in f])
        grid = self._colour_grid()[:, None]
        decoded = self.decode(np.hstack([np.tile(structure, (len(grid), 1)), grid]))  # [table, P]
        w2 = self.cosines**2
        error = (decoded**2) @ w2 - 2.0 * (f * w2) @ decoded.T  # [R, table], less what f alone contributes
        k = np.clip(error.argmin(axis=1), 1, len(grid) - 2)
        left, middle, right = (error[np.arange(len(f)), k + shift] for shift in (-1, 0, 1))
        curvature = left - 2.0 * middle + right
        step = np.divide(0.5 * (left - right), curvature, out=np.zeros(len(f)), where=curvature > 0)
        return grid[k] + (np.clip(step, -1.0, 1.0) * (grid[1] - grid[0]))[:, None]

    def colours_of_albedo(self, structure: Array, albedo: Array, measure: Array) -> tuple[Array, Array]:
        """Colour coordinates that give a structure (Q_s,) the albedos (R,), and the albedos they give, (R,).

        Albedo need not grow with the colour coordinate everywhere. All rows take their colours from one stretch
        where it does, so that neighbouring bands do not jump between looks: the stretch that misses the albedos
        least, and where the posterior is surest. `measure` (P,) makes an albedo of values at the outputs.
        """
        grid = self._colour_grid()
        latents = np.column_stack([np.tile(structure, (len(grid), 1)), grid])
        reached, std = self.decode(latents) @ measure, np.sqrt(self.gp.variance(latents))
        best: tuple[float, Array, Array] | None = None
        for first, last in _growing_stretches(reached):
            part = slice(first, last + 1)
            found = np.clip(albedo, reached[first], reached[last])
            colours = np.interp(found, reached[part], grid[part])
            missed = np.mean(np.abs(found - albedo))
            cost = float(missed + _COST_OF_DOUBT * np.mean(np.interp(colours, grid, std)))
            if best is None or cost < best[0]:
                best = (cost, colours, found)
        assert best is not None
        return best[1], best[2]

    def relative_error(self, latents: Array, f: Array) -> float:
        """`||w (f* - f)|| / ||w f||` of values f (R, P) and what latents (R, Q) decode to."""
        return relative_error(f.T, self.decode(latents).T, self.cosines)

    def _colour_grid(self) -> Array:
        """Values of a single colour coordinate: the training colours' range and a margin."""
        colours = self.gp.X[:, self.n_structure :]
        low, high = float(colours.min()), float(colours.max())
        margin = _COLOUR_MARGIN * (high - low)
        return np.linspace(low - margin, high + margin, _COLOUR_TABLE)

    def _search_colour(self, structure: Array, f: Array) -> Array:
        """Colour (1, Q_c) of one band, from the colours of the nearest training samples."""
        w2 = self.cosines**2
        T = self.mapping.forward(f[..., None], self._row_cosines(1))[..., 0]
        nearest = np.argsort(((self.mapped - T) ** 2) @ w2, kind="stable")[:_STARTS]
        objective = self._decoded_error(f)
        ends = [
            self._minimise(
                objective, np.hstack([structure, self.gp.X[k, self.n_structure :]])[None], fixed=True
            )
            for k in nearest
        ]
        return min(ends, key=lambda end: end[1])[0][:, self.n_structure :]

    def _row_cosines(self, rows: int) -> Array:
        return np.broadcast_to(self.cosines, (rows, self.cosines.size))

    def _starts(self, S: Array, cross: Array, norm: Array) -> list[Array]:
        """Latents (R, Q) of the nearest training materials, with the colours of their own or of any bands."""
        distance = norm[:, None] + np.diag(S)[None, :] - 2.0 * cross  # [R, n]
        by_material = distance.reshape(len(norm), -1, self.group)  # [R, N, group]
        nearest = np.argsort(by_material.min(axis=2).sum(axis=0), kind="stable")[:_STARTS]
        anywhere = self.gp.X[distance.argmin(axis=1), self.n_structure :]
        starts = []
        for material in nearest:
            own = material * self.group + by_material[:, material].argmin(axis=1)
            structure = np.repeat(
                self.gp.X[material * self.group, : self.n_structure][None], len(norm), axis=0
            )
            starts.append(np.hstack([structure, self.gp.X[own, self.n_structure :]]))
            if self.group > 1:
                starts.append(np.hstack([structure, anywhere]))
        return starts

    def _mapped_residual(self, S: Array, cross: Array, norm: Array) -> Callable[[Array], tuple[float, Array]]:
        """log of ||T(f) - V T(F)||^2, and its derivative with respect to the weights V (R, n)."""
        floor = 1e-14 * norm.sum()

        def objective(V: Array) -> tuple[float, Array]:
            VS = V @ S
            squared = max(float(norm.sum() - 2.0 * np.sum(V * cross) + np.sum(VS * V)), floor)
            return np.log(squared), 2.0 * (VS - cross) / squared

        return objective

    def _decoded_error(self, f: Array) -> Callable[[Array], tuple[float, Array]]:
        """log of ||w (T^-1(V T(F)) - f)||^2, and its derivative with respect to V (R, n)."""
        rows = self._row_cosines(len(f))
        w2 = self.cosines**2
        floor = 1e-14 * float(np.sum(w2 * f * f)) + np.finfo(float).tiny

        def objective(V: Array) -> tuple[float, Array]:
            decoded = self.mapping.inverse((V @ self.mapped)[..., None], rows)
            slope = self.mapping.slope(decoded, rows)[..., 0]
            difference = decoded[..., 0] - f
            squared = max(float(np.sum(w2 * difference * difference)), floor)
            return np.log(squared), (2.0 * w2 * difference * slope) @ self.mapped.T / squared

        return objective

    def _minimise(
        self, objective: Callable[[Array], tuple[float, Array]], start: Array, *, fixed: bool = False
    ) -> tuple[Array, float]:
        """Latents (R, Q) where R / 2 objective + prior / 2 ||x||^2 is least nearby, and that value.

        With `fixed` the structure stays where it is.
        """
        R, Q = start.shape
        Qs, X, gp = self.n_structure, self.gp.X, self.gp

        def unpack(z: Array) -> Array:
            return np.hstack([np.broadcast_to(z[:Qs], (R, Qs)), z[Qs:].reshape(R, Q - Qs)])

        def value_and_gradient(z: Array) -> tuple[float, Array]:
            x = unpack(z)
            k, slope = gp.kernel.smooth_and_slope(x, X)  # [R, n]
            W = cho_solve((gp.L, True), k.T).T
            value, dV = objective(W + (1.0 - W.sum(axis=1, keepdims=True)) / gp.n_samples)
            # Pull the derivative back through the centring, the solve, and the kernel.
            dW = dV - dV.mean(axis=1, keepdims=True)
            gradient = gp.kernel.pull_back(x, X, cho_solve((gp.L, True), dW.T).T, slope)
            gradient = 0.5 * R * gradient + self.prior * x
            shared = np.zeros(Qs) if fixed else gradient[:, :Qs].sum(axis=0)
            total = 0.5 * R * value + 0.5 * self.prior * float(np.sum(x * x))
            return total, np.concatenate([shared, gradient[:, Qs:].ravel()])

        z0 = np.concatenate([start[0, :Qs], start[:, Qs:].ravel()])
        found = minimize(value_and_gradient, z0, jac=True, method="L-BFGS-B", options={"maxiter": _MAX_ITER})
        return unpack(found.x), float(found.fun)


def _best_apart(ends: list[tuple[Array, float]]) -> list[Array]:
    """The latents of the `_REFINED` best ends that are `_APART`."""
    kept: list[Array] = []
    for latents, _ in sorted(ends, key=lambda end: end[1]):
        if all(np.abs(latents - other).max() > _APART for other in kept):
            kept.append(latents)
    return kept[:_REFINED]


def _growing_stretches(values: Array) -> list[tuple[int, int]]:
    """First and last index of every run in which values grow; the largest value alone where none does."""
    rises = np.concatenate([[False], np.diff(values) > 0, [False]])
    edges = np.flatnonzero(rises[1:] != rises[:-1])
    runs = [(int(first), int(last)) for first, last in edges.reshape(-1, 2)]
    return runs or [(int(np.argmax(values)),) * 2]
