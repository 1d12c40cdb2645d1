"""Every format of instruments, written and read back: formats are told apart, values and directions are the same."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.instrument_files import SUFFIXES, TITLES, smooth, write_every_format

from manifold.formats import registry


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return write_every_format(tmp_path_factory.mktemp("formats"))


@pytest.mark.parametrize("name", SUFFIXES)
def test_values_are_those_of_the_material_at_the_directions_read(files, name):
    found = registry.read_readings(files[name], limit=5000)
    expected = smooth(found.bands).eval(found.wi, found.wo)
    if name == "pab-opto":  # one band of the spectrophotometer's 31
        from manifold.analytic.virtual_instruments import MA_T12_BANDS

        expected = smooth(MA_T12_BANDS).eval(found.wi, found.wo)[:, [10]]
    assert len(found) >= 6
    # Half of these directions lie near the horizon, where angles of seven digits do what they can.
    steep = np.minimum(found.wi[:, 2], found.wo[:, 2]) < 0.02
    np.testing.assert_allclose(found.values[~steep], expected[~steep], rtol=1e-4)


@pytest.mark.parametrize("name", SUFFIXES)
def test_formats_are_told_apart_by_content_not_by_name(files, name, tmp_path):
    hidden = tmp_path / "file.dat"
    hidden.write_bytes(files[name].read_bytes())
    known = registry.identify(hidden)
    assert known is not None
    assert known.name == TITLES[name]


def test_rows_of_a_mini_diff_beyond_75_degrees_are_not_data(files):
    found = registry.read_readings(files["mini-diff"])
    assert len(found) == 4 * (1 + 36 * 75)
    assert found.wo[:, 2].min() == pytest.approx(np.cos(np.deg2rad(75.0)), abs=1e-6)
    assert any("padding" in note for note in found.notes)
    assert any("phi_s" in note for note in found.notes)
    assert set(found.weights[np.isclose(found.wi[:, 2], 0.5, atol=1e-5)]) == {0.5}


def test_bands_come_out_ascending(files):
    text = files["mini-diff"].read_text().replace("465nm,525nm,630nm", "630nm,465nm,525nm")
    turned = files["mini-diff"].with_name("turned.astm")
    turned.write_text(text)
    found, straight = registry.read_readings(turned), registry.read_readings(files["mini-diff"])
    assert found.bands.wavelengths_nm == (465.0, 525.0, 630.0)
    np.testing.assert_array_equal(found.values, straight.values[:, [1, 2, 0]])
