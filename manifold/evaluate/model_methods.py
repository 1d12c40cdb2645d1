"""Predicts a fitted manifold's own materials: reconstructed, left out with fixed latents, and left out with refits."""

from __future__ import annotations

import numpy as np

from manifold.core.records import Indices
from manifold.evaluate.baselines import fit_pca
from manifold.evaluate.cross_validation import Encode, Fit, Method
from manifold.evaluate.latent_models import LatentProcess, fit_settings
from manifold.evaluate.method_data import Data
from manifold.evaluate.methods import STANDARD
from manifold.gpr import GaussianProcess
from manifold.model.combination import Combination
from manifold.model.manifold import Manifold
from manifold.model.materials import MaterialTable
from manifold.model.settings import GplvmSettings


def model_methods(model: Manifold) -> list[Method]:
    """Return methods of one fitted model, the most optimistic first; refitted ones are unbiased."""
    s, space, count = model.settings, model.space, _pca_count(model)

    def method(key: str, title: str, fit: Fit, *, is_held_out: bool = True, refits: bool = True) -> Method:
        fits_model = "refitted" in key
        return Method(key, title, space.numbers, fit, is_held_out, refits, fits_model=fits_model)

    def fit_reconstruction(data: Data, training: Indices) -> Encode:
        """Predict the measured material itself, which the kernel's delta makes of every training latent."""
        return lambda i: Combination(model.mapping, np.eye(data.n_materials)[i], is_clipped=False)

    def fit_smooth(data: Data, training: Indices) -> Encode:
        """Predict by the posterior mean at a material's own latent without the delta.

        It describes points next to the material.
        """
        process = _process(model, data, training)

        def encode(i: int) -> Combination:
            return process.at(space.X[i], process.gp.smooth_weights(space.X[i : i + 1])[0])

        return encode

    def fit_latents_kept(data: Data, training: Indices) -> Encode:
        """Predict by the posterior mean at a material's own latent, of a process on the other materials.

        Latents were fitted with the material, so the error is optimistic. Of whole materials it is the closed
        form of leave-one-out (Rasmussen & Williams 2006, eq. 5.12).
        """
        variance = _process(model, data, training).output_variance  # variance of all materials, this one too

        def encode(i: int) -> Combination:
            return _process(model, data, np.delete(training, i), variance).at(space.X[i])

        return encode

    def fit_encoded(data: Data, training: Indices) -> Encode:
        """Predict by the process on the other materials, latents kept.

        The material's own latent is found from its data.
        """
        return _process(model, data, training).encode

    def fit_blend_encoded(data: Data, training: Indices) -> Encode:
        """Predict by blends of the other materials, which keep their points.

        The material's own point is found from its data.
        """
        table = MaterialTable(list(data.materials), np.arange(model.bands.count))
        search = space.left_out_search(table, model.materials, s)
        return lambda i: search(i)[1]

    reconstruction = Method(
        "reconstruction",
        "at its own latent",
        space.numbers,
        fit_reconstruction,
        is_held_out=False,
        refits=False,
    )
    pca = Method(
        "pca_log_relative", f"PCA {count}, log-relative", lambda B: count, fit_pca("log-relative", count)
    )
    if s.kind == "blend":  # places of blends are found in one way
        own = [
            method("blend_encoded", "blend, latents kept", fit_blend_encoded, refits=False),
            method("blend_refitted", "blend, refitted", fit_settings(s)),
        ]
    else:
        own = [
            method("smooth", "without delta", fit_smooth, is_held_out=False, refits=False),
            method("gp_latents_kept", "GP, latents kept", fit_latents_kept, refits=False),
            method("gp_encoded", "GP, others' latents kept", fit_encoded),
            method("gp_refitted", "GP, refitted", fit_settings(s)),
        ]
    return [reconstruction, *own, pca]


def replaced_keys(model: Manifold) -> set[str]:
    """Return the keys of the standard methods that are the same as the model's own methods."""
    same = {key for key, settings in STANDARD.items() if model.settings == settings}
    return same | {f"pca_{_pca_count(model)}_log_relative"}


def _pca_count(model: Manifold) -> int:
    """Return the number of components, equal to the coordinates of the model's latents if possible."""
    return min(model.gp.X.shape[1], len(model.names) - 2)


def _process(
    model: Manifold, data: Data, materials: Indices, output_variance: float | None = None
) -> LatentProcess:
    """Return the process on the latents of some materials of the model."""
    gp, s = GaussianProcess(model.space.X[materials], model.space.kernel), model.settings
    assert isinstance(s, GplvmSettings)
    return LatentProcess(
        gp, data, model.mapping, materials, s.prior, s.output_variance or output_variance,
        is_clipped=not s.as_published,
    )  # fmt: skip
