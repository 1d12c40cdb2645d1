"""Completions from simulated readings with the errors of an instrument: the 20 files from an MA-T12's 12 directions.

    python benchmarks/bench_noise.py LIBRARY [--json FILE]

Each file is left out and completed from its own values at these directions, exact, and with simulated errors: a gain of
1 % (standard deviation) for the calibration, 0.5 % for each reading and band, and an offset of 0.001 in reflectance.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from bench_readings import KINDS, read
from bench_spectral import GAIN, OFFSET, SCATTER
from left_out import errors_of_completion

from manifold.estimate import Completion, LibraryAtoms
from manifold.estimate.evidence import Evidence
from manifold.formats.readings import geometry_ma_t12
from manifold.library.store import Library


def main() -> None:
    """Print and keep medians and 90th percentiles of the errors."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("library", type=Path)
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    atoms = LibraryAtoms.of_library(Library.open(asked.library))
    wi, wo = geometry_ma_t12()
    at, rng = atoms.at(wi, wo), np.random.default_rng(0)
    found: dict[str, list[list[float]]] = {"exact": [], "noisy": []}
    for m, name in enumerate(atoms.names):
        exact = read(atoms, m, at, wi, wo, np.arange(len(wi)))
        scale = (1.0 + GAIN * rng.standard_normal()) * (
            1.0 + SCATTER * rng.standard_normal(exact.values.shape)
        )
        offset = OFFSET / np.pi * rng.standard_normal(exact.values.shape)
        others = atoms.without(m).in_atom_bands()
        left = at[atoms.material_of != m]
        for case, readings in (
            ("exact", exact),
            ("noisy", replace(exact, values=exact.values * scale + offset)),
        ):
            seen = Evidence.of_instruments(others, readings, (left, np.empty((len(left), 0))))
            made = Completion.of(others, seen)
            errors = errors_of_completion(atoms, m, made)
            found[case].append([float(getattr(errors, kind)) for kind in KINDS])
        print(name, found["exact"][-1], found["noisy"][-1], flush=True)
    result = {
        case: {
            kind: [float(np.median(each)), float(np.percentile(each, 90))]
            for kind, each in zip(KINDS, np.array(rows).T, strict=True)
        }
        for case, rows in found.items()
    }
    print(result)
    if asked.json:
        asked.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
