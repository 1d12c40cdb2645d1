"""Claims about layouts of which some samples are landmarks."""

from __future__ import annotations

import numpy as np
from scipy.spatial.distance import cdist

from manifold.model.blending import NEIGHBOURS, blend_layout, blend_weights, nearest_distance
from manifold.model.landmarks import farthest_samples, landmark_layout


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


def test_neighbours_of_a_plane_stay_neighbours_among_few_landmarks(rng):
    """Samples of a plane whose distances from 30 of them, and from 30 candidates, are known."""
    truth = rng.uniform(-3.0, 3.0, size=(300, 2))
    distance = cdist(truth, truth)
    landmarks = farthest_samples(30, lambda i: distance[i])
    anchors = blend_layout(distance[np.ix_(landmarks, landmarks)], 2)
    X = landmark_layout(
        landmarks, anchors, distance[:, landmarks], lambda near: np.take_along_axis(distance, near, axis=1)
    )
    before, after = (np.argsort(cdist(places, places), axis=1)[:, 1:6].tolist() for places in (truth, X))
    kept = np.mean([len(set(a) & set(b)) / 5 for a, b in zip(before, after, strict=True)])
    assert kept > 0.8


def test_weights_among_thousands_are_of_neighbours_and_continuous(rng):
    X = rng.uniform(-1.0, 1.0, size=(2000, 2))
    x = X[7] + np.outer(np.linspace(0.0, 1.0, 400), [0.3, 0.2])
    u = blend_weights(x, X, 0.05)
    assert np.count_nonzero(u, axis=1).max() <= NEIGHBOURS
    np.testing.assert_allclose(u.sum(axis=1), 1.0, rtol=1e-12)
    assert u[0, 7] == 1.0
    finer = blend_weights(x + 1e-7, X, 0.05)
    assert np.abs(finer - u).sum(axis=1).max() < 1e-4  # neighbours come and go with weight 0


def test_one_place_has_the_weights_that_it_has_among_many(rng):
    X = rng.uniform(-1.0, 1.0, size=(2000, 2))
    x = np.concatenate([X[:30], rng.uniform(-1.2, 1.2, size=(70, 2))])  # enough for a search tree
    alone = np.concatenate([blend_weights(place[None], X, 0.05) for place in x])
    np.testing.assert_allclose(alone, blend_weights(x, X, 0.05), rtol=1e-9, atol=1e-15)
    gaps = np.concatenate([nearest_distance(place[None], X) for place in x])
    np.testing.assert_allclose(gaps, cdist(x, X).min(axis=1), rtol=1e-12)
    np.testing.assert_allclose(nearest_distance(x, X), gaps, rtol=1e-12)
