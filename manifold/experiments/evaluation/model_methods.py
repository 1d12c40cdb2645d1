"""Predictions of a fitted manifold for its own materials: reconstructed, left out with latents kept, and refitted."""

from __future__ import annotations

import numpy as np

from manifold.experiments.evaluation.baselines import fit_pca
from manifold.experiments.evaluation.latent_models import fit_settings
from manifold.experiments.evaluation.method import Encode, Fit, Method
from manifold.experiments.evaluation.methods import STANDARD
from manifold.experiments.evaluation.samples import LatentProcess, Samples
from manifold.experiments.evaluation.tabulated import Data
from manifold.model.combination import Combination
from manifold.model.manifold import Manifold
from manifold.models.gp_weights import GPWeights
from manifold.records import Array

_COMPARED_CRITERIA = ("decoded", "cube-root", "likelihood")


def model_methods(model: Manifold) -> list[Method]:
    """Methods of one fitted model, most flattering first; refitted ones are the honest ones."""
    numbers, count = model.space.numbers, _pca_count(model)
    reconstruction = Method(
        "reconstruction",
        "reconstruction",
        numbers,
        _fit_reconstruction(model),
        is_held_out=False,
        refits=False,
    )
    pca = Method(
        "pca_log_relative", f"PCA, {count}, log-relative", lambda B: count, fit_pca("log-relative", count)
    )
    return [reconstruction, *_METHODS[model.settings.kind](model), pca]


def _process_methods(model: Manifold) -> list[Method]:
    """Of a Gaussian process on latents."""
    settings = model.settings
    return [
        _method(model, "smooth", "reconstruction, smooth", _fit_smooth(model), held_out=False, refits=False),
        _method(model, "gp_latents_kept", "GP, latents kept", _fit_latents_kept(model), refits=False),
        _method(model, "gp_encoded", "GP, encoded, others kept", _fit_encoded(model)),
        _method(model, "gp_refitted", "GP, refitted without it", fit_settings(settings)),
        *(
            _method(
                model, f"gp_refitted_{criterion.replace('-', '_')}", f"GP, refitted, {criterion}",
                fit_settings(settings, criterion),
            )
            for criterion in _COMPARED_CRITERIA
            if criterion != settings.criterion
        ),
    ]  # fmt: skip


def _blend_methods(model: Manifold) -> list[Method]:
    """Of a map of blends, whose places are found in one way."""
    return [_method(model, "blend_refitted", "blend, refitted without it", fit_settings(model.settings))]


_METHODS = {"blend": _blend_methods, "material": _process_methods, "monochrome": _process_methods}


def _method(
    model: Manifold, key: str, title: str, fit: Fit, *, held_out: bool = True, refits: bool = True
) -> Method:
    space = model.space
    sample_bands = None if space.sample_bands is None else len(space.sample_bands)
    return Method(key, title, space.numbers, fit, held_out, refits, sample_bands, "refitted" in key)


def replaced_keys(model: Manifold) -> set[str]:
    """Keys of the standard methods that are the model's own under another name."""
    same = {key for key, settings in STANDARD.items() if model.settings == settings}
    return same | {f"pca_{_pca_count(model)}_log_relative"}


def _pca_count(model: Manifold) -> int:
    """As many components as a latent of the model has coordinates."""
    return min(model.gp.X.shape[1], len(model.names) - 2)


def _fit_reconstruction(model: Manifold) -> Fit:
    """The measured material, which the kernel's delta makes of every training latent."""

    def fit(data: Data, training: Array) -> Encode:
        return lambda i: Combination(model.mapping, np.eye(data.n_materials)[i], is_clipped=False)

    return fit


def _fit_smooth(model: Manifold) -> Fit:
    """The posterior mean at a material's own latent without the delta: what lies next to the material."""

    def fit(data: Data, training: Array) -> Encode:
        process = _process(model, data, training)

        def encode(i: int) -> Combination:
            latents = model.space.own_latents(i)
            return process.at(latents, process.gp.smooth_weights(latents))

        return encode

    return fit


def _fit_latents_kept(model: Manifold) -> Fit:
    """The posterior mean at a material's own latent, of a process on the other materials.

    Latents were fitted with the material, so the error is optimistic. Of whole materials it is the closed
    form of leave-one-out (Rasmussen & Williams 2006, eq. 5.12).
    """

    def fit(data: Data, training: Array) -> Encode:
        variance = _process(model, data, training).output_variance  # of all materials, this one too

        def encode(i: int) -> Combination:
            process = _process(model, data, np.delete(training, i), variance)
            return process.at(model.space.own_latents(i))

        return encode

    return fit


def _fit_encoded(model: Manifold) -> Fit:
    """The process on the other materials, their latents kept; the material's own is found from its data."""

    def fit(data: Data, training: Array) -> Encode:
        return _process(model, data, training).encode

    return fit


def _process(
    model: Manifold, data: Data, materials: Array, output_variance: float | None = None
) -> LatentProcess:
    """The process on the latents of some materials of the model."""
    space = model.space
    samples = Samples(data, model.mapping, space.sample_bands)
    gp = GPWeights(space.latents_of(materials), space.kernel)
    return LatentProcess(
        gp, space.X.shape[1], samples, materials, model.settings.prior, known_variance=output_variance
    )
