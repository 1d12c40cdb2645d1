"""How well completions meet the readings that they were made of, and predict one that was left out, in CIEDE2000.

    python benchmarks/bench_met.py LIBRARY WORKBOOK ... [--repeatability 0.0025 0.3] [--json FILE]

Of instruments' workbooks, each reading left out in turn; medians and largest over readings, median over workbooks.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from manifold.colour.difference import colour_differences
from manifold.core.records import Array
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.completion import Completion
from manifold.formats.readings import Readings
from manifold.formats.registry import read_readings
from manifold.library.store import Library


def met(atoms: LibraryAtoms, readings: Readings) -> Array:
    """CIEDE2000 at every reading."""
    found = Completion.of(atoms, readings).colour_misfits
    assert found is not None
    return found


def left_out(atoms: LibraryAtoms, readings: Readings) -> Array:
    """CIEDE2000 at every reading, of the completion of the others."""
    found = []
    for k in range(len(readings)):
        others = np.arange(len(readings)) != k
        some = replace(
            readings, wi=readings.wi[others], wo=readings.wo[others], values=readings.values[others],
            weights=readings.weights[others], scatter=readings.scatter[others],
        )  # fmt: skip
        made = Completion.of(atoms, some)
        truth = Completion.of(atoms, readings).readings  # in the bands of the library
        f = made.brdf.eval(truth.wi[k : k + 1], truth.wo[k : k + 1])
        found.append(colour_differences(truth.values[k : k + 1], f, truth.bands, "D65")[0][0])
    return np.array(found)


def main() -> None:
    """Print the table, in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("library", type=Path)
    parser.add_argument("workbooks", type=Path, nargs="+")
    parser.add_argument("--repeatability", type=float, nargs="+", default=[0.0025])
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    atoms, rows = LibraryAtoms.of_library(Library(options.library)), dict[str, dict[str, object]]()
    print(
        "| repeatability | met: mean | largest | left out: median | 90th percentile |\n|---|---|---|---|---|"
    )
    for repeatability in options.repeatability:
        read = [replace(read_readings(path), repeatability=repeatability) for path in options.workbooks]
        own = np.concatenate([met(atoms, one) for one in read])
        others = np.concatenate([left_out(atoms, one) for one in read])
        row = [own.mean(), own.max(), np.median(others), np.percentile(others, 90)]
        rows[f"{repeatability:g}"] = {
            "workbooks": len(read), "met_mean": row[0], "met_largest": row[1], "left_out": row[2:],
        }  # fmt: skip
        print(f"| {repeatability:.2%} |", " | ".join(f"{value:.2f}" for value in row), "|", flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
