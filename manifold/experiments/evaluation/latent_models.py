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

SAMPLE_BANDS = 5  # bands per material that are samples of a monochrome model
_TOLERANCE = 1e-5  # of fits that are made once per left-out material


def fit_gplvm(
    count: int,
    *,
    mapping: str = "cube-root",
    mu: float = 1e-4,
    length_scale: float = 1.0,
    kernel: str = "se",
    prior: float = 0.0,
    optimizer: str = "l-bfgs",
    criterion: str = "decoded",
    tolerance: float = _TOLERANCE,
    is_clipped: bool = True,
) -> Fit:
    """The whole-material GPLVM.

    Args:
        count: Q; fewer where there are not enough materials.
        mapping, mu, length_scale, kernel, prior, optimizer, tolerance: of the model.
        criterion: by which materials are encoded.
        is_clipped: whether negative values are cut to 0.
    """

    def fit(data: Data, training: Array) -> Encode:
        samples = Samples(data, mapping_named(mapping), None)
        Q = min(count, len(training) - 1)
        model = GPLVM(
            Q, mu=mu, length_scale=length_scale, kernel=kernel, prior=prior, optimizer=optimizer, tol=tolerance
        ).fit_gram(samples.gram_of(training), samples.n_outputs)  # fmt: skip
        process = LatentProcess(model.gp_, Q, samples, training, prior, criterion)
        return partial(process.encode, is_clipped=is_clipped)

    return fit


def fit_published(data: Data, training: Array) -> Encode:
    """As Hikichi & Iwasaki: raw values, 2-D, mu = 1e-4, direct local search; the latent by mapped residual."""
    return fit_gplvm(2, mapping="identity", optimizer="dls", criterion="mapped", is_clipped=False)(
        data, training
    )


def fit_monochrome(
    n_structure: int,
    n_colour: int = 1,
    *,
    mapping: str = "cube-root",
    mu: float = 1e-3,
    length_scale: float = 1.0,
    kernel: str = "se",
    prior: float = 0.1,
    sample_bands: int = SAMPLE_BANDS,
    criterion: str = "decoded",
) -> Fit:
    """The monochrome GPLVM.

    Args:
        n_structure: Q_s; fewer where there are not enough materials.
        n_colour, mapping, mu, length_scale, kernel, prior: of the model.
        sample_bands: bands per material that are samples.
        criterion: by which materials are encoded.
    """

    def fit(data: Data, training: Array) -> Encode:
        samples = Samples(data, mapping_named(mapping), data.available_bands(sample_bands))
        Qs = min(n_structure, len(training) - 1)
        model = MonochromeGPLVM(
            Qs, n_colour, mu=mu, length_scale=length_scale, kernel=kernel, prior=prior
        ).fit_gram(samples.gram_of(training), len(training), samples.n_outputs)  # fmt: skip
        return LatentProcess(model.gp_, Qs, samples, training, prior, criterion).encode

    return fit


def fit_settings(s: Settings, criterion: str | None = None, tolerance: float = _TOLERANCE) -> Fit:
    """The model that a manifold of these settings has; `tolerance` of its fit where its kind takes one."""
    return _FITS[s.kind](s, criterion or s.criterion, tolerance)


def _fit_whole(s: Settings, criterion: str, tolerance: float) -> Fit:
    return fit_gplvm(
        s.latent_dim, mapping=s.mapping, mu=s.mu, length_scale=s.length_scale, kernel=s.kernel, prior=s.prior,
        optimizer=s.optimizer, criterion=criterion, tolerance=tolerance,
    )  # fmt: skip


def _fit_bands(s: Settings, criterion: str, tolerance: float) -> Fit:
    return fit_monochrome(
        s.latent_dim, mapping=s.mapping, mu=s.mu, length_scale=s.length_scale, kernel=s.kernel, prior=s.prior,
        sample_bands=s.sample_bands, criterion=criterion,
    )  # fmt: skip


def _fit_blends(s: Settings, criterion: str, tolerance: float) -> Fit:
    return fit_blend(s.latent_dim, s.sample_bands)


_FITS = {"blend": _fit_blends, "material": _fit_whole, "monochrome": _fit_bands}
