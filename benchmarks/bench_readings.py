"""Suggested readings against random ones, errors with and without gloss beside expected ones, colour corrections.

    python benchmarks/bench_readings.py library.zarr

Results: docs/explanation/completion.md.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from left_out import errors_of_completion

from manifold.colour.conversion import to_xyz
from manifold.colour.correction import learn_correction
from manifold.colour.difference import delta_e_2000
from manifold.core.records import Array, Bands
from manifold.estimate import Completion, LibraryAtoms, calibrate, suggest
from manifold.estimate.evidence import Evidence
from manifold.estimate.gloss import gloss_units
from manifold.estimate.suggestions import all_directions
from manifold.formats.readings import Readings, aspecular_pair, geometry_ma_t12
from manifold.library.store import Library
from manifold.model.expected_error import Reliability

CASES = 5  # random choices per material
CHOSEN = 5
EXPECTED = ("ball", "cube_root", "linear")
"""Errors that are expected too."""
KINDS = (*EXPECTED, "ball_itp")


def read(atoms: LibraryAtoms, m: int, at: Array, wi: Array, wo: Array, chosen: Array) -> Readings:
    """Material m of the library at some of the directions, in the bands of the atoms."""
    nm = atoms.band_axis.wavelengths_nm
    own = atoms.material_of == m
    return Readings(
        atoms.names[m], "library", wi[chosen], wo[chosen], None if nm is None else np.array(nm),
        at[own][:, chosen].T ** 3,
    )  # fmt: skip


def errors(
    atoms: LibraryAtoms, m: int, others: LibraryAtoms, at: Array, wi: Array, wo: Array, chosen: Array
) -> Array:
    """Of material m completed from some of the directions."""
    left = at[atoms.material_of != m][:, chosen]
    seen = Evidence.of_instruments(
        others, read(atoms, m, at, wi, wo, chosen), (left, np.empty((len(left), 0)))
    )
    found = errors_of_completion(atoms, m, Completion.of(others, seen))
    return np.array([getattr(found, kind) for kind in KINDS])


def left_out_errors(
    atoms: LibraryAtoms, wi: Array, wo: Array, angles: tuple[int, ...]
) -> dict[str, list[float]]:
    """Medians and 90th percentiles over materials, completed from these directions and gloss at these angles."""
    at, everywhere = atoms.at(wi, wo), np.arange(len(wi))
    rows = []
    for m, material in enumerate(atoms.materials[: len(atoms.names)]):
        gloss = gloss_units(material, angles) if angles else {}
        readings = replace(read(atoms, m, at, wi, wo, everywhere), gloss=gloss)
        completion = Completion.of(atoms.without(m).in_atom_bands(), readings)
        found = errors_of_completion(atoms, m, completion)
        rows.append([getattr(found, kind) for kind in KINDS])
    both = np.quantile(rows, (0.5, 0.9), axis=0).T.tolist()
    return dict(zip(KINDS, both, strict=True))


def suggestions(atoms: LibraryAtoms) -> dict[str, object]:
    """Five readings, chosen one after the other from what the ones before said, against five at random."""
    wi, wo = all_directions()
    at = atoms.at(wi, wo)
    instrument = geometry_ma_t12()
    at_instrument = atoms.at(*instrument)
    rng = np.random.default_rng(0)
    wins = np.zeros((2, len(KINDS)), int)
    cases = 0
    for m in range(len(atoms.names)):
        own = atoms.material_of == m
        others = atoms.without(m).in_atom_bands()
        chosen: list[int] = []
        for _ in range(CHOSEN):
            known = None
            if chosen:
                left = at[~own][:, chosen]
                now = read(atoms, m, at, wi, wo, np.array(chosen))
                seen = Evidence.of_instruments(others, now, (left, np.empty((len(left), 0))))
                known = Completion.of(others, seen)
            found = suggest(others, 1, known)
            chosen.append(int(np.argmin(np.sum((wi - found.wi) ** 2 + (wo - found.wo) ** 2, axis=1))))

        ours = errors(atoms, m, others, at, wi, wo, np.array(chosen))
        first = errors(atoms, m, others, at_instrument, *instrument, np.arange(CHOSEN))
        wins[1] += ours < first
        for _ in range(CASES):
            some = rng.choice(len(wi), CHOSEN, replace=False)
            wins[0] += ours < errors(atoms, m, others, at, wi, wo, some)
            cases += 1
    print(
        f"five suggested readings better than five random ones, of {cases} cases, by {', '.join(KINDS)}: {wins[0]}"
    )
    print(f"better than an MA-T12's first five, of {len(atoms.names)}: {wins[1]}")
    return {
        "cases": cases,
        **{f"better_by_{kind}": int(won) for kind, won in zip(KINDS, wins[0], strict=True)},
    }


def expectations(atoms: LibraryAtoms) -> dict[str, dict[str, dict[str, object]]]:
    """Errors from an instrument's directions and a gloss meter's angles, beside those that are expected."""
    one = aspecular_pair(45.0, 45.0)
    instruments = {"MA-T12": geometry_ma_t12(), "45/0": (one[0][None], one[1][None])}
    nm = atoms.bands.wavelengths_nm
    print(f"| readings | gloss at | {' | '.join(KINDS)} | rank correlation | below twice the expected, % |")
    rows: dict[str, dict[str, dict[str, object]]] = {}
    for name, (wi, wo) in instruments.items():
        for angles in ((), (60,), (20,), (20, 60), (20, 60, 85)):
            blank = Readings(
                "", "", wi, wo, None if nm is None else np.array(nm), np.ones((len(wi), atoms.bands.count)),
                gloss=dict.fromkeys(angles, 1.0),
            )  # fmt: skip
            found = calibrate(atoms, blank)
            both = found.errors, found.expected_of_left_out
            of_kind = {kind: Reliability.of(*(getattr(of, kind) for of in both)) for kind in EXPECTED}
            errors = left_out_errors(atoms, wi, wo, angles)
            summary = ["{:.2f} / {:.2f}".format(*errors[kind]) for kind in KINDS]
            ranks = [f"{one.rank_correlation:.2f}" for one in of_kind.values()]
            below = [f"{100 * one.below_twice:.0f}" for one in of_kind.values()]
            gloss = ", ".join(map(str, angles))
            print(f"| {name} | {gloss} | {' | '.join(summary)} | {', '.join(ranks)} | {', '.join(below)} |")
            row: dict[str, dict[str, object]] = {kind: {"error": errors[kind]} for kind in KINDS}
            for kind, one in of_kind.items():
                row[kind] |= {
                    "rank": one.rank_correlation,
                    "percent_below_twice": round(100 * one.below_twice),
                }
            rows["_".join((name, *map(str, angles)))] = row
    return rows


def paint(rng: np.random.Generator, nm: Array, aspecular_deg: Array) -> Array:
    """f of a metallic paint at aspecular angles (P,), shape (P, B): a body colour, and flakes of another."""
    basis = np.array([np.exp(-0.5 * ((nm - c) / 45.0) ** 2) for c in np.linspace(400.0, 700.0, 7)])
    body, flake = np.clip(0.4 * rng.random(7) @ basis, 0.02, 0.95), 0.5 * rng.random(7) @ basis
    return (body + np.exp(-np.abs(aspecular_deg) / 25.0)[:, None] * flake) / np.pi


def corrections(paints: int = 40) -> None:
    """Simulated paints read by a camera-like instrument and by a spectrophotometer, and new ones."""
    rng = np.random.default_rng(1)
    nm = np.arange(400.0, 701.0, 10.0)
    camera, bands = Bands((465.0, 525.0, 630.0)), Bands(tuple(nm))
    white = to_xyz(np.ones(len(nm)), bands)
    sensors = np.array([np.exp(-0.5 * ((nm - c) / 25.0) ** 2) for c in camera.wavelengths_nm])
    sensors /= sensors.sum(axis=1, keepdims=True)
    shared = np.array([-15, 15, 25, 45, 75, 110, -45, -30, -15, 15, 45, 80], float)
    cameras, spectra, unseen = [], [], []
    for _ in range(2 * paints):
        f = paint(rng, nm, shared)
        read = (f @ sensors.T) ** 1.03  # not quite linear
        cameras.append(read * (1.0 + 0.01 * rng.standard_normal(read.shape)))
        spectra.append(f * (1.0 + 0.003 * rng.standard_normal(f.shape)))
        unseen.append(f)

    def relative(made: Array, truth: Array) -> float:
        return float(np.sqrt(np.mean(np.sum((made - truth) ** 2, axis=1) / np.sum(truth**2, axis=1))))

    x, y = np.vstack(cameras[:paints]), np.vstack(spectra[:paints])
    found = learn_correction(x, y, camera, bands, groups=np.repeat(np.arange(paints), len(shared)))
    new, truth = np.vstack(cameras[paints:]), np.vstack(unseen[paints:])
    on_new = {
        form: relative(learn_correction(x, y, camera, bands, forms=(form,)).apply(new), truth)
        for form in found.errors
    }
    print(f"across {paints} paints, on {paints} new ones, relative error by form:")
    for form, error in on_new.items():
        print(
            f"  {form}: {error:.4f}, left out {found.errors[form]:.4f}" + " (chosen)" * (form == found.form)
        )
    differences = []
    for c, measured, f in zip(cameras, spectra, unseen, strict=True):
        made = learn_correction(c, measured, camera, bands).apply(c)
        xyz = [np.pi * to_xyz(values, bands) for values in (made, f)]
        differences.append(float(np.median(delta_e_2000(*xyz, white))))
    print(f"each paint by its own 12 geometries: CIEDE2000 there, median {np.median(differences):.2f}")


def main() -> None:
    """Print what was found."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("library", type=Path)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    atoms = LibraryAtoms.of_library(Library.open(given.library))
    corrections()
    figures = {"completed_from": expectations(atoms), "five_suggested": suggestions(atoms)}
    if given.json:
        given.json.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
