"""Lists the methods that predict a material from others: baselines, and the models of this package.

A new method of reports, or a new setting of charts, needs one more entry here.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from manifold.evaluate import storage_forms
from manifold.evaluate.baselines import (
    NUMBERS_PER_BAND,
    few_numbers,
    fit_linear,
    fit_nearest,
    fit_nonnegative,
    fit_oracle,
    fit_pca,
    principal_components,
)
from manifold.evaluate.cross_validation import Method
from manifold.evaluate.latent_models import AFTER_PUBLISHED as AFTER_PUBLISHED_SETTINGS
from manifold.evaluate.latent_models import fit_after_published, fit_map, fit_settings
from manifold.evaluate.storage_forms import Storage
from manifold.model.settings import SAMPLE_BANDS, BlendSettings, GplvmSettings, Settings

PUBLISHED = "published"
AFTER_PUBLISHED = "after Hikichi & Iwasaki"
NONNEGATIVE = "samples and lobes, weights >= 0"
BLENDS = "blends, the default"
_FEW = "one or two materials"
_FAMILIES = {"blend": BLENDS, "gplvm": "GPLVM, whole materials"}
_SAMPLES = 3  # bands per material that are samples in charts, where nothing else is said
_COARSE = ((2, 1), (2, 2), (4, 1))  # one in so many outgoing rows and columns, and incidences, is kept


# -- reports -----------------------------------------------------------------------------------------------


def standard_methods() -> list[Method]:
    """Return methods that need no fitted model: baselines first, the setting of Hikichi & Iwasaki, then models."""
    return [*baseline_methods(), *gplvm_methods()]


def baseline_methods() -> list[Method]:
    """Return the baselines of the models of this package."""
    return [
        Method("nearest", "nearest material", lambda B: 1, fit_nearest),
        Method("linear", "linear, two nearest", lambda B: 3, fit_linear),
        Method("oracle", "best mix of two (oracle)", lambda B: 3, fit_oracle),
        _pca("pca_6_identity", "PCA 6, identity", "identity", 6),
        _pca("pca_6_cube_root", "PCA 6, cube root", "cube-root", 6),
        _pca("pca_6_log_relative", "PCA 6, log-relative", "log-relative", 6),
        Method(PUBLISHED, AFTER_PUBLISHED, lambda B: 2, fit_after_published, fits_model=True),
        _nonnegative("non-negative least squares", SAMPLE_BANDS),
    ]


def gplvm_methods() -> list[Method]:
    """Return the models of this package with the settings `STANDARD`."""
    titles = {
        "gplvm_2": "GPLVM 2, cube root", "gplvm_6": "GPLVM 6, cube root",
        "blend_2": "blend 2 + 2 per band", "blend_3": "blend 3 + 2 per band",
    }  # fmt: skip
    models = {key: _model(key, title, STANDARD[key]) for key, title in titles.items()}
    blends = [models.pop("blend_2"), models.pop("blend_3")]
    return [*models.values(), _few_atoms(SAMPLE_BANDS), *blends]


def _gplvm(latent_dim: int, mapping: str = "cube-root") -> Settings:
    prior = 0.0 if latent_dim == 2 else 0.1
    return GplvmSettings(latent_dim, mapping, optimizer="l-bfgs", prior=prior)


STANDARD = {
    "gplvm_2": _gplvm(2),
    "gplvm_6": _gplvm(6),
    "blend_2": BlendSettings(2),
    "blend_3": BlendSettings(3),
}
"""Settings of the models among the methods, by key."""


def _model(key: str, title: str, s: Settings) -> Method:
    """Return the model of a manifold with these settings: a coordinate per axis, and per band a colour and a gain."""
    Q, per_band = s.latent_dim, 2 if isinstance(s, BlendSettings) else 0
    return Method(
        key, title, lambda B: Q + per_band * B, fit_settings(s), fits_model=True, family=_FAMILIES[s.kind],
        sample_bands=s.sample_bands if isinstance(s, BlendSettings) else None, map=partial(fit_map, s),
    )  # fmt: skip


def _pca(key: str, title: str, mapping: str, count: int) -> Method:
    scores = partial(principal_components, mapping, count)
    return Method(key, title, lambda B: count, fit_pca(mapping, count), family="PCA", map=scores)


def _nonnegative(title: str, sample_bands: int) -> Method:
    return Method(
        "nonnegative", title, lambda B: NUMBERS_PER_BAND * B, fit_nonnegative(sample_bands),
        sample_bands=sample_bands, fits_model=True, family=NONNEGATIVE,
    )  # fmt: skip


def _few_atoms(sample_bands: int) -> Method:
    return Method(
        "few_atoms", "few samples and lobes", few_numbers, fit_nonnegative(sample_bands, few_numbers),
        sample_bands=sample_bands, fits_model=True, family=NONNEGATIVE,
    )  # fmt: skip


# -- charts ------------------------------------------------------------------------------------------------


def chart_methods(n_bands: int) -> list[Method]:
    """Return all settings that a chart compares for materials of `n_bands` bands, simplest first."""
    mappings = ("identity", "cube-root", "log-relative")
    pcas = [_pca(f"pca_{k}_{T}", f"PCA {k}, {T}", T, k) for T in mappings for k in (2, 4, 6, 8)]
    gplvms = [_model(f"gplvm_{Q}_{T}", f"GPLVM {Q}, {T}", _gplvm(Q, T)) for T in mappings for Q in (2, 4, 6)]
    blends = [_model(f"blend_{Q}", f"blend {Q}+2", BlendSettings(Q)) for Q in (2, 3)]
    by_key = {setting.key: setting for setting in (*pcas, *gplvms)}
    pca, gplvm = by_key["pca_6_cube-root"], by_key["gplvm_6_cube-root"]
    nonnegative = _nonnegative("non-negative", _SAMPLES)
    few_bands = [storage_forms.few_bands(r) for r in (3, 6, 12) if r < n_bands]
    angles = [storage_forms.few_angles(outgoing=o, incident=i) for o, i in ((2, 1), (1, 2), (2, 2), (4, 1))]
    coarse = [storage_forms.few_angles(outgoing=o, incident=i) for o, i in _COARSE]
    return [
        Method("nearest", "nearest", lambda B: 1, fit_nearest, family=_FEW),
        Method("linear", "linear, two nearest", lambda B: 3, fit_linear, family=_FEW),
        Method(
            PUBLISHED,
            AFTER_PUBLISHED,
            lambda B: 2,
            fit_after_published,
            family=AFTER_PUBLISHED,
            is_dense=True,
            map=partial(fit_map, AFTER_PUBLISHED_SETTINGS),
        ),
        *pcas,
        *gplvms,
        *blends,
        nonnegative,
        _few_atoms(_SAMPLES),
        *(_sparse(pca, threshold) for threshold in (0.03, 0.1)),
        *(_stored(gplvm, storage) for storage in few_bands),
        *(_stored(setting, storage_forms.half()) for setting in (pca, gplvm, blends[0], nonnegative)),
        *(_stored(setting, storage_forms.compact()) for setting in (blends[0], nonnegative)),
        *(_stored(gplvm, storage) for storage in angles),
        *(_stored(s, storage) for s in (blends[0], nonnegative) for storage in coarse),
    ]


def _sparse(base: Method, threshold: float) -> Method:
    title = f"{base.title.split(',')[0]}, weights > {100 * threshold:g} %"
    return replace(base, key=f"{base.key}_over_{threshold:g}", title=title, threshold=threshold)


def _stored(base: Method, storage: Storage) -> Method:
    title = f"{base.title.split(',')[0]}, {storage.title}"
    return replace(base, key=f"{base.key}_{storage.key}", title=title, storage=storage)
