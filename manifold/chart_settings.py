"""The settings that a chart of speed against accuracy compares. One registry: a new setting is one more entry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from manifold.methods import (
    SAMPLE_BANDS,
    Fit,
    fit_gplvm,
    fit_linear,
    fit_monochrome,
    fit_nearest,
    fit_pca,
    fit_seed,
)

SEED = "seed"
_MAPPINGS = ("identity", "cube-root", "log-relative")


@dataclass(frozen=True)
class Setting:
    """A method at one choice of its knobs.

    Attributes:
        key: name in JSON.
        title: for people.
        fit: learns from some materials, and encodes any.
        numbers: how many numbers describe a material of B bands.
        sample_bands: measured bands that predictions read, at most; None is all.
        is_half: whether measured values are kept as float16.
        threshold: weights below this share of the largest one are dropped.
        is_dense: whether every material is resampled to the grid of 1,458,000 direction pairs.
    """

    key: str
    title: str
    fit: Fit
    numbers: Callable[[int], int]
    sample_bands: int | None = None
    is_half: bool = False
    threshold: float = 0.0
    is_dense: bool = False


def settings() -> list[Setting]:
    """All settings, simplest first."""
    return [
        Setting("nearest", "nearest", fit_nearest, lambda B: 1),
        Setting("linear", "linear, two nearest", fit_linear, lambda B: 3),
        Setting(SEED, "seed: GPLVM 2, identity, dense grid", fit_seed, lambda B: 2, is_dense=True),
        *(_pca(mapping, k) for mapping in _MAPPINGS for k in (2, 4, 6, 8)),
        *(_whole(mapping, Q) for mapping in _MAPPINGS for Q in (2, 4, 6)),
        *(_monochrome(Q, SAMPLE_BANDS) for Q in (1, 2, 3)),
        _monochrome(2, 3),
        _monochrome(2, 9),
        _variant("pca_6_cube-root", "float16", fit_pca("cube-root", 6), is_half=True),
        _variant("pca_6_cube-root", "weights > 3 %", fit_pca("cube-root", 6), threshold=0.03),
        _variant("pca_6_cube-root", "weights > 10 %", fit_pca("cube-root", 6), threshold=0.1),
    ]


def _pca(mapping: str, k: int) -> Setting:
    return Setting(f"pca_{k}_{mapping}", f"PCA {k}, {mapping}", fit_pca(mapping, k), lambda B: k)


def _whole(mapping: str, Q: int) -> Setting:
    prior = 0.0 if Q == 2 else 0.1
    fit = fit_gplvm(Q, mapping=mapping, prior=prior)
    return Setting(f"gplvm_{Q}_{mapping}", f"GPLVM {Q}, {mapping}", fit, lambda B: Q)


def _monochrome(Q: int, bands: int) -> Setting:
    fit = fit_monochrome(Q, 1, sample_bands=bands)
    title = f"monochrome {Q} + 1, {bands} bands"
    return Setting(f"monochrome_{Q}_1_{bands}", title, fit, lambda B: Q + B, sample_bands=bands)


def _variant(key: str, how: str, fit: Fit, *, is_half: bool = False, threshold: float = 0.0) -> Setting:
    name = "half" if is_half else f"over_{threshold:g}"
    return Setting(f"{key}_{name}", f"PCA 6, {how}", fit, lambda B: 6, is_half=is_half, threshold=threshold)
