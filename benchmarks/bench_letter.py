"""The method of Hikichi & Iwasaki to the letter, and the effect of each choice in which the row *after* them differs.

    python benchmarks/bench_letter.py FOLDER [--json FILE]      # of .bsdf files

The letter: raw values without weights at 90 x 90 x 180 direction pairs, zeros where nothing was measured, s^2 = 1,
mu = 1e-4, l = 1, direct local search from the principal components in the order of the materials, negative values kept.
Each material is left out; the paper has no rule for its latent, which here is the one of lowest eq. 22.

Each difference is a fit to all materials with that choice changed, and the rest as in the letter; the grids change
how theta_h is spaced and where nodes lie in their cells, which the paper does not say. Errors are medians over the
materials of eq. 22 at their fitted latents, over the whole grid, or over the grid of the fit where that is changed.

The fits end in local optima. All are made from the principal components and from four starts beside them; figures are
the smallest and the largest over these starts.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from bench_published import GRID, STARTS, first_latents, measured

from manifold.brdf.measured import MeasuredBRDF
from manifold.core.mapping import Identity
from manifold.core.pairs import RusinkiewiczGrid
from manifold.core.records import Array
from manifold.evaluate.method_data import Data
from manifold.gp.encoding import Encoder
from manifold.gplvm import GPLVM
from manifold.io_rgl import read_bsdf
from manifold.model.combination import Combination
from manifold.model.gram import Gram, gram_matrix
from manifold.model.materials import MaterialTable

WHOLE = RusinkiewiczGrid.named("hikichi")
ALONE = 0.5
"""Share of the prior's variance; a left-out material of larger posterior variance at its latent is far from others."""


@dataclass(frozen=True)
class Variant:
    """A fit: its Gram matrix and the settings of its search."""

    gram: Gram
    output_variance: float | None = 1.0
    farthest_first: bool = False
    last_step: float = 1e-4

    def fit(self, some: Array | slice = slice(None), start: int = 0) -> GPLVM:
        """Fit to some of the materials."""
        S = self.gram.S[some][:, some]
        model = GPLVM(
            2, mu=1e-4, optimizer="dls", output_variance=self.output_variance, tol=self.last_step / 100.0,
            farthest_first=self.farthest_first,
        )  # fmt: skip
        return model.fit_gram(S, self.gram.n_outputs, X0=first_latents(S, start))


def eq_22(S: Array, V: Array) -> Array:
    """Eq. 22 of weights V (N, N) of the materials, row i predicting material i, over the whole grid, (N,)."""
    wrong = V - np.eye(len(S))
    return np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", wrong, S, wrong), 0.0) / WHOLE.n_pairs)


def row(variant: Variant, S: Array, names: list[str]) -> dict[str, object]:
    """Errors by the Gram matrix S of a whole grid, and where the materials lie; smallest and largest over starts."""
    fits = [variant.fit(start=start) for start in range(STARTS)]

    def span(of: Callable[[GPLVM], float]) -> list[float]:
        values = [float(of(model)) for model in fits]
        return [min(values), max(values)]

    return {
        "latents_kept": span(lambda model: np.median(eq_22(S, model.gp_.leave_one_out_weights()))),
        "without_delta": span(lambda model: np.median(eq_22(S, model.gp_.smooth_weights(model.embedding_)))),
        "alone": [int(n) for n in span(lambda model: np.sum(model.gp_.leave_one_out_variance() > ALONE))],
        "condition": span(lambda model: model.gp_.condition),
        "least_slack_of_eq_15": span(lambda model: slack(model, S)),
        "distance": {
            name: span(lambda model, i=i: np.linalg.norm(model.embedding_[i])) for i, name in enumerate(names)
        },
    }


def slack(model: GPLVM, S: Array) -> float:
    """The smallest quotient of both sides of eq. 15 over a grid of latents."""
    X = model.embedding_
    low, high = X.min(axis=0), X.max(axis=0)
    axes = [np.linspace(a, b, 41) for a, b in zip(low, high, strict=True)]
    places = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    return model.gp_.length_scale_bound(places, S).slack.min()


def left_out(letter: Variant, materials: list[MeasuredBRDF]) -> dict[str, dict[str, object]]:
    """Errors of every material, left out and located by the lowest eq. 22.

    From the principal components, median and 90th percentile; then both over all starts, smallest and largest.
    """
    data = Data.evaluate(materials, GRID)
    balls = MaterialTable(materials, data.bands)
    tables: list[dict[str, list[float]]] = []
    for start in range(STARTS):
        spread = located(letter, start)
        errors = measured(data, balls, lambda i, s=spread: Combination(Identity(), s[i], None, False))
        errors["eq_22"] = eq_22(letter.gram.S, spread)
        kinds = ("ball", "ball ITP", "cube root", "linear", "eq_22")
        tables.append({kind: [*map(float, np.percentile(errors[kind], (50, 90)))] for kind in kinds})
        print(f"left out, start {start}: {tables[-1]}", flush=True)
    over_starts: dict[str, object] = {}
    for kind in tables[0]:
        median, p90 = np.array([table[kind] for table in tables]).T
        over_starts[kind] = {
            "median": [float(median.min()), float(median.max())], "p90": [float(p90.min()), float(p90.max())]
        }  # fmt: skip
    return {"letter": dict(tables[0]), "over_starts": over_starts}


def located(letter: Variant, start: int) -> Array:
    """Weights (N, N) of the materials in predictions of every left-out material, at the latent of lowest eq. 22."""
    S, every = letter.gram.S, np.arange(len(letter.gram.S))
    spread = np.zeros_like(S)
    for i in every:
        others = np.delete(every, i)
        process = letter.fit(others, start).gp_
        encoder = Encoder(process, S[np.ix_(others, others)], letter.gram.n_outputs)
        spread[i, others] = process.weights(encoder.by_residual(S[i, others], float(S[i, i]))[None])[0]
    return spread


def main() -> None:
    """Print and keep the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    files = [read_bsdf(path) for path in sorted(asked.folder.glob("*.bsdf"))]
    materials = [MeasuredBRDF(file) for file in files]

    def gram(grid: RusinkiewiczGrid = WHOLE, weights: bool = False) -> Gram:
        return gram_matrix(materials, Identity(), grid, is_weighted=weights)

    letter = Variant(gram())
    variants = {
        "letter": letter,
        "cosine_weights": replace(letter, gram=gram(weights=True)),
        "default_grid": replace(letter, gram=gram(RusinkiewiczGrid.named("default"))),
        "profiled_variance": replace(letter, output_variance=None),
        "last_step": replace(letter, last_step=1e-2),
        "order_of_moves": replace(letter, farthest_first=True),
    }
    grids = {
        "nodes_at_centres": replace(WHOLE, offset=0.5),
        "squared_theta_h": replace(WHOLE, squared_theta_h=True),
        "squared_theta_h_nodes_at_centres": replace(WHOLE, squared_theta_h=True, offset=0.5),
    }
    names = [material.name for material in materials]
    rows: dict[str, object] = {}
    for name, variant in variants.items():
        rows[name] = row(variant, letter.gram.S, names)
        print(name, rows[name], flush=True)
    for name, grid in grids.items():
        other = replace(letter, gram=gram(grid))
        rows[name] = row(other, other.gram.S, names)
        print(name, rows[name], flush=True)
    result = {"differences": rows, "left_out": left_out(letter, materials)}
    if asked.json:
        asked.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
