"""Measured spectral BRDFs completed from 12 of their own readings, and judged at all others, beside other methods.

    python benchmarks/bench_spectral.py LIBRARY FOLDER [--json FILE]

LIBRARY holds the 20 RGB files of `docs/explanation/data.md`; FOLDER car paints of Cornell University as pbrt-v2 ships
them (`*.brdf`, 31 bands) and PTFE after Germer 2017 (`*.csv`, 4 wavelengths). The 12 readings are those nearest to the
geometries of an MA-T12, or 12 at random. *noisy*: the same with simulated errors of an instrument, a gain of 1 %
(standard deviation) for the sample, 0.5 % for each reading, and an offset of 0.001 in reflectance.
"""

from __future__ import annotations

import argparse
import csv
import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from completion_baselines import BASELINES, Problem

from manifold.colour.difference import colour_differences
from manifold.core.directions import from_spherical
from manifold.core.pairs import Pairs
from manifold.core.records import Array, Bands
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.completion import Completion
from manifold.formats.readings import Readings, geometry_ma_t12
from manifold.library.store import Library
from manifold.model.materials import MaterialCache

READ = 12
REGIONS = {"within_12": (0.0, 12.0), "12_to_30": (12.0, 30.0), "beyond_30": (30.0, 181.0)}
"""Angles between the outgoing direction and the mirror direction, in degrees."""
GAIN, SCATTER, OFFSET = 0.01, 0.005, 0.001


@dataclass(frozen=True, eq=False)
class Sample:
    """A measured sample: f (P, B) in 1/sr at P pairs in B bands."""

    name: str
    nm: Array
    pairs: Pairs
    f: Array

    @property
    def from_mirror_deg(self) -> Array:
        """Angle between the outgoing and the mirror direction, (P,)."""
        mirror = self.pairs.wi * [-1.0, -1.0, 1.0]
        return np.rad2deg(np.arccos(np.clip(np.sum(mirror * self.pairs.wo, axis=1), -1.0, 1.0)))


def turned_to_mirror(name: str, nm: Array, angles: Array, f: Array) -> Sample:
    """A sample of angles (P, 4) in radians, whose azimuths are turned so that the bright side is the mirror side."""
    wi = from_spherical(angles[:, 0], angles[:, 1])
    both = [
        Sample(name, nm, Pairs(wi, from_spherical(angles[:, 2], angles[:, 3] + turn)), f)
        for turn in (0.0, np.pi)
    ]
    near = [sample.f[np.argsort(sample.from_mirror_deg)[:20]].mean() for sample in both]
    sample = both[int(np.argmax(near))]
    above = (sample.pairs.wi[:, 2] > 0.02) & (sample.pairs.wo[:, 2] > 0.02) & np.all(np.isfinite(f), axis=1)
    return Sample(name, nm, sample.pairs[np.flatnonzero(above)], f[above])


def read_cornell(path: Path) -> Sample:
    """A `.brdf` of pbrt-v2: comments, the number of wavelengths, these, then rows of four angles and values."""
    words = " ".join(line.split("#")[0] for line in path.read_text().splitlines()).split()
    count = int(words[0])
    nm = np.array(words[1 : 1 + count], float)
    rows = np.array(words[1 + count :], float).reshape(-1, 4 + count)
    return turned_to_mirror(path.stem, nm, rows[:, :4], rows[:, 4:])


def read_germer(path: Path) -> Sample:
    """PTFE: a row per wavelength and pair, in degrees; pairs that have all wavelengths."""
    with path.open(newline="") as file:
        rows = [
            [float(row[key]) for key in ("lambda", "thetai", "phi", "thetar", "phir", "f_r11")]
            for row in csv.DictReader(file)
        ]
    table = np.array(rows)
    nm = np.unique(table[:, 0])
    at: dict[tuple[float, ...], dict[float, float]] = {}
    for row in table:
        at.setdefault(tuple(row[[1, 3, 4]]), {})[row[0]] = row[5]
    whole = {angles: values for angles, values in at.items() if len(values) == len(nm)}
    angles = np.deg2rad([[abs(theta_i), 0.0, theta_r, phi_r] for theta_i, theta_r, phi_r in whole])
    return turned_to_mirror(
        "PTFE", 1000.0 * nm, angles, np.array([[values[w] for w in nm] for values in whole.values()])
    )


def like_instrument(sample: Sample) -> Array:
    """The readings nearest to the geometries of an MA-T12, each once."""
    chosen: list[int] = []
    for a, b in zip(*geometry_ma_t12(), strict=True):
        far = np.sum((sample.pairs.wi - a) ** 2 + (sample.pairs.wo - b) ** 2, axis=1)
        swapped = np.sum((sample.pairs.wi - b) ** 2 + (sample.pairs.wo - a) ** 2, axis=1)
        far = np.minimum(far, swapped)
        far[chosen] = np.inf
        chosen.append(int(np.argmin(far)))
    return np.array(chosen)


def errors(sample: Sample, some: Array, predicted: Array) -> dict[str, object]:
    """Errors of values (P', B) at some pairs, by region; CIEDE2000 where the bands are those of colours."""
    f, pairs, far = sample.f[some], sample.pairs[some], sample.from_mirror_deg[some]
    result: dict[str, object] = {}
    weight = np.cbrt(pairs.cosines)[:, None]
    roots = [weight * np.cbrt(np.maximum(values, 0.0)) for values in (f, predicted)]
    is_colour = len(sample.nm) > 4
    if is_colour:
        difference, _ = colour_differences(
            np.maximum(f, 0.0), np.maximum(predicted, 0.0), Bands(sample.nm), "D65"
        )
    for name, (low, high) in {"all": (0.0, 181.0), **REGIONS}.items():
        here = (far >= low) & (far < high)
        if not np.any(here):
            continue
        row = {
            "pairs": int(here.sum()),
            "cube_root": float(
                np.linalg.norm(roots[1][here] - roots[0][here]) / np.linalg.norm(roots[0][here])
            ),
            "relative": float(
                np.median(np.abs(predicted[here] - f[here]) / np.maximum(np.abs(f[here]), 1e-6))
            ),
        }
        if is_colour:
            row["ciede2000"] = [
                float(np.median(difference[here])),
                float(np.percentile(difference[here], 90)),
            ]
        result[name] = row
    return result


def main() -> None:
    """Print and keep errors by sample, readings, method and region."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("library", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    library = Library.open(asked.library)
    atoms = LibraryAtoms.of_library(library)
    materials = list(MaterialCache(library, library.names).filled())
    samples = [read_cornell(path) for path in sorted(asked.folder.glob("*.brdf"))]
    samples += [read_germer(path) for path in sorted(asked.folder.glob("*.csv"))]
    result: dict[str, object] = {}
    for sample in samples:
        rng = np.random.default_rng([0, *sample.name.encode()])
        scale = (1.0 + GAIN * rng.standard_normal()) * (1.0 + SCATTER * rng.standard_normal(sample.f.shape))
        noisy = replace(sample, f=sample.f * scale + OFFSET / np.pi * rng.standard_normal(sample.f.shape))
        random = rng.choice(len(sample.f), READ, replace=False)
        cases = {"instrument": (sample, like_instrument(sample)), "random": (sample, random)}
        cases["noisy"] = noisy, cases["instrument"][1]
        rows: dict[str, object] = {"bands": len(sample.nm), "pairs": len(sample.f)}
        for case, (read, chosen) in cases.items():
            others = np.setdiff1d(np.arange(len(sample.f)), chosen)
            some, judged = sample.pairs[chosen], sample.pairs[others]
            readings = Readings(sample.name, "measured", some.wi, some.wo, sample.nm, read.f[chosen])
            completed = Completion.of(atoms, readings)
            f = completed.brdf.eval(judged.wi, judged.wo)
            exchanged = completed.brdf.eval(judged.wo, judged.wi)
            methods = {"complete": errors(sample, others, f)}
            methods["complete"]["not_reciprocal"] = float(
                np.median(np.abs(f - exchanged) / np.maximum(f + exchanged, 1e-9))
            )
            if case != "noisy":
                problem = Problem(some, read.f[chosen], Bands(sample.nm), judged, materials)
                methods |= {
                    name: errors(sample, others, complete(problem)) for name, complete in BASELINES.items()
                }
            rows[case] = methods
            for name, of_method in methods.items():
                print(sample.name, case, name, json.dumps(of_method), flush=True)
        result[sample.name] = rows
        if asked.json:
            asked.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
