"""How far maps of one library differ between installations.

    python benchmarks/bench_installations.py LIBRARY [--latent-dim Q] [--kind KIND] [--noise 0,1]

Embeds the library in new processes: as it is; with the matrix kernels that OpenBLAS has for other processors; with
functions that are compiled afresh; and with values that differ by 1e-12. A row for each: the largest distance of a
material from where the first has it, in length scales, after the best rotation; left-out errors, ball CIEDE2000 and
cube root, median / 90th percentile, and means; seconds. Kernels that this processor cannot run are said to have failed.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.linalg import orthogonal_procrustes

from manifold.brdf.measured import MeasuredBRDF
from manifold.core.records import Array
from manifold.library.store import Library
from manifold.model.manifold import Manifold
from manifold.model.settings import KINDS, Settings

NOISE = 1e-12
CORE_TYPES = ("Nehalem", "Haswell", "SkylakeX")


def embed(library: Path, settings: Settings, seed: int | None, target: Path) -> None:
    """Embed in this process, with values disturbed by noise of a seed, and keep latents and left-out errors."""
    Library.cache_get = lambda self, key: None  # type: ignore[method-assign]
    Library.cache_put = lambda self, key, arrays: None  # type: ignore[method-assign]
    if seed is not None:
        rng, evaluate = np.random.default_rng(seed), MeasuredBRDF.eval

        def disturbed(self: MeasuredBRDF, wi: Array, wo: Array) -> Array:
            f = evaluate(self, wi, wo)
            return f * (1.0 + NOISE * rng.normal(size=f.shape))

        MeasuredBRDF.eval = disturbed  # type: ignore[method-assign]
    start = time.perf_counter()
    model = Manifold.fit(Library.open(library), settings)
    assert model.left_out is not None
    errors = model.left_out.errors.known
    np.savez(target, X=model.X, seconds=time.perf_counter() - start, **errors)


def largest_distance(X: Array, other: Array) -> float:
    """Between places (N, Q) and others, after rotation or reflection."""
    X, other = X - X.mean(axis=0), other - other.mean(axis=0)
    rotation, _ = orthogonal_procrustes(X, other)
    return float(np.linalg.norm(X @ rotation - other, axis=1).max())


def main() -> None:
    """Print a table row by row."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("library", type=Path)
    parser.add_argument("--latent-dim", type=int, default=2)
    parser.add_argument("--kind", choices=KINDS, default="blend")
    parser.add_argument("--noise", default="0,1,2", help="seeds of the noise")
    parser.add_argument("--seed", type=int, help="embed in this process with this noise, with --target")
    parser.add_argument(
        "--target", type=Path, help="embed in this process, and write latents and errors here"
    )
    given = parser.parse_args()
    if given.target is not None:
        settings = Settings(kind=given.kind, latent_dim=given.latent_dim)
        embed(given.library, settings, given.seed, given.target)
        return
    first: Array | None = None
    print(
        "| installation | largest distance | ball | mean | cube root | mean | seconds |\n|---|---|---|---|---|---|---|"
    )
    with tempfile.TemporaryDirectory() as folder:
        cases: list[tuple[str, dict[str, str], list[str]]] = [("this one", {}, [])]
        cases += [(f"OPENBLAS_CORETYPE={core}", {"OPENBLAS_CORETYPE": core}, []) for core in CORE_TYPES]
        cases += [
            (f"values differ by 1e-12, seed {seed}", {}, ["--seed", seed]) for seed in given.noise.split(",")
        ]
        for name, environment, options in cases:
            target = Path(folder) / "found.npz"
            command = [sys.executable, __file__, *sys.argv[1:], *options, "--target", str(target)]
            if subprocess.run(command, env=os.environ | environment, check=False).returncode != 0:
                print(f"| {name} | failed | | | | | |", flush=True)
                continue
            with np.load(target) as found:
                first = found["X"] if first is None else first
                ball, cube_root = found["ball"], found["cube_root"]
                (b, b_90), (c, c_90) = np.quantile([ball, cube_root], (0.5, 0.9), axis=1).T
                apart, seconds = largest_distance(found["X"], first), float(found["seconds"])
                print(f"| {name} | {apart:.1g} | {b:.2f} / {b_90:.2f} | {ball.mean():.2f} | "
                      f"{c:.4f} / {c_90:.3f} | {cube_root.mean():.4f} | {seconds:.1f} |", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
