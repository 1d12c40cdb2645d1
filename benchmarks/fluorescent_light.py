"""Why illuminants need spectra: materials under the fluorescent lamp F11, rendered in bands and in RGB.

Draws, for a few materials of the built-in corpus, the spectral render under F11 and that of the same file reduced to
linear sRGB, both adapted to the lamp's white, and prints the mean CIEDE2000 over the ball between each and a spectral
reference of four times the samples. The RGB render is what it is under any light once white is balanced.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from manifold.analytic import corpus
from manifold.colour.conversion import to_srgb
from manifold.colour.illuminants import Illuminant
from manifold.core.records import Array, BsdfFile
from manifold.io_rgl import write_bsdf
from manifold.pictures import figures
from manifold.pictures.renders import RIM
from manifold.render import images, scenes
from manifold.render.render import RenderSettings, render_bsdf

MATERIALS = ("syn_satin_gold", "syn_felt_orange", "syn_gloss_red", "syn_metal_copper")


def reduced_to_rgb(file: BsdfFile) -> BsdfFile:
    """The same file with three channels of linear sRGB under D65 in place of its bands."""
    band_last = np.moveaxis(file.spectra, 2, -1)
    rgb = np.maximum(to_srgb(band_last, file.bands), 0.0).astype(np.float32)
    return replace(file, wavelengths_nm=None, version=(1, 0), spectra=np.moveaxis(rgb, -1, 2))


def ball(file: BsdfFile, folder: Path, settings: RenderSettings) -> Array:
    """The display picture of a file's ball."""
    path = folder / "material.bsdf"
    write_bsdf(path, file)
    material = {"type": "measured", "filename": str(path)}
    return images.tone_map(render_bsdf(material, file.bands.is_rgb, settings))


def main() -> None:
    """Render, compare, draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--illuminant", default="F11")
    parser.add_argument("--samples", type=int, default=256)
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    lamp = Illuminant.named(options.illuminant)
    spectral = RenderSettings(size=192, samples=options.samples, illuminant=lamp)
    in_rgb = RenderSettings(size=192, samples=options.samples)
    reference = RenderSettings(size=192, samples=4 * options.samples, seed=1, illuminant=lamp)
    inside = scenes.ball_interior(spectral.size, RIM)
    recipes = {m.name: m for m in corpus.isotropic_materials()}
    rows, results = [], {}
    with tempfile.TemporaryDirectory() as name:
        for material in MATERIALS:
            file = corpus.measure(recipes[material])
            pictures = [
                ball(file, Path(name), reference),
                ball(file, Path(name), spectral),
                ball(reduced_to_rgb(file), Path(name), in_rgb),
            ]
            # Averaged over 4 x 4 pixels: noise is not what the eye compares.
            coarse = [blocks(p) for p in pictures]
            shown = blocks(inside[..., None].astype(float))[..., 0] > 0.99
            errors = [float(images.ciede2000_map(coarse[0], p)[shown].mean()) for p in coarse[1:]]
            results[material] = {"spectral": errors[0], "rgb": errors[1]}
            rows.append((material, pictures, errors))
            print(f"{material:24} spectral {errors[0]:5.2f}   RGB {errors[1]:5.2f}", flush=True)
    if options.figure:
        figures.save(figure(rows, lamp.name), options.figure)
    if options.json:
        options.json.write_text(json.dumps(results, indent=2) + "\n")


def blocks(picture: Array, size: int = 4) -> Array:
    """Means over size x size pixels."""
    height, width, channels = picture.shape
    return picture.reshape(height // size, size, width // size, size, channels).mean(axis=(1, 3))


def figure(rows: list[tuple[str, list[Array], list[float]]], lamp: str) -> figures.Figure:
    """Spectral above RGB, a column per material."""
    made = figures.new_figure(2.4 * len(rows), 5.2)
    grid = made.subplots(2, len(rows), squeeze=False)
    for column, (material, pictures, errors) in enumerate(rows):
        for row, (picture, error, kind) in enumerate(
            zip(pictures[1:], errors, ("195 bands", "RGB"), strict=True)
        ):
            axes = grid[row, column]
            axes.imshow(np.clip(picture, 0.0, 1.0), interpolation="antialiased")
            axes.set_title(f"{kind}: CIEDE2000 {error:.1f}", fontsize=10)
            axes.set_xticks([])
            axes.set_yticks([])
        grid[1, column].set_xlabel(material.removeprefix("syn_").replace("_", " "))
    made.suptitle(f"Under {lamp}, adapted to its white; difference from a spectral reference", fontsize=11)
    return made


if __name__ == "__main__":
    main()
