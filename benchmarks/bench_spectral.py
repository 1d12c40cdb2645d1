"""Measured spectral BRDFs completed from 12 of their own readings, and judged at all others, beside other methods.

    python benchmarks/bench_spectral.py LIBRARY FOLDER [--json FILE]

LIBRARY holds the 20 RGB files of `docs/explanation/data.md`; FOLDER car paints of Cornell University as pbrt-v2 ships
them (`*.brdf`, 31 bands) and PTFE after Germer 2017 (`*.csv`, 4 wavelengths). *instrument*: measured pairs near the
geometries of an MA-T12, whose angles `geometries` states. *random*: 12 pairs, drawn 10 times; each number is its median
over the draws, `ciede2000_medians` and `ciede2000_p90s` are the lowest and the highest of the draws. *noisy*: those of
the instrument with simulated errors, a gain of 1 % (standard deviation) for the sample, 0.5 % for each reading, and an
offset of 0.001 in reflectance.
"""

from __future__ import annotations

import argparse
import csv
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from completion_baselines import BASELINES, Problem

from manifold.brdf.interface import BRDF
from manifold.colour.difference import colour_differences
from manifold.core.directions import from_spherical, to_spherical
from manifold.core.pairs import Pairs
from manifold.core.records import Array, Bands, Indices
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.completion import Completion
from manifold.formats.readings import MA_T12_NAMES, Readings, geometry_ma_t12
from manifold.library.store import Library
from manifold.model.materials import MaterialCache

READ = 12
DRAWS = 10
APART_DEG = 5.5
"""Largest angle between a measured direction and the instrument's. The car paints have incidences every 10 degrees."""
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
        return angle_deg(self.pairs.wi * [-1.0, -1.0, 1.0], self.pairs.wo)


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


def angle_deg(a: Array, b: Array) -> Array:
    """Angle between directions (..., 3), in degrees."""
    return np.rad2deg(np.arccos(np.clip(np.sum(a * b, axis=-1), -1.0, 1.0)))


def in_one_azimuth(wi: Array, wo: Array) -> tuple[Array, Array]:
    """Pairs of an isotropic sample, turned and mirrored: wi at azimuth 0, wo between 0 and 180 degrees."""
    (theta_i, phi_i), (theta_o, phi_o) = to_spherical(wi), to_spherical(wo)
    apart = np.arccos(np.cos(phi_o - phi_i))
    return from_spherical(theta_i, np.zeros_like(phi_i)), from_spherical(theta_o, apart)


def like_instrument(sample: Sample) -> tuple[Indices, list[dict[str, Any]]]:
    """The measured pairs, each once, for the geometries of an MA-T12, and their angles.

    A pair is near a geometry if both directions lie within `APART_DEG` of the instrument's, in either order. The pair
    is taken whose directions and angle from the mirror direction differ least in sum. Geometries without a near pair
    are left out.
    """
    own = in_one_azimuth(sample.pairs.wi, sample.pairs.wo)
    chosen: list[int] = []
    stated: list[dict[str, Any]] = []
    for name, a, b in zip(MA_T12_NAMES, *geometry_ma_t12(), strict=True):
        aspecular = angle_deg(a * [-1.0, -1.0, 1.0], b)
        apart = [
            [angle_deg(measured, wanted) for measured, wanted in zip(own, pair, strict=True)]
            for pair in (in_one_azimuth(a[None], b[None]), in_one_azimuth(b[None], a[None]))
        ]
        farther = np.min(np.max(apart, axis=1), axis=0)
        cost = np.min(np.sum(apart, axis=1), axis=0) + np.abs(sample.from_mirror_deg - aspecular)
        cost[farther > APART_DEG] = np.inf
        cost[chosen] = np.inf
        best = int(np.argmin(cost))
        found: dict[str, Any] = {"geometry": name}
        if np.isfinite(cost[best]):
            chosen.append(best)
            pair = sample.pairs[best : best + 1]
            found |= {
                "incidence_deg": float(np.rad2deg(np.arccos(pair.wi[0, 2]))),
                "outgoing_deg": float(np.rad2deg(np.arccos(pair.wo[0, 2]))),
                "from_mirror_deg": float(sample.from_mirror_deg[best]),
                "apart_deg": float(farther[best]),
            }
        stated.append(found)
    return np.array(chosen), stated


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
        row: dict[str, object] = {
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


def completed(sample: Sample, read: Sample, chosen: Indices, atoms: LibraryAtoms) -> dict[str, object]:
    """Errors of a completion from some readings at all other pairs."""
    others = np.setdiff1d(np.arange(len(sample.f)), chosen)
    some, judged = sample.pairs[chosen], sample.pairs[others]
    readings = Readings(sample.name, "measured", some.wi, some.wo, sample.nm, read.f[chosen])
    brdf = Completion.of(atoms, readings).brdf
    f, exchanged = brdf.eval(judged.wi, judged.wo), brdf.eval(judged.wo, judged.wi)
    apart = np.abs(f - exchanged) / np.maximum(f + exchanged, 1e-9)
    return errors(sample, others, f) | {"not_reciprocal": float(np.median(apart))}


def all_methods(
    sample: Sample, chosen: Indices, atoms: LibraryAtoms, materials: Sequence[BRDF]
) -> dict[str, dict[str, object]]:
    """Errors of every method from some exact readings."""
    others = np.setdiff1d(np.arange(len(sample.f)), chosen)
    problem = Problem(
        sample.pairs[chosen], sample.f[chosen], Bands(sample.nm), sample.pairs[others], materials
    )
    return {
        "complete": completed(sample, sample, chosen, atoms),
        **{name: errors(sample, others, complete(problem)) for name, complete in BASELINES.items()},
    }


def over_draws(draws: list[Any]) -> Any:
    """Medians over the draws of every number, and the lowest and highest CIEDE2000."""
    if not isinstance(draws[0], dict):
        return np.median(draws, axis=0).tolist()
    rows = {
        key: over_draws([draw[key] for draw in draws if key in draw]) for key in dict.fromkeys(chain(*draws))
    }
    if "ciede2000" in rows:
        both = np.array([draw["ciede2000"] for draw in draws])
        lowest, highest = both.min(axis=0).tolist(), both.max(axis=0).tolist()
        rows["ciede2000_medians"], rows["ciede2000_p90s"] = map(list, zip(lowest, highest, strict=True))
    return rows


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
    result: dict[str, object] = {"draws": DRAWS}
    for sample in samples:
        rng = np.random.default_rng([0, *sample.name.encode()])
        scale = (1.0 + GAIN * rng.standard_normal()) * (1.0 + SCATTER * rng.standard_normal(sample.f.shape))
        noisy = replace(sample, f=sample.f * scale + OFFSET / np.pi * rng.standard_normal(sample.f.shape))
        near, geometries = like_instrument(sample)
        drawn = [rng.choice(len(sample.f), READ, replace=False) for _ in range(DRAWS)]
        rows: dict[str, Any] = {
            "bands": len(sample.nm),
            "pairs": len(sample.f),
            "instrument_readings": len(near),
            "geometries": geometries,
            "apart_at_most_deg": max(each.get("apart_deg", 0.0) for each in geometries),
            "least_from_mirror_deg": float(sample.from_mirror_deg[near].min()),
            "instrument": all_methods(sample, near, atoms, materials),
            "random": over_draws([all_methods(sample, some, atoms, materials) for some in drawn]),
            "noisy": {"complete": completed(sample, noisy, near, atoms)},
        }
        for case in ("instrument", "random", "noisy"):
            for name, of_method in rows[case].items():
                print(sample.name, case, name, json.dumps(of_method), flush=True)
        result[sample.name] = rows
        if asked.json:
            asked.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
