"""Fits the parameters of a target's own shading model to a material, by the criterion of `principled`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from manifold.colour.difference import VISIBLE
from manifold.core.records import Array
from manifold.fit.exports.document import CURVE_COSINES
from manifold.fit.exports.lobes import ShadingPairs
from manifold.fit.exports.principled_values import snapped
from manifold.fit.exports.targets import Target
from manifold.fit.fit_metrics import Criterion
from manifold.fit.fit_samples import FitSamples
from manifold.fit.identifiability import BOUND

_PAIRS = 512
_COAT, _COAT_ROUGHNESS = 0.3, 0.6  # of the second start: long tails come from a rough coat
_EVALUATIONS = 40
_STEP = float(np.sqrt(np.finfo(float).eps))  # of differences
_GAIN = 0.8  # a film, curve or colour of a sheen that is kept lowers squared residual and difference below this share
_FILM_WEIGHT, _FILM_IORS = 0.5, (1.3, 1.8)  # of its starts
_FILM_THICKNESSES = np.arange(150, 1001, 50) / 1200.0  # of the thickest
_FILM_STARTS = 3  # that are refined
# Evaluations, and below which share of the squared residual a film is by then.
_PROMISING = ((4, 1.0), (8, 0.92))


def fit_target(target: Target, start: Mapping[str, Any], samples: FitSamples) -> dict[str, Any]:
    """Fit all free parameters of a target so that its shading model is nearest to a material.

    If programs implement the model differently, the sum of their squared residuals is minimised.

    If the rendered ball differs visibly, a thin film or, for targets without films, a view-dependent base colour is
    tried; it is kept if it reduces the error of every implementation. A sheen keeps the hue of its start (grey if
    there is none), unless a free colour also reduces the error over all samples, of which the fit uses a part.

    Args:
        target: the target.
        start: parameters derived from `principled`; parameters that are not fitted keep these values.
        samples: samples of the material, with its ball; at most 512 are used.
    """
    few = samples.as_rgb().subsample(_PAIRS)
    free = [name for name, parameter in target.entries.items() if parameter.is_free]
    fixed = list(target.hued)
    hued = fixed + [name for name in target.sheen if name in free and np.ndim(start[name])]
    problem = _Problem(target, start, free, few, hued)
    with threadpool_limits(1):
        x, cost = problem.nearest(problem.starts())
        if any(np.any(problem.rounded(x)[name]) for name in hued if name not in fixed):
            coloured, unseen = (
                _Problem(target, start, free, few, fixed),
                replace(samples.as_rgb(), pixels=None),
            )
            y, with_colour = coloured.nearest([coloured.vector(problem.rounded(x))])
            gains = (
                coloured.ball_differences(y) / problem.ball_differences(x),
                (coloured.relative(y, unseen) / problem.relative(x, unseen)) ** 2,
            )
            if np.max(gains) < _GAIN:
                problem, x, cost, hued = coloured, y, with_colour, fixed
        found = problem.rounded(x)
        without = problem.losses(x)
        if np.max(problem.ball_differences(x)) <= VISIBLE:
            return found
        more, starts = problem, list[Array]()
        if target.film:
            more = _Problem(target, start, [*free, *target.film], few, hued)
            starts = more.film_starts(found)
        elif target.curve:
            curve, base = target.curve
            begun = {**found, curve: len(CURVE_COSINES) * found[base]}
            more = _Problem(target, begun, [*(name for name in free if name != base), curve], few, hued)
            starts = [more.vector(begun)]
        if starts:
            x, _ = more.nearest(starts, cost if target.film else np.inf)
            if np.all(more.losses(x) < _GAIN * without):
                return more.rounded(x)
    return found


def at_bounds(target: Target, values: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of fitted parameters that ended at a bound of their range, with the bound.

    The natural limits of shares do not count: 0 for colours and other shares, and 1 for shares that are not colours.
    """
    found = []
    for name, parameter in target.entries.items():
        if not parameter.is_free:
            continue
        ends = [] if parameter.is_share else [parameter.low]
        ends += [parameter.high] * (not parameter.is_share or np.ndim(parameter.default) > 0)
        margin = 2e-3 * (parameter.high - parameter.low)
        reached = [end for end in ends if np.any(np.abs(np.asarray(values[name]) - end) <= margin)]
        if reached and not np.array_equal(values[name], parameter.default):
            found.append(f"{name} {reached[0]:g}")
    return tuple(found)


def _hue(colour: Any) -> Array:
    """Return a colour over its largest channel, (3,); white for black."""
    most = np.max(colour)
    return np.asarray(colour) / most if most > 0.0 else np.ones(3)


class _Problem:
    """Residuals of a target's free parameters, laid out in one vector."""

    def __init__(
        self, target: Target, start: Mapping[str, Any], free: Sequence[str], samples: FitSamples,
        hued: Sequence[str] = (),
    ) -> None:  # fmt: skip
        """Prepare the problem; colours in `hued` keep the start's hue, and only their largest channel is free."""
        self._start, self._target, self._free = dict(start), target, free
        self._criterion = Criterion(samples, "appearance")
        self._pairs = ShadingPairs.of(self._criterion.wi, self._criterion.wo)
        self._hues = {name: _hue(start[name]) for name in hued}
        sizes = {name: 1 if name in hued else np.size(self._start[name]) for name in free}
        self._names = [name for name, size in sizes.items() for _ in range(size)]  # of each number
        ends = np.cumsum(list(sizes.values()))
        self._colours = [
            columns
            for end, size in zip(ends, sizes.values(), strict=True)
            for columns in np.arange(end - size, end).reshape(-1, 3 if size % 3 == 0 else 1)
        ]
        entries = [target.entries[name] for name in self._names]
        self._lower, self._upper = np.array([e.low for e in entries]), np.array([e.high for e in entries])
        self._span = self._upper - self._lower
        self._ridge = np.array([e.ridge for e in entries]) / self._span
        self._begin = np.clip(self._numbers(start), self._lower, self._upper)

    def vector(self, values: Mapping[str, Any]) -> Array:
        """Return the vector of parameters, a little inside the bounds."""
        margin = 1e-3 * self._span
        return np.clip(self._numbers(values), self._lower + margin, self._upper - margin)

    def _numbers(self, values: Mapping[str, Any]) -> Array:
        numbers = (np.max(values[name]) if name in self._hues else values[name] for name in self._free)
        return np.concatenate([np.atleast_1d(each) for each in numbers]).astype(float)

    def nearest(self, starts: Sequence[Array], below: float = np.inf) -> tuple[Array, float]:
        """Return the best minimum from several starts, and half of its squared residual.

        Args:
            starts: vectors of parameters.
            below: half the squared residual without a film. A start is followed, by exact derivatives, only if its
                residual falls below shares of this after some evaluations. By default all starts are followed, and
                channels are varied at once.
        """
        if np.isfinite(below):
            done = 0
            for evaluations, share in _PROMISING:
                begun = [self._minimum(x, evaluations - done) for x in starts]
                best = min(begun, key=lambda end: end[1])
                if best[1] >= share * below:
                    return best
                starts, done = [x for x, _ in begun], evaluations
            starts = [x for x, cost in begun if cost < share * below]
        ends = [self._minimum(x, _EVALUATIONS, is_exact=np.isfinite(below)) for x in starts]
        return min(ends, key=lambda end: end[1])

    def _minimum(self, start: Array, evaluations: int, *, is_exact: bool = False) -> tuple[Array, float]:
        def jacobian(x: Array) -> Array:
            return self.jacobian(x, is_exact=is_exact)

        end = least_squares(
            self.residuals, start, jacobian, bounds=(self._lower, self._upper), x_scale=self._span,
            max_nfev=evaluations, ftol=1e-5, xtol=1e-4,
        )  # fmt: skip
        return end.x, float(end.cost)

    def starts(self) -> list[Array]:
        """Return the start, and the start with a rough coat."""
        start = self.vector(self._start)
        coated = start.copy()
        for i, name in enumerate(self._names):
            if name in self._target.coat[:1]:
                coated[i] = max(coated[i], _COAT)
            elif name in self._target.coat:
                coated[i] = _COAT_ROUGHNESS
        return [start, coated]

    def film_starts(self, values: Mapping[str, Any]) -> list[Array]:
        """Return parameters with the thin films that lower their residual most, among all that are tried."""
        *weight, thickness, ior = self._target.film
        thickest = self._target.entries[thickness].high
        films = [
            dict.fromkeys(weight, _FILM_WEIGHT) | {thickness: share * thickest, ior: n}
            for share in _FILM_THICKNESSES
            for n in _FILM_IORS
        ]
        starts = [self.vector(dict(values) | film) for film in films]
        return sorted(starts, key=lambda x: float(np.sum(self.residuals(x) ** 2)))[:_FILM_STARTS]

    def _values(self, x: Array) -> dict[str, Any]:
        """Return the target's parameters by name for a vector of the free values."""
        made, at = dict(self._start), 0
        for name in self._free:
            if name in self._hues:
                made[name] = (x[at] * self._hues[name]).tolist()
                at += 1
                continue
            size = np.size(made[name])
            made[name] = x[at : at + size].tolist() if isinstance(made[name], list) else float(x[at])
            at += size
        return made

    def residuals(self, x: Array) -> Array:
        """Return the relative residuals of the criterion, and those of the distance from the start."""
        return np.concatenate([self._rows(x).ravel(), self._ridge * (x - self._begin)])

    def _rows(self, x: Array) -> Array:
        """Return the relative residuals of the criterion, (R, 3), one implementation after the other."""
        rows = self._criterion.residual(self._f_cos(x)) / self._criterion.norm
        return (rows / np.sqrt(len(rows))).reshape(-1, rows.shape[-1])

    def jacobian(self, x: Array, *, is_exact: bool = True) -> Array:
        """Return the derivatives of the residuals, by forward differences.

        Unless `is_exact` is set, red, green and blue of a colour are varied at once. This is accurate because each
        changes almost only its own channel of the BRDF, except for metals under MaterialX's thin films.
        """
        rows = self._rows(x)
        found = np.zeros((*rows.shape, len(x)))
        for columns in np.arange(len(x))[:, None] if is_exact else self._colours:
            step = np.zeros_like(x)
            step[columns] = np.where(x[columns] + _STEP > self._upper[columns], -_STEP, _STEP)
            moved = self._rows(x + step) - rows
            if len(columns) == 1:
                found[..., columns[0]] = moved / step[columns]
            else:
                channels = np.arange(3)
                found[:, channels, columns] = moved / step[columns]
        return np.concatenate([found.reshape(-1, len(x)), np.diag(self._ridge)])

    def ball_differences(self, x: Array) -> Array:
        """Return the mean CIEDE2000 of the ball in the light of the fit, by implementation (I,)."""
        return np.array([self._criterion.ball_difference(f_cos) for f_cos in self._f_cos(x)])

    def losses(self, x: Array) -> Array:
        """Return squared residuals and differences of balls, by implementation, (2, I)."""
        squares = np.sum(self._criterion.residual(self._f_cos(x)) ** 2, axis=(1, 2))
        return np.stack([squares, self.ball_differences(x)])

    def relative(self, x: Array, samples: FitSamples) -> Array:
        """Return the relative residuals of other samples, by implementation (I,)."""
        criterion, pairs = Criterion(samples, "appearance"), ShadingPairs.of(samples.wi, samples.wo)
        values = self._values(x)
        return np.array(
            [criterion.relative(brdf(values, pairs) * samples.wo[:, 2:]) for brdf in self._target.brdfs]
        )

    def _f_cos(self, x: Array) -> Array:
        """Return values by implementation, (I, P, 3)."""
        values = self._values(x)
        return np.stack([brdf(values, self._pairs) * self._pairs.light[:, 2:] for brdf in self._target.brdfs])

    def rounded(self, x: Array) -> dict[str, Any]:
        """Return the parameters, with values near 0 and 1 rounded.

        Coats, sheens and films of negligible weight are removed.
        """
        made, target = self._values(x), self._target
        for name in self._free:
            if target.entries[name].is_share:
                value = made[name]
                made[name] = list(map(snapped, value)) if isinstance(value, list) else snapped(value)
        for names in (target.coat, target.sheen, target.film):
            if names and np.max(made[names[0]]) < BOUND:
                made |= {name: target.entries[name].default for name in names}
        return made
