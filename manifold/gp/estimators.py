"""Gaussian-process regression with the interface of scikit-learn."""

from __future__ import annotations

import numpy as np
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils import Tags
from sklearn.utils.validation import check_is_fitted, validate_data

from manifold.core.defaults import DEFAULT_MU
from manifold.core.records import Array
from manifold.gp.kernels import Kernel, first_equal_row, kernel_named
from manifold.gpr import GaussianProcess, LengthScaleBound


class GPRegressor(RegressorMixin, BaseEstimator):
    """Gaussian-process regression, mean-centred, exact at its training points.

    >>> X, y = np.array([[0.0], [1.0], [2.0]]), np.array([0.0, 1.0, 4.0])
    >>> GPRegressor(mu=1e-6, length_scale=2.0).fit(X, y).predict([[1.0], [1.5]]).round(2)
    array([1.  , 2.36])

    Args:
        mu: noise filter, >= 0.
        length_scale: l > 0, in units of the inputs.
        kernel: name of a kernel, or a class of your own; see `kernel_named`.

    Attributes:
        gp_: the `GaussianProcess` of the training inputs.
        Y_fit_: training outputs, shape (N, D) or (N,).
        output_variance_: `s^2 = tr(K^-1 S) / (N D)`, the output variance that maximises the likelihood.
    """

    def __init__(
        self, mu: float = DEFAULT_MU, length_scale: float = 1.0, kernel: str | type[Kernel] = "se"
    ) -> None:
        self.mu = mu
        self.length_scale = length_scale
        self.kernel = kernel

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.target_tags.multi_output = True
        tags.target_tags.single_output = True
        return tags

    def fit(self, X: Array, Y: Array) -> GPRegressor:
        """Fit to inputs X (N, Q) and outputs Y (N, D) or (N,).

        Source: Rasmussen & Williams 2006, algorithm 2.1; Hikichi & Iwasaki, eq. 13.
        """
        X, Y = validate_data(self, X, Y, multi_output=True, y_numeric=True, dtype=np.float64)
        self.gp_ = GaussianProcess(X, kernel_named(self.kernel, self.mu, self.length_scale))
        self.Y_fit_ = np.array(Y, dtype=np.float64)
        Y_c = self._centred_outputs()  # [N, D]
        fit = max(float(np.sum(Y_c * self.gp_._solve(Y_c))), 0.0)
        self.output_variance_ = fit / Y_c.size
        return self

    def predict(self, X: Array, return_std: bool = False) -> Array | tuple[Array, Array]:
        """Return the posterior mean at X (M, Q), shape (M, D) or (M,); with `return_std` also the deviation (M,).

        At a training input the mean is the training output, bit for bit.
        """
        check_is_fitted(self)
        X = validate_data(self, X, reset=False, dtype=np.float64)
        mean = self.gp_.weights(X) @ self.Y_fit_
        match = first_equal_row(X, self.gp_.X)
        mean[match >= 0] = self.Y_fit_[match[match >= 0]]  # 0 * y + 1 * y loses the sign of -0.0
        if return_std:
            return mean, self.std(X)
        return mean

    def std(self, X: Array) -> Array:
        """Return the posterior standard deviation at X (M, Q), shared by all outputs, in their units, shape (M,)."""
        check_is_fitted(self)
        X = validate_data(self, X, reset=False, dtype=np.float64)
        return np.sqrt(self.output_variance_ * self.gp_.variance(X))

    def length_scale_bound(self, X: Array) -> LengthScaleBound:
        """Return the bound on the length scale at X (M, Q) (Hikichi & Iwasaki, eq. 15)."""
        check_is_fitted(self)
        Y_c = self._centred_outputs()
        return self.gp_.length_scale_bound(validate_data(self, X, reset=False, dtype=np.float64), Y_c @ Y_c.T)

    def _centred_outputs(self) -> Array:
        Y = self.Y_fit_.reshape(self.Y_fit_.shape[0], -1)
        return Y - Y.mean(axis=0)
