"""Expected errors of a completion: those of the library's materials, completed from the same directions."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls

from manifold.brdf.gloss import gloss_meter
from manifold.colour import ball_colours
from manifold.colour.conversion import luminance
from manifold.formats.readings import Readings
from manifold.metrics import cube_root_error, relative_error
from manifold.model.completion.complete import Completion, complete_at
from manifold.model.completion.samples import LibrarySamples
from manifold.models.expected_error import BELOW_TWICE
from manifold.records import Array, Bands

KINDS = ("ball", "cube_root", "linear")
_STRENGTH = 0.1  # of the prior that errors do not depend on an indicator, in units of its variance


@dataclass(frozen=True, eq=False)
class Calibration:
    """Errors of left-out materials of a library, completed from the directions of some readings.

    Attributes:
        errors: ball CIEDE2000, cube-root error and linear error of every material, shape (N, 3).
        indicators: residual of the readings and spread of hypotheses, from which errors are predicted, shape (N, 2).
    """

    errors: Array
    indicators: Array

    def expected(self, found: Completion) -> dict[str, float]:
        """Expected errors of a completion from these directions, by kind.

        Logarithms of errors are linear in those of the indicators, with non-negative slopes. As for predictions, at
        least half of the left-out errors are below the expected one, and 90 % below twice that.
        """
        every = np.ones(len(self.indicators), bool)
        return dict(zip(KINDS, self._line(indicators_of(found), every).tolist(), strict=True))

    def notes(self, found: Completion) -> tuple[str, ...]:
        """A note where the residual of the readings is larger than that of any left-out material."""
        residual, largest = indicators_of(found)[0], self.indicators[:, 0].max()
        if residual <= largest:
            return ()
        return (
            f"the readings are met with a residual of {100.0 * residual:.0f} %, those of left-out materials with at "
            f"most {100.0 * largest:.0f} %: two samples, other units or directions, or a kind that the library lacks; "
            "errors may be larger than expected",
        )

    @property
    def left_out(self) -> Array:
        """Expected errors of every material, learned from the others, shape (N, 3)."""
        every = np.arange(len(self.indicators))
        return np.array([self._line(self.indicators[i], every != i) for i in every])

    def _line(self, indicators: Array, known: Array) -> Array:
        x, y = (np.log(np.maximum(a[known], 1e-6)) for a in (self.indicators, self.errors))
        centre, level = x.mean(axis=0), y.mean(axis=0)
        scale = x.std(axis=0) + 1e-6
        X = np.vstack([(x - centre) / scale, np.sqrt(_STRENGTH * len(x)) * np.eye(x.shape[1])])
        at = (np.clip(np.log(np.maximum(indicators, 1e-6)), x.min(axis=0), x.max(axis=0)) - centre) / scale
        slopes = np.array([nnls(X, np.append(column, np.zeros(x.shape[1])))[0] for column in (y - level).T])
        above = y - level - X[: len(x)] @ slopes.T
        enough = np.quantile(above, BELOW_TWICE, axis=0) - np.log(2.0)
        return np.exp(level + slopes @ at + np.maximum(np.median(above, axis=0), enough))


def indicators_of(found: Completion) -> Array:
    """Indicators of its error, shape (2,): root mean square residual of readings, spread of hypotheses."""
    return np.array([float(np.sqrt(np.mean(found.misfits**2))), found.spread])


def calibrate(samples: LibrarySamples, readings: Readings) -> Calibration:
    """Complete every material of a library from the others, at the directions and in the bands of some readings.

    Args:
        samples: of the library.
        readings: of which only directions, bands and weights are used.
    """
    at_readings, at_gloss = samples.at(readings.wi, readings.wo), samples.gloss(tuple(readings.gloss))
    errors, indicators = [], []
    for m in range(len(samples.names)):
        found = leave_out(samples, m, at_readings, readings, at_gloss)
        errors.append(completion_errors(samples, m, found))
        indicators.append(indicators_of(found))
    return Calibration(np.array(errors), np.array(indicators))


def leave_out(
    samples: LibrarySamples, m: int, at_readings: Array, readings: Readings, at_gloss: Array | None = None
) -> Completion:
    """Material m completed from all others in the sample bands, from readings without noise.

    It is read in the sample bands nearest to those of the readings only, so that errors of extrapolation to other bands
    count.
    """
    own = samples.material_of == m
    axis = sample_axis(samples)
    glossy = samples.gloss(tuple(readings.gloss)) if at_gloss is None else at_gloss
    is_read = _nearest(axis, readings.bands)
    read = Readings(
        samples.names[m], "library", readings.wi, readings.wo,
        None if axis.wavelengths_nm is None else np.array(axis.wavelengths_nm)[is_read],
        at_readings[own].T[:, is_read] ** 3, readings.weights, gloss=_gloss_of(glossy[own], axis, readings),
    )  # fmt: skip
    return complete_at(in_sample_bands(samples.without(m)), read, at_readings[~own], glossy[~own])


def _gloss_of(roots: Array, bands: Bands, readings: Readings) -> dict[float, float]:
    """Gloss units of a material from cube roots (B_s, G) of its means over the apertures at the readings' angles."""
    means = luminance(roots.T**3, bands)
    return {
        angle: float(mean) / gloss_meter(angle).mean_value(1.0)
        for angle, mean in zip(readings.gloss, means, strict=True)
    }


def _nearest(bands: Bands, to: Bands) -> Array:
    """Which bands (B,) are the nearest to one of others; all where one of both is linear sRGB."""
    if bands.wavelengths_nm is None or to.wavelengths_nm is None:
        return np.ones(bands.count, bool)
    apart = np.abs(np.subtract.outer(to.wavelengths_nm, bands.wavelengths_nm))
    return np.isin(np.arange(bands.count), apart.argmin(axis=1))


def completion_errors(samples: LibrarySamples, m: int, found: Completion) -> tuple[float, float, float]:
    """Ball CIEDE2000, cube-root and linear error of a completion of material m, in the sample bands."""
    return errors_of(samples, m, found.on_grid, found.on_ball)


def errors_of(samples: LibrarySamples, m: int, on_grid: Array, on_ball: Array) -> tuple[float, float, float]:
    """Ball CIEDE2000, cube-root and linear error of f predicted for material m in the sample bands.

    Args:
        on_grid: f on the grid, shape (P_g, B_s).
        on_ball: f at the pairs that light a ball, shape (P_b, B_s).
    """
    own = samples.material_of == m
    ball, axis, n = ball_colours.ball(), sample_axis(samples), samples.n_grid
    if not np.all(np.isfinite(on_ball)):
        return np.nan, np.nan, np.nan
    seen = ball_colours.delta_e(ball.xyz(samples.ball[own].T ** 3, axis), ball.xyz(on_ball, axis))
    truth, cosines = samples.directions[own, :n].T ** 3, samples.weights[:n] ** 1.5
    return seen, cube_root_error(truth, on_grid, cosines), relative_error(truth, on_grid, cosines)


def sample_axis(samples: LibrarySamples) -> Bands:
    """The spectral axis of the sample bands."""
    return samples.bands.select(samples.sample_bands)


def in_sample_bands(samples: LibrarySamples) -> LibrarySamples:
    """The same samples, of a library that has the sample bands only."""
    held = replace(samples, bands=sample_axis(samples))
    held.__dict__["gram"] = samples.gram
    return held
