"""Surfaces on the page in headless Chromium: their balls against previews, bytes of the page, and times of a step.

    python benchmarks/bench_page_surfaces.py MODEL SURFACE... [--json FILE]

Balls: as the page shows them at rest in its studio, pixel by pixel against `manifold.surface.preview.strip`, whose
textures are not reduced; CIEDE2000, mean over the ball, and of averages over 7 x 7 pixels. Steps as of `bench_page.py`:
of the light that is turned, and of a lamp that is moved, of a surface and of a material without textures.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from bench_page import STEPS, step_ms
from helpers.browser import chromium, follow, visit

from manifold.colour.conversion import decode_srgb, srgb_to_xyz
from manifold.colour.difference import delta_e_2000
from manifold.core.records import Array
from manifold.page import explore
from manifold.surface import preview
from manifold.surface.written import WrittenSurface, read_surface

PREVIEW, SIZE = 320, 294  # pixels across, whose balls are equally large
BLOCK = 7  # pixels
TURNS = {
    "turn": STEPS["turn"],
    "lamp": "const change = { light: 'lamp', lamp: [0.6 * Math.sin(6 * t), 0.6 * Math.cos(6 * t)] };",
}


def difference(page: Any, surface: WrittenSurface, k: int) -> tuple[float, float]:
    """CIEDE2000 of the page's k-th surface from its preview: pixel by pixel, and of blocks."""
    follow(page, f"#surface={k}")
    data = page.evaluate(
        "(size) => { explorer.balls.refine(0); return [...explorer.balls.image(0, size).data]; }", SIZE
    )
    shown = np.array(data).reshape(SIZE, SIZE, 4) / 255.0
    edge = (PREVIEW - SIZE) // 2
    drawn = preview.strip(surface.brdf, surface.textures, surface.flakes)[edge:-edge, -PREVIEW:][
        :, edge:-edge
    ]
    is_whole = shown[..., 3] == 1.0
    pictures = (decode_srgb(shown[..., :3]), np.clip(drawn, 0.0, 1.0))
    share = uniform_filter(is_whole.astype(float), BLOCK)[..., None]

    def blocks(picture: Array) -> Array:
        sums = uniform_filter(picture * is_whole[..., None], (BLOCK, BLOCK, 1))
        return np.divide(sums, share, out=np.zeros_like(sums), where=share > 0.0)

    def mean(one: Array, other: Array) -> float:
        apart = delta_e_2000(srgb_to_xyz(one), srgb_to_xyz(other), srgb_to_xyz(np.ones(3)))
        return float(apart[is_whole].mean())

    return mean(*pictures), mean(*map(blocks, pictures))


def main() -> None:
    """Print the figures, and keep them where asked to."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", type=Path)
    parser.add_argument("surfaces", type=Path, nargs="+")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    read = [read_surface(path) for path in given.surfaces]
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        alone = explore.write_page(given.model, Path(folder) / "alone.html")
        sizes = [
            explore.write_page(given.model, Path(folder) / "one.html", surfaces=[s]) for s in given.surfaces
        ]
        html = Path(folder) / "map.html"
        explore.write_page(given.model, html, surfaces=given.surfaces)
        page = visit(browser, html.as_uri()).page
        page.evaluate("explorer.pendingThumbnails = []")
        apart = [difference(page, surface, k) for k, surface in enumerate(read)]
        with_textures = {}
        for k, surface in enumerate(read):
            follow(page, f"#surface={k}")
            with_textures[surface.name] = {name: step_ms(page, change) for name, change in TURNS.items()}
        follow(page, "#x=0,0")
        without = {name: step_ms(page, change) for name, change in TURNS.items()}
    pixels, blocks = zip(*apart, strict=True)
    figures = {
        "names": [surface.name for surface in read],
        "flakes": [surface.flakes is not None for surface in read],
        "ciede2000": {"mean": float(np.mean(pixels)), "most": max(pixels), "blocks": float(np.mean(blocks))},
        "megabytes": {name: (size - alone) / 1e6 for name, size in zip((s.name for s in read), sizes, strict=True)},
        "most_megabytes": (max(sizes) - alone) / 1e6,
        "least_megabytes": (min(sizes) - alone) / 1e6,
        "ms": {"textured": with_textures, "alone": without},
    }  # fmt: skip
    print(json.dumps(figures, indent=1))
    if given.json is not None:
        given.json.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
