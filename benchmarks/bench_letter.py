"""The method of Hikichi & Iwasaki to the letter, and the effect of each choice in which the row *after* them differs.

    python benchmarks/bench_letter.py FOLDER [--json FILE]      # of .bsdf files

The letter: raw values without weights at 90 x 90 x 180 direction pairs, zeros where nothing was measured, s^2 = 1,
mu = 1e-4, l = 1, direct local search from the principal components in the order of the materials, negative values kept.
Each material is left out; the paper has no rule for its latent, which here is that of the least eq. 22.

Each difference is one fit to all materials with that choice changed, and the rest as in the letter. Errors are eq. 22
of every material predicted from the others at the fitted latents, over the whole grid, medians.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from bench_published import GRID, measured

from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured_cells import fill_unmeasured
from manifold.core.mapping import Identity
from manifold.core.pairs import RusinkiewiczGrid
from manifold.core.records import Array
from manifold.evaluate.method_data import Data
from manifold.gp.encoding import Encoder
from manifold.gp.kernels import squared_distances
from manifold.gplvm import GPLVM
from manifold.io_rgl import read_bsdf
from manifold.model.combination import Combination
from manifold.model.gram import Gram, gram_matrix
from manifold.model.materials import MaterialTable

WHOLE = RusinkiewiczGrid.named("hikichi")


@dataclass(frozen=True)
class Variant:
    """A fit: its Gram matrix and the settings of its search."""

    gram: Gram
    output_variance: float | None = 1.0
    farthest_first: bool = False
    last_step: float = 1e-4

    def fit(self, some: Array | slice = slice(None)) -> GPLVM:
        """Fit to some of the materials."""
        model = GPLVM(
            2, mu=1e-4, optimizer="dls", output_variance=self.output_variance, tol=self.last_step / 100.0,
            farthest_first=self.farthest_first,
        )  # fmt: skip
        return model.fit_gram(self.gram.S[some][:, some], self.gram.n_outputs)


def eq_22(S: Array, V: Array) -> Array:
    """Eq. 22 of weights V (N, N) of the materials, row i predicting material i, over the whole grid, (N,)."""
    wrong = V - np.eye(len(S))
    return np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", wrong, S, wrong), 0.0) / WHOLE.n_pairs)


def row(variant: Variant, S: Array) -> dict[str, object]:
    """Extent, distances and errors of one fit, by the Gram matrix S of the whole grid."""
    model = variant.fit()
    X = model.embedding_
    distances = np.sqrt(squared_distances(X, X)) + np.diag(np.full(len(X), np.inf))
    smooth = model.gp_.smooth_weights(X)
    return {
        "span": np.ptp(X, axis=0).tolist(),
        "neighbour": float(np.median(distances.min(axis=1))),
        "condition": model.gp_.condition,
        "latents_kept": float(np.median(eq_22(S, model.gp_.leave_one_out_weights()))),
        "without_delta": float(np.median(eq_22(S, smooth))),
        "least_slack_of_eq_15": float(slack(model, S)),
    }


def slack(model: GPLVM, S: Array) -> float:
    """The least quotient of both sides of eq. 15 over a grid of latents."""
    X = model.embedding_
    low, high = X.min(axis=0), X.max(axis=0)
    axes = [np.linspace(a, b, 41) for a, b in zip(low, high, strict=True)]
    places = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    return model.gp_.length_scale_bound(places, S).slack.min()


def left_out(letter: Variant, materials: list[MeasuredBRDF]) -> dict[str, dict[str, object]]:
    """Errors of every material, left out and located by the least eq. 22."""
    S, every = letter.gram.S, np.arange(len(materials))
    spread = np.zeros((len(materials), len(materials)))
    for i in every:
        others = np.delete(every, i)
        process = letter.fit(others).gp_
        encoder = Encoder(process, S[np.ix_(others, others)], letter.gram.n_outputs)
        spread[i, others] = process.weights(encoder.by_residual(S[i, others], float(S[i, i]))[None])[0]
        print(f"left out {materials[i].name}", flush=True)
    data = Data.evaluate(materials, GRID)
    balls = MaterialTable(materials, data.bands)
    tables = {}
    for name, is_clipped in (("letter", False), ("clipped", True)):
        errors = measured(data, balls, lambda i, c=is_clipped: Combination(Identity(), spread[i], None, c))
        tables[name] = {
            key: [float(np.median(of)), float(np.percentile(of, 90))]
            for key, of in ((kind, errors[kind]) for kind in ("ball", "ball ITP", "cube root", "linear"))
        }
    whole = eq_22(S, spread)
    tables["letter"]["eq_22"] = [float(np.median(whole)), float(np.percentile(whole, 90))]
    return tables


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
    filled = [MeasuredBRDF(fill_unmeasured(file)) for file in files]

    def gram(
        grid: RusinkiewiczGrid = WHOLE, some: list[MeasuredBRDF] = materials, weights: bool = False
    ) -> Gram:
        return gram_matrix(some, Identity(), grid, is_weighted=weights)

    letter = Variant(gram())
    variants = {
        "letter": letter,
        "cosine_weights": replace(letter, gram=gram(weights=True)),
        "default_grid": replace(letter, gram=gram(RusinkiewiczGrid.named("default"))),
        "profiled_variance": replace(letter, output_variance=None),
        "filled_cells": replace(letter, gram=gram(some=filled)),
        "last_step": replace(letter, last_step=1e-2),
        "order_of_moves": replace(letter, farthest_first=True),
    }
    rows: dict[str, object] = {}
    for name, variant in variants.items():
        rows[name] = row(variant, letter.gram.S)
        print(name, rows[name], flush=True)
    result = {"differences": rows, "left_out": left_out(letter, materials)}
    print(result["left_out"])
    if asked.json:
        asked.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
