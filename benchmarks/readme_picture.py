"""Readings, the BRDF completed from them, and its export as three.js draws it: the first picture of README.md.

    python benchmarks/readme_picture.py FOLDER docs/images/readings-to-engine.png NAME ...

FOLDER holds `.bsdf` files in RGB. Of each material the twelve geometries of an MA-T12 are evaluated; it is completed
from all others by `manifold complete`, exported by `manifold export`, and drawn in the studio: completed, measured,
and in three.js, which needs its npm package as tests/helpers/three_js.py says.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tools"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from engines.balls import Light, y_up
from helpers.browser import chromium
from helpers.three_js import ThreeJs, node_modules
from left_out import Given, write_ma_t12
from lit_balls import flip, lit_ball

import manifold as mf
from manifold.colour import ball_colours
from manifold.colour.conversion import encode_srgb
from manifold.formats.readings import MA_T12_NAMES
from manifold.model import brdf_errors

SIZE = 240  # pixels across a ball
LIGHT = Light.named("studio 0")


def manifold(folder: Path, *arguments: str) -> None:
    """Run a command in a folder."""
    subprocess.run([sys.executable, "-m", "manifold", *arguments], cwd=folder, check=True)


def main() -> None:
    """Draw a row for each material."""
    given = Given.parse(__doc__)
    count = len(given.names)
    figure, axes = plt.subplots(
        count,
        4,
        figsize=(11, 2.75 * count),
        squeeze=False,
        width_ratios=(1.35, 1, 1, 1),
        layout="constrained",
    )
    with tempfile.TemporaryDirectory() as temporary, chromium() as browser:
        three, folder = ThreeJs(browser, node_modules()), Path(temporary)
        for row, name in zip(axes, given.names, strict=True):
            others = [str(path) for other, path in given.paths.items() if other != name]
            measured = mf.MeasuredBRDF(mf.read_bsdf(given.paths[name]))
            f = write_ma_t12(folder / f"{name}.csv", measured)
            made = f"{name}-made_rgb.bsdf"
            manifold(folder, "import", *others, "--library", f"{name}.zarr")
            manifold(folder, "complete", f"{name}.csv", "--unit", "brdf", "--library", f"{name}.zarr",
                     "-o", made, "--json", "made.json")  # fmt: skip
            manifold(folder, "export", made, "-o", f"{name}.glb")
            completed = mf.MeasuredBRDF(mf.read_bsdf(folder / made))
            view, around = y_up(ball_colours.VIEW), LIGHT.radiance("three.js")
            drawn = three.ball(folder / f"{name}.glb", view, around, SIZE, edge=1.0)
            completed_ball, measured_ball = lit_ball(completed, SIZE), lit_ball(measured, SIZE)
            drawn[..., :3] = encode_srgb(np.clip(drawn[..., :3], 0.0, 1.0))
            drawn[..., 3] = measured_ball[..., 3]
            expected = json.loads((folder / "made.json").read_text(encoding="utf-8"))["expected"]["ball"]
            found = brdf_errors(measured, completed).ball
            colours = encode_srgb(np.clip(np.pi * f, 0.0, 1.0))
            row[0].bar(
                np.arange(len(f)) + 1,
                np.pi * f @ [0.2126, 0.7152, 0.0722],
                color=colours,
                edgecolor="#555",
                lw=0.5,
            )
            row[0].set_yscale("log")
            row[0].set_ylabel(f"{name.replace('_', ' ')}\nreflectance factor", fontsize=9)
            row[0].set_xticks(np.arange(len(f)) + 1, MA_T12_NAMES, rotation=60)
            row[0].tick_params(labelsize=8)
            row[0].set_xlabel("geometry of an MA-T12", fontsize=8)
            for side in ("top", "right"):
                row[0].spines[side].set_visible(False)
            for axis, picture in zip(row[1:], (completed_ball, measured_ball, drawn), strict=True):
                axis.imshow(np.clip(picture, 0.0, 1.0))
                axis.axis("off")
            alike = flip(measured_ball, completed_ball)
            off = f"off by {found:.1f} CIEDE2000, expected {expected:.1f}; FLIP {alike:.3f}"
            row[1].text(0.5, -0.02, off, transform=row[1].transAxes, ha="center", va="top", fontsize=8)
    for axis, title in zip(
        axes[0], ("12 readings", "completed", "measured", "exported, in three.js"), strict=True
    ):
        axis.set_title(title, fontsize=11)
    figure.savefig(given.output, dpi=110)


if __name__ == "__main__":
    main()
