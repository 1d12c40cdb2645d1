"""A variational bound on the likelihood of latents, at a cost linear in their number.

M inducing points Z stand in for the N latents. With `Q = K_fu K_uu^-1 K_uf`, the variational bound on the
likelihood of `GPLVM`, per output, sign reversed and output variance s^2 profiled out, is

    F(X, Z) = 1/2 log|Q + mu I| + N/2 log s^2 + tr(K - Q) / (2 mu) + prior/2 ||X||^2,
    s^2 = tr((Q + mu I)^-1 Y Y^T) / (N D),

with K the covariance without its delta. It is never below the exact objective, and meets it where the inducing
points are the latents. It sees the data through `Y Y^T` only, so any factor of the Gram matrix serves as Y (N, r). An
evaluation costs O(N M^2 + N M r) operations and O(N (M + r)) memory; nothing of size N x N is formed.

Source: Titsias 2009, eq. 9; Lawrence 2007 for its use with latents.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.linalg import cho_solve, solve_triangular
from scipy.linalg.lapack import dpotrf
from scipy.optimize import minimize
from sklearn.utils.extmath import randomized_svd

from manifold.errors import NumericalError
from manifold.latent.kernels import Kernel
from manifold.latent.objective import fix_gauge
from manifold.latent.search import FitCallback
from manifold.records import Array, Indices

_JITTER = 1e-5  # added to the diagonal of K_uu, in units of mu: negligible beside the noise filter
_EXACT_SVD = 500  # sides of Y up to this are decomposed exactly


class SparseObjective:
    """F(X, Z) and its gradients.

    Args:
        Y: centred data, or any factor of their centred Gram matrix, shape (N, r).
        n_outputs: D.
        kernel: the covariance function.
        prior: weight of the Gaussian prior per output.
    """

    def __init__(self, Y: Array, n_outputs: int, kernel: Kernel, prior: float = 0.0) -> None:
        self.Y = np.ascontiguousarray(Y, dtype=np.float64)
        self.n_outputs = n_outputs
        self.kernel = kernel
        self.prior = prior

    def __call__(self, X: Array, Z: Array) -> tuple[float, Array, Array]:
        """F at latents X (N, Q) and inducing points Z (M, Q), dF/dX (N, Q) and dF/dZ (M, Q).

        Raises:
            NumericalError: K_uu is not positive definite.
        """
        N, M, kernel, mu = X.shape[0], Z.shape[0], self.kernel, self.kernel.mu
        p = SparsePosterior(self, X, Z)
        log_det = 2.0 * float(np.sum(np.log(np.diag(p.L_B)))) + (N - M) * np.log(mu)
        unexplained = float(np.sum(kernel.prior_variance(X) - mu)) - float(np.sum(p.V**2))  # tr(K - Q)
        F = 0.5 * log_det + 0.5 * N * np.log(p.fit / (N * self.n_outputs)) + 0.5 * unexplained / mu
        F += 0.5 * self.prior * float(np.sum(X**2))

        # With A = mu K_uu + K_uf K_fu: |Q + mu I| = mu^(N-M) |A| / |K_uu|, and s^2 follows from W = A^-1 K_uf Y.
        scale = 0.5 * N / p.fit
        A_uf = p.solve_A(p.K_uf)  # [M, N]
        U_uf = solve_triangular(p.L_u, p.V, lower=True, trans=1)  # K_uu^-1 K_uf, [M, N]
        residual = self.Y - p.K_uf.T @ p.W  # [N, r]
        d_uf = A_uf - (2.0 * scale / mu) * (p.W @ residual.T) - U_uf / mu
        eye = np.eye(M)
        d_uu = 0.5 * (mu * p.solve_A(eye) - cho_solve((p.L_u, True), eye))
        d_uu += scale * (p.W @ p.W.T) + (0.5 / mu) * (U_uf @ U_uf.T)

        dX = kernel.pull_back(X, Z, d_uf.T, p.slope_uf.T) + self.prior * X
        dX += kernel.pull_back_variance(X, 0.5 / mu)
        dZ = kernel.pull_back(Z, X, d_uf, p.slope_uf) + kernel.gradient(Z, d_uu)
        return float(F), dX, dZ


class SparsePosterior:
    """The factorisations at latents X (N, Q) and inducing points Z (M, Q) that F and predictions share.

    Attributes:
        K_uu, K_uf: covariances of the inducing points (M, M), with the latents (M, N).
        slope_uf: slope of K_uf as `Kernel.pull_back` takes it, shape (M, N).
        L_u, L_B: lower Cholesky factors of K_uu and of `mu I + V V^T`, shape (M, M).
        V: `L_u^-1 K_uf`, shape (M, N).
        W: weights of the inducing points per column of Y, shape (M, r).
        fit: `tr((Q + mu I)^-1 Y Y^T)`.
    """

    def __init__(self, objective: SparseObjective, X: Array, Z: Array) -> None:
        self.kernel, mu, Y = objective.kernel, objective.kernel.mu, objective.Y
        self.Z = Z
        self.K_uu = self.kernel.smooth(Z, Z)
        self.K_uf, self.slope_uf = self.kernel.smooth_and_slope(Z, X)
        self.L_u = _cholesky(self.K_uu + _JITTER * mu * np.eye(Z.shape[0]), mu)
        self.V = solve_triangular(self.L_u, self.K_uf, lower=True)
        self.L_B = _cholesky(self.V @ self.V.T + mu * np.eye(Z.shape[0]), mu)
        half = solve_triangular(self.L_B, self.V @ Y, lower=True)  # [M, r]
        self.W = solve_triangular(
            self.L_u, solve_triangular(self.L_B, half, lower=True, trans=1), lower=True, trans=1
        )
        # The plain difference ||Y||^2 - ||half||^2 cancels; the residual's own norm does not.
        residual = Y - self.K_uf.T @ self.W
        self.fit = max(float(np.sum(residual * Y)), np.finfo(float).tiny) / mu

    def solve_A(self, B: Array) -> Array:
        """`(mu K_uu + K_uf K_fu)^-1 B`, shape of B (M, ...)."""
        half = cho_solve((self.L_B, True), solve_triangular(self.L_u, B, lower=True))
        return solve_triangular(self.L_u, half, lower=True, trans=1)

    def variance(self, X_new: Array) -> Array:
        """Posterior variance at X_new (M', Q) in units of s^2, the delta included, shape (M',)."""
        half = solve_triangular(self.L_u, self.kernel.smooth(self.Z, X_new), lower=True)  # [M, M']
        whole = solve_triangular(self.L_B, half, lower=True)
        mu = self.kernel.mu
        prior = self.kernel.prior_variance(X_new)
        return np.maximum(prior - np.sum(half**2, axis=0) + mu * np.sum(whole**2, axis=0), mu)


def minimise(
    objective: Callable[[Array, Array], tuple[float, Array, Array]],
    X: Array,
    Z: Array,
    *,
    move_inducing: bool = True,
    max_iter: int = 300,
    tol: float = 1e-6,
    callback: FitCallback | None = None,
) -> tuple[Array, Array, int, int]:
    """Minimise F over latents and inducing points by L-BFGS.

    Args:
        objective: (X, Z) to (F, dF/dX, dF/dZ), as `SparseObjective`.
        X: latents, shape (N, Q): where the search starts.
        Z: inducing points, shape (M, Q).
        move_inducing: whether Z is minimised over too.
        max_iter, tol: limit on iterations; relative gain below which it ends.
        callback: `callback(iteration, F)`; StopIteration ends the search with the best so far.
    Returns:
        X, Z, iterations and evaluations.
    """
    split, rounds = X.size, 0

    def unpack(z: Array) -> tuple[Array, Array]:
        return z[:split].reshape(X.shape), z[split:].reshape(Z.shape) if move_inducing else Z

    def flat(z: Array) -> tuple[float, Array]:
        F, dX, dZ = objective(*unpack(z))
        return F, np.concatenate([dX.reshape(-1), *([dZ.reshape(-1)] if move_inducing else [])])

    def report(intermediate_result: Any) -> None:
        nonlocal rounds
        rounds += 1
        if callback is not None:
            callback(rounds, float(intermediate_result.fun))

    start = np.concatenate([X.reshape(-1), *([Z.reshape(-1)] if move_inducing else [])])
    options = {"maxiter": max_iter, "maxfun": 10 * max_iter, "ftol": tol, "gtol": tol, "maxcor": 20}
    found = minimize(flat, start, jac=True, method="L-BFGS-B", callback=report, options=options)
    return (*unpack(found.x), max(rounds, 1), int(found.nfev))


def pca_start_of_factor(Y: Array, n_components: int) -> Array:
    """Principal components of centred data Y (N, r), each of unit variance, shape (N, Q), in a fixed gauge.

    Axes the data do not span are 0. Nothing of size N x N is formed.
    """
    N, Q = Y.shape[0], min(n_components, *Y.shape)
    if min(Y.shape) <= _EXACT_SVD:
        U, singular, _ = np.linalg.svd(Y, full_matrices=False)
    else:
        U, singular, _ = randomized_svd(Y, Q, random_state=0)
    X = np.zeros((N, n_components))
    spanned = int(np.count_nonzero(singular[:Q] > N * np.finfo(float).eps * singular[0]))
    X[:, :spanned] = U[:, :spanned] * np.sqrt(N)
    return fix_gauge(X)


def farthest_points(X: Array, count: int) -> Indices:
    """Indices of `count` rows of X (N, Q), each the farthest from those before it, shape (count,).

    The first is the farthest from the mean. Source: Gonzalez 1985.
    """
    chosen = np.empty(count, dtype=np.intp)
    distance = np.sum((X - X.mean(axis=0)) ** 2, axis=1)
    for c in range(count):
        chosen[c] = distance.argmax()
        squared = np.sum((X - X[chosen[c]]) ** 2, axis=1)
        distance = squared if c == 0 else np.minimum(distance, squared)
        distance[chosen[: c + 1]] = -1.0
    return chosen


def _cholesky(K: Array, mu: float) -> Array:
    L, failed = dpotrf(K, lower=1)
    if failed:
        raise NumericalError(
            f"K_uu ({K.shape[0]} inducing points) is not positive definite at mu = {mu:.0e}; raise mu"
        )
    return np.tril(L)
