"""Colour differences agree with published pairs, and are taken where instruments take them."""

from __future__ import annotations

import numpy as np
import pytest

from manifold.colour.conversion import sensor_responses, xyz_weights
from manifold.colour.difference import (
    ASPECULAR_DEG,
    ILLUMINANTS,
    colour_differences,
    delta_e_2000,
    delta_e_2000_lab,
    delta_e_itp,
    illuminants_for,
    lab_under_d65,
    multi_angle_pairs,
    to_lab,
)
from manifold.colour.illuminants import Illuminant, illuminant_power
from manifold.core.errors import ShapeError, UsageError
from manifold.core.records import Bands
from manifold.formats.readings import Viewing
from manifold.io_rgl import rgl_wavelengths_nm

RGB = Bands(None)
SPECTRAL = Bands(tuple(rgl_wavelengths_nm()))

# Sharma, Wu & Dalal 2005, table 1: two L*a*b* colours and their difference.
PUBLISHED = [
    ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
    ((50.0, 3.1571, -77.2803), (50.0, 0.0, -82.7485), 2.8615),
    ((50.0, -1.3802, -84.2814), (50.0, 0.0, -82.7485), 1.0000),
    ((50.0, 2.5, 0.0), (50.0, 0.0, -2.5), 4.3065),
    ((50.0, 2.5, 0.0), (73.0, 25.0, -18.0), 27.1492),
    ((50.0, 2.5, 0.0), (61.0, -5.0, 29.0), 22.8977),
    ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
    ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
]


def xyz_of_lab(lab, white):
    """The inverse of CIE 15's definition of L*a*b*."""
    y = (lab[0] + 16.0) / 116.0
    t = np.array([y + lab[1] / 500.0, y, y - lab[2] / 200.0])
    return np.where(t > 6 / 29, t**3, 3 * (6 / 29) ** 2 * (t - 4 / 29)) * white


@pytest.mark.parametrize("illuminant", ILLUMINANTS)
@pytest.mark.parametrize(("first", "second", "expected"), PUBLISHED)
def test_published_pairs_have_their_difference(first, second, expected, illuminant):
    white = xyz_weights(SPECTRAL, illuminant).sum(axis=0)
    found = delta_e_2000(xyz_of_lab(first, white), xyz_of_lab(second, white), white)
    assert found == pytest.approx(expected, abs=1e-4)  # the table has four decimals


def test_geometries_lie_at_their_aspecular_angles_in_the_plane_of_incidence():
    wi, wo = multi_angle_pairs()
    mirror = wi * [-1, -1, 1]
    angle = np.rad2deg(np.arccos(np.sum(mirror * wo, axis=1)))
    np.testing.assert_allclose(angle, np.abs(ASPECULAR_DEG), atol=1e-9)
    np.testing.assert_allclose(wo[:, 1], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.rad2deg(np.arccos(wi[:, 2])), 45.0)
    # -15 is beyond the mirror direction, 45 the normal, 75 and 110 on the side of the light.
    sides = np.sign(np.round(wo[:, 0] * np.sign(wi[:, 0]), 12))
    np.testing.assert_array_equal(sides, [-1, -1, -1, 0, 1, 1])
    assert np.all(wo[:, 2] > 0)


@pytest.mark.parametrize("bands", [RGB, SPECTRAL])
def test_equal_values_do_not_differ_and_order_does_not_matter(bands, rng):
    f, g = rng.uniform(0.0, 1.0, (2, 6, bands.count))
    for illuminant in illuminants_for(bands):
        delta_e, angle = colour_differences(f, f, bands, illuminant)
        assert np.all(delta_e == 0.0)
        np.testing.assert_allclose(angle, 0.0, atol=1e-9)
        forth, back = colour_differences(f, g, bands, illuminant), colour_differences(g, f, bands, illuminant)
        np.testing.assert_allclose(forth, back, rtol=1e-9)
        assert np.all(forth[0] > 0.0)


@pytest.mark.parametrize(("bands", "illuminant"), [(RGB, "D65"), *((SPECTRAL, name) for name in ILLUMINANTS)])
def test_grey_diffusers_differ_by_lightness_alone(bands, illuminant):
    """L* of reflectances 0.18 and 0.2 from its definition, weighted as CIEDE2000 weights lightness."""
    L = 116.0 * np.cbrt([0.18, 0.2]) - 16.0
    middle = (L.mean() - 50.0) ** 2
    expected = (L[1] - L[0]) / (1.0 + 0.015 * middle / np.sqrt(20.0 + middle))
    low, high = (np.full(bands.count, r / np.pi) for r in (0.18, 0.2))
    delta_e, angle = colour_differences(low, high, bands, illuminant)
    assert delta_e == pytest.approx(expected, abs=1e-3)  # colour-science rounds the white's chromaticity
    assert angle == pytest.approx(0.0, abs=1e-9)


def test_what_an_illuminant_does_not_light_makes_no_difference():
    nm = rgl_wavelengths_nm()
    f = np.linspace(0.1, 0.3, 195)
    for illuminant in ILLUMINANTS:
        dark = illuminant_power(SPECTRAL, illuminant) == 0.0
        lit_near = np.convolve(~dark, [1, 1, 1], mode="same") > 0  # interpolation reaches one band further
        dark &= ~lit_near
        assert np.any(dark & (nm > 800))
        g = np.where(dark, 5.0, f)
        delta_e, angle = colour_differences(f, g, SPECTRAL, illuminant)
        assert delta_e == pytest.approx(0.0, abs=1e-9)
        assert angle == pytest.approx(0.0, abs=1e-9)


def test_metamers_differ_under_another_illuminant_only():
    """A spectrum changed within the null space of D65 and the observer."""
    f = np.full(195, 0.15)
    W = xyz_weights(SPECTRAL, "D65")
    change = np.sin(rgl_wavelengths_nm() / 15.0) * 0.05
    change -= W @ np.linalg.lstsq(W, change, rcond=None)[0]
    d65, lamp = (colour_differences(f, f + change, SPECTRAL, name)[0] for name in ("D65", "F11"))
    assert d65 == pytest.approx(0.0, abs=1e-6)
    assert lamp > 0.5


def test_shapes_that_differ_are_refused():
    with pytest.raises(ShapeError, match="expected the same"):
        colour_differences(np.ones((2, 3)), np.ones((3, 3)), RGB, "D65")


def test_delta_e_itp_is_that_of_the_recommendation():
    """The formulas of ITU-R BT.2100 and BT.2124, written out."""
    xyz = np.array([[0.4, 0.35, 0.3], [0.9505, 1.0, 1.089], [0.05, 0.04, 0.2]])
    other = 0.9 * xyz[:, [0, 1, 2]] + [0.0, 0.01, 0.02]
    to_rgb = np.array(
        [
            [1.71665119, -0.35567078, -0.25336628],
            [-0.66668435, 1.61648124, 0.01576855],
            [0.01763986, -0.04277061, 0.94210312],
        ]
    )
    to_lms = np.array([[1688, 2146, 262], [683, 2951, 462], [99, 309, 3688]]) / 4096
    to_itp = np.array([[2048, 2048, 0], [6610, -13613, 7003], [17933, -17390, -543]]) / 4096

    def itp(c):
        y = (np.clip(100.0 * c @ to_rgb.T @ to_lms.T, 0, None) / 10_000) ** (2610 / 16384)
        pq = ((3424 / 4096 + 2413 / 128 * y) / (1 + 2392 / 128 * y)) ** (2523 / 32)
        return pq @ to_itp.T * [1.0, 0.5, 1.0]

    expected = 720.0 * np.linalg.norm(itp(xyz) - itp(other), axis=1)
    # Colours are adapted to the very white they have: the matrices differ in the fourth digit.
    np.testing.assert_allclose(delta_e_itp(xyz, other), expected, rtol=2e-2)
    assert not np.any(delta_e_itp(xyz, xyz))


@pytest.mark.parametrize(("illuminant", "observer"), [("D65", 2), ("D65", 10), ("A", 2), ("D50", 10)])
def test_a_colour_under_any_light_is_that_of_its_reflectance_under_d65(illuminant, observer):
    nm, weights = sensor_responses(Illuminant.named(illuminant), observer)
    reflectance = 0.2 + 0.5 / (1.0 + np.exp((560.0 - nm) / 40.0))  # an orange
    of_d65 = sensor_responses(Illuminant.named("D65"))[1]
    lab, expected = (to_lab(reflectance @ w, w.sum(axis=0)) for w in (weights, of_d65))
    found = delta_e_2000_lab(lab_under_d65(lab, Viewing(illuminant, observer)), expected)
    assert found < max(0.1, 0.5 * delta_e_2000_lab(lab, expected))  # what is left is metamerism
    white = np.array([100.0, 0.0, 0.0])
    np.testing.assert_allclose(lab_under_d65(white, Viewing(illuminant, observer)), white, atol=0.05)


def test_an_observer_that_is_none_is_refused():
    with pytest.raises(UsageError, match="an observer of 5 degrees, expected 2"):
        lab_under_d65(np.array([50.0, 0.0, 0.0]), Viewing("D65", 5))
