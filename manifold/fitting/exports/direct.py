"""Parameters of a target fitted to a material directly, with the target's own shading model.

Residuals are those of cube roots at the samples of a fit, and CIELAB of a ball that is lit from behind: the light in
which losses are measured is not seen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from manifold.colour import ball_colours
from manifold.colour.ball_colours import Ball
from manifold.colour.conversion import srgb_to_xyz
from manifold.colour.difference import to_lab
from manifold.fitting.exports import gltf, openpbr, standard_surface
from manifold.fitting.exports.principled_values import snapped
from manifold.fitting.exports.targets import Target
from manifold.fitting.fit_metrics import Metric
from manifold.fitting.fit_samples import EvaluableBRDF, FitSamples
from manifold.records import Array, Bands

_PAIRS = 512
_PICTURE = 0.02  # a colour that is off by 1 counts as a relative residual of 2 %
_PULL = 1e-3  # towards the mapped values, so that what nothing determines stays there
_COAT, _COAT_ROUGHNESS = (
    0.3,
    0.6,
)  # of the second start: long tails are a rough coat's, which the first may not have
_EVALUATIONS = 40
_LEAST = {
    "sheenRoughnessFactor": gltf.SHEEN_ROUGHNESS,
    "sheen_roughness": standard_surface.SHEEN_ROUGHNESS,
    "fuzz_roughness": openpbr.FUZZ_ROUGHNESS,
    "Sheen Roughness": openpbr.FUZZ_ROUGHNESS,
}  # that of principled: a narrower sheen is a coloured line at the rim, where hardly any value determines it
_NONE = 2e-3  # a coat or a sheen below this weight is none


@lru_cache(maxsize=1)
def _ball() -> Ball:
    return ball_colours.ball(6, 18, 8, is_turned=True)


def fit_target(
    target: Target, start: Mapping[str, Any], samples: FitSamples, material: EvaluableBRDF
) -> dict[str, Any]:
    """Parameters of a target whose model is nearest to a material, all of the target's.

    Args:
        target: whose model.
        start: mapped parameters, which what is not fitted keeps.
        samples: of the material; at most 512 of them are used.
        material: the same as a BRDF.
    """
    problem = _Problem(target, start, samples.as_rgb().subsample(_PAIRS), material)
    with threadpool_limits(1):
        ends = [
            least_squares(
                problem.residuals, x, bounds=problem.bounds, x_scale=problem.span, max_nfev=_EVALUATIONS,
                ftol=1e-5, xtol=1e-4,
            )
            for x in problem.starts()
        ]  # fmt: skip
    return problem.settled(min(ends, key=lambda end: end.cost).x)


class _Problem:
    """Residuals of a target's free parameters, laid out in one vector."""

    def __init__(
        self, target: Target, start: Mapping[str, Any], samples: FitSamples, material: EvaluableBRDF
    ) -> None:
        self._brdf, self._start, self._target = target.brdf, dict(start), target
        self._samples = samples
        self._metric = Metric.of("cube-root", samples)
        y = self._metric(samples.f_cos)
        self._weight = np.sqrt(samples.weight)[:, None] / np.sqrt(np.sum(samples.weight[:, None] * y * y))
        self._y = y
        self._lab = _lab(material.eval(_ball().wi, _ball().wo), material.bands)
        lower, upper = zip(*(_range(name) for name, _ in self._places()), strict=True)
        margin = 1e-3 * (np.array(upper) - np.array(lower))
        self.bounds = np.array(lower), np.array(upper)
        self.span = self.bounds[1] - self.bounds[0]
        mapped = np.array([np.atleast_1d(start[name])[k] for name, k in self._places()], float)
        self._mapped = np.clip(mapped, self.bounds[0] + margin, self.bounds[1] - margin)

    def _places(self) -> Sequence[tuple[str, int]]:
        return [(name, k) for name in self._target.free for k in range(np.size(self._start[name]))]

    def starts(self) -> list[Array]:
        """The mapped values, and those with a rough coat."""
        coated = self._mapped.copy()
        for i, (name, _) in enumerate(self._places()):
            if name in self._target.coat[:1]:
                coated[i] = max(coated[i], _COAT)
            elif name in self._target.coat:
                coated[i] = _COAT_ROUGHNESS
        return [self._mapped, coated]

    def values(self, x: Array) -> dict[str, Any]:
        """The target's parameters of a vector."""
        made = dict(self._start)
        at = 0
        for name in self._target.free:
            size = np.size(self._start[name])
            made[name] = x[at : at + size].tolist() if isinstance(made[name], list) else float(x[at])
            at += size
        return made

    def residuals(self, x: Array) -> Array:
        """Of samples, of the ball, and of the distance from the mapped values."""
        values, s = self.values(x), self._samples
        at_samples = self._weight * (self._metric(self._brdf(values, s.wi, s.wo) * s.wo[:, 2:]) - self._y)
        ball = _ball()
        lab = _lab(self._brdf(values, ball.wi, ball.wo), Bands(None))
        seen = _PICTURE * (lab - self._lab) / np.sqrt(len(lab))
        return np.concatenate([at_samples.ravel(), seen.ravel(), _PULL * (x - self._mapped) / self.span])

    def settled(self, x: Array) -> dict[str, Any]:
        """The parameters, where a value at an end of 0 to 1 is that end, and a coat or sheen hardly there is none."""
        made, defaults = self.values(x), self._target.defaults
        for name in self._target.free:
            if _range(name) == (0.0, 1.0):
                value = made[name]
                made[name] = list(map(snapped, value)) if isinstance(value, list) else snapped(value)
        for names in (self._target.coat, self._target.sheen):
            if names and np.max(made[names[0]]) < _NONE:
                made |= {name: defaults[name] for name in names}
        return made


def _range(name: str) -> tuple[float, float]:
    lowered = name.lower()
    if lowered.endswith("ior"):
        return 1.0, 2.0
    if lowered.endswith("smoothness"):
        return 0.0, 0.98
    return _LEAST.get(name, 0.02 if "roughness" in lowered else 0.0), 1.0


def _lab(f: Array, bands: Bands) -> Array:
    return to_lab(_ball().xyz(f, bands), srgb_to_xyz(np.ones(3)))
