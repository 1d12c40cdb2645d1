"""Embedding a library and predicting from it: seconds, peak memory and bytes, beside a copy of the same bytes.

Every measurement runs in a process of its own, so that its peak memory is its own. The reference of the ratios is
the time that copying the library's spectra once in memory takes, in the same process.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from manifold.analytic import corpus
from manifold.core.pairs import RusinkiewiczGrid
from manifold.estimate import predictions
from manifold.library.importing import import_files
from manifold.library.store import Library
from manifold.model.manifold import Manifold, Settings

GRID_BLOCK = 65536  # direction pairs of the grid of Hikichi & Iwasaki evaluated at once


def embed(library: Path, kind: str) -> dict[str, float]:
    """From the library's files to a saved model, the Gram matrix not remembered from before."""
    opened = Library.open(library)
    opened.cache_put = lambda *_: None  # type: ignore[method-assign]
    opened.cache_get = lambda *_: None  # type: ignore[method-assign]
    start = time.perf_counter()
    model = Manifold.fit(opened, Settings(kind=kind), calibrate=False)
    seconds = time.perf_counter() - start
    model.save(model_path(library, kind))
    return {"seconds": seconds, "model_bytes": model_path(library, kind).stat().st_size}


def predict(library: Path, kind: str) -> dict[str, float]:
    """One prediction between two materials to a complete file; seconds after loading."""
    model, x = loaded(library, kind)
    with tempfile.TemporaryDirectory() as folder:
        seconds = [
            predictions.predict(model, x + 1e-3 * k, Path(folder) / "p_spec.bsdf").seconds for k in range(4)
        ]
    return {"first_seconds": seconds[0], "seconds": float(np.median(seconds[1:]))}


def published_grid(library: Path, kind: str) -> dict[str, float]:
    """One prediction at all direction pairs of the grid of Hikichi & Iwasaki and all bands, kept as float32."""
    model, x = loaded(library, kind)
    brdf = model.predict(x)
    grid = RusinkiewiczGrid.named("hikichi")
    values = np.zeros((grid.n_pairs, model.bands.count), np.float32)
    start, row = time.perf_counter(), 0
    for wi, wo, _ in grid.blocks(GRID_BLOCK):
        brdf.eval(wi, wo, out=values[row : row + len(wi)])
        row += len(wi)
    return {"seconds": time.perf_counter() - start, "values_bytes": values.nbytes}


MEASUREMENTS: dict[str, Callable[[Path, str], dict[str, float]]] = {
    "embed": embed, "predict": predict, "published_grid": published_grid,
}  # fmt: skip


def model_path(library: Path, kind: str) -> Path:
    """Where the benchmark keeps a model of a library."""
    return library.parent / f"{kind}.h5"


def loaded(library: Path, kind: str) -> tuple[Manifold, Any]:
    """A model with its materials in memory, and a latent between two of them."""
    model = Manifold.load(model_path(library, kind))
    model.prepare()
    return model, model.between(model.names[0], model.names[-1], 0.4)


def stored_bytes(library: Library) -> int:
    """Of all materials together."""
    return sum(library.attributes(name).bytes for name in library.names)


def reference_seconds(library: Path) -> float:
    """Copying the bytes of all spectra once in memory, the median of five."""
    source = np.ones(stored_bytes(Library(library)) // 8)
    times = []
    for _ in range(5):
        start = time.perf_counter()
        source.copy()
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def measure(library: Path, name: str, kind: str) -> dict[str, float]:
    """One measurement in a process of its own."""
    command = [sys.executable, __file__, str(library), "--only", name, "--kind", kind]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    result: dict[str, float] = json.loads(done.stdout)
    return result


def main() -> None:
    """Measure every kind of manifold on a library: a given one, or the built-in corpus."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "library", nargs="?", type=Path, help="a library.zarr; without it, the built-in corpus"
    )
    parser.add_argument("--json", type=Path)
    parser.add_argument("--only", choices=MEASUREMENTS, help=argparse.SUPPRESS)
    parser.add_argument("--kind", default="material", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.only:
        result = MEASUREMENTS[options.only](options.library, options.kind)
        result["peak_bytes"] = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        print(json.dumps(result))
        return
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "library.zarr"
        if options.library is None:
            corpus.write(Path(folder) / "corpus")
            import_files(library, [Path(folder) / "corpus"])
        else:
            library.symlink_to(options.library.resolve())
        stored = Library(library)
        size = stored_bytes(stored)
        reference = reference_seconds(library)
        results: dict[str, Any] = {"materials": len(stored), "stored_bytes": size}
        print(f"{len(stored)} materials, {size / 1e6:.0f} MB; copied in {reference:.3f} s")
        for kind in ("blend", "material"):
            for name in MEASUREMENTS:
                found = measure(library, name, kind)
                found["ratio"] = found["seconds"] / reference
                results[f"{name}, {kind}"] = found
                peak = found["peak_bytes"] / 1e9
                print(
                    f"{name:14} {kind:11} {found['seconds']:7.2f} s {found['ratio']:7.1f} x {peak:5.2f} GB",
                    flush=True,
                )
    if options.json:
        options.json.write_text(json.dumps(results, indent=2) + "\n")


if __name__ == "__main__":
    main()
