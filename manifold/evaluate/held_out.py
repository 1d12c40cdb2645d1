"""Measures the errors and costs of settings by cross-validation."""

from __future__ import annotations

import itertools
import operator
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from manifold.brdf.interface import all_isotropic
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured_cells import fill_unmeasured
from manifold.core import metrics
from manifold.core.metrics import Errors
from manifold.core.pairs import Pairs, RusinkiewiczGrid
from manifold.core.records import Array, BsdfFile, evenly_spaced
from manifold.evaluate import storage_forms
from manifold.evaluate.coherences import measure_map
from manifold.evaluate.cross_validation import BYTES_PER_NUMBER, Fit, Method, cross_validate, leave_out
from manifold.evaluate.errors import MethodErrors
from manifold.evaluate.method_data import Data, band_shares
from manifold.evaluate.stopwatch import RelativeTime, Stopwatch, some_pairs
from manifold.evaluate.storage_forms import Storage
from manifold.model.coherence import Coherence
from manifold.model.combination import Combination, Values, evaluate
from manifold.model.materials import MaterialTable
from manifold.model.prediction import PredictedBRDF
from manifold.model.settings import LEARNT_BANDS

FOLDS = 10
_TIMED, _REPEATS = 3, 5
_BLOCK_PAIRS = 512
_DENSE_PAIRS = RusinkiewiczGrid.named("hikichi").n_pairs
_STREAMED_BYTES = 1 << 26  # far more than caches hold
_AT_ONCE = 8  # predictions evaluated together

_Fitted = tuple[list[Combination], RelativeTime, tuple[str, ...]]


@dataclass(frozen=True, kw_only=True)
class ChartRow(MethodErrors):
    """The results of one setting; errors are measured in some of the bands.

    Attributes: those of `MethodErrors`, and
        family: family of methods, as in `Method`.
        fit: time to learn from the library, including tabulation of its materials; for methods that are fitted to
            single materials, time of all fits. None if it was not measured.
        predict: time to predict a whole material, at all direction pairs at which it is stored.
        bytes: size of the data that predictions read: files, and the parameters of all materials.
        warnings: warnings of the fits, once per fold.
        coherence: coherence of the map of all materials; None for methods without a map, and if all materials look
            alike.
    """

    family: str
    fit: RelativeTime | None
    predict: RelativeTime
    bytes: int
    warnings: tuple[str, ...] = ()
    coherence: Coherence | None = None


class HeldOut:
    """Measures settings one after the other; shared tables and fits are made once.

    Attributes:
        data: values of the materials on a grid, in some bands.
        pairs, balls: the grid's direction pairs, and the materials' rendered balls.
        watch: stopwatch for relative times.
        folds: number of folds of the cross-validation.
        scaled: texts about quantities that were measured in part and scaled to the whole.
    """

    def __init__(self, files: Sequence[BsdfFile], grid: RusinkiewiczGrid, chosen: Sequence[Method]) -> None:
        """Tabulate N files at the direction pairs of a grid, in the bands that the chosen settings need."""
        self._files, self.watch = [fill_unmeasured(file) for file in files], Stopwatch()
        self.folds = min(FOLDS, len(files))
        n_bands = files[0].bands.count
        bands = evenly_spaced(n_bands, LEARNT_BANDS)
        for count in {s.sample_bands for s in chosen} - {None}:
            bands = np.union1d(bands, evenly_spaced(n_bands, int(count or 0)))
        materials = [MeasuredBRDF(file) for file in self._files]
        grid = grid.suited_to(all_isotropic(materials))
        tabulate = partial(Data.evaluate, materials, grid, bands)
        self.data = tabulate()
        self._tabulating = [self.watch.lap(tabulate)[1] for _ in range(_REPEATS)]
        self._n_pairs, self._shares = grid.n_pairs, band_shares(bands, n_bands)
        self.pairs, self.balls = grid.pairs(), MaterialTable(materials, bands)
        self._block = some_pairs(_BLOCK_PAIRS, grid)
        # Settings that differ only in how files are stored, or in their threshold, share a fit.
        self._fits: dict[Fit, _Fitted] = {}
        self._coherences: dict[Fit, Coherence | None] = {}
        self._stored: StoredMaterials | None = None
        once = [
            self.watch.laps(partial(material.eval_at, self._block), _REPEATS)
            for material in materials[:: max(len(files) // _TIMED, 1)]
        ]
        self._resampling = RelativeTime.of_several(once).median * _DENSE_PAIRS / _BLOCK_PAIRS * len(files)
        self.scaled = {
            "timed_pairs": _BLOCK_PAIRS, "dense_pairs": _DENSE_PAIRS, "resampling": self._resampling,
            "tabulating": RelativeTime.of(self._tabulating).median,
        }  # fmt: skip

    def measure(self, setting: Method) -> ChartRow:
        """Measure errors of all materials, each left out once, and costs."""
        combinations, fit, warned = self._fitted(setting.fit)
        if setting.is_dense:
            fit = RelativeTime(fit.median - self.scaled["tabulating"] + self._resampling, fit.spread)
        combinations = [without_small_weights(c, setting.threshold) for c in combinations]
        if self._stored is None or self._stored.storage.key != setting.storage.key:
            self._stored = None  # one at a time is in memory
            self._stored = StoredMaterials(setting.storage, self._files, self)
        stored = self._stored
        scale = (_DENSE_PAIRS if setting.is_dense else stored.cells) / _BLOCK_PAIRS
        predict = [
            scale * self.watch.laps(_predictor(stored, c, self._block, is_dense=setting.is_dense), _REPEATS)
            for c in combinations[:: max(len(combinations) // _TIMED, 1)]
        ]
        return ChartRow(
            key=setting.key, title=setting.title, family=setting.family,
            errors=stored.errors(combinations), fit=fit, predict=RelativeTime.of_several(predict),
            bytes=self._bytes(setting, stored), warnings=warned, coherence=self._coherence(setting),
        )  # fmt: skip

    def errors(self, i: int, f: Array, f_ball: Array) -> Errors[float]:
        """Return the errors of predicted values of material i on the grid, (P, B'), and the ball, (P_ball, B')."""
        data = self.data
        wide = np.sqrt(self._shares)  # each band stands for those around it
        rmse = metrics.rmse(wide * data.f[i], wide * f, n_pairs=self._n_pairs)
        of_values = Errors.of_values(data.f[i], f, data.cosines)
        return replace(self.balls.look(i, f_ball) | of_values, rmse=rmse)

    def _fitted(self, fit: Fit) -> _Fitted:
        """Return predictions of all materials by fits without them, the time of a fit, and the fits' warnings."""
        if fit not in self._fits:
            warned: list[str] = []

            def lap(work: Callable[[], Any]) -> tuple[Any, float]:
                with warnings.catch_warnings(record=True) as caught:
                    warnings.simplefilter("always", UserWarning)
                    result = self.watch.lap(work)
                warned.extend(str(warning.message) for warning in caught[:1])
                return result

            splits = leave_out(self.data.n_materials, self.folds)
            encoded = cross_validate(self.data, fit, splits, lap=lap, own_tables=_REPEATS)
            times = list(map(operator.add, self._tabulating, encoded.fit_times))  # ends with the shorter
            self._fits[fit] = list(encoded.combinations), RelativeTime.of(times), tuple(warned)
        return self._fits[fit]

    def _coherence(self, setting: Method) -> Coherence | None:
        """Return the coherence of a setting's map; settings that share a fit share it."""
        if setting.map is None:
            return None
        if setting.fit not in self._coherences:
            with warnings.catch_warnings():  # fits without some materials told them
                warnings.simplefilter("ignore", UserWarning)
                self._coherences[setting.fit] = measure_map(*setting.map(self.data), self.balls)[0]
        return self._coherences[setting.fit]

    def _bytes(self, setting: Method, stored: StoredMaterials) -> int:
        B, N = self.data.n_bands, len(self._files)
        numbers = BYTES_PER_NUMBER * setting.numbers(B) * N
        if setting.is_dense:
            return N * _DENSE_PAIRS * B * 4 + numbers
        return stored.file_bytes(min(setting.sample_bands or B, B) / B) + numbers


class StoredMaterials:
    """Materials in a form of storage, and their values where errors are measured.

    Attributes:
        brdfs: the materials, in all stored bands.
        cells: median number of direction pairs of a file.
        back: matrix (B, r) from the stored bands to all bands; None if all are stored.
    """

    def __init__(self, storage: Storage, files: Sequence[BsdfFile], held: HeldOut) -> None:
        """Reduce files, and evaluate them where their errors are measured."""
        self._files = [storage.reduce(file) for file in files]
        self.storage, self._held = storage, held
        self.brdfs = [MeasuredBRDF(file) for file in self._files]
        self.cells = float(np.median([file.luminance.size for file in self._files]))
        sampled, self.back = self.brdfs, None
        if storage.bands is None:
            sampled = [brdf.select_bands(held.data.bands.tolist()) for brdf in self.brdfs]
        else:
            self.back = storage_forms.interpolation(files[0].bands, storage.bands)
        self._at = [Values.at(sampled, pairs) for pairs in (held.pairs, held.balls.lights)]

    def file_bytes(self, band_share: float) -> int:
        """Return the bytes of all files that predictions read, with values in a share of the bands."""
        return sum(self.storage.file_bytes(file, band_share) for file in self._files)

    def errors(self, combinations: Sequence[Combination]) -> Errors[Array]:
        """Return errors of a prediction per material, as `HeldOut.errors` defines them."""
        rows, bands = [], self._held.data.bands
        here = combinations if self.back is not None else [c.in_bands(bands) for c in combinations]
        for first in range(0, len(here), _AT_ONCE):
            both = [evaluate(here[first : first + _AT_ONCE], values) for values in self._at]
            if self.back is not None:
                both = [f @ self.back[bands].T for f in both]
            rows += [self._held.errors(first + k, *each) for k, each in enumerate(zip(*both, strict=True))]
        return Errors.of_several(rows)


def _predictor(
    stored: StoredMaterials, combination: Combination, block: Pairs, *, is_dense: bool
) -> Callable[[], object]:
    """Return a function that predicts values at the direction pairs of a block, in all bands, as the package does."""
    if is_dense:
        # Tabulated values, streamed from memory like those of the whole table.
        f = np.stack([m.eval_at(block) for m in stored.brdfs])  # [N, P, B]
        copies = max(_STREAMED_BYTES // (4 * f.size), 1)
        tables = np.repeat(f.astype(np.float32)[None], copies, axis=0)
        turn, share = itertools.count(), combination.weights.astype(np.float32)
        return lambda: np.tensordot(share, tables[next(turn) % copies], axes=1)
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


def without_small_weights(combination: Combination, threshold: float) -> Combination:
    """Set weights below a share of the largest to 0, and scale the others to the same sum."""
    if threshold <= 0.0:
        return combination
    w = combination.weights
    stored = np.where(np.abs(w) >= threshold * np.abs(w).max(), w, 0.0)
    scale = w.sum() / stored.sum() if stored.sum() > 0.5 * abs(w.sum()) else 1.0
    return replace(combination, weights=stored * scale)
