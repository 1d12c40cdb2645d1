"""The likelihood of latents from the data's Gram matrix, updated in O(N^2) after a move of one coordinate."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np
import scipy

from manifold.core.compiled import loops
from manifold.core.defaults import ROUNDING
from manifold.core.errors import NumericalError, ShapeError, UsageError
from manifold.core.records import Array
from manifold.core.threads import one_blas_thread
from manifold.gp.kernels import Kernel


class LatentObjective:
    """The negative log likelihood of latents per output, F(X), without constants, and its gradient.

    `F = 1/2 log|K| + N/2 log s^2 + tr(K^-1 S) / (2 D s^2) - N/2 + prior/2 ||X||^2`. S (N, N) is the centred Gram
    matrix of D outputs, and `prior` the weight of the prior per output. If the output variance is None, s^2 maximises
    the likelihood, `s^2 = tr(K^-1 S) / (N D)`, and the third and fourth terms cancel.

    Source: Lawrence 2005; Hikichi & Iwasaki, eq. 21, where s^2 = 1, divided by -D.
    """

    def __init__(
        self,
        S: Array,
        n_outputs: int,
        kernel: Kernel,
        prior: float = 0.0,
        output_variance: float | None = None,
    ) -> None:
        self.S = np.ascontiguousarray(S)
        self.n_outputs = n_outputs
        self.kernel = kernel
        self.prior = prior
        self.output_variance = output_variance

    def __call__(self, X: Array) -> tuple[float, Array]:
        """Return F at X (N, Q) and its gradient (N, Q).

        `dF/dK = 1/2 K^-1 - 1 / (2 D s^2) K^-1 S K^-1`.

        Source: Lawrence 2005, eq. 6.
        """
        return self.with_noise(X)[:2]

    def value(self, X: Array) -> float:
        """Return F at X (N, Q)."""
        P, log_det = self.factorise(self.kernel.training(X))
        return self.value_of(log_det, float(np.sum(P * self.S)), float(np.sum(X**2)))

    def with_noise(self, X: Array) -> tuple[float, Array, float]:
        """Return F at X (N, Q), its gradient (N, Q), and its derivative with respect to mu, the trace of dF/dK."""
        N = self.S.shape[0]
        K, slope = self.kernel.training_and_slope(X)
        P, log_det = self.factorise(K)
        PS = P @ self.S
        trace = float(np.trace(PS))
        variance = (
            trace / N if self.output_variance is None else self.n_outputs * self.output_variance
        )  # D s^2
        dK = 0.5 * P - (0.5 / variance) * (PS @ P)
        gradient = self.kernel.gradient(X, dK, slope) + self.prior * X
        return self.value_of(log_det, trace, float(np.sum(X**2))), gradient, float(np.trace(dK))

    def value_of(self, log_det: float, trace: float, squared_norm: float) -> float:
        """Return F from log|K|, tr(K^-1 S) and ||X||^2; inf if rounding made the trace negative."""
        N = self.S.shape[0]
        if not trace > 0.0:
            return float("inf")
        variance = trace / (N * self.n_outputs)
        misfit = 0.0
        if self.output_variance is not None:
            misfit = 0.5 * N * (variance / self.output_variance - 1.0)
            variance = self.output_variance
        return float(0.5 * log_det + 0.5 * N * np.log(variance) + misfit + 0.5 * self.prior * squared_norm)

    def factorise(self, K: Array) -> tuple[Array, float]:
        """Return the inverse of K (N, N), from its Cholesky factor, and log|K|."""
        L, failed = scipy.linalg.lapack.dpotrf(K, lower=1)
        if failed:
            raise NumericalError(f"K is not positive definite (mu = {self.kernel.mu:.0e}); raise mu")
        log_det = 2.0 * float(np.sum(np.log(np.diag(L))))
        P, _ = scipy.linalg.lapack.dpotri(L, lower=1)  # its other half is 0
        inverse = np.ascontiguousarray(P + P.T)
        inverse.flat[:: len(K) + 1] *= 0.5
        return inverse, log_det


def pca_start(S: Array, n_components: int) -> Array:
    """Return the principal components of a centred Gram matrix S (N, N), each of unit variance, shape (N, Q).

    Axes the data do not span are 0. Each axis has its longer tail positive.
    """
    N = S.shape[0]
    Q = min(n_components, N)
    values, vectors = scipy.linalg.eigh(S, subset_by_index=[N - Q, N - 1])
    X = np.zeros((N, n_components))
    X[:, :Q] = vectors[:, ::-1] * np.sqrt(N)
    X[:, :Q][:, values[::-1] <= N * np.finfo(float).eps * max(values[-1], 0.0)] = 0.0
    return fix_gauge(X)


def fix_gauge(X: Array) -> Array:
    """Centre latents (N, Q), and orient each axis so that its longer tail is positive.

    The likelihood depends on neither. The sum of cubes of a coordinate determines its longer tail, robustly against
    rounding; on a symmetric axis, the sign of the first latent of the largest magnitude does.
    """
    X = X - X.mean(axis=0)
    tail = np.sum(X**3, axis=0)
    is_largest = np.abs(X) >= (1.0 - ROUNDING) * np.abs(X).max(axis=0)
    largest = X[is_largest.argmax(axis=0), np.arange(X.shape[1])]
    is_symmetric = np.abs(tail) <= ROUNDING * np.sum(np.abs(X) ** 3, axis=0)
    return X * np.where(np.where(is_symmetric, largest, tail) < 0, -1.0, 1.0)


def centre_gram(S: Array) -> Array:
    """Return `H S H` with `H = I - 1 1^T / N`: the Gram matrix of the outputs less their mean, shape (N, N)."""
    row = S.mean(axis=1)
    centred = S - row[:, None] - row[None, :] + row.mean()
    return 0.5 * (centred + centred.T)


def blas_threads(N: int) -> AbstractContextManager[Any]:
    """Limit BLAS to one thread for small matrices."""
    return one_blas_thread if N <= 500 else nullcontext()


def require_start(X0: Array, N: int, Q: int) -> Array:
    """Return a copy of latents as float64 (N, Q), or raise ShapeError."""
    X0 = np.array(X0, dtype=np.float64)
    if X0.shape != (N, Q) or not np.all(np.isfinite(X0)):
        raise ShapeError(f"latents have shape {X0.shape}, expected ({N}, {Q}) finite values")
    return X0


def require_different(centred: Array, power: float) -> None:
    """Raise ShapeError if all samples are equal up to rounding, from the trace of their centred Gram matrix (N, N).

    `power` is the trace of the uncentred Gram matrix.
    """
    if not np.trace(centred) > len(centred) * np.finfo(np.float64).eps * power:
        raise ShapeError(f"all {len(centred)} samples are identical, expected at least two different ones")


def require_prior(prior: float) -> None:
    """Raise UsageError unless a weight of the prior can be used."""
    if not 0 <= prior < np.inf:
        raise UsageError(f"prior = {prior}, expected a finite weight >= 0")


def require_gram(S: Array, n_outputs: int) -> Array:
    """Return a Gram matrix as float64 (N, N), after checking it."""
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


_LARGEST_DRIFT = 2e-9  # entry of K P - I tolerated before P is computed afresh
# Accepted before P is computed afresh in any case: log|K| and the trace accumulate rounding too.
_MOST_MOVES = 500
_VALUE = 3  # its place in the state


_Arguments = tuple[Array, Array, Array, Array, Array, Array, int, float, int, float, float, int]


class IncrementalObjective:
    """F as a `MoveObjective` that starts from a copy of X (N, Q): a move of one coordinate of one latent costs O(N^2).

    Moving latent i changes row and column i of K, `K' = K + e_i d^T + d e_i^T` with `d_i = 0`. With `P = K^-1`,
    `p = P e_i`, `q = P d`, `a = p_i`, `b = q_i`, `c = d^T q` and `t = (1 + b)^2 - a c`,

        |K'| = t |K|,    P' = P + (c p p^T - (1 + b) (p q^T + q p^T) + a q q^T) / t.

    After every move the error of P is measured on the changed row and on another one. P is recomputed if the error
    exceeds 2e-9, and after 500 moves; `n_refactorisations` counts this, without calls of `move_to`.

    Source: Woodbury; Hikichi & Iwasaki, section 3.4, for the search it serves.
    """

    def __init__(self, objective: LatentObjective, X: Array) -> None:
        self.objective = objective
        self.n_refactorisations = 0
        N, self._Q = X.shape
        self._work = np.zeros((4, N))  # d, P d, S P d, S p
        self._state = np.zeros(5)  # log|K|, tr(P S), ||X||^2, F, moves since P was computed
        self._numbers = (
            *objective.kernel.numbers, objective.n_outputs, objective.prior, _LARGEST_DRIFT, _MOST_MOVES
        )  # fmt: skip
        self.move_to(X)

    @property
    def x(self) -> Array:
        """The latents as one vector, row by row, shape (N Q,). A view: do not write to it."""
        return self._X.reshape(-1)

    @property
    def value(self) -> float:
        """F at the current point."""
        return float(self._state[_VALUE])

    def move_to(self, x: Array) -> None:
        """Make x (N Q,) the current point, and factorise K again."""
        self._X = np.array(x, dtype=np.float64).reshape(-1, self._Q)
        self._factorise()

    def _factorise(self) -> None:
        self._K = self.objective.kernel.training(self._X)
        self._P, log_det = self.objective.factorise(self._K)
        trace = float(np.sum(self._P * self.objective.S))
        squared_norm = float(np.sum(self._X**2))
        value = self.objective.value_of(log_det, trace, squared_norm)
        self._state[:] = log_det, trace, squared_norm, value, 0

    def explore(self, steps: Array, heading: Array, limits: tuple[Array, Array], budget: int) -> int:
        """Move each coordinate by plus and minus its step and keep each improvement at once; see `MoveObjective`."""
        index = tried = 0
        while index < steps.shape[0] and tried < budget:
            index, more, has_drifted = loops.explore(
                *self._arguments, steps, heading, *limits, index, budget - tried
            )
            tried += more
            if has_drifted:
                self.n_refactorisations += 1
                self._factorise()
        return tried

    @property
    def _arguments(self) -> _Arguments:
        return (self._X, self._K, self._P, self.objective.S, self._work, self._state, *self._numbers)
