"""Time of Mitsuba's `measured` plugin over that of `MeasuredBRDF`, on the same pairs and bands.

    python benchmarks/bench_evaluation.py [--rgb FILE] [--spectral FILE] [--pairs N] [--rounds N] [--json FILE]

An RGB and a spectral file are evaluated at random pairs and at neighbours in the grid of Hikichi & Iwasaki, and
sampled: default calls first, which take doubles and return new memory, then single precision and memory that is used
again; and a weighted sum of eight files as predictions evaluate it, whose ratio is per file. Mitsuba evaluates four
wavelengths at a time, so 49 calls cover 195 bands, and keeps its memory. All run warm, alternately, on all cores. The
medians of the rounds count, of processor time and of wall time: 1 is equal, less is slower. Without files, a synthetic
material is measured.

The profile below each table has the processor time of the stages of `eval`, `pdf` and `sample` on one core, measured by
calling compiled loops that contain some of them: at random pairs, at neighbours, and at one pair again and again, which
finds all numbers in the nearest cache. So the difference to random pairs is what cache misses cost.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from manifold.analytic import corpus
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.warp import Warp
from manifold.core.compiled import loops
from manifold.core.directions import from_spherical
from manifold.core.pairs import RusinkiewiczGrid
from manifold.io_rgl import read_bsdf, write_bsdf
from manifold.model.combination import Combination
from manifold.model.prediction import PredictedBRDF
from manifold.registries import MAPPINGS
from manifold.render import backend

SUMMED = 8  # files of a weighted sum
MATERIAL = "syn_satin_gold"
PAIRS = {"rgb": 2_000_000, "spectral": 200_000}
PROFILED = 100_000  # pairs of a profile
SAMPLE, INVERT = 1, 2  # modes of `map_points`

Work = Callable[[], object]


def main() -> None:
    """Measure, print, and leave with 1 if there is nothing to compare with."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rgb", type=Path, metavar="FILE")
    parser.add_argument("--spectral", type=Path, metavar="FILE")
    parser.add_argument("--pairs", type=int, help="by default 2,000,000 of RGB, 200,000 of spectra")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    chosen = backend.choose()
    if chosen.library is None:
        print(f"{chosen.advice or 'scalar was asked for'}; there is nothing to compare with", file=sys.stderr)
        sys.exit(1)
    result: dict[str, Any] = {
        "llvm": chosen.library.name,
        "cores": os.cpu_count(),
        "rounds": arguments.rounds,
    }
    with tempfile.TemporaryDirectory() as folder:
        for kind, count in PAIRS.items():
            path = getattr(arguments, kind) or synthetic(kind, Path(folder))
            result[kind] = compare(path, kind, arguments.pairs or count, arguments.rounds)
            result[kind]["profile"] = profile(path, arguments.rounds)
            show(kind, result[kind])
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=2) + "\n")


def synthetic(kind: str, folder: Path) -> Path:
    """Write a synthetic material."""
    material = next(m for m in corpus.isotropic_materials() if m.name == MATERIAL)
    path = folder / f"{MATERIAL}_{'rgb' if kind == 'rgb' else 'spec'}.bsdf"
    write_bsdf(path, corpus.measure(material, rgb=kind == "rgb"))
    return path


def show(kind: str, result: dict[str, Any]) -> None:
    """Print a table of one file."""
    print(
        f"{kind}: {result['file']}, {result['pairs']:,} pairs, {result['bands']} bands, {os.cpu_count()} cores"
    )
    print(f"  {'':<40} ns per pair (processor)   ratio: processor   wall")
    for name, of in result["methods"].items():
        print(f"  {name:<40} {of['cpu_ns']:12.1f} {of['cpu_ratio']:26.2f} {of['wall_ratio']:11.2f}")
    memory, calls = result["profile"]["memory_mb"], result["profile"]["calls"]
    print(f"  tables in memory, MB: {', '.join(f'{name} {mb:.2f}' for name, mb in memory.items())}")
    print(f"  {'':<40} bytes read  ns per pair: {', '.join(calls)}")
    for call, stages in next(iter(calls.values())).items():
        for stage in stages:
            ns = "".join(f"{of[call][stage]:12.1f}" for of in calls.values())
            print(f"  {f'{call}: {stage}':<40} {result['profile']['bytes'].get(stage, ''):>10} {ns}")


def pairs_of(count: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Pairs (count, 3) twice: random ones over the hemisphere, and a run of a grid."""
    rng = np.random.default_rng(0)
    wi, wo = (
        from_spherical(np.arccos(rng.random(count)), rng.uniform(-np.pi, np.pi, count)) for _ in range(2)
    )
    grid = RusinkiewiczGrid.named("hikichi").pairs()
    count = min(count, len(grid))
    first = (len(grid) - count) // 3
    run = grid[first : first + count]
    return {"random": (wi, wo), "neighbouring": (run.wi, run.wo)}


class Plugin:
    """Mitsuba's `measured` of a file, with directions in its memory."""

    def __init__(self, path: Path, kind: str, wi: np.ndarray, wo: np.ndarray, u: np.ndarray) -> None:
        """Load the file, and copy directions (K, 3) and uniforms (K, 2)."""
        import drjit as dr

        self._dr, self._mi = dr, (mi := backend.mitsuba("rgb" if kind == "rgb" else "spectral"))
        self._plugin, self._context = (
            mi.load_dict({"type": "measured", "filename": str(path)}),
            mi.BSDFContext(),
        )
        self._wo, self._u, self._one = (
            mi.Vector3f(*wo.T.astype(np.float32)),
            mi.Point2f(*u.T.astype(np.float32)),
            dr.full(mi.Float, 0.5, len(u)),
        )
        self._at = mi.SurfaceInteraction3f()
        self._at.wi = mi.Vector3f(*wi.T.astype(np.float32))
        self._fours: list[Any] = [None]
        if kind != "rgb":
            wavelengths = read_bsdf(path).wavelengths_nm
            padded = np.append(wavelengths, np.repeat(wavelengths[-1], -len(wavelengths) % 4)).reshape(-1, 4)
            self._fours = [[float(w) for w in four] for four in padded]
        self._select(self._fours[0])
        dr.eval(self._wo, self._u, self._one, self._at.wi)

    def _select(self, four: list[float] | None) -> None:
        if four is not None:
            self._at.wavelengths = self._mi.Spectrum(*(self._dr.opaque(self._mi.Float, w) for w in four))

    def eval(self) -> list[Any]:
        """Evaluate all bands."""
        values = []
        for four in self._fours:
            self._select(four)
            values.append(self._plugin.eval(self._context, self._at, self._wo))
            self._dr.eval(values[-1])
        self._dr.sync_thread()
        return values

    def pdf(self) -> Any:
        """Evaluate densities."""
        density = self._plugin.pdf(self._context, self._at, self._wo)
        self._dr.eval(density)
        self._dr.sync_thread()
        return density

    def sample(self) -> Any:
        """Sample directions and their densities, without values."""
        sample, _ = self._plugin.sample(self._context, self._at, self._one, self._u)
        self._dr.eval(sample.wo, sample.pdf)
        self._dr.sync_thread()
        return sample


def compare(path: Path, kind: str, count: int, rounds: int) -> dict[str, Any]:
    """Alternate all methods on one file."""
    file = read_bsdf(path)
    brdf, bands = MeasuredBRDF(file), file.bands.count
    several = [MeasuredBRDF(file) for _ in range(SUMMED)]  # each with tables of its own
    weights = np.full(SUMMED, 1.0 / SUMMED)
    sums = {
        name: PredictedBRDF(several, Combination(MAPPINGS[name], weights))
        for name in ("identity", "cube-root")
    }
    methods: dict[str, Any] = {}
    for where, (wi, wo) in pairs_of(count).items():
        n = len(wi)
        u = np.random.default_rng(1).random((n, 2))
        single_wi, single_wo, single_u = (a.astype(np.float32) for a in (wi, wo, u))
        out = np.zeros((n, bands), np.float32)
        plugin = Plugin(path, kind, wi, wo, u)
        # Ours, Mitsuba's, and how many files are evaluated at once.
        works: dict[str, tuple[Work, str, int]] = {
            "eval(wi, wo)": (lambda: brdf.eval(wi, wo), "eval", 1),  # noqa: B023
            "eval, single precision": (lambda: brdf.eval(single_wi, single_wo), "eval", 1),  # noqa: B023
            "eval, single precision, out=": (lambda: brdf.eval(single_wi, single_wo, out=out), "eval", 1),  # noqa: B023
            f"sum of {SUMMED} files": (lambda: sums["identity"].eval(wi, wo), "eval", SUMMED),  # noqa: B023
            f"sum of {SUMMED} cube roots": (lambda: sums["cube-root"].eval(wi, wo), "eval", SUMMED),  # noqa: B023
        }
        if where == "random":
            works |= {
                "pdf(wi, wo)": (lambda: brdf.pdf(wi, wo), "pdf", 1),  # noqa: B023
                "pdf, single precision": (lambda: brdf.pdf(single_wi, single_wo), "pdf", 1),  # noqa: B023
                "sample(wi, u)": (lambda: brdf.sample(wi, u), "sample", 1),  # noqa: B023
                "sample, single precision": (lambda: brdf.sample(single_wi, single_u), "sample", 1),  # noqa: B023
            }
        references = {name: getattr(plugin, name) for name in {of for _, of, _ in works.values()}}
        times = alternate(references | {name: work for name, (work, _, _) in works.items()}, rounds)
        for name, (_, of, files) in works.items():
            ratios = files * times[of] / times[name]  # [rounds, 2]
            cpu, wall = (float(x) for x in np.median(ratios, axis=0))
            methods[f"{where} {name}"] = {
                "cpu_ratio": cpu,
                "wall_ratio": wall,
                "cpu_ns": statistics.median(times[name][:, 0]) / n / files * 1e9,
                "mitsuba_cpu_ns": statistics.median(times[of][:, 0]) / n * 1e9,
            }
    return {"file": path.stem, "pairs": count, "bands": bands, "methods": methods}


def profile(path: Path, rounds: int) -> dict[str, Any]:
    """Measure the stages of calls in ns per pair, and count the bytes that a pair reads and those of the tables."""
    file = read_bsdf(path)
    brdf, axes = MeasuredBRDF(file), (file.phi_i_rad, file.theta_i_rad)
    normals = Warp(file.vndf, *axes).tables
    luminance = Warp(np.maximum(file.luminance, 1e-9), *axes).tables
    # Warps that are always in the cache, of all angles of incidence and of two, which need no search.
    small, smaller = (
        Warp(np.ones((1, len(of), 2, 2)), np.zeros(1), of).tables for of in (axes[1], axes[1][:2])
    )
    scaled, plain = (
        loops.Tables(has_scale, file.ndf, file.sigma, normals, brdf.spectra[..., :1])
        for has_scale in (True, False)
    )
    u = np.random.default_rng(2).random((PROFILED, 2))
    places = {where: (*of, u) for where, of in pairs_of(PROFILED).items()}
    places["one pair"] = tuple(np.repeat(of[:1], PROFILED, axis=0) for of in places["random"])
    tables = (normals, luminance, small, smaller, scaled, plain)
    calls = {where: _stages(brdf, tables, *of, rounds) for where, of in places.items()}
    slices = 4 if len(axes[0]) > 1 else 2
    node = 4 * max(file.bands.count, 4)  # bytes; three bands are stored as four
    numbers = {"visible normals": file.vndf, "luminance": file.luminance}
    return {
        "calls": calls,
        "memory_mb": {name: 12e-6 * of.size for name, of in numbers.items()}  # three singles per node
        | {"bands": 1e-6 * node * file.luminance.size},
        "bytes": {
            "angles, half vectors": 48,
            "inversion": slices * (2 * 16 + 32),  # a cell in two rows; sums of two rows
            "ndf, sigma": 16,
            "bands": slices * 4 * node,
            "luminance, Jacobian": slices * 2 * 16,
        },
    }


def _stages(
    brdf: MeasuredBRDF, tables: tuple[Any, ...], wi: np.ndarray, wo: np.ndarray, u: np.ndarray, rounds: int
) -> dict[str, dict[str, float]]:
    """Measure stages of calls, by call and stage: times of loops that have them less those of loops that do not."""
    normals, luminance, small, smaller, scaled, plain = tables
    n, symmetry = len(wi), brdf.symmetry[:2]
    located, values, value = np.empty((n, 5)), np.zeros((n, brdf.bands.count)), np.zeros((n, 1))
    loops.locate_pairs(wi, wo, *symmetry, located)
    theta, phi, x = (np.ascontiguousarray(located[:, of]) for of in (0, 1, slice(2, 4)))
    point, pdf = np.zeros((n, 3)), np.zeros(n)
    seconds = alternate(
        {
            "located": lambda: loops.locate_pairs(wi, wo, *symmetry, located),
            "inverted": lambda: loops.map_points(INVERT, normals, phi, theta, x, point),
            "bracket": lambda: loops.map_points(INVERT, small, phi, theta, x, point),
            "no bracket": lambda: loops.map_points(INVERT, smaller, phi, theta, x, point),
            "scale": lambda: loops.eval_located(located, scaled, value),
            "no scale": lambda: loops.eval_located(located, plain, value),
            "values": lambda: loops.eval_located(located, brdf.tables, values),
            "eval": lambda: loops.eval_pairs(wi, wo, *symmetry, True, brdf.tables, values),
            "pdf": lambda: loops.pdf_of_pairs(wi, wo, *symmetry, brdf.tables, luminance, pdf),
            "luminance": lambda: loops.map_points(SAMPLE, luminance, phi, theta, u, point),
            "normals": lambda: loops.map_points(SAMPLE, normals, phi, theta, u, point),
            "sample": lambda: loops.sample_directions(wi, u, *symmetry, brdf.tables, luminance, point, pdf),
        },
        rounds,
    )
    ns = {name: times[:, 0] / n * 1e9 for name, times in seconds.items()}  # [rounds] each
    bracket, scale = ns["bracket"] - ns["no bracket"], ns["scale"] - ns["no scale"]
    common = {
        "angles, half vectors": ns["located"],
        "bracket": bracket,
        "inversion": ns["inverted"] - bracket,
    }
    bands = {"ndf, sigma": scale, "bands": ns["values"] - ns["inverted"] - scale, "whole": ns["eval"]}
    calls = {
        "eval": common | bands,
        "pdf": common
        | {"luminance, Jacobian": ns["pdf"] - ns["located"] - ns["inverted"], "whole": ns["pdf"]},
        "sample": {
            "point of luminance": ns["luminance"],
            "visible normal": ns["normals"],
            "angles, directions": ns["sample"] - ns["luminance"] - ns["normals"],
            "whole": ns["sample"],
        },
    }
    return {
        call: {stage: float(np.median(of)) for stage, of in stages.items()} for call, stages in calls.items()
    }


def alternate(works: dict[str, Work], rounds: int) -> dict[str, np.ndarray]:
    """Processor and wall seconds (rounds, 2) of works, called in turn; the first round, which compiles, is left out."""
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in works}
    for _ in range(rounds + 1):
        for name, work in works.items():
            cpu, wall = time.process_time(), time.perf_counter()
            values = work()
            times[name].append((time.process_time() - cpu, time.perf_counter() - wall))
            del values
    return {name: np.array(seconds[1:]) for name, seconds in times.items()}


if __name__ == "__main__":
    main()
