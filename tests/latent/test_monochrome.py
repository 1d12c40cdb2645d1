"""The monochrome manifold: what its bands share, and its limits."""

from __future__ import annotations

import numpy as np
import pytest

from manifold.errors import ShapeError, UsageError
from manifold.latent.per_band import MonochromeGPLVM, join_latents

N, B, P = 8, 3, 60


@pytest.fixture
def values(rng):
    """Materials (N, B, P) of one gloss and one colour per band: positive and smooth in both."""
    gloss, colour = rng.uniform(0.2, 1.0, (N, 1, 1)), rng.uniform(0.05, 1.0, (N, B, 1))
    t = np.linspace(0.0, 1.0, P)
    return colour * (1.0 + t) + 2.0 * gloss * np.exp(-((t - 0.5) ** 2) / (0.02 + 0.1 * gloss))


def gram(values):
    mapped = np.cbrt(values).reshape(-1, values.shape[-1])
    return mapped @ mapped.T


def test_bands_of_a_material_share_their_structure(values):
    model = MonochromeGPLVM(2, 1).fit_gram(gram(values), N, P)
    X = model.embedding_.reshape(N, B, 3)
    for n in range(N):
        np.testing.assert_array_equal(X[n, :, :2], np.tile(model.structure_[n], (B, 1)))
    np.testing.assert_array_equal(join_latents(model.structure_, model.colour_), X)


def test_refining_never_loses(values):
    model = MonochromeGPLVM(2, 1).fit_gram(gram(values), N, P)
    assert model.objective_ <= model.objective_start_


def test_matrices_that_cannot_be_gram_matrices_are_refused(values):
    S = gram(values)
    for wrong in (np.where(S.max() == S, np.nan, S), np.zeros_like(S), S + np.triu(np.ones_like(S), 1)):
        with pytest.raises(ShapeError):
            MonochromeGPLVM(2, 1).fit_gram(wrong, N, P)
    with pytest.raises(ShapeError):
        MonochromeGPLVM(2, 1).fit_gram(S, N, 0)
    for prior in (np.nan, -1.0, np.inf):
        with pytest.raises(UsageError, match="prior"):
            MonochromeGPLVM(2, 1, prior=prior)
