"""What a fitted manifold predicts of its own materials: seen, left out with its latents kept, and refitted."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_solve

from manifold.experiments.evaluation.methods import (
    Encode,
    Fit,
    Method,
    curve,
    encode_in_curves,
    encode_in_materials,
    fit_gplvm,
    fit_monochrome,
    fit_pca,
    sample_columns,
)
from manifold.experiments.evaluation.tabulated import Data
from manifold.gpr import GPWeights
from manifold.model.combination import Combination
from manifold.model.curve_space import CurveSpace
from manifold.model.manifold import Manifold, Settings
from manifold.records import Array


def model_methods(model: Manifold) -> list[Method]:
    """Methods of one fitted model, most flattering first; refitted ones are the honest ones."""
    space, settings = model.space, model.settings
    is_curve = isinstance(space, CurveSpace)
    sample_bands = len(space.sample_bands) if isinstance(space, CurveSpace) else None

    def numbers(B: int) -> int:
        return settings.latent_dim + B * is_curve

    def method(key: str, title: str, fit: Fit, *, held_out: bool = True, refits: bool = True) -> Method:
        return Method(key, title, numbers, fit, held_out, refits, sample_bands, "refitted" in key)

    count = _pca_count(model)
    return [
        Method(
            "reconstruction", "reconstruction", numbers, _fit_reconstruction(model), is_held_out=False,
            refits=False,
        ),
        method("smooth", "reconstruction, smooth", _fit_smooth(model), held_out=False, refits=False),
        method("gp_latents_kept", "GP, latents kept", _fit_latents_kept(model), refits=False),
        method("gp_encoded", "GP, encoded, others kept", _fit_encoded(model)),
        method("gp_refitted", "GP, refitted without it", _fit_refitted(model)),
        method("gp_refitted_likelihood", "GP, refitted, likelihood", _fit_refitted(model, by_likelihood=True)),
        Method(
            "pca_log_relative", f"PCA, {count}, log-relative", lambda B: count,
            fit_pca("log-relative", count),
        ),
    ]  # fmt: skip


def replaced_keys(model: Manifold) -> set[str]:
    """Keys of the standard methods that are the model's own under another name."""
    s = model.settings
    keys = {f"pca_{_pca_count(model)}_log_relative"}
    standard = {
        "gplvm_2": Settings(kind="material", latent_dim=2, optimizer="l-bfgs"),
        "gplvm_6": Settings(kind="material", latent_dim=6, optimizer="l-bfgs", prior=0.1),
        "monochrome_2_1": Settings(latent_dim=2),
        "monochrome_3_1": Settings(latent_dim=3),
    }
    return keys | {key for key, settings in standard.items() if s == settings}


def _pca_count(model: Manifold) -> int:
    """As many components as the model has dimensions, its colour coordinate included."""
    return min(model.settings.latent_dim + isinstance(model.space, CurveSpace), len(model.names) - 2)


def _fit_reconstruction(model: Manifold) -> Fit:
    """The measured material, which the kernel's delta makes of every training latent."""

    def fit(data: Data, training: Array) -> Encode:
        return lambda i: Combination(model.mapping, np.eye(data.n_materials)[i], is_clipped=False)

    return fit


def _fit_smooth(model: Manifold) -> Fit:
    """The posterior mean at a material's own latent without the delta: what lies next to the material."""

    def fit(data: Data, training: Array) -> Encode:
        gp, output_variance = model.gp, _output_variance(model, data)

        def encode(i: int) -> Combination:
            latents = _latents(model, i)
            W = cho_solve((gp.L, True), gp.kernel.smooth(latents, gp.X).T).T
            weights = W + (1.0 - W.sum(axis=1, keepdims=True)) / gp.n_samples
            return _combine(model, data, training, gp, latents, output_variance, weights)

        return encode

    return fit


def _fit_latents_kept(model: Manifold) -> Fit:
    """The posterior mean at a material's own latent, of a process on the other materials.

    Latents were fitted with the material among the data: this flatters. Of whole materials it is the closed
    form of leave-one-out (Rasmussen & Williams 2006, eq. 5.12).
    """

    def fit(data: Data, training: Array) -> Encode:
        output_variance = _output_variance(model, data)

        def encode(i: int) -> Combination:
            others = np.delete(training, i)
            gp = _gp_of(model, others)
            return _combine(model, data, others, gp, _latents(model, i), output_variance)

        return encode

    return fit


def _fit_encoded(model: Manifold) -> Fit:
    """The process on the other materials, their latents kept; the material's own is found from its data."""

    def fit(data: Data, training: Array) -> Encode:
        gp, space, prior = _gp_of(model, training), model.space, model.settings.prior
        if isinstance(space, CurveSpace):
            return encode_in_curves(
                data, training, gp, space.X.shape[1], space.sample_bands, model.mapping, prior
            )
        S = data.gram(model.mapping)[np.ix_(training, training)]
        s2 = gp.output_variance(S, data.n_outputs)
        return encode_in_materials(data, training, gp, model.mapping, prior, s2)

    return fit


def _fit_refitted(model: Manifold, *, by_likelihood: bool = False) -> Fit:
    """The model's own settings, fitted to the others from their own principal components."""
    s = model.settings
    if isinstance(model.space, CurveSpace):
        return fit_monochrome(
            min(s.latent_dim, len(model.names) - 2), 1, mapping=s.mapping, mu=s.mu,
            length_scale=s.length_scale, kernel=s.kernel, prior=s.prior, sample_bands=s.sample_bands,
            by_likelihood=by_likelihood,
        )  # fmt: skip
    return fit_gplvm(
        s.latent_dim, mapping=s.mapping, mu=s.mu, length_scale=s.length_scale, kernel=s.kernel, prior=s.prior,
        optimizer=s.optimizer, by_likelihood=by_likelihood,
    )  # fmt: skip


def _latents(model: Manifold, i: int) -> Array:
    """Latents of material i: one, or one per band."""
    return model.space.own_latents(i)


def _gp_of(model: Manifold, materials: Array) -> GPWeights:
    """The process on the latents of some materials."""
    return GPWeights(model.space.latents_of(materials), model.space.kernel)


def _output_variance(model: Manifold, data: Data) -> float:
    """Profiled variance of the mapped values, all materials seen."""
    if isinstance(model.space, CurveSpace):
        S = data.sample_gram(model.mapping, model.space.sample_bands)
        return model.gp.output_variance(S, data.f.shape[1])
    return model.gp.output_variance(data.gram(model.mapping), data.n_outputs)


def _combine(
    model: Manifold,
    data: Data,
    training: Array,
    gp: GPWeights,
    latents: Array,
    output_variance: float,
    weights: Array | None = None,
) -> Combination:
    """The combination that latents stand for in a process on some materials."""
    if isinstance(model.space, CurveSpace):
        bands = model.space.sample_bands
        columns = sample_columns(training, len(bands))
        return curve(data, columns, gp, latents, bands, model.mapping, output_variance, weights)
    spread = np.zeros(data.n_materials)
    spread[training] = (gp.weights(latents) if weights is None else weights)[0]
    variance = output_variance * float(gp.variance(latents)[0])
    return Combination(model.mapping, spread, variance=variance)
