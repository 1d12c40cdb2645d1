"""Spectra from three narrow bands: neutral colours, exposure, and errors beside other ways to take such bands."""

from __future__ import annotations

import numpy as np
import pytest

from manifold.colour.conversion import srgb_to_xyz, to_xyz
from manifold.colour.difference import delta_e_2000
from manifold.colour.narrow_bands import (
    SPECTRUM,
    _estimated,
    _learned,
    _read,
    colour_errors,
    estimate_spectra,
    interpolation_errors,
    is_coarse,
    is_narrow,
    with_spectra,
)
from manifold.colour.reflectances import diffuse_reflectance, diffuse_reflectance_names
from manifold.core.directions import from_spherical
from manifold.core.errors import UsageError
from manifold.core.records import Array, Bands
from manifold.formats.readings import Readings

NARROW = Bands((465.0, 525.0, 630.0))
FINE_NM = np.arange(400.0, 701.0, 1.0)


def known() -> tuple[Array, Array]:
    """Measured reflectances (n, 301), and readings of them (n, 3) in bands 20 nm wide."""
    spectra = np.array([diffuse_reflectance(name, FINE_NM) for name in diffuse_reflectance_names()])
    sensors = np.exp(
        -0.5 * ((FINE_NM - np.array(NARROW.wavelengths_nm)[:, None]) / 8.5) ** 2
    )  # 20 nm at half height
    return spectra, spectra @ (sensors / sensors.sum(axis=1, keepdims=True)).T


def test_the_bands_that_were_read_are_named():
    wi = from_spherical(np.array([0.8]), 0.0)
    readings = Readings("red", "by hand", wi, wi, np.array(NARROW.wavelengths_nm), np.full((1, 3), 0.1))
    assert with_spectra(readings).bands_in_words == "3 bands, estimated at 31, 400.0 to 700.0 nm"
    assert readings.bands_in_words == str(NARROW)


def test_neutral_colours_stay_neutral_and_estimates_are_in_proportion(rng):
    np.testing.assert_allclose(estimate_spectra(np.full((2, 3), 0.3), NARROW), 0.3)
    values = rng.random((20, 3))
    np.testing.assert_allclose(
        estimate_spectra(100.0 * values, NARROW), 100.0 * estimate_spectra(values, NARROW)
    )
    assert estimate_spectra(values - 0.5, NARROW).min() >= 0.0


def test_wiener_estimates_give_better_colours_than_interpolation_or_bands_as_rgb():
    """Learned from the reflectances of every other name, those of the rest are read in bands 20 nm wide."""
    spectra, read = known()
    fine = Bands(tuple(FINE_NM))
    truth, white = to_xyz(spectra, fine), to_xyz(np.ones(len(FINE_NM)), fine)
    names = [name.partition("/")[2].lower() for name in diffuse_reflectance_names()]
    half = np.array([sorted(set(names)).index(name) % 2 for name in names])
    coarse = spectra[:, ::10]
    estimated = np.empty_like(coarse)
    for one in (0, 1):
        learned = _learned(coarse[half != one], _read(coarse[half != one], NARROW))
        estimated[half == one] = _estimated(read[half == one], learned)
    ways = {
        "estimated": to_xyz(estimated, SPECTRUM),
        "interpolated": to_xyz(read, NARROW),
        "taken for RGB": srgb_to_xyz(read[:, ::-1]),
    }
    errors = {way: delta_e_2000(xyz, truth, white) for way, xyz in ways.items()}
    for way in ("interpolated", "taken for RGB"):
        for share in (50, 90):
            assert np.percentile(errors["estimated"], share) < np.percentile(errors[way], share)
    assert np.median(errors["estimated"]) < 0.75 * np.median(errors["interpolated"])


def test_expected_colour_errors_are_those_of_reflectances_left_out():
    """They are larger than of reflectances that the estimate knows, and less than twice as large."""
    spectra, read = known()
    fine = Bands(tuple(FINE_NM))
    xyz = to_xyz(estimate_spectra(read, NARROW), SPECTRUM), to_xyz(spectra, fine)
    of_known = np.median(delta_e_2000(*xyz, to_xyz(np.ones(len(FINE_NM)), fine)))
    median, most = colour_errors(NARROW)
    assert 0.8 * of_known < median < 2.0 * of_known
    assert most > 1.5 * median


def test_a_red_keeps_its_hue():
    """Linear interpolation turns a red of a ColorChecker towards orange."""
    red = diffuse_reflectance("babel/red", np.array(SPECTRUM.wavelengths_nm))
    read = np.interp(NARROW.wavelengths_nm, SPECTRUM.wavelengths_nm, red)
    white = to_xyz(np.ones(SPECTRUM.count), SPECTRUM)

    def hue_deg(values: Array, bands: Bands) -> float:
        x, y, z = np.cbrt(to_xyz(values, bands) / white)  # none is so dark that CIELAB is linear
        return float(np.degrees(np.arctan2(200.0 * (y - z), 500.0 * (x - y))))

    truth = hue_deg(red, SPECTRUM)
    assert abs(hue_deg(estimate_spectra(read, NARROW), SPECTRUM) - truth) < 0.5 * (
        hue_deg(read, NARROW) - truth
    )


@pytest.mark.parametrize(
    ("nm", "answer"),
    [
        ((465.0, 525.0, 630.0), True),
        ((450.0, 550.0, 650.0), True),
        ((800.0, 900.0, 1000.0), False),
        ((550.0,), False),
    ],
)
def test_narrow_bands_are_blue_green_and_red(nm, answer):
    assert is_narrow(Bands(nm)) is answer
    assert not is_narrow(Bands(None))


def bands_from(*ranges: range) -> Bands:
    return Bands(tuple(float(nm) for part in ranges for nm in part))


@pytest.mark.parametrize(
    ("bands", "answer"),
    [
        (bands_from(range(400, 701, 10)), False),
        (bands_from(range(400, 701, 20)), False),
        (bands_from(range(400, 701, 25)), False),
        (bands_from(range(400, 701, 50)), True),
        (bands_from(range(400, 501, 20), range(660, 701, 20)), True),  # a gap of 160 nm
        (bands_from(range(500, 701, 20)), True),  # no blue
        (bands_from(range(400, 701, 50), range(800, 1001, 100)), True),
        (bands_from(range(800, 1001, 20)), False),  # no colour
        (NARROW, False),
        (Bands(None), False),
    ],
)
def test_bands_are_coarse_if_their_interpolation_changes_colours(bands, answer):
    assert is_coarse(bands) is answer
    if bands.count > 3 and bands.wavelengths_nm[0] < 700.0:  # as a shortcut says
        assert (interpolation_errors(bands)[1] > 1.0) is answer


@pytest.mark.parametrize("infrared", [(), (850.0, 1050.0)])
def test_colours_of_coarse_bands_are_estimated_better_than_interpolated(infrared):
    """Seven bands of 50 nm; the reflectances that are estimated are left out of those that are learned from."""
    bands = Bands((*np.arange(400.0, 701.0, 50.0).tolist(), *infrared))
    (median, most), (of_lines, most_of_lines) = colour_errors(bands), interpolation_errors(bands)
    assert median < 0.5 * of_lines
    assert most < 0.7 * most_of_lines


def test_readings_become_spectra_with_a_note_and_others_stay(rng):
    wi, wo = from_spherical(np.full(4, 0.3), np.pi), from_spherical(np.linspace(0.0, 1.0, 4), 0.0)
    values = rng.random((4, 3))
    values[2, 1] = np.nan
    found = with_spectra(Readings("s", "camera", wi, wo, np.array(NARROW.wavelengths_nm), values))
    assert found.bands == SPECTRUM
    np.testing.assert_array_equal(found.measured.all(axis=1), [True, True, False, True])
    assert "465, 525, 630 nm" in found.notes[-1]
    assert "manifold calibrate" in found.notes[-1]
    assert "1 reading without all bands left out" in found.notes[-1]
    assert found.colour_error == colour_errors(NARROW)[0]
    assert with_spectra(found) is found


def test_bands_read_at_other_directions_each_are_no_colours():
    """The message was that no reading is above zero."""
    wi, wo = from_spherical(np.full(3, 0.3), np.pi), from_spherical(np.linspace(0.0, 1.0, 3), 0.0)
    values = np.where(np.eye(3) > 0.0, 0.1, np.nan)
    with pytest.raises(UsageError, match="no direction was measured in all of 3 bands"):
        with_spectra(Readings("s", "camera", wi, wo, np.array(NARROW.wavelengths_nm), values))
