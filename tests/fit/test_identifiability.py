"""What residuals and their derivatives say of fitted values."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from manifold.fit.identifiability import (
    DETERMINED,
    UNCERTAIN,
    as_good_limit,
    gauss_newton_step,
    identify_parameters,
)
from manifold.render.bsdf_parameters import BsdfFamily, FreeParameter, ParameterLayout

LAYOUT = ParameterLayout(
    BsdfFamily("principled", tuple(FreeParameter(name, 0.0, 1.0, 0.5, tolerance=0.02) for name in "ab")), 1
)


def identified(p, J, kept=(False, False)):
    """Statements on both values, under a standard deviation of residuals of 0.1."""
    return identify_parameters(LAYOUT, np.array(p), np.array(J), 0.01, [], np.array(kept))


@pytest.mark.parametrize(
    ("value", "is_at_bound"), [(0.0, True), (0.001, True), (0.01, False), (0.9995, True)]
)
def test_values_at_an_end_of_the_range_are_told_unless_they_are_defaults(value, is_at_bound):
    J = 100.0 * np.eye(2)
    assert [s.at_bound for s in identified([value, 0.5], J)] == [is_at_bound, False]
    assert not identified([value, 0.5], J, (True, False))[0].at_bound


@pytest.mark.parametrize(("along", "names"), [(30.0, ["b", "a"]), (0.7, [None, None])])
def test_values_that_only_change_together_are_entangled(along, names):
    """Their sum is seen; correlations are -0.9999 and, as the prior says something of each, -0.8."""
    found = identified([0.5, 0.5], along * np.ones((1, 2)))
    assert {s.state for s in found} == {UNCERTAIN}
    assert [s.entangled_with for s in found] == names


def test_determined_values_are_not_entangled():
    found = identified([0.5, 0.5], [[1e4, 1e4], [50.0, -50.0]])
    assert {(s.state, s.entangled_with) for s in found} == {(DETERMINED, None)}


def test_noise_hides_differences_of_costs_as_a_chi_square_test_says():
    assert as_good_limit(0.5, 3) == pytest.approx(0.5 * chi2.ppf(0.99, 3))


def test_a_step_is_at_most_a_tenth_of_a_range_and_ends_in_it():
    step, promised = gauss_newton_step(LAYOUT, np.array([0.5, 0.97]), np.array([-9.0, -9.0]), np.eye(2))
    np.testing.assert_allclose(step, [0.1, 0.03], atol=1e-6)
    assert promised > 0.0
