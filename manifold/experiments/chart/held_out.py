"""Settings measured by cross-validation: held-out errors and costs."""

from __future__ import annotations

import itertools
import operator
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from manifold.brdf.measured import MeasuredBRDF, all_isotropic
from manifold.brdf.pairs import DirectionPairs
from manifold.brdf.unmeasured import fill_unmeasured
from manifold.experiments.chart import instruments
from manifold.experiments.chart.instruments import (
    Measurement,
    RelativeTime,
    Stopwatch,
    StoredMaterials,
    Target,
)
from manifold.experiments.chart.registry import Setting
from manifold.experiments.chart.storage_forms import Storage
from manifold.experiments.evaluation.cross_validation import cross_validate, leave_out
from manifold.experiments.evaluation.tabulated import MAX_BANDS, Data
from manifold.metrics import RusinkiewiczGrid
from manifold.model.combination import Combination
from manifold.model.prediction import PredictedBRDF
from manifold.records import Array, BsdfFile, evenly_spaced

_FOLDS = 10
_TIMED, _REPEATS = 3, 5
_BLOCK_PAIRS = 512
_DENSE_PAIRS = RusinkiewiczGrid.named("hikichi").n_pairs
_BYTES_PER_NUMBER = 8
_STREAMED_BYTES = 1 << 26  # far more than caches hold

_Fitted = tuple[list[Combination], RelativeTime, tuple[str, ...]]


class HeldOut:
    """Measures settings one after the other; what they share, tables and fits, is made once.

    Attributes:
        target: what predictions are compared with.
        watch: what times are measured by.
        folds: of the cross-validation.
        scaled: what was measured in part, and how it was scaled to the whole.
    """

    def __init__(self, files: Sequence[BsdfFile], grid: RusinkiewiczGrid, chosen: Sequence[Setting]) -> None:
        """Tabulate N files at the direction pairs of a grid, in the bands that the chosen settings need."""
        files = [fill_unmeasured(file) for file in files]
        self._files, self.watch = files, Stopwatch()
        self.folds = min(_FOLDS, len(files))
        n_bands = files[0].bands.count
        bands = evenly_spaced(n_bands, MAX_BANDS)
        for count in {s.sample_bands for s in chosen} - {None}:
            bands = np.union1d(bands, evenly_spaced(n_bands, int(count or 0)))
        materials = [MeasuredBRDF(file) for file in files]
        grid = grid.suited_to(all_isotropic(materials))
        tabulate = partial(Data.evaluate, materials, grid, bands)
        self._data = tabulate()
        self._tabulating = [self.watch.lap(tabulate)[1] for _ in range(_REPEATS)]
        wi, wo, above = grid.directions()
        self.target = Target(self._data, materials, DirectionPairs(wi[above], wo[above]))
        self._block = instruments.some_pairs(_BLOCK_PAIRS, grid)
        self._fits: dict[str, _Fitted] = {}
        self._stored: tuple[Storage, StoredMaterials] | None = None
        once = [
            self.watch.laps(partial(material.eval_at, self._block), _REPEATS)
            for material in materials[:: max(len(files) // _TIMED, 1)]
        ]
        self._resampling = RelativeTime.of_several(once).median * _DENSE_PAIRS / _BLOCK_PAIRS * len(files)
        self.scaled = {
            "timed_pairs": _BLOCK_PAIRS, "dense_pairs": _DENSE_PAIRS, "resampling": self._resampling,
            "tabulating": RelativeTime.of(self._tabulating).median,
        }  # fmt: skip

    def measure(self, setting: Setting) -> Measurement:
        """Errors of all materials, each left out once, and costs."""
        combinations, fit, warned = self._fitted(setting)
        if setting.is_dense:
            fit = RelativeTime(fit.median - self.scaled["tabulating"] + self._resampling, fit.spread)
        combinations = [without_small_weights(c, setting.threshold) for c in combinations]
        stored = self._stored_as(setting.storage)
        errors = instruments.summary(self.target.errors_of(stored, combinations))
        scale = (_DENSE_PAIRS if setting.is_dense else stored.cells) / _BLOCK_PAIRS
        predict = [
            scale * self.watch.laps(_predictor(stored, c, self._block, is_dense=setting.is_dense), _REPEATS)
            for c in combinations[:: max(len(combinations) // _TIMED, 1)]
        ]
        return Measurement(
            **errors,
            fit=fit,
            predict=RelativeTime.of_several(predict),
            bytes=self._bytes(setting, stored),
            warnings=warned,
        )

    def _fitted(self, setting: Setting) -> _Fitted:
        """A prediction of every material by a fit without it, the time of a fit, and what fits warned of."""
        if setting.method not in self._fits:
            warned: list[str] = []

            def lap(fit: Callable[[], Any]) -> tuple[Any, float]:
                with warnings.catch_warnings(record=True) as caught:
                    warnings.simplefilter("always", UserWarning)
                    result = self.watch.lap(fit)
                warned.extend(str(warning.message) for warning in caught[:1])
                return result

            splits = leave_out(self._data.n_materials, self.folds)
            encoded = cross_validate(self._data, setting.fit, splits, lap=lap, own_tables=_REPEATS)
            times = list(map(operator.add, self._tabulating, encoded.fit_times))  # as many as both have
            self._fits[setting.method] = list(encoded.combinations), RelativeTime.of(times), tuple(warned)
        return self._fits[setting.method]

    def _stored_as(self, storage: Storage) -> StoredMaterials:
        if self._stored is None or self._stored[0].key != storage.key:
            self._stored = None
            self._stored = storage, StoredMaterials(storage, self._files, self.target)
        return self._stored[1]

    def _bytes(self, setting: Setting, stored: StoredMaterials) -> int:
        B, N = self._data.n_bands, len(self._files)
        numbers = _BYTES_PER_NUMBER * setting.numbers(B) * N
        if setting.is_dense:
            return N * _DENSE_PAIRS * B * 4 + numbers
        return stored.file_bytes(min(setting.sample_bands or B, B) / B) + numbers


def _predictor(
    stored: StoredMaterials, combination: Combination, block: DirectionPairs, *, is_dense: bool
) -> Callable[[], object]:
    """A function that predicts values at the direction pairs of a block, in all bands, as the package does."""
    if is_dense:
        return _from_table(np.stack([m.eval_at(block) for m in stored.brdfs]), combination.weights)
    if combination.sample_bands is not None:
        bands = combination.sample_bands.tolist()
        samples = [m.select_bands(bands) for m in stored.brdfs]
        curve = PredictedBRDF(samples, combination, stored.brdfs[0].bands)
        return lambda: curve.eval(block.wi, block.wo)
    whole = PredictedBRDF(stored.brdfs, combination)
    if stored.back is not None:
        back = stored.back.T
        return lambda: whole.eval(block.wi, block.wo) @ back
    return lambda: whole.eval(block.wi, block.wo)


def _from_table(f: Array, weights: Array) -> Callable[[], object]:
    """Sums of tabulated values (N, P, B), streamed from memory as those of the whole table are."""
    copies = max(_STREAMED_BYTES // (4 * f.size), 1)
    tables = np.repeat(f.astype(np.float32)[None], copies, axis=0)
    turn = itertools.count()
    share = weights.astype(np.float32)
    return lambda: np.tensordot(share, tables[next(turn) % copies], axes=1)


def without_small_weights(combination: Combination, threshold: float) -> Combination:
    """Weights below a share of the largest set to 0; the others scaled to the same sum."""
    if threshold <= 0.0:
        return combination
    w = combination.weights
    stored = np.where(np.abs(w) >= threshold * np.abs(w).max(), w, 0.0)
    scale = w.sum() / stored.sum() if stored.sum() > 0.5 * abs(w.sum()) else 1.0
    return replace(combination, weights=stored * scale)
