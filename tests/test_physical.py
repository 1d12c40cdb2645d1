"""Projection to physical BRDFs: nothing negative, reciprocal, no more light out than in."""

from __future__ import annotations

import numpy as np
import pytest

from manifold.brdf.measured import BRDF
from manifold.brdf.physical import PhysicalBRDF
from manifold.brdf.plausibility import plausibility
from manifold.directions import from_spherical
from manifold.records import Bands
from manifold.synthetic.analytic import Lambert

BANDS = Bands((500.0, 600.0))


class Tampered:
    """A Lambertian BRDF of albedo 0.5 and 1.5, with a negative and a non-reciprocal part."""

    bands = BANDS
    is_isotropic = True

    def __init__(self, tilt: float, dip: float):
        """Add tilt * (1 - cos(theta_i)) and subtract dip where both directions are steep."""
        self._tilt, self._dip = tilt, dip
        self._base = Lambert(np.array([0.5, 1.0]), BANDS)
        self.sample, self.pdf = self._base.sample, self._base.pdf

    def eval(self, wi, wo):
        wi, wo = np.broadcast_arrays(wi, wo)
        f = np.array([0.5, 1.5]) / np.pi + self._tilt * (1 - wi[..., 2:])
        return (f - self._dip * (wi[..., 2:] > 0.9) * (wo[..., 2:] > 0.9)) * (wo[..., 2:] > 0)

    def eval_cos(self, wi, wo):
        return self.eval(wi, wo) * np.maximum(np.asarray(wo)[..., 2:], 0)

    def albedo(self, wi):
        raise NotImplementedError


def test_a_projected_brdf_is_physical():
    before = plausibility(Tampered(0.2, 1.0))
    assert before.negative_share > 0
    assert before.reciprocity_error > 0.05
    assert before.max_albedo > 1.2
    after = plausibility(PhysicalBRDF(Tampered(0.2, 1.0)))
    assert after.negative_share == 0
    assert after.reciprocity_error < 1e-12
    assert after.max_albedo <= 1.001


def test_bands_that_return_too_much_are_scaled_and_others_are_not():
    projected = PhysicalBRDF(Tampered(0.0, 0.0))
    np.testing.assert_allclose(projected.scale, [1.0, 1 / 1.5], rtol=3e-3)
    assert projected.scale[0] == 1.0


def test_a_physical_brdf_stays_as_it_is():
    brdf: BRDF = Lambert(np.array([0.5, 0.9]), BANDS)
    wi, wo = from_spherical(0.7, 0.1), from_spherical(0.2, 2.0)
    np.testing.assert_allclose(PhysicalBRDF(brdf).eval(wi, wo), brdf.eval(wi, wo), rtol=1e-14)


@pytest.mark.parametrize("theta", [0.0, 0.5, 1.2])
def test_albedo_is_the_integral_of_what_is_evaluated(theta):
    brdf = PhysicalBRDF(Lambert(np.array([0.5, 0.9]), BANDS))
    np.testing.assert_allclose(brdf.albedo(from_spherical(theta, 0.0)), [0.5, 0.9], rtol=5e-3)
