"""Claims about maps whose places are blends: weights, layouts, colour paths, and the manifold made of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import reference
from helpers.places import inside_hull
from helpers.small_library import NAMES, measured, small_library
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from manifold.brdf.interface import all_isotropic
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import profile_pairs, valley_depth
from manifold.brdf.unmeasured_cells import fill_unmeasured
from manifold.colour import ball_colours
from manifold.core.directions import from_spherical
from manifold.core.errors import ShapeError
from manifold.library.store import Library
from manifold.model.blend_fitting import evaluate
from manifold.model.blending import (
    LayoutObjective,
    affinities,
    blend_layout,
    blend_weights,
    scaled,
    widest_gap,
)
from manifold.model.colour_paths import WHITE, fit_paths
from manifold.model.manifold import Manifold
from manifold.model.settings import BlendSettings


@given(st.integers(1, 8), st.integers(1, 3), st.integers(0, 10_000), st.floats(1e-3, 1e3))
@settings(max_examples=60, deadline=None)
def test_blend_weights_are_never_negative_and_sum_to_one(n, q, seed, spread):
    rng = np.random.default_rng(seed)
    X, x = spread * rng.normal(size=(n, q)), spread * rng.normal(size=(5, q))
    u = blend_weights(x, X)
    assert np.all(u >= 0.0)
    np.testing.assert_allclose(u.sum(axis=1), 1.0, rtol=1e-12)  # rounding
    np.testing.assert_array_equal(blend_weights(X[:1], X)[0, 0], 1.0)


def test_blend_weights_come_flat_to_a_unit_vector(rng):
    X = rng.normal(size=(6, 2))
    for distance in (1e-2, 1e-4, 1e-6):
        u = blend_weights(X[2:3] + distance * np.array([[0.6, 0.8]]), X)[0]
        assert 1.0 - u[2] < 50.0 * distance**2  # quadratic: the slope is 0; nearest neighbours are 0.2 away


def test_gradient_of_the_layout_agrees_with_central_differences(rng):
    others = np.array([np.delete(np.arange(6), i)[:4] for i in range(6)])
    affinity = rng.dirichlet(np.ones(4), size=6)
    objective = LayoutObjective(others, affinity)
    X = rng.normal(size=(6, 2))
    numeric = reference.central_differences(lambda x: objective.value(x, 1.5)[0], X)
    np.testing.assert_allclose(objective.value(X, 1.5)[1], numeric, rtol=1e-5, atol=1e-7)  # h = 1e-5


def test_the_objective_is_the_divergence_of_similarities_from_affinities(rng):
    X, N = rng.normal(size=(7, 2)), 7
    others = np.array([np.delete(np.arange(N), i) for i in range(N)])
    p = affinities(rng.uniform(0.5, 2.0, size=(N, N - 1)))
    apart = cdist(X, X)
    similarity = (1.0 + apart**2 / 3.0) ** -2 * (1.0 - np.eye(N))
    q = np.take_along_axis(similarity / similarity.sum(), others, axis=1)
    expected = -np.sum(p / N * np.log(q))
    found = LayoutObjective(others, p).value(X)[0]
    np.testing.assert_allclose(found, expected, rtol=1e-8)  # affinities below 1e-9 are left out


@pytest.mark.parametrize(("count", "perplexity"), [(100, 10.0), (25, 8.0), (6, 3.0), (3, 2.0)])
def test_few_samples_keep_fewer_neighbours_but_three_where_there_are_as_many(rng, count, perplexity):
    p = affinities(rng.uniform(0.1, 1.0, size=(count, count - 1)))
    entropy = -np.sum(p * np.log(np.maximum(p, 1e-300)), axis=1)
    np.testing.assert_allclose(np.exp(entropy), perplexity, rtol=1e-6)


def test_affinities_have_one_perplexity_and_leave_out_what_is_infinitely_far(rng):
    distance = rng.uniform(0.1, 1.0, size=(60, 59)) * rng.uniform(0.01, 100.0, size=(60, 1))
    distance[:, :5] = np.inf
    p = affinities(distance)
    assert np.all(p[:, :5] == 0.0)
    np.testing.assert_allclose(p.sum(axis=1), 1.0, rtol=1e-12)  # rounding
    some = p[:, 5:]
    np.testing.assert_allclose(
        np.exp(-np.sum(some * np.log(np.maximum(some, 1e-300)), axis=1)), 10.0, rtol=1e-6
    )


def test_neighbours_of_a_plane_stay_neighbours(rng):
    truth = rng.uniform(-1.0, 1.0, size=(80, 2))
    X = blend_layout(cdist(truth, truth), 2)
    before, after = (cdist(places, places) + np.diag(np.full(80, np.inf)) for places in (truth, X))
    near = [np.argsort(apart, axis=1)[:, :5] for apart in (before, after)]
    kept = np.mean([len(set(a) & set(b)) / 5 for a, b in zip(*(n.tolist() for n in near), strict=True)])
    assert kept > 0.8


@pytest.mark.parametrize("step", [1.0, 1.8])
@pytest.mark.parametrize("groups", [(0.0, 22.0, 34.0), (0.0, 20.0, 40.0), (0.0, 30.0, 50.0)])
def test_groups_on_a_line_keep_their_width(groups, step):
    """Three colours in four roughnesses: without noise between the stages one layout in four was a line."""
    across = [np.eye(2)[i % 2] * step * k for i in range(3) for k in range(4)]
    truth = np.column_stack([np.repeat(groups, 4), across])
    X = blend_layout(cdist(truth, truth), 2)
    widths = np.linalg.svd(X - X.mean(axis=0), compute_uv=False)
    assert widths[1] > 1e-2 * widths[0]  # a line has 1e-6


@pytest.mark.parametrize(("n", "q"), [(6, 4), (6, 5), (8, 6), (12, 8)])
def test_neighbours_are_within_reach_of_the_kernel_in_many_dimensions_too(rng, n, q):
    """Their hull is all but flat, whose volume says nothing of distances: they lay 10 to 300 length scales apart."""
    X = rng.normal(size=(n, q)) * 0.3 ** np.arange(q)
    found = scaled(blend_layout(cdist(X, X), q), X[:, 0])
    apart = cdist(found, found) + np.diag(np.full(n, np.inf))
    assert 0.5 < np.median(apart.min(axis=1)) <= 2.5 + 1e-9


def test_the_last_axis_is_the_direction_of_lightness(rng):
    X = rng.normal(size=(30, 3))
    found = scaled(X, X @ [3.0, -1.0, 2.0])
    upwards = np.linalg.lstsq(found - found.mean(axis=0), X @ [3.0, -1.0, 2.0])[0]
    np.testing.assert_allclose(upwards[:2] / upwards[2], 0.0, atol=1e-9)  # rounding
    assert upwards[2] > 0.0
    ratio = cdist(found, found) / np.maximum(cdist(X, X), 1e-12)
    np.testing.assert_allclose(ratio[np.triu_indices(30, 1)], ratio[0, 1], rtol=1e-9)  # turned, and scaled


def test_places_inside_the_hull_are_drawn_evenly(rng):
    X = np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 1.0], [4.0, 1.0], [1.0, 0.2]])
    shares = inside_hull(X, 1500, rng)
    np.testing.assert_allclose(shares.sum(axis=1), 1.0, rtol=1e-12)  # rounding
    assert shares.min() >= 0.0
    assert np.all(np.count_nonzero(shares, axis=1) <= 3)
    quarters, _ = np.histogram((shares @ X)[:, 0], bins=4, range=(0.0, 4.0))
    np.testing.assert_allclose(quarters / len(shares), 0.25, atol=0.05)  # four standard deviations
    assert len(inside_hull(X[:, :1], 10, rng)) == 0
    assert len(inside_hull(X * [1.0, 0.0], 10, rng)) == 0


def test_rounding_of_the_inputs_does_not_change_a_map(rng):
    """Layouts have many minima, and compiled functions differ in their last bits from machine to machine."""
    materials = [MeasuredBRDF(measured(name)) for name in NAMES]
    known = evaluate(materials, np.arange(3), all_isotropic(materials))[0].distances()
    noise = 1.0 + 1e-12 * rng.normal(size=known.ball.shape)
    disturbed = replace(known, ball=known.ball * noise * noise.T)
    # in length scales: steps end where slopes are 1e-9
    np.testing.assert_allclose(disturbed.layout(2), known.layout(2), atol=1e-3)


def test_distances_of_some_materials_do_not_depend_on_the_others():
    materials = [MeasuredBRDF(measured(name)) for name in NAMES]
    looks, some = evaluate(materials, np.arange(3), all_isotropic(materials))[0], np.arange(len(NAMES) - 2)
    of_all, of_some = looks.distances().subset(some), looks.subset(some).distances()
    np.testing.assert_allclose(of_all.shape, of_some.shape, rtol=1e-12)
    np.testing.assert_allclose(of_all.scale, of_some.scale, rtol=1e-12)
    np.testing.assert_array_equal(of_all.ball, of_some.ball)


def test_copies_of_one_sample_are_laid_out_beside_others_and_refused_alone():
    copies = np.zeros((4, 4))
    with pytest.raises(ShapeError, match="all 4 samples are identical"):
        blend_layout(copies, 1)
    apart = np.pad(copies, (0, 1), constant_values=3.0)
    apart[4, 4] = 0.0
    X = blend_layout(apart, 1)
    assert np.all(np.isfinite(X))
    assert len(np.unique(X)) == 5
    assert abs(X[4] - X[:4].mean()) > 3.0 * np.ptp(X[:4])


@pytest.mark.parametrize("n", [2, 3, 4])
def test_few_samples_have_different_places(n):
    X = blend_layout(np.ones((n, n)) - np.eye(n), 1)
    assert np.all(np.isfinite(X))
    assert len(np.unique(X)) == n


def test_valleys_are_as_deep_as_they_are_made():
    f = np.array([[1.0, 2.0, 1.0], [2.0, 1.5, 4.0], [3.0, 2.0, 1.0]])
    np.testing.assert_allclose(valley_depth(f), [0.0, 0.25, 0.0])
    wi, wo = profile_pairs()
    mirrored = wi * np.array([-1.0, -1.0, 1.0])
    angles = np.rad2deg(np.arccos(np.clip(np.sum(wo * mirrored, axis=2), -1.0, 1.0)))
    assert angles.max() <= 20.0 + 1e-6


def paths_of(rng, n_materials=3, n_bands=2):
    cosines = rng.uniform(0.1, 1.0, size=40)
    samples = np.cbrt(rng.uniform(0.02, 0.25, size=(n_materials * n_bands, 40)))
    measure = np.full(40, np.pi / 40)
    return fit_paths(samples, cosines, n_bands, (samples, measure), [(samples, measure)]), samples, measure


def test_paths_are_never_negative_and_pass_through_the_measured_bands(rng):
    paths, samples, measure = paths_of(rng)
    grid = np.linspace(0.0, paths.last, 50)
    u = np.array([0.2, 0.5, 0.3])
    assert np.all(paths.weights(u, grid) >= 0.0)
    own = np.cbrt(samples[2] ** 3 @ measure)
    np.testing.assert_allclose(
        paths.weights(np.eye(3)[1], np.array([own]))[0], np.eye(6)[2], atol=1e-9
    )  # interpolation between vertices
    assert np.all(paths.weights(u, np.zeros(1)) == 0.0)


def test_a_chosen_reflectance_is_reached(rng):
    paths, samples, measure = paths_of(rng)
    asked = np.array([0.05, 0.3, 0.6])
    at, reached = paths.coordinates_of(np.array([0.4, 0.3, 0.3]), asked, samples, measure)
    np.testing.assert_allclose(reached, asked, atol=2e-3)  # two steps of Newton from a table of 65
    np.testing.assert_allclose(
        (paths.weights(np.array([0.4, 0.3, 0.3]), at) @ samples) ** 3 @ measure, reached
    )
    assert paths.last == pytest.approx(np.cbrt(WHITE), rel=0.05)  # NNLS meets the bright end within its span


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return Manifold.fit(
        Library.open(small_library(tmp_path_factory.mktemp("blend"))), BlendSettings(), calibrate=False
    )


def test_no_place_has_negative_values_or_more_albedo_than_the_materials(model, rng):
    wi = from_spherical(np.deg2rad([10.0, 45.0, 70.0]), np.zeros(3))
    most = max(model.predict(name).albedo(wi).max() for name in model.names)
    pairs = ball_colours.ball(6)
    for _ in range(8):
        x = rng.dirichlet(np.ones(len(model.names))) @ model.X
        brdf = model.predict(x)
        assert brdf.eval(pairs.wi, pairs.wo).min() >= 0.0
        assert brdf.albedo(wi).max() <= most + 1e-6  # Jensen: the cube of a mean is at most the mean of cubes


def test_a_material_is_exact_and_the_limit_of_its_surroundings(model):
    ball = ball_colours.ball(6)
    name = model.names[0]
    own = ball.xyz(model.material(name).eval(ball.wi, ball.wo), model.bands)
    step = np.array([0.6, 0.8])
    for distance, most in ((0.0, 0.0), (1e-6, 0.05), (1e-4, 0.1), (1e-3, 0.5)):
        f = model.predict(model.latent(name) + distance * step).eval(ball.wi, ball.wo)
        assert ball_colours.delta_e(own, ball.xyz(f, model.bands)) <= most


def test_new_materials_are_located_where_the_data_support_blends(model, rng):
    reach = widest_gap(model.X)
    for _ in range(5):
        brdf = model.predict(model.X.mean(axis=0) + rng.normal(size=2) * 3.0 * np.ptp(model.X))  # far outside
        found = model.embed(brdf).latent
        assert np.linalg.norm(model.X - found, axis=1).min() <= reach


def test_a_material_measured_again_is_located_at_itself_in_its_own_colours(model, rng):
    """Path coordinates of its bands may lie nearer to each other than those that are tried anywhere else."""
    for name in NAMES[:3]:
        file = measured(name)
        again = replace(file, spectra=1.05 * file.spectra * rng.normal(1.0, 0.003, file.spectra.shape))
        found = model.embed(MeasuredBRDF(fill_unmeasured(again)))
        np.testing.assert_array_equal(found.latent, model.latent(name))
        assert found.relative_error < 0.01  # three times the noise


def test_between_two_materials_the_colour_is_between_theirs(model):
    """Whatever lies between them in latent space."""
    a, b = NAMES[0], NAMES[1]
    ends = np.stack([model.colours.reflectance(name) for name in (a, b)])
    wi = from_spherical(np.deg2rad(8.0), 0.0)
    for t in (0.1, 0.5, 0.9):
        found = model.interpolate(a, b, t).albedo(wi)
        assert np.all(found >= 0.95 * ends.min(axis=0))
        assert np.all(found <= 1.05 * ends.max(axis=0))


def test_a_chosen_colour_is_met_without_negative_values(model):
    x, asked = model.X.mean(axis=0), np.array([0.1, 0.3, 0.5])
    colours, reached = model.colours.of_reflectance(x, asked)
    np.testing.assert_allclose(reached, asked, atol=0.02)
    ball = ball_colours.ball(6)
    assert model.predict(x, colours).eval(ball.wi, ball.wo).min() >= 0.0


def test_a_material_in_its_own_colours_is_the_file(model):
    name = model.names[2]
    x = model.latent(name)
    ball = ball_colours.ball(6)
    np.testing.assert_array_equal(
        model.predict(x, model.colours.like(x, name)).eval(ball.wi, ball.wo),
        model.material(name).eval(ball.wi, ball.wo),
    )


def test_a_prediction_reads_only_the_materials_that_it_blends(tmp_path, monkeypatch):
    model = Manifold.fit(Library.open(small_library(tmp_path)), BlendSettings(), calibrate=False)
    model.save(tmp_path / "m.h5")
    fresh = Manifold.load(tmp_path / "m.h5")
    read, whole = [], Library.read
    monkeypatch.setattr(Library, "read", lambda self, name: (read.append(name), whole(self, name))[1])
    fresh.predict(NAMES[0])
    assert read == [NAMES[0]]
    x = fresh.between(NAMES[0], NAMES[1], 0.5)
    fresh.predict(x)
    assert set(read) == {NAMES[0]} | {
        n for n, u in zip(fresh.names, fresh.weights(x), strict=True) if u > 0.0
    }
    known = len(read)
    fresh.predict(x)
    assert len(read) == known
