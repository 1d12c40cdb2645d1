"""Anisotropic samples that lie turned: found from their normals, and undone where they are evaluated."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import RoughConductor
from manifold.brdf import goniometer
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.orientation import rotation_of
from manifold.core.directions import from_spherical, rotate_z
from manifold.core.mapping import CubeRoot
from manifold.core.records import Bands, BsdfFile
from manifold.model.combination import Combination
from manifold.model.prediction import PredictedBRDF


@cache
def brushed(angle_deg: float, alpha_x: float = 0.4, alpha_y: float = 0.2) -> BsdfFile:
    """A metal whose normals spread along x, turned."""
    normals = GGX.anisotropic(alpha_x, alpha_y, float(np.deg2rad(angle_deg)))
    metal = RoughConductor(normals, np.array(1.5), np.full(3, 3.0), Bands(None))
    return goniometer.measure(metal, "brushed", resolution=16, n_theta_i=6, n_phi_i=9)


def directions(rng, n):
    return from_spherical(np.arccos(0.1 + 0.9 * rng.random(n)), 2 * np.pi * rng.random(n))


@pytest.mark.parametrize("angle_deg", [0.0, 25.0, -70.0, 90.0])
def test_the_rotation_is_found_from_the_normals(angle_deg):
    found = rotation_of(brushed(angle_deg))
    assert found is not None
    apart = (np.rad2deg(found) - angle_deg + 90.0) % 180.0 - 90.0
    assert abs(apart) < 0.2  # normals are tabulated every 2.8 degrees


def test_no_rotation_is_found_where_normals_spread_alike():
    assert rotation_of(brushed(0.0, 0.3, 0.3)) is None
    once, turned = brushed(0.0), brushed(90.0)
    assert rotation_of(replace(once, ndf=0.5 * (once.ndf + turned.ndf))) is None


def test_a_rotation_is_undone(rng):
    file = brushed(25.0)
    angle = float(np.deg2rad(25.0))
    plain, aligned = MeasuredBRDF(file), MeasuredBRDF(replace(file, rotation_rad=angle))
    wi, wo, u = directions(rng, 300), directions(rng, 300), rng.random((300, 2))
    turned = rotate_z(wi, angle), rotate_z(wo, angle)
    np.testing.assert_allclose(aligned.eval(wi, wo), plain.eval(*turned), rtol=1e-9)
    np.testing.assert_allclose(aligned.pdf(wi, wo), plain.pdf(*turned), rtol=1e-9)
    np.testing.assert_allclose(aligned.albedo(wi[:5]), plain.albedo(turned[0][:5]), rtol=1e-9)
    sampled, pdf = aligned.sample(wi, u)
    np.testing.assert_allclose(rotate_z(sampled, angle), plain.sample(turned[0], u)[0], atol=1e-9)
    valid = pdf > 0
    np.testing.assert_allclose(aligned.pdf(wi, sampled)[valid], pdf[valid], rtol=1e-6)
    again = aligned.turned(angle)
    np.testing.assert_allclose(again.eval(wi, wo), plain.eval(wi, wo), rtol=1e-9)


def test_aligned_samples_are_one_material(rng):
    first, second = brushed(0.0), brushed(-70.0)
    aligned = MeasuredBRDF(replace(second, rotation_rad=rotation_of(second)))
    wi, wo = directions(rng, 2000), directions(rng, 2000)
    expected = MeasuredBRDF(first).eval_cos(wi, wo)
    error, apart = (
        np.linalg.norm(brdf.eval_cos(wi, wo) - expected) / np.linalg.norm(expected)
        for brdf in (aligned, MeasuredBRDF(second))
    )
    assert error < 0.05  # coarse grids, at other azimuths
    assert apart > 10 * error


def test_a_prediction_is_turned_as_a_whole(rng):
    materials = [
        MeasuredBRDF(brushed(0.0)),
        MeasuredBRDF(brushed(0.0, 0.3, 0.3)),
        MeasuredBRDF(brushed(25.0)),
    ]
    predicted = PredictedBRDF(materials, Combination(CubeRoot(), np.array([0.5, 0.3, 0.2])))
    wi, wo = directions(rng, 500), directions(rng, 500)
    before = predicted.eval(wi, wo)
    found = predicted.turned(0.7)
    turned = rotate_z(wi, 0.7), rotate_z(wo, 0.7)
    np.testing.assert_allclose(found.eval(*turned), before, rtol=1e-4)  # sums are in single precision
    np.testing.assert_allclose(found.pdf(*turned), predicted.pdf(wi, wo), rtol=1e-6)
    np.testing.assert_array_equal(predicted.eval(wi, wo), before)
