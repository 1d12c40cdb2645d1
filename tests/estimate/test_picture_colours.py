"""Colours of an instrument's pictures in place of spectra that are missing."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from manifold.colour.conversion import to_srgb
from manifold.colour.difference import delta_e_2000_lab, lab_values
from manifold.estimate.picture_colours import with_picture_colours
from manifold.formats.readings import MA_T12_NAMES, Readings, geometry_ma_t12

MISSING = [6, 11]  # 15as-45 and 15as80
FACTOR = np.array([1.1, 1.0, 1.05])  # of pictures


def _png(colour):
    content = io.BytesIO()
    Image.fromarray(np.full((32, 32, 3), np.round(255.0 * colour), np.uint8)).save(content, "PNG")
    return content.getvalue()


@pytest.fixture
def whole():
    """Twelve readings of a blue paint with a white lobe, and the six pictures of it."""
    wi, wo = geometry_ma_t12()
    nm = np.arange(400.0, 701.0, 10.0)
    blue = 0.1 + 0.3 * np.exp(-(((nm - 470.0) / 60.0) ** 2))
    lobe = 0.15 * np.exp(-((np.arange(12) % 6) / 2.0))
    values = (blue + lobe[:, None]) / np.pi
    readings = Readings("blue", "MA-T12", wi, wo, nm, values)
    colours = FACTOR * np.pi * to_srgb(values, readings.bands)
    images = {MA_T12_NAMES[k]: _png(colours[k]) for k in range(6, 12)} | {"15d": _png(colours[7])}
    return replace(readings, texture={"images": images})


def _without(readings, pairs, *, rows):
    if rows == "empty":
        values = readings.values.copy()
        values[pairs] = np.nan
        return replace(readings, values=values)
    return readings.select_pairs(np.setdiff1d(np.arange(len(readings)), pairs))


@pytest.mark.parametrize("rows", ["empty", "absent"])
def test_missing_spectra_have_the_colours_of_the_pictures_there(whole, rows):
    found = with_picture_colours(_without(whole, MISSING, rows=rows))
    assert len(found) == 12
    assert "15as-45, 15as80" in found.notes[-1]
    np.testing.assert_allclose(found.wo[-2:], whole.wo[MISSING])
    seen, true = (lab_values(f, whole.bands) for f in (found.values[-2:], whole.values[MISSING]))
    assert delta_e_2000_lab(seen, true).max() < 0.5  # 8 bits
    np.testing.assert_array_equal(found.scatter > 0.0, np.arange(12) >= 10)  # less certain than spectra


def test_readings_without_a_missing_spectrum_or_without_a_calibrating_picture_are_unchanged(whole):
    assert with_picture_colours(whole) is whole
    no_factor = _without(whole, range(6, 12), rows="absent")
    assert with_picture_colours(no_factor) is no_factor


def test_pictures_of_another_sample_are_not_taken(whole):
    red = {caption: _png(np.array([0.6, 0.1, 0.1])) for caption in whole.texture["images"]}
    found = with_picture_colours(_without(replace(whole, texture={"images": red}), MISSING, rows="absent"))
    assert len(found) == 10
    assert "a different sample?" in found.notes[-1]


def test_a_picture_that_cannot_be_decoded_is_said(whole):
    images = whole.texture["images"] | {"15as80": b"no picture"}
    found = with_picture_colours(_without(replace(whole, texture={"images": images}), MISSING, rows="absent"))
    assert len(found) == 10
    assert found.notes[-1].startswith("a picture is no known picture, expected PNG or JPEG")
