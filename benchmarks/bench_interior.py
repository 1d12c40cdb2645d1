"""Plausibility of random latents of a map, for docs/explanation/blends.md.

    python benchmarks/bench_interior.py LIBRARY [--latent-dim Q] [--kind KIND] [--count N] [--seeds 0,1,2] [--written N]

A model of the library; places at random inside the convex hull of its materials, none that the data do not support, in
their default colours. A row per seed: how many have a hole in the highlight, negative values before they are cut, an
albedo above 1.02; how far the ball moves (mean CIEDE2000) in a step of 0.01, and where a material's own coordinates are
rounded to three decimals; how many of the places drawn were not supported. With --written, that many predictions at
other random places are also written as files, plain and --physical: their albedo at 0, 5, ... 85 degrees beside that of
the predictions, their reciprocity error, and how far their balls are from those of the predictions. --count 0 leaves
the rest out.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import Delaunay

from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import plausibility
from manifold.colour import ball_colours
from manifold.core.directions import from_spherical
from manifold.core.records import Array
from manifold.estimate.predictions import predict
from manifold.io_rgl import read_bsdf
from manifold.library.store import Library
from manifold.model.colours import NEAREST
from manifold.model.manifold import Manifold
from manifold.model.output_file import OutputOptions
from manifold.model.prediction import ClippedBRDF
from manifold.model.settings import KINDS, Settings

ALBEDO_INCIDENCES_DEG = np.array([0.0, 30.0, 45.0, 60.0, 75.0])
FILE_INCIDENCES_DEG = np.arange(0.0, 86.0, 5.0)
STEP = 0.01


@dataclass(frozen=True)
class Place:
    """What was measured at one place: depth of the deepest hole, share of negative values, albedo, ball of a step."""

    hole: float
    negative: float
    albedo: float
    step: float


@dataclass(frozen=True)
class Written:
    """What was measured on a file: albedo, its own and the prediction's, reciprocity error, ball from prediction's."""

    albedo: float
    predicted: float
    reciprocity: float
    ball: float


class Interior:
    """Places inside a model's map, and their balls."""

    def __init__(self, model: Manifold, seed: int) -> None:
        self._model, self._rng, self._ball = model, np.random.default_rng(seed), ball_colours.ball()
        self._hull, self._low, self._high = Delaunay(model.X), model.X.min(axis=0), model.X.max(axis=0)
        self.drawn = 0

    def draw(self) -> Array:
        """A place (Q,) inside the hull that the data support."""
        while True:
            x = self._rng.uniform(self._low, self._high)
            if self._hull.find_simplex(x) >= 0:
                self.drawn += 1
                if not self._model.is_extrapolation(x):
                    return x

    def measure(self, x: Array) -> Place:
        """What the prediction at a place (Q,) looks like."""
        brdf, step = self._model.predict(x), self._rng.normal(size=x.size)
        beside = self._model.predict(x + STEP * step / np.linalg.norm(step))
        f = brdf.eval(self._ball.wi, self._ball.wo)
        albedo = brdf.albedo(from_spherical(np.deg2rad(ALBEDO_INCIDENCES_DEG), 0.0)).max()
        return Place(
            plausibility(brdf).highlight_valley,
            float(np.mean(f < 0.0)),
            float(albedo),
            self.apart(brdf, beside),
        )

    def rounded(self) -> list[float]:
        """How far each material's ball moves where its coordinates are rounded to three decimals."""
        model = self._model
        return [
            self.apart(model.material(name), model.predict(np.round(model.latent(name), 3)))
            for name in model.names
        ]

    def written(self, folder: Path, *, physical: bool) -> Written:
        """What is measured on the file of a prediction at a random place."""
        x, path = self.draw(), folder / "x.bsdf"
        found = predict(self._model, x, path, options=OutputOptions(physical=physical)).plausibility
        brdf = ClippedBRDF(self._model.predict(x, self._model.choose_colour(x, NEAREST).colours))
        albedo = brdf.albedo(from_spherical(np.deg2rad(FILE_INCIDENCES_DEG), 0.0)).max()
        ball = self.apart(brdf, MeasuredBRDF(read_bsdf(path)))
        return Written(found.max_albedo, float(albedo), found.reciprocity_error, ball)

    def apart(self, a: BRDF, b: BRDF) -> float:
        """Mean CIEDE2000 between two balls."""
        ball = self._ball
        xyz = (ball.xyz(np.maximum(brdf.eval(ball.wi, ball.wo), 0.0), self._model.bands) for brdf in (a, b))
        return ball_colours.delta_e(*xyz)


def print_table(model: Manifold, count: int, seeds: Sequence[int]) -> dict[str, float]:
    """A row per seed; over all seeds, per cent of places with holes and negative values, and the largest step."""
    rows = []
    print("| seed | holes over 10 % | more than 0.5 % negative | albedo above 1.02 (largest) | step of 0.01: median, "
          "95th percentile, largest | rounded, largest | not supported |\n|---|---|---|---|---|---|---|")  # fmt: skip
    for seed in seeds:
        interior = Interior(model, seed)
        places = [interior.measure(interior.draw()) for _ in range(count)]
        hole, negative, albedo, step = (
            np.array([getattr(p, name) for p in places]) for name in ("hole", "negative", "albedo", "step")
        )
        print(f"| {seed} | {np.mean(hole > 0.1):.1%} | {np.mean(negative > 0.005):.1%} | {np.mean(albedo > 1.02):.1%} "
              f"({albedo.max():.2f}) | {np.median(step):.2f}, {np.quantile(step, 0.95):.2f}, {step.max():.2f} | "
              f"{max(interior.rounded()):.2f} | {1.0 - count / interior.drawn:.0%} |", flush=True)  # fmt: skip
        rows.append((100.0 * np.mean(hole > 0.1), 100.0 * np.mean(negative > 0.005), step.max()))
    holes, negatives, steps = np.array(rows).T
    return {
        "percent_with_holes": round(float(holes.mean()), 1),
        "percent_negative": round(float(negatives.mean()), 1),
        "largest_step": float(steps.max()),
    }


def print_written(model: Manifold, count: int, *, physical: bool) -> None:
    """A sentence on files."""
    interior = Interior(model, 3)
    with tempfile.TemporaryDirectory() as folder:
        files = [interior.written(Path(folder), physical=physical) for _ in range(count)]
    albedo, predicted, reciprocity, ball = (
        np.array([getattr(f, name) for f in files]) for name in ("albedo", "predicted", "reciprocity", "ball")
    )
    print(f"{count} files{', --physical' * physical}: albedo at most {albedo.max():.3f} (predictions: "
          f"{predicted.max():.3f}), above 1.05 in {np.sum(albedo > 1.05)}, above 1 in {np.sum(albedo > 1.0)}; "
          f"reciprocity error at most {reciprocity.max():.3f}, above 5 % in {np.sum(reciprocity > 0.05)}; "
          f"ball from the prediction's: median {np.median(ball):.2f}, largest {ball.max():.2f}",
          flush=True)  # fmt: skip


def main() -> None:
    """Print what was asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("library", type=Path)
    parser.add_argument("--latent-dim", type=int, default=2)
    parser.add_argument("--kind", choices=KINDS, default="blend")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seeds", default="0,1,2")
    parser.add_argument("--written", type=int, default=0)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    model = Manifold.fit(Library.open(given.library), Settings(kind=given.kind, latent_dim=given.latent_dim))
    if given.count:
        found = print_table(model, given.count, [int(seed) for seed in given.seeds.split(",")])
        if given.json:
            given.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    for physical in (False, True) if given.written else ():
        print_written(model, given.written, physical=physical)


if __name__ == "__main__":
    main()
