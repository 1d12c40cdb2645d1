"""Ways to minimise the likelihood of latents: direct local search, L-BFGS, and several starts of it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import minimize

from manifold.dls import STOPPED, direct_local_search
from manifold.latent.incremental import IncrementalObjective
from manifold.latent.objective import LatentObjective
from manifold.records import Array

FitCallback = Callable[[int, float], Any]

_FIRST_STEP = 0.1  # of direct local search, in length scales
_LAST_STEP = 100.0  # of direct local search, in length scales times the tolerance
_ROUGH_STEP = 1e-2  # last step of searches before a descent, in length scales
_WIDE_MU = 0.1  # noise filter of the first search, on a smoother objective
_RELOCATIONS, _RELOCATED, _RELOCATION_SPREAD = 30, 0.25, 0.3  # tries, share of latents, in length scales
_RELOCATION_ITERATIONS = 60  # of L-BFGS after each: enough to compare basins
_RELOCATION_TOLERANCE = 1e-5


class Run:
    """One fit: its limits, the best latents so far, and the counts over all stages.

    The callback gets the best value so far after every round; its StopIteration ends the whole fit.
    """

    def __init__(
        self,
        objective: LatentObjective,
        start: Array,
        max_iter: int,
        tol: float,
        random: np.random.RandomState,
        callback: FitCallback | None,
    ) -> None:
        self.objective, self.max_iter, self.tol = objective, max_iter, tol
        self.random, self.callback = random, callback
        self.n_iter, self.n_evaluations = 0, 1
        self.best_X, self.best = start, objective(start)[0]

    def refine(self, optimizer: str) -> None:
        """Minimise from the best latents so far by one of `OPTIMIZERS`."""
        with suppress(StopIteration):
            OPTIMIZERS[optimizer](self, self.best_X)

    def report(self, X: Array, value: float) -> None:
        """Count a round that ended at X (N, Q)."""
        self.n_iter += 1
        if value < self.best:
            self.best_X, self.best = X.reshape(self.best_X.shape).copy(), value
        if self.callback is not None:
            self.callback(self.n_iter, self.best)


def search(run: Run, X: Array, *, mu: float | None = None, last_step: float = 0.0) -> Array:
    """Direct local search of Hooke & Jeeves from X (N, Q): latents. No gradient.

    Args:
        run: the fit.
        X: the start.
        mu: another noise filter than the fit's; rounds are not reported then, since their values are not comparable.
        last_step: lower bound of the last step, in length scales.
    Source: Hikichi & Iwasaki, section 3.4.
    """
    objective = run.objective if mu is None else run.objective.with_mu(mu)
    l = objective.kernel.length_scale
    result = direct_local_search(
        IncrementalObjective(objective, X),
        initial_step=_FIRST_STEP * l,
        tolerance=max(_LAST_STEP * run.tol, last_step) * l,
        maxfev=np.iinfo(np.int64).max,
        max_sweeps=run.max_iter,
        callback=run.report if mu is None else None,
    )
    run.n_evaluations += result.nfev
    if result.status == STOPPED:
        raise StopIteration
    return result.x.reshape(X.shape)


def descend(run: Run, X: Array, *, limit: int | None = None, tol: float = 0.0) -> tuple[Array, float]:
    """L-BFGS from X (N, Q): latents and their value."""
    objective = run.objective

    def flat(x: Array) -> tuple[float, Array]:
        value, gradient = objective(x.reshape(X.shape))
        return value, gradient.reshape(-1)

    def report(intermediate_result: Any) -> None:
        run.report(intermediate_result.x, float(intermediate_result.fun))

    limit = run.max_iter if limit is None else min(limit, run.max_iter)
    tol = max(tol, run.tol)
    options = {"maxiter": limit, "maxfun": 10 * limit, "ftol": 1e-2 * tol, "gtol": tol, "maxcor": 20}
    result = minimize(flat, X.reshape(-1), jac=True, method="L-BFGS-B", callback=report, options=options)
    run.n_evaluations += int(result.nfev)
    if result.status == STOPPED:
        raise StopIteration
    return result.x.reshape(X.shape), float(result.fun)


def search_and_descend(run: Run, X: Array) -> tuple[Array, float]:
    """The best of three descents from X (N, Q), then of relocations of it: latents and their value.

    Each ends in L-BFGS: from X, from the end of a direct local search, and from the end of two, the first under a
    larger noise filter, which makes the objective smoother. Then, repeatedly, random latents are moved next to others
    and refined by L-BFGS; improvements are kept. That leaves optima which no move of a single latent improves.
    """
    rough = partial(search, run, last_step=_ROUGH_STEP)
    ends = [descend(run, X), descend(run, rough(X))]
    if run.objective.kernel.mu < _WIDE_MU:
        ends.append(descend(run, rough(rough(X, mu=_WIDE_MU))))
    X, value = min(ends, key=lambda end: end[1])
    for _ in range(min(_RELOCATIONS, run.max_iter)):
        moved = _relocate(X, run.objective.kernel.length_scale, run.random)
        end, end_value = descend(run, moved, limit=_RELOCATION_ITERATIONS, tol=_RELOCATION_TOLERANCE)
        if end_value < value:
            X, value = end, end_value
    return descend(run, X)


def _relocate(X: Array, length_scale: float, random: np.random.RandomState) -> Array:
    """Latents (N, Q) with a random quarter of them, at least two, moved next to random others."""
    N, Q = X.shape
    moved = random.choice(N, max(2, int(_RELOCATED * N)), replace=False)
    beside = X[random.choice(N, len(moved))]
    out = X.copy()
    out[moved] = beside + _RELOCATION_SPREAD * length_scale * random.normal(size=(len(moved), Q))
    return out


OPTIMIZERS: dict[str, Callable[[Run, Array], Any]] = {
    "dls": search,
    "l-bfgs": descend,
    "multistart": search_and_descend,
}
