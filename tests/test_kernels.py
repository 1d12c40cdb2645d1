"""Claims about the covariance function."""

from __future__ import annotations

import numpy as np
import pytest
import reference
from hypothesis import given
from hypothesis import strategies as st

from manifold.errors import UsageError
from manifold.models.kernels import SquaredExponentialDelta, equal_rows, first_equal_row


@given(n=st.integers(1, 6), m=st.integers(1, 6), q=st.integers(1, 4), length_scale=st.floats(0.1, 10))
def test_cross_covariance_is_the_formula_pair_by_pair(n, m, q, length_scale):
    rng = np.random.default_rng(n + 10 * m + 100 * q)
    A, B = rng.normal(size=(m, q)), rng.normal(size=(n, q))
    B[0] = A[0]  # so that the delta acts somewhere
    kernel = SquaredExponentialDelta(0.3, length_scale)
    expected = reference.covariance_matrix(A, B, 0.3, length_scale)
    np.testing.assert_allclose(
        kernel.cross(A, B), expected, rtol=1e-12, atol=1e-300
    )  # rounding of an exponent near 700


def test_training_covariance_is_the_cross_covariance_of_distinct_latents(rng):
    X = rng.normal(size=(7, 2))
    kernel = SquaredExponentialDelta()
    np.testing.assert_array_equal(kernel.training(X), kernel.cross(X, X))


def test_coinciding_training_latents_leave_the_training_covariance_definite():
    K = SquaredExponentialDelta(1e-4).training(np.zeros((3, 2)))
    assert np.linalg.eigvalsh(K)[0] == pytest.approx(1e-4, rel=1e-9)  # cancellation: 1e-16 / 1e-4


def test_gradient_agrees_with_central_differences(rng):
    X, dK = rng.normal(size=(6, 3)), rng.normal(size=(6, 6))
    dK = dK + dK.T
    kernel = SquaredExponentialDelta(0.1, 1.7)
    numeric = reference.central_differences(lambda x: np.sum(dK * kernel.training(x)), X)
    np.testing.assert_allclose(kernel.gradient(X, dK), numeric, rtol=1e-6, atol=1e-8)  # h = 1e-5


def test_rows_are_equal_only_bit_for_bit():
    A = np.array([[1.0, 2.0], [1.0, np.nextafter(2.0, 3.0)], [1e-200, 0.0]])
    B = np.array([[0.0, 0.0], [1.0, 2.0], [1.0, 2.0]])
    assert first_equal_row(A, B).tolist() == [1, -1, -1]
    assert equal_rows(A, B).sum() == 2


@pytest.mark.parametrize(("mu", "length_scale"), [(-1.0, 1.0), (np.nan, 1.0), (1e-4, 0.0), (1e-4, np.inf)])
def test_impossible_parameters_are_refused(mu, length_scale):
    with pytest.raises(UsageError, match="expected a finite number"):
        SquaredExponentialDelta(mu, length_scale)
