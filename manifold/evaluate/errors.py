"""Measures the errors of predictions, holds the results of methods, and stores results of interrupted runs."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from manifold import __version__
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import Plausibility, plausibilities
from manifold.colour import panel
from manifold.colour.difference import colour_differences, illuminants_for, multi_angle_pairs
from manifold.core.metrics import Errors, RunningErrors
from manifold.core.pairs import Pairs
from manifold.core.records import Array, Indices, plain
from manifold.evaluate.method_data import Data
from manifold.library.store import Library
from manifold.model.combination import Combination, Values, evaluate

_HIGHEST_COSINE = float(np.cos(np.deg2rad(80.0)))  # nearer to the horizon values grow as 1 / cos

Predictions = Sequence[Sequence[Combination]]
"""The predictions of a method, one per material; lists of these hold one entry per method."""


class PredictionErrors:
    """Errors of one method's predictions of N materials, summed over blocks of direction pairs.

    Attributes:
        is_clipped: whether the method cuts negative values to 0.
        seconds: wall-clock time of predicting all materials.
    """

    def __init__(self, combinations: Sequence[Combination]) -> None:
        """Take N predictions in the bands of the values to come."""
        self._combinations = combinations
        self._errors = RunningErrors()
        self._squared: Array | float = 0.0  # sums over direction pairs, [N, B']
        self._bounded: Array | float = 0.0  # the same within 80 degrees, weighted by cosines
        self._weight = 0.0
        self._negative, self._count = 0, 0
        self.is_clipped = combinations[0].is_clipped
        self.seconds = 0.0

    def add(self, values: Values) -> None:
        """Add a block of measured values; the time of every method includes the mapping of these values."""
        start = time.perf_counter()
        predicted = evaluate(self._combinations, Values(values.f, values.wi, values.wo), clip=False)
        self.seconds += time.perf_counter() - start
        self._negative += int(np.count_nonzero(predicted < 0))
        self._count += predicted.size
        if self.is_clipped:
            np.maximum(predicted, 0.0, out=predicted)
        self._errors.add(values.f, predicted, values.cosines, values.roots)
        is_far = np.minimum(values.wi[:, 2], values.wo[:, 2]) >= _HIGHEST_COSINE
        weight = np.where(is_far, values.cosines, 0.0)
        squared = np.square(predicted - values.f)
        self._squared = self._squared + squared.sum(axis=1, dtype=np.float64)
        self._bounded = self._bounded + np.einsum("p,npb->nb", weight, squared)
        self._weight += float(weight.sum())

    def of_values(self, n_pairs: float = 1.0, shares: Array | float = 1.0) -> Errors[Array]:
        """Return the cube-root error, linear error and both RMSE of every material, each (N,).

        The RMSE sum over all bands; each measured band represents `shares` (B',) bands. Eq. 22 divides the sum by
        `n_pairs`.
        """
        rmse, rmse_80 = (
            np.sqrt(np.sum(shares * np.asarray(sums), axis=-1) / count)
            for sums, count in ((self._squared, n_pairs), (self._bounded, self._weight))
        )
        return replace(self._errors.errors(), rmse=rmse, rmse_80=rmse_80)

    @property
    def negative_share(self) -> float:
        """Share of the predicted values that are negative, or were negative before they were set to 0."""
        return self._negative / self._count


def measure_errors(
    predictions: Predictions, bands: Indices, blocks: Iterable[Values]
) -> list[PredictionErrors]:
    """Measure errors of several methods in one pass over blocks of measured values in some bands (B',)."""
    errors = [PredictionErrors([c.in_bands(bands) for c in each]) for each in predictions]
    for values in blocks:
        for one in errors:
            one.add(values)
    return errors


def standardised_error(data: Data, i: int, combination: Combination) -> float:
    """Return the error z of the mapped prediction of material i, in standard deviations estimated by the method.

    `z = sqrt(sum w (T(f) - T(f*))^2 / (P sum_b variance_b))` over direction pairs and the data's bands, with the
    weights `w = cos(theta_i) cos(theta_o)` of the Gram matrix. For calibrated methods, the root mean square of z is
    near 1.
    """
    here = combination.in_bands(data.bands)
    wrong = here.mapped(data) - data.mapped(combination.mapping)[i]  # [P, B']
    squared = float(np.sum(data.cosines[:, None] * wrong**2))
    assert here.variance is not None
    expected = float(np.mean(here.variance)) * wrong.size
    if expected <= 0.0:  # without variance: at a training latent, for example
        return 0.0 if squared == 0.0 else float("inf")
    return float(np.sqrt(squared / expected))


def colour_errors(materials: Sequence[MeasuredBRDF], predictions: Predictions) -> list[Errors[Array]]:
    """Return the colour differences and spectral angles at multi-angle geometries, for each method."""
    values, bands = Values.at(materials, Pairs(*multi_angle_pairs())), materials[0].bands
    errors: list[Errors[Array]] = []
    for each in predictions:
        predicted = evaluate(each, values)
        found = {
            name: colour_differences(values.f, predicted, bands, name) for name in illuminants_for(bands)
        }
        colours, angles = ({name: both[k].mean(axis=1) for name, both in found.items()} for k in (0, 1))
        errors.append(Errors(colours=colours, angles_deg=angles))
    return errors


def plausibility_results(
    materials: Sequence[MeasuredBRDF], bands: Indices, predictions: Predictions
) -> list[list[Plausibility]]:
    """Measure the plausibility of all predictions, method by method, in some bands."""
    selected = [material.select_bands(bands.tolist()) for material in materials]
    here = [[c.in_bands(bands) for c in each] for each in predictions]

    def predict(wi: Array, wo: Array) -> Array:
        values = Values.at(selected, Pairs(wi, wo))
        return np.concatenate([evaluate(each, values) for each in here])

    found = plausibilities(predict, all(material.is_isotropic for material in materials))
    return [found[k : k + len(materials)] for k in range(0, len(found), len(materials))]


@dataclass(frozen=True, kw_only=True)
class MethodErrors:
    """A method that was measured on materials.

    Attributes:
        key, title, is_held_out: as in `Method`.
        errors: errors of every material, each (N,).
    """

    key: str
    title: str
    is_held_out: bool = True
    errors: Errors[Array]

    @cached_property
    def median(self) -> Errors[float]:
        """Median over the materials."""
        return self.errors.median

    @cached_property
    def p90(self) -> Errors[float]:
        """90th percentile over the materials."""
        return self.errors.p90

    def to_json(self) -> dict[str, Any]:
        """Return plain values; errors also as medians and 90th percentiles."""
        return plain({field.name: getattr(self, field.name) for field in fields(self)} | self.errors.of_each)


class KeptResults:
    """Intermediate results of a long experiment, from which an interrupted run continues; they are kept in a library.

    `run` is a text with everything on which the results depend, except the library, the test lights and the package's
    version. Without a library, nothing is kept.
    """

    def __init__(self, library: Library | None, run: str) -> None:
        self._library = library
        content = "" if library is None else library.content_hash
        lights = panel.judged().signature
        self._key = hashlib.sha256(f"{run} {__version__} {content} {lights}".encode()).hexdigest()

    def get(self) -> dict[str, Array]:
        """Return the measurements that an interrupted experiment has kept; empty if there are none."""
        return {} if self._library is None else self._library.cache_get(self._key) or {}

    def put(self, arrays: Mapping[str, Array]) -> None:
        """Keep results in place of earlier ones."""
        if self._library is not None:
            self._library.cache_put(self._key, arrays)

    def finish(self) -> None:
        """Delete the results, so that the next experiment starts from the beginning."""
        self.put({})
