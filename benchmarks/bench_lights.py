"""How materials look in lights that no fit sees: reconstructions of left-out files, and fits, in the judged panel.

    python benchmarks/bench_lights.py FOLDER                   # of .bsdf files of one kind
    python benchmarks/bench_lights.py FOLDER --methods reconstruct numbers fit --json FILE

CIEDE2000 of the ball by light, in the mean of the lights and in the worst of them, median / 90th percentile over files;
Delta E_ITP in the mean. Files left out take no part in their reconstruction; fits have seen the file they are of.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured_cells import fill_unmeasured
from manifold.colour import panel
from manifold.core.metrics import Errors
from manifold.core.records import BsdfFile
from manifold.fit.principled import fit_bsdf
from manifold.io_rgl import read_bsdf
from manifold.library.importing import import_files
from manifold.library.store import Library
from manifold.model.location import reconstruct_file
from manifold.render.fitted_brdf import FittedBRDF


def reconstructed(numbers: int | None, folder: Path) -> Callable[[BsdfFile], BRDF]:
    """Reconstructions from the other files of a library in a folder."""

    def make(file: BsdfFile) -> BRDF:
        return reconstruct_file(Library(folder), file, [file.name], numbers=numbers).brdf

    return make


def fitted(file: BsdfFile) -> BRDF:
    """The `principled` of a file."""
    found = fit_bsdf(file)
    return FittedBRDF.of(found.family, found.values, found.bands, found.spectra, found.rotation_deg)


def errors(brdf: BRDF, file: BsdfFile) -> Errors[float]:
    """Of what was made of a file."""
    lights, truth = panel.judged(), MeasuredBRDF(fill_unmeasured(file))
    values = [np.maximum(one.eval(lights.wi, lights.wo), 0.0) for one in (brdf, truth)]
    return lights.errors(values[0], values[1], truth.bands)


def row(found: list[Errors[float]]) -> dict[str, tuple[float, float]]:
    """Median and 90th percentile over files, by column."""
    columns = {name: [one.lights[name] for one in found] for name in found[0].lights}
    columns |= {"mean": [one.ball for one in found], "worst": [one.worst for one in found]}
    columns |= {"mean ITP": [one.ball_itp for one in found]}
    return {
        name: (round(float(np.median(each)), 3), round(float(np.percentile(each, 90)), 3))
        for name, each in columns.items()
    }


def main() -> None:
    """Print the table, in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--methods", nargs="+", default=["reconstruct", "numbers", "fit"])
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    files, rows = sorted(options.folder.glob("*.bsdf")), dict[str, dict[str, object]]()
    with TemporaryDirectory() as scratch:
        library = Path(scratch) / "library.zarr"
        import_files(library, files)
        methods = {
            "reconstruct": reconstructed(None, library),
            "numbers": reconstructed(12, library),
            "fit": fitted,
        }
        for method in options.methods:
            found, start = [], time.perf_counter()
            for path in files:
                found.append(errors(methods[method](file := read_bsdf(path)), file))
                print(f"{method} {file.name}: {found[-1]}", flush=True)
            seconds = (time.perf_counter() - start) / len(files)
            rows[method] = {"files": len(files), "seconds": round(seconds, 2), **row(found)}
    columns = [name for name in next(iter(rows.values())) if name not in ("files", "seconds")]
    print("\n| |", " | ".join(columns), "| seconds |\n|---" + "|---" * (len(columns) + 1) + "|")
    for method, made in rows.items():
        cells = ["{:.2f} / {:.2f}".format(*made[name]) for name in columns]  # type: ignore[misc]
        print(f"| {method} |", " | ".join(cells), f"| {made['seconds']} |")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
