"""Latent variable models with what the package lacks: other kernels, mappings, priors, back constraints and starts.

What won a trial is in the package; the rest lives here alone. See bench_held_out.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve, cholesky
from scipy.linalg.lapack import dpotrf, dpotri
from scipy.optimize import minimize
from scipy.spatial.distance import cdist

from manifold.gpr import GPWeights, centre_gram
from manifold.mapping import CubeRoot, Mapping
from manifold.models.encoding import Decoder
from manifold.models.per_band import MonochromeGPLVM
from manifold.records import Array

# -- kernels -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Kernel:
    """A radial kernel g(r^2) of unit variance and length scale, plus `linear` x.x', plus a delta of height mu.

    Attributes:
        name: `se`, `matern32`, `matern52` or `rq`.
        mu: height of the delta.
        alpha: of the rational quadratic.
        linear: weight of the linear term.
    """

    name: str = "se"
    mu: float = 1e-3
    alpha: float = 1.0
    linear: float = 0.0

    def radial(self, squared: Array) -> tuple[Array, Array]:
        """g and its derivative by r^2."""
        if self.name == "se":
            g = np.exp(-0.5 * squared)
            return g, -0.5 * g
        if self.name == "matern32":
            a = np.sqrt(3.0 * squared)
            return (1.0 + a) * np.exp(-a), -1.5 * np.exp(-a)
        if self.name == "matern52":
            a = np.sqrt(5.0 * squared)
            return (1.0 + a + a * a / 3.0) * np.exp(-a), -5.0 / 6.0 * (1.0 + a) * np.exp(-a)
        base = 1.0 + squared / (2.0 * self.alpha)
        return base**-self.alpha, -0.5 * base ** (-self.alpha - 1.0)

    def smooth(self, A: Array, B: Array) -> Array:
        """Covariance of A (M, Q) and B (N, Q) without the delta, shape (M, N)."""
        return self.radial(cdist(A, B, "sqeuclidean"))[0] + self.linear * (A @ B.T)

    def training(self, X: Array) -> Array:
        """Covariance of training latents (N, Q)."""
        return self.smooth(X, X) + self.mu * np.eye(len(X))

    def training_and_slope(self, X: Array) -> tuple[Array, Array]:
        """Covariance of training latents (N, Q), and the derivative of its radial part by r^2."""
        K, slope = self.radial(cdist(X, X, "sqeuclidean"))
        if self.linear:
            K = K + self.linear * (X @ X.T)
        K[np.diag_indices_from(K)] += self.mu
        return K, slope

    def pull(self, A: Array, B: Array, H: Array, slope: Array | None = None) -> Array:
        """Gradient by A (M, Q) of `sum(H * smooth(A, B))`, H (M, N) held; the slope where it is at hand."""
        G = 2.0 * H * (self.radial(cdist(A, B, "sqeuclidean"))[1] if slope is None else slope)
        return G.sum(axis=1)[:, None] * A - G @ B + self.linear * (H @ B)


class Process(GPWeights):
    """`GPWeights` under another kernel."""

    kernel: Kernel

    def __init__(self, X: Array, kernel: Kernel) -> None:
        self.X, self.kernel = X, kernel
        self.K = kernel.training(X)
        self.L = cholesky(self.K + 1e-12 * np.trace(self.K) / len(X) * np.eye(len(X)), lower=True)
        self.jitter = 0.0


# -- mappings ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Power:
    """`T(f) = f^(1/root)`, signed."""

    root: float = 3.0
    name = "power"

    def forward(self, values: Array, cosine_weight: Array | None = None) -> Array:
        """The signed root."""
        return np.sign(values) * np.abs(values) ** (1.0 / self.root)

    def inverse(self, mapped: Array, cosine_weight: Array | None = None) -> Array:
        """The signed power."""
        return np.sign(mapped) * np.abs(mapped) ** self.root

    def slope(self, values: Array, cosine_weight: Array | None = None) -> Array:
        """`root f^(1 - 1/root)`."""
        return self.root * np.abs(values) ** (1.0 - 1.0 / self.root)


CUBE_ROOT = CubeRoot()

# -- models ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Setting:
    """A model and its variants.

    Attributes:
        structure, colour: coordinates that the bands of a material share, and that each band has.
        whole: whole materials are samples; they have `colour` coordinates, and `structure` is 0.
        kernel: with its mu.
        prior: weight of the Gaussian prior per output and sample.
        prior_colour: that of the colour coordinates where it differs.
        mapping: T.
        gram_power: outputs weigh cosines^gram_power in the Gram matrix.
        learn: `mu`, `ard` (a length scale per axis), both or none: by likelihood.
        n_starts: two principal-component splits, then random perturbations of them.
        choose: which end counts: `likelihood`; `others`, the closed-form error of leaving out each of the other
            materials, latents kept; or `held-out`, an oracle.
        back: None, `linear` or `rbf`: latents are functions of the data; `back_only` encodes by these alone.
        encoder: `best` polishes the best end by decoded error, `all` every end.
        bands: samples per material; `farthest` chooses them by distance, else evenly spaced.
        interpolate: colours of the other bands by interpolation, not each from its data.
        max_iter: of L-BFGS.
    """

    structure: int = 2
    colour: int = 1
    whole: bool = False
    kernel: Kernel = Kernel()
    prior: float = 0.1
    prior_colour: float | None = None
    mapping: Mapping = CUBE_ROOT
    gram_power: float = 1.0
    learn: tuple[str, ...] = ()
    n_starts: int = 2
    choose: str = "likelihood"
    back: str | None = None
    back_only: bool = False
    encoder: str = "best"
    bands: int = 5
    farthest: bool = False
    interpolate: bool = False
    max_iter: int = 300


@dataclass(frozen=True, eq=False)
class Model:
    """A fitted model.

    Attributes:
        process: of the samples.
        objective: F at the end.
        encode: the back constraint, from products (R, n) and squared norms (R,) to latents (R, Q), or None.
    """

    process: Process
    objective: float
    encode: Callable[[Array, Array], Array] | None


def fit(S: Array, n_materials: int, n_outputs: int, setting: Setting) -> list[Model]:
    """Models of a Gram matrix S (n, n) from every start, the likeliest first."""
    n, Qs = len(S), setting.structure
    B = n // n_materials
    Sc = centre_gram(S)
    features, encoder = _features(S, setting.back)
    prior = priors(setting)
    tie = np.kron(np.eye(n_materials), np.full((B, B), 1.0 / B))  # mean over the bands of a material
    n_ard = Qs + setting.colour if "ard" in setting.learn else 0
    learns_mu = "mu" in setting.learn

    def unpack(z: Array) -> tuple[Array, Array, float]:
        """Latents (n, Q) before scaling, scales (Q,), mu."""
        end = len(z) - n_ard - learns_mu
        scale = np.exp(z[end : end + n_ard]) if n_ard else np.ones(len(prior))
        mu = float(np.exp(z[-1])) if learns_mu else setting.kernel.mu
        if features is None:
            split = n_materials * Qs
            s, c = z[:split].reshape(n_materials, Qs), z[split:end].reshape(n, setting.colour)
            return np.hstack([np.repeat(s, B, axis=0), c]), scale, mu
        X = features @ z[:end].reshape(features.shape[1], -1)
        return np.hstack([tie @ X[:, :Qs], X[:, Qs:]]), scale, mu

    def value_and_gradient(z: Array) -> tuple[float, Array]:
        X, scale, mu = unpack(z)
        kernel = replace(setting.kernel, mu=mu)
        K, slope = kernel.training_and_slope(X * scale)
        L = dpotrf(K, lower=1, overwrite_a=True)[0]
        P = np.tril(dpotri(L, lower=1)[0])
        P = P + np.tril(P, -1).T
        PS = P @ Sc
        trace = float(np.trace(PS))
        dK = 0.5 * P - (0.5 * n / trace) * (PS @ P)
        pulled = 2.0 * kernel.pull(X * scale, X * scale, dK, slope)
        F = np.sum(np.log(np.diag(L))) + 0.5 * n * np.log(trace / (n * n_outputs))
        F += 0.5 * float(np.sum(prior * X * X))
        G = pulled * scale + prior * X
        if features is None:
            parts = [G[:, :Qs].reshape(n_materials, B, Qs).sum(axis=1).ravel(), G[:, Qs:].ravel()]
        else:
            parts = [(features.T @ np.hstack([tie @ G[:, :Qs], G[:, Qs:]])).ravel()]
        if n_ard:
            parts.append(np.sum(pulled * X, axis=0) * scale)
        if learns_mu:
            parts.append(np.array([np.trace(dK) * mu]))
        return float(F), np.concatenate(parts)

    models = []
    for structure, colour in _starts(Sc, n_materials, B, setting):
        if features is None:
            z0 = np.concatenate([structure.ravel(), colour.ravel()])
        else:
            target = np.hstack([np.repeat(structure, B, axis=0), colour])
            ridge = features.T @ features + 1e-3 * np.trace(features.T @ features) / n * np.eye(
                features.shape[1]
            )
            z0 = np.linalg.solve(ridge, features.T @ target).ravel()
        z0 = np.concatenate([z0, np.zeros(n_ard), [np.log(setting.kernel.mu)] * learns_mu])
        bounds: list[tuple[float | None, float | None]] = [(None, None)] * (len(z0) - n_ard - learns_mu)
        bounds += [(-3.0, 3.0)] * n_ard + [(np.log(1e-6), np.log(0.3))] * learns_mu
        found = minimize(
            value_and_gradient, z0, jac=True, method="L-BFGS-B", bounds=bounds,
            options={"maxiter": setting.max_iter},
        )  # fmt: skip
        X, scale, mu = unpack(found.x)
        encode = None
        if encoder is not None and features is not None:
            A = found.x[: len(found.x) - n_ard - learns_mu].reshape(features.shape[1], -1)

            def encode(cross: Array, norm: Array, A: Array = A, scale: Array = scale) -> Array:
                x = encoder(cross, norm) @ A
                return np.hstack([np.tile(x[:, :Qs].mean(axis=0), (len(x), 1)), x[:, Qs:]]) * scale

        models.append(Model(Process(X * scale, replace(setting.kernel, mu=mu)), float(found.fun), encode))
    return sorted(models, key=lambda m: m.objective)


def left_out_error(process: Process, S: Array, group: int) -> float:
    """Mean of log ||T(f) - T(f*)||^2 over materials of `group` samples, each predicted from the others, latents kept.

    With `P = K^-1` and a material's rows g the residual is `P_gg^-1 (P Y)_g`.
    """
    Sc = centre_gram(S)
    P = cho_solve((process.L, True), np.eye(len(S)))
    PSP = P @ Sc @ P
    logs = []
    for g in range(0, len(S), group):
        block = np.linalg.inv(P[g : g + group, g : g + group])
        logs.append(np.log(np.trace(block @ PSP[g : g + group, g : g + group] @ block)))
    return float(np.mean(logs))


def priors(setting: Setting) -> Array:
    """Weight of the prior per axis, shape (Q,)."""
    colour = setting.prior if setting.prior_colour is None else setting.prior_colour
    return np.concatenate([np.full(setting.structure, setting.prior), np.full(setting.colour, colour)])


def _starts(Sc: Array, N: int, B: int, setting: Setting) -> list[tuple[Array, Array]]:
    """Structure (N, Q_s) and colour (N * B, Q_c) to start from: those of the package, then perturbed ones."""
    starts = MonochromeGPLVM(setting.structure, setting.colour)._starts(Sc, N, B)
    random = np.random.default_rng(0)
    for k in range(len(starts), setting.n_starts):
        s, c = starts[k % min(2, len(starts))]
        starts.append((s + 0.3 * random.normal(size=s.shape), c + 0.3 * random.normal(size=c.shape)))
    return starts[: setting.n_starts]


def _features(S: Array, kind: str | None) -> tuple[Array | None, Callable[[Array, Array], Array] | None]:
    """Features (n, m) of samples that latents are linear in, and the same of new ones from their products."""
    if kind is None:
        return None, None
    if kind == "linear":  # principal components of the samples, of unit variance
        values, vectors = np.linalg.eigh(centre_gram(S))
        kept = values > 1e-3 * values[-1]
        U, root = vectors[:, kept], np.sqrt(values[kept])
        scale = np.sqrt(len(S))

        def linear(cross: Array, norm: Array) -> Array:
            centred = cross - cross.mean(axis=1, keepdims=True) - S.mean(axis=1) + S.mean()
            return np.hstack([centred @ U / root**2 * scale, np.ones((len(cross), 1))])

        return np.hstack([U * scale, np.ones((len(S), 1))]), linear
    diagonal = np.diag(S)
    width = 2.0 * np.median(diagonal[:, None] + diagonal - 2.0 * S)

    def rbf(cross: Array, norm: Array) -> Array:
        return np.exp(-(norm[:, None] + diagonal[None] - 2.0 * cross) / width)

    return rbf(S, diagonal), rbf


class TrialDecoder(Decoder):
    """`Decoder` under any kernel, with a prior per axis."""

    gp: Process
    prior: Array

    def ends(self, f: Array, setting: Setting, first: Array | None) -> Array:
        """Latents (R, Q) of a material of values f (R, P): the end of least decoded error."""
        T = self.mapping.forward(f[..., None], self._row_cosines(len(f)))[..., 0]
        weighted = self.mapped * self.gram_weight
        S, cross = weighted @ self.mapped.T, T @ weighted.T
        norm = np.sum(T * T * self.gram_weight, axis=1)
        starts = self._starts(S, cross, norm) if first is None else [first]
        ends = [self._minimise(self._mapped_residual(S, cross, norm), start) for start in starts]
        kept = ends if setting.encoder == "all" else [min(ends, key=lambda end: end[1])]
        decoded = [self._minimise(self._decoded_error(f), end[0]) for end in kept]
        return min(decoded, key=lambda end: end[1])[0]

    def _minimise(self, objective, start, *, fixed=False):
        R, Q = start.shape
        Qs, X, gp = self.n_structure, self.gp.X, self.gp

        def unpack(z: Array) -> Array:
            return np.hstack([np.broadcast_to(z[:Qs], (R, Qs)), z[Qs:].reshape(R, Q - Qs)])

        def value_and_gradient(z: Array) -> tuple[float, Array]:
            x = unpack(z)
            W = cho_solve((gp.L, True), gp.kernel.smooth(x, X).T).T
            value, dV = objective(W + (1.0 - W.sum(axis=1, keepdims=True)) / gp.n_samples)
            dW = dV - dV.mean(axis=1, keepdims=True)
            gradient = gp.kernel.pull(x, X, cho_solve((gp.L, True), dW.T).T)
            gradient = 0.5 * R * gradient + self.prior * x
            shared = np.zeros(Qs) if fixed else gradient[:, :Qs].sum(axis=0)
            total = 0.5 * R * value + 0.5 * float(np.sum(self.prior * x * x))
            return total, np.concatenate([shared, gradient[:, Qs:].ravel()])

        z0 = np.concatenate([start[0, :Qs], start[:, Qs:].ravel()])
        found = minimize(value_and_gradient, z0, jac=True, method="L-BFGS-B", options={"maxiter": 200})
        return unpack(found.x), float(found.fun)
