"""Gaussian-process regression with one kernel for all outputs, the method by which Hikichi & Iwasaki predict BRDFs.

Because all outputs share one kernel, a prediction is a weighted sum of the training samples with weights
`w = K^-1 k*` (eq. 13). `GaussianProcess` therefore depends only on the latents, and uses outputs only through their
Gram matrix. Manifolds of kind `gplvm` predict with it; manifolds of kind `blend` use its variance.
`manifold.gp.estimators.GPRegressor` adds outputs and has the interface of scikit-learn.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from manifold.core.errors import NumericalError
from manifold.core.names import first_few
from manifold.core.records import Array, Indices, Mask
from manifold.gp.kernels import Kernel, equal_rows, first_equal_row, squared_distances
from manifold.gp.likelihood import centre_gram

# Added to the diagonal of a covariance that is not positive definite, ten times more each time: rounding, and noise
# beyond which a fit is refused.
_FIRST_JITTER, _LAST_JITTER = 1e-12, 1e-2
_COINCIDE = 1e-6  # latents closer than this many length scales are named as coinciding


class JitterWarning(UserWarning):
    """Warns that K needed jitter to be positive definite, which makes predictions smoother than mu does."""


def factorise(X: Array, kernel: Kernel) -> tuple[Array, Array, float]:
    """Return the covariance K (N, N) of latents X (N, Q), its lower Cholesky factor, and the jitter (usually 0)."""
    K = kernel.training(X)
    diagonal, variance = np.diag_indices_from(K), np.diag(K).copy()
    jitter = 0.0
    while True:
        L = _cholesky_or_none(K)
        if L is not None:
            break
        raised = _FIRST_JITTER if jitter == 0.0 else 10.0 * jitter
        if raised > _LAST_JITTER:
            raise NumericalError(
                f"K is not positive definite even with {jitter:.0e} on its diagonal (N = {X.shape[0]}, "
                f"mu = {kernel.mu:.0e}): {_name_coinciding(X, kernel)}; raise mu"
            )
        jitter = raised
        K[diagonal] = variance + jitter
    if jitter > 0.0:
        warnings.warn(
            f"K is not positive definite (N = {X.shape[0]}, mu = {kernel.mu:.0e}): "
            f"{_name_coinciding(X, kernel)}; added {jitter:.0e} to its diagonal; "
            f"raise mu to {jitter:.0e} or more",
            JitterWarning,
            stacklevel=4,
        )
    return K, L, jitter


def _cholesky_or_none(K: Array) -> Array | None:
    """Return the lower factor, or None if K is singular to working precision."""
    try:
        L = scipy.linalg.cholesky(K, lower=True)
    except np.linalg.LinAlgError:
        return None
    # Rounding can let a singular K pass with meaningless pivots.
    smallest_pivot = float(np.diag(L).min()) ** 2
    return L if smallest_pivot > 4.0 * K.shape[0] * np.finfo(float).eps else None


def _name_coinciding(X: Array, kernel: Kernel) -> str:
    """Name the latents that coincide, or else the closest two."""
    if X.shape[0] < 2:
        return "a single latent"
    distances = np.sqrt(squared_distances(X, X))
    distances[np.tril_indices_from(distances)] = np.inf
    pairs = np.argwhere(distances <= _COINCIDE * kernel.length_scale)
    if len(pairs) == 0:
        i, j = np.unravel_index(int(distances.argmin()), distances.shape)
        return f"latents {i} and {j} are closest, {distances[i, j]:.1e} apart"
    return f"latents {first_few([f'{i} and {j}' for i, j in pairs])} coincide"


LEAST_EXPLAINED = 0.5  # share of the variance between samples below which a fit is warned of
_ALONE = 0.5  # share of the prior's variance above which a sample is far from all others
_COINCIDENT = 1e-3  # share of the latents' span; closer latents count as one
_MOST_ALONE = 0.25  # share of such samples from which a fit is warned of


class FlatModelWarning(UserWarning):
    """Warns that a fitted process predicts nearly the mean of the samples everywhere, or is linear in the latents."""


class IsolatedLatentsWarning(UserWarning):
    """Warns that many fitted latents are far from all others, so that the process predicts the mean between them."""


@dataclass(frozen=True, eq=False)
class LengthScaleBound:
    """A bound on how fast predictions change away from the nearest training latent (Hikichi & Iwasaki, eq. 15).

    Attributes:
        nearest: index of the nearest training latent, shape (M,).
        distance: distance to that latent, shape (M,).
        displacement: `||y* - y_i||` between prediction and nearest sample, in units of the outputs, shape (M,).
        bound: `s sqrt(2 N) * kappa(K) * ||Y|| * ||x* - x_i||`, shape (M,), with s the steepest slope of the
            kernel, `e^(-1/2) / l` of the squared exponential, and the Frobenius norm of the centred outputs Y.
    """

    nearest: Indices
    distance: Array
    displacement: Array
    bound: Array

    @property
    def slack(self) -> Array:
        """Return `bound / displacement`, shape (M,): at least 1 where the condition holds, inf at a training latent."""
        moved = self.displacement > 0
        return np.where(moved, self.bound / np.where(moved, self.displacement, 1.0), np.inf)

    @property
    def holds(self) -> Mask:
        """Return whether the condition holds, shape (M,).

        It fails very close to a training latent, where the kernel's delta term jumps.
        """
        return self.displacement <= self.bound


class GaussianProcess:
    """The part of a Gaussian process that depends only on the training latents.

    It holds N latents and one N x N Cholesky factor, and nothing of the size of the outputs.

    Args:
        X: training latents, shape (N, Q). Duplicates are allowed.
        kernel: the covariance function.

    Attributes:
        X: the latents, float64, shape (N, Q).
        K: covariance of the training latents (jitter included), shape (N, N).
        L: its lower Cholesky factor, shape (N, N).
        jitter: amount added to the diagonal; 0 if K was positive definite.

    Raises:
        NumericalError: K cannot be factorised even with jitter.

    Source: Rasmussen & Williams 2006, algorithm 2.1; Hikichi & Iwasaki, eq. 12-14.
    """

    def __init__(self, X: Array, kernel: Kernel) -> None:
        self.X = np.array(X, dtype=np.float64)
        self.kernel = kernel
        self.K, self.L, self.jitter = factorise(self.X, self.kernel)

    def __repr__(self) -> str:
        N, Q = self.X.shape
        return f"<{type(self).__name__}: {N} latents, {Q} dimensions, {self.kernel}>"

    @property
    def n_samples(self) -> int:
        """Return N, the number of training latents."""
        return int(self.X.shape[0])

    def weights(self, X_new: Array) -> Array:
        """Return the weights V with prediction = V @ Y, shape (M, N); each row sums to 1.

        `v_i = w_i + (1 - sum(w)) / N` with `w = K^-1 k*`, because the mean of the training outputs is subtracted
        before the prediction and added after it. At a training latent the row is exactly a unit vector; if several
        training latents coincide there, the first one has the weight.

        Args:
            X_new: latents, shape (M, Q).

        >>> from manifold.gp.kernels import SquaredExponential
        >>> gp = GaussianProcess(np.array([[0.0], [1.0]]), SquaredExponential())
        >>> gp.weights(np.array([[0.5], [1.0]]))
        array([[0.5, 0.5],
               [0. , 1. ]])
        """
        V = self.smooth_weights(X_new)
        # K^-1 K[:, i] is a unit vector only to rounding: with equal coordinates it is written down instead.
        match = first_equal_row(X_new, self.X)
        hit = np.flatnonzero(match >= 0)
        V[hit] = 0.0
        V[hit, match[hit]] = 1.0
        return V

    def smooth_weights(self, X_new: Array) -> Array:
        """Return the weights without the kernel's delta term, shape (M, N), at latents X_new (M, Q).

        They are continuous at the training latents, where `weights` jumps to a unit vector.
        """
        W = self._solve(self.kernel.smooth(X_new, self.X).T).T  # [M, N]
        return W + (1.0 - W.sum(axis=1, keepdims=True)) / self.n_samples

    def variance(self, X_new: Array) -> Array:
        """Return the posterior variance in units of the output variance: `c(x*, x*) - k*^T K^-1 k*`, shape (M,).

        The variance is that of a new sample and includes the delta term of `c(x*, x*) = 1 + mu`. It is between mu and
        2 mu beside a training latent, exactly 0 at one, where the prediction equals the sample, and at most 1 + mu.
        """
        A = scipy.linalg.solve_triangular(self.L, self.kernel.smooth(X_new, self.X).T, lower=True)  # [N, M]
        variance = np.maximum(self.kernel.prior_variance - np.einsum("nm,nm->m", A, A), 0.0)
        variance[first_equal_row(X_new, self.X) >= 0] = 0.0
        return variance

    def variance_fraction(self, X_new: Array) -> Array:
        """Return posterior over prior variance, shape (M,): values near 0 mean interpolation, near 1 extrapolation."""
        return self.variance(X_new) / self.kernel.prior_variance

    def output_variance(self, S: Array, n_outputs: int) -> float:
        """Return the output variance that maximises the likelihood, `s^2 = tr(K^-1 S_c) / (N D)`.

        Args:
            S: Gram matrix of the outputs, shape (N, N); this method centres it.
            n_outputs: D, the number of outputs of a sample.
        """
        S = centre_gram(S)
        return max(float(np.trace(self._solve(S))), 0.0) / (self.n_samples * n_outputs)

    def explained(self, S: Array) -> float:
        """Return the share of the variance of the training samples that the smooth mean explains at their latents.

        The residuals at the training latents are `r K^-1 Y`, in which r is the diagonal of K less 1, so the share is
        `1 - |r K^-1 Y|^2 / |Y|^2`. A share of 1 means interpolation, 0 the mean everywhere.

        Args:
            S: Gram matrix of the outputs, shape (N, N); centred here.
        """
        S = centre_gram(S)
        residual = (self.kernel.mu + self.jitter) ** 2 * float(np.trace(self._solve(self._solve(S).T)))
        return 1.0 - residual / float(np.trace(S))

    @property
    def is_linear(self) -> bool:
        """Return whether the mean is linear in the latents, up to an error below the noise filter.

        A linear function of Q coordinates leaves only Q eigenvalues of the centred smooth kernel above the noise
        filter. The result is False for Q + 1 or fewer distinct latents, through which a linear function always
        passes, and for latents that span a length scale or more.
        """
        N, Q = self.X.shape
        span = float(np.ptp(self.X, axis=0).max())
        if not 0.0 < span < self.kernel.length_scale:
            return False
        if len(np.unique(np.round(self.X / (_COINCIDENT * span)), axis=0)) <= Q + 1:
            return False
        beyond = N - 1 - Q
        smooth = centre_gram(self.kernel.smooth(self.X, self.X))
        return bool(scipy.linalg.eigvalsh(smooth, subset_by_index=[beyond, beyond])[0] <= self.kernel.mu)

    def warn_of_fit(self, S: Array) -> None:
        """Warn if the latents explain little of the variance of the samples, given by their Gram matrix S (N, N).

        Warns:
            FlatModelWarning: `explained` is below one half, or the mean `is_linear`.
            IsolatedLatentsWarning: for at least a quarter of the samples, the variance given the others is over half
                of the prior variance.
        """
        share = self.explained(S)
        if share < LEAST_EXPLAINED:
            warnings.warn(
                f"the fit explains {100.0 * share:.0f} % of the variance between samples "
                f"(N = {self.n_samples}, length scale {self.kernel.length_scale:g}, mu = {self.kernel.mu:.0e}), "
                f"expected at least {100.0 * LEAST_EXPLAINED:.0f} %; lower the length scale, the prior or mu",
                FlatModelWarning,
                stacklevel=3,
            )
        elif self.is_linear:
            span = np.ptp(self.X, axis=0).max()
            warnings.warn(
                f"the map is linear, like a PCA map: the latents span only {span:.2g} (length scale "
                f"{self.kernel.length_scale:g}, mu = {self.kernel.mu:.0e}); lower the length scale, the prior or "
                "mu",
                FlatModelWarning,
                stacklevel=3,
            )
        alone = np.count_nonzero(self.leave_one_out_variance() > _ALONE * self.kernel.prior_variance)
        if self.n_samples > 2 and alone >= _MOST_ALONE * self.n_samples:  # two always are
            warnings.warn(
                f"{alone} of {self.n_samples} latents are far from all others (length scale "
                f"{self.kernel.length_scale:g}): predictions between them are the mean; use more materials, fewer "
                "dimensions, a longer length scale or a better start",
                IsolatedLatentsWarning,
                stacklevel=3,
            )

    def leave_one_out_weights(self) -> Array:
        """Return the weights (N, N) that predict every sample from the others at fixed latents; the diagonal is 0.

        Row i equals the weights of a process fitted on the other N - 1 samples, evaluated at x_i: with
        `P = K^-1` its uncentred weights are `a_j = -P_ij / P_ii`, and centring on the mean of the *remaining*
        samples adds `(1 - sum(a)) / (N - 1)`. If another training latent coincides with x_i, the prediction is its
        sample, as in `weights`.

        There are at least two samples.

        Source: Rasmussen & Williams 2006, eq. 5.12.
        """
        N = self.n_samples
        A = -self._precision / np.diag(self._precision)[:, None]  # [N, N]
        np.fill_diagonal(A, 0.0)
        V = A + (1.0 - A.sum(axis=1, keepdims=True)) / (N - 1)
        np.fill_diagonal(V, 0.0)
        twin = self._first_twin
        hit = np.flatnonzero(twin >= 0)
        V[hit] = 0.0
        V[hit, twin[hit]] = 1.0
        return V

    def leave_one_out_variance(self) -> Array:
        """Return the variance of every sample given the others, in units of the output variance, shape (N,).

        Source: Rasmussen & Williams 2006, eq. 5.12: `1 / [K^-1]_ii`.
        """
        return np.where(self._first_twin >= 0, 0.0, 1.0 / np.diag(self._precision))

    @cached_property
    def condition(self) -> float:
        """Return the condition number kappa(K) in the 2-norm."""
        eigenvalues = np.linalg.eigvalsh(self.K)
        return float(eigenvalues[-1] / eigenvalues[0]) if eigenvalues[0] > 0 else float("inf")

    def length_scale_bound(self, X_new: Array, S: Array) -> LengthScaleBound:
        """Return the bound on the length scale at latents X_new, and how far the predictions stay below it.

        Args:
            X_new: latents, shape (M, Q).
            S: Gram matrix of the training outputs, shape (N, N); centred here.
        Source: Hikichi & Iwasaki, eq. 15.
        """
        S = centre_gram(S)
        V = self.weights(X_new)
        distances = np.sqrt(squared_distances(X_new, self.X))
        nearest = distances.argmin(axis=1)
        rows = np.arange(X_new.shape[0])
        V[rows, nearest] -= 1.0  # y* - y_i as weights of the samples
        squared = np.einsum("mi,ij,mj->m", V, S, V, optimize=True)
        factor = self.kernel.steepest / self.kernel.length_scale * np.sqrt(2.0 * self.n_samples)
        norm_Y = np.sqrt(max(float(np.trace(S)), 0.0))
        distance = distances[rows, nearest]
        return LengthScaleBound(
            nearest=nearest,
            distance=distance,
            displacement=np.sqrt(np.maximum(squared, 0.0)),
            bound=factor * self.condition * norm_Y * distance,
        )

    def _solve(self, B: Array) -> Array:
        """Return K^-1 B, computed through L, because near-identical samples make K ill-conditioned."""
        return scipy.linalg.cho_solve((self.L, True), B)

    @cached_property
    def _precision(self) -> Array:
        return self._solve(np.eye(self.n_samples))

    @cached_property
    def _first_twin(self) -> Indices:
        """Index of the first *other* training latent with the same coordinates, or -1, shape (N,)."""
        same = equal_rows(self.X, self.X)
        np.fill_diagonal(same, False)
        return np.where(same.any(axis=1), same.argmax(axis=1), -1)
