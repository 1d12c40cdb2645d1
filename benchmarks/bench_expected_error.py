"""Errors that a model expects beside those that held-out materials have.

    python benchmarks/bench_expected_error.py LIBRARY [--latent-dim Q] [--kind KIND] [--folds K]
    python benchmarks/bench_expected_error.py LIBRARY --materials 4,6,8 [--draws K] [--held-out M]

Every material is held out once, with others of its fold: the rest is embedded and calibrated without it, it is located
there from its data, predicted in its own colours and, at the same place, in blended ones, and compared with its file.
With --materials, random sets of so many are embedded instead, and at most M of the others are held out. Figures of
docs/explanation/expected-errors.md.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import Delaunay
from scipy.stats import spearmanr

from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.colour import panel
from manifold.core.metrics import cube_root_error
from manifold.core.records import Array
from manifold.gp.encoding import encoding_pairs
from manifold.library.store import Library
from manifold.model.manifold import Manifold
from manifold.model.materials import MaterialCache
from manifold.model.settings import KINDS, Settings

PLACES = 2000  # inside the convex hull, of which some are not supported


@dataclass(frozen=True)
class HeldOut:
    """A material that a model had not seen: errors as expected and as they were, of `KINDS_OF_ERRORS`."""

    name: str
    expected: tuple[float, ...]
    true: tuple[float, ...]
    is_extrapolation: bool


KINDS_OF_ERRORS = ("ball", "cube_root", "blended_ball", "blended_cube_root")
"""In the colours of the material, and in colours blended from the surrounding ones."""


def hold_out(
    library: Library, settings: Settings, held_out: list[str], names: list[str] | None = None
) -> list[HeldOut]:
    """Embed and calibrate without some materials, by default all others, and find them there."""
    names = [name for name in library.names if name not in held_out] if names is None else names
    model = Manifold.fit(library, settings, names=names)
    found = []
    for truth in MaterialCache(library, held_out).filled():
        place = model.embed(truth)
        expected = model.expected_error(place.latent, place.colours, place.residual)
        assert expected is not None
        assert model.left_out is not None
        # Of the place alone: at a material's own place, the model expects no error of that material.
        blended = model.left_out.expected(place.latent, is_colour_known=False)
        found.append(
            HeldOut(
                truth.name,
                tuple(float(e) for both in (expected, blended) for e in (both.ball, both.cube_root)),
                errors(truth, model.predict(place.latent, place.colours))
                + errors(truth, model.predict(place.latent)),
                bool(model.is_extrapolation(place.latent, place.colours)),
            )
        )
    return found


def errors(truth: MeasuredBRDF, predicted: BRDF) -> tuple[float, float]:
    """CIEDE2000 of the ball in the judged lights, and the error of cube roots."""
    lights, pairs = panel.judged(), encoding_pairs()
    lit, lit_star = (brdf.eval(lights.wi, lights.wo) for brdf in (truth, predicted))
    f, f_star = (brdf.eval(pairs.wi, pairs.wo) for brdf in (truth, predicted))
    return lights.errors(lit, lit_star, truth.bands).ball, cube_root_error(f, f_star, pairs.cosines)


def unsupported_share(library: Library, settings: Settings) -> float:
    """Share of random places inside the convex hull of all materials that the data do not support."""
    model = Manifold.fit(library, settings)
    rng, hull = np.random.default_rng(0), Delaunay(model.X)
    low, high = model.X.min(axis=0), model.X.max(axis=0)
    places: list[Array] = []
    while sum(map(len, places)) < PLACES:
        x = rng.uniform(low, high, (PLACES, len(low)))
        places.append(x[hull.find_simplex(x) >= 0])
    return float(np.mean(model.is_extrapolation(np.vstack(places)[:PLACES])))


def summary(expected: Array, true: Array) -> dict[str, object]:
    """One line of the table: medians and 90th percentiles, rank correlation, percentage below twice the expected."""
    return {
        "true": np.quantile(true, [0.5, 0.9]).tolist(),
        "expected": np.quantile(expected, [0.5, 0.9]).tolist(),
        "rank": float(spearmanr(expected, true)[0]),
        "percent_below_twice": round(100.0 * float(np.mean(true < 2.0 * expected))),
    }


def few_row(library: Library, settings: Settings, size: int, draws: int, most: int) -> str:
    """Two lines of the table of random sets of so many materials."""
    drawn = []
    for draw in range(draws):
        names = np.random.default_rng([size, draw]).permutation(np.array(library.names))
        held_out, used = names[size : size + most].tolist(), sorted(names[:size].tolist())
        drawn.append(hold_out(library, settings, held_out, used))
    lines = []
    for k, name in enumerate(KINDS_OF_ERRORS):
        of_sets = [np.array([(one.expected[k], one.true[k]) for one in found]).T for found in drawn]
        rank = np.mean([spearmanr(*each)[0] for each in of_sets])
        expected, true = np.hstack(of_sets)
        medians = " | ".join(f"{np.median(e):.3g} / {np.quantile(e, 0.9):.3g}" for e in (true, expected))
        ratio = true / expected
        lines.append(
            f"| {size} | {name} | {medians} | {rank:.2f} | {np.mean(ratio < 2.0):.0%} | {np.median(ratio):.2f} | "
            f"{np.std(np.log(ratio)):.2f} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("library", type=Path)
    parser.add_argument("--latent-dim", type=int, default=2)
    parser.add_argument("--kind", choices=KINDS, default="blend")
    parser.add_argument("--folds", type=int, help="one per material if not given")
    parser.add_argument("--materials", help="sizes of random sets, at least 4, separated by commas")
    parser.add_argument("--draws", type=int, default=40)
    parser.add_argument("--held-out", type=int, default=20)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    library, settings = Library.open(given.library), Settings(kind=given.kind, latent_dim=given.latent_dim)
    if given.materials:
        print("| materials | error | true, median / 90th percentile | expected | rank correlation in a set | below "
              "twice the expected | true over expected, median | deviation of its logarithm |\n"
              + "|---" * 8 + "|")  # fmt: skip
        for size in map(int, given.materials.split(",")):
            print(few_row(library, settings, size, given.draws, given.held_out), flush=True)
        return
    shuffled = np.random.default_rng(0).permutation(np.array(library.names))
    folds = np.array_split(shuffled, given.folds or len(shuffled))
    found = [one for fold in folds for one in hold_out(library, settings, fold.tolist())]
    for one in found:
        errors_of = zip(KINDS_OF_ERRORS, one.expected, one.true, strict=True)
        words = [f"{name} {expected:.3f}, was {true:.3f}" for name, expected, true in errors_of]
        print(f"{one.name:32s} {'; '.join(words)}" + "; not supported" * one.is_extrapolation)
    expected, true = (np.array([getattr(one, name) for one in found]) for name in ("expected", "true"))
    print(
        "\n| error | true, median / 90th percentile | expected | rank correlation | below twice the expected |"
    )
    print("|---|---|---|---|---|")
    rows = {name: summary(expected[:, k], true[:, k]) for k, name in enumerate(KINDS_OF_ERRORS)}
    for name, found_row in rows.items():
        pairs = [
            " / ".join(f"{e:.2f}" for e in pair)  # type: ignore[attr-defined]
            for pair in (found_row["true"], found_row["expected"])
        ]
        below = found_row["percent_below_twice"]
        print(f"| {name} | {pairs[0]} | {pairs[1]} | {found_row['rank']:.2f} | {below} % |")
    if given.json:
        given.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    print(f"\nnot supported: {np.mean([one.is_extrapolation for one in found]):.0%} of the held-out materials, "
          f"{unsupported_share(library, settings):.1%} of places inside the hull")  # fmt: skip


if __name__ == "__main__":
    main()
