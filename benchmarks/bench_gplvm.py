"""The latent variable model: cost as the number of materials grows, and beside GPy.

    python benchmarks/bench_gplvm.py --optimizers FOLDER [FOLDER ...]    # the table of optimisers, and nothing else
    python benchmarks/bench_gplvm.py [--sizes 51 200 1000 5000] [--gpy PYTHON] [--json FILE]

Optimisers: the .bsdf files of each folder, raw and under the cube root, fitted by every optimiser from the same
starts: principal components, the same at half the scale, and perturbations of them.

Data are generated: N points on a curved two-dimensional surface, columns of falling variance as the Gram matrices
of measured materials have. Every size runs in a process of its own, one BLAS thread, whose peak memory is measured
above that of an empty one. Evaluations are timed at all sizes; fits are run up to FIT_LIMIT.

Beside GPy: both start from the same principal components of the same 51 x 51 factor. GPy fits latents, signal and
noise variance and length scale, by L-BFGS; ours latents, s^2 and noise filter (the length scale only sets the unit of
free latents), by L-BFGS too. The time until its objective is first as good as GPy's end counts, and that of the whole
fit is given besides. Both embeddings are then judged by one objective, ours, minimised over noise filter and length
scale (signal variance is profiled out): that is GPy's negative log likelihood per output, but for constants. GPy is no
dependency; to get it:

    python3 -m venv /tmp/gpy && /tmp/gpy/bin/pip install GPy==1.15.0
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits

from manifold.brdf.measured import MeasuredBRDF
from manifold.core.pairs import RusinkiewiczGrid
from manifold.gp.kernels import SquaredExponential
from manifold.gp.likelihood import LatentObjective, centre_gram, pca_start
from manifold.gplvm import GPLVM
from manifold.gpr import IsolatedLatentsWarning
from manifold.io_rgl import read_bsdf
from manifold.model.fitting import gram_matrix
from manifold.registries import MAPPINGS, OPTIMIZERS

STARTS = 20
SIZES = (51, 200, 1000, 5000)
RANK, OUTPUTS = 40, 1_000_000
MU, ITERATIONS = 1e-2, 50
FIT_LIMIT = 1000  # beyond, a fit takes many minutes and teaches nothing that an evaluation does not
FIRST_MU, JOINT_ITERATIONS = 1e-2, 1000  # of our side beside GPy
TARGET = 10.0
ONE_THREAD = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


def starts_of(S: np.ndarray, count: int) -> list[np.ndarray]:
    """Principal components of a centred Gram matrix, the same at half the scale, perturbations by 0.3 deviations."""
    X, rng = pca_start(S, 2), np.random.default_rng(0)
    return [X, 0.5 * X, *(X + 0.3 * rng.normal(size=X.shape) for _ in range(count - 2))]


def beside_each_other(folder: Path, mapping: str) -> list[str]:
    """Rows of the table of optimisers for the materials of a folder."""
    materials = [MeasuredBRDF(read_bsdf(path)) for path in sorted(folder.glob("*.bsdf"))]
    gram = gram_matrix(materials, MAPPINGS[mapping], RusinkiewiczGrid.named("default"))
    starts = starts_of(centre_gram(gram.S), STARTS)
    ends, seconds = {}, {}
    for name in OPTIMIZERS:
        GPLVM(optimizer=name, max_iter=1).fit_gram(gram.S, gram.n_outputs)  # compiles
        before = time.process_time()
        fits = [GPLVM(optimizer=name).fit_gram(gram.S, gram.n_outputs, X0=X) for X in starts]
        seconds[name] = (time.process_time() - before) / STARTS
        ends[name] = np.array([fit.objective_ for fit in fits])
    best = min(F.min() for F in ends.values())
    return [
        f"| {folder.name}, {len(materials)} | {mapping} | `{name}` | {F[0]:.2f} | {np.median(F):.2f} | {F.min():.2f} "
        f"| {np.mean(best + 0.01 * abs(best) >= F):.0%} | {seconds[name]:.2f} |"
        for name, F in ends.items()
    ]


def print_optimizers(folders: list[Path]) -> None:
    """One table in Markdown."""
    print(
        f"| materials | mapping | optimiser | F from principal components | median of {STARTS} starts | best "
        "| within 1 % of the best of all | CPU seconds a fit |\n|---|---|---|---|---|---|---|---|"
    )
    for folder in folders:
        for mapping in ("cube-root", "identity"):
            print("\n".join(beside_each_other(folder, mapping)), flush=True)


def generated(N: int) -> np.ndarray:
    """A factor (N, RANK) of the Gram matrix of N smooth samples; singular values fall as 1 / k."""
    rng = np.random.default_rng(N)
    hidden = rng.uniform(-1.5, 1.5, size=(N, 2))
    frequencies = np.random.default_rng(0).normal(size=(2, RANK)) * np.linspace(0.3, 2.0, RANK)
    Y = np.cos(hidden @ frequencies + np.linspace(0.0, 3.0, RANK)) / np.arange(1, RANK + 1)
    return (Y + 1e-3 * rng.normal(size=Y.shape)) * np.sqrt(OUTPUTS)


def seconds_per_call(work: Callable[[], object]) -> float:
    """Best of several calls within about two seconds, of one where that takes longer."""
    times: list[float] = []
    while not times or (sum(times) < 2.0 and len(times) < 50):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def measure_size(N: int) -> dict[str, float]:
    """One evaluation with gradient, one fit, and peak memory in MB, of this process."""
    Y = generated(N)
    Y -= Y.mean(axis=0)
    # The most that importing and compiling ever held; what the model adds lies above.
    empty = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    out: dict[str, float] = {"N": N}
    S = Y @ Y.T
    X = pca_start(S, 2)
    objective = LatentObjective(S, OUTPUTS, SquaredExponential(MU))
    out["evaluation_s"] = seconds_per_call(lambda: objective(X))
    if N <= FIT_LIMIT:
        start = time.perf_counter()
        fitted = GPLVM(mu=MU, optimizer="l-bfgs", max_iter=ITERATIONS).fit_gram(S, OUTPUTS)
        out["fit_s"], out["iterations"] = time.perf_counter() - start, fitted.n_iter_
    out["peak_mb"] = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - empty) / 1024
    return out


def exponent(rows: list[dict[str, float]], key: str) -> float:
    """Slope of log(key) over log(N) between the two largest sizes that have it."""
    having = [row for row in rows if row.get(key, 0) > 0][-2:]
    if len(having) < 2:
        return float("nan")
    (a, b) = having
    return float(np.log(b[key] / a[key]) / np.log(b["N"] / a["N"]))


def scaling(sizes: tuple[int, ...]) -> list[dict[str, float]]:
    """All sizes, each in a process of its own."""
    rows: list[dict[str, float]] = []
    for N in sizes:
        command = [sys.executable, __file__, "--one", str(N)]
        printed = subprocess.run(command, check=True, capture_output=True, text=True, env=ONE_THREAD).stdout
        row = json.loads(printed)
        rows.append(row)
        fit = (
            f"{row['fit_s']:8.2f} s for {row['iterations']:.0f} iterations"
            if "fit_s" in row
            else "not fitted"
        )
        print(
            f"N = {N:5d}   {1e3 * row['evaluation_s']:9.2f} ms an evaluation   {fit:32s}{row['peak_mb']:8.0f} MB",
            flush=True,
        )
    return rows


GPY = """
import json, sys, time
import numpy as np, GPy
data = np.load(sys.argv[1])
model = GPy.models.GPLVM(data["Y"], 2, X=data["X"].copy(), kernel=GPy.kern.RBF(2))
start = time.perf_counter()
model.optimize("lbfgsb", max_iters=1000)
seconds = time.perf_counter() - start
np.save(sys.argv[2], np.asarray(model.X))
print(json.dumps({"seconds": seconds, "objective": float(model.objective_function()), "version": GPy.__version__,
    "mu": float(model.Gaussian_noise.variance[0] / model.rbf.variance[0]), "l": float(model.rbf.lengthscale[0])}))
"""


def judged(S: np.ndarray, n_outputs: int, X: np.ndarray) -> tuple[float, float, float]:
    """F of latents X minimised over noise filter and length scale, from many starts: F, mu, l."""

    def value(z: np.ndarray) -> float:
        return LatentObjective(S, n_outputs, SquaredExponential(*np.exp(z).tolist()))(X)[0]

    bounds = [np.log((1e-8, 1e1)), np.log((1e-2, 1e2))]
    starts = [np.log([mu, l]) for mu in (1e-4, 1e-2, 1e-1) for l in (0.5, 1.0, 2.0)]
    best = min(
        (minimize(value, start, method="L-BFGS-B", bounds=bounds) for start in starts),
        key=lambda end: end.fun,
    )
    return float(best.fun), float(np.exp(best.x[0])), float(np.exp(best.x[1]))


def fit_with_noise(
    S: np.ndarray, n_outputs: int, X0: np.ndarray, target: float
) -> tuple[np.ndarray, float, float]:
    """Latents and noise filter together.

    Returns latents, seconds until F was first at most `target` (inf if never), all seconds.
    """
    began, reached = time.perf_counter(), float("inf")

    def watch(F: float) -> None:
        nonlocal reached
        if target >= F and reached == float("inf"):
            reached = time.perf_counter() - began

    def flat(z: np.ndarray) -> tuple[float, np.ndarray]:
        mu = float(np.exp(z[-1]))
        F, dX, d_mu = LatentObjective(S, n_outputs, SquaredExponential(mu)).with_noise(
            z[:-1].reshape(X0.shape)
        )
        return F, np.append(dX.ravel(), mu * d_mu)

    bounds = [(None, None)] * X0.size + [tuple(np.log((1e-8, 1e1)))]
    options = {"maxiter": JOINT_ITERATIONS, "maxfun": 2 * JOINT_ITERATIONS, "ftol": 1e-8, "maxcor": 20}

    def report(intermediate_result: Any) -> None:
        watch(float(intermediate_result.fun))

    start = np.append(X0.ravel(), np.log(FIRST_MU))
    with threadpool_limits(1):
        found = minimize(
            flat, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options, callback=report
        )
    return found.x[:-1].reshape(X0.shape), reached, time.perf_counter() - began


def beside_gpy(python: Path, gram: Path | None) -> dict[str, object] | None:
    """GPy's GPLVM and ours on the same data from the same start; None where GPy is absent."""
    probe = (
        subprocess.run([str(python), "-c", "import GPy"], capture_output=True, check=False)
        if python.exists()
        else None
    )
    if probe is None or probe.returncode != 0:
        print(
            f"SKIPPED: no GPy at {python}; `python3 -m venv /tmp/gpy && /tmp/gpy/bin/pip install GPy==1.15.0`",
            flush=True,
        )
        return None
    if gram is None:
        Y = generated(51)
        S = centre_gram(Y @ Y.T)
    else:
        S = centre_gram(np.load(gram))
    N = S.shape[0]
    S *= N * N / np.trace(S)  # N outputs of unit variance, which GPy's hyperparameters start from
    values, vectors = np.linalg.eigh(S)
    factor = vectors * np.sqrt(np.maximum(values, 0.0))
    X0 = pca_start(S, 2)
    with tempfile.TemporaryDirectory() as work:
        data, latents = Path(work) / "data.npz", Path(work) / "X.npy"
        np.savez(data, Y=factor, X=X0)
        command = [str(python), "-c", GPY, str(data), str(latents)]
        # One thread for both: on several, small factorisations crawl, and GPy takes many times as long.
        printed = subprocess.run(command, check=True, capture_output=True, text=True, env=ONE_THREAD).stdout
        gpy: dict[str, Any] = json.loads(printed.splitlines()[-1])
        X_gpy = np.load(latents)
    gpy["F"], gpy["judged_mu"], gpy["judged_l"] = judged(S, N, X_gpy)
    out: dict[str, object] = {"N": N, "gpy": gpy}
    print(f"GPy {gpy['version']}: {gpy['seconds']:.2f} s on one thread, F = {gpy['F']:.3f}", flush=True)
    X, reached, seconds = fit_with_noise(S, N, X0, gpy["F"])
    F, mu, l = judged(S, N, X)
    ratio = gpy["seconds"] / reached
    out["ours"] = {"as_good_s": reached, "seconds": seconds, "F": F, "mu": mu, "l": l, "ratio": ratio}
    verdict = (
        f"as good after {reached:.3f} s, GPy takes {ratio:.1f} times as long (target: {TARGET:g} at least)"
    )
    print(f"ours: {verdict if np.isfinite(reached) else 'never as good'}; F = {F:.3f} after {seconds:.2f} s")
    return out


def main() -> None:
    """Parse, measure, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--optimizers", nargs="+", type=Path, metavar="FOLDER", help="of .bsdf files")
    parser.add_argument("--sizes", nargs="+", type=int, default=SIZES)
    parser.add_argument("--gpy", type=Path, default=Path("/tmp/gpy/bin/python"), help="a Python that has GPy")
    parser.add_argument(
        "--gram", type=Path, help=".npy of a Gram matrix to use beside GPy (default: generated)"
    )
    parser.add_argument("--json", type=Path, help="write the result here")
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        print(json.dumps(measure_size(arguments.one)))
        return
    if arguments.optimizers:
        with warnings.catch_warnings(), threadpool_limits(1):
            warnings.simplefilter("ignore", IsolatedLatentsWarning)  # random starts end in poor maps, too
            print_optimizers(arguments.optimizers)
        return
    rows = scaling(tuple(arguments.sizes))
    exponents = {key: exponent(rows, key) for key in ("evaluation_s", "fit_s", "peak_mb")}
    print(
        f"time grows as N^{exponents['evaluation_s']:.2f}, memory as N^{exponents['peak_mb']:.2f} at the end"
    )
    result = {
        "scaling": rows,
        "exponents": exponents,
        "beside_gpy": beside_gpy(arguments.gpy, arguments.gram),
    }
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
