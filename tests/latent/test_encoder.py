"""The encoder: gradients of all criteria, training materials found again, and what each criterion is best at."""

from __future__ import annotations

import numpy as np
import pytest

from manifold.gplvm import GPLVM
from manifold.gpr import GPWeights
from manifold.latent.criteria import CRITERIA, Products
from manifold.latent.decoder import Decoder
from manifold.latent.encoder import Encoder
from manifold.latent.kernels import kernel_named
from manifold.latent.per_band import MonochromeGPLVM
from manifold.mapping import MAPPINGS, mapping_named
from manifold.metrics import relative_error

N, B, P = 8, 3, 60
_FITTED = {}


@pytest.fixture
def values(rng):
    """Materials (N, B, P) of one gloss and one colour per band: positive and smooth in both."""
    gloss, colour = rng.uniform(0.2, 1.0, (N, 1, 1)), rng.uniform(0.05, 1.0, (N, B, 1))
    t = np.linspace(0.0, 1.0, P)
    return colour * (1.0 + t) + 2.0 * gloss * np.exp(-((t - 0.5) ** 2) / (0.02 + 0.1 * gloss))


def encoder(values, gp, n_structure, *, group=B, mapping="cube-root", prior=0.0, criterion="decoded"):
    T = mapping_named(mapping)
    mapped = T.forward(values.reshape(-1, values.shape[-1])[..., None])[..., 0]
    decoder = Decoder(gp, mapped, T, np.linspace(0.2, 1.0, values.shape[-1]))
    return Encoder.of_decoder(decoder, n_structure, group, prior, criterion)


def fitted(values, n_structure=2, n_colour=1, prior=0.1):
    """A process on the bands of materials (N, B, P), by the cube roots of their values; the same for all tests."""
    key = (values.tobytes(), n_structure, n_colour, prior)
    if key not in _FITTED:
        mapped = np.cbrt(values).reshape(-1, P) * np.sqrt(np.linspace(0.2, 1.0, P))
        model = MonochromeGPLVM(n_structure, n_colour, prior=prior)
        _FITTED[key] = model.fit_gram(mapped @ mapped.T, len(values), P).gp_
    return _FITTED[key]


def criterion_of(enc, f):
    return (
        enc._by_values(f) if enc.criterion in ("decoded", "cube-root") else enc._by_products(enc._products(f))
    )


@pytest.mark.parametrize("mapping", sorted(MAPPINGS))
@pytest.mark.parametrize("criterion", CRITERIA)
def test_gradients_agree_with_differences(values, rng, mapping, criterion):
    gp = GPWeights(rng.standard_normal((N * B, 3)), kernel_named("se", 1e-3))
    enc = encoder(values, gp, 2, mapping=mapping, prior=0.1, criterion=criterion)
    _check_gradient(
        enc, criterion_of(enc, values[0] * rng.uniform(0.8, 1.2, (B, 1))), rng.standard_normal((B, 3))
    )


def _check_gradient(enc, criterion, x):
    gradient = enc.value_and_gradient(criterion, x)[1]
    h = 1e-5
    for i in np.ndindex(*x.shape):
        e = np.zeros_like(x)
        e[i] = h
        difference = enc.value_and_gradient(criterion, x + e)[0] - enc.value_and_gradient(criterion, x - e)[0]
        # Central differences: h^2 of the third derivative, and rounding of values of order 10 over h.
        assert gradient[i] == pytest.approx(difference / (2 * h), rel=1e-4, abs=1e-5 * np.abs(gradient).max())


@pytest.mark.parametrize("criterion", CRITERIA)
@pytest.mark.parametrize(("n_structure", "n_colour"), [(2, 1), (0, 2), (1, 2)])
def test_a_held_out_material_is_encoded_and_decoded(values, n_structure, n_colour, criterion):
    enc = encoder(values[1:], fitted(values[1:], n_structure, n_colour), n_structure, criterion=criterion)
    latents = enc.encode(values[0])
    assert latents.shape == (B, n_structure + n_colour)
    np.testing.assert_array_equal(latents[:, :n_structure], np.tile(latents[0, :n_structure], (B, 1)))
    # Two numbers make these materials; the mean of the others is off by 0.3 to 0.6.
    assert enc.decoder.relative_error(latents, values[0]) < 0.1


@pytest.mark.parametrize("criterion", CRITERIA)
def test_a_training_material_finds_itself(values, criterion):
    enc = encoder(values, fitted(values, prior=0.0), 2, criterion=criterion)
    # The noise filter mu smooths a little everywhere but at the latent itself.
    assert enc.decoder.relative_error(enc.encode(values[3]), values[3]) < 0.01


def test_whole_materials_are_encoded_as_one_row(values):
    flat = values.reshape(N, B * P)
    mapped = np.cbrt(flat[1:])
    gp = GPLVM(2, optimizer="l-bfgs").fit_gram(mapped @ mapped.T, B * P).gp_
    enc = encoder(flat[1:], gp, 2, group=1)
    latent = enc.encode(flat[:1])
    assert latent.shape == (1, 2)
    mean = flat[1:].mean(axis=0)
    assert enc.decoder.relative_error(latent, flat[:1]) < relative_error(flat[0], mean)


def test_every_criterion_is_least_where_it_was_minimised(values):
    """On its own terms no criterion is beaten by the latents that another one finds."""
    gp = fitted(values[1:], 1, 1)
    by = {name: encoder(values[1:], gp, 1, criterion=name) for name in CRITERIA}
    found = {name: enc.encode(values[0]) for name, enc in by.items()}
    for name, enc in by.items():
        criterion = criterion_of(enc, values[0])
        own = enc.value_and_gradient(criterion, found[name])[0]
        for other in CRITERIA:
            assert own <= enc.value_and_gradient(criterion, found[other])[0] + 1e-4, (name, other)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_one_colour_by_table_is_that_of_a_search(values, criterion):
    gp = fitted(values)
    enc = encoder(values, gp, 2, criterion=criterion)
    f, structure = values[2] * 1.01, gp.X[2 * B, :2]
    table = enc.encode_colours(structure, f)
    searched = np.concatenate([enc.search_colour(structure, row[None]) for row in f])
    # 257 nodes over the colours and their margin, and a parabola between them.
    np.testing.assert_allclose(table, searched, atol=0.02)


def test_products_are_about_the_mean_of_the_samples(rng):
    Y, y = rng.normal(size=(6, 40)) + 3.0, rng.normal(size=(2, 40))
    products = Products.centred(Y @ Y.T, y @ Y.T, np.sum(y * y, axis=1))
    np.testing.assert_allclose(products.distances, ((y[:, None] - Y) ** 2).sum(axis=2), rtol=1e-9)
    V = rng.normal(size=(2, 6))
    V /= V.sum(axis=1, keepdims=True)
    squared, _ = products.residual(V)
    np.testing.assert_allclose(squared, np.sum((y - V @ Y) ** 2, axis=1), rtol=1e-9)


def test_products_alone_serve_criteria_of_the_mapped_domain(values):
    gp = fitted(values[1:])
    for criterion in ("mapped", "likelihood"):
        enc = encoder(values[1:], gp, 2, criterion=criterion)
        T = np.cbrt(values[0])
        weighted = T * enc.decoder.cosines
        found = enc.encode_products(weighted @ enc.decoder.mapped.T, np.sum(weighted * T, axis=1))
        np.testing.assert_allclose(found, enc.encode(values[0]), atol=1e-9)


def test_likelihood_knows_its_error(rng):
    """Samples of smooth functions of two structure coordinates and a colour, the process given."""
    structure = np.repeat(rng.normal(size=(N, 2)), 2, axis=0)
    X = np.hstack([structure, rng.normal(size=(N * 2, 1))])
    frequencies, phases = rng.normal(size=(3, 300)), rng.uniform(0, 2 * np.pi, 300)
    gp = GPWeights(X, kernel_named("se", 1e-3))

    def of(x):
        return np.cos(0.7 * x @ frequencies + phases)

    Y, y = of(X), of(np.array([[0.2, -0.3, 0.1], [0.2, -0.3, 0.6]]))
    enc = Encoder(gp, Y @ Y.T, 300, 2, 2, criterion="likelihood")
    found = enc.encode_products(y @ Y.T, np.sum(y * y, axis=1))
    wrong = np.linalg.norm(gp.weights(found) @ Y - y, axis=1)
    assert np.all(wrong < 3.0 * np.sqrt(300 * enc.output_variance * gp.variance(found)))
    assert np.all(wrong < np.linalg.norm(Y[:, None] - y[None], axis=2).min(axis=0))
