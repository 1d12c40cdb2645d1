"""The cross-validation loop: fit without some materials, encode these from their data.

Latents fitted with the left-out material, or the reconstruction of training data, would be optimistic.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from manifold.errors import ShapeError
from manifold.experiments.evaluation.method import Encode, Fit, Method
from manifold.experiments.evaluation.tabulated import Data
from manifold.model.combination import Combination
from manifold.records import Array
from manifold.system.parallel import one_blas_thread

Split = tuple[Array, Array]
"""Indices of the materials to learn from, and of those to predict."""


Lap = Callable[[Callable[[], Any]], tuple[Any, float]]
"""Does some work, and says what it gave and how long it took."""


def wall_clock(work: Callable[[], Any]) -> tuple[Any, float]:
    """The result of some work, and its duration in seconds."""
    start = time.perf_counter()
    result = work()
    return result, time.perf_counter() - start


def leave_out(n_materials: int, n_folds: int | None = None) -> list[Split]:
    """Every material left out once: one at a time, or dealt into so many folds."""
    n_folds = n_materials if n_folds is None else n_folds
    everything = np.arange(n_materials)
    folds = [everything[k::n_folds] for k in range(n_folds)]
    return [(np.setdiff1d(everything, fold), fold) for fold in folds]


def all_as_training(n_materials: int) -> list[Split]:
    """One split, without any held out: all materials are training materials, and all are predicted."""
    return [(np.arange(n_materials), np.arange(n_materials))]


@dataclass(frozen=True, eq=False)
class Encoded:
    """Predictions of a method for every material, and their times.

    Attributes:
        combinations: the predictions, one per material that was left out, in the order of the materials.
        fit_times: of the fits, split by split.
        encode_times: of encoding, split by split, all its materials together.
    """

    combinations: tuple[Combination, ...]
    fit_times: tuple[float, ...]
    encode_times: tuple[float, ...]


def cross_validate(
    data: Data,
    fit: Fit,
    splits: Sequence[Split],
    *,
    lap: Lap = wall_clock,
    own_tables: int = 1,
    on_material: Callable[[int], None] | None = None,
) -> Encoded:
    """Encode every material after a fit to what its split learns from.

    Args:
        data: of all materials.
        fit: see `Method`.
        splits: each material is predicted in one of them, or in none.
        lap: measures times.
        own_tables: so many fits first map the values and multiply them anew, which is part of their time.
        on_material: called with the number of materials done.
    Raises:
        ShapeError: a fit has too few different materials to learn from.
    """
    found: dict[int, Combination] = {}
    fit_times, encode_times = [], []
    for k, (training, left_out) in enumerate(splits):
        if k < own_tables:
            data = data.unmapped()
        with one_blas_thread:  # the matrices are small: a second thread costs more than it does
            encode, seconds = lap(partial(_fit, fit, data, training))
            fit_times.append(seconds)
            encode_times.append(0.0)
            for i in left_out.tolist():
                found[i], seconds = wall_clock(partial(encode, i))
                encode_times[-1] += seconds
                if on_material is not None:
                    on_material(len(found))
    return Encoded(tuple(found[i] for i in sorted(found)), tuple(fit_times), tuple(encode_times))


def encode_all(data: Data, method: Method, on_material: Callable[[int], None] | None = None) -> Encoded:
    """Encode every material: left out of the fit if the method refits, else all by one fit."""
    splits = (leave_out if method.refits else all_as_training)(data.n_materials)
    return cross_validate(data, method.fit, splits, on_material=on_material)


def _fit(fit: Fit, data: Data, training: Array) -> Encode:
    try:
        return fit(data, training)
    except ShapeError as error:
        raise ShapeError(
            f"learning from {len(training)} of {data.n_materials} materials: {error}; import more that differ"
        ) from error
