"""Fits of a BSDF to the evaluated materials themselves, for comparison with held-out predictions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from manifold.brdf.pairs import DirectionPairs
from manifold.experiments.chart.instruments import Measurement, RelativeTime, Stopwatch, Target, summary
from manifold.experiments.evaluation.anchors import NEURAL_NUMBERS, neural_fits
from manifold.fitting import principled
from manifold.fitting.bsdf_evaluation import evaluator
from manifold.fitting.principled import FitResult
from manifold.records import Array, BsdfFile, evenly_spaced
from manifold.rendering import backend

METHODS = ("gauss-newton", "adam", "swarm")
"""Of `principled.METHODS`."""
NEURAL = "neural"
TITLES = {
    "gauss-newton": "fit, Gauss-Newton",
    "adam": "fit, Adam",
    "swarm": "fit, swarm",
    NEURAL: "fit, neural",
}

FAMILY = "fit of the seen material"
_REPEATS = 3
_BYTES_PER_NUMBER = 8


def measure(
    method: str, files: Sequence[BsdfFile], count: int, target: Target, watch: Stopwatch
) -> Measurement:
    """Fit evenly spaced materials by one of `METHODS`.

    Predictions are evaluations at as many direction pairs as the material's file has.

    Raises:
        UsageError, RendererError: the method does not run here, or Mitsuba is missing.
    """
    errors, fits, predicts, numbers = [], [], [], []
    for i in evenly_spaced(len(files), count):
        file = files[i]
        with backend.one_thread():
            result, seconds = watch.lap(partial(principled.fit_bsdf, file, method=method))
            fits.append(seconds)
            evaluators = [_evaluate(result, pairs) for pairs in (target.pairs, target.balls.pairs)]
            on_grid, on_ball = (evaluate()[:, target.data.bands] for evaluate in evaluators)
            scale = file.luminance.size / len(target.pairs)
            predicts.append(scale * watch.laps(evaluators[0], _REPEATS))
        errors.append(target.errors(int(i), on_grid, on_ball))
        numbers.append(sum(np.size(value) for value in (dict(result.values) | result.spectra).values()))
    return Measurement(
        **summary(errors),
        fit=RelativeTime.of(np.array(fits) * len(files)),
        predict=RelativeTime.of_several(predicts),
        bytes=int(np.median(numbers)) * _BYTES_PER_NUMBER * len(files),
    )


def measure_neural(source: str, files: Sequence[BsdfFile], target: Target, watch: Stopwatch) -> Measurement:
    """Published neural fits of the materials that have one; the time to fit them is not known.

    Raises:
        UsageError: there is no such source, or none of its fits is of one of the materials.
        FileFormatError: the source holds no neural fits, or damaged ones.
    """
    found = neural_fits(source, [file.name for file in files], files[0].bands)
    errors, predicts = [], []
    for i, fit in found.items():
        on_grid, on_ball = (
            fit.eval(at.wi, at.wo)[:, target.data.bands] for at in (target.pairs, target.balls.pairs)
        )
        errors.append(target.errors(i, on_grid, on_ball))
        scale = files[i].luminance.size / len(target.pairs)
        predicts.append(scale * watch.laps(partial(fit.eval, target.pairs.wi, target.pairs.wo), _REPEATS))
    return Measurement(
        **summary(errors),
        fit=None,
        predict=RelativeTime.of_several(predicts),
        bytes=NEURAL_NUMBERS * _BYTES_PER_NUMBER * len(files),
    )


def _evaluate(result: FitResult, pairs: DirectionPairs) -> Callable[[], Array]:
    """The BRDF of a fit in the bands of its samples, f in 1/sr (P, B)."""
    made = evaluator(result.family, pairs.wi, pairs.wo, result.bands.count)
    p = made.layout.join(result.values | result.spectra)
    return lambda: np.asarray(made.values(p)[0], dtype=np.float64) / pairs.wo[:, 2:]
