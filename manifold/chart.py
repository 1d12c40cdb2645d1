"""Speed against accuracy: every setting of the registry on one library, by cross-validation, in one run."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from manifold import __version__, chart_bench, chart_fits, pareto
from manifold.brdf import MeasuredBRDF
from manifold.chart_bench import REFERENCE, REFERENCE_PAIRS, Kept, Stopwatch, Target, Timed
from manifold.chart_settings import Setting, settings
from manifold.chart_storage import Storage
from manifold.combination import Combination
from manifold.errors import UsageError
from manifold.metrics import RusinkiewiczGrid
from manifold.model import evenly_spaced
from manifold.pairs import DirectionPairs
from manifold.prediction import MonochromePrediction, PredictedBRDF
from manifold.records import Array, BsdfFile
from manifold.tabulated import MAX_BANDS, Data

Progress = Callable[[int, int, str], None]

ERRORS = {"rmse": "RMSE of eq. 22", "delta_e": "CIEDE2000 of the ball", "relative_error": "relative error"}
COSTS = {"predict": "time to predict", "bytes": "bytes", "fit": "time to fit"}

_FOLDS = 10
_TIMED, _REPEATS = 3, 5
_BLOCK_PAIRS = 512
_DENSE_PAIRS = RusinkiewiczGrid.named("seed").n_pairs
_BYTES_PER_NUMBER = 8
_STREAMED_BYTES = 1 << 26  # far more than caches hold
_ALIKE = 0.01  # errors and bytes that differ by less do not push each other off a front


@dataclass(frozen=True)
class Charted:
    """One setting, measured.

    Attributes:
        key, title, family: of the setting.
        is_held_out: False where a material is represented by a fit to itself.
        relative_error, rmse, delta_e: medians over materials; see `chart_bench.Target`.
        fit: time to learn from the library, tabulating its materials included; of fits, all of them.
        predict: time to predict a whole material, at all direction pairs that it is kept at.
        bytes: of what predictions read: files, and the numbers of all materials.
    """

    key: str
    title: str
    family: str
    is_held_out: bool
    relative_error: float
    rmse: float
    delta_e: float
    fit: Timed
    predict: Timed
    bytes: int


@dataclass(frozen=True)
class Chart:
    """All settings, measured in one run.

    Attributes:
        charted: setting by setting; held-out ones first.
        fronts: by error, then by cost, the keys of held-out settings that no other beats, cheapest first.
        n_materials, n_bands, folds: of the cross-validation.
        reference_seconds: median processor time of the reference, in which all times are.
        scaled: what was measured in part, and how it was scaled to the whole.
        skipped: settings that this machine cannot run, and why.
    """

    charted: tuple[Charted, ...]
    fronts: dict[str, dict[str, list[str]]]
    n_materials: int
    n_bands: int
    folds: int
    reference_seconds: float
    scaled: dict[str, float]
    skipped: dict[str, str]

    def to_json(self) -> dict[str, Any]:
        """The chart as plain values, with the program's version."""
        reference = f"{REFERENCE}, 195 bands, {REFERENCE_PAIRS} direction pairs, one core"
        return {"program": f"manifold {__version__}", "reference": reference, **asdict(self)}

    def front(self, error: str, cost: str) -> list[Charted]:
        """The settings on a front, cheapest first."""
        by_key = {row.key: row for row in self.charted}
        return [by_key[key] for key in self.fronts[error][cost]]


def cost_of(row: Charted, cost: str) -> float:
    """A cost, one of `COSTS`: reference times, or bytes."""
    value = getattr(row, cost)
    return value.median if isinstance(value, Timed) else float(value)


def make_chart(
    files: Sequence[BsdfFile],
    only: Sequence[str] = (),
    on_progress: Progress | None = None,
    grid: RusinkiewiczGrid | None = None,
    fitted: int = 3,
) -> Chart:
    """Measure settings on materials, left out in at most ten folds.

    Args:
        files: at least four, of the same bands.
        only: keys of settings; all by default.
        on_progress: called with (done, total, title).
        grid: direction pairs of the errors; by default 45 x 23 x 12.
        fitted: how many materials the fits of `chart_fits` represent.
    Raises:
        UsageError: a key is unknown, or there are fewer than four materials.
    """
    if len(files) < 4:
        raise UsageError(f"{len(files)} materials, expected at least 4 to leave some out; import more files")
    known: dict[str, Setting | str] = {s.key: s for s in settings(files[0].bands.count)}
    known |= {f"fit_{method}": method for method in chart_fits.METHODS}
    unknown = [key for key in only if key not in known]
    if unknown:
        raise UsageError(f"no setting is called {unknown[0]!r}, expected one of {', '.join(known)}")
    chosen = [known[key] for key in only or known]
    held_out = [s for s in chosen if isinstance(s, Setting)]
    rows: dict[str, Charted] = {}
    skipped: dict[str, str] = {}
    with chart_bench.one_core():
        bench = _Bench(files, RusinkiewiczGrid.named("default") if grid is None else grid, held_out)
        # Settings that keep files alike stand together: only one set of kept files is in memory.
        in_order = sorted(held_out, key=lambda s: s.storage.key)
        for setting in in_order:
            rows[setting.key] = bench.measure(setting)
            if on_progress is not None:
                on_progress(len(rows), len(chosen), setting.title)
    for method in (s for s in chosen if isinstance(s, str)):
        try:
            found = chart_fits.measure(method, files, fitted, bench.target, bench.watch)
        except UsageError as error:
            skipped[f"fit_{method}"] = str(error)
            continue
        rows[f"fit_{method}"] = Charted(
            f"fit_{method}", f"fit, {chart_fits.METHODS[method]}", "fit of the seen material", False, *found
        )
        if on_progress is not None:
            on_progress(len(rows), len(chosen), rows[f"fit_{method}"].title)
    charted = tuple(rows[key] for key in known if key in rows)
    return Chart(
        charted, fronts(charted), len(files), files[0].bands.count, bench.folds,
        bench.watch.reference_seconds, bench.scaled, skipped,
    )  # fmt: skip


def fronts(rows: Sequence[Charted]) -> dict[str, dict[str, list[str]]]:
    """Keys of the held-out settings on each front of an error and a cost, cheapest first.

    Neither errors and bytes that differ by 1 %, nor times that differ by less than their spreads, count as different.
    """
    rows = [row for row in rows if row.is_held_out]
    return {error: {cost: _front(rows, error, cost) for cost in COSTS} for error in ERRORS}


def _front(rows: Sequence[Charted], error: str, cost: str) -> list[str]:
    if not rows:
        return []
    values = np.array([[getattr(row, error), cost_of(row, cost)] for row in rows])
    tolerance = 0.5 * _ALIKE * values
    if cost != "bytes":
        tolerance[:, 1] = np.maximum(tolerance[:, 1], [0.5 * getattr(row, cost).spread for row in rows])
    on = np.flatnonzero(pareto.front(values, tolerance)).tolist()
    return [rows[k].key for k in sorted(on, key=lambda k: values[k, 1])]


class _Bench:
    def __init__(self, files: Sequence[BsdfFile], grid: RusinkiewiczGrid, chosen: Sequence[Setting]) -> None:
        self.files, self.watch = files, Stopwatch()
        self.folds = min(_FOLDS, len(files))
        n_bands = files[0].bands.count
        bands = evenly_spaced(n_bands, MAX_BANDS)
        for count in {s.sample_bands for s in chosen} - {None}:
            bands = np.union1d(bands, evenly_spaced(n_bands, int(count or 0)))
        materials = [MeasuredBRDF(file) for file in files]
        self.data, self.tabulating = self.watch.lap(partial(Data.evaluate, materials, grid, bands))
        wi, wo, above = grid.directions()
        self.target = Target(self.data, materials, DirectionPairs(wi[above], wo[above]))
        self.block = chart_bench.some_pairs(_BLOCK_PAIRS, grid)
        self._fits: dict[str, tuple[list[Combination], Timed]] = {}
        self._kept: tuple[Storage, Kept] | None = None
        once = [
            self.watch.laps(partial(chart_bench.evaluated, material, self.block), _REPEATS)
            for material in materials[:: max(len(files) // _TIMED, 1)]
        ]
        self.resampling = Timed.of_several(once).median * _DENSE_PAIRS / _BLOCK_PAIRS * len(files)
        self.scaled = {
            "timed_pairs": _BLOCK_PAIRS, "dense_pairs": _DENSE_PAIRS, "resampling": self.resampling,
            "tabulating": self.tabulating,
        }  # fmt: skip

    def measure(self, setting: Setting) -> Charted:
        combinations, fit = self._fitted(setting)
        if setting.is_dense:
            fit = Timed(fit.median - self.tabulating + self.resampling, fit.spread)
        combinations = [_sparse(c, setting.threshold) for c in combinations]
        kept = self._kept_as(setting.storage)
        relative, rmse, delta_e = np.median(self.target.errors_of(kept, combinations), axis=0)
        scale = (_DENSE_PAIRS if setting.is_dense else kept.cells) / _BLOCK_PAIRS
        predict = [
            scale * self.watch.laps(_predictor(kept, c, self.block, is_dense=setting.is_dense), _REPEATS)
            for c in combinations[:: max(len(combinations) // _TIMED, 1)]
        ]
        return Charted(
            setting.key, setting.title, setting.family, True, float(relative), float(rmse), float(delta_e),
            fit, Timed.of_several(predict), self._bytes(setting, kept),
        )  # fmt: skip

    def _fitted(self, setting: Setting) -> tuple[list[Combination], Timed]:
        """A prediction of every material by a fit without it, and the time of a fit."""
        if setting.method not in self._fits:
            everything = np.arange(self.data.n_materials)
            found: dict[int, Combination] = {}
            times = []
            for fold in range(self.folds):
                if fold < _REPEATS:
                    data = self._unmapped()
                out = everything[fold :: self.folds]
                encode, ratio = self.watch.lap(partial(setting.fit, data, np.setdiff1d(everything, out)))
                found |= {int(i): encode(int(i)) for i in out}
                if fold < _REPEATS:
                    times.append(self.tabulating + ratio)
            self._fits[setting.method] = [found[int(i)] for i in everything], Timed.of(times)
        return self._fits[setting.method]

    def _unmapped(self) -> Data:
        """The data without what methods share, values in a mapped domain and their products: each pays for its own."""
        data = self.data
        return Data(data.f, data.cosines, data.bands, data.n_bands, data.full_values)

    def _kept_as(self, storage: Storage) -> Kept:
        if self._kept is None or self._kept[0].key != storage.key:
            self._kept = None
            self._kept = storage, Kept(storage, self.files, self.target)
        return self._kept[1]

    def _bytes(self, setting: Setting, kept: Kept) -> int:
        B, N = self.data.n_bands, len(self.files)
        numbers = _BYTES_PER_NUMBER * setting.numbers(B) * N
        if setting.is_dense:
            return N * _DENSE_PAIRS * B * 4 + numbers
        return kept.file_bytes(min(setting.sample_bands or B, B) / B) + numbers


def _predictor(kept: Kept, combination: Combination, block: Any, *, is_dense: bool) -> Callable[[], object]:
    """What predicts values at the direction pairs of a block, in all bands, as the package does."""
    mapping, weights = combination.mapping, combination.weights
    if is_dense:
        return _from_table(np.stack([chart_bench.evaluated(m, block) for m in kept.brdfs]), weights)
    if combination.sample_bands is not None:
        bands = combination.sample_bands.tolist()
        samples = [m.thinned(bands) for m in kept.brdfs]
        curve = MonochromePrediction(samples, weights, mapping, kept.brdfs[0].bands)
        return lambda: curve.eval(block.wi, block.wo)
    whole = PredictedBRDF(kept.brdfs, weights, mapping)
    if kept.back is not None:
        back = kept.back.T
        return lambda: whole.eval(block.wi, block.wo) @ back
    return lambda: whole.eval(block.wi, block.wo)


def _from_table(f: Array, weights: Array) -> Callable[[], object]:
    """Sums of tabulated values (N, P, B), streamed from memory as those of the whole table are."""
    copies = max(_STREAMED_BYTES // (4 * f.size), 1)
    tables = np.repeat(f.astype(np.float32)[None], copies, axis=0)
    turn = itertools.count()
    share = weights.astype(np.float32)
    return lambda: np.tensordot(share, tables[next(turn) % copies], axes=1)


def _sparse(combination: Combination, threshold: float) -> Combination:
    """Small weights dropped; the others scaled to the same sum."""
    if threshold <= 0.0:
        return combination
    w = combination.weights
    kept = np.where(np.abs(w) >= threshold * np.abs(w).max(), w, 0.0)
    scale = w.sum() / kept.sum() if kept.sum() > 0.5 * abs(w.sum()) else 1.0
    return replace(combination, weights=kept * scale)
