"""How well completions meet the readings that they were made of, and predict one that was left out, in CIEDE2000.

    python benchmarks/bench_met.py LIBRARY WORKBOOK ... [--repeatability 0.0025 0.3] [--json FILE]

Of instruments' workbooks, each reading left out in turn; means, medians and largest over all readings. Other methods
predict it from the same readings without a library: `mean` of the others, the one `nearest` in its angle from the
mirror direction, a `gaussian_process` over half-vector coordinates, and one over aspecular angle and incidence.
`same_incidence` completes from only those of the other readings that have its incidence. `not_reciprocal` is the
CIEDE2000 between the reading of an MA-T12 at 15/45 degrees and that at 45/15, interpolated between its neighbours.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from completion_baselines import aspecular_coordinates, gaussian_process_of_one
from scipy.interpolate import PchipInterpolator

from manifold.colour.difference import colour_differences
from manifold.core.pairs import Pairs
from manifold.core.records import Array
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.completion import Completion
from manifold.formats.readings import Readings
from manifold.formats.registry import read_readings
from manifold.library.store import Library

SAME_DEG = 0.5
"""Angles from the mirror direction that differ by less are equal."""


def met(atoms: LibraryAtoms, readings: Readings) -> Array:
    """CIEDE2000 at every reading."""
    found = Completion.of(atoms, readings).colour_misfits
    assert found is not None
    return found


def mean(others: Readings, wi: Array, wo: Array) -> Array:
    """The mean of the other readings, (1, B)."""
    return others.values.mean(axis=0, keepdims=True)


def nearest_aspecular(others: Readings, wi: Array, wo: Array) -> Array:
    """The reading whose angle from the mirror direction is nearest; the mean of such readings, (1, B)."""
    far = np.abs(from_mirror_deg(others.wi, others.wo) - from_mirror_deg(wi, wo))
    return others.values[far < far.min() + SAME_DEG].mean(axis=0, keepdims=True)


def gaussian_process(others: Readings, wi: Array, wo: Array) -> Array:
    """A Gaussian process of the other readings, (1, B)."""
    return gaussian_process_of_one(Pairs(others.wi, others.wo), others.values, Pairs(wi, wo))


def gaussian_process_in_plane(others: Readings, wi: Array, wo: Array) -> Array:
    """A Gaussian process over aspecular angles and incidences, (1, B); all readings lie in the plane of incidence."""
    read = Pairs(others.wi, others.wo)
    return gaussian_process_of_one(read, others.values, Pairs(wi, wo), aspecular_coordinates)


BASELINES: dict[str, Callable[[Readings, Array, Array], Array]] = {
    "mean": mean, "nearest": nearest_aspecular, "gaussian_process": gaussian_process,
    "gaussian_process_in_plane": gaussian_process_in_plane,
}  # fmt: skip


def from_mirror_deg(wi: Array, wo: Array) -> Array:
    """Angles between outgoing and mirror directions, (P,)."""
    return np.rad2deg(np.arccos(np.clip(np.sum(wi * [-1.0, -1.0, 1.0] * wo, axis=1), -1.0, 1.0)))


def not_reciprocal(readings: Readings) -> float:
    """CIEDE2000 between the reading at 15/45 degrees and the one at 45/15, interpolated in the outgoing angle."""
    incidence, outgoing = (
        np.rad2deg(np.arctan2(sign * w[:, 0], w[:, 2]))
        for sign, w in ((-1.0, readings.wi), (1.0, readings.wo))
    )
    at_15 = (np.abs(incidence - 15.0) < SAME_DEG) & (np.abs(outgoing - 45.0) < SAME_DEG)
    at_45 = np.flatnonzero(np.abs(incidence - 45.0) < SAME_DEG)
    at_45 = at_45[np.argsort(outgoing[at_45])]
    interpolated = PchipInterpolator(outgoing[at_45], readings.values[at_45])(15.0)
    return float(colour_differences(readings.values[at_15], interpolated[None], readings.bands, "D65")[0][0])


def left_out(atoms: LibraryAtoms, readings: Readings) -> dict[str, Array]:
    """CIEDE2000 at every reading, as the completion and the baselines predict it from the others."""
    truth = Completion.of(atoms, readings).readings  # in the bands of the library
    names = ("left_out", "left_out_same_incidence", *(f"left_out_{name}" for name in BASELINES))
    found: dict[str, list[float]] = {name: [] for name in names}
    incidence = np.rad2deg(np.arccos(truth.wi[:, 2]))
    for k in range(len(readings)):
        is_other = np.arange(len(readings)) != k
        wi, wo = truth.wi[k : k + 1], truth.wo[k : k + 1]
        others = truth.select_pairs(is_other)
        is_same = is_other & (np.abs(incidence - incidence[k]) < SAME_DEG)
        predicted = {
            name: Completion.of(atoms, readings.select_pairs(some)).brdf.eval(wi, wo)
            for name, some in zip(names, (is_other, is_same), strict=False)
        }
        predicted |= {f"left_out_{name}": predict(others, wi, wo) for name, predict in BASELINES.items()}
        for name, f in predicted.items():
            found[name].append(colour_differences(truth.values[k : k + 1], f, truth.bands, "D65")[0][0])
    return {name: np.array(values) for name, values in found.items()}


def main() -> None:
    """Print the table, in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("library", type=Path)
    parser.add_argument("workbooks", type=Path, nargs="+")
    parser.add_argument("--repeatability", type=float, nargs="+", default=[0.0025])
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    atoms, rows = LibraryAtoms.of_library(Library(options.library)), dict[str, dict[str, object]]()
    print("| repeatability | met: mean | largest | left out: median / 90th percentile |\n|---|---|---|---|")
    for repeatability in options.repeatability:
        read = [replace(read_readings(path), repeatability=repeatability) for path in options.workbooks]
        own = np.concatenate([met(atoms, one) for one in read])
        each, apart = [left_out(atoms, one) for one in read], [not_reciprocal(one) for one in read]
        both = {
            name: np.percentile(np.concatenate([one[name] for one in each]), (50, 90)) for name in each[0]
        }
        rows[f"{repeatability:g}"] = {
            "workbooks": len(read), "not_reciprocal": np.median(apart),
            "not_reciprocal_range": [min(apart), max(apart)],
            "met_mean": own.mean(), "met_largest": own.max(),
            **{name: values.tolist() for name, values in both.items()},
        }  # fmt: skip
        cells = [f"{name} {median:.2f} / {p90:.2f}" for name, (median, p90) in both.items()]
        print(
            f"| {repeatability:.2%} | {own.mean():.2f} | {own.max():.2f} |", ", ".join(cells), "|", flush=True
        )
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
