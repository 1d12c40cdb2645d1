"""Non-negative least squares, lobes, and what combinations of samples and lobes reach."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls
from small_library import NAMES, measured

from manifold.brdf.measured import MeasuredBRDF
from manifold.colour.conversion import to_xyz
from manifold.errors import ShapeError
from manifold.metrics import RusinkiewiczGrid, cosine_weight
from manifold.models.lobes import Lobes
from manifold.models.nonnegative import nonnegative_weights
from manifold.models.picture_terms import lab_slopes, picture_rows
from manifold.models.reconstruction_weights import reconstruction_weights
from manifold.models.shared_pair import pair_gains, shared_pair
from manifold.records import Bands


def problem(rng, n, rows, *, rank=None):
    """Samples (n, P) that are never negative, like BRDFs, and targets near combinations of them."""
    rank = n if rank is None else rank
    samples = rng.random((n, rank)) @ rng.random((rank, 3 * n)) ** 3
    targets = rng.random((rows, n)) @ samples + rng.normal(0, 0.3, (rows, 3 * n))
    return samples, targets


@pytest.mark.parametrize("n", [1, 2, 7, 40])
def test_weights_are_those_of_scipy(n, rng):
    samples, targets = problem(rng, n, 6)
    found = nonnegative_weights(samples @ samples.T, targets @ samples.T)
    expected = [nnls(samples.T, t)[0] for t in targets]
    # the Gram matrix squares the condition of the samples, and 1e-10 stands on its diagonal
    np.testing.assert_allclose(found, expected, atol=1e-5)


@given(st.integers(0, 10**6), st.integers(1, 30), st.integers(1, 30), st.integers(1, 5))
@settings(max_examples=60, deadline=None)
def test_no_weight_can_be_moved_to_advantage(seed, n, rank, rows):
    """Karush, Kuhn and Tucker: slopes are zero where weights are positive, and not downhill elsewhere."""
    samples, targets = problem(np.random.default_rng(seed), n, rows, rank=rank)  # of low rank: not unique
    gram, cross = samples @ samples.T, targets @ samples.T
    weights = nonnegative_weights(gram, cross)
    assert weights.min() >= 0.0
    scale = np.sqrt(np.diag(gram))
    slope = (weights @ gram - cross) / scale
    tolerance = (
        1e-7 * np.abs(cross / scale).max()
    )  # the stopping rule, 1e-9, and the ridge, 1e-10 of the weights
    assert slope.min() >= -tolerance
    assert np.abs(slope[weights > 0]).max(initial=0.0) <= tolerance


def test_rows_do_not_depend_on_what_came_before(rng):
    samples, targets = problem(rng, 25, 12)
    gram, cross = samples @ samples.T, targets @ samples.T
    together = nonnegative_weights(gram, cross)
    alone = np.vstack([nonnegative_weights(gram, row[None]) for row in cross])
    np.testing.assert_allclose(together, alone, atol=1e-8)


def test_a_sample_is_itself_and_what_points_away_has_no_weight(rng):
    samples, _ = problem(rng, 12, 1)
    gram = samples @ samples.T
    np.testing.assert_allclose(nonnegative_weights(gram, gram), np.eye(12), atol=1e-6)
    assert not np.any(nonnegative_weights(gram, -gram))


def test_black_samples_and_equal_samples_do_no_harm(rng):
    samples, targets = problem(rng, 5, 3)
    doubled = np.vstack([samples, samples, np.zeros((2, samples.shape[1]))])
    found = nonnegative_weights(doubled @ doubled.T, targets @ doubled.T) @ doubled
    expected = nonnegative_weights(samples @ samples.T, targets @ samples.T) @ samples
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


def test_shapes_that_do_not_fit_are_refused():
    for gram, cross in (
        (np.eye(3), np.ones((2, 2))),
        (np.ones((3, 2)), np.ones((1, 3))),
        (np.eye(3), np.ones(3)),
    ):
        with pytest.raises(ShapeError, match=r"expected \(n, n\) and \(R, n\)"):
            nonnegative_weights(gram, cross)
    with pytest.raises(ShapeError, match="not finite"):
        nonnegative_weights(np.eye(2), np.array([[1.0, np.nan]]))


# -- what a picture sees -----------------------------------------------------------------------------------

GRID = RusinkiewiczGrid(16, 9, 6)
TO_XYZ = np.array([to_xyz(row, Bands(None)) for row in np.eye(3)]).T


@pytest.fixture(scope="module")
def pairs():
    wi, wo, above = GRID.directions()
    return wi[above], wo[above]


def test_every_pair_is_averaged_with_those_of_either_direction(pairs):
    rows = picture_rows(*pairs)
    np.testing.assert_allclose(rows @ np.ones(len(pairs[0])), 1.0, rtol=1e-12)
    assert np.all(rows.getnnz(axis=0) == 2)
    # exchanging the directions exchanges the groups of one with those of the other
    by_f = np.sort(rows @ np.exp(pairs[0][:, 2] * pairs[1][:, 2]))
    swapped = np.sort(picture_rows(pairs[1], pairs[0]) @ np.exp(pairs[0][:, 2] * pairs[1][:, 2]))
    np.testing.assert_allclose(by_f, swapped, rtol=1e-12)


def test_slopes_are_those_of_cielab(rng):
    means = rng.uniform(0.05, 0.3, (8, 3))  # bright: above the linear part of CIELAB

    def lab(f):
        x, y, z = np.cbrt(np.pi * f @ TO_XYZ.T / TO_XYZ.sum(axis=1)).T
        return np.stack([116.0 * y, 500.0 * (x - y), 200.0 * (y - z)], axis=1)

    S_C = 1.0 + 0.045 * np.linalg.norm(lab(means)[:, 1:], axis=1)
    h = 1e-5
    for b in range(3):
        step = h * np.eye(3)[b]
        difference = (lab(means + step) - lab(means - step)) / (2 * h) / 100.0
        difference[:, 1:] /= S_C[:, None]
        # central differences of cube roots: h^2 against 0.05^2
        np.testing.assert_allclose(lab_slopes(means, TO_XYZ)[:, :, b], difference, rtol=1e-6, atol=1e-8)


def test_slopes_of_black_are_finite():
    assert np.all(np.isfinite(lab_slopes(np.zeros((2, 3)), TO_XYZ)))


# -- reconstruction ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def samples(pairs):
    """Cube roots of the bands of a few materials and of lobes, (n, P)."""
    measured_roots = [np.cbrt(np.maximum(MeasuredBRDF(measured(name)).eval(*pairs).T, 0.0)) for name in NAMES]
    return np.vstack([*measured_roots, Lobes((0.1, 0.4), (2.0,)).cube_roots(*pairs)])


@pytest.mark.parametrize("picture", [0.0, 1.0])
def test_a_combination_of_samples_is_found_again(samples, pairs, picture, rng):
    truth = np.zeros((3, len(samples)))
    truth[:, [2, 9, 20]] = rng.uniform(0.2, 1.0, (3, 3))
    targets = truth @ samples
    weights = reconstruction_weights(
        samples, targets, cosine_weight(*pairs), picture_rows(*pairs), picture=picture
    )
    assert weights.min() >= 0.0
    # samples are alike (materials of one colour): the values are determined, the weights hardly
    np.testing.assert_allclose(weights @ samples, targets, rtol=1e-3, atol=1e-4 * targets.max())


def test_the_second_stage_brings_averages_of_light_nearer(samples, pairs):
    cosines, rows = cosine_weight(*pairs), picture_rows(*pairs)
    others = np.delete(samples, [6, 7, 8], axis=0)
    targets = samples[6:9]

    def errors(picture):
        found = reconstruction_weights(others, targets, cosines, rows, picture=picture) @ others
        seen, true = (np.cbrt(rows @ (roots**3).T) for roots in (found, targets))
        return np.sum(cosines ** (2 / 3) * (found - targets) ** 2), np.sum((seen - true) ** 2)

    (pairwise, averaged), (pairwise_2, averaged_2) = errors(0.0), errors(1.0)
    assert averaged_2 < 0.9 * averaged
    assert pairwise <= pairwise_2


def test_black_is_made_of_nothing(samples, pairs):
    cosines, rows = cosine_weight(*pairs), picture_rows(*pairs)
    black = np.zeros((3, samples.shape[1]))
    assert not np.any(reconstruction_weights(samples, black, cosines, rows))
    assert not np.any(shared_pair(samples, 18, black, cosines, rows, TO_XYZ))


# -- a pair of samples -------------------------------------------------------------------------------------


def test_gains_of_pairs_are_those_of_least_squares(rng):
    samples, targets = problem(rng, 6, 3)
    found = pair_gains(samples @ samples.T, targets @ samples.T)
    for i in range(6):
        for j in range(i):
            left = [nnls(samples[[i, j]].T, t)[1] ** 2 for t in targets]
            expected = np.sum(targets**2) - np.sum(left)
            assert found[i, j] == pytest.approx(expected, rel=1e-9)
            assert found[i, j] == found[j, i]


def test_a_pair_and_white_are_found_again(samples, pairs):
    white = 18  # the Lambertian, after six materials in three bands
    truth = np.zeros((3, len(samples)))
    truth[:, 10], truth[:, 22], truth[:, white] = (0.9, 0.5, 0.1), (0.2, 0.3, 0.4), 0.3
    weights = shared_pair(
        samples, white, truth @ samples, cosine_weight(*pairs), picture_rows(*pairs), TO_XYZ
    )
    np.testing.assert_allclose(weights, truth, atol=1e-5)


def test_a_pair_is_two_samples_and_a_white_that_all_bands_share(samples, pairs):
    targets = samples[6:9]
    others = np.delete(samples, [6, 7, 8], axis=0)
    weights = shared_pair(others, 15, targets, cosine_weight(*pairs), picture_rows(*pairs), TO_XYZ)
    coloured = np.delete(weights, 15, axis=1)
    assert weights.min() >= 0.0
    assert np.count_nonzero(coloured.any(axis=0)) <= 2
    assert np.ptp(weights[:, 15]) == 0.0
