"""Fits of `principled`: errors of what is seen, known truths, and time and residual beside the older methods.

    python benchmarks/bench_fit.py [--files FOLDER] [--neural ZIP] [--cases 200] [--baseline-cases N] [--json FILE]
    python benchmarks/bench_fit.py --files FOLDER --appearance-only

FOLDER holds .bsdf files; without it they are the built-in corpus. ZIP holds published neural fits, which take the place
of the files where errors of what is seen are measured. All methods see the same samples in the same run. The older
methods take about a quarter of a minute per case on two quiet cores; --baseline-cases runs them on the first N only.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from neural_fits import read_neural_fits

from manifold.analytic import corpus
from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.core.directions import from_spherical
from manifold.core.pairs import RusinkiewiczGrid
from manifold.fit import fit_samples, fits
from manifold.fit.fit_metrics import Criterion
from manifold.fit.fit_samples import FitSamples
from manifold.fit.identifiability import DETERMINED
from manifold.fit.principled import FitResult, fit_bsdf
from manifold.io_rgl import read_bsdf
from manifold.model.comparison import brdf_errors
from manifold.render import backend, fit_json
from manifold.render.bsdf_evaluation import evaluator
from manifold.render.bsdf_parameters import ParameterLayout, principled
from manifold.render.fitted_brdf import FittedBRDF

NOISE = 0.005
METHODS = ("gauss-newton", "adam", "swarm")
SENSORS_DEG = (
    (60, 0), (30, 0), (0, 0), (30, 180), (65, 180), (45, 60), (45, 120), (30, 90), (60, 60), (60, 120),
)  # fmt: skip


def truths(n: int, layout: ParameterLayout) -> np.ndarray:
    """Random parameter vectors (n, K): uniform, a little away from the ends of [0, 1]."""
    low, high = np.maximum(layout.minimum, 0.02), np.minimum(layout.maximum, 0.98)
    return np.random.default_rng(1).uniform(low, high, (n, layout.size))


def noisy(
    samples: FitSamples, f_cos: np.ndarray, rng: np.random.Generator, relative: float, floor: float = 0.0
):
    """Samples of known values with Gaussian noise, per value; negative ones clipped."""
    f = f_cos / samples.wo[:, 2:]
    f = np.maximum(f + (relative * f + floor) * rng.standard_normal(f.shape), 0.0)
    return FitSamples.from_arrays(samples.wi, samples.wo, f)


def judge(result: FitResult, p: np.ndarray, truth_residual: float) -> dict[str, Any]:
    """How a fit compares with the truth."""
    layout = ParameterLayout(result.family, 3)
    error = np.abs(layout.join(result.values) - p)
    counted = [k for k, label in enumerate(layout.labels) if label not in ("clearcoat_gloss", "sheen")]
    claimed = [k for k in counted if result.statements[k].state == DETERMINED]
    return {
        "recovered": bool(np.all(error[claimed] <= layout.tolerance[claimed])),
        "recovered_all": bool(np.all(error[counted] <= layout.tolerance[counted])),
        "claimed": len(claimed),
        "counted": len(counted),
        "as_low_as_truth": result.residuals[result.metric] <= truth_residual * 1.0001,
        "seconds": result.seconds,
    }


def known_truths(pairs: FitSamples, n: int, n_baseline: int) -> dict[str, Any]:
    """Recovery of random parameters by every method."""
    family = principled()
    whole = evaluator(family, pairs.wi, pairs.wo, 3)
    rng = np.random.default_rng(2)
    rows: dict[str, list[dict[str, Any]]] = {method: [] for method in METHODS}
    for k, p in enumerate(truths(n, whole.layout)):
        value = whole.values(p)[0]
        samples = noisy(pairs, value, rng, NOISE)
        truth = Criterion(samples, "cube-root").relative(value)
        for method in METHODS:
            if method == "gauss-newton" or k < n_baseline:
                rows[method].append(judge(fit_bsdf(samples, family, method=method, noise=NOISE), p, truth))
        if (k + 1) % 20 == 0 or k + 1 == n:
            summary = {method: truth_summary(judged) for method, judged in rows.items() if judged}
            print(f"known truths, {k + 1} of {n}: {summary}", flush=True)
    return {method: truth_summary(judged) for method, judged in rows.items() if judged}


def truth_summary(judged: list[dict[str, Any]]) -> dict[str, Any]:
    """How many of the cases of one method were recovered, and how fast."""
    return {
        "cases": len(judged),
        "recovered_where_claimed": sum(j["recovered"] for j in judged),
        "recovered_everything": sum(j["recovered_all"] for j in judged),
        "share_of_values_claimed": sum(j["claimed"] for j in judged) / sum(j["counted"] for j in judged),
        "as_low_as_truth": sum(j["as_low_as_truth"] for j in judged),
        "median_seconds": statistics.median(j["seconds"] for j in judged),
    }


def rough_or_smooth(n: int) -> dict[str, Any]:
    """Rough black and smooth grey: how often both are among the solutions that fit as well as the best."""
    family = principled()
    layout = ParameterLayout(family, 3)
    materials = {
        "rough black": {"base_color": [0.01] * 3, "roughness": 0.95},
        "smooth grey": {"base_color": [0.02] * 3, "roughness": 0.1},
    }
    wi, wo = [], []
    for incidence in (15, 45):
        for theta, phi in SENSORS_DEG:
            wi.append(from_spherical(np.deg2rad(incidence), np.pi))
            wo.append(from_spherical(np.deg2rad(theta), np.deg2rad(phi)))
    dense_wi, dense_wo, above = RusinkiewiczGrid().directions()
    keep = np.flatnonzero(above & (np.minimum(dense_wi[:, 2], dense_wo[:, 2]) > 0.05))[::6]
    tables = {"20 geometries": (np.array(wi), np.array(wo)), "dense": (dense_wi[keep], dense_wo[keep])}
    out: dict[str, Any] = {}
    for table, (wi_t, wo_t) in tables.items():
        for name, values in materials.items():
            p = layout.join({"metallic": 0, "specular": 0.5, "clearcoat": 0, "sheen": 0} | values)
            f_cos = evaluator(family, wi_t, wo_t, 3).values(p)[0]
            pairs = FitSamples.from_arrays(wi_t, wo_t, np.ones((len(wi_t), 3)))
            rng = np.random.default_rng(3)
            row = {
                "cases": n,
                "both_listed": 0,
                "roughness_determined_and_right": 0,
                "says_it_cannot_tell": 0,
            }
            for _ in range(n):
                result = fit_bsdf(noisy(pairs, f_cos, rng, 0.05, 0.003), family, noise=0.05)
                good = [float(m.values["roughness"]) for m in result.minima if m.as_good]
                state = next(s for s in result.statements if s.name == "roughness")
                row["both_listed"] += max(good) > 0.5 and min(good) < 0.3
                row["says_it_cannot_tell"] += state.state != DETERMINED
                row["roughness_determined_and_right"] += (
                    state.state == DETERMINED and abs(state.value - values["roughness"]) < 0.03
                )
            out[f"{table}, {name}"] = row
            print(f"{table}, {name}: {row}", flush=True)
    return out


def json_difference(result: FitResult, samples: FitSamples) -> float:
    """Largest difference of the BSDF that the written JSON re-creates, over the largest value."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "fit.json"
        fit_json.write_document(path, fits.document(result, fit_json.FitSource("benchmark")))
        bsdf = fit_json.read_bsdf(path)
    mi, dr = backend.mitsuba(colour="rgb"), backend.drjit()
    si = dr.zeros(mi.SurfaceInteraction3f, len(samples))
    si.wi = mi.Vector3f(samples.wi.T.astype(np.float32))
    found = np.array(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(samples.wo.T.astype(np.float32)), True)).T
    whole = evaluator(result.family, samples.wi, samples.wo, 3)
    expected = whole.values(whole.layout.join(result.values))[0]
    return float(np.max(np.abs(found - expected)) / np.max(expected))


def appearance(brdfs: dict[str, BRDF]) -> dict[str, Any]:
    """Errors of fits in the metrics `appearance`, the default, and `cube-root`."""
    rows: dict[str, list[dict[str, float]]] = {"appearance": [], "cube-root": []}
    for name, brdf in brdfs.items():
        for metric, made in rows.items():
            start = time.perf_counter()
            result = fit_bsdf(brdf, metric=metric)
            seconds = time.perf_counter() - start
            fitted = FittedBRDF.of(result.family, result.values, result.bands, result.spectra)
            errors = brdf_errors(brdf, fitted)
            assert result.errors is not None
            made.append({"ball": errors.ball, "ball in the fitted light": result.errors.fitted_ball})
            made[-1] |= {"cube root": errors.cube_root, "linear": errors.linear, "seconds": seconds}
        print(name, *(f"{made[-1]['ball']:.2f}" for made in rows.values()), flush=True)
    columns = list(rows["appearance"][0])
    print("| metric |", " | ".join(columns), "|")
    print("|---" * (1 + len(columns)) + "|")
    for metric, made in rows.items():
        both = [np.percentile([row[column] for row in made], (50, 90)) for column in columns]
        print(f"| {metric} |", " | ".join(f"{median:.3g} / {p90:.3g}" for median, p90 in both), "|")
    summary = {
        metric: {
            column: np.percentile([row[column] for row in made], (50, 90)).tolist() for column in columns
        }
        for metric, made in rows.items()
    }
    return {"names": list(brdfs), "summary": summary, "rows": rows}


def materials(folder: Path, n_baseline: int) -> dict[str, Any]:
    """What is said of fits of files, and time and residual of Gauss-Newton and Adam on the same samples."""
    rows = []
    for k, path in enumerate(sorted(folder.glob("*.bsdf"))):
        file = read_bsdf(path)
        samples = fit_samples.from_brdf(MeasuredBRDF(file)).as_rgb()
        of_file, ours = fit_bsdf(file), fit_bsdf(samples, metric="cube-root")
        of_brdf = fit_bsdf(MeasuredBRDF(file))
        assert of_file.errors is not None
        assert of_brdf.errors is not None
        row: dict[str, Any] = {
            "name": path.stem,
            "seconds": ours.seconds,
            "residual": of_file.residuals["appearance"],
            "diffuse": of_file.diffuse_residual,
            "file_and_brdf": abs(of_file.errors.ball - of_brdf.errors.ball),
            "json_difference": json_difference(ours, samples),
            "at_bound_said": all(
                any(s.name in note for note in of_file.notes) for s in of_file.statements if s.at_bound
            ),
        }
        if k < n_baseline:
            theirs = fit_bsdf(samples, method="adam")
            linear = fit_bsdf(samples, metric="linear")
            row |= {
                "adam_seconds": theirs.seconds,
                "cube_root": ours.residuals["cube-root"],
                "adam_cube_root": theirs.residuals["cube-root"],
                "adam_linear": theirs.residuals["linear"],
                "linear": linear.residuals["linear"],
            }
        rows.append(row)
        print(row, flush=True)
    both = [row for row in rows if "adam_seconds" in row]
    summary: dict[str, Any] = {
        "materials": len(rows),
        "largest_json_difference": max(row["json_difference"] for row in rows),
        "largest_difference_of_file_and_brdf": max(row["file_and_brdf"] for row in rows),
        "worse_than_diffuse": sum(row["residual"] > row["diffuse"] * (1 + 1e-6) for row in rows),
        "unsaid_bounds": sum(not row["at_bound_said"] for row in rows),
    }
    if both:
        summary |= {
            "beside_adam": len(both),
            "median_time_ratio": statistics.median(row["adam_seconds"] / row["seconds"] for row in both),
            "residual_as_low": sum(row["cube_root"] <= row["adam_cube_root"] for row in both),
            "linear_as_low": sum(row["linear"] <= row["adam_linear"] * 1.0001 for row in both),
        }
    print(f"materials of {folder.name}: {summary}", flush=True)
    return {"summary": summary, "rows": rows}


def main() -> None:
    """Run what the options ask for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--files", type=Path, help="folder of .bsdf files")
    parser.add_argument("--cases", type=int, default=200, help="known truths")
    parser.add_argument(
        "--baseline-cases", type=int, default=10**9, help="of those, and of the files, also by Adam"
    )
    parser.add_argument("--neural", help="file or folder of published neural fits, as materials")
    parser.add_argument("--every", type=int, default=1, help="of what is fitted to be seen, every n-th")
    parser.add_argument("--appearance-only", action="store_true", help="measure errors of what is seen alone")
    parser.add_argument("--rough-cases", type=int, default=20)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if options.files is None:
            options.files = Path(folder)
            corpus.write(options.files)
        results = measure(options)
    if options.json is not None:
        options.json.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """All that the options ask for."""
    brdfs: dict[str, BRDF] = {
        path.stem: MeasuredBRDF(read_bsdf(path)) for path in sorted(options.files.glob("*.bsdf"))
    }
    if options.neural:
        brdfs = dict(sorted(read_neural_fits(options.neural).items()))
    results: dict[str, Any] = {"appearance": appearance(dict(list(brdfs.items())[:: options.every]))}
    if options.appearance_only:
        return results
    if options.cases:
        first = sorted(options.files.glob("*.bsdf"))[0]
        pairs = fit_samples.from_brdf(MeasuredBRDF(read_bsdf(first)))
        pairs = FitSamples.from_arrays(pairs.wi, pairs.wo, np.ones((len(pairs), 3)))
        fit_bsdf(pairs)  # compile
        results["known_truths"] = known_truths(pairs, options.cases, options.baseline_cases)
    if options.rough_cases:
        results["rough_or_smooth"] = rough_or_smooth(options.rough_cases)
    results["materials"] = materials(options.files, options.baseline_cases)
    return results


if __name__ == "__main__":
    main()
