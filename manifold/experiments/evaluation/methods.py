"""The registry of ways to predict a material from others: baselines, and the models of this package.

A new method is one more entry.
"""

from __future__ import annotations

from collections.abc import Callable

from manifold.experiments.evaluation.baselines import fit_linear, fit_nearest, fit_oracle, fit_pca
from manifold.experiments.evaluation.latent_models import (
    SAMPLE_BANDS,
    fit_monochrome,
    fit_published,
    fit_settings,
)
from manifold.experiments.evaluation.method import Method
from manifold.experiments.evaluation.nonnegative import (
    NUMBERS_PER_BAND,
    fit_nonnegative,
    fit_nonnegative_pair,
)
from manifold.experiments.evaluation.tabulated import MAX_BANDS
from manifold.model.settings import Settings


def standard_methods() -> list[Method]:
    """Methods that need no fitted model: baselines first, the setting of Hikichi & Iwasaki, then models."""
    return [*baseline_methods(), *gplvm_methods()]


def baseline_methods() -> list[Method]:
    """Baselines of the models of this package."""
    return [
        Method("nearest", "nearest material", lambda B: 1, fit_nearest),
        Method("linear", "linear, two nearest", lambda B: 3, fit_linear),
        Method("oracle", "best mix of two (an oracle)", lambda B: 3, fit_oracle),
        Method("pca_6_identity", "PCA, 6, identity", lambda B: 6, fit_pca("identity", 6)),
        Method("pca_6_cube_root", "PCA, 6, cube root", lambda B: 6, fit_pca("cube-root", 6)),
        Method("pca_6_log_relative", "PCA, 6, log-relative", lambda B: 6, fit_pca("log-relative", 6)),
        Method("published", "Hikichi & Iwasaki, 2-D", lambda B: 2, fit_published, fits_model=True),
        Method(
            "nonnegative", "non-negative least squares", lambda B: NUMBERS_PER_BAND * B,
            fit_nonnegative(SAMPLE_BANDS), sample_bands=SAMPLE_BANDS, fits_model=True,
        ),
    ]  # fmt: skip


def gplvm_methods() -> list[Method]:
    """Models of this package at settings of their own."""
    pair = Method(
        "nonnegative_pair", "two samples + Lambertian", lambda B: 3 + 2 * B, fit_nonnegative_pair(SAMPLE_BANDS),
        sample_bands=SAMPLE_BANDS, fits_model=True,
    )  # fmt: skip
    return [
        _model("gplvm_2", "GPLVM, 2, cube root", lambda B: 2, None),
        _model("gplvm_6", "GPLVM, 6, cube root", lambda B: 6, None),
        _model("monochrome_2_1", "monochrome, 2 + 1 per band", lambda B: 2 + B),
        _model("monochrome_3_1", "monochrome, 3 + 1 per band", lambda B: 3 + B),
        Method(
            "monochrome_0_2", "monochrome, 2 per band", lambda B: 2 * min(B, MAX_BANDS),
            fit_monochrome(Settings(kind="monochrome", latent_dim=0), "decoded", n_colour=2),
            sample_bands=SAMPLE_BANDS, fits_model=True,
        ),
        pair,
        _model("blend_2", "blend, 2 + 2 per band", lambda B: 2 + 2 * B),
        _model("blend_3", "blend, 3 + 2 per band", lambda B: 3 + 2 * B),
    ]  # fmt: skip


def _whole(latent_dim: int, prior: float) -> Settings:
    return Settings("material", latent_dim, optimizer="l-bfgs", prior=prior, criterion="decoded")


STANDARD = {
    "gplvm_2": _whole(2, 0.0),
    "gplvm_6": _whole(6, 0.1),
    "monochrome_2_1": Settings("monochrome", 2, criterion="decoded"),
    "monochrome_3_1": Settings("monochrome", 3, criterion="decoded"),
    "blend_2": Settings("blend", 2),
    "blend_3": Settings("blend", 3),
}
"""Settings of the models among the methods, by key."""


def _model(
    key: str, title: str, numbers: Callable[[int], int], sample_bands: int | None = SAMPLE_BANDS
) -> Method:
    return Method(
        key, title, numbers, fit_settings(STANDARD[key]), sample_bands=sample_bands, fits_model=True
    )
