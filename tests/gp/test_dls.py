"""Claims about the search of Hooke & Jeeves."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import Bounds, minimize, rosen

from manifold.core.errors import UsageError
from manifold.dls import OUT_OF_EVALUATIONS, STOPPED, direct_local_search, hooke_jeeves


def booth(x):
    return (x[0] + 2 * x[1] - 7) ** 2 + (2 * x[0] + x[1] - 5) ** 2


def kinked(x):
    return abs(x[0] - 1.0) + 2.0 * abs(x[1] + 0.3)


@pytest.mark.parametrize(
    ("function", "start", "minimum"),
    [(rosen, [-1.2, 1.0], [1.0, 1.0]), (booth, [0.0, 0.0], [1.0, 3.0]), (kinked, [3.0, 3.0], [1.0, -0.3])],
)
def test_known_minima_are_found_through_scipy(function, start, minimum):
    result = minimize(function, start, method=hooke_jeeves, tol=1e-8)
    assert result.success, result.message
    np.testing.assert_allclose(result.x, minimum, atol=1e-5)  # Rosenbrock's valley is flat: sqrt of tol
    assert result.fun == function(result.x)


def test_evaluations_are_counted_and_limited():
    calls = []

    def counted(x):
        calls.append(x)
        return rosen(x)

    result = minimize(counted, [-1.2, 1.0], method=hooke_jeeves, options={"maxfev": 57})
    assert result.status == OUT_OF_EVALUATIONS
    assert not result.success
    assert result.nfev == 57
    assert result.fun == rosen(result.x) == min(map(rosen, calls))


def test_no_point_outside_the_bounds_is_evaluated():
    def guarded(x):
        assert -2.0 <= x[0] <= 0.5
        assert x[1] <= 2.0
        return rosen(x)

    bounds = [(-2.0, 0.5), (None, 2.0)]
    result = minimize(guarded, [-3.0, 1.0], method=hooke_jeeves, bounds=bounds, tol=1e-8)
    np.testing.assert_allclose(result.x, [0.5, 0.25], atol=1e-5)
    other = minimize(
        guarded, [-3.0, 1.0], method=hooke_jeeves, bounds=Bounds([-2, -np.inf], [0.5, 2]), tol=1e-8
    )
    assert np.array_equal(result.x, other.x)


def test_stop_iteration_in_the_callback_ends_the_search():
    seen = []

    def stop_at_third(intermediate_result):
        seen.append(intermediate_result.fun)
        if len(seen) == 3:
            raise StopIteration

    result = minimize(rosen, [-1.2, 1.0], method=hooke_jeeves, callback=stop_at_third)
    assert result.status == STOPPED
    assert result.nit == 3
    assert seen == sorted(seen, reverse=True)
    assert result.fun == seen[-1]


def test_extra_arguments_reach_the_function():
    result = minimize(lambda x, a: (x[0] - a) ** 2, [0.0], args=(4.0,), method=hooke_jeeves)
    assert result.x == pytest.approx([4.0], abs=1e-6)


def test_values_that_are_not_numbers_are_never_accepted():
    result = minimize(lambda x: np.nan if x[0] < 1.0 else x[0] ** 2, [3.0], method=hooke_jeeves)
    assert result.x == pytest.approx([1.0], abs=1e-5)


def test_constraints_are_refused():
    with pytest.raises(UsageError, match="not constraints"):
        minimize(booth, [0.0, 0.0], method=hooke_jeeves, constraints={"type": "eq", "fun": booth})


class Recorded:
    """A quadratic that moves by whole steps and counts jumps."""

    def __init__(self):
        self.x = np.array([3.0, -2.0, 1.0])
        self.jumps = 0

    @property
    def value(self):
        return self._at(self.x)

    def _at(self, x):
        return float(np.sum((x - 0.25) ** 2))

    def explore(self, steps, heading, limits, budget):
        assert budget > 0
        for index, step in enumerate(steps):
            for sense in (1.0, -1.0):
                moved = self.x.copy()
                moved[index] += sense * step
                if self._at(moved) < self.value:
                    self.x = moved
                    break
        return 6

    def move_to(self, x):
        self.x, self.jumps = x.copy(), self.jumps + 1


def test_incremental_form_ends_at_the_minimum_and_stands_there():
    objective = Recorded()
    result = direct_local_search(objective, tolerance=1e-7)
    np.testing.assert_allclose(result.x, 0.25, atol=1e-6)
    assert np.array_equal(objective.x, result.x)
    assert objective.jumps > 0  # pattern moves


def test_a_function_without_a_finite_value_is_no_success():
    found = minimize(lambda x: np.nan, [1.0, 2.0], method=hooke_jeeves)
    assert not found.success
    assert found.message == "no finite value was found"
