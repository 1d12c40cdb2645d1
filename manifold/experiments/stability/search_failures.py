"""Failure modes of the search for latents: starts, stopping, ambiguities between runs, precision, conditioning."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from manifold import dls
from manifold.experiments.stability.limits import HALF_OF_NEAREST
from manifold.experiments.stability.model_failures import held_out, in_error_of_nearest
from manifold.experiments.stability.testbed import TestBed, in_space
from manifold.experiments.stability.trials import Limit, Measurement, Mode, Trial
from manifold.gplvm import GPLVM
from manifold.mapping import mapping_named
from manifold.model.combination import Combination
from manifold.model.material_space import MaterialSpace
from manifold.model.prediction import PredictedBRDF
from manifold.models.gp_weights import GPWeights
from manifold.models.incremental import IncrementalObjective
from manifold.models.kernels import SquaredExponential
from manifold.models.objective import LatentObjective, centre_gram, pca_start
from manifold.records import Array

_MAPPING = mapping_named("cube-root")
_SEARCHES = ("dls", "l-bfgs", "multistart")
_CLOSE = 0.2  # of principal components of unit variance: K has a condition number of 1e10 and more


def _gram(bed: TestBed) -> Array:
    """Inner products of the family, in the order of its models."""
    names = [file.name for file in bed.family]
    order = [names.index(name) for name in bed.model("material").names]
    return bed.data.gram(_MAPPING)[np.ix_(order, order)]


def _fit(bed: TestBed, S: Array, optimizer: str, start: Array | None = None) -> GPLVM:
    return GPLVM(2, optimizer=optimizer).fit_gram(S, bed.data.n_outputs, X0=start)


def _held_out_by(bed: TestBed, fitted: GPLVM) -> Measurement:
    """The held-out plastic, embedded in a manifold with these latents of the family."""
    truth = held_out(bed)
    space = MaterialSpace(fitted.embedding_, fitted.gram_, fitted.n_outputs_, fitted.gp_.kernel)
    brdf, messages = bed.embed(in_space(bed.model("material"), space), truth)
    return Measurement(in_error_of_nearest(bed, brdf), messages)


# -- starts and ambiguities --------------------------------------------------------------------------------


def _from_start(optimizer: str) -> Trial:
    """A fit from principal components that are disturbed by a standard deviation."""

    def trial(bed: TestBed, scale: float) -> Measurement:
        S = _gram(bed)
        start = pca_start(centre_gram(S), 2) + scale * np.random.default_rng(0).normal(size=(len(S), 2))
        return _held_out_by(bed, _fit(bed, S, optimizer, start))

    return trial


def _rotated(optimizer: str) -> Trial:
    """A fit from principal components turned by an angle."""

    def trial(bed: TestBed, degrees: float) -> Measurement:
        S = _gram(bed)
        c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
        start = pca_start(centre_gram(S), 2) @ np.array([[c, -s], [s, c]])
        return _held_out_by(bed, _fit(bed, S, optimizer, start))

    return trial


def _again(optimizer: str) -> Trial:
    """The same library, its materials in another order and their values changed a little: how far latents move."""

    def trial(bed: TestBed, change: float) -> Measurement:
        S, rng = _gram(bed), np.random.default_rng(0)
        first = bed.once(("fit", optimizer), lambda: _fit(bed, S, optimizer).embedding_)
        order, scale = rng.permutation(len(S)), 1.0 + change * rng.normal(size=len(S))
        other = (S * scale[:, None] * scale)[np.ix_(order, order)]
        X = np.empty_like(first)
        X[order] = _fit(bed, other, optimizer).embedding_
        return Measurement(float(np.abs(X - first).max() / np.ptp(first)))

    return trial


# -- numbers -----------------------------------------------------------------------------------------------


def _in_precision(optimizer: str) -> Trial:
    """A fit to inner products that were rounded to fewer bits."""

    def trial(bed: TestBed, dropped: float) -> Measurement:
        dtype = {0: np.float64, 29: np.float32, 42: np.float16}[int(dropped)]
        return _held_out_by(bed, _fit(bed, _gram(bed).astype(dtype).astype(np.float64), optimizer))

    return trial


def _ill_conditioned(bed: TestBed, length_scale: float) -> Measurement:
    """The held-out plastic from the weights of a kernel without observation noise."""
    model, truth = bed.model("material"), held_out(bed)
    x = bed.once("latent of the held-out plastic", lambda: model.embed(truth).latent)
    weights = GPWeights(model.X, SquaredExponential(0.0, length_scale)).weights(x[None])[0]
    brdf = PredictedBRDF(model.materials.filled(), Combination(model.mapping, weights))
    return Measurement(in_error_of_nearest(bed, brdf))


def _drift(bed: TestBed, moves: float) -> Measurement:
    """F after many moves of one coordinate each, by updates and afresh, under the least noise filter."""
    S, rng = centre_gram(_gram(bed)), np.random.default_rng(0)
    objective = LatentObjective(S, bed.data.n_outputs, SquaredExponential(1e-10))
    start = _CLOSE * pca_start(S, 2)
    updated = IncrementalObjective(objective, start)
    for _ in range(int(moves)):  # each to near where it started, so that latents stay close
        index = int(rng.integers(start.size))
        target = start.reshape(-1)[index] + 0.1 * _CLOSE * float(rng.normal())
        updated.move(index, target - updated.x[index])
    afresh = objective(updated.x.reshape(len(S), -1))[0]
    return Measurement(abs(updated.value - afresh) / len(S))


# -- stopping ----------------------------------------------------------------------------------------------


def _valley(x: Array) -> float:
    """A curved valley with its minimum, 0, at (1, 1) (Rosenbrock 1960)."""
    return float(100.0 * (x[1] - x[0] ** 2) ** 2 + (1.0 - x[0]) ** 2)


def _stairs(x: Array) -> float:
    """A bowl in steps, flat almost everywhere, with its minimum, 0, around (1, 1)."""
    return float(np.sum(np.floor(8.0 * np.abs(x - 1.0)) / 8.0))


def _stopped(function: Callable[[Array], float]) -> Trial:
    """Distance from the minimum at the end of a search with limited evaluations, relative to that of its start."""

    def trial(bed: TestBed, divisor: float) -> Measurement:
        start = np.array([-1.2, 1.0])
        found = dls.hooke_jeeves(function, start, maxfev=int(4000 / divisor))
        messages = () if found.success else (f"not converged: {found.message}",)
        apart = np.linalg.norm(found.x - 1.0) / np.linalg.norm(start - 1.0)
        return Measurement(float(apart), messages)

    return trial


MODES: tuple[Mode, ...] = (
    Mode(
        "bad_starts", "fits from disturbed principal components", "standard deviation, in length scales",
        (0.1, 1.0, 10.0, 100.0), HALF_OF_NEAREST, {name: _from_start(name) for name in _SEARCHES},
        "Keep the start from principal components; from a distant start only `multistart` converges.",
    ),
    Mode(
        "rotated_start", "fits from rotated principal components", "degrees", (0.0, 45.0, 180.0),
        HALF_OF_NEAREST, {name: _rotated(name) for name in _SEARCHES[:2]},
        "No action needed: predictions do not depend on the rotation of the map.",
    ),
    Mode(
        "run_to_run", "a second fit, with another order of materials and perturbed values", "relative change",
        (0.0, 1e-9, 1e-6, 1e-4),
        Limit(
            "largest shift of a latent, in widths of the map", 0.25,
            "a material moves to another quarter of the map",
        ),
        {name: _again(name) for name in _SEARCHES[:2]},
        "Compare distances, not coordinates, between maps of different libraries; axes may be mirrored.",
    ),
    Mode(
        "rounded_products", "inner products of materials in fewer bits", "bits dropped of 52", (0, 29, 42),
        HALF_OF_NEAREST, {name: _in_precision(name) for name in _SEARCHES[:2]},
        "Single precision is enough for the data; half precision costs accuracy.",
    ),
    Mode(
        "ill_conditioned_kernel", "weights of a kernel without observation noise", "length scale l",
        (1.0, 10.0, 1e2, 1e4, 1e7), HALF_OF_NEAREST, {"GP": _ill_conditioned},
        "Raise mu to the value in the warning; with a nearly singular kernel matrix, digits are lost.",
    ),
    Mode(
        "drift_of_updates", "the objective by rank-two updates, with very small mu", "moves",
        (10.0, 100.0, 990.0),  # not where everything has just been computed afresh
        Limit("error of the objective, nats per material", 1e-3, "less than the difference between starts of one "
        "fit"),
        {"dls": _drift},
        "No action needed: the factorisation is recomputed when its error grows.",
    ),
    Mode(
        "stopping_rule", "a direct local search cut short", "evaluations, as a divisor of 4000",
        (1.0, 10.0, 40.0, 400.0),
        Limit(
            "remaining distance to the minimum, relative to that of the start", 0.5,
            "a search that ends less than half-way has not converged; chosen after the results were known",
        ),
        {"curved valley": _stopped(_valley), "stairs": _stopped(_stairs)},
        "Check `success` and `message` of the result, and raise maxfev if the limit was reached.",
    ),
)  # fmt: skip
