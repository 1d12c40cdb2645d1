"""Warps of the unit square: densities, sampling and inversion agree with each other."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from manifold.brdf.warp import Warp


def nodes(n_phi, n_theta):
    return np.linspace(-np.pi, 0, n_phi), np.linspace(0, 1.5, n_theta)


def random_values(rng, n_phi, n_theta, n_rows, n_cols, zeros=0.2):
    """Spiky densities with zero cells, as in measured luminance."""
    values = rng.lognormal(0.0, 2.0, (n_phi, n_theta, n_rows, n_cols))
    values[rng.random(values.shape) < zeros] = 0.0
    values[:, :, 0, 0] = 1.0  # no slice is zero everywhere
    return values.astype(np.float32)


def random_warp(rng, *shape):
    return Warp(random_values(rng, *shape), *nodes(*shape[:2]))


def random_parameters(rng, n):
    return rng.uniform(-np.pi, 0, n), rng.uniform(0, 1.5, n)


# With more than nine columns, guides lead to a block of them.
shapes = st.tuples(st.integers(1, 3), st.integers(1, 4), st.integers(2, 9), st.integers(2, 27))


@settings(deadline=None, max_examples=30)
@given(shape=shapes, seed=st.integers(0, 2**32 - 1))
def test_inverting_a_sample_returns_its_variates(shape, seed):
    rng = np.random.default_rng(seed)
    # Zero cells have no unique inverse; a floor keeps the map strictly monotonic.
    values = rng.uniform(0.05, 1.0, shape)
    warp = Warp(values, *nodes(*shape[:2]))
    variates = rng.random((200, 2))
    phi, theta = random_parameters(rng, 200)
    points, pdf = warp.sample(variates, phi, theta)
    back, pdf_back = warp.invert(points, phi, theta)
    np.testing.assert_allclose(back, variates, atol=1e-11)  # variates stop 1e-12 short of 0 and 1
    np.testing.assert_allclose(pdf, pdf_back, rtol=1e-9)


def test_density_of_a_sample_is_the_density_evaluated_there(rng):
    warp = random_warp(rng, 3, 4, 16, 12)
    phi, theta = random_parameters(rng, 1000)
    points, pdf = warp.sample(rng.random((1000, 2)), phi, theta)
    np.testing.assert_allclose(pdf, warp.evaluate(points, phi, theta), rtol=1e-9, atol=1e-12)


def test_density_integrates_to_one_between_parameter_nodes(rng):
    warp = random_warp(rng, 2, 3, 9, 11)
    # Midpoints of 8 x 8 points per cell integrate a bilinear function exactly.
    x = (np.arange(10 * 8) + 0.5) / (10 * 8)
    y = (np.arange(8 * 8) + 0.5) / (8 * 8)
    points = np.stack(np.meshgrid(x, y), axis=-1)
    for phi, theta in [(-3.0, 0.1), (-1.234, 0.77), (0.0, 1.5)]:
        assert warp.evaluate(points, phi, theta).mean() == pytest.approx(1.0, rel=1e-12)


def test_samples_follow_the_density(rng):
    warp = random_warp(rng, 1, 3, 5, 6)
    n = 200_000
    points, _ = warp.sample(rng.random((n, 2)), 0.0, 0.6)
    counts, _, _ = np.histogram2d(points[:, 1], points[:, 0], bins=(8, 10), range=[[0, 1], [0, 1]])
    fine = (np.arange(400) + 0.5) / 400
    density = warp.evaluate(np.stack(np.meshgrid(fine, fine), axis=-1), 0.0, 0.6)  # (y, x)
    expected = density.reshape(8, 50, 10, 40).mean(axis=(1, 3))
    expected *= n / expected.sum()
    keep = expected > 5
    statistic = np.sum((counts[keep] - expected[keep]) ** 2 / expected[keep])
    assert stats.chi2.sf(statistic, keep.sum() - 1) > 1e-4


def test_densities_agree_with_a_loop_over_corners(rng):
    values = random_values(rng, 3, 4, 6, 7)
    warp = Warp(values, *nodes(3, 4))
    phi, theta = random_parameters(rng, 50)
    points = rng.random((50, 2))
    data = normalised(values)
    expected = [slow_density(data, *points[k], phi[k], theta[k]) for k in range(50)]
    np.testing.assert_allclose(warp.evaluate(points, phi, theta), expected, rtol=1e-10, atol=1e-12)


def normalised(values):
    """Densities (P, T, R, C) of integral 1, by the trapezoidal rule over unit cells."""
    values = values.astype(float)
    cells = (values[:, :, 1:] + values[:, :, :-1])[..., 1:] + (values[:, :, 1:] + values[:, :, :-1])[..., :-1]
    return values / (cells.sum(axis=(2, 3), keepdims=True) / 4)


def slow_density(data, x, y, phi, theta):
    """Multilinear interpolation written out over the sixteen corners."""
    rows, cols = data.shape[2:]

    def hats(value, nodes):
        return [np.interp(value, nodes, np.eye(len(nodes))[k]) for k in range(len(nodes))]

    total = 0.0
    for p, wp in enumerate(hats(phi, np.linspace(-np.pi, 0, data.shape[0]))):
        for t, wt in enumerate(hats(theta, np.linspace(0, 1.5, data.shape[1]))):
            for r, wr in enumerate(hats(y, np.linspace(0, 1, rows))):
                for c, wc in enumerate(hats(x, np.linspace(0, 1, cols))):
                    total += wp * wt * wr * wc * data[p, t, r, c]
    return total * (rows - 1) * (cols - 1)
