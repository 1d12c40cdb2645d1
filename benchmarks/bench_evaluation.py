"""Values per second of `MeasuredBRDF.eval_cos` and of Mitsuba's `measured` plugin, on the same pairs and bands.

Mitsuba evaluates four wavelengths at a time: 49 calls cover 195 bands. It keeps memory from call to call; `manifold`
is timed with new memory, as `eval_cos` returns it, and with `out=` in double and in single precision; and a weighted
sum of several files as predictions evaluate it, in which the values of every file count. The pairs are random ones, of
which each reads another place of the file, then neighbours in the grid of Hikichi & Iwasaki. All run warm, alternately,
and the medians of the rounds count. Prints a table of ratios; --json FILE keeps them.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from manifold.analytic import corpus
from manifold.brdf.measured import MeasuredBRDF
from manifold.core.directions import from_spherical
from manifold.core.pairs import RusinkiewiczGrid
from manifold.io_rgl import read_bsdf, write_bsdf
from manifold.model.combination import Combination
from manifold.model.prediction import PredictedBRDF
from manifold.registries import MAPPINGS
from manifold.render import backend

TARGET = 15.0
SUMMED = 8  # files of a weighted sum


def main() -> None:
    """Measure, print, and leave with 1 if there is nothing to compare with."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--material", default="syn_satin_gold")
    parser.add_argument("--pairs", type=int, default=100_000)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    chosen = backend.choose()
    if chosen.library is None:
        print(f"{chosen.advice or 'scalar was asked for'}; there is nothing to compare with", file=sys.stderr)
        sys.exit(1)
    library = chosen.library
    material = next(m for m in corpus.isotropic_materials() if m.name == arguments.material)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{material.name}_spec.bsdf"
        write_bsdf(path, corpus.measure(material))
        results = {
            kind: compare(path, *of, arguments.rounds) for kind, of in pairs_of(arguments.pairs).items()
        }
    result = {
        "material": material.name, "llvm": library.name, "cores": os.cpu_count(), "target": TARGET, "pairs": results,
    }  # fmt: skip
    print(f"{material.name}, {arguments.pairs:,} pairs x 195 bands, {os.cpu_count()} cores, {library.name}")
    for kind, methods in results.items():
        print(f"{kind} pairs")
        for name, of in methods.items():
            spread = f"{of['ratio_min']:.1f} to {of['ratio_max']:.1f}"
            speed = of["values_per_second"] / 1e6
            print(f"  {name:<24} {speed:8.1f} million values/s, {of['ratio']:5.1f} times ({spread})")
    print(f"  target {TARGET:g} times Mitsuba")
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=2) + "\n")


def pairs_of(count: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Pairs (count, 3) twice: random ones over the hemisphere, and a run of a grid."""
    rng = np.random.default_rng(0)
    wi, wo = (
        from_spherical(np.arccos(rng.random(count)), rng.uniform(-np.pi, np.pi, count)) for _ in range(2)
    )
    grid = RusinkiewiczGrid.named("hikichi").pairs()
    first = (len(grid) - count) // 3
    run = grid[first : first + count]
    return {"random": (wi, wo), "neighbouring": (run.wi, run.wo)}


def compare(path: Path, wi: np.ndarray, wo: np.ndarray, rounds: int) -> dict[str, Any]:
    """Alternate them on the same pairs."""
    import drjit as dr

    mi, pairs = backend.mitsuba("spectral"), len(wi)
    file = read_bsdf(path)
    brdf = MeasuredBRDF(file)
    plugin = mi.load_dict({"type": "measured", "filename": str(path)})
    context = mi.BSDFContext()
    outgoing = mi.Vector3f(*wo.T.astype(np.float32))
    interaction = mi.SurfaceInteraction3f()
    interaction.wi = mi.Vector3f(*wi.T.astype(np.float32))
    bands = np.append(file.wavelengths_nm, file.wavelengths_nm[-1]).reshape(-1, 4)  # 196: the last one twice
    dr.eval(outgoing, interaction.wi)

    def mitsuba() -> np.ndarray:
        values = []
        for four in bands:
            interaction.wavelengths = mi.Spectrum(*(dr.opaque(mi.Float, float(w)) for w in four))
            value = plugin.eval(context, interaction, outgoing)
            dr.eval(value)
            values.append(value)
        dr.sync_thread()
        return values

    double, single = (np.zeros((pairs, 195), dtype) for dtype in (np.float64, np.float32))
    several = [MeasuredBRDF(file) for _ in range(SUMMED)]  # each with tables of its own
    summed = PredictedBRDF(several, Combination(MAPPINGS["identity"], np.full(SUMMED, 1.0 / SUMMED)))
    works = {
        "mitsuba": mitsuba,
        "new memory": lambda: brdf.eval_cos(wi, wo),
        "out= in double precision": lambda: brdf.eval_cos(wi, wo, out=double),
        "out= in single precision": lambda: brdf.eval_cos(wi, wo, out=single),
        (of_several := f"a sum of {SUMMED} files"): lambda: summed.eval(wi, wo, out=single),
    }
    counts = {of_several: SUMMED}
    times: dict[str, list[float]] = {name: [] for name in works}
    for round_ in range(rounds + 1):
        for name, work in works.items():
            start = time.perf_counter()
            values = work()
            if round_ > 0:  # the first round compiles
                times[name].append(time.perf_counter() - start)
            del values
    methods = {}
    for name, seconds in times.items():
        count = counts.get(name, 1)
        ratios = count * np.array(times["mitsuba"]) / seconds
        methods[name] = {
            "values_per_second": count * pairs * 195 / statistics.median(seconds),
            "ratio": float(np.median(ratios)),
            "ratio_min": float(ratios.min()),
            "ratio_max": float(ratios.max()),
        }
    return methods


if __name__ == "__main__":
    main()
