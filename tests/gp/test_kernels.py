"""Claims about the covariance functions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers import reference
from hypothesis import given
from hypothesis import strategies as st
from sklearn.base import clone

from manifold.core.errors import UsageError
from manifold.gp import kernels
from manifold.gp.estimators import GPRegressor
from manifold.gp.kernels import SquaredExponential, kernel_named
from manifold.gplvm import GPLVM
from manifold.model.settings import GplvmSettings
from manifold.registries import KERNELS


@given(n=st.integers(1, 6), m=st.integers(1, 6), q=st.integers(1, 4), length_scale=st.floats(0.1, 10))
@pytest.mark.parametrize("name", KERNELS)
def test_covariance_is_the_formula_pair_by_pair(name, n, m, q, length_scale):
    rng = np.random.default_rng(n + 10 * m + 100 * q)
    A, B = rng.normal(size=(m, q)), rng.normal(size=(n, q))
    B[0] = A[0]
    expected = [[reference.RADIAL[name](math.dist(a, b) / length_scale) for b in B] for a in A]
    found = kernel_named(name, 0.3, length_scale).smooth(A, B)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-300)  # rounding of an exponent near 700


@pytest.mark.parametrize("name", KERNELS)
def test_delta_adds_mu_to_the_diagonal_of_samples_alone(rng, name):
    X = rng.normal(size=(7, 2))
    kernel = kernel_named(name, 1e-2, 0.8)
    np.testing.assert_allclose(
        kernel.training(X), kernel.smooth(X, X) + 1e-2 * np.eye(7), rtol=1e-15, atol=1e-15
    )
    np.testing.assert_array_equal(np.diag(kernel.training(X)), kernel.prior_variance)


@pytest.mark.parametrize("name", KERNELS)
def test_gradients_agree_with_central_differences(rng, name):
    X, Z, dK = rng.normal(size=(6, 3)), rng.normal(size=(4, 3)), rng.normal(size=(6, 6))
    dK = dK + dK.T
    kernel = kernel_named(name, 0.1, 1.7)
    for gradient, function in (
        (kernel.gradient(X, dK), lambda x: np.sum(dK * kernel.training(x))),
        (kernel.pull_back(X, Z, dK[:, :4]), lambda x: np.sum(dK[:, :4] * kernel.smooth(x, Z))),
    ):
        numeric = reference.central_differences(function, X)
        np.testing.assert_allclose(gradient, numeric, rtol=1e-6, atol=1e-8)  # h = 1e-5


@pytest.mark.parametrize("name", KERNELS)
def test_no_covariance_changes_faster_than_the_steepest_slope(rng, name):
    X = rng.normal(size=(5, 2))
    x = X[0] + np.linspace(0.0, 3.0, 3001)[:, None] * [0.6, 0.8]
    kernel = kernel_named(name, length_scale=0.7)
    slopes = np.abs(np.diff(kernel.smooth(x, X), axis=0)) / 1e-3
    assert slopes.max() <= kernel.steepest / 0.7 * (1 + 1e-9)
    assert slopes.max() == pytest.approx(kernel.steepest / 0.7, rel=1e-3)  # away from X[0], straight on


@pytest.mark.parametrize(("mu", "length_scale"), [(-1.0, 1.0), (np.nan, 1.0), (1e-4, 0.0), (1e-4, np.inf)])
def test_impossible_parameters_are_refused(mu, length_scale):
    with pytest.raises(UsageError, match="expected a finite number"):
        SquaredExponential(mu, length_scale)


class Own(SquaredExponential):
    """The squared exponential again, as somebody's own class."""

    family = "own"


def test_estimators_take_kernels_of_ones_own(rng):
    X, Y = rng.normal(size=(12, 2)), rng.normal(size=(12, 2)) @ rng.normal(size=(2, 20))
    own, named = (GPRegressor(1e-3, 2.0, kernel).fit(X, Y).predict(X + 0.1) for kernel in (Own, "se"))
    np.testing.assert_array_equal(own, named)
    own, named = (GPLVM(optimizer="l-bfgs", kernel=kernel).fit(Y).embedding_ for kernel in (Own, "se"))
    np.testing.assert_array_equal(own, named)
    assert clone(GPLVM(kernel=Own)).kernel is Own
    with pytest.raises(
        UsageError, match="expected a kernel's name, because a model file cannot store a class"
    ):
        GplvmSettings(kernel=Own)


def test_a_kernel_that_is_registered_as_compiled_without_a_loop_is_refused(rng, monkeypatch):
    """The compiled search would otherwise evaluate another kernel, and the fit would be wrong in silence."""
    monkeypatch.setattr(kernels, "_COMPILED", (*kernels._COMPILED, Own))
    with pytest.raises(ValueError, match="expected a kernel of `radial_of_pair`"):
        GPLVM(optimizer="dls", kernel=Own).fit(rng.normal(size=(6, 4)))
