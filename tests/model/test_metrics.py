"""Claims about errors and direction grids."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import reference
from hypothesis import given
from hypothesis import strategies as st

from manifold.core.directions import from_rusinkiewicz, from_spherical, half_vector, to_rusinkiewicz
from manifold.core.errors import ShapeError
from manifold.core.metrics import Errors, RunningErrors, cube_root_error, relative_error, rmse, spectral_angle
from manifold.core.pairs import RusinkiewiczGrid, cosine_weight


@given(pairs=st.integers(1, 8), bands=st.integers(1, 8))
def test_rmse_is_the_loop_over_pairs_and_bands(pairs, bands):
    rng = np.random.default_rng([pairs, bands])
    f, f_star = rng.random((2, pairs, bands))
    assert rmse(f, f_star) == pytest.approx(reference.rmse(f, f_star), rel=1e-12)


def test_rmse_sums_over_bands_and_can_count_pairs_left_out():
    f, f_star = np.zeros((10, 195)), np.ones((10, 195))
    assert rmse(f, f_star) == pytest.approx(np.sqrt(195))
    assert rmse(f, f_star, n_pairs=40) == pytest.approx(np.sqrt(195 / 4))


def test_errors_in_blocks_are_the_errors_of_the_whole(rng):
    f, f_star, w = rng.random((90, 4)), rng.random((90, 4)), rng.random(90)
    running = RunningErrors()
    for start in range(0, 90, 25):
        rows = slice(start, start + 25)
        running.add(f[rows], f_star[rows], w[rows])
    assert running.errors(running.n_pairs).rmse == pytest.approx(rmse(f, f_star), rel=1e-12)
    assert running.errors().linear == pytest.approx(relative_error(f, f_star, w), rel=1e-12)
    assert running.errors().cube_root == pytest.approx(cube_root_error(f, f_star, w), rel=1e-12)


def test_errors_of_many_materials_are_those_of_each(rng):
    f, f_star, w = rng.random((5, 30, 4)), rng.random((5, 30, 4)), rng.random(30)
    running = RunningErrors()
    running.add(f, f_star, w)
    for k in range(5):
        assert running.errors(30).rmse[k] == pytest.approx(rmse(f[k], f_star[k]), rel=1e-12)
        assert running.errors().linear[k] == pytest.approx(relative_error(f[k], f_star[k], w), rel=1e-12)
        assert running.errors().cube_root[k] == pytest.approx(cube_root_error(f[k], f_star[k], w), rel=1e-12)


def test_cube_root_error_is_a_ratio_of_norms_of_cube_roots(rng):
    f, f_star, w = rng.random((20, 4)), rng.random((20, 4)) - 0.2, rng.random(20)
    root, root_star = np.cbrt(w[:, None] * f), np.cbrt(w[:, None] * f_star)
    expected = np.linalg.norm(root_star - root) / np.linalg.norm(root)
    assert cube_root_error(f, f_star, w) == pytest.approx(expected, rel=1e-12)
    assert cube_root_error(f, np.zeros_like(f), w) == pytest.approx(1.0, rel=1e-12)
    assert cube_root_error(f, f.copy(), w) == 0.0


def test_relative_error_is_a_ratio_of_weighted_norms(rng):
    f, f_star, w = rng.random((20, 4)), rng.random((20, 4)), rng.random(20)
    expected = np.linalg.norm(w[:, None] * (f_star - f)) / np.linalg.norm(w[:, None] * f)
    assert relative_error(f, f_star, w) == pytest.approx(expected, rel=1e-12)
    assert relative_error(f, np.zeros_like(f), w) == 1.0
    assert relative_error(np.zeros_like(f), np.zeros_like(f)) == 0.0
    assert 1e90 < relative_error(np.zeros_like(f), f_star) < np.inf  # JSON has no infinity


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(ShapeError, match="expected the same"):
        rmse(np.zeros((2, 3)), np.zeros((2, 4)))
    with pytest.raises(ShapeError, match="one per direction pair"):
        relative_error(np.zeros((2, 3)), np.zeros((2, 3)), np.ones(3))


def test_spectral_angle_ignores_intensity_and_resolves_tiny_angles():
    u = np.array([1.0, 2.0, 2.0])
    assert spectral_angle(u, 7.0 * u) == pytest.approx(0.0, abs=1e-15)
    assert spectral_angle(np.array([1.0, 0.0]), np.array([1.0, 1e-9])) == pytest.approx(1e-9, rel=1e-6)
    assert spectral_angle(np.array([1.0, 0.0]), np.array([0.0, 3.0])) == pytest.approx(np.pi / 2)
    assert spectral_angle(np.zeros(2), np.zeros(2)) == 0.0
    assert spectral_angle(np.zeros(2), np.ones(2)) == pytest.approx(np.pi / 2)


def test_rusinkiewicz_angles_and_directions_convert_both_ways(rng):
    theta_h, theta_d = rng.uniform(0.01, 1.5, size=(2, 500))
    phi_d, phi_h = rng.uniform(-3.1, 3.1, size=(2, 500))
    wi, wo = from_rusinkiewicz(theta_h, theta_d, phi_d, phi_h)
    np.testing.assert_allclose(np.linalg.norm(wi, axis=1), 1.0, rtol=1e-14)
    for found, expected in zip(to_rusinkiewicz(wi, wo), (theta_h, theta_d, phi_d, phi_h), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-11)  # azimuths near a pole lose two digits
    back = from_rusinkiewicz(*to_rusinkiewicz(wi, wo))
    np.testing.assert_allclose(back, (wi, wo), atol=1e-13)


def test_rusinkiewicz_angles_mean_half_vector_and_difference(rng):
    theta_h, theta_d = rng.uniform(0.1, 1.4, size=(2, 50))
    phi_d, phi_h = rng.uniform(-3, 3, size=(2, 50))
    wi, wo = from_rusinkiewicz(theta_h, theta_d, phi_d, phi_h)
    np.testing.assert_allclose(half_vector(wi, wo), from_spherical(theta_h, phi_h), atol=1e-13)
    np.testing.assert_allclose(np.sum(wi * wo, axis=1), np.cos(2 * theta_d), atol=1e-13)
    np.testing.assert_allclose(
        to_rusinkiewicz(wo, wi)[1], theta_d, atol=1e-12
    )  # reciprocity swaps phi_d only


def test_named_grids_have_the_stated_nodes():
    grid = RusinkiewiczGrid.named("hikichi")
    assert grid.n_pairs == 1_458_000
    theta_h, theta_d, phi_d = np.rad2deg(grid.angles(181 * 180, 181 * 180 + 2))
    np.testing.assert_allclose(theta_h, 2.0)
    np.testing.assert_allclose(theta_d, 1.0)
    np.testing.assert_allclose(phi_d, [0.0, 1.0], atol=1e-12)
    wi, wo, above = RusinkiewiczGrid().directions()
    assert wi.shape == wo.shape == (45 * 23 * 12, 3)
    assert 0.4 < above.mean() < 0.9
    assert np.array_equal(above, cosine_weight(wi, wo) > 0)
    first = RusinkiewiczGrid().angles()[0]
    assert first.max() == pytest.approx((44.5 / 45) ** 2 * np.pi / 2)


def test_blocks_walk_the_whole_grid_in_order():
    grid = RusinkiewiczGrid(5, 4, 3)
    for size in (1, 7, 60, 1000):
        parts = [np.concatenate(part) for part in zip(*grid.blocks(size), strict=True)]
        for part, whole in zip(parts, grid.directions(), strict=True):
            assert np.array_equal(part, whole)


def test_a_turned_grid_has_half_vectors_of_all_azimuths_at_every_elevation():
    grid = RusinkiewiczGrid()
    turned = grid.suited_to(False)
    assert grid.suited_to(True) is grid
    wi, wo, above = grid.directions()
    turned_wi, turned_wo, turned_above = turned.directions()
    assert np.array_equal(above, turned_above)
    assert np.array_equal(turned_wi[:, 2], wi[:, 2])  # cosines, to the bit
    assert np.array_equal(turned_wo[:, 2], wo[:, 2])
    some = np.flatnonzero(above)[::6]  # those that find a latent
    theta_h, theta_d, phi_d, phi_h = to_rusinkiewicz(turned_wi[some], turned_wo[some])
    for found, angle in zip((theta_h, theta_d, phi_d), grid.angles(), strict=True):
        np.testing.assert_allclose(found, angle[some], atol=1e-7)
    for ring in np.split(phi_h[:1200], 30):  # about one elevation each
        gaps = np.diff(np.sort(np.append(ring, ring.min() + 2.0 * np.pi)))
        assert gaps.max() < np.deg2rad(30.0)  # even gaps are 9 degrees
    parts = [np.concatenate(part) for part in zip(*turned.blocks(777), strict=True)]
    assert np.array_equal(parts[0], turned_wi)


def test_errors_of_several_come_back_from_json_where_one_is_not_known():
    errors = Errors(linear=np.array([1.0, np.nan, 3.0]), lights={"sun 45": np.array([0.5, np.nan, 1.5])})
    back = Errors.from_json(errors.to_json())
    np.testing.assert_array_equal(back.linear, errors.linear)
    assert back.median.linear == 2.0
    assert back.median.lights == {"sun 45": 1.0}
