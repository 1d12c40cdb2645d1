"""Speed against accuracy: every setting of the registry on one library, by cross-validation, in one run."""

from __future__ import annotations

import json
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from manifold.errors import RendererError, UsageError
from manifold.experiments.chart import fits, instruments, pareto
from manifold.experiments.chart.held_out import HeldOut
from manifold.experiments.chart.instruments import REFERENCE, REFERENCE_PAIRS, Measurement, RelativeTime
from manifold.experiments.chart.registry import Setting, settings
from manifold.experiments.evaluation.anchors import require_anchors
from manifold.experiments.interrupted import KeptResults
from manifold.library.store import Library
from manifold.metrics import RusinkiewiczGrid
from manifold.records import Array, BsdfFile, Progress
from manifold.system.names import names_like

ERRORS = {
    "delta_e": "CIEDE2000 of the ball", "cube_root_error": "cube-root error", "relative_error": "linear error",
    "delta_e_itp": "Delta E_ITP of the ball", "rmse": "RMSE of eq. 22",
}  # fmt: skip
COSTS = {"predict": "time to predict", "bytes": "bytes", "fit": "time to fit"}

_ALIKE = 0.01  # errors and bytes that differ by less do not count as different
_ALIKE_TIMES = 0.1  # nor times: so much they differ from run to run of the whole chart


@dataclass(frozen=True, kw_only=True)
class ChartRow(Measurement):
    """One setting, measured.

    Attributes:
        key, title, family: of the setting.
        is_held_out: False where a material is represented by a fit to itself.
    """

    key: str
    title: str
    family: str
    is_held_out: bool = True


@dataclass(frozen=True)
class Chart:
    """All settings, measured in one run.

    Attributes:
        rows: setting by setting; held-out ones first.
        fronts: by error, then by cost, the keys of held-out settings that no other dominates, cheapest first.
        n_materials, n_bands, folds: of the cross-validation.
        reference_seconds: median processor time of the reference, in which all times are.
        scaled: what was measured in part, and how it was scaled to the whole.
        skipped: settings that this machine cannot run, and why.
    """

    rows: tuple[ChartRow, ...]
    fronts: dict[str, dict[str, list[str]]]
    n_materials: int
    n_bands: int
    folds: int
    reference_seconds: float
    scaled: dict[str, float]
    skipped: dict[str, str]

    def to_json(self) -> dict[str, Any]:
        """The chart as plain values."""
        reference = f"{REFERENCE}, 195 bands, {REFERENCE_PAIRS} direction pairs, one core"
        rows = [{"key": row.key, "title": row.title, **asdict(row)} for row in self.rows]
        return {"reference": reference, **asdict(self), "rows": rows}

    def front(self, error: str, cost: str) -> list[ChartRow]:
        """The settings on a front, cheapest first."""
        by_key = {row.key: row for row in self.rows}
        return [by_key[key] for key in self.fronts[error][cost]]


def cost_of(row: ChartRow, cost: str) -> float:
    """A cost, one of `COSTS`: reference times, or bytes; NaN where it is not known."""
    value = getattr(row, cost)
    if value is None:
        return np.nan
    return value.median if isinstance(value, RelativeTime) else float(value)


def make_chart(
    files: Sequence[BsdfFile],
    only: Sequence[str] = (),
    on_progress: Progress | None = None,
    grid: RusinkiewiczGrid | None = None,
    fitted: int = 3,
    neural: str | None = None,
    library: Library | None = None,
    on_result: Callable[[Chart], None] | None = None,
) -> Chart:
    """Measure settings on materials, left out in at most ten folds.

    Args:
        files: at least four, of the same bands.
        only: keys of settings; all by default.
        on_progress: called with (done, total, title).
        grid: direction pairs of the errors; by default 45 x 23 x 12.
        fitted: how many materials the fits of `fits.METHODS` represent.
        neural: file, zip file or folder of published neural fits; also show those of these materials.
        library: of the files, where settings that are done are kept until all are and `on_result` has returned, so
            that an interrupted run is continued on the same machine.
        on_result: called with the chart, to write it.
    Raises:
        UsageError: a key is unknown, there are fewer than four materials, or `neural` holds none of them.
    """
    if len(files) < 4:
        raise UsageError(
            f"found {len(files)} material{'s' * (len(files) != 1)}, expected at least 4 to leave some out; import more"
        )
    known: dict[str, Setting | str] = {s.key: s for s in settings(files[0].bands.count)}
    known |= {f"fit_{method}": method for method in fits.METHODS}
    if neural is not None:
        require_anchors([neural], [file.name for file in files], files[0].bands)
        known[fits.NEURAL] = fits.NEURAL
    unknown = [key for key in only if key not in known]
    if unknown:
        near = names_like(known, unknown[0], "there are")
        raise UsageError(f"no setting is called {unknown[0]!r}; {near} (docs/design/chart.md lists all)")
    chosen = [known[key] for key in only or known]
    held_out = [s for s in chosen if isinstance(s, Setting)]
    names, machine = [file.name for file in files], platform.node()
    kept = KeptResults(library, f"chart-1 {names} {list(only)} {grid} {fitted} {neural} {machine}")
    rows = _from_arrays(kept.get())
    skipped: dict[str, str] = {}

    def add(key: str, title: str, family: str, measured: Measurement, *, is_held_out: bool = True) -> None:
        rows[key] = ChartRow(key=key, title=title, family=family, is_held_out=is_held_out, **vars(measured))
        kept.put(_to_arrays(rows))
        if on_progress is not None:
            on_progress(len(rows), len(chosen), title)

    with instruments.one_core():
        held = HeldOut(files, RusinkiewiczGrid.named("default") if grid is None else grid, held_out)
        # Settings that keep files alike stand together: only one set of kept files is in memory.
        for setting in sorted((s for s in held_out if s.key not in rows), key=lambda s: s.storage.key):
            add(setting.key, setting.title, setting.family, held.measure(setting))
        for key in only or known:
            method = known[key]
            if isinstance(method, Setting) or key in rows:
                continue
            try:
                if neural is not None and method == fits.NEURAL:
                    measured = fits.measure_neural(neural, files, held.target, held.watch)
                else:
                    measured = fits.measure(method, files, fitted, held.target, held.watch)
            except (RendererError, UsageError) as error:
                skipped[key] = str(error)
            else:
                add(key, fits.TITLES[method], fits.FAMILY, measured, is_held_out=False)
    measured_rows = tuple(rows[key] for key in known if key in rows)
    made = Chart(
        measured_rows, fronts(measured_rows), len(files), files[0].bands.count, held.folds,
        held.watch.reference_seconds, held.scaled, skipped,
    )  # fmt: skip
    if on_result is not None:
        on_result(made)
    kept.finish()
    return made


def _to_arrays(rows: Mapping[str, ChartRow]) -> dict[str, Array]:
    content = json.dumps([asdict(row) for row in rows.values()])
    return {"rows": np.frombuffer(content.encode(), np.uint8)}


def _from_arrays(arrays: Mapping[str, Array]) -> dict[str, ChartRow]:
    rows = {}
    for row in json.loads(arrays["rows"].tobytes()) if arrays else []:
        times = {name: row[name] and RelativeTime(**row[name]) for name in ("fit", "predict")}
        rows[row["key"]] = ChartRow(**row | times | {"warnings": tuple(row["warnings"])})
    return rows


def fronts(rows: Sequence[ChartRow]) -> dict[str, dict[str, list[str]]]:
    """Keys of the held-out settings on each front of an error and a cost, cheapest first.

    Neither errors and bytes that differ by 1 %, nor times that differ by 10 % or their spreads, count as different.
    """
    rows = [row for row in rows if row.is_held_out]
    return {error: {cost: _front(rows, error, cost) for cost in COSTS} for error in ERRORS}


def _front(rows: Sequence[ChartRow], error: str, cost: str) -> list[str]:
    if not rows:
        return []
    values = np.array([[getattr(row, error), cost_of(row, cost)] for row in rows])
    tolerance = 0.5 * _ALIKE * values
    if cost != "bytes":
        spreads = [getattr(row, cost).spread for row in rows]
        tolerance[:, 1] = 0.5 * np.maximum(_ALIKE_TIMES * values[:, 1], spreads)
    on = np.flatnonzero(pareto.front(values, tolerance)).tolist()
    return [rows[k].key for k in sorted(on, key=lambda k: values[k, 1])]
