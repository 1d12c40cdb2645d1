"""How good a fitted manifold is: reconstruction, leave-one-out against simple baselines, plausibility, times."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from manifold import __version__, gram
from manifold.brdf import MeasuredBRDF
from manifold.gplvm import GPLVM
from manifold.mapping import Mapping, mapping_named
from manifold.metrics import RunningErrors, RusinkiewiczGrid, cosine_weight
from manifold.model import Manifold
from manifold.plausibility import plausibilities
from manifold.records import Array

Progress = Callable[[int, int, str], None]

SEED_MAPPING = "identity"
_REFIT_TOLERANCE = 1e-4  # of the N refits of leave-one-out: finer ones move no error by more than it varies


@dataclass(frozen=True)
class Method:
    """A way to predict every material.

    Attributes:
        key: name in the JSON report.
        title: name in the text report.
        weights: of the materials for each prediction, shape (N, N).
        mapping: under which they are combined.
        seconds: what finding the weights took.
        is_held_out: whether the diagonal of the weights is zero.
    """

    key: str
    title: str
    weights: Array
    mapping: Mapping
    seconds: float
    is_held_out: bool = True


@dataclass(frozen=True)
class MethodResult:
    """Errors of one method.

    Attributes:
        key, title, seconds, is_held_out: as in `Method`.
        rmse: eq. 22 of Hikichi & Iwasaki per material, in 1/sr.
        relative_error: cosine-weighted, per material.
        median_relative_error, p90_relative_error: over materials.
        negative_share: share of predicted values below zero.
        reciprocity_error: worst over materials; see `plausibility`.
        max_albedo: worst over materials.
    """

    key: str
    title: str
    seconds: float
    is_held_out: bool
    rmse: tuple[float, ...]
    relative_error: tuple[float, ...]
    median_relative_error: float
    p90_relative_error: float
    negative_share: float
    reciprocity_error: float
    max_albedo: float


@dataclass(frozen=True)
class Report:
    """What `manifold report` prints and writes.

    Attributes:
        names: materials, in the order of all per-material tuples.
        latents: shape (N, Q) as nested tuples.
        is_synthetic: per material, whether its file says so.
        bands: the spectral axis in words.
        grid: name of the grid of direction pairs.
        n_pairs: its size, pairs below the horizon included.
        settings: of the model.
        condition: kappa(K).
        methods: reconstruction first, then what was held out.
        seconds: of the stages of the report.
    """

    names: tuple[str, ...]
    latents: tuple[tuple[float, ...], ...]
    is_synthetic: tuple[bool, ...]
    bands: str
    grid: str
    n_pairs: int
    settings: dict[str, Any]
    condition: float
    methods: tuple[MethodResult, ...]
    seconds: dict[str, float]

    def to_json(self) -> dict[str, Any]:
        """The report as plain values, with the program's version."""
        return {"program": f"manifold {__version__}", **asdict(self)}


def make_report(model: Manifold, grid_name: str = "default", on_progress: Progress | None = None) -> Report:
    """Evaluate a model on a grid of direction pairs.

    Args:
        model: a fitted manifold.
        grid_name: `default`, or `seed` for the 1,458,000 pairs of Hikichi & Iwasaki.
        on_progress: called with (done, total, what).
    Raises:
        UsageError: the grid is unknown.
        LibraryError: a material cannot be read.
    """
    grid = RusinkiewiczGrid.named(grid_name)
    materials, load_seconds = _timed(lambda: model.load_materials(on_progress))
    methods = _methods(model)
    results, evaluate_seconds = _timed(lambda: _evaluate(model, materials, methods, grid, on_progress))
    return Report(
        names=model.names,
        latents=tuple(tuple(float(v) for v in row) for row in model.X),
        is_synthetic=tuple(model.library.attributes(name).is_synthetic for name in model.names),
        bands=str(model.bands),
        grid=grid_name,
        n_pairs=grid.n_pairs,
        settings=dict(vars(model.settings)),
        condition=model.gp.condition,
        methods=results,
        seconds={"load": load_seconds, "evaluate": evaluate_seconds},
    )


def _timed(work: Callable[[], Any]) -> tuple[Any, float]:
    start = time.perf_counter()
    result = work()
    return result, time.perf_counter() - start


def _methods(model: Manifold) -> list[Method]:
    """Every method with the weights it predicts each material by."""
    mapping, identity = model.mapping, mapping_named(SEED_MAPPING)
    methods = []

    def add(
        key: str, title: str, weights: Callable[[], Array], mapping: Mapping, held_out: bool = True
    ) -> None:
        found, seconds = _timed(weights)
        methods.append(Method(key, title, found, mapping, seconds, held_out))

    add("reconstruction", "reconstruction", lambda: model.weights(model.X), mapping, False)
    add("gp_refitted", "GP, refitted without it", lambda: _refitted_weights(model), mapping)
    add("gp_latents_kept", "GP, latents kept", model.gp.leave_one_out_weights, mapping)
    add("linear", "linear, two nearest", lambda: _linear_weights(model.S), identity)
    add("nearest", "nearest material", lambda: _nearest_weights(model.S), identity)
    return methods


def _squared_distances(S: Array) -> Array:
    """Squared distances between mapped materials (N, N), infinite on the diagonal."""
    norm = np.diag(S)
    distance = norm[:, None] + norm[None, :] - 2.0 * S
    np.fill_diagonal(distance, np.inf)
    return distance


def _nearest_weights(S: Array) -> Array:
    """The nearest other material, in the mapped domain."""
    weights = np.zeros_like(S)
    weights[np.arange(len(S)), np.argmin(_squared_distances(S), axis=1)] = 1.0
    return weights


def _linear_weights(S: Array) -> Array:
    """The best point between the two nearest other materials (Hikichi & Iwasaki, eq. 23)."""
    weights = np.zeros_like(S)
    if len(S) < 3:
        return _nearest_weights(S)
    for i, (a, b) in enumerate(np.argsort(_squared_distances(S), axis=1)[:, :2]):
        span = S[a, a] + S[b, b] - 2.0 * S[a, b]
        along = (S[i, a] - S[i, b] - S[a, b] + S[b, b]) / span if span > 0 else 0.5
        alpha = min(max(along, 0.0), 1.0)
        weights[i, a], weights[i, b] = alpha, 1.0 - alpha
    return weights


def _refitted_weights(model: Manifold) -> Array:
    """Encode-decode leave-one-out: fit on the others, find the left-out material's latent from its data."""
    N, settings = len(model.names), model.settings
    weights = np.zeros((N, N))
    for i in range(N):
        others = np.delete(np.arange(N), i)
        S = model.S[np.ix_(others, others)]
        latent_dim = min(settings.latent_dim, N - 2)
        if latent_dim < 1:
            weights[i, others] = 1.0 / len(others)
            continue
        # The fit starts from principal components of the others: it must not have seen the left-out one.
        fitted = GPLVM(
            latent_dim,
            mu=settings.mu,
            length_scale=settings.length_scale,
            optimizer=settings.optimizer,
            tol=_REFIT_TOLERANCE,
        ).fit_gram(S, model.n_outputs)
        x = fitted.transform_gram(
            model.S[i, others][None, :], np.array([model.S[i, i]]), criterion="residual"
        )
        weights[i, others] = fitted.weights(x)[0]
    return weights


def _evaluate(
    model: Manifold,
    materials: Sequence[MeasuredBRDF],
    methods: Sequence[Method],
    grid: RusinkiewiczGrid,
    on_progress: Progress | None,
) -> tuple[MethodResult, ...]:
    """Errors of all methods in one walk over the grid, so that every material is evaluated once per pair."""
    N = len(materials)
    errors = [[RunningErrors() for _ in range(N)] for _ in methods]
    negative = np.zeros(len(methods))
    values = 0
    total = -(-grid.n_pairs // gram.BLOCK_PAIRS)
    for done, (wi, wo, f) in enumerate(gram.value_blocks(materials, grid), start=1):
        weight = cosine_weight(wi, wo)
        values += f.size
        for m, method in enumerate(methods):
            predicted = combine(method.weights, f, method.mapping, weight)
            negative[m] += np.count_nonzero(predicted < 0)
            for i in range(N):
                errors[m][i].add(f[i], predicted[i], weight)
        if on_progress is not None:
            on_progress(done, total, "direction pairs")
    results = []
    for m, method in enumerate(methods):
        relative = np.array([e.relative_error for e in errors[m]])
        physical = plausibilities(partial(_predict_pairs, materials, method))
        results.append(
            MethodResult(
                key=method.key,
                title=method.title,
                seconds=method.seconds,
                is_held_out=method.is_held_out,
                rmse=tuple(e.rmse_over(grid.n_pairs) for e in errors[m]),
                relative_error=tuple(float(e) for e in relative),
                median_relative_error=float(np.median(relative)),
                p90_relative_error=float(np.percentile(relative, 90)),
                negative_share=float(negative[m] / values),
                reciprocity_error=max(p.reciprocity_error for p in physical),
                max_albedo=max(p.max_albedo for p in physical),
            )
        )
    return tuple(results)


def _predict_pairs(materials: Sequence[MeasuredBRDF], method: Method, wi: Array, wo: Array) -> Array:
    """Predictions of one method for all materials at direction pairs (P, 3), shape (N, P, B)."""
    f = np.stack([m.eval(wi, wo) for m in materials])
    return combine(method.weights, f, method.mapping, cosine_weight(wi, wo))


def combine(weights: Array, f: Array, mapping: Mapping, cosines: Array) -> Array:
    """Predictions T^-1(V T(f)) from values f (N, P, B) by weights V (M, N), shape (M, P, B).

    `cosines` is cos(theta_i) cos(theta_o) per direction pair, shape (P,).

    A row that is a unit vector returns that material's values bit for bit.
    """
    mapped = mapping.forward(f, np.broadcast_to(cosines, f.shape[:2])).reshape(len(f), -1)
    combined = (weights @ mapped).reshape(len(weights), *f.shape[1:])
    predicted = mapping.inverse(combined, np.broadcast_to(cosines, combined.shape[:2]))
    for row, single in enumerate(np.count_nonzero(weights, axis=1) == 1):
        source = int(np.argmax(weights[row]))
        if single and weights[row, source] == 1.0:
            predicted[row] = f[source]
    return predicted
