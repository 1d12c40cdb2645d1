"""Fits to the evaluated materials themselves, for comparison with predictions of left-out materials."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from manifold.brdf.interface import EvaluableBRDF
from manifold.core.mapping import Identity
from manifold.core.metrics import Errors
from manifold.core.pairs import Pairs
from manifold.core.records import Array, BsdfFile, Indices, evenly_spaced
from manifold.evaluate.cross_validation import BYTES_PER_NUMBER, Encode, Method
from manifold.evaluate.held_out import ChartRow, HeldOut
from manifold.evaluate.method_data import Data
from manifold.evaluate.stopwatch import RelativeTime
from manifold.fit import principled
from manifold.fit.principled import FitResult, fit_bsdf
from manifold.model.combination import Combination, Values
from manifold.render import backend
from manifold.render.bsdf_evaluation import evaluator


@dataclass(frozen=True, eq=False)
class FittedPrediction(Combination):
    """A prediction that is a BRDF by itself instead of a combination of measured materials.

    Attributes:
        brdf: the BRDF, in all bands; None without a fit, when every value is NaN.
        bands: indices of the bands that are used, shape (B,).
    """

    brdf: EvaluableBRDF | None = field(kw_only=True)
    bands: Indices = field(kw_only=True)

    @classmethod
    def of(cls, brdf: EvaluableBRDF | None, n_bands: int) -> FittedPrediction:
        """Return the prediction that uses all bands of a BRDF; None stands for a missing fit."""
        bands = np.arange(n_bands)
        return cls(Identity(), np.zeros((n_bands, 0)), bands[:0], is_clipped=False, brdf=brdf, bands=bands)

    def in_bands(self, bands: Indices) -> FittedPrediction:
        """Return the prediction in some bands (B',)."""
        return replace(self, bands=self.bands[bands])

    def mapped(self, values: Values) -> Array:
        """Return f in 1/sr, shape (P, B)."""
        if self.brdf is None:
            return np.full((len(values.wi), len(self.bands)), np.nan)
        return self.brdf.eval(values.wi, values.wo)[:, self.bands]


def seen_principled() -> Method:
    """Return the method that fits Mitsuba's `principled` to the evaluated materials themselves."""

    def fit_principled(data: Data, training: Indices) -> Encode:
        def encode(i: int) -> Combination:
            return FittedPrediction.of(fit_bsdf(data.materials[i]).brdf, data.n_bands)

        return encode

    return Method(
        "principled",
        "principled",
        lambda B: B + 6,
        fit_principled,
        is_held_out=False,
        refits=False,
    )


METHODS = ("gauss-newton", "adam", "swarm")
"""Methods of `registries.FITTERS`."""

FAMILY = "fit of the seen material"
_TITLES = {"gauss-newton": "fit, Gauss-Newton", "adam": "fit, Adam", "swarm": "fit, swarm"}
_REPEATS = 3

_Predictor = Callable[[Pairs], Callable[[], Array]]
"""A function from direction pairs to a function that predicts f in all bands there."""


def measure(method: str, files: Sequence[BsdfFile], count: int, held: HeldOut) -> ChartRow:
    """Fit evenly spaced materials by one of `METHODS`.

    The time to predict is measured at as many direction pairs as the material's file has.
    """
    measured, fits, numbers = [], [], []
    for i in evenly_spaced(len(files), count).tolist():
        with backend.one_thread():
            result, seconds = held.watch.lap(partial(principled.fit_bsdf, files[i], method=method))
            measured.append(_measured(i, files[i], partial(_evaluator, result), held))
        fits.append(seconds)
        numbers.append(sum(np.size(value) for value in (dict(result.values) | result.spectra).values()))
    time = RelativeTime.of(np.array(fits) * len(files))
    return _row(f"fit_{method}", _TITLES[method], measured, time, int(np.median(numbers)) * len(files))


def _measured(i: int, file: BsdfFile, predictor: _Predictor, held: HeldOut) -> tuple[Errors[float], Array]:
    """Return errors of a prediction of material i, and times of repeated runs."""
    on_grid, on_ball = predictor(held.pairs), predictor(held.balls.lights)
    errors = held.errors(i, *(evaluate()[:, held.data.bands] for evaluate in (on_grid, on_ball)))
    return errors, file.luminance.size / len(held.pairs) * held.watch.laps(on_grid, _REPEATS)


def _row(
    key: str, title: str, measured: Sequence[tuple[Errors[float], Array]], fit: RelativeTime | None, numbers: int
) -> ChartRow:  # fmt: skip
    errors, times = zip(*measured, strict=True)
    return ChartRow(
        key=key, title=title, family=FAMILY, is_held_out=False, errors=Errors.of_several(errors), fit=fit,
        predict=RelativeTime.of_several(times), bytes=numbers * BYTES_PER_NUMBER,
    )  # fmt: skip


def _evaluator(result: FitResult, pairs: Pairs) -> Callable[[], Array]:
    """Return a function that evaluates a fit in the bands of its samples, f in 1/sr (P, B)."""
    made = evaluator(result.family, pairs.wi, pairs.wo, result.bands.count)
    p = made.layout.join(result.values | result.spectra)
    return lambda: np.asarray(made.values(p)[0], dtype=np.float64) / pairs.wo[:, 2:]
