"""Coherence and left-out errors of maps of a library: blends, GPLVMs, principal components.

    python benchmarks/bench_layouts.py LIBRARY [--json FILE]

A row per number of dimensions, two and three: detours halfway between each material and the one that looks
most like it (median, 90th percentile, share above 1.5), the five most similar materials among the five nearest, errors
of left-out materials with the places of the others kept, the hull's share that the data support, and processor seconds.
Detours of the blends are also those a quarter, half and three quarters of the way from each material to the three that
look most like it.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from helpers.places import inside_hull

from manifold.colour import panel
from manifold.colour.difference import VISIBLE
from manifold.evaluate.coherences import coherences
from manifold.evaluate.report import tabulate_materials
from manifold.library.store import Library
from manifold.model.coherence import most_similar
from manifold.model.expected_error import coherence_of
from manifold.model.manifold import Manifold
from manifold.model.materials import MaterialTable
from manifold.model.settings import BlendSettings, GplvmSettings

PLACES = 1000  # drawn from the hull
WAYS = {"quarter": 0.25, "half": 0.5, "three_quarters": 0.75}
SIMILAR = 3  # materials to which ways lead from each
KEYS = {"this": "map", "GPLVM": "published"}


def on_the_way(model: Manifold, table: MaterialTable) -> dict[str, list[float]]:
    """Return the median and 90th percentile of detours at shares of the ways to the three most similar materials."""
    lights, balls, X = panel.judged(), table.balls, model.X
    detours: dict[str, list[float]] = {name: [] for name in WAYS}
    for i, similar in most_similar(balls.__getitem__, len(X), SIMILAR, range(len(X))):
        for j in similar.tolist():
            apart = lights.compare(balls[i], balls[j]).ball
            if apart < VISIBLE:
                continue
            for name, t in WAYS.items():
                between = table.ball(
                    model.space.combination((1.0 - t) * X[i] + t * X[j], None, model.mapping)
                )
                detours[name].append(sum(lights.compare(balls[k], between).ball for k in (i, j)) / apart)
    return {name: [float(np.median(of)), float(np.quantile(of, 0.9))] for name, of in detours.items()}


def measure(library: Library, latent_dim: int) -> dict[str, Any]:
    """Fit a map of blends, and return its measures, and in two dimensions those of the other methods."""
    start = time.process_time()
    model = Manifold.fit(library, BlendSettings(latent_dim=latent_dim))
    seconds = time.process_time() - start
    left_out = model.left_out
    assert left_out is not None
    assert left_out.blended is not None
    inside = inside_hull(model.X, PLACES, np.random.default_rng(0)) @ model.X
    row: dict[str, Any] = {
        name: [float(np.median(errors)), float(np.quantile(errors, 0.9))]
        for name, errors in (
            ("ball", left_out.errors.ball), ("blended_ball", left_out.blended.ball),
            ("cube_root", left_out.errors.cube_root),
        )
    }  # fmt: skip
    reliability = left_out.reliability()["ball"]
    row |= {
        "supported_percent": round(100.0 * float(np.mean(~model.is_extrapolation(inside)))),
        "rank_correlation": reliability.rank_correlation,
        "below_twice_percent": round(100.0 * reliability.below_twice),
        "embed_seconds": round(seconds, 1),
    }
    materials = model.materials.with_negative_values()
    data = tabulate_materials(model, materials)
    table = MaterialTable(materials, data.bands)
    row["ways"] = on_the_way(model, table)
    is_plane = latent_dim == 2
    maps, _ = coherences(model, data, table, is_published_shown=is_plane)
    measured = {KEYS.get(title.split()[0], "pca"): coherence for title, coherence in maps.items()}
    if is_plane:
        letter = Manifold.fit(library, GplvmSettings.published(), calibrate=False)
        of_letter, _ = coherence_of(letter.space, table, letter.mapping)
        if of_letter is not None:
            measured["letter"] = of_letter
    for key, c in measured.items():
        row[key] = {
            "detour": [c.detour, c.detour_p90], "far_percent": round(100.0 * c.detour_far),
            "kept_percent": round(100.0 * c.neighbours_kept),
        }  # fmt: skip
    return row


def main() -> None:
    """Print and keep a row per number of dimensions."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("library", type=Path)
    parser.add_argument("--dimensions", type=int, nargs="+", default=[2, 3])
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    rows = {}
    for latent_dim in given.dimensions:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            row = rows[f"dimensions_{latent_dim}"] = measure(Library.open(given.library), latent_dim)
        print(f"{latent_dim} dimensions: {row}", flush=True)
    if given.json:
        given.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
