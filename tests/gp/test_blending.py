"""Claims about maps whose places are blends: weights, layouts, colour paths, valleys, and the manifold made of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import reference
from helpers.small_library import NAMES, measured, small_library
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from manifold.brdf.interface import all_isotropic
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import profile_pairs, squared_valleys, valley_depth
from manifold.brdf.unmeasured_cells import fill_unmeasured
from manifold.colour import ball_colours
from manifold.core.directions import from_spherical
from manifold.core.errors import ShapeError
from manifold.core.records import Bands
from manifold.library.store import Library
from manifold.model.blend_fitting import AppearanceDistances, evaluate
from manifold.model.blending import (
    LayoutObjective,
    _blends,
    blend_layout,
    blend_weights,
    inside_hull,
    widest_gap,
)
from manifold.model.colour_paths import WHITE, fit_paths
from manifold.model.manifold import Manifold
from manifold.model.settings import Settings


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
    truth = rng.normal(size=(6, 2))
    distance = np.linalg.norm(truth[:, None] - truth[None], axis=2)
    implausible = np.abs(rng.normal(size=(6, 6)))
    implausible = implausible + implausible.T
    pairs = np.triu_indices(6, 1)
    objective = LayoutObjective(pairs, distance[pairs], 1.2 * distance[pairs])
    cost = lambda u: (np.sum(u**3, axis=1), 3.0 * u**2)  # noqa: E731
    blends = _blends(rng.dirichlet(np.ones(6), size=20), 0.7, implausible, cost, 2.0)
    X = truth + 0.3 * rng.normal(size=truth.shape)
    numeric = reference.central_differences(lambda x: objective.value(x, blends)[0], X)
    np.testing.assert_allclose(objective.value(X, blends)[1], numeric, rtol=1e-5, atol=1e-7)  # h = 1e-5


def test_a_layout_gives_distances_back_that_a_plane_can_have(rng):
    truth = rng.normal(size=(12, 2))
    distance = np.linalg.norm(truth[:, None] - truth[None], axis=2)
    layout = blend_layout(distance, np.zeros_like(distance), np.zeros_like(distance), 2)
    found = np.linalg.norm(layout.X[:, None] - layout.X[None], axis=2)
    upper = np.triu_indices(12, 1)
    ratio = found[upper] / distance[upper]
    np.testing.assert_allclose(ratio, np.median(ratio), rtol=1e-3)  # ends of L-BFGS-B
    assert layout.objective <= layout.objective_start + 1e-9


@pytest.mark.parametrize(("n", "q"), [(6, 4), (6, 5), (8, 6), (12, 8)])
def test_neighbours_are_within_reach_of_the_kernel_in_many_dimensions_too(rng, n, q):
    """Their hull is all but flat, whose volume says nothing of distances: they lay 10 to 300 length scales apart."""
    X = rng.normal(size=(n, q)) * 0.3 ** np.arange(q)
    distance = cdist(X, X)
    found = blend_layout(distance, 0.5 * distance, np.zeros((n, n)), q).X
    apart = cdist(found, found) + np.diag(np.full(n, np.inf))
    assert 0.5 < np.median(apart.min(axis=1)) <= 2.5 + 1e-9


def test_a_layout_keeps_apart_what_does_not_blend():
    distance = np.ones((4, 4)) - np.eye(4)
    implausible = np.zeros((4, 4))
    implausible[0, 1] = implausible[1, 0] = 5.0
    X = blend_layout(distance, np.zeros((4, 4)), implausible, 2).X
    d = np.linalg.norm(X[:, None] - X[None], axis=2)
    assert d[0, 1] > 1.2 * np.median(d[np.triu_indices(4, 1)])


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


def distances(materials) -> AppearanceDistances:
    """Between a few materials."""
    bands = np.arange(materials[0].bands.count)
    return evaluate(materials, bands, all_isotropic(materials))[0].distances()


def test_rounding_of_the_inputs_does_not_change_a_map(rng):
    """Layouts have many minima, and compiled functions differ in their last bits from machine to machine."""
    known = distances([MeasuredBRDF(measured(name)) for name in NAMES])
    noise = 1.0 + 1e-12 * rng.normal(size=known.ball.shape)
    disturbed = replace(
        known,
        ball=known.ball * noise * noise.T,
        profiles=known.profiles * (1.0 + 1e-12 * rng.normal(size=known.profiles.shape)),
    )
    X = known.layout(2).X
    np.testing.assert_allclose(
        disturbed.layout(2).X, X, atol=1e-3
    )  # length scales: steps end where slopes are 1e-7


def test_copies_of_one_sample_are_laid_out_beside_others_and_refused_alone():
    copies = np.zeros((4, 4))
    with pytest.raises(ShapeError, match="all 4 samples are identical"):
        blend_layout(copies, copies, copies, 1)
    apart = np.pad(copies, (0, 1), constant_values=3.0)
    apart[4, 4] = 0.0
    X = blend_layout(apart, apart, 0.0 * apart, 1).X
    assert np.all(np.isfinite(X))
    assert abs(X[4] - X[:4].mean()) > 3.0 * np.ptp(X[:4])


def test_valleys_are_as_deep_as_they_are_made():
    f = np.array([[1.0, 2.0, 1.0], [2.0, 1.5, 4.0], [3.0, 2.0, 1.0]])
    np.testing.assert_allclose(valley_depth(f), [0.0, 0.25, 0.0])
    wi, wo = profile_pairs()
    mirrored = wi * np.array([-1.0, -1.0, 1.0])
    angles = np.rad2deg(np.arccos(np.clip(np.sum(wo * mirrored, axis=2), -1.0, 1.0)))
    assert angles.max() <= 20.0 + 1e-6


class Grooved:
    """A lobe of a width, with a groove in its middle, in one band."""

    bands, is_isotropic = Bands.from_array(np.array([550.0])), True

    def __init__(self, width_rad: float, depth: float) -> None:
        self.width, self.depth = width_rad, depth

    def eval(self, wi, wo):
        half = wi + wo
        angle = np.arccos(np.clip(half[..., 2] / np.linalg.norm(half, axis=-1), -1.0, 1.0))
        groove = 1.0 - self.depth * np.exp(-0.5 * (angle / 0.03) ** 2)
        return (0.05 + np.exp(-0.5 * (angle / self.width) ** 2) * groove)[..., None]

    def select_bands(self, bands):
        return self


def test_a_materials_own_groove_does_not_move_it_onto_another():
    """Blends with it have a groove wherever it lies: only what they have beyond it speaks against a layout."""
    widths = np.linspace(0.2, 0.35, 5)
    smooth, grooved = ([Grooved(width, depth) for width in widths] for depth in (0.0, 0.6))
    looks = distances([*smooth[:2], grooved[2], *smooth[3:]])
    assert looks.allowed[2] > 0.4
    assert looks.valley.max() < 0.02  # half of a groove is hardly less deep than the mean of one and none
    places = looks.layout(1).X[:, 0]
    assert np.all(np.diff(places) > 0.0) or np.all(np.diff(places) < 0.0)


class GroovedAcross(Grooved):
    """Its groove is seen by light along y only."""

    is_isotropic = False

    def eval(self, wi, wo):
        along_y = wi[..., 1] ** 2 / np.maximum(wi[..., 0] ** 2 + wi[..., 1] ** 2, 1e-12)
        grooved, smooth = super().eval(wi, wo), Grooved(self.width, 0.0).eval(wi, wo)
        return smooth + along_y[..., None] * (grooved - smooth)


def test_valleys_of_anisotropic_materials_are_seen_at_all_azimuths():
    looks = distances([GroovedAcross(0.2, 0.6), Grooved(0.25, 0.0), Grooved(0.3, 0.0)])
    assert looks.allowed[0] > 0.4
    assert looks.allowed[1:].max() < 0.1


def test_a_blend_of_a_highlight_and_a_rise_to_grazing_has_a_valley():
    highlight, rise = np.array([1.0, 2.0, 1.0, 1.0, 1.0]), np.array([1.0, 1.0, 1.0, 1.5, 2.0])
    roots = np.cbrt(np.stack([highlight, rise]))[:, None, :, None]
    limits = np.full(2, 0.05)
    alone = squared_valleys(np.eye(2), roots, limits)[0]
    blend = squared_valleys(np.array([[0.5, 0.5]]), roots, limits)[0]
    np.testing.assert_allclose(alone, 0.0, atol=1e-12)  # rounding
    excess = valley_depth(roots.mean(axis=0)[0, :, 0] ** 3) - 0.05
    assert excess > 0.2
    assert excess**2 * 0.9 < blend[0] < 3.0 * excess**2  # three directions are lower than both sides


def test_gradient_of_valleys_of_blends_agrees_with_central_differences(rng):
    profiles, u = rng.uniform(0.5, 1.5, size=(5, 2, 9, 3)), rng.dirichlet(0.5 * np.ones(5), size=6)
    limits = rng.uniform(0.01, 0.1, size=5)
    squared, gradient = squared_valleys(u, profiles, limits)
    assert np.count_nonzero(squared) >= 3
    found = reference.central_differences(lambda x: squared_valleys(x, profiles, limits)[0].sum(), u)
    np.testing.assert_allclose(gradient, found, rtol=1e-5, atol=1e-7)  # h = 1e-5


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
        Library.open(small_library(tmp_path_factory.mktemp("blend"))), Settings(kind="blend"), calibrate=False
    )


def test_no_place_has_negative_values_or_more_albedo_than_the_materials(model, rng):
    wi = from_spherical(np.deg2rad([10.0, 45.0, 70.0]), np.zeros(3))
    most = max(material.albedo(wi).max() for material in model.materials.filled())
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
    model = Manifold.fit(Library.open(small_library(tmp_path)), Settings(kind="blend"), calibrate=False)
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
