"""Left-out materials by methods that take equally many numbers from them: a point of a map, and a gain per band.

    python benchmarks/bench_fair.py FOLDER [--every K] [--json FILE]      # of .bsdf files, RGB or spectral

Each K-th material is left out, a method is fitted to the others, and represents it by the numbers that the table
states. Rows with gains multiply each band of the prediction by one number. Points are found by the cube-root error.
Rows *kept* use the latent that a fit with the material gave it, as reproductions do.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from bench_published import GRID

from manifold.brdf.interface import all_isotropic
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured_cells import fill_unmeasured
from manifold.core.mapping import CubeRoot, Identity, ValueMapping
from manifold.core.metrics import cube_root_error
from manifold.core.records import Array, Indices
from manifold.evaluate.baselines import fit_linear, fit_nearest, fit_pca
from manifold.evaluate.cross_validation import Encode
from manifold.evaluate.method_data import Data, band_shares
from manifold.gplvm import GPLVM
from manifold.gpr import GaussianProcess
from manifold.io_rgl import read_bsdf
from manifold.model.blend_fitting import BlendTables
from manifold.model.blend_space import PlaceSearch
from manifold.model.combination import Combination, evaluate
from manifold.model.decoding import appearance_pairs, appearance_weight, roots_at
from manifold.model.materials import MaterialTable
from manifold.model.settings import Settings

_STARTS, _EVALUATIONS = 3, 120
KINDS = ("ball", "cube_root", "eq_22")
Weights = Callable[[Array], Array]


class Target:
    """A left-out material, and what a prediction of it by material weights lacks."""

    def __init__(self, data: Data, i: int, mapping: ValueMapping, training: Indices, gains: bool) -> None:
        some = slice(None, None, data.stride)
        self.data, self.mapping, self.training, self.gains = data, mapping, training, gains
        self.mapped = data.mapped(mapping)[training, some]  # [n, P, B']
        self.roots = np.cbrt(data.cosines[some])[:, None]
        self.target = data.roots[i, some]

    def of(self, weights: Array) -> tuple[float, Array]:
        """Relative cube-root error of weights (n,) of the training materials, and the gains of all bands (B',)."""
        f = np.maximum(self.mapping.inverse(np.tensordot(weights, self.mapped, axes=1)), 0.0)
        roots = self.roots * np.cbrt(f)
        scale = np.ones(roots.shape[1])
        if self.gains:
            scale = np.sum(roots * self.target, axis=0) / np.maximum(np.sum(roots * roots, axis=0), 1e-30)
        wrong = scale * roots - self.target
        return float(np.linalg.norm(wrong) / np.linalg.norm(self.target)), scale**3

    def combination(self, weights: Array) -> Combination:
        """The prediction of weights (n,), each band with its gain."""
        spread = np.zeros(self.data.n_materials)
        spread[self.training] = weights
        if not self.gains:
            return Combination(self.mapping, spread)
        mapped_gain = self.mapping.forward(self.of(weights)[1][None])[0]
        bands = self.data.bands
        per_band = np.zeros((self.data.n_bands, len(spread), len(bands)))
        for k, band in enumerate(bands):
            per_band[band, :, k] = mapped_gain[k] * spread
        return Combination(self.mapping, per_band.reshape(self.data.n_bands, -1), bands)


def search(target: Target, weights: Weights, X: Array) -> Combination:
    """The best point near the best of the latents X (n, Q)."""
    errors = [target.of(weights(x))[0] for x in X]
    ends = [
        scipy.optimize.minimize(
            lambda x: target.of(weights(x))[0], X[k], method="Nelder-Mead",
            options={"maxfev": _EVALUATIONS, "initial_simplex": X[k] + 0.3 * np.vstack([np.zeros(2), np.eye(2)])},
        )
        for k in np.argsort(errors)[:_STARTS]
    ]  # fmt: skip
    return target.combination(weights(min(ends, key=lambda end: end.fun).x))


def of_process(mapping: ValueMapping, optimizer: str, gains: bool) -> Callable[[Data, Indices], Encode]:
    """A GPLVM in two dimensions, with or without gains."""

    def fit(data: Data, training: Indices) -> Encode:
        S = data.gram(mapping)[np.ix_(training, training)]
        gp = GPLVM(2, mu=1e-4, optimizer=optimizer).fit_gram(S, data.n_outputs).gp_
        return lambda i: search(
            Target(data, i, mapping, training, gains), lambda x: gp.smooth_weights(x[None])[0], gp.X
        )

    return fit


def kept(mapping: ValueMapping, optimizer: str) -> Callable[[Data, Indices], Encode]:
    """A GPLVM of all materials; each is predicted from the others at its own latent."""

    def fit(data: Data, training: Indices) -> Encode:
        X = data.cached(
            ("kept", mapping, optimizer),
            lambda: (
                GPLVM(2, mu=1e-4, optimizer=optimizer).fit_gram(data.gram(mapping), data.n_outputs).embedding_
            ),
        )
        gp = GaussianProcess(X[training], Settings("gplvm").covariance())
        return lambda i: Target(data, i, mapping, training, False).combination(gp.weights(X[i][None])[0])

    return fit


def of_blend(kind: str) -> Callable[[Data, Indices], Encode]:
    """The map of `embed`: in the colours of the surroundings, with gains, or with chosen colours."""

    def fit(data: Data, training: Indices) -> Encode:
        bands = data.available_bands(Settings().sample_bands)
        every: BlendTables = data.cached("blend", lambda: BlendTables.of(data.materials, bands))
        rows = every.samples.rows(training)

        def make() -> tuple[object, object]:
            tables = every.subset(training)
            return tables, tables.fit(2, Settings().covariance())[0]

        tables, space = data.cached(("map", tuple(training.tolist())), make)
        if kind != "colours":
            return lambda i: search(
                Target(data, i, CubeRoot(), training, kind == "gains"),
                lambda x: space.weights(x, None),
                space.X,
            )
        roots, pairs = tables.samples.roots, appearance_pairs(all_isotropic(data.materials))
        places = PlaceSearch(space, roots, appearance_weight(roots))

        def encode(i: int) -> Combination:
            x, colours, _ = places.find(roots_at([data.materials[i]], pairs), bands)
            spread = np.zeros((data.n_bands, len(every.samples.roots)))
            spread[:, rows] = space.weights(x, colours)
            return Combination(CubeRoot(), spread, bands)

        return encode

    return fit


RAW, ROOT = Identity(), CubeRoot()
ROWS: dict[str, tuple[Callable[[int], int], Callable[[Data, Indices], Encode]]] = {
    "nearest": (lambda B: 1, fit_nearest),
    "after": (lambda B: 2, of_process(RAW, "dls", False)),
    "gplvm": (lambda B: 2, of_process(ROOT, "l-bfgs", False)),
    "pca_2": (lambda B: 2, fit_pca("cube-root", 2)),
    "map": (lambda B: 2, of_blend("plain")),
    "eq_23": (lambda B: 3, fit_linear),
    "after_gains": (lambda B: 2 + B, of_process(RAW, "dls", True)),
    "gplvm_gains": (lambda B: 2 + B, of_process(ROOT, "l-bfgs", True)),
    "map_gains": (lambda B: 2 + B, of_blend("gains")),
    "pca_8": (lambda B: 8, fit_pca("cube-root", 8)),
    "map_colours": (lambda B: 2 + 2 * B, of_blend("colours")),
    "after_kept": (lambda B: 2, kept(RAW, "dls")),
    "gplvm_kept": (lambda B: 2, kept(ROOT, "l-bfgs")),
}


def summary(each: dict[str, list[float]]) -> dict[str, list[float]]:
    """Median and 90th percentile of every error over materials."""
    return {
        kind: [float(np.median(of)), float(np.percentile(of, 90))]
        for kind, of in zip(KINDS, np.array(list(each.values())).T, strict=True)
    }


def main() -> None:
    """Print and keep a row per method; materials that the file of results has already are kept."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--every", type=int, default=1, metavar="K", help="leave out each K-th material")
    parser.add_argument(
        "--seconds",
        type=float,
        default=np.inf,
        help="processor seconds after which to stop; run again to continue",
    )
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    paths = sorted(asked.folder.glob("*.bsdf"))
    materials = [MeasuredBRDF(fill_unmeasured(read_bsdf(path))) for path in paths]
    data = Data.evaluate(materials, GRID)
    balls = MaterialTable(materials, data.bands)
    every = np.arange(len(materials))
    left_out = every[:: asked.every]
    result: dict[str, Any] = {
        "materials": len(materials), "left_out": len(left_out), "bands": data.n_bands,
    }  # fmt: skip
    kept = json.loads(asked.json.read_text()) if asked.json and asked.json.exists() else {}
    errors: dict[str, dict[str, list[float]]] = {key: kept.get(key, {}).get("each", {}) for key in ROWS}
    shares = band_shares(data.bands, data.n_bands)
    for i in left_out.tolist():
        name = materials[i].name
        if all(name in each for each in errors.values()):
            continue
        if time.process_time() > asked.seconds:
            sys.exit("stopped; run again to continue")
        for key, (_, fit) in ROWS.items():
            here = [fit(data, np.delete(every, i))(i).in_bands(data.bands)]
            f = evaluate(here, data)[0]
            look = balls.look(i, evaluate(here, balls.on_ball)[0])
            eq_22 = np.sqrt(np.sum(shares * (f - data.f[i]) ** 2) / GRID.n_pairs)
            errors[key][name] = [look.ball, cube_root_error(data.f[i], f, data.cosines), float(eq_22)]
        for key, (numbers, _) in ROWS.items():
            each = errors[key]
            result[key] = {"numbers": numbers(data.n_bands)} | summary(each) | {"each": each}
        print(name, {key: round(each[name][0], 1) for key, each in errors.items()}, flush=True)
        if asked.json:
            asked.json.write_text(json.dumps(result, indent=1) + "\n")
    for key in ROWS:
        print(key, {what: of for what, of in result.get(key, kept.get(key)).items() if what != "each"})


if __name__ == "__main__":
    main()
