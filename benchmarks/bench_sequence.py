"""Errors of completions as readings are added: each material of a library left out, judged in the same lights.

    python benchmarks/bench_sequence.py LIBRARY [--json FILE]

The steps: 45/0; then gloss at 60 degrees beside it; then the 12 geometries of an MA-T12; then those of a Mini-Diff in
the plane of incidence; then all directions from which `--suggest` chooses. Values are exact, or each has an error of
0.25 % (standard deviation). For pictures see `bench_photo.py`.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from bench_readings import read
from left_out import errors_of_completion

from manifold.core.records import Array
from manifold.estimate import Completion, LibraryAtoms
from manifold.estimate.gloss import gloss_units
from manifold.estimate.suggestions import DIRECTIONS, all_directions
from manifold.formats.readings import aspecular_pair, geometry_ma_t12
from manifold.library.store import Library

GLOSS_DEG = 60.0
NOISE = 0.0025
KINDS = ("ball", "cube_root")
STEPS = {
    "45_0": (1, False),
    "gloss": (1, True),
    "ma_t12": (2, True),
    "mini_diff": (3, True),
    "all": (4, True),
}
"""Sets of directions, one after the other, and whether gloss is read."""


def directions() -> list[tuple[Array, Array]]:
    """The sets of directions, each (P, 3) and (P, 3)."""
    one = aspecular_pair(45.0, 45.0)
    wi, wo = DIRECTIONS["mini-diff"]()
    in_plane = np.abs(wi[:, 0] * wo[:, 1] - wi[:, 1] * wo[:, 0]) < 1e-9
    return [(one[0][None], one[1][None]), geometry_ma_t12(), (wi[in_plane], wo[in_plane]), all_directions()]


def main() -> None:
    """Print and keep medians and 90th percentiles by step."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("library", type=Path)
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    library = Library.open(asked.library)
    atoms, rng = LibraryAtoms.of_library(library), np.random.default_rng(0)
    sets = directions()
    ends = np.cumsum([len(wi) for wi, _ in sets])
    wi, wo = (np.vstack([each[k] for each in sets]) for k in (0, 1))
    at = atoms.at(wi, wo)
    errors: dict[str, list[list[float]]] = {
        f"{case}_{step}": [] for case in ("exact", "noisy") for step in STEPS
    }
    for m in range(len(atoms.names)):
        others = atoms.without(m).in_atom_bands()
        exact = read(atoms, m, at, wi, wo, np.arange(len(wi)))
        noisy = replace(exact, values=exact.values * (1.0 + NOISE * rng.standard_normal(exact.values.shape)))
        units = gloss_units(atoms.materials[m], [GLOSS_DEG])
        for case, readings in (("exact", exact), ("noisy", noisy)):
            for step, (count, has_gloss) in STEPS.items():
                some = np.arange(len(wi)) < ends[count - 1]
                taken = replace(readings.select_pairs(some), gloss=units if has_gloss else {})
                completed = Completion.of(others, taken)
                of_material = errors_of_completion(atoms, m, completed)
                errors[f"{case}_{step}"].append([float(getattr(of_material, kind)) for kind in KINDS])
    result = {
        step: {
            kind: [float(np.median(values)), float(np.percentile(values, 90))]
            for kind, values in zip(KINDS, np.array(rows).T, strict=True)
        }
        for step, rows in errors.items()
    }
    for step, of_step in result.items():
        print(step, json.dumps(of_step))
    if asked.json:
        asked.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
