"""How physical BRDFs are: holes around the mirror direction, at any azimuth."""

from __future__ import annotations

import numpy as np
import pytest

from manifold.analytic.base import Lambert
from manifold.brdf.plausibility import (
    ASSESSED_INCIDENCES_DEG,
    mirror_difference,
    plausibilities,
    profile_pairs,
    valley_depth,
)
from manifold.core.records import Bands


def _highlight(wi, wo, hole):
    """A lobe over angles from the mirror direction, with a dark ring at 10 degrees, `hole` deep, (1, P, 1)."""
    mirror = wi * [-1.0, -1.0, 1.0]
    away = np.rad2deg(np.arccos(np.clip(np.sum(mirror * wo, axis=1), -1.0, 1.0)))
    f = 1.0 / (1.0 + 0.01 * away)
    return (f * (1.0 - hole * np.exp(-(((away - 10.0) / 2.0) ** 2))))[None, :, None]


@pytest.mark.parametrize("hole", [0.2, 0.6])
def test_a_ring_around_the_mirror_direction_is_as_deep_as_it_is_made(hole):
    (found,) = plausibilities(lambda wi, wo: _highlight(wi, wo, hole))
    beyond = (
        1.0 - (1.0 - hole) * 1.14 / 1.10
    )  # its outer side, at some 14 degrees, is lower than the ring's own level
    assert found.highlight_valley == pytest.approx(beyond, abs=0.02)


def test_a_lobe_that_falls_on_both_sides_and_a_level_one_have_no_valley():
    assert plausibilities(lambda wi, wo: _highlight(wi, wo, 0.0))[0].highlight_valley == 0.0
    assert plausibilities(lambda wi, wo: np.full((1, len(wi), 3), 0.3))[0].highlight_valley == 0.0


def test_a_rise_towards_grazing_beside_a_weak_highlight_is_no_valley():
    def paint(wi, wo):
        rise = 0.1 * np.exp(0.8 * np.arccos(wo[:, 2]))
        return rise[None, :, None] + 0.05 * _highlight(wi, wo, 0.0) ** 20

    wi, wo = np.broadcast_arrays(*profile_pairs(ASSESSED_INCIDENCES_DEG))
    profiles = paint(wi.reshape(-1, 3), wo.reshape(-1, 3)).reshape(wo.shape[:2])
    assert valley_depth(profiles).max() > 0.1
    assert plausibilities(paint)[0].highlight_valley < 1e-6


def test_a_hole_at_one_azimuth_of_an_anisotropic_brdf_is_found():
    def at_90_degrees(wi, wo):
        return np.where(np.abs(wi[:, 0:1]) < 1e-6, _highlight(wi, wo, 0.5)[0], 1.0)[None]

    assert plausibilities(at_90_degrees)[0].highlight_valley == 0.0
    assert plausibilities(at_90_degrees, is_isotropic=False)[0].highlight_valley > 0.4


def test_difference_near_mirror_directions_is_relative_and_that_of_the_worst_incidence():
    class Brighter(Lambert):
        def eval(self, wi, wo):
            wi, wo = np.broadcast_arrays(wi, wo)
            return super().eval(wi, wo) * np.where(wi[..., 2:] < np.cos(np.deg2rad(72.0)), 1.2, 1.1)

    albedo, bands = np.array([0.4, 0.2]), Bands((500.0, 600.0))
    assert mirror_difference(Lambert(albedo, bands), Lambert(albedo, bands)) == 0.0
    assert mirror_difference(Lambert(albedo, bands), Brighter(albedo, bands)) == pytest.approx(0.2)
