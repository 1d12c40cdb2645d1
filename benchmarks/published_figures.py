"""Figures 4.2 and 4.4 of Hikichi & Iwasaki with the corpus: materials at their latents, and between two materials.

    python benchmarks/published_figures.py LIBRARY PICTURE.png

Above: three materials measured, predicted at their own latents, and beside these, where the delta of eq. 14 does not
act. Below: five steps between two materials by linear interpolation (eq. 23), by the published fit, by a GPLVM of cube
roots with profiled variance, and by a walk on the map of blends. The published fit takes a minute. Shown in
docs/explanation/gplvm.md.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.colour.conversion import encode_srgb
from manifold.library.store import Library
from manifold.model.manifold import Manifold
from manifold.model.settings import BlendSettings, GplvmSettings
from manifold.pictures import figures
from manifold.render.ball import render_ball

AT_LATENTS = ("syn_felt_green", "syn_satin_blue", "syn_chrome_blue")
"""Like the green felt, the satin paint and the blue chrome film of the paper."""
BETWEEN = ("syn_felt_green", "syn_chrome_blue")
STEPS = np.linspace(0.0, 1.0, 5)
BESIDE = 1e-6  # of the length scale: the delta is 0 there


def main() -> None:
    """Fit the models, render the balls and draw them."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("library", type=Path)
    parser.add_argument("picture", type=Path)
    asked = parser.parse_args()
    library = Library.open(asked.library)
    letter = Manifold.fit(library, GplvmSettings.published(), calibrate=False)
    gplvm = Manifold.fit(library, GplvmSettings(), calibrate=False)
    blends = Manifold.fit(library, BlendSettings(), calibrate=False)

    def at(model: Manifold, name: str) -> np.ndarray:
        return model.X[model.names.index(name)]

    rows: list[tuple[str, list[tuple[str, BRDF]]]] = [
        ("measured", [(name, MeasuredBRDF(library.read(name))) for name in AT_LATENTS]),
        ("published fit,\nat the latent", [(name, letter.predict(at(letter, name))) for name in AT_LATENTS]),
        (
            "published fit,\nbeside it",
            [(name, letter.predict(at(letter, name) + BESIDE)) for name in AT_LATENTS],
        ),
    ]
    start, end = BETWEEN
    lines = {
        "linear\ninterpolation": lambda t: blends.linear(start, end, 1.0 - t),
        "published fit": lambda t: letter.predict((1.0 - t) * at(letter, start) + t * at(letter, end)),
        "GPLVM of cube\nroots": lambda t: gplvm.predict((1.0 - t) * at(gplvm, start) + t * at(gplvm, end)),
        "walk between\nthe two": lambda t: blends.interpolate(start, end, t),
    }
    rows += [(title, [(f"{t:.2f}", of(t)) for t in STEPS.tolist()]) for title, of in lines.items()]
    headed = {rows[0][0], rows[len(rows) - len(lines)][0]}
    figure = figures.new_figure(7.5, 1.4 * len(rows))
    axes = figure.subplots(len(rows), len(STEPS), squeeze=False)
    for line, (title, balls) in zip(axes, rows, strict=True):
        for axis in line:
            axis.set_axis_off()
        for axis, (name, brdf) in zip(line, balls, strict=False):
            ball = render_ball(brdf, size=128, illuminant="D65")
            axis.imshow(encode_srgb(np.clip(np.nan_to_num(ball), 0.0, 1.0)))
            if title in headed:
                axis.set_title(name.removeprefix("syn_").replace("_", " "), fontsize=7)
        line[0].text(-0.08, 0.5, title, fontsize=7, ha="right", va="center", transform=line[0].transAxes)
    figures.save(figure, asked.picture)


if __name__ == "__main__":
    main()
