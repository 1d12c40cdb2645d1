"""Latent variable models as held-out methods: fitted to some materials, they encode others."""

from __future__ import annotations

from functools import partial

from manifold.experiments.evaluation.blends import fit_blend
from manifold.experiments.evaluation.method import Encode, Fit
from manifold.experiments.evaluation.samples import LatentProcess, Samples
from manifold.experiments.evaluation.tabulated import Data
from manifold.gplvm import GPLVM
from manifold.mapping import mapping_named
from manifold.model.settings import Settings
from manifold.models.per_band import MonochromeGPLVM
from manifold.records import Array

SAMPLE_BANDS = Settings().sample_bands
_TOLERANCE = 1e-5  # of fits that are made once per left-out material


def fit_settings(s: Settings, criterion: str | None = None, tolerance: float = _TOLERANCE) -> Fit:
    """The model that a manifold of these settings has, of fewer dimensions where there are not enough materials.

    Args:
        s: of the model.
        criterion: by which materials are encoded; that of the settings if None.
        tolerance: of the fit, where its kind takes one.
    """
    return _FITS[s.kind](s, criterion or s.criterion, tolerance)


def fit_gplvm(s: Settings, criterion: str, tolerance: float, *, is_clipped: bool = True) -> Fit:
    """The whole-material GPLVM; arguments as of `fit_settings`, and whether negative values are cut to 0."""

    def fit(data: Data, training: Array) -> Encode:
        samples = Samples(data, mapping_named(s.mapping), None)
        Q = min(s.latent_dim, len(training) - 1)
        model = GPLVM(
            Q, mu=s.mu, length_scale=s.length_scale, kernel=s.kernel, prior=s.prior, optimizer=s.optimizer,
            tol=tolerance,
        ).fit_gram(samples.gram_of(training), samples.n_outputs)  # fmt: skip
        process = LatentProcess(model.gp_, Q, samples, training, s.prior, criterion)
        return partial(process.encode, is_clipped=is_clipped)

    return fit


def fit_published(data: Data, training: Array) -> Encode:
    """As Hikichi & Iwasaki: raw values, 2-D, mu = 1e-4, direct local search; the latent by mapped residual."""
    settings = Settings("material", 2, "identity", mu=1e-4, optimizer="dls")
    return fit_gplvm(settings, "mapped", _TOLERANCE, is_clipped=False)(data, training)


def fit_monochrome(s: Settings, criterion: str, tolerance: float = _TOLERANCE, *, n_colour: int = 1) -> Fit:
    """The monochrome GPLVM; arguments as of `fit_settings`, and how many colour coordinates a band has."""

    def fit(data: Data, training: Array) -> Encode:
        samples = Samples(data, mapping_named(s.mapping), data.available_bands(s.sample_bands))
        Qs = min(s.latent_dim, len(training) - 1)
        model = MonochromeGPLVM(
            Qs, n_colour, mu=s.mu, length_scale=s.length_scale, kernel=s.kernel, prior=s.prior
        ).fit_gram(samples.gram_of(training), len(training), samples.n_outputs)  # fmt: skip
        return LatentProcess(model.gp_, Qs, samples, training, s.prior, criterion).encode

    return fit


_FITS = {
    "blend": lambda s, _criterion, _tolerance: fit_blend(s.latent_dim, s.sample_bands),
    "material": fit_gplvm,
    "monochrome": fit_monochrome,
}
