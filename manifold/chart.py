"""Speed against accuracy: every setting of the registry on one library, by cross-validation, in one run."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from manifold import __version__, pareto
from manifold.brdf import MeasuredBRDF
from manifold.chart_settings import Setting, settings
from manifold.combination import Combination, Values
from manifold.encoding import EncodingPairs
from manifold.errors import UsageError
from manifold.gplvm import blas_threads
from manifold.metrics import RusinkiewiczGrid
from manifold.model import evenly_spaced
from manifold.pairs import DirectionPairs
from manifold.records import Array
from manifold.tabulated import MAX_BANDS, Data

Progress = Callable[[int, int, str], None]

AXES = ("predict_ratio", "bytes", "fit_ratio")
_FOLDS = 10
_TIMED, _REPEATS = 3, 3
_DENSE_PAIRS = RusinkiewiczGrid.named("seed").n_pairs
_BYTES_PER_NUMBER = 8


@dataclass(frozen=True)
class Charted:
    """One setting, measured.

    Attributes:
        key, title: of the setting.
        relative_error: median over materials left out, cosine-weighted, in the bands that methods learn from.
        rmse: eq. 22 of Hikichi & Iwasaki, median, in 1/sr, these bands standing for all.
        fit_ratio, fit_spread: median and interquartile range of the time of a fit to tabulated values, per reference
            time; for the dense grid with the resampling, scaled from one block.
        predict_ratio, predict_spread: the same of a prediction, the evaluation of its materials included.
        bytes: measured values that predictions read, and the numbers of all materials.
        on_front: the axes, of `AXES`, where no other setting has both less error and less cost.
    """

    key: str
    title: str
    relative_error: float
    rmse: float
    fit_ratio: float
    fit_spread: float
    predict_ratio: float
    predict_spread: float
    bytes: int
    on_front: tuple[str, ...] = ()


@dataclass(frozen=True)
class Chart:
    """All settings, measured in one run.

    Attributes:
        charted: setting by setting.
        n_materials, folds: of the cross-validation.
        reference_seconds: median time of one evaluation of the first material at the timed direction pairs.
    """

    charted: tuple[Charted, ...]
    n_materials: int
    folds: int
    reference_seconds: float

    def to_json(self) -> dict[str, Any]:
        """The chart as plain values, with the program's version."""
        return {"program": f"manifold {__version__}", **asdict(self)}


def make_chart(
    materials: Sequence[MeasuredBRDF],
    only: Sequence[str] = (),
    on_progress: Progress | None = None,
    grid: RusinkiewiczGrid | None = None,
) -> Chart:
    """Measure settings on materials, left out in at most ten folds.

    Args:
        materials: at least four, of the same bands.
        only: keys of settings; all by default.
        on_progress: called with (done, total, title).
        grid: direction pairs of the errors; by default 45 x 23 x 12.
    Raises:
        UsageError: a key is unknown, or there are fewer than four materials.
    """
    known = {s.key: s for s in settings()}
    unknown = [key for key in only if key not in known]
    if unknown:
        raise UsageError(f"no setting is called {unknown[0]!r}, expected one of {', '.join(known)}")
    if len(materials) < 4:
        raise UsageError(
            f"{len(materials)} materials, expected at least 4 to leave some out; import more files"
        )
    chosen = [known[key] for key in only] or list(known.values())
    n_bands = materials[0].bands.count
    bands = evenly_spaced(n_bands, MAX_BANDS)
    for count in {s.sample_bands for s in chosen} - {None}:
        bands = np.union1d(bands, evenly_spaced(n_bands, int(count or 0)))
    grid = RusinkiewiczGrid.named("default") if grid is None else grid
    bench = _Bench(materials, Data.evaluate(materials, grid, bands), EncodingPairs.of_grid(grid))
    rows = []
    for done, setting in enumerate(chosen, start=1):
        rows.append(bench.measure(setting))
        if on_progress is not None:
            on_progress(done, len(chosen), setting.title)
    return Chart(_with_fronts(rows), len(materials), bench.folds, bench.reference)


def _with_fronts(rows: Sequence[Charted]) -> tuple[Charted, ...]:
    on = {a: pareto.front(np.array([[r.relative_error, getattr(r, a)] for r in rows])) for a in AXES}
    return tuple(replace(r, on_front=tuple(a for a in AXES if on[a][i])) for i, r in enumerate(rows))


class _Bench:
    def __init__(self, materials: Sequence[MeasuredBRDF], data: Data, pairs: EncodingPairs) -> None:
        self.data, self.pairs = data, DirectionPairs(pairs.wi, pairs.wo)
        self.cosines = pairs.cosines
        self.whole = materials[0]
        self.thin = [m.thinned(data.bands.tolist()) for m in materials]
        self.folds = min(_FOLDS, len(materials))
        self.n_values = [m._spectra.size for m in materials]
        self.reference = float(np.median(_times(lambda: _evaluated(self.thin[0], self.pairs), 9)))

    def measure(self, setting: Setting) -> Charted:
        data, N = self.data, self.data.n_materials
        predictions: dict[int, Combination] = {}
        fits = []
        resampling = self._resampling_seconds() if setting.is_dense else 0.0
        with blas_threads(0):
            for fold in range(self.folds):
                out = np.arange(fold, N, self.folds)
                start = time.perf_counter()
                encode = setting.fit(data, np.setdiff1d(np.arange(N), out))
                fits.append(time.perf_counter() - start + resampling)
                predictions |= {int(i): _sparse(encode(int(i)), setting.threshold) for i in out}
        here = [predictions[i].in_bands(data.bands) for i in range(N)]
        kept = Values(_halved(data.f), data.cosines) if setting.is_half else data
        relative, rmse = [], []
        for i, combination in enumerate(here):
            f = combination.evaluate(kept)
            relative.append(data.relative_error(i, f))
            rmse.append(float(np.sqrt(np.sum((f - data.f[i]) ** 2) / f.shape[0] * data.n_bands / f.shape[1])))
        seconds = [
            t for c in here[:: max(N // _TIMED, 1)] for t in _times(partial(self._predict, c), _REPEATS)
        ]
        fit, predict = np.array(fits) / self.reference, np.array(seconds) / self.reference
        return Charted(
            setting.key, setting.title, float(np.median(relative)), float(np.median(rmse)),
            float(np.median(fit)), _spread(fit), float(np.median(predict)), _spread(predict),
            self._bytes(setting),
        )  # fmt: skip

    def _resampling_seconds(self) -> float:
        """Of all materials to the dense grid in all bands: one block of one material, measured and scaled."""
        block = np.median(_times(lambda: _evaluated(self.whole, self.pairs), _REPEATS))
        return float(block) * _DENSE_PAIRS / len(self.pairs) * len(self.thin)

    def _predict(self, combination: Combination) -> None:
        """Evaluate the materials that weigh anything, and combine."""
        per = 1 if combination.sample_bands is None else len(combination.sample_bands)
        weighs = np.abs(combination.weights).reshape(-1, self.data.n_materials, per).max(axis=(0, 2)) > 0
        used = np.flatnonzero(weighs)
        f = np.stack([_evaluated(self.thin[n], self.pairs) for n in used])
        columns = np.repeat(weighs, per)
        replace(combination, weights=combination.weights[..., columns]).evaluate(Values(f, self.cosines))

    def _bytes(self, setting: Setting) -> int:
        B = self.data.n_bands
        share = min(setting.sample_bands or B, B) / B
        size = 2 if setting.is_half else 4
        values = [_DENSE_PAIRS * B] * len(self.thin) if setting.is_dense else self.n_values
        return int(sum(values) * share * size) + _BYTES_PER_NUMBER * setting.numbers(B) * len(self.thin)


def _halved(f: Array) -> Array:
    """Values as float16 holds them; what is too large becomes its largest number."""
    return np.minimum(f, np.finfo(np.float16).max).astype(np.float16).astype(float)


def _sparse(combination: Combination, threshold: float) -> Combination:
    """Small weights dropped; the others scaled to the same sum."""
    if threshold <= 0.0:
        return combination
    w = combination.weights
    kept = np.where(np.abs(w) >= threshold * np.abs(w).max(), w, 0.0)
    scale = w.sum() / kept.sum() if kept.sum() > 0.5 * abs(w.sum()) else 1.0
    return replace(combination, weights=kept * scale)


def _evaluated(material: MeasuredBRDF, pairs: DirectionPairs) -> Array:
    """Values (P, B) on one core, whose time depends least on what else runs."""
    out = np.empty((len(pairs), material.bands.count))
    material.eval_into(pairs, out)
    return out


def _times(work: Callable[[], object], count: int) -> list[float]:
    work()
    seconds = []
    for _ in range(count):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return seconds


def _spread(values: Array) -> float:
    return float(np.subtract(*np.percentile(values, [75, 25])))
