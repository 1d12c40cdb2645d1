"""The published setting of Hikichi & Iwasaki (raw values, two dimensions, direct local search), each material left out.

    python benchmarks/bench_published.py FOLDER      # of .bsdf files

The paper does not say by which rule the latent of a new material is found. Two rules are compared, each from the start
at principal components and from four starts beside it: the least residual of raw values, and the least error of cube
roots, which is the rule of reports. Eq. 22 sums squared errors without a cosine: values grow as 1 / cos towards the
horizon. Beside it stands the same within 80 degrees, weighted by both cosines. The last row is the map of `embed`.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from manifold.brdf.measured import MeasuredBRDF
from manifold.core.mapping import Identity
from manifold.core.pairs import RusinkiewiczGrid
from manifold.core.records import Array, Indices
from manifold.evaluate.cross_validation import Encode
from manifold.evaluate.errors import PredictionErrors
from manifold.evaluate.latent_models import LatentProcess, fit_settings
from manifold.evaluate.method_data import Data, band_shares
from manifold.evaluate.methods import STANDARD
from manifold.gp.encoding import Encoder
from manifold.gp.likelihood import centre_gram, pca_start
from manifold.gplvm import GPLVM
from manifold.io_rgl import read_bsdf
from manifold.model.combination import Combination
from manifold.model.materials import MaterialTable

STARTS = 5
GRID = RusinkiewiczGrid.named("default")
_JITTER = 0.2  # of the other starts, relative to the spread of the principal components


def first_latents(S: Array, start: int) -> Array:
    """Where a fit to a Gram matrix S (N, N) starts: principal components for start 0, else beside them, (N, 2)."""
    components = pca_start(centre_gram(S), 2)
    noise = np.random.default_rng(start).standard_normal(components.shape)
    return components + (_JITTER * components.std(axis=0) * noise if start else 0.0)


def process(data: Data, training: Indices, start: int) -> LatentProcess:
    """The published model of some materials."""
    S = data.gram(Identity())[np.ix_(training, training)]
    X0 = first_latents(S, start)
    model = GPLVM(2, mu=1e-4, optimizer="dls").fit_gram(S, data.n_outputs, X0=X0)
    return LatentProcess(model.gp_, data, Identity(), training, 0.0, is_clipped=False)


def by_residual(process: LatentProcess, i: int) -> Combination:
    """The latent of least residual of raw values, negative values kept."""
    S = process.data.gram(process.mapping)
    some = process.training
    encoder = Encoder(process.gp, S[np.ix_(some, some)], process.data.n_outputs, 0.0)
    return process.at(encoder.by_residual(S[i, some], float(S[i, i])))


RULES: dict[str, Callable[[LatentProcess, int], Combination]] = {
    "residual of raw values": by_residual,
    "cube roots": lambda process, i: replace(process, is_clipped=True).encode(i),
}


def measured(data: Data, balls: MaterialTable, find: Callable[[int], Combination]) -> dict[str, Array]:
    """Errors of every material, left out."""
    made = [find(i) for i in range(data.n_materials)]
    errors = PredictionErrors([one.in_bands(data.bands) for one in made])
    for block in data.blocks():
        errors.add(block)
    found = balls.looks(made) | errors.of_values(GRID.n_pairs, band_shares(data.bands, data.n_bands))
    return {
        "ball": found.ball, "ball ITP": found.ball_itp, "cube root": found.cube_root, "linear": found.linear,
        "eq. 22": found.rmse, "eq. 22, within 80 degrees": found.rmse_80,
    }  # fmt: skip


def main() -> None:
    """Print a row per rule and start."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    materials = [MeasuredBRDF(read_bsdf(path)) for path in sorted(asked.folder.glob("*.bsdf"))]
    data = Data.evaluate(materials, GRID)
    balls = MaterialTable(materials, data.bands)
    every = np.arange(len(materials))
    blend = fit_settings(STANDARD["blend_2"])

    def of_blend(i: int) -> Combination:
        encode: Encode = blend(data, np.delete(every, i))
        return encode(i)

    own = measured(data, balls, of_blend)
    rows: dict[str, dict[str, Array]] = {}
    for start in range(STARTS):
        processes = [process(data, np.delete(every, i), start) for i in every]
        for name, rule in RULES.items():
            rows[f"{name}, start {start}"] = measured(
                data, balls, lambda i, rule=rule, p=processes: rule(p[i], i)
            )
    rows["blend_2"] = own
    for name, found in rows.items():
        wins = f"eq. 22 less than that of the map for {np.sum(found['eq. 22'] < own['eq. 22'])} materials"
        cells = [f"{kind} {np.median(of):.3g} / {np.percentile(of, 90):.3g}" for kind, of in found.items()]
        print(f"{name}: {'; '.join(cells)} {wins}", flush=True)
    if asked.json:
        asked.json.write_text(json.dumps(ranges(rows), indent=1) + "\n")


def ranges(rows: dict[str, dict[str, Array]]) -> dict[str, dict[str, object]]:
    """Medians of the map, and of every rule the smallest and the largest over starts."""
    key = {
        "ball": "ball",
        "ball ITP": "ball_itp",
        "cube root": "cube_root",
        "linear": "linear",
        "eq. 22": "eq_22",
    }
    own = rows["blend_2"]
    found: dict[str, dict[str, object]] = {"map": {}, "cube_roots": {}, "raw_values": {}}
    for kind in own:
        name = key.get(kind, "eq_22_within_80")
        found["map"][name] = float(np.median(own[kind]))
        for rule, prefix in (("cube_roots", "cube roots"), ("raw_values", "residual")):
            medians = [float(np.median(row[kind])) for title, row in rows.items() if title.startswith(prefix)]
            found[rule][name] = [min(medians), max(medians)]
    for rule, prefix in (("cube_roots", "cube roots"), ("raw_values", "residual")):
        wins = [
            int(np.sum(r["eq. 22"] < own["eq. 22"])) for title, r in rows.items() if title.startswith(prefix)
        ]
        found[rule]["wins"] = [min(wins), max(wins)]
    return found


if __name__ == "__main__":
    main()
