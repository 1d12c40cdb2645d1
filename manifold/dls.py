"""Direct local search: the pattern search of Hooke & Jeeves.

The search has two interfaces:

- `hooke_jeeves` is a method for `scipy.optimize.minimize`;
- `direct_local_search` minimises a `MoveObjective`, for which moving one coordinate costs less than evaluating
  a new point (a rank-two update for the likelihood of a latent variable model).

Source: Hooke & Jeeves 1961.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
import scipy

from manifold.core.errors import ShapeError, UsageError
from manifold.core.records import Array

CONVERGED, OUT_OF_EVALUATIONS, OUT_OF_SWEEPS, NOT_FINITE, STOPPED = 0, 1, 2, 3, 99
_MESSAGES = {
    CONVERGED: "every step is below the tolerance",
    OUT_OF_EVALUATIONS: "the maximum number of evaluations was reached",
    OUT_OF_SWEEPS: "the maximum number of sweeps was reached",
    NOT_FINITE: "no finite value was found",
    STOPPED: "the callback stopped the search",
}


class MoveObjective(Protocol):
    """A function of n coordinates with a current point. Values may be NaN or inf."""

    @property
    def x(self) -> Array:
        """Return the current point, shape (n,)."""

    @property
    def value(self) -> float:
        """Return the value of the function at the current point."""

    def explore(self, steps: Array, heading: Array, limits: tuple[Array, Array], budget: int) -> int:
        """Move each coordinate by plus and minus its step, keep improvements, and return the number of trials.

        Args:
            steps: step of each coordinate, > 0, shape (n,). A step that would pass a limit ends at the limit; from
                there, no step beyond it is tried.
            heading: the sign, +1 or -1, that is tried first for each coordinate, shape (n,); it is overwritten by the
                sign that succeeded.
            limits: lowest and highest coordinates, each of shape (n,).
            budget: largest number of trials.
        """

    def move_to(self, x: Array) -> None:
        """Make x (n,) the current point."""


class _OutOfEvaluations(Exception):
    """Ends the search wherever it is."""


def direct_local_search(
    objective: MoveObjective,
    *,
    initial_step: float | Array = 0.5,
    tolerance: float = 1e-6,
    bounds: scipy.optimize.Bounds | Sequence[tuple[float | None, float | None]] | None = None,
    maxfev: int | None = None,
    max_sweeps: int | None = None,
    callback: Callable[[Array, float], Any] | None = None,
) -> scipy.optimize.OptimizeResult:
    """Minimise a function by exploratory moves along the coordinates and pattern moves along their sum.

    A sweep tries `x_j + step` and `x_j - step` for every j and keeps each improvement at once. After a sweep that
    lowers the value, the search repeats the whole displacement and explores from there, as long as that lowers the
    value. After any other sweep the step halves, until it falls below the tolerance.

    Args:
        objective: the function; the search starts at its current point and leaves it at the best point, even after an
            exception.
        initial_step: first step in units of x, a number or shape (n,).
        tolerance: the search ends when every step is smaller than this.
        bounds: limits of every coordinate, in the forms that scipy accepts.
        maxfev: limit on evaluations; moving one coordinate counts as one; 2000 n if None.
        max_sweeps: limit on rounds; a round is a sweep and the pattern moves after it.
        callback: called as `callback(x, value)` after every round; StopIteration ends the search.

    Returns:
        A result with `x`, `fun`, `nfev`, `nit`, `status`, `success` and `message`, as in scipy.

    Raises:
        ShapeError: the bounds or steps have another length than x.
        UsageError: a step or tolerance is not positive.
    Source: Hooke & Jeeves 1961.
    """
    n = objective.x.shape[0]
    if not (np.all(np.asarray(initial_step) > 0) and tolerance > 0):
        raise UsageError(f"initial_step {initial_step} and tolerance {tolerance}: both must be positive")
    search = _PatternSearch(
        objective,
        steps=_per_coordinate(initial_step, n, "initial_step"),
        limits=_limits(bounds, n),
        maxfev=2000 * n if maxfev is None else maxfev,
    )
    nit, status = 0, OUT_OF_SWEEPS
    try:
        while status == OUT_OF_SWEEPS and (max_sweeps is None or nit < max_sweeps):
            search.round()
            nit += 1
            if callback is not None:
                callback(search.best_x.copy(), search.best)
            if np.all(search.steps < tolerance):
                status = CONVERGED
    except _OutOfEvaluations:
        status = OUT_OF_EVALUATIONS
    except StopIteration:
        status = STOPPED
    finally:
        search.return_to_best()
    if status == CONVERGED and not np.isfinite(search.best):
        status = NOT_FINITE
    return scipy.optimize.OptimizeResult(
        x=search.best_x.copy(),
        fun=search.best,
        nfev=search.nfev,
        nit=nit,
        status=status,
        success=status == CONVERGED,
        message=_MESSAGES[status],
    )


class _PatternSearch:
    """Steps, budget, and the best point of one search."""

    def __init__(
        self, objective: MoveObjective, steps: Array, limits: tuple[Array, Array], maxfev: int
    ) -> None:
        self.objective = objective
        self.steps = steps
        self.heading = np.ones(steps.shape[0])  # the sign that succeeded last is tried first
        self.limits = limits
        self.maxfev = maxfev
        self.nfev = 1
        self.best_x, self.best = objective.x.copy(), objective.value

    def round(self) -> None:
        """Explore once from the best point, then move along the pattern while that improves; else halve the steps."""
        origin = self.best_x
        self._explore()
        improved = self._keep_if_better()
        if not improved:
            self.steps *= 0.5
        while improved:
            pattern = np.clip(2.0 * self.best_x - origin, *self.limits)
            origin = self.best_x
            self.objective.move_to(pattern)
            self._spend(1)
            # Explored even if the jump itself made things worse: that is what lets it follow curved valleys.
            self._explore()
            improved = self._keep_if_better()
        self.return_to_best()

    def return_to_best(self) -> None:
        """Leave the objective at the best point."""
        if not self._keep_if_better() and not np.array_equal(self.objective.x, self.best_x):
            self.objective.move_to(self.best_x)

    def _keep_if_better(self) -> bool:
        if not self.objective.value < self.best:
            return False
        self.best_x, self.best = self.objective.x.copy(), self.objective.value
        return True

    def _explore(self) -> None:
        self._spend(self.objective.explore(self.steps, self.heading, self.limits, self.maxfev - self.nfev))

    def _spend(self, evaluations: int) -> None:
        self.nfev += evaluations
        if self.nfev >= self.maxfev:
            raise _OutOfEvaluations


def _per_coordinate(value: float | Array, n: int, name: str) -> Array:
    value = np.asarray(value, dtype=np.float64)
    if value.shape not in ((), (1,), (n,)):
        raise ShapeError(f"{name} has shape {value.shape}, expected a number or ({n},)")
    return np.array(np.broadcast_to(value, (n,)))


def _limits(
    bounds: scipy.optimize.Bounds | Sequence[tuple[float | None, float | None]] | None, n: int
) -> tuple[Array, Array]:
    """Return lower and upper limits, shape (n,) each, from either of scipy's forms."""
    if bounds is None:
        return np.full(n, -np.inf), np.full(n, np.inf)
    if isinstance(bounds, scipy.optimize.Bounds):
        lower, upper = bounds.lb, bounds.ub
    else:
        pairs = list(bounds)
        lower = np.array([-np.inf if low is None else low for low, _ in pairs])
        upper = np.array([np.inf if high is None else high for _, high in pairs])
    lower, upper = _per_coordinate(lower, n, "lower bounds"), _per_coordinate(upper, n, "upper bounds")
    if np.any(lower > upper):
        raise UsageError(f"lower bound {lower[lower > upper][0]} lies above its upper bound")
    return lower, upper


class FunctionObjective:
    """Presents an ordinary function of x (n,) as a `MoveObjective`; every move costs a full evaluation."""

    def __init__(self, fun: Callable[..., float], x0: Array, args: tuple[Any, ...] = ()) -> None:
        self._fun, self._args = fun, args
        self.x = x0
        self.value = self._evaluate(x0)

    def explore(self, steps: Array, heading: Array, limits: tuple[Array, Array], budget: int) -> int:
        """Move each coordinate by its step if that lowers the value; return the evaluations, at most `budget`."""
        tried = 0
        for index, (step, low, high) in enumerate(zip(steps, *limits, strict=True)):
            for sense in (heading[index], -heading[index]):
                target = min(max(self.x[index] + sense * step, low), high)
                if target == self.x[index]:
                    continue
                if tried == budget:
                    return tried
                tried += 1
                moved = self.x.copy()
                moved[index] = target
                value = self._evaluate(moved)
                if value < self.value:
                    self.x, self.value, heading[index] = moved, value, sense
                    break
        return tried

    def move_to(self, x: Array) -> None:
        """Move to x (n,) and evaluate the function there."""
        self.x, self.value = x.copy(), self._evaluate(x)

    def _evaluate(self, x: Array) -> float:
        # A copy: functions handed to scipy may keep or change their argument.
        return float(np.asarray(self._fun(x.copy(), *self._args)).item())


def hooke_jeeves(
    fun: Callable[..., float],
    x0: Array,
    args: tuple[Any, ...] = (),
    *,
    bounds: scipy.optimize.Bounds | Sequence[tuple[float | None, float | None]] | None = None,
    callback: Callable[..., Any] | None = None,
    tol: float | None = None,
    initial_step: float | Array = 0.5,
    maxfev: int | None = None,
    maxiter: int | None = None,
    **unused: Any,
) -> scipy.optimize.OptimizeResult:
    """Minimise a function by direct local search, as `method=hooke_jeeves` of `scipy.optimize.minimize`.

    Args:
        fun: function called as `fun(x, *args)` that returns a number; it need be neither smooth nor finite.
        x0: start, shape (n,), clipped to the bounds.
        args: further arguments of `fun`.
        bounds: `scipy.optimize.Bounds` or pairs `(low, high)`.
        callback: function called after every round, as `callback(intermediate_result)` if its parameter has that
            name, otherwise as `callback(x)`; StopIteration ends the search.
        tol: the search ends when every step is smaller than this; 1e-6 if None.
        initial_step: first step, a number or shape (n,).
        maxfev: limit on evaluations, 2000 n if None.
        maxiter: limit on rounds.
        unused: `jac`, `hess`, `hessp` and `constraints`, which scipy always passes.

    Raises:
        UsageError: constraints are given, which the method does not support.
    Source: Hooke & Jeeves 1961.

    >>> from scipy.optimize import minimize
    >>> found = minimize(lambda x: abs(x[0] - 1.0) + (x[1] + 2.0) ** 2, [0.0, 0.0], method=hooke_jeeves)
    >>> found.x.round(3), found.success
    (array([ 1., -2.]), True)
    """
    if unused.get("constraints"):
        raise UsageError("hooke_jeeves supports bounds but not constraints; add a penalty to the function")
    start = np.atleast_1d(np.array(x0, dtype=np.float64))
    if start.ndim != 1:
        raise ShapeError(f"x0 has shape {start.shape}, expected (n,)")
    objective = FunctionObjective(fun, np.clip(start, *_limits(bounds, start.shape[0])), args)
    return direct_local_search(
        objective,
        initial_step=initial_step,
        tolerance=1e-6 if tol is None else tol,
        bounds=bounds,
        maxfev=maxfev,
        max_sweeps=maxiter,
        callback=_in_scipy_form(callback),
    )


def _in_scipy_form(callback: Callable[..., Any] | None) -> Callable[[Array, float], Any] | None:
    """Adapt a callback to scipy's rule: a sole parameter `intermediate_result` gets an OptimizeResult, any other x."""
    if callback is None:
        return None
    if set(inspect.signature(callback).parameters) == {"intermediate_result"}:
        return lambda x, value: callback(intermediate_result=scipy.optimize.OptimizeResult(x=x, fun=value))
    return lambda x, value: callback(x)
