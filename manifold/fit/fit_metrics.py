"""Measures of the difference between a fitted BSDF and samples, and the residuals that a fit minimises."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from manifold.brdf.interface import EvaluableBRDF
from manifold.brdf.measured import values_at
from manifold.colour import panel
from manifold.colour.conversion import srgb_to_xyz
from manifold.colour.difference import delta_e_2000
from manifold.colour.panel import Panel
from manifold.core.directions import half_vector
from manifold.core.errors import UsageError
from manifold.core.metrics import Errors
from manifold.core.records import Array
from manifold.fit.fit_samples import FitSamples

METRICS = ("appearance", "cube-root", "linear", "log")
_KNEE = 1e-3  # share of the mean value: below, roots and logarithms turn linear, so that 0 has a finite slope
_BALL = 3.0  # a relative residual of 3 % of the samples weighs as much as cube roots of pixels that are off by 0.01
_SHOULDER = (
    0.1  # slope of the logarithm that values above display white follow, which a display shows as white
)


@dataclass(frozen=True)
class Metric:
    """A mapping T of reflectance, with which residuals are `sqrt(weight) (T(f*_cos) - T(f_cos))`.

    Every T is smooth and odd, so that slightly negative values of colours outside the gamut do no harm. `appearance`
    uses the cube root.

    Attributes:
        name: one of `METRICS`.
        knee: value below which roots and logarithms are replaced by lines, in 1/sr.
    """

    name: str
    knee: float

    @classmethod
    def of(cls, name: str, samples: FitSamples) -> Metric:
        """Return the metric with a name, with its knee chosen for the samples."""
        if name not in METRICS:
            raise UsageError(f"there is no metric {name!r}, expected one of {', '.join(METRICS)}")
        mean = np.average(samples.f_cos, axis=0, weights=samples.weight).mean()
        return cls(name, _KNEE * float(mean))

    def __call__(self, x: Array) -> Array:
        """Return T(x), same shape."""
        if self.name == "linear":
            return np.asarray(x, float)
        if self.name == "log":
            return np.arcsinh(x / self.knee)
        return x / np.cbrt(x * x + self.knee**2)

    def slope(self, x: Array) -> Array:
        """Return the derivative of T at x, in the shape of x."""
        if self.name == "linear":
            return np.ones_like(x, dtype=float)
        if self.name == "log":
            return 1.0 / np.sqrt(x * x + self.knee**2)
        square = x * x + self.knee**2
        return (x * x / 3.0 + self.knee**2) / (square * np.cbrt(square))


def ball_errors(fitted: EvaluableBRDF, material: EvaluableBRDF) -> Errors[float]:
    """Return the differences between the rendered balls of a fit and its material, each in its own bands.

    They are compared in the five test lights and in the lights used for fitting.
    """

    def errors(lights: Panel) -> Errors[float]:
        return lights.compare(
            *(lights.xyz(values_at(brdf, lights), brdf.bands) for brdf in (fitted, material))
        )

    return replace(errors(panel.judged()), fitted_ball=errors(panel.fitted()).ball)


_NEAR_DEG = 25.0  # angle from the mirror direction within which is the highlight
# CIEDE2000 of a highlight that is missed, and its ratio to that of the rest.
_MISSED, _MISSED_SHARE = 5.0, 2.0


def missed_highlight(fitted: EvaluableBRDF, material: EvaluableBRDF) -> str | None:
    """Return a sentence if a model fits the highlight's colour or strength much worse than the rest, or None.

    Examples are the iridescence of flakes and thin films in models without them.
    """
    ball = panel.sun(panel.SUN_DEG)
    xyz, xyz_star = (ball.xyz(values_at(brdf, ball), brdf.bands) for brdf in (fitted, material))
    differences = delta_e_2000(xyz, xyz_star, srgb_to_xyz(np.ones(3)))
    is_near = half_vector(ball.wi, ball.wo)[:, 2] > np.cos(np.deg2rad(_NEAR_DEG))
    near, rest = float(differences[is_near].mean()), float(differences[~is_near].mean())
    if near < max(_MISSED, _MISSED_SHARE * rest):
        return None
    return (
        f"its highlight is missed: under a sun, CIEDE2000 {near:.0f} within {_NEAR_DEG:.0f} degrees of the mirror "
        f"direction, {rest:.0f} elsewhere, which no parameter of the model can correct"
    )


class Criterion:
    """The residuals of a BSDF against samples; the metric `appearance` also compares the pixels of their ball.

    The rows are first those of the samples, then those of the pixels. Pixels are compared in cube roots as a display
    shows them, so that values brighter than white have little weight.

    Attributes:
        samples, metric: the samples, and the metric in which they are compared.
        wi, wo: direction pairs at which values are needed, those of the samples first, shape (P, 3).
        norm: norm of the rows of a black surface, by which relative residuals are divided.
    """

    def __init__(self, samples: FitSamples, name: str) -> None:
        self.samples, self.metric = samples, Metric.of(name, samples)
        self._root = np.sqrt(samples.weight)[:, None]
        self._target = self._root * self.metric(samples.f_cos)
        self._pixels = samples.pixels if name == "appearance" else None
        self.wi, self.wo, self.norm = samples.wi, samples.wo, float(np.linalg.norm(self._target))
        if self._pixels is not None:
            self.wi = np.concatenate([samples.wi, self._pixels.lights.wi])
            self.wo = np.concatenate([samples.wo, self._pixels.lights.wo])
            shown = _DISPLAY(_shown(self._pixels.values)[0])
            weights = self._pixels.lights.pixel_weights
            self._scale = _BALL * self.norm * np.sqrt(weights / len(shown))[:, None]
            self._shown = self._scale * shown
            self.norm = float(np.hypot(self.norm, np.linalg.norm(self._shown)))

    def residual(self, f_cos: Array) -> Array:
        """Return the residuals (..., R, B) of values (..., P, B); values at further pairs are ignored."""
        m = len(self.samples)
        rows = self._root * self.metric(f_cos[..., :m, :]) - self._target
        if self._pixels is None:
            return np.asarray(rows)
        shown = _DISPLAY(_shown(self._pixels.of(f_cos[..., m:, :]))[0])
        return np.concatenate([rows, self._scale * shown - self._shown], axis=-2)

    def slope(self, f_cos: Array, slope: Array) -> Array:
        """Return the derivatives of the residuals (R, B, n), from values (P, B) and their derivatives (P, B, n)."""
        m = len(self.samples)
        rows = (self._root * self.metric.slope(f_cos[:m]))[..., None] * slope[:m]
        if self._pixels is None:
            return np.asarray(rows)
        shown, shoulder = _shown(self._pixels.of(f_cos[m:]))
        of_pixels = self._pixels.of(slope[m:].reshape(len(slope) - m, -1)).reshape(*shown.shape, -1)
        return np.concatenate([rows, (self._scale * _DISPLAY.slope(shown) * shoulder)[..., None] * of_pixels])

    def relative(self, f_cos: Array) -> float:
        """Return the relative residual `||rows|| / norm` of values (P, B)."""
        return float(np.linalg.norm(self.residual(f_cos))) / self.norm

    def ball_difference(self, f_cos: Array) -> float:
        """Return the mean CIEDE2000 between the balls of values (P, 3) in linear sRGB and of the material."""
        assert self._pixels is not None
        both = self._pixels.of(f_cos[len(self.samples) :]), self._pixels.values
        xyz, xyz_star = (srgb_to_xyz(np.clip(pixels, 0.0, 1.0)) for pixels in both)
        return self._pixels.lights.compare(xyz, xyz_star).ball


_DISPLAY = Metric("appearance", _KNEE)


def _shown(pixels: Array) -> tuple[Array, Array]:
    """Return linear values as a display shows them, with a soft end at white, and the derivatives."""
    above = np.maximum(pixels, 1.0)
    shown = np.where(pixels > 1.0, 1.0 + _SHOULDER * np.log(above), np.maximum(pixels, 0.0))
    return shown, np.where(pixels > 1.0, _SHOULDER / above, (pixels > 0.0).astype(float))


def relative_residuals(samples: FitSamples, f_cos: Array) -> dict[str, float]:
    """Return the relative residual in every metric, by name, of values at the direction pairs of `appearance`."""
    return {name: Criterion(samples, name).relative(f_cos) for name in METRICS}


def best_diffuse(criterion: Criterion) -> tuple[Array, float]:
    """Fit a diffuse BRDF of constant albedo by Gauss-Newton, band by band.

    Returns its albedo per band (B,), and its sum of squared residuals, an upper bound for every fit.
    """
    samples = criterion.samples
    white = np.repeat(criterion.wo[:, 2:] / np.pi, samples.bands.count, axis=1)  # f_cos of a white diffuser
    x, w = white[: len(samples)], samples.weight[:, None]
    albedo = np.sum(w * x * samples.f_cos, axis=0) / np.sum(w * x * x, axis=0)
    for _ in range(50):
        slope = criterion.slope(albedo * white, white[..., None])[..., 0]
        step = -np.sum(slope * criterion.residual(albedo * white), axis=0) / np.sum(slope**2, axis=0)
        albedo = np.maximum(albedo + step, 0.2 * albedo)  # a fifth at once, at most: roots are steep at 0
    return albedo, float(np.sum(criterion.residual(albedo * white) ** 2))
