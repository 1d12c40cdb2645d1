"""Failure modes of the search for latents: starts, stopping, ambiguities between runs, precision, conditioning."""

from __future__ import annotations

from functools import partial

import numpy as np

from manifold.evaluate.stability.model_failures import held_out, in_error_of_nearest
from manifold.evaluate.stability.testbed import TestBed, in_space
from manifold.evaluate.stability.trials import HALF_OF_NEAREST, Limit, Measurement, Mode
from manifold.gplvm import GPLVM
from manifold.gpr import GaussianProcess
from manifold.kernels import SquaredExponential
from manifold.likelihood import centre_gram, pca_start
from manifold.mapping import MAPPINGS
from manifold.model.combination import Combination
from manifold.model.material_space import MaterialSpace
from manifold.model.prediction import PredictedBRDF
from manifold.records import Array

_MAPPING = MAPPINGS["cube-root"]
_SEARCHES = ("dls", "l-bfgs")
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


def _from_start(optimizer: str, bed: TestBed, scale: float) -> Measurement:
    """A fit from principal components that are disturbed by a standard deviation."""
    S = _gram(bed)
    start = pca_start(centre_gram(S), 2) + scale * np.random.default_rng(0).normal(size=(len(S), 2))
    return _held_out_by(bed, _fit(bed, S, optimizer, start))


def _again(optimizer: str, bed: TestBed, change: float) -> Measurement:
    """The same library, its materials in another order and their values changed a little: how far latents move."""
    S, rng = _gram(bed), np.random.default_rng(0)
    first = bed.cached(("fit", optimizer), lambda: _fit(bed, S, optimizer).embedding_)
    order, scale = rng.permutation(len(S)), 1.0 + change * rng.normal(size=len(S))
    other = (S * scale[:, None] * scale)[np.ix_(order, order)]
    X = np.empty_like(first)
    X[order] = _fit(bed, other, optimizer).embedding_
    return Measurement(float(np.abs(X - first).max() / np.ptp(first)))


# -- numbers -----------------------------------------------------------------------------------------------


def _ill_conditioned(bed: TestBed, length_scale: float) -> Measurement:
    """The held-out plastic from the weights of a kernel without observation noise."""
    model, truth = bed.model("material"), held_out(bed)
    x = bed.cached("latent of the held-out plastic", lambda: model.embed(truth).latent)
    weights = GaussianProcess(model.X, SquaredExponential(0.0, length_scale)).weights(x[None])[0]
    brdf = PredictedBRDF(model.materials.filled(), Combination(model.mapping, weights))
    return Measurement(in_error_of_nearest(bed, brdf))


MODES: tuple[Mode, ...] = (
    Mode(
        "bad_starts", "fits from disturbed principal components", "standard deviation, in length scales",
        (0.1, 1.0, 10.0, 100.0), HALF_OF_NEAREST, {name: partial(_from_start, name) for name in _SEARCHES},
        "Keep the start from principal components: from a distant start no search converges.",
    ),
    Mode(
        "run_to_run", "a second fit, with another order of materials and perturbed values", "relative change",
        (0.0, 1e-9, 1e-6, 1e-4),
        Limit(
            "largest shift of a latent, in widths of the map", 0.25,
            "a material moves to another quarter of the map",
        ),
        {name: partial(_again, name) for name in _SEARCHES},
        "Compare distances, not coordinates, between maps of different libraries; axes may be mirrored.",
    ),
    Mode(
        "ill_conditioned_kernel", "weights of a kernel without observation noise", "length scale l",
        (1.0, 10.0, 1e2, 1e4, 1e7), HALF_OF_NEAREST, {"GP": _ill_conditioned},
        "Raise mu to the value in the warning; with a nearly singular kernel matrix, digits are lost.",
    ),
)  # fmt: skip
