"""The records of readings and of dense tables."""

from __future__ import annotations

import numpy as np
import pytest

from manifold.core.errors import ShapeError
from manifold.formats import Readings, geometry_ma_t12
from manifold.formats.dense import DenseTable
from manifold.formats.readings import aspecular_pair

# Of MA-T12 sheets: the other leg's signed angle from the normal, positive on the mirror side.
OTHER_LEG_DEG = (60, 30, 20, 0, -30, -65, 60, 45, 30, 0, -30, -65)


def readings(**changes):
    wi, wo = geometry_ma_t12()
    given = {"name": "s", "instrument": "i", "wi": wi, "wo": wo, "wavelengths_nm": np.array([400.0, 500.0])}
    return Readings(**(given | {"values": np.arange(24.0).reshape(12, 2)} | changes))


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ([[0.1], [0.1, 0.2]], "sample: values: rows of different"),
        ([[0.1j], [0.2]], "values of type complex128"),
    ],
)
def test_values_that_are_no_array_of_real_numbers_are_refused(values, words):
    w = np.tile([0.0, 0.0, 1.0], (2, 1))
    with pytest.raises(ShapeError, match=words):
        Readings("sample", "by hand", w, w, np.array([550.0]), values)


def test_ma_t12_directions_are_those_of_its_sheets():
    wi, wo = geometry_ma_t12()
    np.testing.assert_allclose(np.rad2deg(np.arctan2(wo[:, 0], wo[:, 2])), OTHER_LEG_DEG, atol=1e-9)
    np.testing.assert_allclose(np.rad2deg(np.arccos(wi[:, 2])), [45] * 6 + [15] * 6, atol=1e-9)
    assert np.all(wi[:, 0] < 0)


def test_an_azimuth_turns_the_aspecular_angle_about_the_mirror_direction():
    wi, wo = aspecular_pair(45.0, 25.0, 90.0)
    mirror = wi * [-1, -1, 1]
    np.testing.assert_allclose(wo @ mirror, np.cos(np.deg2rad(25.0)), atol=1e-12)
    assert abs(wo[1]) == pytest.approx(np.sin(np.deg2rad(25.0)))


def test_detectors_across_the_plane_are_the_same_for_both_lamps_of_an_ma98():
    """Its azimuths are 180 degrees minus those counted from the normal: only so do two lamps share four detectors."""
    seen = [aspecular_pair(*angles)[1] for angles in ((45.0, 60.0, 125.3), (15.0, 46.9, 104.5))]
    np.testing.assert_allclose(
        seen, [[0.0, np.sqrt(0.5), np.sqrt(0.5)]] * 2, atol=2e-3
    )  # angles of one decimal
    seen = [aspecular_pair(*angles)[1] for angles in ((45.0, 25.0, -90.0), (15.0, 38.3, -43.0))]
    np.testing.assert_allclose(seen[0], seen[1], atol=2e-3)
    in_plane = [aspecular_pair(45.0, 25.0, azimuth)[1] for azimuth in (0.0, 180.0)]
    np.testing.assert_allclose(in_plane[0], in_plane[1])


def test_subsets_keep_values_beside_their_directions():
    part = readings().select_pairs(np.array([3, 1])).select_bands([1])
    np.testing.assert_array_equal(part.values, [[7.0], [3.0]])
    np.testing.assert_array_equal(part.wo, geometry_ma_t12()[1][[3, 1]])
    assert part.bands.wavelengths_nm == (500.0,)
    assert len(part) == 2


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"values": np.zeros((12, 3))}, "values have shape"),
        ({"values": np.full((12, 2), np.inf)}, "infinite"),
        ({"wi": np.tile([0.0, 0.0, -1.0], (12, 1))}, "below the horizon"),
        ({"wavelengths_nm": np.array([500.0, 400.0])}, "increasing"),
        ({"weights": -np.ones(12)}, "weights"),
    ],
)
def test_records_that_cannot_be_are_refused(changes, words):
    with pytest.raises(ShapeError, match=words):
        readings(**changes)


def test_a_dense_table_lists_its_measured_nodes_above_the_horizon():
    axes = tuple(np.deg2rad(a) for a in ([0.0, 80.0], [0.0, 40.0], [0.0, 90.0]))
    values = np.arange(24.0).reshape(2, 2, 2, 3)
    values[0, 0, 1] = np.nan
    table = DenseTable("m", "MERL", "half-difference", axes, None, values)
    found = table.readings()
    wi, wo = table.directions()
    kept = table.measured.reshape(-1) & (wi[:, 2] > 0) & (wo[:, 2] > 0)
    assert 0 < kept.sum() < 7  # one not measured, some below the horizon
    np.testing.assert_array_equal(found.values, values.reshape(-1, 3)[kept])
