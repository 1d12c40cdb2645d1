"""Claims about Gaussian-process regression by weights."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from helpers import reference
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.utils.estimator_checks import parametrize_with_checks

from manifold.gp.estimators import GPRegressor
from manifold.gp.kernels import SquaredExponential
from manifold.gp.likelihood import centre_gram
from manifold.gpr import GaussianProcess, JitterWarning


@parametrize_with_checks([GPRegressor()])
def test_regressor_follows_scikit_learn(estimator, check):
    check(estimator)


@settings(deadline=None)
@given(n=st.integers(1, 12), m=st.integers(1, 5), q=st.integers(1, 4), d=st.integers(1, 5))
def test_posterior_is_the_textbook_posterior(n, m, q, d):
    rng = np.random.default_rng([n, m, q, d])
    X, Y, X_new = 2 * rng.normal(size=(n, q)), rng.normal(size=(n, d)), rng.normal(size=(m, q))
    model = GPRegressor(mu=1e-2, length_scale=0.8).fit(X, Y)
    mean, variance = reference.posterior(X, Y, X_new, 1e-2, 0.8)
    np.testing.assert_allclose(model.predict(X_new), mean, rtol=1e-9, atol=1e-10)  # kappa(K) <= N / mu
    np.testing.assert_allclose(model.gp_.variance(X_new), variance, rtol=1e-9, atol=1e-10)


def test_weights_at_training_latents_are_exactly_unit_vectors(rng):
    X = rng.normal(size=(20, 2))
    assert np.array_equal(GaussianProcess(X, SquaredExponential()).weights(X), np.eye(20))


def test_prediction_at_training_latents_is_the_data_bit_for_bit(rng):
    X, Y = rng.normal(size=(20, 2)), rng.normal(size=(20, 7)) * 10.0 ** rng.integers(-100, 100, size=(20, 7))
    Y[3, 2] = -0.0
    assert np.asarray(GPRegressor().fit(X, Y).predict(X)).tobytes() == Y.tobytes()


def test_deviation_is_zero_on_data_near_zero_beside_it_and_the_prior_far_away(rng):
    X, Y = rng.normal(size=(15, 2)), rng.normal(size=(15, 4))
    model = GPRegressor().fit(X, Y)
    prior = np.sqrt(model.output_variance_ * (1 + model.mu))
    assert np.array_equal(model.std(X), np.zeros(15))
    assert np.all(model.std(X + 1e-6) < 0.02 * prior)  # sqrt(2 mu) = 0.014
    np.testing.assert_allclose(model.std(X + 50.0), prior, rtol=1e-12)
    np.testing.assert_allclose(model.gp_.variance_fraction(X + 50.0), 1.0, rtol=1e-12)


def test_output_variance_maximises_the_likelihood(rng):
    X, Y = rng.normal(size=(8, 2)), rng.normal(size=(8, 5))
    model = GPRegressor(mu=1e-2).fit(X, Y)
    Y_c = Y - Y.mean(axis=0)
    fit = np.trace(Y_c.T @ np.linalg.solve(model.gp_.K, Y_c))

    def negative_log_likelihood(s2):
        return 0.5 * Y.size * np.log(s2) + 0.5 * fit / s2

    best = negative_log_likelihood(model.output_variance_)
    assert best < negative_log_likelihood(1.01 * model.output_variance_)
    assert best < negative_log_likelihood(0.99 * model.output_variance_)
    assert model.gp_.output_variance(Y @ Y.T, 5) == pytest.approx(model.output_variance_, rel=1e-10)


def _refit_without(X, i, **parameters):
    keep = np.arange(len(X)) != i
    row = np.zeros(len(X))
    process = GaussianProcess(X[keep], SquaredExponential(**parameters))
    row[keep] = process.weights(X[i : i + 1])[0]
    return row, process.variance(X[i : i + 1])[0]


@pytest.mark.parametrize(("n", "mu", "length_scale"), [(2, 1e-4, 1.0), (20, 1e-2, 0.5), (51, 1e-4, 1.0)])
def test_closed_form_leave_one_out_is_refitting_n_times(rng, n, mu, length_scale):
    X = 2.0 * rng.normal(size=(n, 2))
    process = GaussianProcess(X, SquaredExponential(mu, length_scale))
    refitted = [_refit_without(X, i, mu=mu, length_scale=length_scale) for i in range(n)]
    V = process.leave_one_out_weights()
    assert np.array_equal(np.diag(V), np.zeros(n))
    np.testing.assert_allclose(V, [row for row, _ in refitted], rtol=0, atol=1e-10)
    np.testing.assert_allclose(process.leave_one_out_variance(), [v for _, v in refitted], rtol=0, atol=1e-10)


def test_leave_one_out_of_a_duplicate_is_its_twin(rng):
    X = rng.normal(size=(9, 2))
    X[[4, 7]] = X[1]
    process = GaussianProcess(X, SquaredExponential(1e-2))
    refitted = [_refit_without(X, i, mu=1e-2) for i in range(9)]
    V = process.leave_one_out_weights()
    np.testing.assert_allclose(V, [row for row, _ in refitted], rtol=0, atol=1e-10)
    assert V[1, 4] == V[4, 1] == V[7, 1] == 1.0
    assert np.array_equal(process.leave_one_out_variance()[[1, 4, 7]], np.zeros(3))


def test_duplicates_neither_warn_nor_break_and_the_first_one_answers(rng):
    X, Y = rng.normal(size=(6, 2)), rng.normal(size=(6, 3))
    X[5] = X[2]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = GPRegressor().fit(X, Y)
    assert np.array_equal(model.predict(X[5:]), Y[2:3])
    assert np.all(np.abs(model.gp_.weights(X + 0.01)) < 1e3)


def test_jitter_names_the_coinciding_latents(rng):
    X = rng.normal(size=(12, 2))
    X[9] = X[4]
    with pytest.warns(JitterWarning, match=r"latents 4 and 9 coincide; added 1e-12 .* raise mu"):
        process = GaussianProcess(X, SquaredExponential(0.0, 0.2))
    assert process.jitter == 1e-12
    assert np.all(np.isfinite(process.weights(X + 0.1)))


def test_jitter_escalates_until_the_factorisation_holds():
    with pytest.warns(JitterWarning, match="closest"):
        process = GaussianProcess(np.linspace(0, 1, 60)[:, None], SquaredExponential(0.0, 5.0))
    assert process.jitter > 1e-13
    np.testing.assert_allclose(process.L @ process.L.T, process.K, atol=1e-13)


def test_length_scale_bound_is_the_formula_and_holds_between_latents(rng):
    X, Y, X_new = rng.normal(size=(10, 2)), rng.normal(size=(10, 6)), rng.normal(size=(25, 2))
    model = GPRegressor(mu=1e-2, length_scale=1.3).fit(X, Y)
    bound = model.length_scale_bound(X_new)
    norm = np.linalg.norm(Y - Y.mean(axis=0))
    for m, x in enumerate(X_new):
        i = np.argmin(np.linalg.norm(X - x, axis=1))
        distance = np.linalg.norm(X[i] - x)
        expected = np.exp(-0.5) * np.sqrt(20) / 1.3 * np.linalg.cond(model.gp_.K) * norm * distance
        assert bound.nearest[m] == i
        assert bound.bound[m] == pytest.approx(expected, rel=1e-8)  # eps times kappa(K)
        moved = np.linalg.norm(model.predict(x[None])[0] - Y[i])
        assert bound.displacement[m] == pytest.approx(moved, rel=1e-8)
    assert np.all(bound.holds)
    np.testing.assert_allclose(bound.slack, bound.bound / bound.displacement)


def test_length_scale_bound_fails_in_the_jump_beside_a_latent(rng):
    X, Y = rng.normal(size=(10, 2)), rng.normal(size=(10, 6))
    model = GPRegressor(mu=1e-2).fit(X, Y)
    assert np.all(model.length_scale_bound(X).slack == np.inf)
    assert not np.any(model.length_scale_bound(X + 1e-12).holds)


def test_centred_gram_is_the_gram_of_centred_data(rng):
    Y = rng.normal(size=(7, 4)) + 3.0
    Y_c = Y - Y.mean(axis=0)
    np.testing.assert_allclose(centre_gram(Y @ Y.T), Y_c @ Y_c.T, atol=1e-12)
