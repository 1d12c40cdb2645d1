"""Expected errors of completions beside true ones, of materials that the library does not have.

    python benchmarks/bench_completion_errors.py LIBRARY NEURAL [--every K] [--only SETUP ...] [--tasks TASK ...]

NEURAL holds published neural fits (`neural_fits.py`). Those of materials that LIBRARY does not have are completed from
LIBRARY. Then every third of all is completed from the other two thirds. Calibrations see only the library that
completes. Readings and pictures are exact; pictures show a ball under one far lamp each, at angles from the camera.
With --every K, one in K of these materials is tried. Figures of docs/explanation/completion.md.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from bench_readings import read
from neural_fits import NeuralBRDF, read_neural_fits, write_fits
from scipy.stats import spearmanr

from manifold.core.directions import from_spherical
from manifold.core.records import Array
from manifold.estimate import Completion, LibraryAtoms, calibrate
from manifold.estimate.evidence import Evidence, channel_atoms, rows_of_readings
from manifold.estimate.expected import LARGE, errors_of
from manifold.estimate.gloss import gloss_units
from manifold.estimate.lamp_plan import picture_rows
from manifold.estimate.suggestions import DIRECTIONS, all_directions
from manifold.formats.readings import aspecular_pair, geometry_ma_t12
from manifold.library.importing import import_files
from manifold.library.store import Library

KINDS = ("ball", "scaled_ball", "cube_root", "near_mirror", "elsewhere")
RANDOM = 12  # readings in random directions
LAMPS_DEG = {"picture": (30.0,), "pictures": (15.0, 45.0, 90.0)}
INCIDENCES_DEG = (20.0, 40.0, 60.0)
ELEVATIONS_DEG = np.arange(-80.0, 81.0, 5.0)
TASKS = ("of_library", "of_neural")
"""Completed from LIBRARY, or from two thirds of the neural fits."""
LEAST = 1e-6  # 1/sr; smaller values count as this

LeftOut = tuple[LibraryAtoms, list[int]]
"""Materials that a library does not have, and which of them are tried."""


@dataclass(frozen=True)
class Setup:
    """The observations of a material: readings at directions (P, 3), gloss, or pictures.

    Attributes:
        gloss_deg: angles of a gloss meter.
        lamps_deg: angles of a picture's lamp each.
        is_exposed: whether the exposure of pictures is known.
        has_reading: whether there is a reading at 45/0 beside the pictures.
    """

    wi: Array | None = None
    wo: Array | None = None
    gloss_deg: tuple[float, ...] = ()
    lamps_deg: tuple[float, ...] = ()
    is_exposed: bool = True
    has_reading: bool = False

    def observers(self, atoms: LibraryAtoms, truths: LibraryAtoms) -> Callable[[int], Completion]:
        """Return the completions of other materials from their observations and a library's atoms."""
        if self.lamps_deg:
            return self._pictures(atoms.in_values, truths.in_values)
        wi, wo = self.wi, self.wo
        assert wi is not None
        assert wo is not None
        at, of_library = truths.at(wi, wo), (atoms.at(wi, wo), atoms.at_gloss_meters(self.gloss_deg))

        def complete(m: int) -> Completion:
            gloss = gloss_units(truths.materials[m], self.gloss_deg) if self.gloss_deg else {}
            readings = replace(read(truths, m, at, wi, wo, np.arange(len(wi))), gloss=gloss)
            return Completion.of(atoms, Evidence.of_instruments(atoms, readings, of_library))

        return complete

    def _pictures(self, atoms: LibraryAtoms, truths: LibraryAtoms) -> Callable[[int], Completion]:
        ours, theirs = ([picture_rows(each, angle) for angle in self.lamps_deg] for each in (atoms, truths))
        exposure, one = 1.0 if self.is_exposed else None, at_45_0()
        roots = replace(truths, is_linear=False)
        at = roots.at(*one)

        def complete(m: int) -> Completion:
            own = channel_atoms(truths, m)
            pictures = [
                [replace(row, seen=true.atoms[k]) for row, true, k in zip(rows, trues, own, strict=True)]
                for rows, trues in zip(ours, theirs, strict=True)
            ]
            beside: dict[str, Any] = {}
            if self.has_reading:
                readings = read(roots, m, at, *one, np.arange(1))
                of_readings = rows_of_readings(atoms, readings, float(pictures[0][0].weights.sum()))
                beside = {"readings": readings, "of_readings": of_readings}
            evidence = Evidence(pictures=pictures, exposure=exposure, to_bands=np.eye(3), **beside)
            return Completion.of(atoms, evidence)

        return complete


def setups() -> dict[str, Setup]:
    """Return what is observed, by name."""
    one = at_45_0()
    mini_diff, every = DIRECTIONS["mini-diff"](), all_directions()
    in_plane = (
        np.abs(mini_diff[0][:, 0] * mini_diff[1][:, 1] - mini_diff[0][:, 1] * mini_diff[1][:, 0]) < 1e-9
    )
    some = np.random.default_rng(0).choice(len(every[0]), RANDOM, replace=False)
    return {
        "ma_t12": Setup(*geometry_ma_t12()),
        "45_0": Setup(*one),
        "45_0_gloss": Setup(*one, (60.0,)),
        "mini_diff": Setup(mini_diff[0][in_plane], mini_diff[1][in_plane]),
        "random": Setup(every[0][some], every[1][some]),
        "picture": Setup(lamps_deg=LAMPS_DEG["picture"]),
        "pictures": Setup(lamps_deg=LAMPS_DEG["pictures"]),
        "picture_unexposed": Setup(lamps_deg=LAMPS_DEG["picture"], is_exposed=False),
        "pictures_unexposed": Setup(lamps_deg=LAMPS_DEG["pictures"], is_exposed=False),
        "pictures_reading": Setup(lamps_deg=LAMPS_DEG["pictures"], is_exposed=False, has_reading=True),
    }  # fmt: skip


def at_45_0() -> tuple[Array, Array]:
    """Return one pair, (1, 3) and (1, 3)."""
    wi, wo = aspecular_pair(45.0, 45.0)
    return wi[None], wo[None]


def evaluate(setup: Setup, atoms: LibraryAtoms, left_out: Sequence[LeftOut]) -> dict[str, object]:
    """Return how expected errors of completions compare with true ones, by kind of error."""
    wi, wo = plane()
    calibration, expected, true, inside = None, [], [], []
    for truths, tried in left_out:
        complete = setup.observers(atoms, truths)
        of = truths.in_values if setup.lamps_deg else truths
        roots = truths.at(wi, wo)
        for m in tried:
            made = complete(m)
            calibration = calibration or calibrate(made.atoms, made.exposed)
            both = calibration.expected(made), errors_of(of, m, made.on_grid, made.on_ball)
            for errors, rows in zip(both, (expected, true), strict=True):
                rows.append([getattr(errors, kind) for kind in KINDS])
            f = (roots[truths.material_of == m] ** 3).mean(axis=0), made.brdf.eval(wi, wo).mean(axis=-1)
            off = np.abs(np.diff(np.log(np.maximum(f, LEAST)), axis=0)[0])
            inside.append(float(np.mean(off <= np.log(made.factors_at(wi, wo)))))
    pairs = zip(KINDS, np.array(expected).T, np.array(true).T, strict=True)
    summary: dict[str, object] = {kind: compare(*both) for kind, *both in pairs if np.isfinite(both[0]).all()}
    near = KINDS.index("near_mirror")
    said, was = (np.array(errors)[:, near] <= LARGE for errors in (expected, true))
    summary["highlights_usable"] = {
        "materials": int(was.sum()),
        "said": int(said.sum()),
        "right": int(np.sum(said & was)),
    }
    return {"materials": len(inside), "percent_in_bands": round(100.0 * float(np.mean(inside)))} | summary


def compare(expected: Array, true: Array) -> dict[str, object]:
    """Return medians and 90th percentiles, rank correlation, and shares of true errors below the expected ones."""
    of_true, of_expected = (np.quantile(values, [0.5, 0.9]).tolist() for values in (true, expected))
    return {
        "true": of_true,
        "expected": of_expected,
        "rank": float(spearmanr(expected, true)[0]),
        "percent_below": round(100.0 * float(np.mean(true < expected))),
        "percent_below_twice": round(100.0 * float(np.mean(true < 2.0 * expected))),
        "true_over_expected_p90": of_true[1] / of_expected[1],
    }


def plane() -> tuple[Array, Array]:
    """Return pairs in the plane of incidence, (P, 3) and (P, 3)."""
    wi = from_spherical(np.deg2rad(np.repeat(INCIDENCES_DEG, len(ELEVATIONS_DEG))), np.pi)
    return wi, from_spherical(np.deg2rad(np.tile(ELEVATIONS_DEG, len(INCIDENCES_DEG))), 0.0)


def main() -> None:
    """Print and keep the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("library", type=Path)
    parser.add_argument("neural", type=Path)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--only", nargs="+", choices=setups())
    parser.add_argument("--tasks", nargs="+", choices=TASKS, default=TASKS)
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    fits = read_neural_fits(asked.neural)
    names = list(fits)
    measured = LibraryAtoms.of_library(Library.open(asked.library))
    with tempfile.TemporaryDirectory() as temporary:
        thirds = [
            atoms_of(Path(temporary, str(k)), {name: fits[name] for name in names[k::3]}) for k in range(3)
        ]
        rest = atoms_of(Path(temporary, "rest"), {name: fits[name] for k in (1, 2) for name in names[k::3]})
    every = [(of, [m for m, name in enumerate(of.names) if name not in measured.names]) for of in thirds]
    tasks = {
        "of_library": (measured, [(of, some[:: asked.every]) for of, some in every]),
        "of_neural": (rest, [(thirds[0], list(range(len(thirds[0].names)))[:: asked.every])]),
    }
    result: dict[str, dict[str, object]] = {}
    for task in asked.tasks:
        atoms, left_out = tasks[task]
        for name, setup in setups().items():
            if asked.only and name not in asked.only:
                continue
            found = result[f"{task}_{name}"] = evaluate(setup, atoms, left_out)
            print(f"{task} {name}: {found['materials']} materials, {found['percent_in_bands']} % in bands")
            for kind, of_kind in found.items():
                if isinstance(of_kind, dict):
                    shown = {key: np.round(value, 2).tolist() for key, value in of_kind.items()}
                    print(f"  {kind}: {shown}", flush=True)
            if asked.json:
                asked.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


def atoms_of(folder: Path, fits: dict[str, NeuralBRDF]) -> LibraryAtoms:
    """Return the atoms of a library of neural fits."""
    write_fits(folder, fits)
    import_files(folder / "library.zarr", folder)
    return LibraryAtoms.of_library(Library.open(folder / "library.zarr"))


if __name__ == "__main__":
    main()
