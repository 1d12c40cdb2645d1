"""Errors of predictions: linear and cube-root error, eq. 22, and calibration, over blocks of measured values."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from manifold.experiments.evaluation.tabulated import Data
from manifold.metrics import RunningErrors
from manifold.model.combination import Combination, Values, evaluate
from manifold.records import Array


class MedianAndP90(NamedTuple):
    """Median and 90th percentile of an error over materials."""

    median: float
    p90: float

    @classmethod
    def of(cls, errors: Array) -> MedianAndP90:
        """Of errors (N,); those that are NaN, of materials without a prediction, do not count."""
        return cls(float(np.nanmedian(errors)), float(np.nanpercentile(errors, 90)))


class PredictionErrors:
    """Errors of one method's predictions of N materials, summed over blocks of direction pairs.

    Attributes:
        is_clipped: whether the method cuts negative values to 0.
        seconds: of predicting all materials, wall-clock.
    """

    def __init__(self, combinations: Sequence[Combination]) -> None:
        """Take N predictions in the bands of the values to come."""
        self._combinations = combinations
        self._errors = RunningErrors()
        self._negative, self._count = 0, 0
        self.is_clipped = combinations[0].is_clipped
        self.seconds = 0.0

    def add(self, values: Values) -> None:
        """Count a block of measured values; what their mapping costs counts for every method."""
        start = time.perf_counter()
        predicted = evaluate(self._combinations, Values(values.f, values.wi, values.wo), clip=False)
        self.seconds += time.perf_counter() - start
        self._negative += int(np.count_nonzero(predicted < 0))
        self._count += predicted.size
        if self.is_clipped:
            np.maximum(predicted, 0.0, out=predicted)
        self._errors.add(values.f, predicted, values.cosines, values.roots)

    @property
    def linear(self) -> Array:
        """`||w (f* - f)|| / ||w f||` of every material, `w = cos(theta_i) cos(theta_o)`, shape (N,)."""
        return self._errors.relative_error

    @property
    def cube_root(self) -> Array:
        """`||(w f*)^(1/3) - (w f)^(1/3)|| / ||(w f)^(1/3)||` of every material, shape (N,)."""
        return self._errors.cube_root_error

    def rmse(self, n_pairs: float) -> Array:
        """Eq. 22 of Hikichi & Iwasaki in 1/sr, the sum divided by `n_pairs`, shape (N,)."""
        return self._errors.rmse(n_pairs)

    @property
    def negative_share(self) -> float:
        """Share of the values that are negative, or were before they were cut."""
        return self._negative / self._count


def measure_errors(
    predictions: Sequence[Sequence[Combination]], bands: Array, blocks: Iterable[Values]
) -> list[PredictionErrors]:
    """Errors of several methods in one walk over blocks, so that every material is evaluated once per pair.

    Args:
        predictions: per method, one per material.
        bands: which bands the values are in, shape (B',).
        blocks: measured values of the materials.
    """
    errors = [PredictionErrors([c.in_bands(bands) for c in each]) for each in predictions]
    for values in blocks:
        for one in errors:
            one.add(values)
    return errors


def standardised_error(data: Data, i: int, combination: Combination) -> float:
    """Error of the mapped prediction of material i, in the standard deviations that the method expected.

    `z = sqrt(sum w (T(f) - T(f*))^2 / (P sum_b variance_b))` over pairs and the data's bands, with the weight
    `w = cos(theta_i) cos(theta_o)` that outputs have in the Gram matrix. Calibrated methods have a root mean
    square of z near 1.
    """
    here = combination.in_bands(data.bands)
    wrong = here.mapped(data) - data.mapped(combination.mapping)[i]  # [P, B']
    squared = float(np.sum(data.cosines[:, None] * wrong**2))
    assert here.variance is not None
    expected = float(np.mean(here.variance)) * wrong.size
    if expected <= 0.0:  # a method that is sure: of a training latent, say
        return 0.0 if squared == 0.0 else float("inf")
    return float(np.sqrt(squared / expected))
