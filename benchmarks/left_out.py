"""Materials of a folder, each left out of the library that predicts or completes it: steps that scripts share."""

from __future__ import annotations

import argparse
import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import manifold as mf
from manifold.brdf.interface import BRDF
from manifold.brdf.measured import values_at
from manifold.core.directions import to_spherical
from manifold.core.metrics import Errors
from manifold.core.pairs import RusinkiewiczGrid
from manifold.core.records import Array
from manifold.estimate import Completion, LibraryAtoms
from manifold.estimate.expected import errors_of
from manifold.formats import Readings, geometry_ma_t12
from manifold.io_rgl import material_name


@dataclass(frozen=True)
class Given:
    """Arguments of a script: `.bsdf` files in RGB by name, the picture to write, and the materials to draw."""

    paths: dict[str, Path]
    output: Path
    names: list[str]

    @classmethod
    def parse(cls, description: str | None) -> Given:
        """Parse FOLDER OUTPUT NAME ..."""
        parser = argparse.ArgumentParser(
            description=description, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        parser.add_argument("folder", type=Path)
        parser.add_argument("output", type=Path)
        parser.add_argument("names", nargs="+", metavar="NAME")
        given = parser.parse_args()
        paths = {material_name(path): path for path in sorted(given.folder.resolve().glob("*_rgb.bsdf"))}
        return cls(paths, given.output, given.names)


def read_ma_t12(brdf: BRDF, name: str) -> Readings:
    """Return noiseless readings of a material at the twelve geometries of an MA-T12."""
    wi, wo = geometry_ma_t12()
    nm = brdf.bands.wavelengths_nm
    return Readings(name, "simulated", wi, wo, None if nm is None else np.array(nm), brdf.eval(wi, wo))


def write_ma_t12(path: Path, brdf: BRDF) -> Array:
    """Write such readings of an RGB material as a table; return their values (12, 3) in 1/sr."""
    read = read_ma_t12(brdf, "")
    angles = [np.rad2deg(angle) for w in (read.wi, read.wo) for angle in to_spherical(w)]
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["theta_i (deg)", "phi_i (deg)", "theta_o (deg)", "phi_o (deg)", "R", "G", "B"])
        table.writerows(np.column_stack([*angles, read.values]).round(6).tolist())
    return read.values


def errors_of_completion(atoms: LibraryAtoms, m: int, completion: Completion) -> Errors[float]:
    """Return errors of a completion of material m in the bands of the atoms.

    Cube-root and linear errors are those at all 45 x 23 x 12 pairs of the default grid, not at one in six as in
    calibrations.
    """
    pairs = RusinkiewiczGrid.named("default").pairs()
    f, f_star = values_at(atoms.materials[m], pairs), completion.brdf.eval(pairs.wi, pairs.wo)
    look = errors_of(atoms, m, completion.on_grid, completion.on_ball)
    return look | Errors.of_values(np.maximum(f, 0.0), f_star, pairs.cosines)


def complete(atoms: LibraryAtoms, brdf: BRDF, name: str) -> BRDF:
    """Complete a material from such readings by the other materials of a library."""
    others = atoms.without(atoms.names.index(name))
    return Completion.of(others, read_ma_t12(brdf, name)).brdf


def predict(library: Path, brdf: mf.MeasuredBRDF, name: str) -> tuple[mf.Manifold, BRDF]:
    """Embed the other materials of a library; return their map, and its prediction where a material is located."""
    model = mf.Manifold.fit(library, names=set(mf.Library.open(library).names) - {name}, calibrate=False)
    located = model.embed(brdf)
    return model, model.predict(located.latent, located.colours)
