"""Ways to minimise the likelihood of latents: direct local search, and L-BFGS."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
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
        callback: FitCallback | None,
    ) -> None:
        self.objective, self.max_iter, self.tol = objective, max_iter, tol
        self.callback = callback
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


def search(run: Run, X: Array) -> Array:
    """Direct local search of Hooke & Jeeves from X (N, Q): latents. No gradient.

    Args:
        run: the fit.
        X: the start.
    Source: Hikichi & Iwasaki, section 3.4.
    """
    objective = run.objective
    l = objective.kernel.length_scale
    result = direct_local_search(
        IncrementalObjective(objective, X),
        initial_step=_FIRST_STEP * l,
        tolerance=_LAST_STEP * run.tol * l,
        maxfev=np.iinfo(np.int64).max,
        max_sweeps=run.max_iter,
        callback=run.report,
    )
    run.n_evaluations += result.nfev
    if result.status == STOPPED:
        raise StopIteration
    return result.x.reshape(X.shape)


def descend(run: Run, X: Array) -> tuple[Array, float]:
    """L-BFGS from X (N, Q): latents and their value."""
    objective = run.objective

    def flat(x: Array) -> tuple[float, Array]:
        value, gradient = objective(x.reshape(X.shape))
        return value, gradient.reshape(-1)

    def report(intermediate_result: Any) -> None:
        run.report(intermediate_result.x, float(intermediate_result.fun))

    limit, tol = run.max_iter, run.tol
    options = {"maxiter": limit, "maxfun": 10 * limit, "ftol": 1e-2 * tol, "gtol": tol, "maxcor": 20}
    result = minimize(flat, X.reshape(-1), jac=True, method="L-BFGS-B", callback=report, options=options)
    run.n_evaluations += int(result.nfev)
    if result.status == STOPPED:
        raise StopIteration
    return result.x.reshape(X.shape), float(result.fun)


OPTIMIZERS: dict[str, Callable[[Run, Array], Any]] = {
    "dls": search,
    "l-bfgs": descend,
}
