"""Pareto fronts against the definition, pair by pair."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from manifold.pareto import dominators, front

COSTS = arrays(
    float, st.tuples(st.integers(1, 12), st.integers(1, 4)), elements=st.sampled_from([0, 1, 2, 3, 9])
)


def _dominates(a, b):
    return all(x <= y for x, y in zip(a, b, strict=True)) and any(x < y for x, y in zip(a, b, strict=True))


@given(COSTS)
def test_dominators_are_those_of_the_definition(costs):
    expected = [[j for j, a in enumerate(costs) if _dominates(a, b)] for b in costs]
    assert dominators(costs) == expected


@given(COSTS)
def test_whatever_is_off_the_front_is_dominated_by_one_that_is_on_it(costs):
    on = front(costs)
    assert on.any()
    for row, beaten in enumerate(dominators(costs)):
        assert on[row] or any(on[j] for j in beaten)


@given(COSTS)
def test_the_cheapest_of_any_axis_is_matched_on_the_front(costs):
    on = costs[front(costs)]
    assert np.array_equal(on.min(axis=0), costs.min(axis=0))
