"""Cross-validation: fits methods without some materials, and then predicts these from their data.

Errors would be too small if latents were fitted with the left-out material, or if training data were reconstructed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from manifold.core.errors import ShapeError
from manifold.core.records import Array, Indices
from manifold.core.threads import one_blas_thread
from manifold.evaluate.method_data import Data
from manifold.evaluate.storage_forms import WHOLE, Storage
from manifold.model.combination import Combination

BYTES_PER_NUMBER = 8
"""Size of each number that a method stores for a material: double precision."""

Encode = Callable[[int], Combination]
"""A function from the index of a material to its prediction."""

Fit = Callable[[Data, Indices], Encode]
"""A function of data and training indices that returns an encoder of any material."""

Map = Callable[[Data], tuple[Array, Callable[[Array], Combination]]]
"""A function of data that returns the points (N, Q) of all materials, and the prediction at a point (Q,)."""

Split = tuple[Indices, Indices]
"""Indices of the materials to learn from, and of those to predict."""


@dataclass(frozen=True)
class Method:
    """A way to predict materials, at one choice of its settings.

    Attributes:
        key: name in JSON.
        title: for people.
        numbers: function from the number of bands to the number of parameters of a material.
        fit: function that learns from some materials, and returns a function that predicts any material.
        is_held_out: whether a material is predicted from the other materials only.
        refits: whether every left-out material needs a fit without it; if False, one fit to all is enough, because
            `fit` itself leaves each material out.
        sample_bands: largest number of bands of the measured files that predictions need; None means all.
        fits_model: whether a fit searches for latents, which takes long.
        family: family of methods in the legend of a chart.
        storage: form in which the measured files are stored.
        threshold: weights below this share of the largest weight are dropped.
        is_dense: whether every material is resampled to the grid of 1,458,000 direction pairs.
        map: function that returns the map of all materials, if the method has one.
    """

    key: str
    title: str
    numbers: Callable[[int], int]
    fit: Fit
    is_held_out: bool = True
    refits: bool = True
    sample_bands: int | None = None
    fits_model: bool = False
    family: str = ""
    storage: Storage = WHOLE
    threshold: float = 0.0
    is_dense: bool = False
    map: Map | None = None


def leave_out(n_materials: int, n_folds: int | None = None) -> list[Split]:
    """Return splits that leave out every material once, one at a time or in `n_folds` folds."""
    n_folds = n_materials if n_folds is None else n_folds
    everything = np.arange(n_materials)
    folds = [everything[k::n_folds] for k in range(n_folds)]
    return [(np.setdiff1d(everything, fold), fold) for fold in folds]


def wall_clock(work: Callable[[], Any]) -> tuple[Any, float]:
    """Return the result of some work, and its duration in seconds."""
    start = time.perf_counter()
    result = work()
    return result, time.perf_counter() - start


@dataclass(frozen=True, eq=False)
class Encoded:
    """Predictions of the left-out materials, in order, and the times of fitting and of encoding for every split."""

    combinations: tuple[Combination, ...]
    fit_times: tuple[float, ...]
    encode_times: tuple[float, ...]


def cross_validate(
    data: Data,
    fit: Fit,
    splits: Sequence[Split],
    *,
    lap: Callable[[Callable[[], Any]], tuple[Any, float]] = wall_clock,
    own_tables: int = 1,
    on_material: Callable[[int], None] | None = None,
) -> Encoded:
    """Predict the left-out materials of every split by a method that is fitted to its training materials.

    A material is left out at most once. `lap` runs a fit and measures its time. The first `own_tables` fits compute
    mapped values and their inner products again, so that their times include this work. `on_material` is called with
    the number of finished materials.
    """
    found: dict[int, Combination] = {}
    fit_times, encode_times = [], []
    for k, (training, left_out) in enumerate(splits):
        if k < own_tables:
            data = data.unmapped()
        with one_blas_thread:  # the matrices are small: a second thread costs more than it does
            try:
                encode, seconds = lap(partial(fit, data, training))
            except ShapeError as error:
                known = f"learning from {len(training)} of {data.n_materials} materials"
                raise ShapeError(f"{known}: {error}; import more that differ") from error
            fit_times.append(seconds)
            encode_times.append(0.0)
            for i in left_out.tolist():
                found[i], seconds = wall_clock(partial(encode, i))
                encode_times[-1] += seconds
                if on_material is not None:
                    on_material(len(found))
    return Encoded(tuple(found[i] for i in sorted(found)), tuple(fit_times), tuple(encode_times))


def encode_all(data: Data, method: Method, on_material: Callable[[int], None] | None = None) -> Encoded:
    """Predict every material, by fits without it if the method refits, otherwise by one fit to all."""
    everything = np.arange(data.n_materials)
    splits = leave_out(data.n_materials) if method.refits else [(everything, everything)]
    return cross_validate(data, method.fit, splits, on_material=on_material)
