"""Pareto fronts against the definition, pair by pair."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from manifold.study.chart import dominators

COSTS = arrays(
    float, st.tuples(st.integers(1, 12), st.integers(1, 4)), elements=st.sampled_from([0, 1, 2, 3, 9])
)
TWO_COSTS = arrays(float, st.tuples(st.integers(1, 12), st.just(2)), elements=st.sampled_from(range(12)))


def front(costs, tolerance=0.0):
    """Whether no other row dominates a row, bool, shape (M,)."""
    return np.array([not others for others in dominators(costs, tolerance)])


def _dominates(a, b, tolerance):
    """Whether a is clearly better than b in one column, and b than a in none."""

    def better(x, y):
        return any(p + s < q - t for p, q, s, t in zip(x[0], y[0], x[1], y[1], strict=True))

    a, b = (a, tolerance[0]), (b, tolerance[1])
    return better(a, b) and not better(b, a)


def _expected(costs, tolerance):
    pairs = list(zip(costs, tolerance, strict=True))
    return [[j for j, (a, s) in enumerate(pairs) if _dominates(a, b, (s, t))] for b, t in pairs]


@given(COSTS, st.data())
def test_dominators_are_those_of_the_definition(costs, data):
    tolerance = data.draw(arrays(float, costs.shape, elements=st.sampled_from([0.0, 0.5, 1.25, 4.0])))
    assert dominators(costs, tolerance) == _expected(costs, tolerance)


@given(COSTS)
def test_without_tolerance_settings_off_the_front_are_dominated_by_one_on_it(costs):
    on = front(costs)
    assert on.any()
    for row, others in enumerate(dominators(costs)):
        assert on[row] or any(on[j] for j in others)


@given(COSTS)
def test_without_tolerance_the_cheapest_of_any_axis_is_matched_on_the_front(costs):
    on = costs[front(costs)]
    assert np.array_equal(on.min(axis=0), costs.min(axis=0))


@given(TWO_COSTS, st.data())
def test_in_two_columns_a_chain_of_dominators_ends_on_the_front_whatever_the_tolerance(costs, data):
    tolerance = data.draw(arrays(float, costs.shape, elements=st.sampled_from([0.0, 0.6, 1.1, 3.0])))
    dominators_of = dominators(costs, tolerance)
    for row in range(len(costs)):
        for _ in costs:
            row = dominators_of[row][0] if dominators_of[row] else row
        assert not dominators_of[row]


def test_settings_within_the_tolerance_of_each_other_stay_on_the_front_together():
    costs = np.array([[1.0, 5.0], [1.2, 4.9], [2.0, 5.0]])
    assert front(costs, 0.15).tolist() == [True, True, False]
    assert front(costs).tolist() == [True, True, False]
    assert front(np.array([[1.0, 5.0], [1.2, 5.1]])).tolist() == [True, False]
    assert front(np.array([[1.0, 5.0], [1.2, 5.1]]), 0.15).tolist() == [True, True]
