"""Claims about layouts of which some samples are landmarks."""

from __future__ import annotations

import numpy as np
from helpers import reference
from scipy.spatial.distance import cdist

from manifold.brdf.plausibility import squared_valleys, squared_valleys_of_some
from manifold.model.blending import NEIGHBOURS, blend_layout, blend_weights
from manifold.model.landmarks import Comparison, _local_blends, farthest_samples, landmark_layout


def test_landmarks_cover_all_samples(rng):
    X = rng.normal(size=(300, 2))
    chosen = farthest_samples(30, lambda i: cdist(X, X[i : i + 1])[:, 0])
    assert len(set(chosen.tolist())) == 30
    reach = cdist(X, X[chosen]).min(axis=1).max()
    drawn = max(cdist(X, X[rng.choice(300, 30, replace=False)]).min(axis=1).max() for _ in range(20))
    assert reach < 0.7 * drawn  # random landmarks leave those at the rim far away


def test_copies_are_no_landmarks():
    X = np.array([[0.0], [0.0], [1.0], [1.0]])
    assert farthest_samples(4, lambda i: np.abs(X - X[i])[:, 0]).tolist() == [0, 2]


def test_all_samples_are_where_their_distances_put_them(rng):
    """Samples of a plane whose distances to 12 of them, and to their neighbours, are known."""
    truth = rng.uniform(-3.0, 3.0, size=(120, 2))
    distance = cdist(truth, truth)
    landmarks = farthest_samples(12, lambda i: distance[i])
    at = distance[np.ix_(landmarks, landmarks)]
    of_landmarks = blend_layout(at, 0.0 * at, 0.0 * at, 2)

    def compare(others):
        apart = np.take_along_axis(distance, others, axis=1)
        return Comparison(others, apart, 0.0 * apart)

    to_landmarks = compare(np.broadcast_to(landmarks, (120, 12)))
    free = lambda u, _: (np.zeros(len(u)), np.zeros_like(u))  # noqa: E731
    layout = landmark_layout(landmarks, of_landmarks, to_landmarks, compare, free)
    found = layout.unit * cdist(layout.X, layout.X)
    upper = np.triu_indices(120, 1)
    np.testing.assert_allclose(found[upper], distance[upper], rtol=0.02, atol=0.02)  # ends of L-BFGS-B


def test_gradient_of_local_blends_agrees_with_central_differences(rng):
    X, landmarks = rng.normal(size=(9, 2)), np.array([0, 3, 5])
    shares = rng.dirichlet(np.ones(3), size=4)
    nearest = np.stack([rng.choice(9, 5, replace=False) for _ in range(4)])
    cost = lambda u, materials: (np.sum((1 + materials) * u**3, axis=1), 3.0 * (1 + materials) * u**2)  # noqa: E731
    blends = _local_blends(shares, landmarks, nearest, 0.8, cost, 2.0)
    numeric = reference.central_differences(lambda x: blends(x)[0], X)
    np.testing.assert_allclose(blends(X)[1], numeric, rtol=1e-5, atol=1e-7)  # h = 1e-5


def test_valleys_of_blends_of_some_are_those_of_blends_of_all(rng):
    profiles = np.cbrt(rng.uniform(0.1, 1.0, size=(7, 2, 11, 3)))
    limits = rng.uniform(0.0, 0.05, size=7)
    some = np.stack([rng.choice(7, 3, replace=False) for _ in range(5)])
    u = rng.dirichlet(np.ones(3), size=5)
    whole = np.zeros((5, 7))
    np.put_along_axis(whole, some, u, axis=1)
    value, gradient = squared_valleys_of_some(u, some, profiles, limits)
    expected, slope = squared_valleys(whole, profiles, limits)
    np.testing.assert_allclose(value, expected, rtol=1e-9)
    np.testing.assert_allclose(gradient, np.take_along_axis(slope, some, axis=1), rtol=1e-9)


def test_weights_among_thousands_are_of_neighbours_and_continuous(rng):
    X = rng.uniform(-1.0, 1.0, size=(2000, 2))
    x = X[7] + np.outer(np.linspace(0.0, 1.0, 400), [0.3, 0.2])
    u = blend_weights(x, X, 0.05)
    assert np.count_nonzero(u, axis=1).max() <= NEIGHBOURS
    np.testing.assert_allclose(u.sum(axis=1), 1.0, rtol=1e-12)
    assert u[0, 7] == 1.0
    finer = blend_weights(x + 1e-7, X, 0.05)
    assert np.abs(finer - u).sum(axis=1).max() < 1e-4  # neighbours come and go with weight 0
