"""Encode-decode leave-one-out: nothing sees the material it predicts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import real_rgl_folder
from small_library import NAMES, measured

from manifold import heldout
from manifold.brdf import MeasuredBRDF
from manifold.gplvm import GPLVM
from manifold.io_rgl import read_bsdf
from manifold.metrics import RusinkiewiczGrid, relative_error
from manifold.monochrome import MonochromeGPLVM

GRID = RusinkiewiczGrid(14, 8, 6)
METHODS = {m.title: m for m in heldout.standard_methods()}
LINEAR = "best mix of any two (sees the answer)"


@pytest.fixture(scope="module")
def data():
    return heldout.Data.evaluate([MeasuredBRDF(measured(name)) for name in NAMES], GRID)


@pytest.mark.parametrize("title", [t for t in METHODS if "GPLVM" in t or "monochrome" in t])
def test_models_are_fitted_without_the_left_out_material(data, title, monkeypatch):
    seen = []

    def recording(original):
        def fit_gram(self, S, *arguments, **options):
            seen.append(S.copy())
            return original(self, S, *arguments, **options)

        return fit_gram

    for model in (GPLVM, MonochromeGPLVM):
        monkeypatch.setattr(model, "fit_gram", recording(model.fit_gram))
    other = data.f.copy()
    other[2] = 3.0 * data.f[4][::-1]
    for f in (data.f, other):
        METHODS[title].predict(heldout.Data(f, data.cosines), 2)
    np.testing.assert_array_equal(seen[0], seen[1])


@pytest.mark.parametrize("title", METHODS)
def test_predictions_are_finite(data, title):
    predicted = METHODS[title].predict(data, 0)
    assert predicted.shape == data.f.shape[1:]
    assert np.all(np.isfinite(predicted))


@pytest.mark.parametrize(
    "title", [t for t in METHODS if "GPLVM" in t or "monochrome" in t if "seed" not in t]
)
def test_models_of_this_package_predict_nothing_negative(data, title):
    assert METHODS[title].predict(data, 1).min() >= 0.0


def test_the_relative_error_is_that_of_the_metrics(data, rng):
    predicted = data.f[1] * rng.uniform(0.9, 1.1, data.f[1].shape)
    expected = relative_error(data.f[1], predicted, data.cosines)
    assert data.relative_error(1, predicted) == pytest.approx(expected, rel=1e-12)


def test_the_mix_of_two_is_the_best_of_all_mixes(data):
    best = data.relative_error(0, METHODS[LINEAR].predict(data, 0))
    for a in range(1, 6):
        for b in range(1, a):
            for t in np.linspace(0.0, 1.0, 11):
                assert best <= data.relative_error(0, t * data.f[a] + (1 - t) * data.f[b]) + 1e-12


def test_pca_with_all_components_projects_on_the_others(data):
    """An identity projection: the residual is orthogonal to what the others span."""
    predicted = heldout._pca("identity", 10)(data, 0)
    w2 = data.cosines[:, None]
    centred = data.f[1:] - data.f[1:].mean(axis=0)
    products = np.sum(w2 * (data.f[0] - predicted) * centred, axis=(1, 2))
    scale = np.sqrt(np.sum(w2 * data.f[0] ** 2) * np.sum(w2 * centred**2, axis=(1, 2)))
    np.testing.assert_allclose(products / scale, 0.0, atol=1e-8)


def test_many_bands_are_thinned_evenly():
    many = replace(
        measured("syn_satin_gold"),
        wavelengths_nm=np.linspace(400, 700, 60, dtype=np.float32),
        spectra=np.repeat(measured("syn_satin_gold").spectra[:, :, :1], 60, axis=2),
    )
    found = heldout.Data.evaluate([MeasuredBRDF(many)] * 2, GRID)
    assert found.f.shape[2] == heldout.MAX_BANDS


def test_held_out_errors_on_the_real_files():
    """The figures of docs/design/held-out.md; a few percent are left for other processors and libraries."""
    folder = real_rgl_folder()
    files = [] if folder is None else sorted(folder.glob("*_rgb.bsdf"))
    if len(files) != 20:
        pytest.skip("needs the 20 real RGB files: set MANIFOLD_RGL_DIR to a folder of exactly those")
    results = {r.title: r for r in heldout.compare([MeasuredBRDF(read_bsdf(path)) for path in files])}
    best = results["monochrome, 3 shared + 1 per band"]
    shared = results["monochrome, 2 shared + 1 per band"]
    whole = results["GPLVM, 2, cube root"]
    assert (best.numbers, shared.numbers) == (6, 5)
    assert best.median <= 0.13
    assert best.p90 <= 0.38
    assert shared.median <= 0.17
    assert shared.p90 <= 0.42
    assert whole.median <= 0.34
    assert whole.p90 <= 0.65
    assert best.median <= 0.25 * results["seed: GPLVM, 2, identity"].median
    assert best.median <= 0.4 * results["PCA, 6, identity"].median
    assert best.median <= 0.5 * results[LINEAR].median
    assert best.negative_share == 0.0
