"""Size of compact materials against their visible error, and codecs beside the one that is used.

    python benchmarks/bench_compact.py FILES_OR_FOLDERS... [--tolerance E] [--figure FILE] [--json FILE]

First, codecs for the values alone: each quantised one with the coarsest step of a search that keeps the tolerance (mean
CIEDE2000 of the ball, and the cube-root error that goes with it). Then the whole material, as a library stores it, at
several tolerances. Bytes are relative to the files'; errors are medians and maxima over the files. Pcodec is one of
zarr's codecs, and shown where the package `pcodec` is installed.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
from numcodecs.blosc import Blosc
from scipy.fft import dctn, idctn

from manifold.core.errors import LibraryError
from manifold.core.records import BsdfFile
from manifold.io_rgl import read_bsdf
from manifold.library.compacting import CUBE_ROOT_PER_BALL, _errors_from, encode
from manifold.library.importing import find_files

matplotlib.use("Agg")
from matplotlib import pyplot as plt

try:
    from pcodec import ChunkConfig, standalone
except ImportError:
    standalone = None

TOLERANCES = (1.0, 0.5, 0.2, 0.1, 0.05, 0.02)
STEPS = 0.08 * 2.0 ** -np.arange(0.0, 12.0, 0.5)  # relative to the root mean square of the norms of spectra
Coded = tuple[int, np.ndarray]  # bytes, and what they decode to


def zstd(values: np.ndarray) -> int:
    """Bytes after bit shuffling and zstd, as libraries do it."""
    flat = np.ascontiguousarray(values)
    return len(Blosc("zstd", 5, Blosc.BITSHUFFLE).encode(flat))


def pcodec(values: np.ndarray) -> int:
    """Bytes by pcodec."""
    return len(standalone.simple_compress(np.ascontiguousarray(values).reshape(-1), ChunkConfig()))


def differences(multiples: np.ndarray) -> np.ndarray:
    """Between neighbours along rows and columns, the last axes."""
    return np.diff(np.diff(multiples, axis=-1, prepend=0), axis=-2, prepend=0)


def components_of(roots: np.ndarray) -> np.ndarray:
    """Principal components (B, B) of cube roots (..., B), the largest first."""
    flat = roots.reshape(-1, roots.shape[-1])
    return np.linalg.eigh(flat.T @ flat)[1].T[::-1]


def quantised(
    roots: np.ndarray, step: float, *, basis: bool = True, delta: bool = True, dct: bool = False,
    size: Callable[[np.ndarray], int] = zstd,
) -> Coded:  # fmt: skip
    """Cube roots (P, T, H, W, B) as multiples of a step."""
    vectors = components_of(roots) if basis else np.eye(roots.shape[-1])
    coefficients = np.moveaxis(roots @ vectors.T, -1, 0)
    if dct:
        coefficients = dctn(coefficients, axes=(-2, -1), norm="ortho")
    multiples = np.rint(coefficients / step).astype(np.int32)
    used = np.flatnonzero(np.any(multiples, axis=(1, 2, 3, 4))) if basis else np.arange(len(vectors))
    count = 1 + int(used.max(initial=0))
    multiples, vectors = multiples[:count], vectors[:count]
    decoded = multiples * step
    if dct:
        decoded = idctn(decoded, axes=(-2, -1), norm="ortho")
    stored = size(differences(multiples) if delta else multiples)
    stored += zstd(vectors.astype(np.float16)) if basis else 0
    return stored, np.moveaxis(decoded, 0, -1) @ vectors


CODECS: dict[str, Callable[[np.ndarray, float], Coded]] = {
    "cube roots of bands, differences, zstd": lambda r, s: quantised(r, s, basis=False),
    "spectral basis, zstd": lambda r, s: quantised(r, s, delta=False),
    "spectral basis, differences, zstd": quantised,
    **(
        {}
        if standalone is None
        else {"spectral basis, differences, pcodec": lambda r, s: quantised(r, s, size=pcodec)}
    ),
    "spectral basis, cosine transform, zstd": lambda r, s: quantised(r, s, delta=False, dct=True),
}


def coarsest(file: BsdfFile, codec: Callable[[np.ndarray, float], Coded], tolerance: float) -> list[float]:
    """Bytes, ball and cube-root error of the coarsest step that keeps a tolerance; NaN where none does."""
    values, errors_of = np.moveaxis(file.spectra, 2, -1), _errors_from(file)
    roots = np.cbrt(values.astype(np.float64))
    is_lit, least = np.any(values != 0, axis=-1), 0.0 if values.min() >= 0.0 else -np.inf
    norm = np.sqrt(np.sum(roots**2) / np.count_nonzero(is_lit))
    for step in STEPS:
        stored, decoded = codec(roots, step * norm)
        found = np.where(is_lit[..., None], np.maximum(decoded, least), 0.0) ** 3
        errors = errors_of(replace(file, spectra=np.moveaxis(found.astype(np.float32), -1, 2)))
        if errors[0] <= tolerance and errors[1] <= CUBE_ROOT_PER_BALL * tolerance:
            return [stored, *errors]
    return [np.nan] * 3


def exact(file: BsdfFile) -> dict[str, list[float]]:
    """Codecs without a step: bytes, ball and cube-root error."""
    half = np.clip(file.spectra, -65504.0, 65504.0).astype(np.float16)
    errors = _errors_from(file)(replace(file, spectra=half.astype(np.float32)))
    return {
        "float32, zstd": [zstd(file.spectra), 0.0, 0.0],
        "float16, zstd": [zstd(half.view(np.uint16)), *errors],
    }


def whole(file: BsdfFile, tolerance: float) -> list[float]:
    """Bytes, ball and cube-root error of a whole material; NaN where no step keeps the tolerance."""
    try:
        compact = encode(file, tolerance)
    except LibraryError:
        return [np.nan] * 3
    stored = zstd(compact.coefficients) + sum(zstd(table) for table in compact.tables.values())
    return [stored, compact.accuracy.ball, compact.accuracy.cube_root]


def row(name: str, found: list[list[float]], total: int) -> dict[str, object]:
    """One row of a table, printed."""
    table = np.array(found)
    share, (ball, root), (worst, worst_root) = (
        float(table[:, 0].sum() / total), np.median(table[:, 1:], axis=0), table[:, 1:].max(axis=0),
    )  # fmt: skip
    print(
        f"{name:42} {share:8.4f} {1 / share:7.0f} : 1   {ball:5.3f} / {worst:5.3f}   {root:6.2%} / {worst_root:6.2%}",
        flush=True,
    )
    return {
        "name": name, "share": share, "ball": float(ball), "largest_ball": float(worst),
        "cube_root": float(root), "largest_cube_root": float(worst_root),
    }  # fmt: skip


def draw(rows: list[dict[str, object]], path: Path) -> None:
    """Size against error."""
    figure, axes = plt.subplots(figsize=(5.0, 3.5), layout="constrained")
    shares = [100.0 * float(r["share"]) for r in rows]  # type: ignore[arg-type]
    axes.loglog(shares, [r["ball"] for r in rows], "o-", label="median")
    axes.loglog(shares, [r["largest_ball"] for r in rows], "s--", label="largest")
    axes.set(xlabel="% of the files' bytes", ylabel="CIEDE2000 of the ball")
    axes.legend()
    figure.savefig(path, dpi=150)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sources", nargs="+", type=Path)
    parser.add_argument("--tolerance", type=float, default=0.2)
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    paths = find_files(options.sources)
    files, total = [read_bsdf(path) for path in paths], sum(path.stat().st_size for path in paths)
    values = sum(file.spectra.nbytes for file in files)
    print(f"{len(files)} files, {total / 1e6:.1f} MB, of which values {values / 1e6:.1f} MB")
    head = f"{'':8} {'':11} {'ball, median / max':15} {'cube root, median / max'}"
    print(f"\nvalues alone, tolerance {options.tolerance:g}\n{'codec':42} {head}")
    found = [exact(file) for file in files]
    codecs = [row(name, [each[name] for each in found], values) for name in found[0]]
    codecs += [
        row(name, [coarsest(file, codec, options.tolerance) for file in files], values)
        for name, codec in CODECS.items()
    ]
    print(f"\nwhole materials\n{'tolerance':42} {head}")
    curve = [row(f"{e:g}", [whole(file, e) for file in files], total) for e in TOLERANCES]
    if options.figure is not None:
        draw(curve, options.figure)
    if options.json is not None:
        options.json.write_text(json.dumps({"codecs": codecs, "curve": curve}, indent=2) + "\n")


if __name__ == "__main__":
    main()
