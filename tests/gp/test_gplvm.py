"""Claims about the latent variable model."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from helpers import reference
from scipy.optimize import minimize
from sklearn.utils.estimator_checks import parametrize_with_checks
from threadpoolctl import threadpool_limits

from manifold.core.errors import ShapeError, UsageError
from manifold.dls import hooke_jeeves
from manifold.gp.kernels import Kernel, Matern52, SquaredExponential, kernel_named
from manifold.gp.likelihood import IncrementalObjective, LatentObjective, centre_gram, fix_gauge, pca_start
from manifold.gplvm import GPLVM
from manifold.gpr import FlatModelWarning, GaussianProcess, IsolatedLatentsWarning
from manifold.registries import KERNELS, OPTIMIZERS


# A few rounds exercise every path; hundreds would only cost time.
@parametrize_with_checks([GPLVM(max_iter=4, optimizer=name) for name in OPTIMIZERS])
def test_model_follows_scikit_learn(estimator, check):
    check(estimator)


def curved(rng, n=30, d=40, q=2):
    """Outputs that depend smoothly on q hidden coordinates, with little noise."""
    return np.tanh(rng.normal(size=(n, q)) @ rng.normal(size=(q, d))) + 0.01 * rng.normal(size=(n, d))


def objective_of(Y, mu=1e-4, length_scale=1.0, prior=0.0, kernel="se"):
    return LatentObjective(centre_gram(Y @ Y.T), Y.shape[1], kernel_named(kernel, mu, length_scale), prior)


def test_objective_is_the_likelihood_written_out(rng):
    Y, X = curved(rng, 12), rng.normal(size=(12, 2))
    expected = reference.gplvm_objective(X, Y, 1e-2, 1.3)
    assert objective_of(Y, 1e-2, 1.3)(X)[0] == pytest.approx(expected, rel=1e-10)


def test_a_fixed_output_variance_gives_the_likelihood_without_profiling(rng):
    """Eq. 21 of Hikichi & Iwasaki, where s^2 = 1; its gradient by differences."""
    Y, X = curved(rng, 8), rng.normal(size=(8, 2))
    N, D = Y.shape
    Y_c = Y - Y.mean(axis=0)
    fixed = LatentObjective(centre_gram(Y @ Y.T), D, SquaredExponential(1e-2, 1.3), output_variance=1.0)
    expected = -reference.log_likelihood(X, Y_c, 1e-2, 1.3) / D - 0.5 * N * (1.0 + np.log(2.0 * np.pi))
    value, gradient = fixed(X)
    assert value == pytest.approx(expected, rel=1e-10)
    assert fixed.value(X) == pytest.approx(expected, rel=1e-10)
    slope = reference.central_differences(lambda at: fixed(at)[0], X)
    np.testing.assert_allclose(gradient, slope, rtol=1e-5, atol=1e-5 * np.abs(slope).max())


@pytest.mark.parametrize("optimizer", OPTIMIZERS)
def test_fits_with_a_fixed_output_variance_end_below_the_start(rng, optimizer):
    Y = curved(rng, 8)
    model = GPLVM(1, mu=1e-2, optimizer=optimizer, output_variance=0.5, max_iter=20).fit(Y)
    assert model.objective_ < model.objective_start_ - 1e-3
    assert model.output_variance_ == 0.5
    with pytest.raises(UsageError, match="expected a positive number or None"):
        GPLVM(output_variance=0.0).fit(Y)


@pytest.mark.parametrize("optimizer", OPTIMIZERS)
@pytest.mark.parametrize("kernel", KERNELS)
def test_a_fit_ends_at_the_likelihood_of_its_kernel_written_out(rng, kernel, optimizer):
    Y = curved(rng, 12)
    model = GPLVM(kernel=kernel, optimizer=optimizer, mu=1e-2, max_iter=30).fit(Y)
    expected = reference.gplvm_objective(model.embedding_, Y, 1e-2, 1.0, reference.RADIAL[kernel])
    assert model.objective_ == pytest.approx(expected, rel=1e-9)  # condition of K: up to 1e3
    assert model.objective_ < model.objective_start_ - 1.0


class Cauchy(Kernel):
    """`g = 1 / (1 + r^2)`."""

    family, steepest = "cauchy", 3.0**1.5 / 8.0

    def radial(self, squared, xp=np):
        g = 1.0 / (1.0 + squared)
        return g, -(g**2)


class NotMatern(Matern52):
    """A class of one's own that inherits the name of a built-in kernel."""

    def radial(self, squared, xp=np):
        g = 1.0 / (1.0 + squared)
        return g, -(g**2)


@pytest.mark.parametrize("own", [Cauchy, NotMatern])
@pytest.mark.parametrize("is_registered", [False, True])
@pytest.mark.parametrize("optimizer", OPTIMIZERS)
def test_a_kernel_of_ones_own_is_fitted_as_it_is(rng, monkeypatch, own, is_registered, optimizer):
    Y, kernel = curved(rng, 12), own
    if is_registered:
        monkeypatch.setitem(KERNELS, own.family, own)
        kernel = own.family
    model = GPLVM(kernel=kernel, optimizer=optimizer, mu=1e-2).fit(Y)
    expected = reference.gplvm_objective(model.embedding_, Y, 1e-2, 1.0, reference.RADIAL["cauchy"])
    assert model.objective_ == pytest.approx(expected, rel=1e-9)  # condition of K: up to 1e3
    assert model.objective_ < model.objective_start_


def test_prior_adds_half_its_weight_times_the_squared_norm(rng):
    Y, X = curved(rng, 12), rng.normal(size=(12, 2))
    added = objective_of(Y, prior=0.7)(X)[0] - objective_of(Y)(X)[0]
    assert added == pytest.approx(0.35 * np.sum(X**2), rel=1e-10)


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("prior", [0.0, 0.3])
def test_gradient_agrees_with_central_differences(rng, prior, kernel):
    Y, X = curved(rng, 15), rng.normal(size=(15, 3))
    objective = objective_of(Y, 1e-2, 1.2, prior, kernel)
    numeric = reference.central_differences(lambda x: objective(x)[0], X)
    gradient = objective(X)[1]
    # h = 1e-5: truncation h^2 and rounding eps kappa / h are both near 1e-8 of the largest entry.
    np.testing.assert_allclose(gradient, numeric, rtol=0, atol=1e-6 * np.abs(numeric).max())


def test_derivative_by_the_noise_agrees_with_central_differences(rng):
    Y, X, h = curved(rng, 15), rng.normal(size=(15, 3)), 1e-6
    ahead, behind = (objective_of(Y, 1e-2 + step, 1.2, 0.3)(X)[0] for step in (h, -h))
    _, _, derivative = objective_of(Y, 1e-2, 1.2, 0.3).with_noise(X)
    # h = 1e-4 of mu: truncation is h^2 / mu^2 = 1e-8 of the derivative.
    assert derivative == pytest.approx((ahead - behind) / (2 * h), rel=1e-6)


@pytest.mark.parametrize(("kernel", "prior"), [*((kernel, 0.0) for kernel in KERNELS), ("se", 0.3)])
def test_thousands_of_rank_two_updates_agree_with_a_fresh_factorisation(rng, prior, kernel):
    Y = curved(rng, 51)
    objective = objective_of(Y, prior=prior, kernel=kernel)
    unlimited, worst, n_moves, n_refactorisations = (np.full(102, -np.inf), np.full(102, np.inf)), 0.0, 0, 0
    with threadpool_limits(1):  # small factorisations crawl on several threads
        for _ in range(4):
            moving = IncrementalObjective(objective, rng.normal(size=(51, 2)))
            for _ in range(30):
                before = moving.x.copy()
                moving.explore(np.abs(0.05 * rng.normal(size=102)), np.ones(102), unlimited, 1000)
                n_moves += np.count_nonzero(moving.x != before)
                worst = max(worst, abs(moving.value - objective(moving.x.reshape(51, 2))[0]))
            n_refactorisations += moving.n_refactorisations
    assert n_moves > 2000
    assert worst < 1e-8
    assert n_refactorisations < 0.5 * n_moves  # most moves are updates, or the test shows nothing


@pytest.mark.parametrize("kernel", KERNELS)
def test_exploring_keeps_the_moves_that_lower_the_objective_and_no_others(rng, kernel):
    objective = objective_of(curved(rng, 12), kernel=kernel, prior=0.1)
    X = pca_start(objective.S, 2)
    moving, steps = IncrementalObjective(objective, X), np.full(24, 0.1)
    heading = np.where(rng.random(24) < 0.5, -1.0, 1.0)
    expected, best, tried, turned = X.copy().reshape(-1), objective(X)[0], 0, heading.copy()
    for index in range(24):
        for sense in (heading[index], -heading[index]):
            other = expected.copy()
            other[index] += sense * 0.1
            tried += 1
            if (value := objective(other.reshape(12, 2))[0]) < best:
                expected, best, turned[index] = other, value, sense
                break
    unlimited = (np.full(24, -np.inf), np.full(24, np.inf))
    assert moving.explore(steps, heading, unlimited, 1000) == tried
    np.testing.assert_allclose(moving.x, expected, atol=1e-14)
    np.testing.assert_array_equal(heading, turned)
    assert moving.value == pytest.approx(best, abs=1e-8)
    assert best < objective(X)[0]


def test_start_is_principal_components_of_unit_variance_and_fixed_sign(rng):
    Y = rng.normal(size=(20, 6)) * [5, 4, 3, 1, 1, 1]
    Y_c = Y - Y.mean(axis=0)
    X = pca_start(Y_c @ Y_c.T, 3)
    U = np.linalg.svd(Y_c, full_matrices=False)[0][:, :3]
    np.testing.assert_allclose(np.abs(X), np.abs(U) * np.sqrt(20), atol=1e-10)
    np.testing.assert_allclose(X.var(axis=0), 1.0)
    assert np.all(X[np.abs(X).argmax(axis=0), range(3)] > 0)


def test_axes_the_data_do_not_span_start_at_zero(rng):
    y = rng.normal(size=(8, 1))
    S = centre_gram(y @ y.T)
    X = pca_start(S, 3)
    assert np.array_equal(X[:, 1:], np.zeros((8, 2)))
    assert np.all(np.isfinite(GPLVM(3, max_iter=5).fit(y).embedding_))


@pytest.mark.parametrize("optimizer", OPTIMIZERS)
@pytest.mark.parametrize("prior", [0.0, 1.0])
def test_refined_likelihood_is_never_worse_than_the_start(rng, optimizer, prior):
    for n, q in ((3, 2), (12, 1), (25, 4)):
        Y = curved(rng, n, q=2)
        model = GPLVM(q, optimizer=optimizer, prior=prior, max_iter=20).fit(Y)
        objective = objective_of(Y, prior=prior)
        assert model.objective_ <= model.objective_start_
        assert model.objective_ == pytest.approx(objective(model.embedding_)[0], rel=1e-8)
        again = GPLVM(q, optimizer=optimizer, prior=prior, max_iter=20).fit_gram(
            Y @ Y.T, 40, X0=model.embedding_
        )
        assert again.objective_ <= model.objective_ + 1e-9  # rounding of one factorisation


def test_direct_local_search_ends_where_no_step_of_one_coordinate_is_better(rng):
    Y = curved(rng, 12)
    X = GPLVM(optimizer="dls").fit(Y).embedding_
    objective = objective_of(Y)
    here = objective(X)[0]
    for index in range(24):
        for step in (0.1 / 2**9, -0.1 / 2**9):  # the last that is tried: half of it is below 100 tolerances
            other = X.copy().reshape(-1)
            other[index] += step
            assert objective(other.reshape(12, 2))[0] >= here - 1e-8  # of the incremental objective


def test_direct_local_search_is_that_of_hooke_and_jeeves_from_the_principal_components(rng):
    Y = curved(rng, 8)
    start = pca_start(objective_of(Y, 1e-2).S, 2)
    Y = Y[np.argsort(-np.sum(start**2, axis=1))]  # farthest first, as it searches
    objective = objective_of(Y, 1e-2)
    slow = minimize(
        lambda x: objective(x.reshape(8, 2))[0], pca_start(objective.S, 2).reshape(-1), method=hooke_jeeves,
        options={"initial_step": 0.1, "maxiter": 10},
    )  # fmt: skip
    model = GPLVM(mu=1e-2, optimizer="dls", max_iter=10).fit(Y)  # later, paths part by rounding
    assert model.objective_ == pytest.approx(slow.fun, abs=1e-8)
    np.testing.assert_allclose(model.embedding_, fix_gauge(slow.x.reshape(8, 2)), atol=1e-8)


@pytest.mark.parametrize("optimizer", ["dls", "l-bfgs"])
def test_the_order_of_samples_changes_nothing(rng, optimizer):
    Y, order = curved(rng, 20), rng.permutation(20)
    S = Y @ Y.T
    model, other = (
        GPLVM(mu=1e-2, optimizer=optimizer).fit_gram(gram, 40) for gram in (S, S[np.ix_(order, order)])
    )
    np.testing.assert_allclose(other.embedding_, model.embedding_[order], atol=1e-3)  # rounding, amplified


def test_fits_repeat_bit_for_bit(rng):
    Y = curved(rng, 15)
    for optimizer in OPTIMIZERS:
        a, b = (GPLVM(optimizer=optimizer, max_iter=20).fit(Y).embedding_ for _ in range(2))
        assert np.array_equal(a, b)


def test_gauge_is_centred_with_longer_tails_positive(rng):
    X = fix_gauge(rng.normal(size=(9, 3)) + 5.0)
    np.testing.assert_allclose(X.mean(axis=0), 0.0, atol=1e-14)
    assert np.all(np.sum(X**3, axis=0) > 0)


@pytest.mark.parametrize("larger", [0, 1, 2, 3])
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_gauge_of_a_symmetric_axis_does_not_depend_on_rounding(sense, larger):
    """Two materials, for example, are at -1 and 1."""
    X = np.array([[-1.0], [1.0], [0.5], [-0.5]])
    rounded = X.copy()
    rounded[larger] *= 1.0 + 4.0 * np.finfo(float).eps
    np.testing.assert_allclose(fix_gauge(sense * rounded), -X, atol=1e-14)


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_gauge_keeps_its_sense_where_the_largest_entries_are_as_good_as_equal(sense):
    X = np.array([[1.0], [-1.0 - 1e-9], [0.7], [-0.3], [-0.4 + 1e-9]])
    np.testing.assert_allclose(fix_gauge(sense * X), fix_gauge(X + 1e-8 * np.sign(X)), atol=1e-7)


@pytest.mark.parametrize(("scale", "warning"), [(1e-4, FlatModelWarning), (1e4, IsolatedLatentsWarning)])
def test_latents_that_predict_little_of_each_other_are_warned_of(rng, scale, warning):
    Y = curved(rng, 10)
    gp = GaussianProcess(scale * rng.normal(size=(10, 2)), SquaredExponential(1e-3))
    with pytest.warns(warning):
        gp.warn_of_fit(Y @ Y.T)


@pytest.mark.parametrize(("scale", "is_linear"), [(0.01, True), (1.0, False)])
def test_a_kernel_that_does_not_bend_between_its_latents_is_linear(rng, scale, is_linear):
    gp = GaussianProcess(scale * rng.normal(size=(10, 2)), SquaredExponential(1e-4))
    a, b, halfway = gp.weights(scale * np.array([[-0.5, -0.4], [0.6, 0.5], [0.05, 0.05]]))
    bend = np.linalg.norm(halfway - 0.5 * (a + b)) / np.linalg.norm(a - b)
    assert (bend < 0.01) == is_linear  # of six draws: at most 0.0003 and at least 0.19
    assert gp.is_linear == is_linear


def test_a_usual_fit_is_not_warned_of(rng):
    with warnings.catch_warnings(record=True) as seen:
        GPLVM(optimizer="l-bfgs").fit(curved(rng, 20))
    assert not seen


def test_data_and_their_gram_matrix_give_the_same_latents(rng):
    Y = curved(rng, 15) + 2.0
    by_data = GPLVM(max_iter=3).fit(Y)
    by_gram = GPLVM(max_iter=3).fit_gram(Y @ Y.T, 40)
    np.testing.assert_allclose(by_data.embedding_, by_gram.embedding_, atol=1e-6)  # cancellation in S
    assert by_data.output_variance_ == pytest.approx(by_gram.output_variance_, rel=1e-6)


def test_training_samples_embed_at_their_latents_and_decode_bit_for_bit(rng):
    Y = curved(rng, 15)
    model = GPLVM(max_iter=10).fit(Y)
    assert np.array_equal(model.transform(Y), model.embedding_)
    assert np.array_equal(model.inverse_transform(model.embedding_), Y)
    assert np.array_equal(model.std(model.embedding_), np.zeros(15))


def test_a_new_sample_embeds_where_no_nearby_latent_is_better(rng):
    Y = curved(rng, 31)
    model = GPLVM(prior=0.1, max_iter=50).fit(Y[:30])
    y = Y[30]
    x = model.transform(y[None])[0]
    Y_c = Y[:30] - Y[:30].mean(axis=0)

    def cost(x):
        mean, variance = reference.posterior(model.embedding_, Y_c, x[None], model.mu, 1.0)
        squared = np.sum((y - Y[:30].mean(axis=0) - mean[0]) ** 2)
        prior = 0.05 * np.sum(x**2)
        return 0.5 * np.log(variance[0]) + 0.5 * squared / (40 * model.output_variance_ * variance[0]) + prior

    here = cost(x)
    for other in x + 0.05 * rng.normal(size=(50, 2)):
        assert here <= cost(other) + 1e-4  # L-BFGS stops at a relative decrease of 1e-9 to 1e-5
    assert all(here <= cost(latent + 1e-9) + 1e-4 for latent in model.embedding_)


def test_callback_reports_falling_objectives_and_can_stop(rng):
    seen = []

    def stop(iteration, objective):
        seen.append((iteration, objective))
        if iteration == 3:
            raise StopIteration

    for optimizer in OPTIMIZERS:
        seen.clear()
        model = GPLVM(optimizer=optimizer).fit(curved(rng, 15), callback=stop)
        assert [iteration for iteration, _ in seen] == [1, 2, 3]
        assert model.n_iter_ == 3
        assert model.objective_ == pytest.approx(min(value for _, value in seen), abs=1e-6)


def test_duplicated_samples_are_embedded(rng):
    Y = curved(rng, 12)
    Y[7] = Y[3]
    model = GPLVM(max_iter=30).fit(Y)
    assert np.all(np.isfinite(model.embedding_))
    assert np.linalg.norm(model.embedding_[7] - model.embedding_[3]) < 0.5


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"optimizer": "adam"}, "dls, l-bfgs"),
        ({"mu": 0.0}, "mu = 0.0"),
        ({"prior": -1.0}, "prior"),
    ],
)
def test_impossible_parameters_are_refused(rng, parameters, message):
    with pytest.raises(UsageError, match=message):
        GPLVM(**parameters).fit(rng.normal(size=(5, 3)))


@pytest.mark.parametrize(
    ("S", "message"),
    [
        (np.ones((3, 4)), "expected"),
        (np.full((3, 3), np.nan), "non-finite"),
        (np.arange(9.0).reshape(3, 3), "not symmetric"),
    ],
)
def test_what_is_no_gram_matrix_is_refused(S, message):
    with pytest.raises(ShapeError, match=message):
        GPLVM().fit_gram(S, 10)


@pytest.mark.parametrize("count", [3, 6, 8])
def test_samples_that_differ_by_rounding_only_are_refused(count):
    row = np.random.default_rng(1).random(5)
    Y = np.tile(row, (count, 1))
    for fit in (lambda: GPLVM().fit(Y), lambda: GPLVM().fit_gram(Y @ Y.T, 5)):
        with pytest.raises(ShapeError, match="samples are identical"):
            fit()


@pytest.mark.parametrize("mu", [0.0, -1.0, np.nan, np.inf, 1e300])
def test_noise_filters_that_cannot_be_used_are_refused(mu, rng):
    with pytest.raises(UsageError, match=r"mu = .*, expected 1e-10 to 1e\+06"):
        GPLVM(mu=mu).fit(curved(rng, 10))
