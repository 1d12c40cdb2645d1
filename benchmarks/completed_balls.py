"""Balls of materials: measured; completed from an MA-T12, with gloss beside it, and with three suggested readings more.

    python benchmarks/completed_balls.py library.zarr balls.png NAME ...

Each material is completed from the others of the library. Shown in docs/explanation/completion.md.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.estimate import Completion, LibraryAtoms, suggest
from manifold.estimate.gloss import gloss_units
from manifold.estimate.sources import FileSource
from manifold.formats.readings import Readings, geometry_ma_t12
from manifold.io_rgl import write_bsdf
from manifold.library.store import Library
from manifold.model.output_file import write_checked
from manifold.model.prediction import ClippedBRDF
from manifold.pictures import renders
from manifold.records import Array
from manifold.render import images
from manifold.render.render import RenderSettings

SUGGESTED = 3
GLOSS_DEG = (20, 60)


def readings_of(brdf: BRDF, name: str, wi: Array, wo: Array) -> Readings:
    """What an instrument without noise reads of a material."""
    nm = brdf.bands.wavelengths_nm
    return Readings(name, "", wi, wo, None if nm is None else np.array(nm), brdf.eval(wi, wo))


def completions(brdf: BRDF, name: str, others: LibraryAtoms) -> tuple[Completion, Completion, Completion]:
    """From the MA-T12's geometries, with gloss beside them, and with readings, each suggested by those before."""
    wi, wo = geometry_ma_t12()
    read = readings_of(brdf, name, wi, wo)
    first = found = Completion.of(others, read)
    glossy = Completion.of(others, replace(read, gloss=gloss_units(brdf, GLOSS_DEG)))
    for _ in range(SUGGESTED):
        following = suggest(others, 1, found)
        wi, wo = np.vstack([wi, following.wi]), np.vstack([wo, following.wo])
        found = Completion.of(others, readings_of(brdf, name, wi, wo))
    return first, glossy, found


def main() -> None:
    """Render the balls."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("library", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("names", nargs="+", metavar="NAME")
    given = parser.parse_args()
    library = Library.open(given.library)
    atoms = LibraryAtoms.of_library(library)
    settings = RenderSettings(size=192, samples=72)
    columns = []
    with tempfile.TemporaryDirectory() as folder:
        file, picture = Path(folder) / "ball_spec.bsdf", Path(folder) / "ball.png"
        for name in given.names:
            others = atoms.without(library.names.index(name))
            balls = []
            for found in (None, *completions(MeasuredBRDF(library.read(name)), name, others)):
                if found is None:
                    write_bsdf(file, library.read(name))
                else:
                    write_checked(file, ClippedBRDF(found.brdf))
                renders.render(FileSource(file), picture, settings)
                balls.append(images.read_image(picture))
            columns.append(np.vstack(balls))
    images.write_image(given.output, np.hstack(columns))


if __name__ == "__main__":
    main()
