"""Embedding by likelihood: the gradient is right, training samples find themselves, variances tell errors."""

from __future__ import annotations

import numpy as np
import pytest

from manifold.gplvm import GPLVM
from manifold.gpr import GPWeights
from manifold.models.kernels import SquaredExponential
from manifold.models.likelihood_encoding import LikelihoodEncoder

N, BANDS, D = 8, 2, 300


@pytest.fixture
def curves(rng):
    """Samples of smooth functions of two structure coordinates and a colour, and their process."""
    structure = np.repeat(rng.normal(size=(N, 2)), BANDS, axis=0)
    X = np.hstack([structure, rng.normal(size=(N * BANDS, 1))])
    frequencies, phases = rng.normal(size=(3, D)), rng.uniform(0, 2 * np.pi, D)
    gp = GPWeights(X, SquaredExponential(1e-3))
    return gp, lambda x: np.cos(0.7 * x @ frequencies + phases)


def test_the_gradient_agrees_with_differences(curves, rng):
    gp, values = curves
    Y = values(gp.X)
    encoder = LikelihoodEncoder(gp, Y @ Y.T, D, 2, BANDS, prior=0.1)
    cross, norm = rng.normal(size=(BANDS, N * BANDS)), np.full(BANDS, 50.0)
    objective = encoder.objective(cross, norm)
    z = 0.5 * rng.normal(size=2 + BANDS)
    gradient = objective(z)[1]
    h = 1e-6
    for k, e in enumerate(np.eye(len(z))):
        difference = (objective(z + h * e)[0] - objective(z - h * e)[0]) / (2 * h)
        assert gradient[k] == pytest.approx(difference, rel=1e-5, abs=1e-6)


def test_rows_of_a_material_share_their_structure_and_a_known_one_is_found(curves):
    gp, values = curves
    Y = values(gp.X)
    encoder = LikelihoodEncoder(gp, Y @ Y.T, D, 2, BANDS)
    x = np.array([[0.2, -0.3, 0.1], [0.2, -0.3, 0.6]])
    y = values(x)
    found = encoder.encode(y @ Y.T, np.sum(y * y, axis=1))
    np.testing.assert_array_equal(found[0, :2], found[1, :2])
    wrong = np.linalg.norm(gp.weights(found) @ Y - y, axis=1)
    expected = np.sqrt(D * encoder.output_variance * gp.variance(found))
    assert np.all(wrong < 3.0 * expected)
    others = np.linalg.norm(Y[:, None] - y[None], axis=2).min(axis=0)
    assert np.all(wrong < others)


def test_of_whole_materials_it_is_the_embedding_of_the_gplvm(rng):
    """Two implementations of one objective: `GPLVM.transform_gram` by likelihood."""
    Y = rng.normal(size=(10, 3)) @ rng.normal(size=(3, D))
    fitted = GPLVM(2, optimizer="l-bfgs", prior=0.05).fit_gram(Y[1:] @ Y[1:].T, D)
    cross, norm = (Y[:1] @ Y[1:].T), np.sum(Y[:1] ** 2, axis=1)
    encoder = LikelihoodEncoder(fitted.gp_, Y[1:] @ Y[1:].T, D, 2, prior=0.05)
    theirs, mine = fitted.transform_gram(cross, norm), encoder.encode(cross, norm)
    mean = Y[1:].mean(axis=0)
    y = Y[:1] - mean
    objective = encoder.objective(y @ (Y[1:] - mean).T, np.sum(y * y, axis=1))
    assert objective(mine[0])[0] <= objective(theirs[0])[0] + 1e-3
