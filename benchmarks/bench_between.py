"""Predictions halfway between two materials, judged by the material that exists there.

    python benchmarks/bench_between.py FOLDER [--json FILE]      # of measured RGB .bsdf files

Six families of three materials differ in roughness (geometric means), or in the mixing ratio of two paints
(Kubelka-Munk). The outer two join every third of the measured files in a library; no method sees the middle one. It is
predicted halfway: on the map between their places, on the walk between them, by the mean of their values (eq. 23 of
Hikichi & Iwasaki with alpha = 1/2), and by the published GPLVM and one of cube roots at the middle of their latents.
*best* is the best of the points at 0.4, 0.5 and 0.6. The families are synthetic: analytic models, measured with noise
by the virtual goniometer.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from manifold.analytic.corpus import Material, Recipe, measure
from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import Plastic, RoughConductor
from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.colour import metal_ior
from manifold.colour.reflectances import diffuse_reflectance
from manifold.core.records import Array, Bands
from manifold.io_rgl import write_bsdf
from manifold.library.importing import import_files
from manifold.library.store import Library
from manifold.model.comparison import brdf_errors
from manifold.model.manifold import Manifold
from manifold.model.settings import Settings

STEPS = (0.5, 0.4, 0.6)


def metal(name: str, alpha: float) -> Recipe:
    """A rough metal."""

    def recipe(bands: Bands) -> BRDF:
        return RoughConductor(GGX.isotropic(alpha), *metal_ior(name, np.array(bands.wavelengths_nm)), bands)

    return recipe


def paint(alpha: float, first: str, second: str, ratio: float) -> Recipe:
    """A varnished paint mixed of two, a share `ratio` of the second, by absorption over scattering."""

    def absorption(spectrum: str, bands: Bands) -> Array:
        R = np.clip(diffuse_reflectance(spectrum, np.array(bands.wavelengths_nm)), 0.01, 0.97)
        return (1.0 - R) ** 2 / (2.0 * R)

    def recipe(bands: Bands) -> BRDF:
        a = (1.0 - ratio) * absorption(first, bands) + ratio * absorption(second, bands)
        R = 1.0 + a - np.sqrt(a * a + 2.0 * a)
        return Plastic(GGX.isotropic(alpha), np.array(1.5), R, bands)

    return recipe


RED, BLUE, WHITE, YELLOW = "ohta/red", "ohta/blue", "ohta/white 9.5 (.05 D)", "ohta/orange yellow"
FAMILIES: dict[str, tuple[Recipe, Recipe, Recipe]] = {
    "gold, roughness 0.1 to 0.4": (metal("Au", 0.1), metal("Au", 0.2), metal("Au", 0.4)),
    "aluminium, roughness 0.15 to 0.35": (metal("Al", 0.15), metal("Al", 0.23), metal("Al", 0.35)),
    "red plastic, roughness 0.05 to 0.2": (
        paint(0.05, RED, RED, 0.0), paint(0.1, RED, RED, 0.0), paint(0.2, RED, RED, 0.0),
    ),
    "blue plastic, roughness 0.15 to 0.6": (
        paint(0.15, BLUE, BLUE, 0.0), paint(0.3, BLUE, BLUE, 0.0), paint(0.6, BLUE, BLUE, 0.0),
    ),
    "white and red paint, mixed": (
        paint(0.15, WHITE, RED, 0.0), paint(0.15, WHITE, RED, 0.5), paint(0.15, WHITE, RED, 1.0),
    ),
    "yellow and blue paint, mixed": (
        paint(0.3, YELLOW, BLUE, 0.0), paint(0.3, YELLOW, BLUE, 0.5), paint(0.3, YELLOW, BLUE, 1.0),
    ),
}  # fmt: skip


def paths(library: Library) -> dict[str, Callable[[float], BRDF]]:
    """The methods, as functions of the step from the first end to the second."""
    fitted = {
        "map": Settings(),
        "published": Settings("gplvm", 2, "identity"),
        "gplvm": Settings("gplvm", 2),
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        models = {name: Manifold.fit(library, s, calibrate=False) for name, s in fitted.items()}

    def on_line(model: Manifold) -> Callable[[float], BRDF]:
        return lambda t: model.predict(model.between("end_a", "end_b", t))

    own = models["map"]
    found = {name: on_line(model) for name, model in models.items()}
    found["walk"] = lambda t: own.interpolate("end_a", "end_b", t)
    found["eq_23"] = lambda t: own.linear("end_a", "end_b", 1.0 - t)
    return found


def main() -> None:
    """Print and keep a row per family and method."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument(
        "--seconds",
        type=float,
        default=np.inf,
        help="processor seconds after which to stop; run again to continue",
    )
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    kept = json.loads(asked.json.read_text()) if asked.json and asked.json.exists() else {}
    rows: dict[str, dict[str, list[float]]] = {method: row["each"] for method, row in kept.items()}
    sources = sorted(asked.folder.glob("*.bsdf"))[::3]
    for family, recipes in FAMILIES.items():
        if any(family in each for each in rows.values()):
            continue
        names = ("end_a", "middle", "end_b")
        files = {
            name: measure(Material(name, "metal", recipe), rgb=True)
            for name, recipe in zip(names, recipes, strict=True)
        }
        truth = MeasuredBRDF(files.pop("middle"))
        with tempfile.TemporaryDirectory() as folder:
            for name, file in files.items():
                write_bsdf(Path(folder, f"{name}_rgb.bsdf"), file)
            ends = sorted(Path(folder).glob("*.bsdf"))
            import_files(Path(folder, "library.zarr"), [*sources, *ends])
            for method, at in paths(Library.open(Path(folder, "library.zarr"))).items():
                found = [brdf_errors(truth, at(t)) for t in STEPS]
                balls, roots = [e.ball for e in found], [e.cube_root for e in found]
                each = rows.setdefault(method, {})
                each[family] = [float(x) for x in (balls[0], min(balls), roots[0], min(roots))]
                print(f"{family}: {method} {each[family]}", flush=True)
        if asked.json:
            asked.json.write_text(json.dumps(summary(rows), indent=1) + "\n")
        if time.process_time() > asked.seconds:
            break
    for method, found in summary(rows).items():
        print(method, {k: v for k, v in found.items() if k not in ("each", "halfway")})


def summary(rows: dict[str, dict[str, list[float]]]) -> dict[str, Any]:
    """Median and largest of every error over families."""
    kinds = ("ball", "best_ball", "cube_root", "best_cube_root")
    return {
        method: {"each": each, "halfway": {family: [row[0], row[2]] for family, row in each.items()}}
        | {
            kind: [float(np.median([row[k] for row in each.values()])), max(row[k] for row in each.values())]
            for k, kind in enumerate(kinds)
        }
        for method, each in rows.items()
    }


if __name__ == "__main__":
    main()
