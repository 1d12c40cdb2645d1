"""Errors of completions from 8, 12 and 32 readings at chosen and at random directions, beside other methods.

    python benchmarks/bench_counts.py LIBRARY [--json FILE]

Each material of LIBRARY is left out and completed from its own exact values; all methods have the same readings and the
same library. Directions are those that `--suggest` names, those of Nielsen et al. 2015 (`pivots`), or random ones: 10
draws, each anew for every material and the same for all methods. Errors of random directions are medians over the
draws; `medians` and `p90s` are the lowest and the highest.
"""

from __future__ import annotations

import argparse
import json
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from completion_baselines import LOGARITHMS, gaussian_process_of_one, ridge_on_components

from manifold.colour import panel
from manifold.core.pairs import Pairs
from manifold.core.records import Indices
from manifold.estimate.atoms import LibraryAtoms
from manifold.evaluate.readings import METHODS, Predicted, ReadingMethod, Task, measure_curves
from manifold.library.store import Library

COUNTS = (8, 12, 32)
DRAWS = 10
KINDS = ("ball", "cube_root")
SUGGESTED_ONLY = ("nearest", "principled")
"""Methods that are far from the best, at the suggested directions alone."""
PREDICT: dict[str, Callable[[Task, Indices], Predicted]] = {
    key: METHODS[key].predict for key in ("completion", "ridge", "nearest", "principled")
}


def ridge_of_nielsen(task: Task, chosen: Indices) -> Predicted:
    """Predict as Nielsen et al. 2015: log-relative values, see `completion_baselines`."""
    read, others, lights = task.readings(chosen), task.others, panel.judged()
    n = others.n_measured
    roots = others.directions[:n, : others.n_grid], task.at[:n, chosen], others.ball[:n]
    on_grid, at_readings, on_ball = (each.T**3 for each in roots)
    cosines = Pairs(read.wi, read.wo).cosines, np.concatenate([others.grid.cosines, lights.cosines])
    samples = at_readings, np.vstack([on_grid, on_ball])
    f = ridge_on_components(samples, cosines, read.values, LOGARITHMS)
    return f[: len(on_grid)], f[len(on_grid) :]


def gaussian_process(task: Task, chosen: Indices) -> Predicted:
    """Predict by a Gaussian process of the readings, see `completion_baselines`."""
    read, grid, lights = task.readings(chosen), task.others.grid, panel.judged()
    both = Pairs(np.vstack([grid.wi, lights.wi]), np.vstack([grid.wo, lights.wo]))
    f = gaussian_process_of_one(Pairs(read.wi, read.wo), read.values, both)
    return f[: len(grid)], f[len(grid) :]


def random(draw: int) -> Callable[[Task, int], Indices]:
    """Return directions drawn by a seed that only the draw and the material decide."""

    def order(task: Task, count: int) -> Indices:
        seed = [draw, zlib.crc32(np.ascontiguousarray(task.roots).tobytes())]
        return np.random.default_rng(seed).choice(len(task.wi), count, replace=False)

    return order


def over_draws(draws: list[dict[str, dict[str, list[float]]]]) -> dict[str, dict[str, list[float]]]:
    """Return medians over the draws, and the lowest and the highest, by number of readings."""
    result: dict[str, dict[str, list[float]]] = {}
    for count in draws[0]:
        result[count] = {}
        for kind in KINDS:
            both = np.array([draw[count][kind] for draw in draws])
            result[count][kind] = np.median(both, axis=0).tolist()
            ends = np.stack([both.min(axis=0), both.max(axis=0)], axis=1).tolist()
            result[count][f"{kind}_medians"], result[count][f"{kind}_p90s"] = ends
    return result


def main() -> None:
    """Print and keep medians and 90th percentiles, by directions, method and number of readings."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("library", type=Path)
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    predict_all = PREDICT | {"nielsen": ridge_of_nielsen, "gaussian_process": gaussian_process}
    orders = {
        "suggested": METHODS["completion"].order,
        "pivots": METHODS["ridge"].order,
        **{f"random {draw}": random(draw) for draw in range(DRAWS)},
    }
    keys = [
        f"{name} {method}"
        for name in orders
        for method in predict_all
        if name == "suggested" or method not in SUGGESTED_ONLY
    ]
    for key in keys:
        name, method = key.rsplit(" ", 1)
        METHODS[key] = ReadingMethod(key, key, orders[name], predict_all[method])
    atoms = LibraryAtoms.of_library(Library.open(asked.library))
    errors = {
        curve.key: {
            str(count): {kind: [getattr(median, kind), getattr(p90, kind)] for kind in KINDS}
            for count, median, p90 in curve.summary
        }
        for curve in measure_curves(atoms, COUNTS, keys)
    }
    result = {key.replace(" ", "_"): of_key for key, of_key in errors.items() if not key.startswith("random")}
    for method in (name for name in predict_all if name not in SUGGESTED_ONLY):
        draws = [errors[f"random {draw} {method}"] for draw in range(DRAWS)]
        result[f"random_{method}"] = over_draws(draws)
    for key, of_key in result.items():
        print(key, json.dumps(of_key), flush=True)
    if asked.json:
        asked.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
