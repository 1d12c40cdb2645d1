"""Minimises by bounded Gauss-Newton from the best points of a coarse global search, and returns all minima found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import qmc

from manifold.core import progress
from manifold.core.errors import NumericalError
from manifold.core.progress import Stages
from manifold.core.records import Array, Indices, Mask
from manifold.fit.fit_metrics import Criterion
from manifold.fit.fit_samples import FitSamples
from manifold.render.bsdf_evaluation import evaluator
from manifold.render.bsdf_parameters import BsdfFamily, ParameterLayout

_BAND_ITERATIONS, _BAND_PAIRS = 20, 512  # most iterations, and pairs, of `refine_bands`


@dataclass(frozen=True)
class GaussNewton:
    """Hyperparameters of the default method.

    Attributes:
        n_search: number of parameter vectors of the coarse search, a power of two.
        search_pairs: number of direction pairs at which they are evaluated.
        n_starts: number of the best vectors that are refined. If there are at most `coarse_pairs` samples, the best
            vectors in the lowest and in the highest quarter of each shared parameter's range are refined as well,
            once within that quarter and once without limits.
        coarse_pairs: number of direction pairs of the first refinement.
        coarse_pixels: stride over the pixels of each light in the coarse refinement.
        coarse_iterations, iterations: evaluations allowed per start in the coarse and the fine refinement.
        tolerance: relative change of the cost and of the parameters at which a refinement ends.
        n_fine: number of distinct minima of the coarse refinement that are refined on all pairs.
        seed: seed of the quasi-random search.
    """

    n_search: int = 512
    search_pairs: int = 160
    n_starts: int = 6
    coarse_pairs: int = 320
    coarse_pixels: int = 4
    coarse_iterations: int = 6
    iterations: int = 60
    tolerance: float = 1e-5
    n_fine: int = 3
    seed: int = 0


@dataclass(frozen=True)
class Minimum:
    """The result of a refinement.

    Attributes:
        p: parameter values, shape (K,).
        cost: sum of squared residuals over all samples.
        converged: whether the refinement converged before the limit of iterations.
        part: lower and upper ends, each (K,), of the part of the ranges to which the refinement was restricted, so
            that the result need not be a minimum; None if it was not restricted.
    """

    p: Array
    cost: float
    converged: bool
    part: tuple[Array, Array] | None = None


class Residuals:
    """The residuals (R * B,) and their Jacobian as functions of the optimiser's coordinates, evaluated together."""

    def __init__(self, family: BsdfFamily, criterion: Criterion) -> None:
        self.criterion = criterion
        self.evaluator = evaluator(family, criterion.wi, criterion.wo, 3)
        self.layout = self.evaluator.layout
        self._last: tuple[bytes, Array, Array] | None = None

    def _both(self, t: Array) -> tuple[Array, Array]:
        key = t.tobytes()
        if self._last is None or self._last[0] != key:
            residual, J = self.by_parameter(self.layout.outward(t))
            self._last = key, residual, J * self.layout.slope(t)
        return self._last[1], self._last[2]

    def value(self, t: Array) -> Array:
        """Return residuals (R * B,) at t (K,)."""
        return self._both(t)[0]

    def jacobian(self, t: Array) -> Array:
        """Return the derivatives of the residuals with respect to t, shape (R * B, K)."""
        return self._both(t)[1]

    def by_parameter(self, p: Array) -> tuple[Array, Array]:
        """Return the residuals (R * B,) and their derivatives with respect to the parameters p, shape (R * B, K)."""
        value, slope = self.evaluator.jacobian(p)
        slope[~np.isfinite(slope)] = 0.0  # a derivative that is infinite at the end of a range moves nothing
        J = self.criterion.slope(value, slope)
        return self.criterion.residual(value).ravel(), J.reshape(-1, self.layout.size)


def minimize(
    residuals: Residuals, start: Array, iterations: int, tolerance: float, part: tuple[Array, Array] | None = None,
    kept: Mask | None = None,
) -> Minimum:  # fmt: skip
    """Refine parameter values (K,) within their ranges, or within a part of them.

    Values marked in `kept` (K,) are fixed.
    """
    layout = residuals.layout
    free = np.ones(layout.size, bool) if kept is None else ~kept
    at = layout.inward(start)
    lower, upper = (layout.inward(end)[free] for end in part or (layout.minimum, layout.maximum))
    margin = 1e-3 * (upper - lower)

    def whole(t: Array) -> Array:
        out = at.copy()
        out[free] = t
        return out

    found = least_squares(
        lambda t: residuals.value(whole(t)),
        np.clip(at[free], lower + margin, upper - margin),
        lambda t: residuals.jacobian(whole(t))[:, free],
        bounds=(lower, upper),
        x_scale=upper - lower,
        ftol=tolerance,
        xtol=tolerance,
        gtol=1e-12,
        max_nfev=iterations,
    )
    p = np.where(free, layout.outward(whole(found.x)), start)
    return Minimum(p, 2.0 * float(found.cost), found.status > 0, part)


def search(residuals: Residuals, options: GaussNewton) -> tuple[Array, Array]:
    """Return parameter vectors (n, K) spread over the ranges, and their costs (n,) on a few samples, best first.

    Vectors whose BSDF is not finite are left out. All bands share the values of a vector, except for parameters in
    which the BSDF is affine: two evaluations give their best value in every band, to first order in the metric.
    """
    layout, bsdf, metric = residuals.layout, residuals.evaluator, residuals.criterion.metric
    samples = residuals.criterion.samples
    rows = _spread(len(samples), options.search_pairs)
    y, w = samples.f_cos[rows], samples.weight[rows][:, None]
    names = [o.name for o in layout.family.parameters]
    solved = next((o.name for o in layout.family.parameters if o.affine and o.per_band), None)
    searched = [name for name in names if name != solved]
    sobol = qmc.Sobol(max(len(searched), 1), seed=options.seed).random(options.n_search)
    points = np.tile(layout.default, (options.n_search, 1))
    for j, name in enumerate(searched):
        o = layout.family.named(name)
        low, high = o.inward(o.minimum), o.inward(o.maximum)
        points[:, layout.slices[name]] = o.outward(low + (high - low) * sobol[:, j])[:, None]
    if solved is None:
        model = bsdf.values(points, rows)
    else:
        place, o = layout.slices[solved], layout.family.named(solved)
        black, white = points.copy(), points.copy()
        black[:, place], white[:, place] = 0.0, 1.0
        both = bsdf.values(np.concatenate([black, white]), rows)
        offset, gain = both[: len(points)], both[len(points) :] - both[: len(points)]
        W = w * metric.slope(y) ** 2
        best = np.sum(W * gain * (y - offset), axis=1) / np.maximum(np.sum(W * gain * gain, axis=1), 1e-30)
        points[:, place] = np.clip(best, o.minimum, o.maximum)
        model = offset + points[:, None, place] * gain
    costs = np.sum(w * (metric(model) - metric(y)) ** 2, axis=(1, 2))
    finite = np.isfinite(costs)
    if not np.any(finite):
        raise NumericalError(
            f"BSDF {layout.family.type} gives no finite values anywhere in the ranges of {', '.join(names)}; check them"
        )
    points, costs = points[finite], costs[finite]
    order = np.argsort(costs, kind="stable")
    return points[order], costs[order]


def distinct(scale: Array, minima: list[Minimum], distance: float) -> list[Minimum]:
    """Return the minima, best first, without those within a distance of a better minimum.

    The distance is the largest difference of a parameter, relative to its range.
    """
    kept: list[Minimum] = []
    for one in sorted(minima, key=_cost):
        if all(np.max(np.abs(one.p - other.p) / scale) > distance for other in kept):
            kept.append(one)
    return kept


def _cost(minimum: Minimum) -> float:
    return minimum.cost


def select_minima(minima: list[Minimum], limit: float) -> list[Minimum]:
    """Return the minima, best first, and the rivals whose costs exceed the best by less than the limit.

    `minima` come from `find_minima`. A rival is the result of a restricted refinement; it is returned only if no
    other minimum within the limit lies in the same part of the ranges.
    """
    best = minima[0].cost
    kept = [one for one in minima if one.part is None]
    for one in minima:
        if one.part is None or one.cost - best > limit:
            continue
        lower, upper = one.part
        if not any(
            other.cost - best <= limit and np.all((other.p >= lower) & (other.p <= upper)) for other in kept
        ):
            kept.append(one)
    return sorted(kept, key=lambda minimum: max(minimum.cost, best))


def find_minima(residuals: Residuals, options: GaussNewton) -> list[Minimum]:
    """Return distinct minima, best first, followed for few samples by rivals (see `select_minima`)."""
    stages = Stages({"coarse search": 4, "refinement": 6})
    stages.begin("coarse search")
    layout = residuals.layout
    scale = layout.maximum - layout.minimum
    points, _ = search(residuals, options)
    starts = _diverse(layout.inward(points), points, layout.is_per_band, options.n_starts)
    samples = residuals.criterion.samples
    few = samples.subset(_spread(len(samples), options.coarse_pairs))
    is_whole = len(few) == len(samples)
    if few.pixels is not None and not is_whole:
        few = replace(few, pixels=few.pixels.every(options.coarse_pixels))
    first = Residuals(layout.family, Criterion(few, residuals.criterion.metric.name))
    if is_whole:  # few samples leave room for rivals
        parts = _outer_quarters(points, layout)
        rivals = [
            minimize(first, start, options.iterations, options.tolerance, part)
            for start, part in progress.each(parts)
        ]
        starts += [start for start, _ in parts] + [min(rivals, key=_cost).p for _ in parts[:1]]
        stages.begin("refinement")
        in_starts = progress.each(starts)
        ends = [minimize(first, start, options.iterations, options.tolerance) for start in in_starts]
        return [*distinct(scale, ends, 0.02), *sorted(rivals, key=_cost)]
    rough = [minimize(first, start, options.coarse_iterations, 1e-4) for start in progress.each(starts)]
    candidates = distinct(scale, rough, 0.05)
    best = candidates[0].cost
    chosen = [one for one in candidates if one.cost <= 4.0 * best][: options.n_fine]
    stages.begin("refinement")
    in_chosen = progress.each(chosen)
    ends = [minimize(residuals, one.p, options.iterations, options.tolerance) for one in in_chosen]
    return distinct(scale, ends, 0.02)


def refine_bands(
    family: BsdfFamily, samples: FitSamples, metric: str, values: Mapping[str, Any]
) -> tuple[dict[str, float | list[float]], float]:
    """Fit the parameters that differ between bands to samples in B bands, starting from the mean of RGB.

    Shared values are kept. Returns all values by name, and the relative residual. The method is Levenberg-Marquardt
    in all bands at once, on some of the samples. Values stay above 0, because Mitsuba accepts no negative spectra.
    """
    criterion = Criterion(samples.subset(_spread(len(samples), _BAND_PAIRS)), metric)
    bands = evaluator(family, criterion.wi, criterion.wo, samples.bands.count)
    layout = bands.layout
    p = layout.join({name: np.mean(value) for name, value in values.items()})
    own = [layout.slices[o.name] for o in family.parameters if o.per_band]
    index = np.stack([np.arange(place.start, place.stop) for place in own], axis=1)  # (B, n)
    lower, upper = np.maximum(layout.minimum, 0.0)[index], layout.maximum[index]
    p[index] = np.clip(p[index], lower, upper)
    value, slope = bands.band_jacobian(p)
    cost = np.sum(criterion.residual(value) ** 2, axis=0)  # (B,)
    damping = np.full(len(index), 1e-3)
    for _ in range(_BAND_ITERATIONS):
        residual, J = criterion.residual(value), criterion.slope(value, slope)  # (R, B), (R, B, n)
        hessian = np.einsum("mbi,mbj->bij", J, J)
        gradient = np.einsum("mbi,mb->bi", J, residual)
        diagonal = np.einsum("bii->bi", hessian)
        scaled = hessian + (damping[:, None] * diagonal + 1e-30)[:, None, :] * np.eye(len(own))
        trial = p.copy()
        trial[index] = np.clip(p[index] - np.linalg.solve(scaled, gradient[..., None])[..., 0], lower, upper)
        new_value, new_slope = bands.band_jacobian(trial)
        new_cost = np.sum(criterion.residual(new_value) ** 2, axis=0)
        better = new_cost < cost
        step = np.max(np.abs(trial - p)[index])
        p[index[better]] = trial[index[better]]
        value = np.where(better, new_value, value)
        slope = np.where(better[:, None], new_slope, slope)
        cost = np.where(better, new_cost, cost)
        damping = np.where(better, 0.2 * damping, 10.0 * damping)
        if step < 1e-6:
            break
    return layout.split(p), criterion.relative(value)


def _spread(n: int, count: int) -> Indices:
    """Return at most `count` of n rows, sorted, in no step with any regular order of the table."""
    if n <= count:
        return np.arange(n)
    return np.sort(np.random.default_rng(0).permutation(n)[:count])


def _diverse(inward: Array, points: Array, is_per_band: Mask, n: int) -> list[Array]:
    """Return the first n points, best first, that differ from each other in the shared parameters."""
    shared = inward[:, ~is_per_band]
    if not shared.shape[1]:
        return list(points[:n])
    span = np.ptp(shared, axis=0)
    unit = shared / np.where(span > 0, span, 1.0)
    radius = 0.25 * np.sqrt(shared.shape[1])
    chosen: list[int] = []
    for k in range(len(unit)):
        if all(np.linalg.norm(unit[k] - unit[other]) > radius for other in chosen):
            chosen.append(k)
            if len(chosen) == n:
                break
    return [points[k] for k in chosen]


def _outer_quarters(points: Array, layout: ParameterLayout) -> list[tuple[Array, tuple[Array, Array]]]:
    """Return the best point in the lowest and the highest quarter of each shared parameter's range, with their ends.

    Where samples do not tell two kinds of material apart, the cost may fall all the way from one to the other: the
    second is then no minimum, and only found where the parameter is kept from leaving.
    """
    chosen = []
    for k in np.flatnonzero(~layout.is_per_band):
        quarter = 0.25 * (layout.maximum[k] - layout.minimum[k])
        for low, high in (
            (layout.minimum[k], layout.minimum[k] + quarter),
            (layout.maximum[k] - quarter, layout.maximum[k]),
        ):
            inside = np.flatnonzero((points[:, k] >= low) & (points[:, k] <= high))
            if inside.size:
                lower, upper = layout.minimum.copy(), layout.maximum.copy()
                lower[k], upper[k] = low, high
                chosen.append((points[inside[0]], (lower, upper)))
    return chosen
