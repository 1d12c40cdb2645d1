"""What a render of the material ball costs: a measured file, a predicted file, and the plugin `manifold`.

256 x 256 pixels, 64 samples, the synthetic corpus of 51 spectral materials, a latent between two of them. All run warm
and by turns in one process, and the median round counts; a ratio of processor times stands beside that of wall-clock
times, which other programs on the machine disturb. The scalar renderer runs in a process of its own.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from manifold.analytic import corpus
from manifold.estimate import predictions
from manifold.library.importing import import_files
from manifold.library.store import Library
from manifold.model.manifold import Manifold
from manifold.model.settings import GplvmSettings
from manifold.render import backend, images, scenes
from manifold.render.render import RenderSettings, render_bsdf

PAIR = ("syn_satin_gold", "syn_metallic_gold")
TARGETS = {"predicted file": 1.3, "plugin": 12.0, "plugin, tolerance": 4.0, "scalar, predicted file": 10.0}

_SCALAR = """
import json, sys, time
from manifold.render.render import RenderSettings, render_bsdf
material, settings = {"type": "measured", "filename": sys.argv[1]}, RenderSettings(int(sys.argv[2]), int(sys.argv[3]))
render_bsdf(material, False, RenderSettings(16, 1))
start = time.perf_counter(), time.process_time()
render_bsdf(material, False, settings)
print(json.dumps([time.perf_counter() - start[0], time.process_time() - start[1]]))
"""


def main() -> None:
    """Measure, print, keep."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--tolerance", type=float, default=0.01)
    parser.add_argument("--library", type=Path, help="of spectral materials; the synthetic corpus if none")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    if not backend.choose().is_llvm:
        sys.exit(f"{backend.choose().advice}; there is nothing to compare with")
    with tempfile.TemporaryDirectory() as folder:
        library = arguments.library or make_library(Path(folder))
        result = compare(Path(folder), library, arguments)
    print(f"{arguments.size} x {arguments.size}, {arguments.samples} samples, {os.cpu_count()} cores")
    print(f"  {'':<32}{'wall s':>8}{'ratio':>8}{'CPU s':>8}{'ratio':>8}{'target':>8}")
    for name, row in result["rows"].items():
        target = f"{TARGETS[name]:8.1f}" if name in TARGETS else ""
        print(
            f"  {name:<32}{row['wall']:8.2f}{row['ratio']:8.2f}{row['cpu']:8.2f}{row['cpu_ratio']:8.2f}{target}"
        )
    left = result["left_out"]
    print(
        f"  tolerance {arguments.tolerance:g}: {left['kept']} of {left['all']} materials, error {left['error']:.3g}, "
        f"CIEDE2000 on the ball {left['ciede2000']:.2f} in the mean (noise alone: {left['noise']:.2f})"
    )
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=2) + "\n")


def make_library(folder: Path) -> Path:
    """The synthetic corpus as a library."""
    corpus.write(folder / "corpus")
    import_files(folder / "library.zarr", [folder / "corpus"])
    return folder / "library.zarr"


def compare(folder: Path, library: Path, arguments: argparse.Namespace) -> dict:
    """Seconds per picture, and what leaving materials out changes."""
    path = folder / "model.h5"
    model = Manifold.fit(Library.open(library), GplvmSettings(), calibrate=False)
    model.save(path)
    latent = model.between(*PAIR, 0.5)
    predicted, measured = folder / "predicted_spec.bsdf", folder / "measured_spec.bsdf"
    predictions.predict(model, latent, predicted)
    predictions.predict(model, model.latent(PAIR[0]), measured)
    plugin = {"type": "manifold", "model": str(path), "latent": ",".join(repr(float(v)) for v in latent)}
    materials = {
        "measured file": {"type": "measured", "filename": str(measured)},
        "predicted file": {"type": "measured", "filename": str(predicted)},
        "plugin": plugin,
        "plugin, tolerance": plugin | {"tolerance": arguments.tolerance},
    }
    mi = backend.mitsuba("spectral")
    loaded = {name: mi.load_dict(material) for name, material in materials.items()}
    del model
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in materials}
    pictures = {}
    for turn in range(arguments.rounds + 1):  # the first compiles
        for name, bsdf in loaded.items():
            settings = RenderSettings(arguments.size, arguments.samples, seed=turn)
            start = time.perf_counter(), time.process_time()
            pictures[name, turn] = render_bsdf(bsdf, False, settings)
            if turn:
                times[name].append((time.perf_counter() - start[0], time.process_time() - start[1]))
    scalar = [sys.executable, "-c", _SCALAR, str(predicted), str(arguments.size), str(arguments.samples)]
    environment = os.environ | {backend.RENDERER_VARIABLE: "scalar"}
    done = subprocess.run(scalar, env=environment, capture_output=True, text=True, check=True)
    times["scalar, predicted file"] = [tuple(json.loads(done.stdout))]
    rows = {}
    for name, rounds in times.items():
        wall, cpu = (statistics.median(column) for column in zip(*rounds, strict=True))
        rows[name] = {"wall": wall, "cpu": cpu}
        rows[name] |= {
            "ratio": wall / rows["measured file"]["wall"],
            "cpu_ratio": cpu / rows["measured file"]["cpu"],
        }
    mixture = loaded["plugin, tolerance"].mixture
    ball = scenes.ball_interior(arguments.size, 0.03)
    display = {name: images.tone_map(picture) for name, picture in pictures.items()}
    last = arguments.rounds

    def difference(a: tuple[str, int], b: tuple[str, int]) -> float:
        return float(np.mean(images.ciede2000_map(display[a], display[b])[ball]))

    left_out = {
        "tolerance": arguments.tolerance,
        "kept": len(mixture.names),
        "all": len(mixture.names) + mixture.left_out,
        "error": mixture.left_out_error,
        "ciede2000": difference(("plugin", last), ("plugin, tolerance", last - 1)),
        "noise": difference(("plugin", last), ("plugin", last - 1)),
    }
    return {"rows": rows, "left_out": left_out, "size": arguments.size, "samples": arguments.samples}


if __name__ == "__main__":
    main()
