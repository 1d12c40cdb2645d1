"""Leave-one-out of non-negative combinations beside other methods: three errors of every material, in one table.

    python benchmarks/bench_nonnegative.py FOLDER           # of .bsdf files
    python benchmarks/bench_nonnegative.py built-in         # the built-in library
    python benchmarks/bench_nonnegative.py rgl_nbrdf.zip    # of the published neural fits, taken as the truth

`--numbers 8 12 16 24 40` adds the curve of error against numbers. Encoded at every sixth direction pair of the default
grid, evaluated at all of them, and by the ball in the judged lights: their mean, and the worst.
Results: docs/explanation/accuracy.md.
"""

from __future__ import annotations

import argparse
import json
import random
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from neural_fits import NeuralBRDF, read_neural_fits, seen_neural

from manifold.brdf.measured import MeasuredBRDF
from manifold.colour import panel
from manifold.core.metrics import Errors
from manifold.core.pairs import Pairs, RusinkiewiczGrid
from manifold.core.records import Array, Indices
from manifold.evaluate.baselines import fit_nonnegative, fit_pca
from manifold.evaluate.cross_validation import Encode, Method, cross_validate, leave_out
from manifold.evaluate.method_data import Data
from manifold.evaluate.methods import standard_methods
from manifold.evaluate.seen_fits import seen_principled
from manifold.io_rgl import read_bsdf
from manifold.library.store import Library
from manifold.model.combination import Combination
from manifold.model.materials import MaterialCache, MaterialTable
from manifold.registries import MAPPINGS

DEFAULT = ("nearest", "gplvm_6", "nonnegative", "few_atoms")
"""Keys of the registry of methods."""

BUILT_IN = "built-in"

COLUMNS = ("linear", "cube_root", "ball", "worst", "ball_itp")


class Network:
    """A neural fit where measured materials are expected."""

    is_isotropic = True

    def __init__(self, name: str, brdf: NeuralBRDF) -> None:
        self.name, self.bands, self.eval = name, brdf.bands, brdf.eval

    def select_bands(self, bands: Sequence[int]) -> Network:
        """All three: networks are RGB."""
        return self

    def eval_at(self, pairs: Pairs) -> Array:
        """f in 1/sr at K pairs, shape (K, 3)."""
        return self.eval(pairs.wi, pairs.wo)


def load(source: Path) -> list:
    """The materials of a folder of .bsdf files, of the built-in library, or of a zip file of networks."""
    if str(source) == BUILT_IN:
        library = Library.open(BUILT_IN)
        return list(MaterialCache(library, library.names).filled())
    if source.is_dir() and any(source.glob("*.bsdf")):
        return [MeasuredBRDF(read_bsdf(path)) for path in sorted(source.glob("*.bsdf"))]
    return [Network(name, brdf) for name, brdf in read_neural_fits(source).items()]


def fit_nearest_ball(data: Data, training: Indices) -> Encode:
    """Predict the material whose ball differs least, by CIEDE2000 in the lights used for fitting."""
    lights = panel.fitted()

    def xyz() -> list[Array]:
        rgb = [material.select_bands(data.bands.tolist()) for material in data.materials]
        return [lights.xyz(material.eval_at(lights), material.bands) for material in rgb]

    balls = data.cached("balls in the lights of fits", xyz)

    def encode(i: int) -> Combination:
        apart = [lights.compare(balls[i], balls[k]).ball for k in training]
        weights = np.arange(data.n_materials) == training[int(np.argmin(apart))]
        return Combination(MAPPINGS["identity"], weights.astype(float), is_clipped=False)

    return encode


OWN = (
    Method("nearest_by_balls", "nearest material, by balls in other lights", lambda B: 1, fit_nearest_ball),
    Method("pca_8_cube_root", "PCA 8, cube root", lambda B: 8, fit_pca("cube-root", 8)),
)
"""Methods that only this comparison has."""


def numbers_of(method: Method, predictions: Sequence[Combination]) -> int:
    """Numbers per RGB file; for `nonnegative` the median of its non-zero weights and the atoms that they belong to."""
    if method.key != "nonnegative":
        return method.numbers(3)
    kept = [prediction.weights.reshape(3, -1) > 0.0 for prediction in predictions]
    return round(float(np.median([each.sum() + each.any(axis=0).sum() for each in kept])))


def methods(names: Sequence[str], numbers: Sequence[int], anchors: Sequence[str]) -> list[Method]:
    """Methods by their keys, combinations of so many numbers, and anchors."""
    known = {m.key: m for m in (*standard_methods(), *OWN)}
    codes = [
        Method(
            f"few_atoms_{n}", "few samples and lobes", lambda B, n=n: n, fit_nonnegative(5, lambda B, n=n: n)
        )
        for n in numbers
    ]
    return [
        *(known[name] for name in names),
        *codes,
        *(seen_principled() if name == "principled" else seen_neural(name) for name in anchors),
    ]


def main() -> None:
    """Print a row per method."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("source", type=Path)
    parser.add_argument("--methods", nargs="+", default=DEFAULT, help="keys of the registry of methods")
    parser.add_argument(
        "--numbers", nargs="*", type=int, default=[], help="also few atoms of so many numbers"
    )
    parser.add_argument("--anchors", nargs="*", default=[], help="principled, or a source of neural fits")
    parser.add_argument("--every", type=int, default=1, help="leave out only every Nth material")
    parser.add_argument("--draw", type=int, help="take so many materials at random")
    parser.add_argument("--seed", type=int, default=0, help="of the draw")
    parser.add_argument("--materials", action="store_true", help="also print the errors of every material")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    materials = load(arguments.source)
    if arguments.draw:
        drawn = random.Random(arguments.seed).sample(range(len(materials)), arguments.draw)
        materials = [materials[i] for i in sorted(drawn)]
    data = Data.evaluate(materials, RusinkiewiczGrid.named("default"))
    balls = MaterialTable(materials, data.bands)
    print(f"{len(materials)} materials; median / 90th percentile")
    print(
        "| method | numbers | linear | cube root | ball CIEDE2000 | worst light | ball Delta E ITP | seconds each |\n"
        "|---|---|---|---|---|---|---|---|"
    )
    rows: dict[str, dict[str, object]] = {}
    for method in methods(arguments.methods, arguments.numbers, arguments.anchors):
        start = time.perf_counter()
        splits = leave_out(data.n_materials)[:: arguments.every]
        predictions = cross_validate(data, method.fit, splits).combinations
        seconds = (time.perf_counter() - start) / len(splits)
        errors = []
        for (_, out), combination in zip(splits, predictions, strict=True):
            i, here = int(out[0]), combination.in_bands(data.bands)
            f, truth, ball = here.evaluate(data), data.f[i], here.evaluate(balls.on_ball)
            assert not method.key.startswith(("nonnegative", "few_atoms")) or min(f.min(), ball.min()) >= 0.0
            found = balls.look(i, ball) | Errors.of_values(truth, f, data.cosines)
            errors.append([getattr(found, column) for column in COLUMNS])
        both = np.percentile(errors, (50, 90), axis=0).T.tolist()
        numbers = numbers_of(method, predictions)
        rows[method.key] = {"numbers": numbers, **dict(zip(COLUMNS, both, strict=True))}
        cells = [f"{m:.{d}f} / {p:.{d}f}" for (m, p), d in zip(both, (3, 3, 2, 2, 2), strict=True)]
        print(f"| {method.title} | {numbers} | {' | '.join(cells)} | {seconds:.2f} |", flush=True)
        for (_, out), row in zip(splits, errors, strict=True):
            if arguments.materials:
                print(
                    f"    {materials[int(out[0])].name:30s} {row[0]:.3f} {row[1]:.3f} {row[2]:.2f} {row[3]:.2f}"
                )
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
