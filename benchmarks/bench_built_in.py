"""The built-in library beside the files that it is made of: errors of completions, photographs and the map.

    python benchmarks/bench_built_in.py --files FOLDER --neural NEURAL_ZIP [--pictures-every K] [--json FILE]

The materials are published neural fits of RGL materials that are in neither library. Each is completed from noiseless
readings at the twelve geometries of an MA-T12, and from one simulated photograph in the studio (1 % noise, clipped),
and located on the map; errors are those of the ball in the judged lights (mean CIEDE2000), median and 90th percentile.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from bench_photo import STANDARD, rendered, sighting
from left_out import read_ma_t12
from neural_fits import read_neural_fits

import manifold as mf
from manifold.brdf import goniometer
from manifold.colour.lights import environment
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.completion import Completion
from manifold.io_rgl import write_bsdf
from manifold.model.comparison import brdf_errors


def main() -> None:
    """Print the errors by library."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--files", type=Path, required=True)
    parser.add_argument("--neural", type=Path, required=True)
    parser.add_argument("--pictures-every", type=int, default=1)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    light, found = environment("studio"), {}
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        mf.import_files(folder / "library.zarr", options.files)
        libraries = {"built_in": mf.Library("built-in"), "files": mf.Library(folder / "library.zarr")}
        names = set(libraries["files"].names)
        fits = [fit for name, fit in sorted(read_neural_fits(options.neural).items()) if name not in names]
        measured = [goniometer.measure(fit.plausible(), fit.name) for fit in fits]
        materials = [mf.MeasuredBRDF(file) for file in measured]
        paths = [folder / f"{file.name}_rgb.bsdf" for file in measured[:: options.pictures_every]]
        for path, file in zip(paths, measured[:: options.pictures_every], strict=True):
            write_bsdf(path, file)
        seen = [sighting(linear, STANDARD, light) for linear in rendered(paths, light)]
        for key, library in libraries.items():
            atoms, model = LibraryAtoms.of_library(library), mf.Manifold.fit(library, calibrate=False)
            of_values = atoms.in_values
            errors: dict[str, list[float]] = {"completion": [], "map": [], "photograph": []}
            for material, fit in zip(materials, fits, strict=True):
                completed = Completion.of(atoms, read_ma_t12(material, fit.name)).brdf
                errors["completion"].append(brdf_errors(material, completed).ball)
                place = model.embed(material)
                errors["map"].append(brdf_errors(material, model.predict(place.latent, place.colours)).ball)
            for material, one in zip(materials[:: options.pictures_every], seen, strict=True):
                errors["photograph"].append(brdf_errors(material, Completion.of(of_values, [one]).brdf).ball)
            found[key] = {
                task: [float(np.median(each)), float(np.percentile(each, 90))]
                for task, each in errors.items()
            } | {f"{task}_each": each for task, each in errors.items()}
            print(key, {task: found[key][task] for task in errors}, flush=True)
    result = found | {"materials": len(fits), "photographed": len(seen)}
    if options.json is not None:
        options.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
