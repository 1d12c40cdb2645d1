"""Walks between two materials: what differs between them changes evenly, and analytic materials keep their model."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
import pytest
from helpers.small_library import small_library

from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import Plastic, RoughConductor
from manifold.brdf.plausibility import plausibility
from manifold.colour import ball_colours
from manifold.core.directions import from_spherical
from manifold.core.metrics import cube_root_error
from manifold.core.pairs import cosine_weight
from manifold.core.records import Bands
from manifold.gp.encoding import encoding_pairs
from manifold.model.manifold import Manifold
from manifold.model.walks import RoughenedBRDF, Walked, fit_highlight, roughness_at, step_of

PAIRS = encoding_pairs()


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return Manifold.fit(small_library(tmp_path_factory.mktemp("walks")), calibrate=False)


def metal(alpha):
    return RoughConductor(
        GGX.isotropic(alpha), np.array([0.14, 0.37, 1.44]), np.array([4.5, 2.3, 1.8]), Bands(None)
    )


def plastic(alpha):
    return Plastic(GGX.isotropic(alpha), np.array([1.5]), np.array([0.6, 0.05, 0.04]), Bands(None))


def error(f, f_star):
    return cube_root_error(f, f_star, cosine_weight(PAIRS.wi, PAIRS.wo))


@pytest.mark.parametrize("make", [metal, plastic])
@pytest.mark.parametrize("alphas", [(0.05, 0.2), (0.1, 0.4), (0.2, 0.6), (0.03, 0.5)])
def test_half_way_between_two_roughnesses_is_the_one_between_them(make, alphas):
    """At equal shares, beside the average of cube roots, which has two lobes."""
    a, b = ends = [make(alpha) for alpha in alphas]
    truth = make(np.sqrt(alphas[0] * alphas[1])).eval(PAIRS.wi, PAIRS.wo)
    found = step_of(ends, [Walked.of(end) for end in ends], 0.5).eval(PAIRS.wi, PAIRS.wo)
    roots = (0.5 * (np.cbrt(a.eval(PAIRS.wi, PAIRS.wo)) + np.cbrt(b.eval(PAIRS.wi, PAIRS.wo)))) ** 3
    assert error(truth, found) < error(truth, roots)


@pytest.mark.parametrize("make", [metal, plastic])
def test_the_roughness_of_an_analytic_material_is_found(make):
    for alpha in (0.03, 0.1, 0.3):
        found = roughness_at(fit_highlight(make(alpha)).position)
        assert 0.85 < found / alpha < 1.18  # one of the roughnesses, which are 16 % apart


def test_at_its_own_roughness_a_material_is_what_it_was():
    brdf = plastic(0.1)
    highlight = fit_highlight(brdf)
    found = RoughenedBRDF(brdf, highlight, highlight.position).eval(PAIRS.wi, PAIRS.wo)
    np.testing.assert_allclose(found, brdf.eval(PAIRS.wi, PAIRS.wo), rtol=1e-12)


def test_steps_look_equally_large_and_nothing_turns_back(model):
    """The highlight in mirror directions, and the lightness of the ball."""
    ball = ball_colours.ball()
    theta = np.deg2rad([20.0, 45.0, 60.0])
    wi, wo = from_spherical(theta, np.zeros(3)), from_spherical(theta, np.full(3, np.pi))
    for a, b in combinations(model.names[:4], 2):
        steps = [model.interpolate(a, b, t) for t in np.linspace(0.0, 1.0, 7).tolist()]
        pictures = [ball.xyz(step.eval(ball.wi, ball.wo), model.bands) for step in steps]
        sizes = [ball_colours.delta_e(*both) for both in pairwise(pictures)]
        assert max(sizes) < 1.2 * np.mean(sizes)
        assert sum(sizes) < 1.25 * ball_colours.delta_e(pictures[0], pictures[-1])
        gloss = np.log([step.eval(wi, wo).mean(axis=1) for step in steps])
        lightness = np.array([xyz[:, 1].mean() for xyz in pictures])
        assert np.all(np.abs(np.diff(gloss, axis=0)).sum(axis=0) <= np.abs(gloss[-1] - gloss[0]) + 0.2)
        assert np.abs(np.diff(lightness)).sum() <= np.abs(lightness[-1] - lightness[0]) + 0.01


def test_steps_are_reciprocal_never_negative_and_conserve_energy(model):
    for a, b in combinations(model.names[:4], 2):
        ends = [plausibility(model.material(name)) for name in (a, b)]
        found = plausibility(model.interpolate(a, b, 0.5))
        assert found.negative_share == 0.0
        assert found.max_albedo <= max(1.0, *(end.max_albedo for end in ends))
        assert found.reciprocity_error <= max(0.05, *(1.1 * end.reciprocity_error for end in ends))


def test_a_walk_backwards_has_the_same_steps(model):
    a, b = model.names[:2]
    ball = ball_colours.ball(6)
    there, back = (
        model.interpolate(*ends, t).eval(ball.wi, ball.wo) for ends, t in (((a, b), 0.3), ((b, a), 0.7))
    )
    np.testing.assert_allclose(there, back, rtol=1e-3)  # shares are interpolated between nodes of t
