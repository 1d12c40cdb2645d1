"""Fits of seen materials beside predictions: principled, and neural fits where the user has them."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.small_library import NAMES, measured, small_library
from typer.testing import CliRunner

from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured import fill_unmeasured
from manifold.cli.main import app
from manifold.errors import UsageError
from manifold.evaluate import anchors
from manifold.evaluate.cross_validation import encode_all
from manifold.evaluate.errors import BallErrors, MedianAndP90, measure_errors
from manifold.evaluate.tabulated import Data
from manifold.library.store import Library
from manifold.metrics import RusinkiewiczGrid


@pytest.fixture(scope="module")
def materials():
    return [MeasuredBRDF(measured(name)) for name in NAMES[:3]]


@pytest.fixture(scope="module")
def data(materials):
    return Data.evaluate(materials, RusinkiewiczGrid(12, 8, 6))


def test_principled_is_fitted_to_every_material(data):
    method = anchors.anchor("principled")
    assert (method.numbers(3), method.is_held_out) == (9, False)
    (errors,) = measure_errors([encode_all(data, method).combinations], data.bands, [data])
    assert errors.cube_root.max() < 0.3  # a seen material: felt and gloss are within principled's reach


def test_a_material_without_a_neural_fit_has_no_error(materials, data, monkeypatch):
    half = SimpleNamespace(eval=lambda wi, wo: 0.125 * materials[1].eval(wi, wo))
    monkeypatch.setattr(anchors, "read_neural_fits", lambda source, bands: {materials[1].name: half})
    found = encode_all(data, anchors.anchor("fits.zip")).combinations
    (errors,) = measure_errors([found], data.bands, [data])
    np.testing.assert_allclose(errors.cube_root, [np.nan, 0.5, np.nan], rtol=1e-12)  # 0.125^(1/3) is 0.5
    assert MedianAndP90.of(errors.linear).median == pytest.approx(0.875)
    assert [np.isnan(look.ball) for look in BallErrors(materials, data.bands).of(found)] == [
        True,
        False,
        True,
    ]


def test_a_prediction_that_is_a_brdf_meets_values_in_some_bands(materials, data):
    whole = anchors.FittedPrediction.of(materials[0], 3)
    np.testing.assert_array_equal(whole.evaluate(data), data.f[0])
    blue = whole.in_bands(np.array([2]))
    np.testing.assert_array_equal(blue.mapped(data), data.f[0][:, [2]])


def test_neural_fits_of_other_materials_are_refused(data, monkeypatch):
    monkeypatch.setattr(anchors, "read_neural_fits", lambda source, bands: {"granite": None})
    with pytest.raises(
        UsageError, match=r"fits.zip: no neural fit of any of syn_felt_green, .*found granite"
    ):
        anchors.anchor("fits.zip").fit(data, np.arange(3))


def test_a_chart_shows_neural_fits_without_a_time_to_fit_that_nobody_measured(tmp_path, monkeypatch):
    library = small_library(tmp_path)
    file = MeasuredBRDF(fill_unmeasured(Library.open(library).read(NAMES[1])))
    half = SimpleNamespace(eval=lambda wi, wo: 0.5 * file.eval(wi, wo))
    monkeypatch.setattr(anchors, "read_neural_fits", lambda source, bands: {NAMES[1]: half})
    command = ["chart", "-L", str(library), "--only", "nearest", "--only", "neural", "--anchor", "fits.zip"]
    picture, document = tmp_path / "chart.png", tmp_path / "chart.json"
    result = CliRunner().invoke(app, [*command, "-o", str(picture), "--json", str(document)])
    assert result.exit_code == 0, result.output
    nearest, neural = json.loads(document.read_text())["rows"]
    assert (neural["is_held_out"], neural["bytes"]) == (False, 675 * 8 * len(NAMES))
    assert neural["relative_error"] == pytest.approx(0.5, rel=1e-6)
    assert neural["fit"] is None
    assert nearest["fit"]["median"] > 0.0
    assert picture.stat().st_size > 0
