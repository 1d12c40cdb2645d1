"""Errors of completions from 8, 12, 16 and 32 readings at random and at suggested directions, beside other methods.

    python benchmarks/bench_counts.py LIBRARY [--json FILE]

Each material of LIBRARY is left out and completed from its own exact values; all methods have the same readings and the
same library. Random directions are drawn anew for each material, one set for all methods.
"""

from __future__ import annotations

import argparse
import json
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from completion_baselines import gaussian_process_of_one

from manifold.colour import panel
from manifold.core.pairs import Pairs
from manifold.core.records import Indices
from manifold.estimate.atoms import LibraryAtoms
from manifold.evaluate.readings import METHODS, Predicted, ReadingMethod, Task, measure_curves
from manifold.library.store import Library

COUNTS = (8, 12, 16, 32)
KINDS = ("ball", "cube_root")
PREDICT: dict[str, Callable[[Task, Indices], Predicted]] = {
    key: METHODS[key].predict for key in ("completion", "ridge", "nearest", "principled")
}


def gaussian_process(task: Task, chosen: Indices) -> Predicted:
    """Predict by a Gaussian process of the readings, see `completion_baselines`."""
    read, grid, lights = task.readings(chosen), task.others.grid, panel.judged()
    both = Pairs(np.vstack([grid.wi, lights.wi]), np.vstack([grid.wo, lights.wo]))
    f = gaussian_process_of_one(Pairs(read.wi, read.wo), read.values, both)
    return f[: len(grid)], f[len(grid) :]


def random(task: Task, count: int) -> Indices:
    """Return directions drawn by a seed that only the material decides."""
    seed = zlib.crc32(np.ascontiguousarray(task.roots).tobytes())
    return np.random.default_rng(seed).choice(len(task.wi), count, replace=False)


def main() -> None:
    """Print and keep medians and 90th percentiles, by directions, method and number of readings."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("library", type=Path)
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    PREDICT["gaussian_process"] = gaussian_process
    orders = {"suggested": METHODS["completion"].order, "random": random}
    keys = [f"{name}_{method}" for name in orders for method in PREDICT]
    for name, order in orders.items():
        for method, predict in PREDICT.items():
            key = f"{name}_{method}"
            METHODS[key] = ReadingMethod(key, key, order, predict)
    atoms = LibraryAtoms.of_library(Library.open(asked.library))
    result: dict[str, dict[str, dict[str, list[float]]]] = {}
    for curve in measure_curves(atoms, COUNTS, keys):
        result[curve.key] = {
            str(count): {kind: [getattr(median, kind), getattr(p90, kind)] for kind in KINDS}
            for count, median, p90 in curve.summary
        }
        print(curve.key, json.dumps(result[curve.key]), flush=True)
    if asked.json:
        asked.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
