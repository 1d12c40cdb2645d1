"""Fits of seen materials beside predictions."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.small_library import NAMES, measured

from manifold.brdf.measured import MeasuredBRDF
from manifold.core.pairs import RusinkiewiczGrid
from manifold.evaluate import seen_fits
from manifold.evaluate.cross_validation import encode_all
from manifold.evaluate.errors import measure_errors
from manifold.evaluate.method_data import Data


@pytest.fixture(scope="module")
def materials():
    return [MeasuredBRDF(measured(name)) for name in NAMES[:3]]


@pytest.fixture(scope="module")
def data(materials):
    return Data.evaluate(materials, RusinkiewiczGrid(12, 8, 6))


def test_principled_is_fitted_to_every_material(data):
    method = seen_fits.seen_principled()
    assert (method.numbers(3), method.is_held_out) == (9, False)
    (errors,) = measure_errors([encode_all(data, method).combinations], data.bands, [data])
    assert (
        errors.of_values().cube_root.max() < 0.3
    )  # a seen material: felt and gloss are within principled's reach


def test_a_prediction_that_is_a_brdf_meets_values_in_some_bands(materials, data):
    whole = seen_fits.FittedPrediction.of(materials[0], 3)
    np.testing.assert_array_equal(whole.evaluate(data), data.f[0])
    blue = whole.in_bands(np.array([2]))
    np.testing.assert_array_equal(blue.mapped(data), data.f[0][:, [2]])
