"""Latent variable models with options that the package lacks: priors per axis, mu and length scales by likelihood.

What won a trial is in the package; the rest lives here alone. See bench_held_out.py.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve
from scipy.optimize import minimize

from manifold.experiments.evaluation.cross_validation import Encode, Fit
from manifold.experiments.evaluation.latent_models import LatentProcess, Samples
from manifold.experiments.evaluation.tabulated import Data
from manifold.gpr import GPWeights
from manifold.latent.kernels import Kernel, SquaredExponential
from manifold.latent.objective import LatentObjective, centre_gram
from manifold.latent.per_band import MonochromeGPLVM
from manifold.mapping import CubeRoot, Mapping
from manifold.model.combination import Combination
from manifold.records import Array


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
_KERNEL = SquaredExponential(1e-3)


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
        gram_power: outputs weigh cosines^gram_power in the Gram matrix that a model is fitted to.
        learn: `mu`, `ard` (a length scale per axis), both or none: by likelihood.
        n_starts: two principal-component splits, then random perturbations of them.
        choose: which end counts: `likelihood`; `others`, the closed-form error of leaving out each of the other
            materials, latents kept; or `held-out`, an oracle.
        criterion: by which materials are encoded.
        bands: samples per material; `farthest` chooses them by distance, else evenly spaced.
        max_iter: of L-BFGS.
    """

    structure: int = 2
    colour: int = 1
    whole: bool = False
    kernel: Kernel = _KERNEL
    prior: float = 0.1
    prior_colour: float | None = None
    mapping: Mapping = CUBE_ROOT
    gram_power: float = 1.0
    learn: tuple[str, ...] = ()
    n_starts: int = 2
    choose: str = "likelihood"
    criterion: str = "decoded"
    bands: int = 5
    farthest: bool = False
    max_iter: int = 300

    @property
    def priors(self) -> Array:
        """Weight of the prior per axis, shape (Q,)."""
        colour = self.prior if self.prior_colour is None else self.prior_colour
        return np.concatenate([np.full(self.structure, self.prior), np.full(self.colour, colour)])


def fit_trial(setting: Setting) -> Fit:
    """A trial as a method of `manifold.experiments.evaluation`."""

    def fit(data: Data, training: Array) -> Encode:
        bands = None if setting.whole else sample_bands(data, setting)
        samples = Samples(data, setting.mapping, bands)
        rows = samples.rows(training)
        S = data.gram(setting.mapping, bands, power=setting.gram_power)[np.ix_(rows, rows)]
        models = fit_gram(S, len(training), samples.n_outputs, setting)
        if setting.choose == "likelihood":
            models = models[:1]
        elif setting.choose == "others":
            models = [min(models, key=lambda gp: left_out_error(gp, S, samples.group))]
        shared = setting.colour if setting.whole else setting.structure
        found = [
            LatentProcess(gp, shared, samples, training, setting.priors, setting.criterion) for gp in models
        ]

        def encode(i: int) -> Combination:
            ends = [process.encode(i) for process in found]
            if len(ends) == 1:
                return ends[0]
            return min(ends, key=lambda c: data.relative_error(i, c.in_bands(data.bands).evaluate(data)))

        return encode

    return fit


def sample_bands(data: Data, setting: Setting) -> Array:
    """Evenly spaced bands, or those whose mapped values differ most from the ones chosen before."""
    if not setting.farthest:
        return data.available_bands(setting.bands)
    some = slice(None, None, data.stride)
    flat = np.moveaxis(data.mapped(setting.mapping)[:, some], 2, 0) * np.sqrt(data.cosines[some])
    flat = flat.reshape(len(data.bands), -1)
    products = flat @ flat.T
    squared = np.diag(products)[:, None] + np.diag(products) - 2.0 * products
    chosen = [0, len(data.bands) - 1]
    while len(chosen) < setting.bands:
        chosen.append(int(squared[:, chosen].min(axis=1).argmax()))
    return data.bands[np.sort(chosen)]


def fit_gram(S: Array, n_materials: int, n_outputs: int, setting: Setting) -> list[GPWeights]:
    """Models of a Gram matrix S (n, n) from every start, the likeliest first."""
    n, Qs = len(S), setting.structure
    B = n // n_materials
    Sc = centre_gram(S)
    prior = setting.priors
    n_ard, learns_mu = len(prior) if "ard" in setting.learn else 0, "mu" in setting.learn
    split, free = n_materials * Qs, n_materials * Qs + n * setting.colour

    def unpack(z: Array) -> tuple[Array, Array, Kernel]:
        """Latents (n, Q) before scaling, scales (Q,), kernel."""
        s, c = z[:split].reshape(n_materials, Qs), z[split:free].reshape(n, setting.colour)
        scale = np.exp(z[free : free + n_ard]) if n_ard else np.ones(len(prior))
        mu = float(np.exp(z[-1])) if learns_mu else setting.kernel.mu
        return np.hstack([np.repeat(s, B, axis=0), c]), scale, replace(setting.kernel, mu=mu)

    def value_and_gradient(z: Array) -> tuple[float, Array]:
        X, scale, kernel = unpack(z)
        F, pulled, d_mu = LatentObjective(Sc, n_outputs, kernel).with_noise(X * scale)
        F += 0.5 * float(np.sum(prior * X * X))
        G = pulled * scale + prior * X
        parts = [G[:, :Qs].reshape(n_materials, B, Qs).sum(axis=1).ravel(), G[:, Qs:].ravel()]
        if n_ard:
            parts.append(np.sum(pulled * X, axis=0) * scale)
        if learns_mu:
            parts.append(np.array([d_mu * kernel.mu]))
        return float(F), np.concatenate(parts)

    bounds: list[tuple[float | None, float | None]] = [(None, None)] * free
    bounds += [(-3.0, 3.0)] * n_ard + [(np.log(1e-6), np.log(0.3))] * learns_mu
    ends = []
    for structure, colour in _starts(Sc, n_materials, B, setting):
        learned = [np.zeros(n_ard), [np.log(setting.kernel.mu)] * learns_mu]
        found = minimize(
            value_and_gradient, np.concatenate([structure.ravel(), colour.ravel(), *learned]), jac=True,
            method="L-BFGS-B", bounds=bounds, options={"maxiter": setting.max_iter},
        )  # fmt: skip
        X, scale, kernel = unpack(found.x)
        ends.append((float(found.fun), GPWeights(X * scale, kernel)))
    return [gp for _, gp in sorted(ends, key=lambda end: end[0])]


def left_out_error(gp: GPWeights, S: Array, group: int) -> float:
    """Mean of log ||T(f) - T(f*)||^2 over materials of `group` samples, each predicted from the others, latents kept.

    With `P = K^-1` and a material's rows g the residual is `P_gg^-1 (P Y)_g`.
    """
    Sc = centre_gram(S)
    P = cho_solve((gp.L, True), np.eye(len(S)))
    PSP = P @ Sc @ P
    logs = []
    for g in range(0, len(S), group):
        block = np.linalg.inv(P[g : g + group, g : g + group])
        logs.append(np.log(np.trace(block @ PSP[g : g + group, g : g + group] @ block)))
    return float(np.mean(logs))


def _starts(Sc: Array, N: int, B: int, setting: Setting) -> list[tuple[Array, Array]]:
    """Structure (N, Q_s) and colour (N * B, Q_c) to start from: those of the package, then perturbed ones."""
    starts = MonochromeGPLVM(setting.structure, setting.colour)._starts(Sc, N, B)
    random = np.random.default_rng(0)
    for k in range(len(starts), setting.n_starts):
        s, c = starts[k % min(2, len(starts))]
        starts.append((s + 0.3 * random.normal(size=s.shape), c + 0.3 * random.normal(size=c.shape)))
    return starts[: setting.n_starts]
