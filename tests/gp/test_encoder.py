"""The encoder: gradients of all criteria, training materials found again, and what each criterion is best at."""

from __future__ import annotations

import numpy as np
import pytest

from manifold.core.metrics import cube_root_error, relative_error
from manifold.gp.encoding import Decoder, Encoder, Products, decoded_error, likelihood, mapped_residual
from manifold.gp.kernels import kernel_named
from manifold.gplvm import GPLVM
from manifold.gpr import GaussianProcess
from manifold.registries import MAPPINGS

N, P = 12, 60
WAYS = ("values", "residual", "likelihood")


@pytest.fixture
def values(rng):
    """Materials (N, P) of one gloss and one colour: positive and smooth in both."""
    gloss, colour = rng.uniform(0.2, 1.0, (N, 1)), rng.uniform(0.05, 1.0, (N, 1))
    t = np.linspace(0.0, 1.0, P)
    return colour * (1.0 + t) + 2.0 * gloss * np.exp(-((t - 0.5) ** 2) / (0.02 + 0.1 * gloss))


def decoder_of(values, gp, mapping="cube-root"):
    T = MAPPINGS[mapping]
    return Decoder(gp, T.forward(values[..., None])[..., 0], T, np.linspace(0.2, 1.0, P))


def products_of(decoder, f):
    T = decoder.map(f[None])[0]
    weighted = T * decoder.cosines
    return decoder.mapped @ weighted, float(weighted @ T)


def encoded(way, decoder, f, prior=0.0):
    enc = Encoder.of_decoder(decoder, prior)
    if way == "values":
        return enc.by_values(decoder, f)
    return {"residual": enc.by_residual, "likelihood": enc.by_likelihood}[way](*products_of(decoder, f))


def criterion_of(way, enc, decoder, f):
    if way == "values":
        return decoded_error(decoder, f)
    products = Products.centred(enc.S, *products_of(decoder, f))
    return mapped_residual(products) if way == "residual" else likelihood(products, P * enc.output_variance)


def fitted(values):
    mapped = np.cbrt(values) * np.sqrt(np.linspace(0.2, 1.0, P))
    return GPLVM(2, optimizer="l-bfgs").fit_gram(mapped @ mapped.T, P).gp_


@pytest.mark.parametrize("mapping", sorted(MAPPINGS))
@pytest.mark.parametrize("way", WAYS)
def test_gradients_agree_with_differences(values, rng, mapping, way):
    decoder = decoder_of(
        values, GaussianProcess(rng.standard_normal((N, 3)), kernel_named("se", 1e-3)), mapping
    )
    enc = Encoder.of_decoder(decoder, 0.1)
    criterion, x = criterion_of(way, enc, decoder, values[0] * 1.1), rng.standard_normal(3)
    gradient, h = enc.value_and_gradient(criterion, x)[1], 1e-5
    for i, e in enumerate(h * np.eye(3)):
        difference = enc.value_and_gradient(criterion, x + e)[0] - enc.value_and_gradient(criterion, x - e)[0]
        # Central differences: h^2 of the third derivative, and rounding of values of order 10 over h.
        assert gradient[i] == pytest.approx(difference / (2 * h), rel=1e-4, abs=1e-5 * np.abs(gradient).max())


@pytest.mark.parametrize("way", WAYS)
def test_a_left_out_material_is_encoded_and_decoded(values, way):
    decoder = decoder_of(values[1:], fitted(values[1:]))
    found = decoder.decode(encoded(way, decoder, values[0])[None])[0]
    nearest = min(relative_error(values[0][:, None], other[:, None]) for other in values[1:])
    assert relative_error(values[0][:, None], found[:, None]) < nearest


@pytest.mark.parametrize("way", WAYS)
def test_a_training_material_finds_itself(values, way):
    decoder = decoder_of(values, fitted(values))
    # The noise filter mu smooths a little everywhere but at the latent itself.
    assert decoder.relative_error(encoded(way, decoder, values[3])[None], values[3][None]) < 0.01


def test_every_criterion_is_least_where_it_was_minimised(values):
    """On its own terms no criterion is beaten by the latents that another one finds."""
    decoder = decoder_of(values[1:], fitted(values[1:]))
    enc, found = Encoder.of_decoder(decoder), {way: encoded(way, decoder, values[0]) for way in WAYS}
    for way in WAYS:
        criterion = criterion_of(way, enc, decoder, values[0])
        own = enc.value_and_gradient(criterion, found[way])[0]
        for other in WAYS:
            assert own <= enc.value_and_gradient(criterion, found[other])[0] + 1e-4, (way, other)


def test_decoded_values_are_near_in_cube_roots(values):
    decoder = decoder_of(values[1:], fitted(values[1:]), "cube-root")
    f, w = values[0][:, None], decoder.cosines
    by = {way: decoder.decode(encoded(way, decoder, values[0])[None])[0][:, None] for way in WAYS}
    assert min(WAYS, key=lambda way: cube_root_error(f, by[way], w)) == "values"


def test_products_are_about_the_mean_of_the_samples(rng):
    Y, y = rng.normal(size=(6, 40)) + 3.0, rng.normal(size=40)
    products = Products.centred(Y @ Y.T, Y @ y, float(y @ y))
    np.testing.assert_allclose(products.distances, ((y - Y) ** 2).sum(axis=1), rtol=1e-9)
    V = rng.normal(size=6)
    V /= V.sum()
    assert products.residual(V)[0] == pytest.approx(np.sum((y - V @ Y) ** 2), rel=1e-9)


def test_likelihood_knows_its_error(rng):
    """Samples of smooth functions of three coordinates, the process given."""
    X = rng.normal(size=(N, 3))
    frequencies, phases = rng.normal(size=(3, 300)), rng.uniform(0, 2 * np.pi, 300)
    gp = GaussianProcess(X, kernel_named("se", 1e-3))

    def of(x):
        return np.cos(0.7 * x @ frequencies + phases)

    Y, y = of(X), of(np.array([0.2, -0.3, 0.1]))
    enc = Encoder(gp, Y @ Y.T, 300)
    found = enc.by_likelihood(Y @ y, float(y @ y))[None]
    wrong = np.linalg.norm(gp.weights(found)[0] @ Y - y)
    assert wrong < 3.0 * np.sqrt(300 * enc.output_variance * gp.variance(found)[0])
    assert wrong < np.linalg.norm(Y - y, axis=1).min()
