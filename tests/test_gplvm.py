"""Claims about the latent variable model."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import reference
from sklearn.exceptions import NotFittedError
from sklearn.utils.estimator_checks import parametrize_with_checks
from threadpoolctl import threadpool_limits

from manifold.errors import ShapeError, UsageError
from manifold.gplvm import GPLVM, IncrementalObjective, LatentObjective, fix_gauge, pca_start
from manifold.gpr import FlatModelWarning, GPWeights, IsolatedLatentsWarning, centre_gram
from manifold.models.kernels import KERNELS, SquaredExponential, kernel_named
from manifold.models.per_band import MonochromeGPLVM


# A few rounds exercise every path; hundreds would only cost time.
@parametrize_with_checks([GPLVM(max_iter=4), GPLVM(max_iter=4, optimizer="l-bfgs")])
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
def test_ten_thousand_rank_two_updates_agree_with_a_fresh_factorisation(rng, prior, kernel):
    Y = curved(rng, 51)
    objective = objective_of(Y, prior=prior, kernel=kernel)
    moving = IncrementalObjective(objective, pca_start(objective.S, 2))
    worst = 0.0
    with threadpool_limits(1):  # small factorisations crawl on several threads
        for step in range(10_000):
            moving.try_move(int(rng.integers(102)), 0.05 * rng.normal())
            moving.commit()
            if step % 100 == 0 or step == 9_999:
                worst = max(worst, abs(moving.value - objective(moving.x.reshape(51, 2))[0]))
    assert worst < 1e-8
    assert moving.n_refactorisations < 5_000  # most moves are updates, or the test shows nothing


def test_a_rejected_move_changes_nothing(rng):
    objective = objective_of(curved(rng))
    X = pca_start(objective.S, 2)
    moving, other = IncrementalObjective(objective, X), IncrementalObjective(objective, X)
    moving.try_move(7, 0.4)
    moving.reject()
    assert np.array_equal(moving.x, other.x)
    assert moving.try_move(6, 0.1) == other.try_move(6, 0.1)


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


@pytest.mark.parametrize("optimizer", ["dls", "l-bfgs", "both"])
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


def test_search_gains_as_much_as_the_gradient_within_one_percent(rng):
    """Both are local and either may end in the better optimum, so the claim is one about several data sets."""
    ratios = []
    for prior in (0.0, 1.0):
        for _ in range(5):
            Y = curved(rng, 15)
            fits = [GPLVM(optimizer=name, prior=prior).fit(Y) for name in ("dls", "l-bfgs")]
            search, gradient = (model.objective_start_ - model.objective_ for model in fits)
            ratios.append(search / gradient)
    assert np.mean(np.array(ratios) >= 0.99) >= 0.8
    assert min(ratios) > 0.9


def test_more_starts_are_never_worse_than_the_first(rng):
    Y = curved(rng, 20, q=3)
    one = GPLVM(optimizer="l-bfgs", max_iter=30).fit(Y)
    several = GPLVM(optimizer="l-bfgs", max_iter=30, n_starts=4).fit(Y)
    assert several.objective_ <= one.objective_ + 1e-9  # rounding of one factorisation
    assert several.objective_start_ == one.objective_start_
    assert several.n_evaluations_ > 2 * one.n_evaluations_


def test_fits_repeat_bit_for_bit_with_the_same_random_state(rng):
    Y = curved(rng, 15)
    for optimizer in ("dls", "l-bfgs"):
        a, b = (GPLVM(optimizer=optimizer, n_starts=3, max_iter=20).fit(Y).embedding_ for _ in range(2))
        assert np.array_equal(a, b)
    other = GPLVM(n_starts=3, max_iter=20, random_state=1).fit(Y)
    assert np.all(np.isfinite(other.embedding_))


def test_both_optimizers_in_turn_are_never_worse_than_the_gradient_alone(rng):
    for n in (10, 20):
        Y = curved(rng, n, q=3)
        gradient = GPLVM(optimizer="l-bfgs", max_iter=50).fit(Y)
        both = GPLVM(optimizer="both", max_iter=50).fit(Y)
        assert both.objective_ <= gradient.objective_ + 1e-9


def test_gauge_is_centred_with_longer_tails_positive(rng):
    X = fix_gauge(rng.normal(size=(9, 3)) + 5.0)
    np.testing.assert_allclose(X.mean(axis=0), 0.0, atol=1e-14)
    assert np.all(np.sum(X**3, axis=0) > 0)


def test_gauge_of_symmetric_latents_has_the_largest_entry_positive():
    X = fix_gauge(np.array([[-2.0], [-1.0], [1.0], [2.0]]))
    assert X[0] == 2.0  # the first of the largest


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_gauge_keeps_its_sense_where_the_largest_entries_are_as_good_as_equal(sense):
    X = np.array([[1.0], [-1.0 - 1e-9], [0.7], [-0.3], [-0.4 + 1e-9]])
    np.testing.assert_allclose(fix_gauge(sense * X), fix_gauge(X + 1e-8 * np.sign(X)), atol=1e-7)


@pytest.mark.parametrize(("scale", "warning"), [(1e-4, FlatModelWarning), (1e4, IsolatedLatentsWarning)])
def test_latents_that_predict_little_of_each_other_are_warned_of(rng, scale, warning):
    Y = curved(rng, 10)
    gp = GPWeights(scale * rng.normal(size=(10, 2)), SquaredExponential(1e-3))
    with pytest.warns(warning):
        gp.warn_of_fit(Y @ Y.T)


def test_a_usual_fit_is_not_warned_of(rng):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        GPLVM(optimizer="l-bfgs").fit(curved(rng, 20))


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


@pytest.mark.parametrize("criterion", ["likelihood", "mapped"])
def test_a_new_sample_embeds_where_no_nearby_latent_is_better(rng, criterion):
    Y = curved(rng, 31)
    model = GPLVM(prior=0.1, max_iter=50).fit_gram(Y[:30] @ Y[:30].T, 40)
    y = Y[30]
    x = model.transform_gram((Y[:30] @ y)[None], np.array([y @ y]), criterion=criterion)[0]
    Y_c = Y[:30] - Y[:30].mean(axis=0)

    def cost(x):
        mean, variance = reference.posterior(model.embedding_, Y_c, x[None], model.mu, 1.0)
        squared = np.sum((y - Y[:30].mean(axis=0) - mean[0]) ** 2)
        prior = 0.05 * np.sum(x**2)
        if criterion == "mapped":
            return 0.5 * np.log(squared) + prior
        return 0.5 * np.log(variance[0]) + 0.5 * squared / (40 * model.output_variance_ * variance[0]) + prior

    here = cost(x)
    for other in x + 0.05 * rng.normal(size=(50, 2)):
        assert here <= cost(other) + 1e-4  # L-BFGS stops at a relative decrease of 1e-9 to 1e-5
    assert all(here <= cost(latent + 1e-9) + 1e-4 for latent in model.embedding_)


def test_adopted_latents_are_kept_bit_for_bit(rng):
    Y = curved(rng, 12)
    fitted = GPLVM(max_iter=5).fit_gram(Y @ Y.T, 40)
    adopted = GPLVM().adopt(Y @ Y.T, 40, fitted.embedding_)
    assert np.array_equal(adopted.embedding_, fitted.embedding_)
    assert adopted.output_variance_ == fitted.output_variance_
    x = rng.normal(size=(4, 2))
    assert np.array_equal(adopted.weights(x), fitted.weights(x))


def test_callback_reports_falling_objectives_and_can_stop(rng):
    seen = []

    def stop(iteration, objective):
        seen.append((iteration, objective))
        if iteration == 3:
            raise StopIteration

    for optimizer in ("dls", "l-bfgs", "both"):
        seen.clear()
        model = GPLVM(optimizer=optimizer).fit(curved(rng, 15), callback=stop)
        assert [iteration for iteration, _ in seen] == [1, 2, 3]
        assert model.n_iter_ == 3
        assert model.objective_ == pytest.approx(min(value for _, value in seen), abs=1e-6)


def test_an_interrupted_fit_leaves_the_model_unfitted(rng):
    def interrupt(iteration, objective):
        raise KeyboardInterrupt

    for optimizer in ("dls", "l-bfgs"):
        model = GPLVM(optimizer=optimizer)
        with pytest.raises(KeyboardInterrupt):
            model.fit(curved(rng, 10), callback=interrupt)
        with pytest.raises(NotFittedError):
            model.weights(np.zeros((1, 2)))


def test_identical_samples_are_refused():
    with pytest.raises(ShapeError, match="all 4 samples are identical"):
        GPLVM().fit(np.ones((4, 3)))


def test_duplicated_samples_are_embedded(rng):
    Y = curved(rng, 12)
    Y[7] = Y[3]
    model = GPLVM(max_iter=30).fit(Y)
    assert np.all(np.isfinite(model.embedding_))
    assert np.linalg.norm(model.embedding_[7] - model.embedding_[3]) < 0.5


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"optimizer": "adam"}, "dls, l-bfgs, both"),
        ({"mu": 0.0}, "mu = 0.0"),
        ({"prior": -1.0}, "prior"),
        ({"n_starts": 0}, "n_starts = 0"),
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


@pytest.mark.parametrize("seed", range(6))
def test_direct_local_search_is_never_worse_than_the_descent_from_the_same_start(seed):
    rng = np.random.default_rng(seed)
    factor = rng.normal(size=(18, 6)) * 2.0 ** -np.arange(6)
    S = np.tanh(factor) @ np.tanh(factor).T + 1e-3 * np.eye(18)
    ends = [
        GPLVM(2, optimizer=optimizer, random_state=0).fit_gram(S, 50).objective_
        for optimizer in ("dls", "l-bfgs")
    ]
    assert ends[0] <= ends[1] + 1e-9 * abs(ends[1])


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
    with pytest.raises(UsageError, match="mu = "):
        MonochromeGPLVM(2, 1, mu=mu)
