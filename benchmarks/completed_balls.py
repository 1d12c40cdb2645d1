"""Balls of materials: measured; completed from an MA-T12, with gloss beside it, and with three suggested readings more.

    python benchmarks/completed_balls.py library.zarr docs/images/completed-balls.png NAME ...

Each material is completed from the others of the library; the number under a ball is its ball error. Shown in
docs/explanation/completion.md.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from left_out import read_ma_t12
from lit_balls import lit_ball, save

from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.core.records import Array
from manifold.estimate import Completion, LibraryAtoms, suggest
from manifold.estimate.gloss import gloss_units
from manifold.formats.readings import Readings
from manifold.library.store import Library
from manifold.model import brdf_errors

SUGGESTED = 3
GLOSS_DEG = (20, 60)
SIZE = 110  # pixels across a ball
ROWS = ("measured", "12 readings", "with gloss", "3 more readings")


def readings_of(brdf: BRDF, name: str, wi: Array, wo: Array) -> Readings:
    """What an instrument without noise reads of a material."""
    nm = brdf.bands.wavelengths_nm
    return Readings(name, "", wi, wo, None if nm is None else np.array(nm), brdf.eval(wi, wo))


def completions(brdf: BRDF, name: str, others: LibraryAtoms) -> tuple[Completion, Completion, Completion]:
    """From the MA-T12's geometries, with gloss beside them, and with readings, each suggested by those before."""
    read = read_ma_t12(brdf, name)
    wi, wo = read.wi, read.wo
    first = found = Completion.of(others, read)
    glossy = Completion.of(others, replace(read, gloss=gloss_units(brdf, GLOSS_DEG)))
    for _ in range(SUGGESTED):
        following = suggest(others, 1, found)
        wi, wo = np.vstack([wi, following.wi]), np.vstack([wo, following.wo])
        found = Completion.of(others, readings_of(brdf, name, wi, wo))
    return first, glossy, found


def main() -> None:
    """Draw a column for each material."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("library", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("names", nargs="+", metavar="NAME")
    given = parser.parse_args()
    library = Library.open(given.library)
    atoms = LibraryAtoms.of_library(library)
    count = len(given.names)
    figure, axes = plt.subplots(
        len(ROWS), count, figsize=(1.4 * count, 6.2), squeeze=False, layout="constrained"
    )
    for column, name in zip(axes.T, given.names, strict=True):
        measured = MeasuredBRDF(library.read(name))
        made = completions(measured, name, atoms.without(library.names.index(name)))
        column[0].set_title(name.replace("_", " "), fontsize=9)
        for axis, brdf in zip(column, (measured, *(each.brdf for each in made)), strict=True):
            axis.imshow(lit_ball(brdf, SIZE, 16, 32))
            axis.axis("off")
            if brdf is not measured:
                error = brdf_errors(measured, brdf).ball
                axis.text(0.5, -0.02, f"{error:.1f}", transform=axis.transAxes, ha="center", va="top")
                print(name, f"{error:.2f}", flush=True)
    for axis, label in zip(axes[:, 0], ROWS, strict=True):
        axis.text(-0.06, 0.5, label, transform=axis.transAxes, rotation=90, ha="right", va="center")
    save(figure, given.output)


if __name__ == "__main__":
    main()
