"""A sparse latent variable model: thousands of materials at a cost linear in their number."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import minimize
from sklearn.base import BaseEstimator, ClassNamePrefixFeaturesOutMixin, TransformerMixin
from sklearn.utils import check_array
from sklearn.utils.validation import check_is_fitted, validate_data

from manifold.errors import ShapeError, UsageError
from manifold.latent.kernels import Kernel, kernel_named
from manifold.latent.objective import fix_gauge, require_start
from manifold.latent.search import FitCallback
from manifold.latent.sparse_objective import (
    SparseObjective,
    SparsePosterior,
    farthest_points,
    minimise,
    pca_start_of_factor,
)
from manifold.records import Array

_SMALLEST_MU = 1e-6  # below, the jitter no longer holds K_uu definite
_SAME = 1e-12  # squared distance, relative to the squared norms, under which data count as a training sample


class SparseGPLVM(ClassNamePrefixFeaturesOutMixin, TransformerMixin, BaseEstimator):
    """`GPLVM` for thousands of samples: a variational bound with inducing points, by L-BFGS.

    Inducing points start as a farthest-point subset of the starting latents and are optimised with the latents.
    Unlike `GPLVM`, predictions are smooth everywhere: at a training latent they come close to the datum.

    Args:
        n_components: Q, the number of latent dimensions.
        n_inducing: M, the number of inducing points; N where that is fewer.
        mu: noise filter of the kernel, at least 1e-6.
        length_scale: l > 0.
        kernel: its name, or a class of your own, see `kernel_named`.
        prior: weight of the Gaussian prior on the latents per output.
        start_scale: standard deviation of the start along every axis.
        move_inducing: whether the inducing points are optimised; else they stay a subset of the start.
        max_iter: limit on iterations of L-BFGS; 0 keeps the start.
        tol: relative gain of an iteration below which it ends.

    Attributes:
        embedding_: latents X, shape (N, Q), centred, each axis with its longer tail positive.
        inducing_: inducing points Z, shape (M, Q).
        objective_, objective_start_: the bound F at the end and at the start.
        n_iter_, n_evaluations_: iterations, and evaluations of F.
        output_variance_: s^2, in squared units of the outputs.
        n_outputs_: D.
        Y_fit_: the centred data or factor, shape (N, r).
        mean_: what was subtracted from them, shape (r,).

    Source: Titsias 2009; Lawrence 2007.
    """

    def __init__(
        self,
        n_components: int = 2,
        *,
        n_inducing: int = 50,
        mu: float = 1e-4,
        length_scale: float = 1.0,
        kernel: str | type[Kernel] = "se",
        prior: float = 0.0,
        start_scale: float = 1.0,
        move_inducing: bool = True,
        max_iter: int = 300,
        tol: float = 1e-6,
    ) -> None:
        self.n_components = n_components
        self.n_inducing = n_inducing
        self.mu = mu
        self.length_scale = length_scale
        self.kernel = kernel
        self.prior = prior
        self.start_scale = start_scale
        self.move_inducing = move_inducing
        self.max_iter = max_iter
        self.tol = tol

    # -- fitting -------------------------------------------------------------------------------------------

    def fit(self, Y: Array, y: Any = None, *, callback: FitCallback | None = None) -> SparseGPLVM:
        """Fit to data Y (N, D), centred here; y is ignored. `callback(iteration, F)` may raise StopIteration."""
        Y = validate_data(self, Y, dtype=np.float64, ensure_min_samples=2)
        return self._fit(Y, Y.shape[1], None, callback)

    def fit_factor(
        self, Y: Array, n_outputs: int, *, X0: Array | None = None, callback: FitCallback | None = None
    ) -> SparseGPLVM:
        """Fit to a factor Y (N, r) of the Gram matrix `S = Y Y^T` of D outputs, centred here.

        Args:
            Y: shape (N, r), N at least 2; what `transform` takes and `inverse_transform` returns then.
            n_outputs: D.
            X0: start, shape (N, Q), in place of principal components.
            callback: as for `fit`.
        """
        Y = validate_data(self, Y, dtype=np.float64, ensure_min_samples=2)
        if n_outputs < 1:
            raise ShapeError(f"n_outputs = {n_outputs}, expected at least 1")
        return self._fit(Y, n_outputs, X0, callback)

    def fit_transform(self, Y: Array, y: Any = None, **fit_params: Any) -> Array:
        """Fit to Y (N, D) and return its latents (N, Q)."""
        return self.fit(Y, y, **fit_params).embedding_.copy()

    def _fit(self, Y: Array, n_outputs: int, X0: Array | None, callback: FitCallback | None) -> SparseGPLVM:
        self._require_parameters()
        self.mean_ = Y.mean(axis=0)
        Y = Y - self.mean_
        if not np.any(Y):
            raise ShapeError(f"all {Y.shape[0]} samples are identical, expected at least two different ones")
        N, Q = Y.shape[0], self.n_components
        X = self.start_scale * pca_start_of_factor(Y, Q) if X0 is None else require_start(X0, N, Q)
        Z = X[farthest_points(X, min(self.n_inducing, N))]
        kernel = kernel_named(self.kernel, self.mu, self.length_scale)
        objective = SparseObjective(Y, n_outputs, kernel, float(self.prior))
        self.objective_start_ = objective(X, Z)[0]
        self.n_iter_, self.n_evaluations_ = 1, 1
        if self.max_iter > 0:
            X, Z, self.n_iter_, self.n_evaluations_ = minimise(
                objective, X, Z, move_inducing=self.move_inducing, max_iter=self.max_iter, tol=self.tol,
                callback=callback,
            )  # fmt: skip
        fixed = fix_gauge(X, centre=not kernel.has_origin)
        # The inducing points follow the latents into the gauge.
        mean = np.zeros(Q) if kernel.has_origin else X.mean(axis=0)
        sign = np.where(np.sum(fixed * (X - mean), axis=0) < 0, -1.0, 1.0)
        self.embedding_, self.inducing_ = fixed, (Z - mean) * sign
        self.objective_ = objective(self.embedding_, self.inducing_)[0]
        self._posterior = SparsePosterior(objective, self.embedding_, self.inducing_)
        self.output_variance_ = self._posterior.fit / (N * n_outputs)
        self.n_outputs_, self.Y_fit_ = n_outputs, Y
        return self

    def _require_parameters(self) -> None:
        if not self.n_components >= 1:
            raise UsageError(f"n_components = {self.n_components}, expected at least 1")
        if not self.n_inducing >= 1:
            raise UsageError(f"n_inducing = {self.n_inducing}, expected at least 1")
        if not self.mu >= _SMALLEST_MU:
            raise UsageError(
                f"mu = {self.mu}, expected at least {_SMALLEST_MU}: K_uu must be positive definite"
            )
        if not self.prior >= 0:
            raise UsageError(f"prior = {self.prior}, expected a weight >= 0")

    @property
    def _n_features_out(self) -> int:
        return int(self.embedding_.shape[1])

    # -- using ---------------------------------------------------------------------------------------------

    def transform(self, Y: Array) -> Array:
        """Latents of data Y (M', r) by their likelihood, the model kept, shape (M', Q).

        Minimises `1/2 log v + ||y - y*||^2 / (2 D s^2 v) + prior/2 ||x||^2` with the posterior variance v in
        units of s^2, from the latents of the nearest training samples. A training sample gets its latent.
        """
        check_is_fitted(self)
        Y = validate_data(self, Y, reset=False, dtype=np.float64) - self.mean_
        norms = np.einsum("nr,nr->n", self.Y_fit_, self.Y_fit_)
        return np.array([self._embed_one(y, norms) for y in Y])

    def inverse_transform(self, X: Array) -> Array:
        """Predicted data at latents X (M', Q), shape (M', r)."""
        check_is_fitted(self)
        k = self._posterior.kernel.smooth(check_array(X, dtype=np.float64), self.inducing_)
        return self.mean_ + k @ self._posterior.W

    def weights(self, X: Array) -> Array:
        """Weights of the training samples at latents X (M', Q), rows summing to 1, shape (M', N)."""
        check_is_fitted(self)
        k = self._posterior.kernel.smooth(check_array(X, dtype=np.float64), self.inducing_)  # [M', M]
        W = self._posterior.solve_A(k.T).T @ self._posterior.K_uf
        return W + (1.0 - W.sum(axis=1, keepdims=True)) / W.shape[1]

    def std(self, X: Array) -> Array:
        """Posterior standard deviation at latents X (M', Q), in units of the outputs, shape (M',)."""
        check_is_fitted(self)
        return np.sqrt(self.output_variance_ * self._posterior.variance(check_array(X, dtype=np.float64)))

    def _embed_one(self, y: Array, norms: Array) -> Array:
        norm = float(y @ y)
        squared = norm + norms - 2.0 * (self.Y_fit_ @ y)  # distances to the training samples, [N]
        order = np.argsort(squared, kind="stable")
        if squared[order[0]] <= _SAME * (norm + norms[order[0]]):
            return self.embedding_[order[0]]
        p, Z = self._posterior, self.inducing_
        target, mu = p.W @ y, self.mu  # [M]
        scale = self.n_outputs_ * max(self.output_variance_, np.finfo(float).tiny)

        def objective(x: Array) -> tuple[float, Array]:
            K, slope = p.kernel.smooth_and_slope(x[None, :], Z)
            k = K[0]
            whitened = solve_triangular(p.L_u, k, lower=True)
            explained = solve_triangular(p.L_u, whitened, lower=True, trans=1)
            tempered = p.solve_A(k)
            prior = float(p.kernel.prior_variance(x[None, :])[0])
            variance = max(prior - k @ explained + mu * (k @ tempered), mu)
            prediction = k @ p.W
            residual = float(np.sum((y - prediction) ** 2))
            value = 0.5 * np.log(variance) + 0.5 * residual / (scale * variance)
            d_variance = 0.5 / variance - 0.5 * residual / (scale * variance**2)
            d_k = (p.W @ prediction - target) / (scale * variance) + 2.0 * d_variance * (
                mu * tempered - explained
            )
            gradient = p.kernel.pull_back(x[None, :], Z, d_k[None, :], slope)[0] + self.prior * x
            gradient += p.kernel.pull_back_variance(x[None, :], d_variance)[0]
            return value + 0.5 * self.prior * float(x @ x), gradient

        ends = [minimize(objective, self.embedding_[n], jac=True, method="L-BFGS-B") for n in order[:4]]
        return min(ends, key=lambda end: float(end.fun)).x
