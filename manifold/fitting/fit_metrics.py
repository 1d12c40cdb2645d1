"""The measures in which a fitted BSDF is compared with samples: cosine-weighted linear, cube root, log."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from manifold.errors import UsageError
from manifold.fitting.fit_samples import FitSamples
from manifold.records import Array

METRICS = ("cube-root", "linear", "log")
_KNEE = 1e-3  # of the mean value: below, roots and logarithms turn linear, so that 0 has a finite slope


@dataclass(frozen=True)
class Metric:
    """A measure T of reflectance; residuals are `sqrt(weight) (T(f*_cos) - T(f_cos))`.

    All three are smooth and odd, so that slightly negative values of a colour outside the gamut do no harm.

    Attributes:
        name: one of `METRICS`.
        knee: where roots and logarithms turn linear, in 1/sr.
    """

    name: str
    knee: float

    @classmethod
    def of(cls, name: str, samples: FitSamples) -> Metric:
        """The measure for some samples.

        Raises:
            UsageError: the name is unknown.
        """
        if name not in METRICS:
            raise UsageError(f"no residual is called {name!r}, expected one of {', '.join(METRICS)}")
        mean = np.average(samples.f_cos, axis=0, weights=samples.weight).mean()
        return cls(name, _KNEE * float(mean))

    def __call__(self, x: Array) -> Array:
        """T(x), same shape."""
        if self.name == "linear":
            return np.asarray(x, float)
        if self.name == "log":
            return np.arcsinh(x / self.knee)
        return x / np.cbrt(x * x + self.knee**2)

    def slope(self, x: Array) -> Array:
        """Derivative of T, same shape."""
        if self.name == "linear":
            return np.ones_like(x, dtype=float)
        if self.name == "log":
            return 1.0 / np.sqrt(x * x + self.knee**2)
        square = x * x + self.knee**2
        return (x * x / 3.0 + self.knee**2) / (square * np.cbrt(square))


def norm(samples: FitSamples, metric: Metric) -> float:
    """`||sqrt(w) T(f_cos)||` of the samples: what relative residuals are divided by."""
    return float(np.linalg.norm(np.sqrt(samples.weight)[:, None] * metric(samples.f_cos)))


def relative_residual(samples: FitSamples, metric: Metric, f_cos: Array) -> float:
    """`||sqrt(w) (T(f*_cos) - T(f_cos))|| / ||sqrt(w) T(f_cos)||` of fitted values (M, B)."""
    error = np.sqrt(samples.weight)[:, None] * (metric(f_cos) - metric(samples.f_cos))
    return float(np.linalg.norm(error)) / norm(samples, metric)


def relative_residuals(samples: FitSamples, f_cos: Array) -> dict[str, float]:
    """`relative_residual` in every measure, by its name."""
    return {name: relative_residual(samples, Metric.of(name, samples), f_cos) for name in METRICS}


def best_diffuse(samples: FitSamples, metric: Metric) -> tuple[Array, float]:
    """The constant-albedo diffuse that fits best: its albedo per band (B,), and its sum of squared residuals.

    The sum is what a fit has to stay below. Source: iteratively reweighted linear least squares.
    """
    x = samples.wo[:, 2:] / np.pi  # f_cos of a white diffuser
    y, w = samples.f_cos, samples.weight[:, None]
    albedo = np.sum(w * x * y, axis=0) / np.sum(w * x * x)
    for _ in range(50):
        model = albedo * x
        slope = metric.slope(model)
        step = np.sum(w * slope * x * (metric(y) - metric(model)), axis=0) / np.sum(
            w * (slope * x) ** 2, axis=0
        )
        albedo = np.maximum(albedo + step, 0.2 * albedo)  # a fifth at once, at most: roots are steep at 0
    return albedo, float(np.sum(w * (metric(albedo * x) - metric(y)) ** 2))
