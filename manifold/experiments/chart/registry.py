"""The settings that a chart of speed against accuracy compares. One registry: a new setting is one more entry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from manifold.experiments.chart import storage_forms
from manifold.experiments.chart.storage_forms import Storage
from manifold.experiments.evaluation.baselines import fit_linear, fit_nearest, fit_pca
from manifold.experiments.evaluation.latent_models import SAMPLE_BANDS, fit_published, fit_settings
from manifold.experiments.evaluation.method import Fit
from manifold.experiments.evaluation.nonnegative import (
    NUMBERS_PER_BAND,
    fit_nonnegative,
    fit_nonnegative_pair,
)
from manifold.model.settings import Settings

PUBLISHED = "published"
AS_PUBLISHED = "Hikichi & Iwasaki 2-D, as published"
NONNEGATIVE = "samples and lobes, weights >= 0"
BLENDS = "blends, the default"
_MAPPINGS = ("identity", "cube-root", "log-relative")
_FEW_BANDS = (3, 6, 12)
_SAMPLES = 3  # bands per material that are samples, where nothing else is said
_THRESHOLDS = (0.03, 0.1)
_COARSE = ((2, 1), (2, 2), (4, 1))  # of outgoing rows and columns, and of incidences, one in so many is kept
_WHOLE = storage_forms.whole()


@dataclass(frozen=True)
class Setting:
    """A method at one choice of its knobs.

    Attributes:
        key: name in JSON.
        title: for people.
        family: of methods, as the legend of a chart names it.
        method: what is fitted; settings that differ in something else share a fit.
        fit: learns from some materials, and encodes any.
        numbers: how many numbers describe a material of B bands.
        sample_bands: measured bands that predictions read, at most; None is all.
        storage: how the measured files are kept.
        threshold: weights below this share of the largest one are dropped.
        is_dense: whether every material is resampled to the grid of 1,458,000 direction pairs.
    """

    key: str
    title: str
    family: str
    method: str
    fit: Fit
    numbers: Callable[[int], int]
    sample_bands: int | None = None
    storage: Storage = _WHOLE
    threshold: float = 0.0
    is_dense: bool = False


def settings(n_bands: int) -> list[Setting]:
    """All settings for materials of so many bands, simplest first."""
    pca, gplvm, monochrome = _pca("cube-root", 6), _gplvm("cube-root", 6), _monochrome(3, _SAMPLES)
    blend, nonnegative = _blend(2), _nonnegative()
    return [
        Setting("nearest", "nearest", "one or two materials", "nearest", fit_nearest, lambda B: 1),
        Setting("linear", "linear, two nearest", "one or two materials", "linear", fit_linear, lambda B: 3),
        Setting(PUBLISHED, AS_PUBLISHED, AS_PUBLISHED, PUBLISHED, fit_published, lambda B: 2, is_dense=True),
        *(_pca(mapping, k) for mapping in _MAPPINGS for k in (2, 4, 6, 8)),
        *(_gplvm(mapping, Q) for mapping in _MAPPINGS for Q in (2, 4, 6)),
        *(_monochrome(Q, _SAMPLES) for Q in (1, 2, 3)),
        *(_monochrome(2, count) for count in (SAMPLE_BANDS,) if count < n_bands),
        blend,
        _blend(3),
        *nonnegative,
        *(_sparse(pca, threshold) for threshold in _THRESHOLDS),
        *(_stored(gplvm, storage_forms.few_bands(r)) for r in _FEW_BANDS if r < n_bands),
        *(
            _stored(setting, storage_forms.half())
            for setting in (pca, gplvm, monochrome, blend, nonnegative[0])
        ),
        *(
            _stored(gplvm, storage_forms.few_angles(outgoing=o, incident=i))
            for o, i in ((2, 1), (1, 2), (2, 2), (4, 1))
        ),
        *(
            _stored(setting, storage_forms.few_angles(outgoing=o, incident=i))
            for setting in (monochrome, blend, nonnegative[0])
            for o, i in _COARSE
        ),
    ]


def _pca(mapping: str, k: int) -> Setting:
    key = f"pca_{k}_{mapping}"
    return Setting(key, f"PCA {k}, {mapping}", "PCA", key, fit_pca(mapping, k), lambda B: k)


def _gplvm(mapping: str, Q: int) -> Setting:
    key, prior = f"gplvm_{Q}_{mapping}", 0.0 if Q == 2 else 0.1
    fit = fit_settings(Settings("material", Q, mapping, optimizer="l-bfgs", prior=prior, criterion="decoded"))
    return Setting(key, f"GPLVM {Q}, {mapping}", "GPLVM, whole materials", key, fit, lambda B: Q)


def _monochrome(Q: int, bands: int) -> Setting:
    key = f"monochrome_{Q}_1_{bands}"
    title = f"monochrome {Q}+1" + ("" if bands == _SAMPLES else f", {bands} bands")
    fit = fit_settings(Settings("monochrome", Q, sample_bands=bands, criterion="decoded"))
    return Setting(key, title, "GPLVM, monochrome samples", key, fit, lambda B: Q + B, sample_bands=bands)


def _blend(Q: int) -> Setting:
    fit = fit_settings(Settings("blend", Q))
    return Setting(
        f"blend_{Q}", f"blend {Q}+2", BLENDS, f"blend_{Q}", fit, lambda B: Q + 2 * B,
        sample_bands=SAMPLE_BANDS,
    )  # fmt: skip


def _nonnegative() -> list[Setting]:
    return [
        Setting(
            "nonnegative", "non-negative", NONNEGATIVE, "nonnegative", fit_nonnegative(_SAMPLES),
            lambda B: NUMBERS_PER_BAND * B, sample_bands=_SAMPLES,
        ),
        Setting(
            "nonnegative_pair", "two samples + Lambertian", NONNEGATIVE, "nonnegative_pair",
            fit_nonnegative_pair(_SAMPLES), lambda B: 3 + 2 * B, sample_bands=_SAMPLES,
        ),
    ]  # fmt: skip


def _sparse(base: Setting, threshold: float) -> Setting:
    title = f"{base.title.split(',')[0]}, weights > {100 * threshold:g} %"
    return _changed(base, f"over_{threshold:g}", title, threshold=threshold)


def _stored(base: Setting, storage: Storage) -> Setting:
    return _changed(base, storage.key, f"{base.title.split(',')[0]}, {storage.title}", storage=storage)


def _changed(
    base: Setting, suffix: str, title: str, *, storage: Storage = _WHOLE, threshold: float = 0.0
) -> Setting:
    return Setting(
        f"{base.key}_{suffix}", title, base.family, base.method, base.fit, base.numbers, base.sample_bands,
        storage, threshold,
    )  # fmt: skip
