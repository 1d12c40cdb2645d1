"""Balls of all materials of a folder, each left out: measured, on the map of the others, and reconstructed from them.

    python benchmarks/left_out_balls.py FOLDER docs/images/left-out-balls.png

FOLDER holds `.bsdf` files in RGB. The material with the largest error on the map comes first; the numbers under a ball
are its ball error and its FLIP against the measured one. Shown in docs/explanation/accuracy.md.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from left_out import predict
from lit_balls import flip, lit_ball, save

import manifold as mf
from manifold.core.records import Array
from manifold.io_rgl import material_name
from manifold.model import brdf_errors

SIZE = 84  # pixels across a ball
PER_ROW = 10
ROWS = ("measured", "map", "reconstruct")


def balls_of(library: Path, path: Path) -> tuple[list[Array], list[tuple[float, float]]]:
    """Return the balls of ROWS for a file, and the ball error and FLIP of the last two."""
    measured = mf.MeasuredBRDF(mf.read_bsdf(path))
    model, predicted = predict(library, measured, material_name(path))
    described = (predicted, model.reconstruct(measured))
    balls = [lit_ball(brdf, SIZE, 20, 32) for brdf in (measured, *described)]
    alike = [flip(balls[0], ball) for ball in balls[1:]]
    errors = [brdf_errors(measured, brdf).ball for brdf in described]
    return balls, list(zip(errors, alike, strict=True))


def main() -> None:
    """Draw all materials, ten beside each other."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("output", type=Path)
    given = parser.parse_args()
    paths = sorted(given.folder.glob("*_rgb.bsdf"))
    drawn = []
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "library.zarr"
        mf.import_files(library, paths)
        for path in paths:
            drawn.append((material_name(path), *balls_of(library, path)))
            print(drawn[-1][0], *(f"{error:.2f} {alike:.3f}" for error, alike in drawn[-1][2]), flush=True)
    drawn.sort(key=lambda each: -each[2][0][0])
    all_errors = np.array([errors for _, _, errors in drawn])  # materials, rows, kinds
    for row, errors in zip(ROWS[1:], np.swapaxes(all_errors, 0, 1), strict=True):
        for kind, values in zip(("CIEDE2000", "FLIP"), errors.T, strict=True):
            print(row, kind, "median {:.3g}, 90th percentile {:.3g}".format(*np.percentile(values, (50, 90))))
    blocks = -(-len(drawn) // PER_ROW)
    figure, axes = plt.subplots(3 * blocks, PER_ROW, figsize=(10.4, 3.65 * blocks), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.01, h_pad=0.01, wspace=0.0, hspace=0.0)
    for axis in axes.flat:
        axis.axis("off")
    for k, (name, balls, errors) in enumerate(drawn):
        block, column = divmod(k, PER_ROW)
        for axis, ball, error in zip(
            axes[3 * block : 3 * block + 3, column], balls, (None, *errors), strict=True
        ):
            axis.imshow(ball)
            if error is not None:
                off, alike = error
                label = f"{off:.1f}, {alike:.3f}"
                axis.text(0.5, -0.02, label, transform=axis.transAxes, ha="center", va="top", fontsize=8)
        axes[3 * block, column].set_title(name.replace("_", " "), fontsize=6)
        if column == 0:
            for axis, label in zip(axes[3 * block : 3 * block + 3, 0], ROWS, strict=True):
                axis.text(-0.08, 0.5, label, transform=axis.transAxes, rotation=90, ha="right", va="center")
    save(figure, given.output, 80)


if __name__ == "__main__":
    main()
