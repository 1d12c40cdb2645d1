"""A Gaussian-process latent variable model: low-dimensional coordinates of materials from their Gram matrix.

The likelihood sees the data only through the N x N Gram matrix S, so a fit costs nothing in the number of
outputs D. With the output variance s^2 profiled out, the negative log likelihood per output is

    F(X) = 1/2 log|K| + N/2 log s^2 + prior/2 ||X||^2,    s^2 = tr(K^-1 S) / (N D),

constants dropped. F times D is the likelihood of Hikichi & Iwasaki, eq. 21.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from typing import Any

import numba as nb
import numpy as np
from scipy.linalg import eigh
from scipy.linalg.lapack import dpotrf, dpotri
from scipy.optimize import minimize
from sklearn.base import BaseEstimator, ClassNamePrefixFeaturesOutMixin, TransformerMixin
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_is_fitted, validate_data

from manifold.dls import STOPPED, direct_local_search
from manifold.errors import NumericalError, ShapeError, UsageError
from manifold.gpr import GPWeights, centre_gram
from manifold.models.criteria import Products
from manifold.models.encoder import Encoder
from manifold.models.kernels import Kernel, kernel_named, radial_of_pair, require_mu
from manifold.parallel import one_blas_thread
from manifold.records import Array

OPTIMIZERS = ("dls", "l-bfgs", "both")
_DRIFT = 2e-9  # largest entry of K P - I tolerated before P is computed afresh
_RENEWED = 500  # accepted moves after which P is computed afresh in any case
_FIRST_STEP, _LARGEST_STEP = 0.02, 0.5  # of the search, in length scales
_SEARCH_ROUNDS = 10  # of every direct local search: later rounds gain slowly, and the polish has a gradient
_WIDE_MU = 0.1  # of the second search, which first follows a smoother objective
_RELOCATIONS, _RELOCATED, _RELOCATION_SPREAD = 30, 0.25, 0.3  # tries, share of latents, in length scales
_RELOCATION_ITERATIONS = 60  # of L-BFGS after each: enough to tell a better basin from a worse one
_RELOCATION_TOLERANCE = 1e-5
_PERTURBATION = 0.3  # of random starts, in standard deviations of the start
_SYMMETRIC = 1e-9  # sum of cubes, relative to that of their magnitudes
_SAME = 1e-12  # squared distance, relative to the squared norms, under which data count as a training sample

FitCallback = Callable[[int, float], Any]


class GPLVM(ClassNamePrefixFeaturesOutMixin, TransformerMixin, BaseEstimator):
    """Gaussian-process latent variable model.

    Starts from principal components and refines the latents by direct local search or L-BFGS. The latents
    are centred, unless the kernel has an origin, and each axis has its longer tail positive.

    Args:
        n_components: Q, the number of latent dimensions.
        mu: noise filter of the kernel, at least 1e-10.
        length_scale: l > 0. It only sets the unit of the latents, unless there is a prior.
        kernel: its name, see `kernel_named`.
        optimizer: `dls`, direct local search: two searches from the start, one of which first sees a wider
            noise filter, each ended by a short polish along the gradient; then random groups of latents are
            moved next to others, polished, and kept where that pays. `l-bfgs`: the gradient alone. `both`:
            a direct local search with long steps from where L-BFGS ended, hence never worse than `l-bfgs`.
        prior: weight of the Gaussian prior on the latents *per output*; 0 is none, 1 / D is eq. 19 of
            Hikichi & Iwasaki as they state it.
        start_scale: standard deviation of the start along every axis.
        max_iter: limit on rounds of the search; ten times as many iterations of L-BFGS; 0 keeps the start.
        tol: ends when a round gains less than this times |F|, or the search's steps fall below it.
        n_starts: how many starts are refined, the best end is kept: the principal components, the same at half
            the scale, then random perturbations of them.
        random_state: of the perturbations and relocations, as scikit-learn takes it; 0 makes fits repeatable.

    Attributes:
        embedding_: latents X, shape (N, Q).
        objective_, objective_start_: F at the end and at the start.
        n_iter_, n_evaluations_: rounds, and evaluations of F (a move of one coordinate is one).
        output_variance_: profiled s^2, in squared units of the outputs.
        gp_: `GPWeights` of the latents.
        gram_: centred Gram matrix, shape (N, N).
        n_outputs_: D.
        Y_fit_: the data, shape (N, D), after `fit`; None after `fit_gram`, which stores nothing of size D.

    Source: Lawrence 2005; Hikichi & Iwasaki, eq. 16-21.
    """

    def __init__(
        self,
        n_components: int = 2,
        *,
        mu: float = 1e-4,
        length_scale: float = 1.0,
        kernel: str = "se",
        optimizer: str = "dls",
        prior: float = 0.0,
        start_scale: float = 1.0,
        max_iter: int = 300,
        tol: float = 1e-6,
        n_starts: int = 1,
        random_state: Any = 0,
    ) -> None:
        self.n_components = n_components
        self.mu = mu
        self.length_scale = length_scale
        self.kernel = kernel
        self.optimizer = optimizer
        self.prior = prior
        self.start_scale = start_scale
        self.max_iter = max_iter
        self.tol = tol
        self.n_starts = n_starts
        self.random_state = random_state

    # -- fitting -------------------------------------------------------------------------------------------

    Y_fit_: Array | None

    def fit(self, Y: Array, y: Any = None, *, callback: FitCallback | None = None) -> GPLVM:
        """Fit to data Y (N, D), which is centred here; y is ignored.

        `callback(iteration, F)` is called after every round; StopIteration ends the refinement with the best
        latents so far, any other exception leaves the latents of the estimator as they were.
        """
        Y = validate_data(self, Y, dtype=np.float64, ensure_min_samples=2)
        Y_c = Y - Y.mean(axis=0)
        S = Y_c @ Y_c.T
        require_different(S, float(np.sum(Y * Y)))
        self._fit_centred(S, Y.shape[1], None, callback)
        self.Y_fit_ = Y.copy()
        # Cross products with new data are centred by the data's mean, not by the Gram matrix's.
        self._mean_Y = Y.mean(axis=0)
        self._gram_row_mean, self._gram_mean = np.zeros(Y.shape[0]), 0.0
        return self

    def fit_gram(
        self, S: Array, n_outputs: int, *, X0: Array | None = None, callback: FitCallback | None = None
    ) -> GPLVM:
        """Fit to a Gram matrix `S = Y Y^T` (N, N) of uncentred outputs; it is centred here (H S H).

        A centred Gram matrix gives the same latents, but `transform_gram` then needs its products taken about
        the same mean.

        Args:
            S: shape (N, N), symmetric, N at least 2.
            n_outputs: D.
            X0: start, shape (N, Q), in place of principal components.
            callback: as for `fit`.
        Raises:
            ShapeError: S is not square, symmetric and finite, or all samples are identical.
            UsageError: a parameter of the model cannot be used.
        """
        S = require_gram(S, n_outputs)
        centred = centre_gram(S)
        require_different(centred, float(np.trace(S)))
        self._fit_centred(centred, n_outputs, X0, callback)
        self._remember_gram(S)
        return self

    def adopt(self, S: Array, n_outputs: int, X: Array) -> GPLVM:
        """Take latents X (N, Q) as they are, bit for bit: a model that was fitted before and stored."""
        S = require_gram(S, n_outputs)
        self._require_parameters()
        X = _require_start(X, S.shape[0], self.n_components)
        objective = self._objective(centre_gram(S), n_outputs)(X)[0]
        self._set_fitted(X.copy(), centre_gram(S), n_outputs)
        self.objective_, self.objective_start_ = objective, objective
        self.n_iter_, self.n_evaluations_ = 0, 1
        self._remember_gram(S)
        return self

    def fit_transform(self, Y: Array, y: Any = None, **fit_params: Any) -> Array:
        """Fit to Y (N, D) and return its latents (N, Q)."""
        return self.fit(Y, y, **fit_params).embedding_.copy()

    def _remember_gram(self, S: Array) -> None:
        self.Y_fit_ = None
        self._gram_row_mean, self._gram_mean = S.mean(axis=1), float(S.mean())

    def _fit_centred(self, S: Array, n_outputs: int, X0: Array | None, callback: FitCallback | None) -> None:
        self._require_parameters()
        N, Q = S.shape[0], self.n_components
        start = _require_start(X0, N, Q) if X0 is not None else self.start_scale * pca_start(S, Q)
        objective = self._objective(S, n_outputs)
        objective_start = objective(start)[0]
        X, n_iter, n_evaluations = start, 0, 1
        if self.max_iter > 0:
            with blas_threads(N):
                X, n_iter, n_evaluations = self._refine(objective, start, callback)
        X = fix_gauge(X, centre=not objective.kernel.has_origin)
        objective_end = objective(X)[0]
        if objective_end > objective_start:  # by rounding only: the start was optimal
            X, objective_end = start, objective_start
        self._set_fitted(X, S, n_outputs)
        self.gp_.warn_of_fit(S)
        self.objective_, self.objective_start_ = objective_end, objective_start
        self.n_iter_, self.n_evaluations_ = max(n_iter, 1), n_evaluations

    def _refine(
        self, objective: LatentObjective, start: Array, callback: FitCallback | None
    ) -> tuple[Array, int, int]:
        """Latents (N, Q), rounds and evaluations, by the stages of the optimizer from every start."""
        random = check_random_state(self.random_state)
        run = _Run(objective, start, self.max_iter, self.tol, random, callback)
        try:
            for X in _starts(start, self.n_starts, random):
                for refine in _STAGES[self.optimizer]:
                    X = refine(run, X)
        except StopIteration:
            pass
        return run.best_X, run.n_iter, run.n_evaluations

    def _set_fitted(self, X: Array, S: Array, n_outputs: int) -> None:
        self.gp_ = GPWeights(X, self._kernel)
        self.embedding_ = X
        self.gram_ = S
        self.n_outputs_ = n_outputs
        self.output_variance_ = self.gp_.output_variance(S, n_outputs)

    def _objective(self, S: Array, n_outputs: int) -> LatentObjective:
        return LatentObjective(S, n_outputs, self._kernel, float(self.prior))

    @property
    def _kernel(self) -> Kernel:
        return kernel_named(self.kernel, self.mu, self.length_scale)

    def _require_parameters(self) -> None:
        if self.optimizer not in OPTIMIZERS:
            raise UsageError(f"optimizer '{self.optimizer}', expected one of {', '.join(OPTIMIZERS)}")
        if not self.n_components >= 1:
            raise UsageError(f"n_components = {self.n_components}, expected at least 1")
        require_mu(self.mu)
        require_prior(self.prior)
        if not self.n_starts >= 1:
            raise UsageError(f"n_starts = {self.n_starts}, expected at least 1")

    @property
    def _n_features_out(self) -> int:
        return int(self.embedding_.shape[1])

    # -- using ---------------------------------------------------------------------------------------------

    def transform(self, Y: Array) -> Array:
        """Latents of data Y (M, D) by their likelihood, the training latents kept, shape (M, Q).

        A training sample gets its training latent.
        """
        check_is_fitted(self, "embedding_")
        if self.Y_fit_ is None:
            raise UsageError("this model was fitted on a Gram matrix; use transform_gram")
        Y = validate_data(self, Y, reset=False, dtype=np.float64)
        Y_c = Y - self._mean_Y
        cross = Y_c @ (self.Y_fit_ - self._mean_Y).T
        return self.transform_gram(cross, np.einsum("md,md->m", Y_c, Y_c))

    def transform_gram(self, cross: Array, norm: Array, *, criterion: str = "likelihood") -> Array:
        """Latents of new samples known by their products with the training samples, shape (M, Q).

        The training latents are kept; a training sample gets its own. See `manifold.models.criteria`: by `likelihood`,
        the error of the reconstruction is weighed against the posterior variance; `mapped` is where the
        *prediction* is nearest.

        Args:
            cross: products `Y_new Y^T` about the origin that `fit_gram` saw, shape (M, N).
            norm: squared norms of the new samples about the same origin, shape (M,).
            criterion: `likelihood` or `mapped`.
        Raises:
            ShapeError: cross is not (M, N), norm is not (M,), or either is not finite.
            UsageError: the criterion is unknown, or needs more than products.
        """
        check_is_fitted(self, "embedding_")
        products = Products(self.gram_, *self._centred_products(cross, norm))
        Q, prior = self.embedding_.shape[1], float(self.prior)
        encoder = Encoder(self.gp_, self.gram_, self.n_outputs_, Q, prior=prior, criterion=criterion)
        # At a training latent variance and residual are both 0, and the likelihood is unbounded.
        squared = products.distances
        nearest = squared.argmin(axis=1)
        same = squared.min(axis=1) <= _SAME * (products.norm + np.diag(self.gram_)[nearest])
        latents = self.embedding_[nearest]
        for m in np.flatnonzero(~same):
            latents[m] = encoder.encode_products(products.cross[[m]], products.norm[[m]])[0]
        return latents

    def inverse_transform(self, X: Array) -> Array:
        """Predicted data at latents X (M, Q), (M, D); a training latent gives its datum, bit for bit."""
        check_is_fitted(self, "embedding_")
        if self.Y_fit_ is None:
            raise UsageError("this model was fitted on a Gram matrix; multiply `weights(X)` by the data")
        return self.weights(X) @ self.Y_fit_

    def weights(self, X: Array) -> Array:
        """Weights of the training samples at latents X (M, Q), shape (M, N)."""
        check_is_fitted(self, "embedding_")
        return self.gp_.weights(X)

    def std(self, X: Array) -> Array:
        """Posterior standard deviation at latents X (M, Q), in units of the outputs, shape (M,)."""
        check_is_fitted(self, "embedding_")
        return np.sqrt(self.output_variance_ * self.gp_.variance(X))

    def _centred_products(self, cross: Array, norm: Array) -> tuple[Array, Array]:
        cross, norm = np.asarray(cross, dtype=np.float64), np.asarray(norm, dtype=np.float64)
        N = self.gram_.shape[0]
        if cross.ndim != 2 or cross.shape[1] != N or norm.shape != cross.shape[:1]:
            raise ShapeError(
                f"cross has shape {cross.shape} and norm {norm.shape}, expected (samples, {N}) and (samples,)"
            )
        if not (np.all(np.isfinite(cross)) and np.all(np.isfinite(norm))):
            raise ShapeError("cross or norm has non-finite values, expected finite products")
        mean_cross = cross.mean(axis=1)
        centred = cross - mean_cross[:, None] - self._gram_row_mean[None, :] + self._gram_mean
        return centred, np.maximum(norm - 2.0 * mean_cross + self._gram_mean, 0.0)


class LatentObjective:
    """F(X) and its gradient, by a fresh factorisation.

    Args:
        S: centred Gram matrix, shape (N, N).
        n_outputs: D.
        kernel: the covariance function.
        prior: weight of the Gaussian prior per output.
    """

    def __init__(self, S: Array, n_outputs: int, kernel: Kernel, prior: float = 0.0) -> None:
        self.S = np.ascontiguousarray(S)
        self.n_outputs = n_outputs
        self.kernel = kernel
        self.prior = prior

    def with_mu(self, mu: float) -> LatentObjective:
        """The same objective under another noise filter."""
        return LatentObjective(self.S, self.n_outputs, replace(self.kernel, mu=mu), self.prior)

    def __call__(self, X: Array) -> tuple[float, Array]:
        """F at X (N, Q) and its gradient (N, Q).

        `dF/dK = 1/2 K^-1 - N / (2 tr(K^-1 S)) K^-1 S K^-1`.

        Source: Lawrence 2005, eq. 6, with the output variance profiled out.
        """
        return self.with_noise(X)[:2]

    def with_noise(self, X: Array) -> tuple[float, Array, float]:
        """F at X (N, Q), its gradient (N, Q), and its derivative by mu, the trace of dF/dK."""
        N = self.S.shape[0]
        K, slope = self.kernel.training_and_slope(X)
        P, log_det = self.factorise(K)
        PS = P @ self.S
        trace = float(np.trace(PS))
        dK = 0.5 * P - (0.5 * N / trace) * (PS @ P)
        gradient = self.kernel.gradient(X, dK, slope) + self.prior * X
        return self.value_of(log_det, trace, float(np.sum(X**2))), gradient, float(np.trace(dK))

    def value_of(self, log_det: float, trace: float, squared_norm: float) -> float:
        """F of log|K|, tr(K^-1 S) and ||X||^2; inf where rounding made the trace negative."""
        N = self.S.shape[0]
        if not trace > 0.0:
            return float("inf")
        log_variance = np.log(trace / (N * self.n_outputs))
        return float(0.5 * log_det + 0.5 * N * log_variance + 0.5 * self.prior * squared_norm)

    def factorise(self, K: Array) -> tuple[Array, float]:
        """The inverse P of K (N, N), by Cholesky, and log|K|."""
        L, failed = dpotrf(K, lower=1)
        if failed:
            raise NumericalError(f"K is not positive definite (mu = {self.kernel.mu:.0e}); raise mu")
        log_det = 2.0 * float(np.sum(np.log(np.diag(L))))
        P, _ = dpotri(L, lower=1)
        P = np.tril(P)
        return np.ascontiguousarray(P + np.tril(P, -1).T), log_det


class IncrementalObjective:
    """F as a `MoveObjective`: a move of one coordinate of one latent costs O(N^2).

    Moving latent i changes row and column i of K, `K' = K + e_i d^T + d e_i^T`; `d_i` is half of what its
    diagonal changes by, which a linear term does. With
    `P = K^-1`, `p = P e_i`, `q = P d`, `a = p_i`, `b = q_i`, `c = d^T q` and `t = (1 + b)^2 - a c`,

        |K'| = t |K|,    P' = P + (c p p^T - (1 + b) (p q^T + q p^T) + a q q^T) / t.

    Every accepted move measures the error of P on the row it changed and on one more, and P is computed
    afresh when that exceeds 2e-9, and after 500 moves: log|K| and the trace gather rounding too.

    Args:
        objective: F.
        X: where to stand, shape (N, Q); copied.
    Attributes:
        n_refactorisations: how often P was computed afresh since the start, jumps not counted.
    Source: Woodbury; Hikichi & Iwasaki, section 3.4, for the search it serves.
    """

    def __init__(self, objective: LatentObjective, X: Array) -> None:
        self.objective = objective
        self.n_refactorisations = 0
        N, Q = X.shape
        self._Q = Q
        self._work = np.zeros((4, N))  # d, P d, S P d, S p
        kernel = objective.kernel
        self._kernel = kernel.family, 1.0 / kernel.length_scale**2, kernel.slope_of_linear
        self.move_to(np.ascontiguousarray(X, dtype=np.float64).reshape(-1))

    @property
    def x(self) -> Array:
        """The latents as one vector, row by row, shape (N Q,). A view: do not write to it."""
        return self._flat

    def move_to(self, x: Array) -> float:
        """Stand at x (N Q,), by a fresh factorisation."""
        self._X = np.array(x, dtype=np.float64).reshape(-1, self._Q)
        self._flat = self._X.reshape(-1)
        self._factorise()
        self.n_commits = 0
        return self.value

    def _factorise(self) -> None:
        self._K = self.objective.kernel.training(self._X)
        self._P, self._log_det = self.objective.factorise(self._K)
        self._trace = float(np.sum(self._P * self.objective.S))
        self._squared_norm = float(np.sum(self._X**2))
        self.value = self.objective.value_of(self._log_det, self._trace, self._squared_norm)
        self._cached = -1  # the latent whose S p lies in the work space

    def try_move(self, index: int, delta: float) -> float:
        """F with coordinate `index` of `x` moved by delta, pending."""
        i, q = divmod(index, self._Q)
        t, a, b, c, change = _price(
            self._X,
            self._K,
            self._P,
            self.objective.S,
            self._work,
            i,
            q,
            delta,
            self._kernel,
            self._cached,
        )
        self._cached = i
        squared_norm = self._squared_norm + delta * (2.0 * self._flat[index] + delta)
        if not t > 0.0:  # rounding: no real move makes K indefinite
            value = float("inf")
            log_det = trace = float("nan")
        else:
            log_det, trace = self._log_det + np.log(t), self._trace + change
            value = self.objective.value_of(log_det, trace, squared_norm)
        self._pending = (i, q, delta, t, a, b, c, log_det, trace, squared_norm, value)
        return value

    def commit(self) -> None:
        """Make the pending move."""
        i, q, delta, t, a, b, c, *state = self._pending
        self._log_det, self._trace, self._squared_norm, self.value = state
        self.n_commits += 1
        other = self.n_commits % self._X.shape[0]
        self._X[i, q] += delta
        drift = _commit(self._K, self._P, self._work, i, t, a, b, c, other)
        self._cached = -1
        if not drift < _DRIFT or self.n_commits % _RENEWED == 0:
            self.n_refactorisations += 1
            self._factorise()

    def reject(self) -> None:
        """Drop the pending move."""


@nb.njit(cache=True)
def _price(X, K, P, S, work, i, q, delta, kernel, cached):
    """A rank-two update of K, latent i moved by delta along axis q: t, a, b, c and the change of the trace.

    Leaves d, P d and S P d in `work`, and S P e_i, which moves of the same latent share.
    """
    N, Q = X.shape
    family, inverse_l2, slope = kernel
    d, Pd, SPd, Sp = work[0], work[1], work[2], work[3]
    for j in range(N):
        squared, product = 0.0, 0.0
        for k in range(Q):
            moved = X[i, k] + delta if k == q else X[i, k]
            squared += (moved - X[j, k]) ** 2
            product += moved * X[j, k]
        d[j] = radial_of_pair(family, squared * inverse_l2) + slope * product - K[i, j]
        Pd[j] = 0.0
        SPd[j] = 0.0
    d[i] = slope * delta * (X[i, q] + 0.5 * delta)
    for j in range(N):  # symmetric: rows serve as columns, and the inner loop runs along memory
        w = d[j]
        for k in range(N):
            Pd[k] += w * P[j, k]
    for j in range(N):
        w = Pd[j]
        for k in range(N):
            SPd[k] += w * S[j, k]
    if cached != i:
        Sp[:] = 0.0
        for j in range(N):
            w = P[i, j]
            for k in range(N):
                Sp[k] += w * S[j, k]
    a, b, c = P[i, i], Pd[i], 0.0
    pSp, pSq, qSq = 0.0, 0.0, 0.0
    for j in range(N):
        c += d[j] * Pd[j]
        pSp += P[i, j] * Sp[j]
        pSq += Pd[j] * Sp[j]
        qSq += Pd[j] * SPd[j]
    t = (1.0 + b) * (1.0 + b) - a * c
    change = (c * pSp - 2.0 * (1.0 + b) * pSq + a * qSq) / t
    return t, a, b, c, change


@nb.njit(cache=True)
def _commit(K, P, work, i, t, a, b, c, other):
    """Update K and P in place; the largest entry of rows i and `other` of K P - I, a measure of P's error."""
    N = K.shape[0]
    d, Pd, p = work[0], work[1], work[2]
    for j in range(N):
        p[j] = P[i, j]
    for j in range(N):
        along_p = (c * p[j] - (1.0 + b) * Pd[j]) / t
        along_q = (a * Pd[j] - (1.0 + b) * p[j]) / t
        for k in range(N):
            P[j, k] += along_p * p[k] + along_q * Pd[k]
        K[i, j] += d[j] if j != i else 2.0 * d[i]
        K[j, i] = K[i, j]
    drift = 0.0
    for row in (i, other):
        residual = work[3]
        residual[:] = 0.0
        residual[row] = -1.0
        for j in range(N):
            w = K[row, j]
            for k in range(N):
                residual[k] += w * P[j, k]
        for k in range(N):
            if not abs(residual[k]) <= drift:  # NaN counts as drift
                drift = abs(residual[k])
    return drift


class _Run:
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

    def report(self, X: Array, value: float) -> None:
        """Count a round that stands at X (N, Q)."""
        self.n_iter += 1
        if value < self.best:
            self.best_X, self.best = X.reshape(self.best_X.shape).copy(), value
        if self.callback is not None:
            self.callback(self.n_iter, self.best)


def _starts(start: Array, count: int, random: np.random.RandomState) -> list[Array]:
    """`count` starts (N, Q): the given one, it at half the scale, then random perturbations of it."""
    scale = _PERTURBATION * start.std(axis=0)
    noisy = [start + scale * random.normal(size=start.shape) for _ in range(count - 2)]
    return [start, 0.5 * start, *noisy][:count]


def _search(
    run: _Run,
    X: Array,
    *,
    rounds: int | None = None,
    mu: float | None = None,
    first_step: float = _FIRST_STEP,
) -> Array:
    """Direct local search from X (N, Q); under another mu nothing is reported: its values are others."""
    objective = run.objective if mu is None else run.objective.with_mu(mu)
    l = objective.kernel.length_scale
    result = direct_local_search(
        IncrementalObjective(objective, X),
        initial_step=first_step * l,
        largest_step=_LARGEST_STEP * l,
        tolerance=10.0 * run.tol * l,
        f_tolerance=run.tol,
        individual_steps=True,
        maxfev=np.iinfo(np.int64).max,
        max_sweeps=run.max_iter if rounds is None else min(rounds, run.max_iter),
        callback=run.report if mu is None else None,
    )
    run.n_evaluations += result.nfev
    if result.status == STOPPED:
        raise StopIteration
    return result.x.reshape(X.shape)


def _descend(
    run: _Run, X: Array, *, limit: int | None = None, tol: float | None = None
) -> tuple[Array, float]:
    """L-BFGS from X (N, Q): latents and their value."""
    objective = run.objective

    def flat(x: Array) -> tuple[float, Array]:
        value, gradient = objective(x.reshape(X.shape))
        return value, gradient.reshape(-1)

    def report(intermediate_result: Any) -> None:
        run.report(intermediate_result.x, float(intermediate_result.fun))

    # One of its iterations costs a hundredth of a round of the search and gains less: a tighter tolerance.
    limit = 10 * run.max_iter if limit is None else min(limit, 10 * run.max_iter)
    tol = run.tol if tol is None else max(tol, run.tol)
    options = {"maxiter": limit, "maxfun": 10 * limit, "ftol": 1e-2 * tol, "gtol": tol, "maxcor": 20}
    result = minimize(flat, X.reshape(-1), jac=True, method="L-BFGS-B", callback=report, options=options)
    run.n_evaluations += int(result.nfev)
    if result.status == STOPPED:
        raise StopIteration
    return result.x.reshape(X.shape), float(result.fun)


def _refine_dls(run: _Run, start: Array) -> Array:
    """Two direct local searches from the start, polished, and the descent alone; the best, improved by relocations.

    With the descent among them the end is never worse than that of `l-bfgs`.
    """
    ends = [_descend(run, _search(run, start, rounds=_SEARCH_ROUNDS)), _descend(run, start)]
    if run.objective.kernel.mu < _WIDE_MU:
        smoothed = _search(run, start, rounds=_SEARCH_ROUNDS, mu=_WIDE_MU)
        ends.append(_descend(run, _search(run, smoothed, rounds=_SEARCH_ROUNDS)))
    X, value = min(ends, key=lambda end: end[1])
    for _ in range(min(_RELOCATIONS, run.max_iter)):
        moved = _relocate(X, run.objective.kernel.length_scale, run.random)
        end, end_value = _descend(run, moved, limit=_RELOCATION_ITERATIONS, tol=_RELOCATION_TOLERANCE)
        if end_value < value:
            X, value = end, end_value
    return _descend(run, X)[0]


def _relocate(X: Array, length_scale: float, random: np.random.RandomState) -> Array:
    """Latents (N, Q) with a random quarter of them, at least two, moved next to random others."""
    N, Q = X.shape
    moved = random.choice(N, max(2, int(_RELOCATED * N)), replace=False)
    beside = X[random.choice(N, len(moved))]
    out = X.copy()
    out[moved] = beside + _RELOCATION_SPREAD * length_scale * random.normal(size=(len(moved), Q))
    return out


def _refine_lbfgs(run: _Run, start: Array) -> Array:
    return _descend(run, start)[0]


# From the start, small steps keep the order of the latents; at an optimum, only long ones can leave it.
_STAGES: dict[str, list[Callable[[_Run, Array], Array]]] = {
    "dls": [_refine_dls],
    "l-bfgs": [_refine_lbfgs],
    "both": [_refine_lbfgs, partial(_search, first_step=_LARGEST_STEP)],
}


def pca_start(S: Array, n_components: int) -> Array:
    """Principal components of a centred Gram matrix S (N, N), each of unit variance, shape (N, Q).

    Axes the data do not span are 0. Each axis has its longer tail positive.
    """
    N = S.shape[0]
    Q = min(n_components, N)
    values, vectors = eigh(S, subset_by_index=[N - Q, N - 1])
    X = np.zeros((N, n_components))
    X[:, :Q] = vectors[:, ::-1] * np.sqrt(N)
    X[:, :Q][:, values[::-1] <= N * np.finfo(float).eps * max(values[-1], 0.0)] = 0.0
    return fix_gauge(X)


def fix_gauge(X: Array, *, centre: bool = True) -> Array:
    """Latents (N, Q) centred, if asked for, each axis with its longer tail positive.

    The likelihood is blind to both, unless the kernel has an origin: such latents must not be shifted. The tail is
    told by the sum of cubes: a sum over all latents keeps its sign where the largest of them would change with the
    last digit; that decides where an axis is as good as symmetric.
    """
    X = X - X.mean(axis=0) if centre else X
    tail = np.sum(X**3, axis=0)
    largest = X[np.abs(X).argmax(axis=0), np.arange(X.shape[1])]
    is_symmetric = np.abs(tail) <= _SYMMETRIC * np.sum(np.abs(X) ** 3, axis=0)
    return X * np.where(np.where(is_symmetric, largest, tail) < 0, -1.0, 1.0)


def blas_threads(N: int) -> AbstractContextManager[Any]:
    """One BLAS thread for small matrices."""
    return one_blas_thread if N <= 500 else nullcontext()


def _require_start(X0: Array, N: int, Q: int) -> Array:
    X0 = np.array(X0, dtype=np.float64)
    if X0.shape != (N, Q) or not np.all(np.isfinite(X0)):
        raise ShapeError(f"latents have shape {X0.shape}, expected ({N}, {Q}) finite values")
    return X0


def require_different(centred: Array, power: float) -> None:
    """Raise ShapeError where samples are all alike but for rounding, by the trace of their centred Gram matrix (N, N).

    `power` is the trace of the uncentred one.
    """
    if not np.trace(centred) > len(centred) * np.finfo(np.float64).eps * power:
        raise ShapeError(f"all {len(centred)} samples are identical, expected at least two different ones")


def require_prior(prior: float) -> None:
    """Raise UsageError unless a weight of the prior can be used."""
    if not 0 <= prior < np.inf:
        raise UsageError(f"prior = {prior}, expected a finite weight >= 0")


def require_gram(S: Array, n_outputs: int) -> Array:
    """A Gram matrix as float64 (N, N).

    Raises:
        ShapeError: S is not square, symmetric and finite, N is below 2, or n_outputs below 1.
    """
    S = np.asarray(S, dtype=np.float64)
    if S.ndim != 2 or S.shape[0] != S.shape[1] or S.shape[0] < 2:
        raise ShapeError(f"S has shape {S.shape}, expected (N, N) with N at least 2")
    if not np.all(np.isfinite(S)):
        raise ShapeError("S has non-finite values, expected the Gram matrix of finite data")
    if np.abs(S - S.T).max() > 1e-8 * np.abs(S).max():
        raise ShapeError("S is not symmetric, expected a Gram matrix Y Y^T")
    if n_outputs < 1:
        raise ShapeError(f"n_outputs = {n_outputs}, expected at least 1")
    return S
