"""Claims about coherence: what lies between two materials, and which similar ones are neighbours."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from manifold.colour import panel
from manifold.model.coherence import LOST, Coherence, Pair, measure_coherence, typical_pair

X = np.linspace(0.0, 1.0, 8)[:, None]


def grey(reflectance: float) -> np.ndarray:
    """CIE XYZ of a ball that has one luminance in all lights."""
    count = int(panel.judged().counts.sum())
    return np.full((count, 3), reflectance) * [0.95, 1.0, 1.09]


BALLS = [grey(0.1 + 0.8 * float(x)) for x in X[:, 0]]


def test_a_map_of_greys_in_order_has_no_detours_and_keeps_its_neighbours():
    found, pairs = measure_coherence(X, BALLS.__getitem__, lambda x: grey(0.1 + 0.8 * float(x[0])))
    assert found.detour == pytest.approx(1.0, abs=0.01)  # CIEDE2000 of greys is nearly additive
    assert found.detour_far == 0.0
    assert found.neighbours_kept > 0.85
    assert {abs(pair.first - pair.second) for pair in pairs} == {1}
    assert found.warning is None


def test_another_material_halfway_is_a_detour():
    found, _ = measure_coherence(X, BALLS.__getitem__, lambda x: grey(0.0))
    assert found.detour > 3.0
    assert found.detour_far == 1.0


def test_a_map_that_loses_its_neighbours_says_so(rng):
    places = np.arange(40)[:, None].astype(float)
    shuffled = [grey(0.02 * r) for r in rng.permutation(40)]
    found, _ = measure_coherence(places, shuffled.__getitem__, lambda x: grey(0.5))
    assert found.neighbours_kept < LOST
    assert "expected at least 25 %" in found.warning


def test_materials_that_look_alike_have_nothing_between_them():
    assert measure_coherence(X, lambda i: grey(0.5), lambda x: grey(0.5)) == (None, [])


def test_measures_are_kept_with_the_statistics_of_a_fit():
    found = Coherence(1.1, 1.4, 0.05, 0.8)
    assert Coherence.from_statistics(json.loads(json.dumps(found.statistics))) == found
    assert Coherence.from_statistics({"objective": 1.0}) is None


def test_the_typical_pair_is_mutual_and_of_median_difference():
    a = [Pair(0, 1, 2.0, 1.0), Pair(1, 0, 2.0, 1.0), Pair(2, 3, 5.0, 1.0), Pair(3, 2, 5.0, 1.0)]
    b = [Pair(4, 5, 9.0, 1.0), Pair(5, 4, 9.0, 1.0), Pair(6, 0, 4.0, 1.0)]
    assert typical_pair([*a, *b]) == a[2]
    assert typical_pair([replace(a[0], first=4)]).first == 4  # none is mutual
