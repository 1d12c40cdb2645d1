"""OpenPBR in NumPy as Adobe's openpbr-bsdf evaluates it, against values of that code."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from manifold.analytic.fresnel import fresnel_thin_film
from manifold.fit.exports import openpbr, openpbr_adobe
from manifold.fit.exports.lobes import ShadingPairs
from manifold.fit.exports.thin_film import film_at_wavelengths

REFERENCE = json.loads((Path(__file__).parents[1] / "data" / "openpbr_bsdf.json").read_text())["materials"]
TOLERANCE, OF_FUZZ = 0.01, 0.05
"""Largest relative deviation: Adobe's albedos of smooth metals are off by a permille, which is more of what facets
scatter to each other; its fuzz is a table, ours MaterialX's rational fit of it. Medians are a tenth of that.
"""


@pytest.mark.parametrize("material", REFERENCE, ids=lambda material: material["name"])
def test_values_are_those_of_adobe_s_code(material):
    expected = np.array(material["f"])
    pairs = ShadingPairs.of(np.array(material["wi"]), np.array(material["wo"]))
    found = openpbr_adobe.brdf(material["values"], pairs)
    tolerance = OF_FUZZ if material["values"]["fuzz_weight"] else TOLERANCE
    np.testing.assert_allclose(found, expected, rtol=tolerance)
    assert np.median(np.abs(found / expected - 1.0)) < 0.1 * tolerance


def test_the_reference_has_every_parameter_that_exports_set_away_from_its_default():
    for name, default in openpbr.DEFAULTS.items():
        assert name == "base_weight" or any(m["values"][name] != default for m in REFERENCE), name


@pytest.mark.parametrize("outside", [1.0, 1.3])
def test_a_film_reflects_what_airy_s_formula_gives_at_each_wavelength(outside):
    wavelengths, n, k = np.array([620.0, 540.0, 450.0]), np.array([0.2, 0.9, 1.3]), np.array([3.9, 2.5, 1.9])
    cosines = np.linspace(0.05, 1.0, 20)
    found = film_at_wavelengths(tuple(wavelengths), outside, 1.8, 380.0, n, k, cosines)
    relative = (
        np.array([1.8 / outside]),
        outside * 380.0,
        n / outside,
        k / outside,
    )  # the film's index times its path
    expected = fresnel_thin_film(cosines, wavelengths, *relative)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_light_beyond_the_critical_angle_to_the_film_is_all_reflected():
    film = film_at_wavelengths((550.0,), 1.6, 1.2, 300.0, np.array([1.5]), np.zeros(1), np.array([0.3, 0.9]))
    assert film[0, 0] == 1.0
    assert film[1, 0] < 0.2
