"""Parameters of a target fitted to a material directly, with the target's own shading model.

Residuals are those of cube roots at the samples of a fit, and CIELAB of a ball that is lit from behind: the light in
which losses are measured is not seen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from manifold.colour import ball_colours
from manifold.colour.conversion import srgb_to_xyz
from manifold.colour.difference import to_lab
from manifold.fitting.exports import blender, gltf, openpbr, standard_surface
from manifold.fitting.exports.principled_values import snapped
from manifold.fitting.exports.targets import Target
from manifold.fitting.fit_metrics import Metric
from manifold.fitting.fit_samples import EvaluableBRDF, FitSamples
from manifold.records import Array, Bands

_PAIRS = 512
_PICTURE = 0.02  # a colour that is off by 1 counts as a relative residual of 2 %
_PULL = 1e-3  # towards the mapped values, so that what nothing determines stays there
_COAT, _COAT_ROUGHNESS = 0.3, 0.6  # of the second start: long tails come from a rough coat
_EVALUATIONS = 40
_LEAST = {
    "sheenRoughnessFactor": gltf.SHEEN_ROUGHNESS,
    "sheen_roughness": standard_surface.SHEEN_ROUGHNESS,
    "fuzz_roughness": openpbr.FUZZ_ROUGHNESS,
    "Sheen Roughness": openpbr.FUZZ_ROUGHNESS,
}  # that of principled: a narrower sheen is a coloured line at the rim, where hardly any value determines it
_FILM_RANGES = {
    name: limits
    for model in (gltf, standard_surface, blender)
    for name, limits in zip(model.FILM[-2:], ((50.0, 1200.0), (1.0, 2.5)), strict=True)
}  # of thicknesses in nm, and of indices
_NONE = 2e-3  # a coat, a sheen or a film below this weight is none
NOTICEABLE = 2.3  # CIEDE2000 of the ball, just noticeable (Mahy et al. 1994): above it a thin film is tried
_FILM_GAIN = 0.8  # a film that is kept lowers the squared residual and the ball's difference below this share
_FILM_WEIGHT, _FILM_IORS, _FILM_THICKNESSES = 0.5, (1.3, 1.8), range(150, 1001, 50)  # nm, of its starts
_FILM_STARTS = 3  # that are refined


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
    few = samples.as_rgb().subsample(_PAIRS)
    problem = _Problem(target, start, target.free, few, material)
    with threadpool_limits(1):
        x, cost = problem.nearest(problem.starts())
        found = problem.settled(x)
        seen = problem.seen_difference(x)
        if target.film and seen > NOTICEABLE:
            filmed = _Problem(target, start, target.free + target.film, few, material)
            x, with_film = filmed.nearest(filmed.film_starts(found))
            if with_film < _FILM_GAIN * cost and filmed.seen_difference(x) < _FILM_GAIN * seen:
                return filmed.settled(x)
    return found


class _Problem:
    """Residuals of a target's free parameters, laid out in one vector."""

    def __init__(
        self, target: Target, start: Mapping[str, Any], free: Sequence[str], samples: FitSamples,
        material: EvaluableBRDF,
    ) -> None:  # fmt: skip
        self._brdf, self._start, self._target, self._free = target.brdf, dict(start), target, free
        self._samples = samples
        self._metric = Metric.of("cube-root", samples)
        y = self._metric(samples.f_cos)
        self._weight = np.sqrt(samples.weight)[:, None] / np.sqrt(np.sum(samples.weight[:, None] * y * y))
        self._y = y
        self._ball = ball_colours.ball(6, 18, 8, is_turned=True)
        self._xyz = self._ball.xyz(material.eval(self._ball.wi, self._ball.wo), material.bands)
        self._lab = _lab(self._xyz)
        lower, upper = zip(*(parameter_range(name) for name, _ in self._places()), strict=True)
        self._bounds = np.array(lower), np.array(upper)
        self._span = self._bounds[1] - self._bounds[0]
        self._mapped = self._vector(start)

    def _places(self) -> Sequence[tuple[str, int]]:
        return [(name, k) for name in self._free for k in range(np.size(self._start[name]))]

    def _vector(self, values: Mapping[str, Any]) -> Array:
        """Of parameters, a little inside the bounds."""
        x = np.array([np.atleast_1d(values[name])[k] for name, k in self._places()], float)
        margin = 1e-3 * self._span
        return np.clip(x, self._bounds[0] + margin, self._bounds[1] - margin)

    def nearest(self, starts: Sequence[Array]) -> tuple[Array, float]:
        """The best minimum from several starts, and half of its squared residual."""
        ends = [
            least_squares(
                self.residuals, x, bounds=self._bounds, x_scale=self._span, max_nfev=_EVALUATIONS,
                ftol=1e-5, xtol=1e-4,
            )
            for x in starts
        ]  # fmt: skip
        best = min(ends, key=lambda end: float(end.cost))
        return best.x, float(best.cost)

    def starts(self) -> list[Array]:
        """The mapped values, and those with a rough coat."""
        coated = self._mapped.copy()
        for i, (name, _) in enumerate(self._places()):
            if name in self._target.coat[:1]:
                coated[i] = max(coated[i], _COAT)
            elif name in self._target.coat:
                coated[i] = _COAT_ROUGHNESS
        return [self._mapped, coated]

    def film_starts(self, values: Mapping[str, Any]) -> list[Array]:
        """Parameters with the thin films that lower their residual most, of all that are tried."""
        *weight, thickness, ior = self._target.film
        films = [
            dict.fromkeys(weight, _FILM_WEIGHT) | {thickness: float(nm), ior: n}
            for nm in _FILM_THICKNESSES
            for n in _FILM_IORS
        ]
        starts = [self._vector(dict(values) | film) for film in films]
        return sorted(starts, key=lambda x: float(np.sum(self.residuals(x) ** 2)))[:_FILM_STARTS]

    def values(self, x: Array) -> dict[str, Any]:
        """The target's parameters of a vector."""
        made = dict(self._start)
        at = 0
        for name in self._free:
            size = np.size(self._start[name])
            made[name] = x[at : at + size].tolist() if isinstance(made[name], list) else float(x[at])
            at += size
        return made

    def residuals(self, x: Array) -> Array:
        """Of samples, of the ball, and of the distance from the mapped values."""
        values, s = self.values(x), self._samples
        at_samples = self._weight * (self._metric(self._brdf(values, s.wi, s.wo) * s.wo[:, 2:]) - self._y)
        seen = _PICTURE * (_lab(self._ball_xyz(values)) - self._lab) / np.sqrt(len(self._lab))
        return np.concatenate([at_samples.ravel(), seen.ravel(), _PULL * (x - self._mapped) / self._span])

    def seen_difference(self, x: Array) -> float:
        """Mean CIEDE2000 of the ball."""
        return ball_colours.delta_e(self._ball_xyz(self.values(x)), self._xyz)

    def _ball_xyz(self, values: Mapping[str, Any]) -> Array:
        return self._ball.xyz(self._brdf(values, self._ball.wi, self._ball.wo), Bands(None))

    def settled(self, x: Array) -> dict[str, Any]:
        """The parameters; a value at an end of 0 to 1 is that end, and a coat, sheen or film hardly there is none."""
        made, defaults = self.values(x), self._target.defaults
        for name in self._free:
            if parameter_range(name) == (0.0, 1.0):
                value = made[name]
                made[name] = list(map(snapped, value)) if isinstance(value, list) else snapped(value)
        for names in (self._target.coat, self._target.sheen, self._target.film):
            if names and np.max(made[names[0]]) < _NONE:
                made |= {name: defaults[name] for name in names}
        return made


def parameter_range(name: str) -> tuple[float, float]:
    """Of a parameter that a direct fit changes, of any target: the least value and the greatest."""
    if name in _FILM_RANGES:
        return _FILM_RANGES[name]
    lowered = name.lower()
    if lowered.endswith("ior"):
        return 1.0, 2.0
    if lowered.endswith("smoothness"):
        return 0.0, 0.98
    return _LEAST.get(name, 0.02 if "roughness" in lowered else 0.0), 1.0


def _lab(xyz: Array) -> Array:
    return to_lab(xyz, srgb_to_xyz(np.ones(3)))
