"""Claims about the sparse latent variable model."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import reference
from sklearn.utils.estimator_checks import parametrize_with_checks

from manifold.errors import ShapeError, UsageError
from manifold.gplvm import GPLVM
from manifold.latent.kernels import KERNELS, SquaredExponential, kernel_named
from manifold.latent.objective import LatentObjective, centre_gram
from manifold.latent.sparse import SparseGPLVM
from manifold.latent.sparse_objective import (
    SparseObjective,
    minimise,
    pca_start_of_factor,
)


# A few iterations exercise every path; hundreds would only cost time.
@parametrize_with_checks([SparseGPLVM(max_iter=4, n_inducing=8)])
def test_model_follows_scikit_learn(estimator, check):
    check(estimator)


def curved(rng, n=40, d=12, q=2):
    """Outputs that depend smoothly on q hidden coordinates, with little noise."""
    Y = np.tanh(rng.normal(size=(n, q)) @ rng.normal(size=(q, d))) + 0.01 * rng.normal(size=(n, d))
    return Y - Y.mean(axis=0)


def bound_written_out(X, Z, Y, mu, length_scale):
    """The variational bound by plain inverses of N x N matrices, jitter left out."""
    N, D = Y.shape
    K_uu = reference.covariance_matrix(Z, Z, 0.0, length_scale)
    K_uf = reference.covariance_matrix(Z, X, 0.0, length_scale)
    Q = K_uf.T @ np.linalg.inv(K_uu) @ K_uf
    R = Q + mu * np.eye(N)
    s2 = np.trace(np.linalg.inv(R) @ Y @ Y.T) / (N * D)
    return 0.5 * np.linalg.slogdet(R)[1] + 0.5 * N * np.log(s2) + (N - np.trace(Q)) / (2 * mu)


def test_objective_is_the_bound_written_out(rng):
    Y, X, Z = curved(rng, 15), rng.normal(size=(15, 2)), 2.0 * rng.normal(size=(5, 2))
    expected = bound_written_out(X, Z, Y, 1e-2, 1.3)
    found = SparseObjective(Y, 12, SquaredExponential(1e-2, 1.3))(X, Z)[0]
    assert found == pytest.approx(expected, rel=1e-5)  # the jitter is 1e-5 of mu


@pytest.mark.parametrize(("kernel", "prior"), [*((kernel, 0.0) for kernel in KERNELS), ("se", 0.3)])
def test_gradients_agree_with_central_differences(rng, kernel, prior):
    Y, X, Z = curved(rng, 20), rng.normal(size=(20, 2)), rng.normal(size=(6, 2))
    objective = SparseObjective(Y, 12, kernel_named(kernel, 1e-2, 1.2), prior)
    _, dX, dZ = objective(X, Z)
    numeric_X = reference.central_differences(lambda x: objective(x, Z)[0], X)
    numeric_Z = reference.central_differences(lambda z: objective(X, z)[0], Z)
    # h = 1e-5: truncation h^2 and rounding eps kappa / h are both near 1e-8 of the largest entry.
    np.testing.assert_allclose(dX, numeric_X, rtol=0, atol=1e-6 * np.abs(numeric_X).max())
    np.testing.assert_allclose(dZ, numeric_Z, rtol=0, atol=1e-6 * np.abs(numeric_Z).max())


@pytest.mark.parametrize(("name", "prior"), [*((kernel, 0.0) for kernel in KERNELS), ("se", 0.3)])
def test_bound_meets_the_exact_objective_where_inducing_points_are_the_latents(rng, name, prior):
    kernel = kernel_named(name, 1e-2)
    Y, X = curved(rng, 25), 2.0 * rng.normal(size=(25, 2))
    exact, gradient = LatentObjective(Y @ Y.T, 12, kernel, prior)(X)
    F, dX, dZ = SparseObjective(Y, 12, kernel, prior)(X, X)
    # The jitter, 1e-5 of mu, counts N / 2 * 1e-5 = 1.25e-4 in the trace, and as much again through Q.
    assert exact <= F <= exact + 3e-4
    # The bound is stationary in Z where it is tight: latents alone carry the derivative.
    np.testing.assert_allclose(dX + dZ, gradient, rtol=0, atol=1e-4 * np.abs(gradient).max())


def test_weights_are_the_predictions(rng):
    Y = curved(rng) + 1.0
    model = SparseGPLVM(n_inducing=8, max_iter=20).fit(Y)
    x = rng.normal(size=(5, 2))
    np.testing.assert_allclose(model.weights(x) @ Y, model.inverse_transform(x), atol=1e-8)
    np.testing.assert_allclose(model.weights(x).sum(axis=1), 1.0)


def test_fitting_lowers_the_bound_and_half_the_inducing_points_suffice(rng):
    Y = curved(rng, 60)
    model = SparseGPLVM(n_inducing=30, mu=1e-2).fit(Y)
    exact = GPLVM(mu=1e-2, optimizer="l-bfgs").fit(Y)
    gain = exact.objective_start_ - exact.objective_
    assert model.objective_ < model.objective_start_
    own = LatentObjective(centre_gram(Y @ Y.T), 12, SquaredExponential(1e-2))(model.embedding_)[0]
    assert own <= model.objective_
    assert exact.objective_start_ - own > 0.8 * gain


def test_a_factor_of_the_gram_matrix_serves_as_the_data(rng):
    Y = curved(rng, 20, d=100)
    values, vectors = np.linalg.eigh(Y @ Y.T)
    factor = vectors[:, 1:] * np.sqrt(values[1:])  # 19 columns: centred data have no more
    by_data = SparseGPLVM(n_inducing=8, max_iter=5).fit(Y)
    by_factor = SparseGPLVM(n_inducing=8, max_iter=5).fit_factor(factor, 100)
    np.testing.assert_allclose(by_data.embedding_, by_factor.embedding_, atol=1e-6)
    assert by_data.output_variance_ == pytest.approx(by_factor.output_variance_, rel=1e-6)


def test_training_samples_embed_at_their_latents(rng):
    Y = curved(rng)
    model = SparseGPLVM(n_inducing=10, max_iter=10).fit(Y)
    assert np.array_equal(model.transform(Y), model.embedding_)


def test_a_new_sample_embeds_where_no_nearby_latent_is_better(rng):
    Y = curved(rng)
    model = SparseGPLVM(n_inducing=15, mu=1e-2, prior=0.1).fit(Y[:39])
    x = model.transform(Y[39:])[0]

    def cost(x):
        variance = (model.std(x[None])[0]) ** 2 / model.output_variance_
        squared = np.sum((Y[39] - model.inverse_transform(x[None])[0]) ** 2)
        fit = 0.5 * squared / (12 * model.output_variance_ * variance)
        return 0.5 * np.log(variance) + fit + 0.05 * np.sum(x**2)

    here = cost(x)
    for other in [*(x + 0.05 * rng.normal(size=(50, 2))), *model.embedding_]:
        assert here <= cost(other) + 1e-4  # L-BFGS stops at a relative decrease of 1e-9 to 1e-5


def test_inducing_points_can_stay_where_they_are(rng):
    Y = curved(rng)
    X0 = pca_start_of_factor(Y, 2)
    objective = SparseObjective(Y, 12, SquaredExponential(1e-2))
    X, Z, _, _ = minimise(objective, X0, X0[:8], move_inducing=False, max_iter=5)
    assert np.array_equal(Z, X0[:8])
    assert not np.array_equal(X, X0)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [({"n_inducing": 0}, "n_inducing = 0"), ({"mu": 1e-12}, "mu = 1e-12"), ({"prior": -1.0}, "prior")],
)
def test_impossible_parameters_are_refused(rng, parameters, message):
    with pytest.raises(UsageError, match=message):
        SparseGPLVM(**parameters).fit(rng.normal(size=(5, 3)))


def test_identical_samples_and_wrong_starts_are_refused(rng):
    with pytest.raises(ShapeError, match="all 4 samples are identical"):
        SparseGPLVM().fit(np.ones((4, 3)))
    with pytest.raises(ShapeError, match="expected \\(5, 2\\)"):
        SparseGPLVM().fit_factor(rng.normal(size=(5, 3)), 3, X0=np.zeros((4, 2)))
    with pytest.raises(ShapeError, match="n_outputs = 0"):
        SparseGPLVM().fit_factor(rng.normal(size=(5, 3)), 0)
