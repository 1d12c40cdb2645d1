"""Measures speed and accuracy of every setting on one library, by cross-validation, in one run."""

from __future__ import annotations

import json
import platform
from collections.abc import Hashable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from manifold.core import progress, work
from manifold.core.errors import ManifoldError, UsageError
from manifold.core.judged_lights import BALL, LIGHTS
from manifold.core.metrics import Errors
from manifold.core.names import counted, percent
from manifold.core.pairs import RusinkiewiczGrid
from manifold.core.records import Array, BsdfFile, plain
from manifold.evaluate import seen_fits, stopwatch
from manifold.evaluate.cross_validation import Method
from manifold.evaluate.errors import KeptResults
from manifold.evaluate.held_out import FOLDS, ChartRow, HeldOut
from manifold.evaluate.methods import chart_methods
from manifold.evaluate.stopwatch import REFERENCE, REFERENCE_PAIRS, RelativeTime
from manifold.library.store import Library
from manifold.model.coherence import Coherence
from manifold.registries import Registry

ERRORS = {
    "ball": BALL, "cube_root": "cube-root error", "linear": "linear error",
    "ball_itp": f"Delta E_ITP of the ball (mean of {LIGHTS})", "rmse": "RMSE of eq. 22",
}  # fmt: skip
COSTS = {"predict": "time to predict", "bytes": "bytes", "fit": "time to fit"}

_ALIKE = 0.01  # errors and bytes that differ by less do not count as different
_NEAR_BEST = 1.25  # times the smallest error: as accurate, for who needs speed
_ALIKE_TIMES = 0.1  # nor times: so much they differ from run to run of the whole chart


@dataclass(frozen=True)
class Chart:
    """All settings, measured in one run.

    Attributes:
        rows: results of the settings, cross-validated settings first.
        fronts: for each error and cost, the keys of cross-validated settings that no other dominates, cheapest first.
        folds: number of folds of the cross-validation.
        reference_seconds: median processor time of the reference, the unit of all times.
        scaled: texts about quantities that were measured in part and scaled to the whole.
    """

    rows: tuple[ChartRow, ...]
    fronts: dict[str, dict[str, list[str]]]
    n_materials: int
    n_bands: int
    folds: int
    reference_seconds: float
    scaled: dict[str, float]

    def to_json(self) -> dict[str, Any]:
        """Return the chart as plain values."""
        reference = f"{REFERENCE}, 195 bands, {REFERENCE_PAIRS} direction pairs, one core"
        return {"reference": reference, **plain(vars(self))}

    def front(self, error: str, cost: str) -> list[ChartRow]:
        """Return the settings on the Pareto front of an error and a cost, cheapest first."""
        by_key = {row.key: row for row in self.rows}
        return [by_key[key] for key in self.fronts[error][cost]]


def cost_of(row: ChartRow, cost: str) -> float:
    """Return one of the costs `COSTS` of a setting, in reference times or bytes; NaN if unknown."""
    value = getattr(row, cost)
    if value is None:
        return np.nan
    return value.median if isinstance(value, RelativeTime) else float(value)


def conclusion(made: Chart) -> str:
    """Return two sentences on the settings to choose; empty if none was cross-validated."""
    held_out = [row for row in made.rows if row.is_held_out]
    if not held_out:
        return ""
    best = min(held_out, key=lambda row: row.median.ball)
    near = [row for row in held_out if row.median.ball <= _NEAR_BEST * best.median.ball]
    fast = min(near, key=lambda row: row.predict.median)
    most_accurate = f"Most accurate for left-out materials: {best.title}, {best.median.ball:.2f} {BALL}."
    if fast is best:
        return f"{most_accurate} No faster setting is within {percent(_NEAR_BEST - 1)}."
    times = best.predict.median / fast.predict.median
    return (
        f"{most_accurate} Where speed counts, choose {fast.title}: {fast.median.ball:.2f}, and {times:.2g} times as "
        "fast to predict."
    )


def make_chart(
    files: Sequence[BsdfFile],
    only: Sequence[str] = (),
    grid: RusinkiewiczGrid | None = None,
    fitted: int = 3,
    library: Library | None = None,
    workers: Executor | None = None,
) -> Chart:
    """Measure settings on materials by cross-validation in at most ten folds.

    Args:
        files: at least four files with the same bands.
        only: keys of settings; by default all.
        grid: grid of direction pairs of the errors; by default 45 x 23 x 12.
        fitted: number of materials to which the fits of `seen_fits.METHODS` are made.
        library: library of the files, in which finished settings are kept until the run ends, so that an interrupted
            run continues on the same machine.
        workers: executor, see `work.run`, whose processes read the files from the library. Times are relative to a
            reference in the same process.

    Raises:
        UsageError: a key is unknown, there are fewer than four materials, or there are workers
            without a library.
        ManifoldError: a setting cannot be measured, or a worker process ended unexpectedly.
    """
    if len(files) < 4:
        raise UsageError(
            f"found {counted(len(files), 'material')}, expected at least 4 to leave some out; import more"
        )
    known = _known_settings(files[0].bands.count)
    names = tuple(file.name for file in files)
    for key in only:
        known[key]  # checks it
    kept = KeptResults(library, f"chart-4 {[*names]} {[*only]} {grid} {fitted} {platform.node()}")
    rows = _from_arrays(kept.get())
    how = _How(tuple(only), grid or RusinkiewiczGrid.named("default"), fitted)
    todo = [key for key in only or known if key not in rows]
    tasks: list[list[str]]
    if workers is None:
        measure = _Measuring(files, how).measure

        def storage(key: str) -> tuple[bool, str]:
            method = known[key]
            return (False, method.storage.key) if isinstance(method, Method) else (True, "")

        # Settings with equal storage follow each other: one set of stored files is in memory. Fits come last.
        tasks = [[key] for key in sorted(todo, key=storage)]
    else:
        if library is None:
            raise UsageError("workers need the library of the files, from which they read; give the library")
        measure = partial(_measure_there, library=library.path, names=names, how=how)
        of_fits: dict[Hashable, list[str]] = {}  # settings that share a fit are one task
        for key in todo:
            method = known[key]
            of_fits.setdefault(method.fit if isinstance(method, Method) else method, []).append(key)
        tasks = list(of_fits.values())
    reference_seconds, scaled = 0.0, dict[str, float]()
    for _, measured, failure in work.run(measure, tasks, workers):
        if measured is None:
            raise ManifoldError(failure)
        for row in measured.rows:
            rows[row.key] = row
            content = json.dumps([done.to_json() for done in rows.values()]).encode()
            kept.put({"rows": np.frombuffer(content, np.uint8)})
            progress.report(len(rows), len(only or known), row.title)
        reference_seconds, scaled = measured.reference_seconds, measured.scaled
    measured_rows = tuple(rows[key] for key in known if key in rows)
    kept.finish()
    return Chart(
        measured_rows, fronts(measured_rows), len(files), files[0].bands.count, min(FOLDS, len(files)),
        reference_seconds, scaled,
    )  # fmt: skip


class _How(NamedTuple):
    """Arguments of `make_chart` on which rows depend beside the files."""

    only: tuple[str, ...]
    grid: RusinkiewiczGrid
    fitted: int


class _Measured(NamedTuple):
    """Rows of some settings; times are relative to the reference time, and `scaled` is as in `Chart`."""

    rows: list[ChartRow]
    reference_seconds: float
    scaled: dict[str, float]


class _Measuring:
    """Measures settings on files, in one process; shared parts are made once."""

    def __init__(self, files: Sequence[BsdfFile], how: _How) -> None:
        self._files, self._how = files, how
        self._known = _known_settings(files[0].bands.count)
        chosen = [self._known[key] for key in how.only or self._known]
        with stopwatch.one_core(), progress.listen(None):  # settings are what is counted
            self._held = HeldOut(files, how.grid, [s for s in chosen if isinstance(s, Method)])

    def measure(self, keys: Sequence[str]) -> _Measured:
        """Return the rows of settings."""
        with stopwatch.one_core():
            rows = [
                self._held.measure(method)
                if isinstance(method := self._known[key], Method)
                else seen_fits.measure(method, self._files, self._how.fitted, self._held)
                for key in keys
            ]
        return _Measured(rows, self._held.watch.reference_seconds, self._held.scaled)


def _measure_there(keys: Sequence[str], *, library: Path, names: tuple[str, ...], how: _How) -> _Measured:
    return _measuring(library, names, how).measure(keys)


@lru_cache(maxsize=1)
def _measuring(library: Path, names: tuple[str, ...], how: _How) -> _Measuring:
    opened = Library(library)
    return _Measuring([opened.read(name) for name in names], how)


def _known_settings(n_bands: int) -> Registry[Method | str]:
    """Return all settings, by key: cross-validated ones, and the names of fits."""
    known = Registry[Method | str]("setting", ((s.key, s) for s in chart_methods(n_bands)))
    known.update({f"fit_{method}": method for method in seen_fits.METHODS})
    return known


def _from_arrays(arrays: Mapping[str, Array]) -> dict[str, ChartRow]:
    rows = {}
    for row in json.loads(arrays["rows"].tobytes()) if arrays else []:
        times = {name: row[name] and RelativeTime(**row[name]) for name in ("fit", "predict")}
        known = {
            "errors": Errors.from_json(row["errors"]), "warnings": tuple(row["warnings"]),
            "coherence": row["coherence"] and Coherence(**row["coherence"]),
        }  # fmt: skip
        del row["median"], row["p90"]
        rows[row["key"]] = ChartRow(**row | times | known)
    return rows


def fronts(rows: Sequence[ChartRow]) -> dict[str, dict[str, list[str]]]:
    """Return the keys of the cross-validated settings on the Pareto front of every error and cost, cheapest first.

    Errors and bytes count as equal if they differ by less than 1 %. Times count as equal if they differ by less than
    10 % or by less than their spreads.
    """
    rows = [row for row in rows if row.is_held_out]
    return {error: {cost: _front(rows, error, cost) for cost in COSTS} for error in ERRORS}


def _front(rows: Sequence[ChartRow], error: str, cost: str) -> list[str]:
    if not rows:
        return []
    values = np.array([[getattr(row.median, error), cost_of(row, cost)] for row in rows])
    tolerance = 0.5 * _ALIKE * values
    if cost != "bytes":
        spreads = [getattr(row, cost).spread for row in rows]
        tolerance[:, 1] = 0.5 * np.maximum(_ALIKE_TIMES * values[:, 1], spreads)
    on = np.flatnonzero([not others for others in dominators(values, tolerance)]).tolist()
    return [rows[k].key for k in sorted(on, key=lambda k: values[k, 1])]


def dominators(costs: Array, tolerance: Array | float = 0.0) -> list[list[int]]:
    """Return, for each row of costs (M, C), the rows that are better in one column and worse in none; less is better.

    Costs are known within +- tolerance; a cost is better or worse only if the two intervals do not overlap.
    """
    low, high = costs - tolerance, costs + tolerance
    better = high[:, None] < low[None]  # [row, than row, C]
    wins = np.asarray(better.any(axis=2))
    dominated_by = (wins & ~wins.T).T
    return [np.flatnonzero(row).tolist() for row in dominated_by]
