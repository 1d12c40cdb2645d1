"""Walks between the materials of a library: do steps look equal, and does anything turn back on the way?

    python benchmarks/bench_walks.py LIBRARY.zarr [--steps 13] [--pairs 190] [--seed 0]

Over random pairs, or all if there are no more, median / 90th percentile / largest of

- length: sum of the steps' mean CIEDE2000 between balls, over that between the ends;
- largest step over the mean step;
- turning back, total variation less that from end to end: of log luminance in mirror directions at 20, 45 and 60
  degrees (the mean of three), of log luminance of the ball's brightest pixel, and of the ball's mean lightness L*.

Methods: the walk, and the two materials alone, averaged as values, as cube roots, and as cube roots in steps of
equal visible size. Then the midpoints of walks between two roughnesses of analytic metals and plastics, beside the
roughness in equal ratio to both: cube-root error / CIEDE2000 of the ball, at t = 0.5 of the walk, at equal shares
of cube roots, and at equal visible distance in cube roots.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from itertools import combinations
from pathlib import Path

import numpy as np

from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import Plastic, RoughConductor
from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured_cells import fill_unmeasured
from manifold.colour import ball_colours
from manifold.colour.conversion import to_xyz
from manifold.colour.difference import to_lab
from manifold.core.directions import from_spherical
from manifold.core.metrics import cube_root_error
from manifold.core.pairs import cosine_weight
from manifold.core.records import Array, Bands
from manifold.gp.encoding import encoding_pairs
from manifold.library.store import Library
from manifold.model.walks import WALK_NODES, Walked, step_of, walk_shares

BALL = ball_colours.ball()
ELEVATIONS = np.deg2rad([20.0, 45.0, 60.0])
MIRROR = from_spherical(ELEVATIONS, np.zeros(3)), from_spherical(ELEVATIONS, np.full(3, np.pi))
GRID = encoding_pairs()
WI, WO = (np.vstack(parts) for parts in zip((BALL.wi, BALL.wo), MIRROR, (GRID.wi, GRID.wo), strict=True))
LIT, END = len(BALL.wi), len(BALL.wi) + len(ELEVATIONS)
DENSE = 33
ROUGHNESSES = ((0.05, 0.2), (0.1, 0.4), (0.2, 0.6), (0.03, 0.5))
GOLD = np.array([0.14, 0.37, 1.44]), np.array([4.5, 2.3, 1.8])
BASES = {
    "black plastic": (0.02, 0.02, 0.02),
    "red plastic": (0.6, 0.05, 0.04),
    "white plastic": (0.85, 0.85, 0.85),
}

Way = Callable[[float], Array]
"""Values at the pairs of ball, mirror directions and grid, by t."""


def values(brdf: BRDF) -> Array:
    """f at all pairs, shape (P, B)."""
    return np.maximum(brdf.eval(WI, WO), 0.0)


def ways(a: BRDF, b: BRDF, walked: tuple[Walked, Walked]) -> dict[str, Way]:
    """Every method between two materials."""
    f_a, f_b = values(a), values(b)
    nodes, shares = np.linspace(0.0, 1.0, WALK_NODES), walk_shares(*walked)

    def cube_roots(t: float) -> Array:
        return ((1.0 - t) * np.cbrt(f_a) + t * np.cbrt(f_b)) ** 3

    dense = np.linspace(0.0, 1.0, DENSE)
    pictures = [BALL.xyz(cube_roots(t)[:LIT], a.bands) for t in dense]
    length = np.concatenate([[0.0], np.cumsum(list(map(ball_colours.delta_e, pictures[:-1], pictures[1:])))])
    return {
        "walk": lambda t: values(step_of([a, b], walked, float(np.interp(t, nodes, shares)))),
        "values averaged": lambda t: (1.0 - t) * f_a + t * f_b,
        "cube roots averaged": cube_roots,
        "cube roots, equal steps": lambda t: cube_roots(float(np.interp(t * length[-1], length, dense))),
    }


def turning_back(path: Array) -> float:
    """Total variation of numbers (n,) less their difference from first to last."""
    return float(np.abs(np.diff(path)).sum() - abs(path[-1] - path[0]))


def measures(way: Way, steps: int, bands: Bands) -> tuple[float, ...]:
    """Length, largest step, and what turns back: highlight, brightest pixel, lightness."""
    made = [way(t) for t in np.linspace(0.0, 1.0, steps)]
    pictures = [BALL.xyz(f[:LIT], bands) for f in made]
    sizes = np.array(list(map(ball_colours.delta_e, pictures[:-1], pictures[1:])))
    luminance = np.array([to_xyz(f[:END], bands)[:, 1] for f in made])
    pixels = BALL.of(luminance[:, :LIT].T).T
    lightness = [float(to_lab(xyz, ball_colours.srgb_to_xyz(np.ones(3)))[:, 0].mean()) for xyz in pictures]
    highlights = np.log(np.maximum(luminance[:, LIT:], 1e-9))
    return (
        sizes.sum() / ball_colours.delta_e(pictures[0], pictures[-1]),
        sizes.max() / sizes.mean(),
        float(np.mean([turning_back(path) for path in highlights.T])),
        turning_back(np.log(pixels.max(axis=1))),
        turning_back(np.array(lightness)),
    )


def analytic(kind: str, alpha: float) -> BRDF:
    """A metal or plastic of a roughness."""
    ggx = GGX.isotropic(alpha)
    if kind == "gold":
        return RoughConductor(ggx, *GOLD, Bands(None))
    return Plastic(ggx, np.array([1.5]), np.array(BASES[kind]), Bands(None))


def midpoints() -> None:
    """Print errors half way between two roughnesses."""
    print("\ncube-root error / CIEDE2000 of the ball at t = 0.5, beside the roughness in equal ratio to both")
    for kind in ("gold", *BASES):
        for alpha, other in ROUGHNESSES:
            a, b, truth = (analytic(kind, r) for r in (alpha, other, float(np.sqrt(alpha * other))))
            f = values(truth)
            cells = []
            for name, way in ways(a, b, (Walked.of(a), Walked.of(b))).items():
                found = way(0.5)
                error = cube_root_error(f[END:], found[END:], cosine_weight(GRID.wi, GRID.wo))
                seen = BALL.difference(f[:LIT], found[:LIT], a.bands)
                cells.append(f"{name} {error:.3f} / {seen:.1f}")
            print(f"{kind:14s} {alpha:.2f} {other:.2f}   " + "   ".join(cells))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("library", type=Path)
    parser.add_argument("--steps", type=int, default=13)
    parser.add_argument("--pairs", type=int, default=190)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    library = Library.open(asked.library)
    materials = [MeasuredBRDF(fill_unmeasured(library.read(name))) for name in library.names]
    walked = [Walked.of(material) for material in materials]
    pairs = list(combinations(range(len(materials)), 2))
    chosen = np.random.default_rng(asked.seed).permutation(len(pairs))[: asked.pairs]
    found: dict[str, list[tuple[float, ...]]] = {}
    for i, j in (pairs[k] for k in chosen):
        for name, way in ways(materials[i], materials[j], (walked[i], walked[j])).items():
            found.setdefault(name, []).append(measures(way, asked.steps, library.bands))
    print(f"{len(chosen)} pairs, {asked.steps} steps; median / 90th percentile / largest of")
    print(f"{'':24s}length, largest / mean step, turning back: log highlight, log brightest pixel, lightness")
    for name, rows in found.items():
        cells = [
            "{:.2f} / {:.2f} / {:.2f}".format(*np.quantile(column, [0.5, 0.9, 1.0]))
            for column in zip(*rows, strict=True)
        ]
        print(f"{name:24s}" + "   ".join(cells))
    if asked.json:
        kept = {
            name: {
                key: np.quantile([row[k] for row in rows], [0.5, 0.9, 1.0]).tolist()
                for key, k in (("largest_over_mean_step", 1), ("lightness_turns_back", 4))
            }
            for name, rows in found.items()
        }
        asked.json.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    midpoints()


if __name__ == "__main__":
    main()
