"""Accuracy of files written by the virtual goniometer, read back by Mitsuba's `measured` plugin.

Prints the mean relative error in percent for GGX over a diffuse base, and with --choices what each choice of
docs/explanation/rgl-files.md contributes; with --corpus the same error of the materials of the built-in corpus, without
noise. With --predictions, files of 24 random places inside the map of a model are compared with the predictions
themselves, and with --neural those of published neural fits with the fits, for each spread of the outgoing grid and
each limit of how sharply the normal distribution may bend.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from neural_fits import read_neural_fits
from scipy.spatial import Delaunay

from manifold.analytic import GGX, Plastic, corpus
from manifold.brdf import goniometer
from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import plausibility
from manifold.colour import ball_colours
from manifold.core.directions import from_spherical
from manifold.core.metrics import cube_root_error
from manifold.core.records import Array, Bands, BsdfFile
from manifold.io_rgl import write_bsdf
from manifold.model.manifold import Manifold
from manifold.model.prediction import ClippedBRDF

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

ALPHAS = (0.05, 0.1, 0.3, 0.6)
SETTINGS = ((32, 8), (32, 16), (64, 32))  # outgoing grid, incident elevations
FOUR_BANDS = Bands((450.0, 520.0, 590.0, 660.0))
LIMIT = np.cos(np.deg2rad(80.0))
SHARPEST = 0.02  # alpha, of what the spread of the outgoing grid is about
EXPONENTS = (1.0, 0.75, 0.5, 0.35, 0.25)
BENDS = (3.0, 1.0, 0.3, 0.1)
PLACES = 24
MOST_VALLEY = 0.1
DARK = 1e-3  # f_cos in 1/sr: less is compared with this


def material(alpha: float) -> Plastic:
    """A dielectric of index 1.5 over a diffuse base of 30 %, in RGB."""
    return Plastic(GGX.isotropic(alpha), 1.5, 0.3, Bands(None))


def direction_pairs(alpha: float, n: int = 20_000, seed: int = 0) -> tuple[Array, Array]:
    """Pairs within 80 degrees of the normal; half of the outgoing directions mirror at normals of the lobe."""
    rng = np.random.default_rng(seed)

    def cap(count: int) -> Array:
        theta = np.arccos(rng.uniform(LIMIT, 1.0, count))
        return from_spherical(theta, rng.uniform(-np.pi, np.pi, count))

    wi, wo = cap(n), cap(n)
    u = rng.random(n // 2)
    m = from_spherical(np.arctan(alpha * np.sqrt(u / (1.0 - u))), rng.uniform(-np.pi, np.pi, n // 2))
    around = wi[: n // 2]
    wo[: n // 2] = 2.0 * np.sum(around * m, axis=-1, keepdims=True) * m - around
    keep = wo[:, 2] > LIMIT
    return wi[keep], wo[keep]


def mean_relative_error(alpha: float, *, in_mitsuba: bool = True, **options: object) -> float:
    """Of f_cos in the first channel, between the written file and the analytic truth."""
    truth = material(alpha)
    file = goniometer.measure(truth, "truth", **options)  # type: ignore[arg-type]
    wi, wo = direction_pairs(alpha)
    expected = truth.eval_cos(wi, wo)
    found = evaluate_in_mitsuba(file, wi, wo) if in_mitsuba else MeasuredBRDF(file).eval_cos(wi, wo)
    return float(np.mean(np.abs(found[:, 0] - expected[:, 0]) / expected[:, 0]))


def evaluate_in_mitsuba(file: BsdfFile, wi: Array, wo: Array) -> Array:
    """f_cos (n, B) of a file in RGB or in four bands, by the `measured` plugin."""
    from helpers.mitsuba_reference import measured

    nm = None if file.wavelengths_nm is None else np.tile(file.wavelengths_nm.astype(float), (len(wi), 1))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"truth_{'rgb' if nm is None else 'spec'}.bsdf"
        write_bsdf(path, file)
        return measured(path, wi, wo, nm)[0]


def corpus_error(entry: corpus.Material, n: int = 4_000) -> tuple[float, float]:
    """Mean and 90th percentile of the relative error of f_cos of a noiseless file, over four bands."""
    truth = entry.truth(FOUR_BANDS)
    file = goniometer.measure(truth, entry.name, resolution=entry.resolution, warp_exponent=1.0)
    wi, wo = direction_pairs(0.1, n)
    expected = truth.eval_cos(wi, wo)
    error = np.abs(evaluate_in_mitsuba(file, wi, wo) - expected) / expected
    return float(error.mean()), float(np.quantile(error, 0.9))


def deviation(brdf: BRDF, n: int = 4_000, **options: object) -> tuple[float, float, float, float]:
    """Of a BRDF's file from itself: relative and cube-root error of f_cos, ball CIEDE2000, depth of the valley."""
    file = MeasuredBRDF(goniometer.measure(brdf, "x", **options))  # type: ignore[arg-type]
    wi, wo = direction_pairs(0.1, n)
    expected, found = brdf.eval_cos(wi, wo), file.eval_cos(wi, wo)
    # of band means: single bands of predictions are cut to zero where they would be negative
    relative = np.mean(np.abs(found - expected).mean(axis=1) / np.maximum(expected.mean(axis=1), DARK))
    ball = ball_colours.ball()
    off = ball.difference(*(np.maximum(b.eval(ball.wi, ball.wo), 0.0) for b in (brdf, file)), brdf.bands)
    return float(relative), cube_root_error(expected, found), off, plausibility(file).highlight_valley


def places(model: Manifold, count: int = PLACES) -> list[ClippedBRDF]:
    """Predictions at random places inside the hull of the materials."""
    rng, hull = np.random.default_rng(7), Delaunay(model.X)
    drawn: list[ClippedBRDF] = []
    while len(drawn) < count:
        x = rng.uniform(model.X.min(axis=0), model.X.max(axis=0))
        if hull.find_simplex(x) >= 0:
            drawn.append(ClippedBRDF(model.predict(x)))
    return drawn


def print_deviations(label: str, brdfs: Sequence[BRDF], **options: object) -> None:
    """A line per exponent and per bend: means over BRDFs, and how many files have a valley."""
    choices = [("warp_exponent", exponent) for exponent in EXPONENTS] + [("bend", bend) for bend in BENDS]
    for name, value in choices:
        found = np.array([deviation(brdf, **{name: value}, **options) for brdf in brdfs])
        relative, cube_root, ball, _ = found.mean(axis=0)
        print(f"{label}, {name} {value:.2f}: relative {relative:.1%}, root {cube_root:.1%}, ball {ball:.3f}, "
              f"largest {found[:, 2].max():.2f}; valleys {np.sum(found[:, 3] > MOST_VALLEY)}",
              flush=True)  # fmt: skip


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--choices", action="store_true", help="also compare the alternatives of the design")
    parser.add_argument("--corpus", action="store_true", help="also print the errors of the corpus by family")
    parser.add_argument(
        "--predictions", type=Path, metavar="MODEL", help="also compare files with predictions"
    )
    parser.add_argument("--neural", type=Path, metavar="SOURCE", help="also compare files with neural fits")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    table: dict[str, list[float]] = {}

    def add(label: str, **options: object) -> None:
        table[label] = [100.0 * mean_relative_error(alpha, **options) for alpha in ALPHAS]  # type: ignore[arg-type]
        print(f"{label:<44}" + "".join(f"{error:8.2f}" for error in table[label]), flush=True)

    print(f"{'mean relative error in %, alpha =':<44}" + "".join(f"{alpha:8.2f}" for alpha in ALPHAS))
    for resolution, n in SETTINGS:
        add(f"{resolution} x {resolution}, {n} elevations", resolution=resolution, n_theta_i=n)
    if arguments.choices:
        print(f"{'32 x 32, 8 elevations, alpha =':<44}" + f"{SHARPEST:8.2f}")
        for exponent in EXPONENTS:
            label = f"warp exponent {exponent:.2f}"
            sharpest = 100.0 * mean_relative_error(SHARPEST, in_mitsuba=False, warp_exponent=exponent)
            print(f"{label:<44}{sharpest:8.2f}")
            add(label, in_mitsuba=False, warp_exponent=exponent)
        for bend in BENDS:
            add(f"bend {bend:.1f}", in_mitsuba=False, bend=bend)
        t = np.linspace(0.0, 1.0, 8)
        for share in (0.0, 0.2, 0.4, 0.6, 0.8, 1.0):
            nodes = 0.5 * np.pi * (1 - share) * t + share * np.arccos(1.0 - t)
            add(f"32 x 32, 8 elevations, even-cosine share {share:.1f}", in_mitsuba=False, theta_i_rad=nodes)
        for resolution, n in SETTINGS:
            label = f"{resolution} x {resolution}, {n} elevations, not compensated"
            add(label, in_mitsuba=False, resolution=resolution, n_theta_i=n, compensate=False)
    families: dict[str, list[tuple[float, float]]] = {}
    for entry in corpus.isotropic_materials() if arguments.corpus else ():
        families.setdefault(entry.family, []).append(corpus_error(entry))
    for family, errors in families.items():
        mean, high = 100.0 * np.max(errors, axis=0)
        print(f"{family:<14} largest mean {mean:6.2f}, largest 90th percentile {high:6.2f}")
    if arguments.predictions:
        print_deviations("predictions", places(Manifold.load(arguments.predictions)), version=(1, 0))
    if arguments.neural:
        fits = [fit.plausible() for fit in read_neural_fits(arguments.neural).values()]
        print_deviations("neural fits", fits, n_theta_i=12, steepest=2.0, version=(1, 0))
    if arguments.json:
        arguments.json.write_text(json.dumps({"alpha": ALPHAS, "percent": table}, indent=2) + "\n")


if __name__ == "__main__":
    main()
