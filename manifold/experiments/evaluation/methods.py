"""The registry of ways to predict a material from others: baselines, and the models of this package.

A new method is one more entry.
"""

from __future__ import annotations

from manifold.experiments.evaluation.baselines import fit_linear, fit_nearest, fit_oracle, fit_pca
from manifold.experiments.evaluation.blends import fit_blend
from manifold.experiments.evaluation.latent_models import (
    SAMPLE_BANDS,
    fit_gplvm,
    fit_monochrome,
    fit_published,
)
from manifold.experiments.evaluation.method import Method
from manifold.experiments.evaluation.nonnegative import (
    NUMBERS_PER_BAND,
    fit_nonnegative,
    fit_nonnegative_pair,
)
from manifold.experiments.evaluation.tabulated import MAX_BANDS


def standard_methods() -> list[Method]:
    """Methods that need no fitted model: baselines first, the setting of Hikichi & Iwasaki, then models."""
    return [*baseline_methods(), *gplvm_methods()]


def baseline_methods() -> list[Method]:
    """What a model of this package has to beat."""
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
    return [
        Method("gplvm_2", "GPLVM, 2, cube root", lambda B: 2, fit_gplvm(2), fits_model=True),
        Method("gplvm_6", "GPLVM, 6, cube root", lambda B: 6, fit_gplvm(6, prior=0.1), fits_model=True),
        _monochrome("monochrome_2_1", "monochrome, 2 + 1 per band", 2, 1),
        _monochrome("monochrome_3_1", "monochrome, 3 + 1 per band", 3, 1),
        _monochrome("monochrome_0_2", "monochrome, 2 per band", 0, 2),
        Method(
            "nonnegative_pair",
            "two samples + Lambertian",
            lambda B: 3 + 2 * B,
            fit_nonnegative_pair(SAMPLE_BANDS),
            sample_bands=SAMPLE_BANDS,
            fits_model=True,
        ),
        Method(
            "blend_2",
            "blend, 2 + 2 per band",
            lambda B: 2 + 2 * B,
            fit_blend(2),
            sample_bands=SAMPLE_BANDS,
            fits_model=True,
        ),
        Method(
            "blend_3",
            "blend, 3 + 2 per band",
            lambda B: 3 + 2 * B,
            fit_blend(3),
            sample_bands=SAMPLE_BANDS,
            fits_model=True,
        ),
    ]


def _monochrome(key: str, title: str, n_structure: int, n_colour: int) -> Method:
    def numbers(B: int) -> int:
        return n_structure + n_colour * (B if n_colour == 1 else min(B, MAX_BANDS))

    fit = fit_monochrome(n_structure, n_colour)
    return Method(key, title, numbers, fit, sample_bands=SAMPLE_BANDS, fits_model=True)
