"""The monochrome manifold and the encoder: gradients, recovery, and the limits of both."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import check_grad

from manifold.errors import ShapeError, UsageError
from manifold.gplvm import GPLVM
from manifold.gpr import GPWeights
from manifold.mapping import MAPPINGS, mapping_named
from manifold.models import encoding
from manifold.models.encoding import Decoder
from manifold.models.kernels import SquaredExponential
from manifold.models.per_band import MonochromeGPLVM, join_latents

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


def decoder(values, model, n_structure, group, mapping="cube-root", prior=0.0):
    T = mapping_named(mapping)
    ones = np.ones(values.shape[-1])
    mapped = T.forward(values.reshape(-1, values.shape[-1])[..., None])[..., 0]
    return Decoder(model.gp_, n_structure, group, mapped, T, ones, ones, prior)


def test_bands_of_a_material_share_their_structure(values):
    model = MonochromeGPLVM(2, 1).fit_gram(gram(values), N, P)
    X = model.embedding_.reshape(N, B, 3)
    for n in range(N):
        np.testing.assert_array_equal(X[n, :, :2], np.tile(model.structure_[n], (B, 1)))
    np.testing.assert_array_equal(join_latents(model.structure_, model.colour_), X)


def test_refining_never_loses(values):
    model = MonochromeGPLVM(2, 1).fit_gram(gram(values), N, P)
    assert model.objective_ <= model.objective_start_


def test_fitting_is_deterministic(values):
    a, b = (MonochromeGPLVM(2, 1).fit_gram(gram(values), N, P) for _ in range(2))
    np.testing.assert_array_equal(a.embedding_, b.embedding_)


@pytest.mark.parametrize("mapping", sorted(MAPPINGS))
@pytest.mark.parametrize("kind", ["mapped residual", "decoded error"])
def test_gradients_of_the_encoder_agree_with_differences(values, rng, mapping, kind):
    X = rng.standard_normal((N * B, 3))
    gp = GPWeights(X, SquaredExponential(1e-3))
    model = type("Fitted", (), {"gp_": gp})
    d = decoder(values, model, 2, B, mapping, prior=0.1)
    new = values[0] * rng.uniform(0.8, 1.2, (B, 1))
    if kind == "decoded error":
        objective = d._decoded_error(new)
    else:
        T = d.mapping.forward(new[..., None])[..., 0]
        objective = d._mapped_residual(d.mapped @ d.mapped.T, T @ d.mapped.T, np.sum(T * T, axis=1))
    V = gp.weights(rng.standard_normal((B, 3)))
    scale = np.abs(objective(V)[1]).max()
    error = check_grad(
        lambda v: objective(v.reshape(V.shape))[0],
        lambda v: objective(v.reshape(V.shape))[1].ravel(),
        V.ravel(),
        epsilon=1e-7,
    )
    assert error < 1e-4 * scale * np.sqrt(V.size)  # forward differences


@pytest.mark.parametrize(("n_structure", "n_colour"), [(2, 1), (0, 2), (1, 2)])
def test_a_held_out_material_is_encoded_and_decoded(values, n_structure, n_colour):
    train = values[1:]
    model = MonochromeGPLVM(n_structure, n_colour).fit_gram(gram(train), N - 1, P)
    d = decoder(train, model, n_structure, B)
    latents = d.encode(values[0])
    assert latents.shape == (B, n_structure + n_colour)
    np.testing.assert_allclose(latents[:, :n_structure], np.tile(latents[0, :n_structure], (B, 1)))
    error = np.linalg.norm(d.decode(latents) - values[0]) / np.linalg.norm(values[0])
    # Two numbers make these materials; the mean of the others is off by 0.3 to 0.6.
    assert error < 0.1


def test_encoding_a_training_material_finds_it(values):
    model = MonochromeGPLVM(2, 1, prior=0.0).fit_gram(gram(values), N, P)
    d = decoder(values, model, 2, B)
    found = d.decode(d.encode(values[3]))
    # The noise filter mu smooths a little everywhere but at the latent itself.
    assert np.linalg.norm(found - values[3]) < 0.01 * np.linalg.norm(values[3])


def test_whole_materials_are_encoded_as_one_row(values):
    flat = values.reshape(N, B * P)
    mapped = np.cbrt(flat[1:])
    model = GPLVM(2).fit_gram(mapped @ mapped.T, B * P)
    d = decoder(flat[1:, None, :], model, 2, 1)
    latent = d.encode(flat[:1])
    assert latent.shape == (1, 2)
    start = np.linalg.norm(flat[1:].mean(axis=0) - flat[0])
    assert np.linalg.norm(d.decode(latent)[0] - flat[0]) < start


def test_decoding_refines_the_mapped_residual(values):
    """The second stage minimises what reports measure, so it cannot end worse than it began."""
    train = values[1:]
    model = MonochromeGPLVM(1, 1).fit_gram(gram(train), N - 1, P)
    d = decoder(train, model, 1, B)
    error = d._decoded_error(values[0])
    latents = d.encode(values[0])
    T = np.cbrt(values[0])
    residual = d._mapped_residual(d.mapped @ d.mapped.T, T @ d.mapped.T, np.sum(T * T, axis=1))
    starts = d._starts(d.mapped @ d.mapped.T, T @ d.mapped.T, np.sum(T * T, axis=1))
    first = min((d._minimise(residual, s) for s in starts), key=lambda end: end[1])[0]
    assert error(model.gp_.weights(latents))[0] <= error(model.gp_.weights(first))[0]


def test_what_cannot_be_fitted_is_refused():
    with pytest.raises(UsageError, match="structure and 0 colour"):
        MonochromeGPLVM(2, 0)
    with pytest.raises(ShapeError, match="S has shape"):
        MonochromeGPLVM().fit_gram(np.eye(7), 3, 10)


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


def test_refining_more_ends_of_the_first_search_never_decodes_worse(values, monkeypatch):
    model = MonochromeGPLVM(2, 1).fit_gram(gram(values[1:]), N - 1, P)
    searched = decoder(values[1:], model, 2, B)
    errors = []
    for count in (1, 3):
        monkeypatch.setattr(encoding, "_REFINED", count)
        errors.append(searched.relative_error(searched.encode(values[0]), values[0]))
    assert errors[1] <= errors[0] + 1e-12
