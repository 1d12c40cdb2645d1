"""Analytic lobes that serve as samples."""

from __future__ import annotations

import numpy as np
import pytest

from manifold.analytic.free_lobes import (
    ROUGHNESSES,
    TAILS,
    Lobes,
    bernstein,
    cos_theta_d,
    microfacet_lobe,
)
from manifold.analytic.ggx import GGX, normal_distribution
from manifold.core.directions import from_spherical, to_rusinkiewicz
from manifold.gp.nonnegative import nonnegative_weights


def directions(rng, n):
    theta, phi = rng.uniform(0, 0.5 * np.pi, (2, n)), rng.uniform(-np.pi, np.pi, (2, n))
    return from_spherical(theta[0], phi[0]), from_spherical(theta[1], phi[1])


@pytest.mark.parametrize("alpha", ROUGHNESSES)
@pytest.mark.parametrize("tail", [*TAILS, 1.1])
def test_normals_cover_the_surface_once(alpha, tail):
    """Gauss-Legendre in log(tan), where distributions are smooth from alpha / 100 outwards."""
    t, weights = np.polynomial.legendre.leggauss(400)
    low, high = np.log(1e-3 * alpha), np.log(1e4)
    tangent = np.exp(0.5 * (high - low) * (t + 1.0) + low)
    theta = np.arctan(tangent)
    # d theta = cos^2 d tan, and d tan = tan d log(tan)
    measure = 0.5 * (high - low) * weights * tangent * np.cos(theta) ** 2 * 2.0 * np.pi * np.sin(theta)
    covered = measure @ (normal_distribution(np.cos(theta), alpha, tail) * np.cos(theta))
    assert covered == pytest.approx(1.0, abs=2e-4)  # what lies within alpha / 1000 and beyond tan = 10^4


@pytest.mark.parametrize("alpha", [0.01, 0.2, 0.7])
def test_tail_2_is_ggx(alpha, rng):
    wi, wo = directions(rng, 400)
    expected = GGX.isotropic(alpha).reflection_factor(wi, wo)
    # 1 - (1 - alpha^2) cos^2 loses digits next to the normal
    np.testing.assert_allclose(microfacet_lobe(wi, wo, alpha), expected, rtol=1e-8)


def test_lobes_are_reciprocal_and_never_negative(rng):
    wi, wo = directions(rng, 500)
    roots = Lobes().cube_roots(wi, wo)
    assert roots.shape == (145, 500)
    assert roots.min() >= 0.0
    np.testing.assert_allclose(roots, Lobes().cube_roots(wo, wi), rtol=1e-9)


def test_polynomials_are_a_partition_of_unity_in_the_cosine_of_theta_d(rng):
    wi, wo = directions(rng, 300)
    c = cos_theta_d(wi, wo)
    np.testing.assert_allclose(c, np.cos(to_rusinkiewicz(wi, wo)[1]), atol=1e-12)
    values = bernstein(c, 5)
    assert values.min() >= 0.0
    np.testing.assert_allclose(values.sum(axis=0), 1.0, rtol=1e-12)


@pytest.mark.parametrize("F0", [0.04, 0.5, 1.0])
def test_schlicks_fresnel_term_is_a_non_negative_combination(F0):
    c = np.linspace(0.0, 1.0, 300)
    values = bernstein(c, 5)
    schlick = F0 + (1.0 - F0) * (1.0 - c) ** 5
    weights = nonnegative_weights(values @ values.T, schlick[None] @ values.T)
    np.testing.assert_allclose(weights @ values, schlick[None], atol=1e-6)


def test_nothing_is_reflected_below_the_horizon_or_between_opposite_directions(rng):
    wi, wo = directions(rng, 30)
    assert not np.any(Lobes().cube_roots(wi, wo * [1, 1, -1]))
    assert not np.any(Lobes().cube_roots(wi, -wi))
