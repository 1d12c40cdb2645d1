"""Measurements of a chart: relative times, errors on a grid and on the ball, file sizes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numba as nb
import numpy as np
from threadpoolctl import threadpool_limits

from manifold import metrics
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.pairs import DirectionPairs
from manifold.brdf.synthetic import corpus
from manifold.experiments.chart import storage_forms
from manifold.experiments.chart.storage_forms import Storage
from manifold.experiments.evaluation.ball_errors import BallErrors
from manifold.experiments.evaluation.tabulated import Data
from manifold.metrics import RusinkiewiczGrid
from manifold.model.combination import Combination, Values, evaluate
from manifold.records import Array, BsdfFile

REFERENCE = "syn_satin_gold"
REFERENCE_PAIRS = 8192
_AT_ONCE = 8  # predictions evaluated together

Result = TypeVar("Result")


@dataclass(frozen=True)
class RelativeTime:
    """A time in times of the reference: the median of repeated runs, and their interquartile range."""

    median: float
    spread: float

    @classmethod
    def of(cls, ratios: Sequence[float] | Array) -> RelativeTime:
        """Of repeated runs."""
        low, median, high = np.percentile(ratios, [25, 50, 75])
        return cls(float(median), float(high - low))

    @classmethod
    def of_several(cls, runs: Sequence[Array]) -> RelativeTime:
        """Of repeated runs of several works: their median, with the spread of runs about that of their own work."""
        medians = np.array([np.median(ratios) for ratios in runs])
        apart = np.concatenate([ratios / m for ratios, m in zip(runs, medians, strict=True)])
        median = float(np.median(medians))
        return cls(median, median * cls.of(apart).spread)


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """Costs and errors of a setting: medians over materials.

    Attributes:
        relative_error: linear, cosine-weighted, over a grid, in some of the bands.
        cube_root_error: the same of cube roots; see `metrics.cube_root_error`.
        rmse: eq. 22 of Hikichi & Iwasaki over the grid, in 1/sr; these bands stand for all.
        delta_e, delta_e_itp: mean CIEDE2000 and Delta E_ITP of the ball; see `ball_colours`.
        p90: 90th percentiles of these five over materials, by their names.
        fit: time to learn from the library, tabulating its materials included; of fits, all of them; None where
            it was not measured.
        predict: time to predict a whole material, at all direction pairs that it is kept at.
        bytes: of what predictions read: files, and the numbers of all materials.
        warnings: what fits warned of, once per fold.
    """

    relative_error: float
    cube_root_error: float
    rmse: float
    delta_e: float
    delta_e_itp: float
    p90: dict[str, float] = field(default_factory=dict)
    fit: RelativeTime | None
    predict: RelativeTime
    bytes: int
    warnings: tuple[str, ...] = ()


def summary(errors: Sequence[Sequence[float]] | Array) -> dict[str, Any]:
    """Errors (N, 5) as `Target.errors` gives them, over materials: what `Measurement` holds of them."""
    names = ("relative_error", "cube_root_error", "rmse", "delta_e", "delta_e_itp")
    medians, p90 = np.percentile(errors, [50, 90], axis=0).tolist()
    return {**dict(zip(names, medians, strict=True)), "p90": dict(zip(names, p90, strict=True))}


class Stopwatch:
    """Processor times as ratios to that of a reference run just before, so that neither the machine nor others count.

    The reference is one evaluation of a synthetic material in 195 bands at 8192 direction pairs.
    """

    def __init__(self) -> None:
        """Measure the reference material, which is the same everywhere."""
        (material,) = (m for m in corpus.isotropic_materials() if m.name == REFERENCE)
        self._brdf = MeasuredBRDF(corpus.measure(material))
        self._pairs = some_pairs(REFERENCE_PAIRS)
        self._runs: list[float] = []
        self.lap(lambda: None)  # compiles
        self._runs.clear()

    def lap(self, work: Callable[[], Result]) -> tuple[Result, float]:
        """The result of some work, and its time relative to the reference."""
        start = time.process_time()
        self._brdf.eval_at(self._pairs)
        middle = time.process_time()
        result = work()
        end = time.process_time()
        self._runs.append(middle - start)
        return result, (end - middle) / (middle - start)

    def laps(self, work: Callable[[], object], count: int) -> Array:
        """The times that some work takes again and again, after a run that does not count."""
        work()
        return np.array([self.lap(work)[1] for _ in range(count)])

    @property
    def reference_seconds(self) -> float:
        """Median processor time of the reference."""
        return float(np.median(self._runs))


@contextmanager
def one_core() -> Iterator[None]:
    """Compiled loops and BLAS on one core, whose time depends least on what else runs."""
    threads = nb.get_num_threads()
    nb.set_num_threads(1)
    try:
        with threadpool_limits(1):
            yield
    finally:
        nb.set_num_threads(threads)


def some_pairs(count: int, grid: RusinkiewiczGrid | None = None) -> DirectionPairs:
    """Direction pairs above the horizon, spread evenly over a grid, by default 45 x 23 x 12."""
    wi, wo, above = (RusinkiewiczGrid.named("default") if grid is None else grid).directions()
    rows = np.flatnonzero(above)
    rows = rows[np.linspace(0, len(rows) - 1, count).astype(int)]
    return DirectionPairs(wi[rows], wo[rows])


class StoredMaterials:
    """Materials as a storage keeps them, and their values where errors are measured.

    Attributes:
        brdfs: in all bands that are kept.
        file_bytes: of all files, from the share of the bands that is read.
        cells: direction pairs of a file, the median.
        back: the matrix (B, r) from kept bands to all; None where all are kept.
    """

    def __init__(self, storage: Storage, files: Sequence[BsdfFile], target: Target) -> None:
        """Reduce files, and evaluate them at the target's direction pairs."""
        stored = [storage.reduce(file) for file in files]
        self.brdfs = [MeasuredBRDF(file) for file in stored]
        self._files, self._storage = stored, storage
        self.cells = float(np.median([file.luminance.size for file in stored]))
        sampled, self.back, self._some_back = self.brdfs, None, None
        if storage.bands is None:
            sampled = [brdf.select_bands(target.data.bands.tolist()) for brdf in self.brdfs]
        else:
            self.back = storage_forms.interpolation(files[0].bands, storage.bands)
            self._some_back = self.back[target.data.bands]
        self._at = [Values.at(sampled, pairs) for pairs in (target.pairs, target.balls.pairs)]

    def file_bytes(self, band_share: float) -> int:
        """Bytes of all files that predictions read, values in a share of the bands."""
        return sum(self._storage.file_bytes(file, band_share) for file in self._files)

    def predict(self, combinations: Sequence[Combination]) -> tuple[Array, Array]:
        """Predictions on the grid and on the ball, in the target's bands: (M, P, B') each."""
        grid, ball = (evaluate(combinations, values) for values in self._at)
        if self._some_back is not None:
            return grid @ self._some_back.T, ball @ self._some_back.T
        return grid, ball


class Target:
    """The truth: materials on a grid and on the ball, in some bands."""

    def __init__(self, data: Data, materials: Sequence[MeasuredBRDF], pairs: DirectionPairs) -> None:
        """Colour the balls of materials whose values at the pairs are `data`."""
        self.data, self.pairs = data, pairs
        self.balls = BallErrors(materials, data.bands)

    def errors(self, i: int, f: Array, f_ball: Array) -> tuple[float, ...]:
        """Linear and cube-root error, RMSE, and the ball's, of a prediction of material i, (P, B') and (P_ball, B')."""
        data = self.data
        rmse = metrics.rmse(data.f[i], f, n_pairs=f.size / data.n_bands)
        cube_root = metrics.cube_root_error(data.f[i], f, data.cosines)
        return data.relative_error(i, f), cube_root, rmse, *self.balls.differences(i, f_ball)

    def errors_of(self, stored: StoredMaterials, combinations: Sequence[Combination]) -> Array:
        """Errors (N, 5), as `errors` gives them, of a prediction per material."""
        rows = []
        here = [c if stored.back is not None else c.in_bands(self.data.bands) for c in combinations]
        for first in range(0, len(here), _AT_ONCE):
            grid, ball = stored.predict(here[first : first + _AT_ONCE])
            rows += [
                self.errors(first + k, f, f_ball)
                for k, (f, f_ball) in enumerate(zip(grid, ball, strict=True))
            ]
        return np.array(rows)
