"""Non-negative least squares, lobes, and what combinations of samples and lobes reach."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from helpers.small_library import NAMES, measured
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

from manifold.analytic.free_lobes import Lobes
from manifold.brdf.measured import MeasuredBRDF
from manifold.core.errors import ShapeError
from manifold.core.pairs import RusinkiewiczGrid, cosine_weight
from manifold.gp.nonnegative import nonnegative_weights
from manifold.model.estimator import explain
from manifold.model.reconstruction import few_atoms, observations


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


def test_black_samples_and_equal_samples_do_no_harm(rng):
    samples, targets = problem(rng, 5, 3)
    doubled = np.vstack([samples, samples, np.zeros((2, samples.shape[1]))])
    found = nonnegative_weights(doubled @ doubled.T, targets @ doubled.T) @ doubled
    expected = nonnegative_weights(samples @ samples.T, targets @ samples.T) @ samples
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


def test_what_is_not_finite_is_refused():
    with pytest.raises(ShapeError, match="not finite"):
        nonnegative_weights(np.eye(2), np.array([[1.0, np.nan]]))


GRID = RusinkiewiczGrid(16, 9, 6)
N_PIXELS = 12
PIXELS = np.ones(N_PIXELS)


@pytest.fixture(scope="module")
def pairs():
    wi, wo, above = GRID.directions()
    return wi[above], wo[above]


# -- reconstruction ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def samples(pairs):
    """Cube roots of the bands of a few materials and of lobes, (n, P)."""
    measured_roots = [np.cbrt(np.maximum(MeasuredBRDF(measured(name)).eval(*pairs).T, 0.0)) for name in NAMES]
    return np.vstack([*measured_roots, Lobes((0.1, 0.4), (2.0,)).cube_roots(*pairs)])


@pytest.fixture(scope="module")
def atoms(samples, pairs):
    """Values of BRDFs as reconstructions compare them, with averages of neighbours in place of pixels."""
    return compared(samples**3, pairs)


def compared(f, pairs):
    values = f * cosine_weight(*pairs)
    return np.hstack([values, np.add.reduceat(values, np.arange(N_PIXELS) * 20, axis=1) / 20.0])


def test_a_combination_of_samples_is_found_again(samples, atoms, rng):
    truth = np.zeros((3, len(samples)))
    truth[:, [2, 9, 20]] = rng.uniform(0.2, 1.0, (3, 3))
    targets = truth @ atoms
    weights = explain(observations(atoms, targets, PIXELS))
    assert weights.min() >= 0.0
    # samples are alike (materials of one colour): the values are determined, the weights hardly
    np.testing.assert_allclose(weights @ atoms, targets, rtol=1e-3, atol=1e-4 * targets.max())


def test_pixels_come_nearer_where_they_count(atoms):
    n_pixels = N_PIXELS
    others, targets = np.delete(atoms, [6, 7, 8], axis=0), atoms[6:9]
    bright = targets.copy()
    bright[:, -n_pixels:] += 1.0  # beyond display white

    def errors(targets):
        found = np.cbrt(explain(observations(others, targets, PIXELS)) @ others) - np.cbrt(atoms[6:9])
        found[:, -n_pixels:] *= atoms[6:9, -n_pixels:] < 1.0
        return np.sum(found[:, :-n_pixels] ** 2), np.sum(found[:, -n_pixels:] ** 2)

    (values, pixels), (values_alone, clipped) = errors(targets), errors(bright)
    assert pixels < 0.9 * clipped
    assert values_alone <= values


def test_a_highlight_survives_where_the_base_is_black(pairs):
    """Cube roots, linearised where values are near 0, would give up the highlight for them."""
    atoms = compared(Lobes((0.1, 0.4), (2.0,)).values(*pairs), pairs)
    target = np.maximum(0.04 * atoms[[6]] - 1e-3 * atoms[[0]], 0.0)  # black but for the highlight
    found = explain(observations(atoms, target, PIXELS)) @ atoms
    assert found.max() > 0.8 * target.max()


def test_black_is_made_of_nothing(atoms):
    assert not np.any(explain(observations(atoms, 0.0 * atoms[:3], PIXELS)))
    assert not np.any(few_atoms(observations(atoms, 0.0 * atoms[:3], PIXELS), 12, LAMBERTIAN))


# -- few atoms ---------------------------------------------------------------------------------------------

LAMBERTIAN = 18  # after six materials in three bands


def numbers_of(weights):
    """How many numbers describe weights: an index and a weight per band, or one where all bands have the same."""
    used = np.flatnonzero(weights.any(axis=0))
    return sum((k != LAMBERTIAN) + (1 if np.ptp(weights[:, k]) == 0.0 else len(weights)) for k in used)


def test_few_atoms_are_found_again(atoms):
    truth = np.zeros((3, len(atoms)))
    truth[:, 10], truth[:, 22], truth[:, LAMBERTIAN] = (0.9, 0.5, 0.1), 0.3, (0.2, 0.3, 0.4)
    found = few_atoms(observations(atoms, truth @ atoms, PIXELS), 9, LAMBERTIAN)  # 4 + 2 + 3
    np.testing.assert_allclose(found, truth, atol=1e-5)


def error_of(weights, atoms, targets):
    slopes = np.array([band.slopes(band.seen) for band in observations(targets, targets, PIXELS)])
    return np.sum(((weights @ atoms - targets) * slopes) ** 2)


def test_numbers_are_kept_to_and_more_of_them_are_never_worse(atoms):
    others, targets = np.delete(atoms, [0, 1, 2], axis=0), atoms[:3]
    lambertian = LAMBERTIAN - 3
    errors = []
    for numbers in (1, 4, 8, 12, 24):
        weights = few_atoms(observations(others, targets, PIXELS), numbers, lambertian)
        assert weights.min() >= 0.0
        assert numbers_of(np.insert(weights, [0] * 3, 0.0, axis=1)) <= numbers
        errors.append(error_of(weights, others, targets))
    assert np.all(np.diff(errors) < 0.0)
    assert error_of(explain(observations(others, targets, PIXELS)), others, targets) < errors[-1]


def test_few_atoms_are_as_good_as_the_best_of_all_pairs(atoms):
    """Of two atoms with weights per band, against all pairs tried one after the other."""
    others, targets = np.delete(atoms, [0, 1, 2], axis=0), atoms[:3]
    slopes = np.array([band.slopes(band.seen) for band in observations(targets, targets, PIXELS)])

    def error(pair):
        residuals = [nnls((others[list(pair)] * s).T, t * s)[1] for t, s in zip(targets, slopes, strict=True)]
        return np.sum(np.square(residuals))

    best = min(map(error, combinations(range(len(others)), 2)))
    found = few_atoms(observations(others, targets, PIXELS), 8, LAMBERTIAN - 3)
    # weights are found with slopes between the target and a first fit: a little off these
    assert error_of(found, others, targets) < 1.05 * best
