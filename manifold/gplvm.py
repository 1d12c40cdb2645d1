"""A Gaussian-process latent variable model, which finds low-dimensional coordinates of materials.

The likelihood depends on the data only through their N x N Gram matrix S, so the cost of a fit does not depend on the
number of outputs D.
The latents start at principal components. Direct local search (`manifold.dls`), as Hikichi & Iwasaki publish it
(sections 3.3 and 3.4), or L-BFGS then minimises the negative log likelihood per output,
`manifold.gp.likelihood.LatentObjective`.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import scipy
from sklearn.base import BaseEstimator, ClassNamePrefixFeaturesOutMixin, TransformerMixin
from sklearn.utils import check_array
from sklearn.utils.validation import check_is_fitted, validate_data

from manifold.core.defaults import (
    DEFAULT_KERNEL,
    DEFAULT_LENGTH_SCALE,
    DEFAULT_MU,
    DEFAULT_OPTIMIZER,
    DEFAULT_PRIOR,
)
from manifold.core.errors import UsageError
from manifold.core.records import Array
from manifold.dls import STOPPED, FunctionObjective, MoveObjective, direct_local_search
from manifold.gp.encoding import Encoder
from manifold.gp.kernels import Kernel, kernel_named, require_mu
from manifold.gp.likelihood import (
    IncrementalObjective,
    LatentObjective,
    blas_threads,
    centre_gram,
    fix_gauge,
    pca_start,
    require_different,
    require_gram,
    require_prior,
    require_start,
)
from manifold.gpr import GaussianProcess
from manifold.registries import OPTIMIZERS

FitCallback = Callable[[int, float], Any]

_FIRST_STEP = 0.1  # first step of direct local search, in length scales
_SMALLEST_STEP_PER_TOL = 100.0  # its smallest step, in length scales per unit of `tol`


class Run:
    """The state of one fit: objective, limits, best latents so far, and counts of rounds and evaluations.

    The callback receives the best value so far after every round; if it raises StopIteration, the whole fit ends.
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

    def report(self, X: Array, value: float) -> None:
        """Count a finished round, keep its latents X (N, Q) if they are the best so far, and call the callback."""
        self.n_iter += 1
        if value < self.best:
            self.best_X, self.best = X.reshape(self.best_X.shape).copy(), value
        if self.callback is not None:
            self.callback(self.n_iter, self.best)


def minimise_by_dls(run: Run, X: Array) -> None:
    """Minimise from X (N, Q) by direct local search (Hooke & Jeeves), without a gradient, and report to the run.

    Source: Hikichi & Iwasaki, section 3.4.
    """
    objective = run.objective
    l = objective.kernel.length_scale
    moves: MoveObjective
    if objective.output_variance is None and objective.kernel.is_compiled:
        moves = IncrementalObjective(objective, X)
    else:  # the compiled moves profile the output variance of built-in kernels
        moves = FunctionObjective(lambda x: objective.value(x.reshape(X.shape)), X.reshape(-1).copy())
    result = direct_local_search(
        moves,
        initial_step=_FIRST_STEP * l,
        tolerance=_SMALLEST_STEP_PER_TOL * run.tol * l,
        maxfev=np.iinfo(np.int64).max,
        max_sweeps=run.max_iter,
        callback=run.report,
    )
    run.n_evaluations += result.nfev
    if result.status == STOPPED:
        raise StopIteration


def minimise_by_lbfgs(run: Run, X: Array) -> None:
    """Minimise from X (N, Q) by L-BFGS, and report to the run."""
    objective = run.objective

    def flat(x: Array) -> tuple[float, Array]:
        value, gradient = objective(x.reshape(X.shape))
        return value, gradient.reshape(-1)

    def report(intermediate_result: Any) -> None:
        run.report(intermediate_result.x, float(intermediate_result.fun))

    limit, tol = run.max_iter, run.tol
    options = {"maxiter": limit, "maxfun": 10 * limit, "ftol": 1e-2 * tol, "gtol": tol, "maxcor": 20}
    result = scipy.optimize.minimize(
        flat, X.reshape(-1), jac=True, method="L-BFGS-B", callback=report, options=options
    )
    run.n_evaluations += int(result.nfev)
    if result.status == STOPPED:
        raise StopIteration


def log_likelihood(
    X: Array, S: Array, n_outputs: int, *, mu: float = DEFAULT_MU,
    length_scale: float = DEFAULT_LENGTH_SCALE, kernel: str | type[Kernel] = DEFAULT_KERNEL,
    output_variance: float | None = 1.0,
) -> float:  # fmt: skip
    """Return the log likelihood of latents, `log p(Y | X)`, including all constants.

    `-N D / 2 log(2 pi s^2) - D / 2 log|K| - tr(K^-1 H S H) / (2 s^2)`

    Args:
        X: latents, shape (N, Q).
        S: Gram matrix `Y Y^T` of the outputs, shape (N, N); centred here.
        n_outputs: D, the number of outputs of a sample.
        mu: noise filter of the kernel.
        length_scale: l > 0, in units of the latents.
        kernel: name of a kernel, or a class of your own; see `kernel_named`.
        output_variance: s^2, in squared units of the outputs; None selects the value that maximises the likelihood.

    Raises:
        ShapeError: S is not a Gram matrix, or X has another number of rows.
    Source: Hikichi & Iwasaki, eq. 21, where s^2 = 1.
    """
    S = require_gram(S, n_outputs)
    X = require_start(X, len(S), np.shape(X)[1] if np.ndim(X) == 2 else 1)
    covariance = kernel_named(kernel, mu, length_scale)
    F = LatentObjective(centre_gram(S), n_outputs, covariance, output_variance=output_variance).value(X)
    return -n_outputs * (F + 0.5 * len(S) * (1.0 + float(np.log(2.0 * np.pi))))


_SAME = 1e-12  # squared distance, relative to the squared norms, under which data count as a training sample


class GPLVM(ClassNamePrefixFeaturesOutMixin, TransformerMixin, BaseEstimator):
    """Gaussian-process latent variable model.

    >>> rng = np.random.default_rng(0)
    >>> t = rng.uniform(-1.0, 1.0, 20)
    >>> Y = np.column_stack([t, t**2, np.sin(2.0 * t)])
    >>> model = GPLVM(n_components=1, mu=1e-2, optimizer="l-bfgs").fit(Y)
    >>> bool(abs(np.corrcoef(model.embedding_[:, 0], t)[0, 1]) > 0.98)
    True

    The fit starts from principal components and refines the latents. The latents are centred, and the sign of each
    axis makes its longer tail positive. The objective never ends above its starting value.

    Args:
        n_components: Q, the number of latent dimensions.
        mu: noise filter of the kernel, at least 1e-10.
        length_scale: l > 0. Without a prior it only sets the unit of the latents.
        kernel: name of a kernel, or a class of your own; see `kernel_named`.
        optimizer: `dls` is the direct local search of Hooke & Jeeves without gradients, as Hikichi & Iwasaki publish
            it (section 3.4); `l-bfgs` descends along the gradient.
        prior: weight of the Gaussian prior on the latents *per output*; 0 is none, 1 / D is eq. 19 of
            Hikichi & Iwasaki as they state it.
        output_variance: s^2, in squared units of the outputs; None selects the value that maximises the likelihood,
            1.0 is eq. 20 of Hikichi & Iwasaki.
        start_scale: standard deviation of the starting latents along every axis.
        farthest_first: search first the latents that start farthest from the origin, so that the order of the
            samples does not matter; False searches in the order of the samples.
        max_iter: limit on the rounds of direct local search or on the iterations of L-BFGS; 0 keeps the start.
        tol: L-BFGS ends when an iteration lowers F by less than `tol / 100 * |F|`, or when no entry of the gradient
            exceeds `tol`; direct local search ends when its steps fall below `100 * tol` length scales.

    Attributes:
        embedding_: latents X, shape (N, Q).
        objective_, objective_start_: the objective F, the negative log likelihood per output, at the end and at the
            start.
        n_iter_, n_evaluations_: numbers of rounds and of evaluations of F; moving one coordinate counts as one.
        output_variance_: s^2, in squared units of the outputs.
        gp_: `GaussianProcess` of the latents.
        gram_: centred Gram matrix, shape (N, N).
        n_outputs_: D, the number of outputs of a sample.
        Y_fit_: the data, shape (N, D), after `fit`; None after `fit_gram`, which stores nothing of size D.

    Source: Lawrence 2005; Hikichi & Iwasaki, eq. 16-21.
    """

    Y_fit_: Array | None

    def __init__(
        self,
        n_components: int = 2,
        *,
        mu: float = DEFAULT_MU,
        length_scale: float = DEFAULT_LENGTH_SCALE,
        kernel: str | type[Kernel] = DEFAULT_KERNEL,
        optimizer: str = DEFAULT_OPTIMIZER,
        prior: float = DEFAULT_PRIOR,
        output_variance: float | None = None,
        start_scale: float = 1.0,
        farthest_first: bool = True,
        max_iter: int = 3000,
        tol: float = 1e-6,
    ) -> None:
        self.n_components = n_components
        self.mu = mu
        self.length_scale = length_scale
        self.kernel = kernel
        self.optimizer = optimizer
        self.prior = prior
        self.output_variance = output_variance
        self.start_scale = start_scale
        self.farthest_first = farthest_first
        self.max_iter = max_iter
        self.tol = tol

    # -- fitting -------------------------------------------------------------------------------------------

    def fit(self, Y: Array, y: Any = None, *, callback: FitCallback | None = None) -> GPLVM:
        """Fit the latents to data Y (N, D), which this method centres; y is ignored.

        `callback(iteration, F)` is called after every round. If it raises StopIteration, the fit ends with the best
        latents so far; after any other exception the estimator keeps its earlier latents.
        """
        Y = validate_data(self, Y, dtype=np.float64, ensure_min_samples=2)
        Y_c = Y - Y.mean(axis=0)
        S = Y_c @ Y_c.T
        require_different(S, float(np.sum(Y * Y)))
        self._fit_centred(S, Y.shape[1], None, callback)
        self.Y_fit_ = Y.copy()
        return self

    def fit_gram(
        self, S: Array, n_outputs: int, *, X0: Array | None = None, callback: FitCallback | None = None
    ) -> GPLVM:
        """Fit the latents to a Gram matrix `S = Y Y^T` (N, N) of outputs, which this method centres (H S H).

        Args:
            S: shape (N, N), symmetric, N at least 2.
            n_outputs: D, the number of outputs of a sample.
            X0: starting latents, shape (N, Q); None starts from principal components.
            callback: as in `fit`.

        Raises:
            ShapeError: S is not square, symmetric and finite, or all samples are identical.
            UsageError: a parameter of the model is out of range.
        """
        S = require_gram(S, n_outputs)
        centred = centre_gram(S)
        require_different(centred, float(np.trace(S)))
        self._fit_centred(centred, n_outputs, X0, callback)
        self.Y_fit_ = None
        return self

    def fit_transform(self, Y: Array, y: Any = None, **fit_params: Any) -> Array:
        """Fit the latents to data Y (N, D) and return them, shape (N, Q)."""
        return self.fit(Y, y, **fit_params).embedding_.copy()

    def _fit_centred(self, S: Array, n_outputs: int, X0: Array | None, callback: FitCallback | None) -> None:
        self._require_parameters()
        N, Q = S.shape[0], self.n_components
        start = require_start(X0, N, Q) if X0 is not None else self.start_scale * pca_start(S, Q)
        kernel = kernel_named(self.kernel, self.mu, self.length_scale)
        # Where a search along coordinates ends depends on their order: farthest first, in whatever order samples come.
        order = np.argsort(-np.sum(start**2, axis=1), kind="stable") if self.farthest_first else np.arange(N)
        objective = LatentObjective(
            S[np.ix_(order, order)], n_outputs, kernel, float(self.prior), self.output_variance
        )
        run = Run(objective, start[order], self.max_iter, self.tol, callback)
        objective_start = run.best
        if self.max_iter > 0:
            with blas_threads(N), suppress(StopIteration):
                OPTIMIZERS[self.optimizer](run, run.best_X)
        found = fix_gauge(run.best_X)
        objective_end = objective(found)[0]
        if objective_end > objective_start:  # by rounding only: the start was optimal
            found, objective_end = start[order], objective_start
        X = found[np.argsort(order)]
        self.gp_ = GaussianProcess(X, kernel)
        self.gp_.warn_of_fit(S)
        self.embedding_, self.gram_, self.n_outputs_ = X, S, n_outputs
        self.output_variance_ = (
            self.gp_.output_variance(S, n_outputs) if self.output_variance is None else self.output_variance
        )
        self.objective_, self.objective_start_ = objective_end, objective_start
        self.n_iter_, self.n_evaluations_ = max(run.n_iter, 1), run.n_evaluations

    def _require_parameters(self) -> None:
        OPTIMIZERS[self.optimizer]  # checks it
        if not self.n_components >= 1:
            raise UsageError(f"n_components = {self.n_components}, expected at least 1")
        require_mu(self.mu)
        require_prior(self.prior)
        if self.output_variance is not None and not 0.0 < self.output_variance < np.inf:
            raise UsageError(f"output_variance = {self.output_variance}, expected a positive number or None")

    @property
    def _n_features_out(self) -> int:
        return int(self.embedding_.shape[1])

    # -- using ---------------------------------------------------------------------------------------------

    def transform(self, Y: Array) -> Array:
        """Return the most likely latents of data Y (M, D), shape (M, Q); the training latents stay fixed.

        A training sample gets its training latent, because the likelihood is unbounded there. `Encoder` finds the
        others.
        """
        Y_fit = self._require_data()
        mean = Y_fit.mean(axis=0)
        Y_c = validate_data(self, Y, reset=False, dtype=np.float64) - mean
        cross, norm = Y_c @ (Y_fit - mean).T, np.einsum("md,md->m", Y_c, Y_c)
        of_fit = np.diag(self.gram_)
        squared = norm[:, None] + of_fit - 2.0 * cross
        encoder = Encoder(self.gp_, self.gram_, self.n_outputs_, float(self.prior), self.output_variance)
        nearest = squared.argmin(axis=1)
        same = squared.min(axis=1) <= _SAME * (norm + of_fit[nearest])
        latents = self.embedding_[nearest]
        for m in np.flatnonzero(~same):
            latents[m] = encoder.by_likelihood(cross[m], float(norm[m]))
        return latents

    def inverse_transform(self, X: Array) -> Array:
        """Return the predicted data (M, D) at latents X (M, Q); a training latent gives its training sample exactly."""
        return self.weights(X) @ self._require_data()

    def weights(self, X: Array) -> Array:
        """Return the weights of the training samples at latents X (M, Q), shape (M, N)."""
        check_is_fitted(self, "embedding_")
        return self.gp_.weights(check_array(X, dtype=np.float64))

    def std(self, X: Array) -> Array:
        """Return the posterior standard deviation at latents X (M, Q), in units of the outputs, shape (M,)."""
        check_is_fitted(self, "embedding_")
        return np.sqrt(self.output_variance_ * self.gp_.variance(check_array(X, dtype=np.float64)))

    def _require_data(self) -> Array:
        check_is_fitted(self, "embedding_")
        if self.Y_fit_ is None:
            raise UsageError(
                "this model was fitted to a Gram matrix and holds no data; use `weights`, and `Encoder` to locate "
                "samples"
            )
        return self.Y_fit_
