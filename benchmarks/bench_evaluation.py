"""Values per second of `MeasuredBRDF.eval_cos` and of Mitsuba's `measured` plugin, on the same pairs and bands.

Mitsuba evaluates four wavelengths at a time: 49 calls cover 195 bands. Both run warm, alternately, and the
median of the rounds counts. Prints a table and a ratio; --json FILE keeps it.
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

import numpy as np

from manifold.analytic import corpus
from manifold.brdf.measured import MeasuredBRDF
from manifold.directions import from_spherical
from manifold.io_rgl import read_bsdf, write_bsdf
from manifold.render import backend

TARGET = 4.0


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
        result = compare(path, arguments.pairs, arguments.rounds)
    result |= {"material": material.name, "llvm": library.name, "cores": os.cpu_count(), "target": TARGET}
    print(f"{material.name}, {arguments.pairs:,} pairs x 195 bands, {os.cpu_count()} cores, {library.name}")
    for key in ("manifold", "mitsuba"):
        print(f"  {key:<9} {result[f'{key}_values_per_second'] / 1e6:8.1f} million values/s")
    spread = f"rounds: {result['ratio_min']:.1f} to {result['ratio_max']:.1f}"
    print(f"  ratio     {result['ratio']:8.1f} ({spread}; target {TARGET:g})")
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=2) + "\n")


def compare(path: Path, pairs: int, rounds: int) -> dict[str, float]:
    """Alternate the two on random pairs over the hemisphere."""
    import drjit as dr

    mi = backend.mitsuba("spectral")
    rng = np.random.default_rng(0)
    wi, wo = (
        from_spherical(np.arccos(rng.random(pairs)), rng.uniform(-np.pi, np.pi, pairs)) for _ in range(2)
    )
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

    def manifold() -> np.ndarray:
        return brdf.eval_cos(wi, wo)

    times: dict[str, list[float]] = {"manifold": [], "mitsuba": []}
    for round_ in range(rounds + 1):
        for name, work in (("manifold", manifold), ("mitsuba", mitsuba)):
            start = time.perf_counter()
            values = work()
            if round_ > 0:  # the first round compiles
                times[name].append(time.perf_counter() - start)
            del values
    ratios = [b / a for a, b in zip(times["manifold"], times["mitsuba"], strict=True)]
    count = pairs * 195
    return {
        "manifold_values_per_second": count / statistics.median(times["manifold"]),
        "mitsuba_values_per_second": count / statistics.median(times["mitsuba"]),
        "ratio": statistics.median(ratios),
        "ratio_min": min(ratios),
        "ratio_max": max(ratios),
    }


if __name__ == "__main__":
    main()
