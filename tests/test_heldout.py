"""Leave-one-out: nothing sees the material it predicts, and all methods are weighted sums of measured values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import real_rgl_folder
from small_library import NAMES, measured

from manifold.brdf.measured import MeasuredBRDF
from manifold.errors import ShapeError
from manifold.experiments.evaluation import heldout, methods
from manifold.gplvm import GPLVM
from manifold.io_rgl import read_bsdf
from manifold.mapping import MAPPINGS, mapping_named
from manifold.metrics import RusinkiewiczGrid, cosine_weight, relative_error
from manifold.model.combination import Combination, Values, evaluate
from manifold.models.per_band import MonochromeGPLVM
from manifold.records import evenly_spaced

GRID = RusinkiewiczGrid(14, 8, 6)
METHODS = {m.key: m for m in heldout.standard_methods()}
MODELS = [key for key, method in METHODS.items() if method.fits_model]


@pytest.fixture(scope="module")
def data():
    return heldout.Data.evaluate([MeasuredBRDF(measured(name)) for name in NAMES], GRID)


@pytest.fixture(scope="module")
def many_bands():
    """The materials in 60 bands, between their red, green and blue."""
    x = np.linspace(0.0, 2.0, 60)
    materials = []
    for name in NAMES:
        file = measured(name)
        low = np.minimum(x.astype(int), 1)
        t = (x - low)[None, None, :, None, None]
        spectra = (1 - t) * file.spectra[:, :, low] + t * file.spectra[:, :, low + 1]
        nm = np.linspace(400, 700, 60, dtype=np.float32)
        materials.append(MeasuredBRDF(replace(file, wavelengths_nm=nm, spectra=spectra.astype(np.float32))))
    return materials


# -- combinations ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mapping", MAPPINGS)
def test_a_unit_vector_gives_the_measured_values_bit_for_bit(data, mapping):
    for n, weights in enumerate(np.eye(len(NAMES))):
        predicted = Combination(mapping_named(mapping), weights, is_clipped=False).evaluate(data)
        np.testing.assert_array_equal(predicted, data.f[n])


@pytest.mark.parametrize("mapping", MAPPINGS)
def test_a_combination_is_the_inverse_of_a_weighted_sum(data, mapping, rng):
    T = mapping_named(mapping)
    weights = rng.dirichlet(np.ones(len(NAMES)))
    expected = T.inverse(
        sum(w * T.forward(f, data.cosines) for w, f in zip(weights, data.f, strict=True)), data.cosines
    )
    found = Combination(T, weights, is_clipped=False).evaluate(data)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-15)


def test_monochrome_weights_that_pick_a_materials_own_bands_give_it_back(data):
    n = 3
    weights = np.zeros((3, 3 * len(NAMES)))
    weights[np.arange(3), 3 * n + np.arange(3)] = 1.0
    predicted = Combination(mapping_named("cube-root"), weights, np.arange(3)).evaluate(data)
    np.testing.assert_allclose(predicted, np.maximum(data.f[n], 0), rtol=1e-13)


def test_many_predictions_at_once_are_those_made_alone(data, rng):
    T, R = mapping_named("cube-root"), mapping_named("log-relative")
    combinations = [
        Combination(T, rng.normal(size=6)),
        Combination(R, rng.normal(size=6), is_clipped=False),
        Combination(T, rng.normal(size=(3, 18)), np.arange(3)),
        Combination(T, np.eye(6)[2]),
        Combination(T, rng.normal(size=6)),
    ]
    for alone, among in zip(combinations, evaluate(combinations, data), strict=True):
        np.testing.assert_allclose(among, alone.evaluate(data), rtol=1e-10, atol=1e-12)


def test_a_prediction_meets_values_in_some_bands_only(many_bands, rng):
    bands = np.array([3, 10, 40, 59])
    grid = RusinkiewiczGrid(6, 4, 3)
    every = heldout.Data.evaluate(many_bands, grid, np.arange(60))
    some = heldout.Data.evaluate(many_bands, grid, bands)
    whole = Combination(mapping_named("cube-root"), rng.normal(size=(60, 12)) / 6, np.array([10, 59]))
    found = whole.in_bands(bands).evaluate(some)
    np.testing.assert_allclose(found, whole.evaluate(every)[:, bands], rtol=1e-10, atol=1e-12)
    with pytest.raises(ShapeError, match="bands \\[59\\] are samples"):
        whole.in_bands(np.array([3, 10, 40]))


def test_negative_values_are_cut_where_a_method_says_so(data):
    weights = np.array([2.0, -1.0, 0, 0, 0, 0])
    T = mapping_named("identity")
    assert Combination(T, weights, is_clipped=False).evaluate(data).min() < 0.0
    assert Combination(T, weights).evaluate(data).min() == 0.0


# -- methods -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", MODELS)
def test_models_are_fitted_without_the_left_out_material(data, key, monkeypatch):
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
        METHODS[key].predict(heldout.Data(f, data.cosines), 2)
    np.testing.assert_allclose(seen[0], seen[1], rtol=1e-12)


@pytest.mark.parametrize("key", METHODS)
def test_no_method_gives_the_left_out_material_a_weight(data, key):
    combination = METHODS[key].leave_out(data, 2)
    weights = combination.weights.reshape(*combination.weights.shape[:-1], len(NAMES), -1)
    assert np.all(weights[..., 2, :] == 0.0)
    np.testing.assert_allclose(combination.weights.sum(axis=-1), 1.0, atol=1e-9)
    assert np.all(np.isfinite(combination.evaluate(data)))


@pytest.mark.parametrize("key", [key for key in MODELS if key != "published"])
def test_models_of_this_package_predict_nothing_negative(data, key):
    assert METHODS[key].predict(data, 1).min() >= 0.0


def test_more_knowledge_is_never_worse(data):
    """Nearest, the best point between the nearest two, the best between any two: each contains the one before."""
    for i in range(len(NAMES)):
        errors = [
            data.relative_error(i, METHODS[key].predict(data, i)) for key in ("nearest", "linear", "oracle")
        ]
        assert errors == sorted(errors, reverse=True)


def test_the_nearest_material_has_the_smallest_error(data):
    for i in range(len(NAMES)):
        found = data.relative_error(i, METHODS["nearest"].predict(data, i))
        assert found == pytest.approx(min(data.relative_error(i, f) for n, f in enumerate(data.f) if n != i))


def test_the_mix_of_two_is_the_best_of_all_mixes(data):
    best = data.relative_error(0, METHODS["oracle"].predict(data, 0))
    for a in range(1, 6):
        for b in range(1, a):
            for t in np.linspace(0.0, 1.0, 11):
                assert best <= data.relative_error(0, t * data.f[a] + (1 - t) * data.f[b]) + 1e-12


def test_pca_with_all_components_projects_on_the_others(data):
    """An identity projection: the residual is orthogonal to what the others span."""
    encode = methods.fit_pca("identity", 10)(data, np.arange(1, len(NAMES)))
    predicted = encode(0).evaluate(data)
    w = data.cosines[:, None]
    centred = data.f[1:] - data.f[1:].mean(axis=0)
    products = np.sum(w * (data.f[0] - predicted) * centred, axis=(1, 2))
    scale = np.sqrt(np.sum(w * data.f[0] ** 2) * np.sum(w * centred**2, axis=(1, 2)))
    np.testing.assert_allclose(products / scale, 0.0, atol=1e-8)


def test_pca_agrees_with_a_singular_value_decomposition(data):
    T = mapping_named("cube-root")
    rows = (T.forward(data.f) * np.sqrt(data.cosines)[:, None]).reshape(len(NAMES), -1)
    mean = rows[1:].mean(axis=0)
    axes = np.linalg.svd(rows[1:] - mean, full_matrices=False)[2][:2]
    expected = mean + axes.T @ (axes @ (rows[0] - mean))
    encode = methods.fit_pca("cube-root", 2)(data, np.arange(1, len(NAMES)))
    found = (encode(0).mapped(data) * np.sqrt(data.cosines)[:, None]).reshape(-1)
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def test_a_training_material_is_encoded_to_itself(data):
    everything = np.arange(len(NAMES))
    for fit in (methods.fit_gplvm(2, optimizer="l-bfgs"), methods.fit_monochrome(2, 1)):
        predicted = fit(data, everything)(2).evaluate(data)
        assert data.relative_error(2, predicted) < 0.02


def test_the_relative_error_is_that_of_the_metrics(data, rng):
    predicted = data.f[1] * rng.uniform(0.9, 1.1, data.f[1].shape)
    expected = relative_error(data.f[1], predicted, data.cosines)
    assert data.relative_error(1, predicted) == pytest.approx(expected, rel=1e-12)


def test_a_comparison_is_the_sum_of_what_methods_predict(data):
    materials = [MeasuredBRDF(measured(name)) for name in NAMES]
    chosen = [METHODS["linear"], METHODS["pca_6_cube_root"]]
    for method, result in zip(chosen, heldout.compare(materials, chosen, GRID), strict=True):
        expected = [data.relative_error(i, method.predict(data, i)) for i in range(len(NAMES))]
        np.testing.assert_allclose(result.relative_error, expected, rtol=1e-9)


def test_gram_matrices_are_sums_over_pairs(data):
    T = mapping_named("cube-root")
    root = np.sqrt(data.cosines)[:, None]
    flat = (T.forward(data.f) * root).reshape(len(NAMES), -1)
    np.testing.assert_allclose(data.gram(T), flat @ flat.T, rtol=1e-9)
    samples = np.concatenate([(T.forward(f) * root).T for f in data.f])
    np.testing.assert_allclose(data.sample_gram(T, np.arange(3)), samples @ samples.T, rtol=1e-9)


# -- many bands --------------------------------------------------------------------------------------------


def test_of_many_bands_some_are_selected_evenly(many_bands):
    found = heldout.Data.evaluate(many_bands[:2], GRID)
    assert found.f.shape[2] == 20
    assert (found.bands[0], found.bands[-1]) == (0, 59)
    assert set(np.diff(found.bands)) <= {3, 4}


@pytest.mark.parametrize("key", ["monochrome_2_1", "monochrome_0_2"])
def test_monochrome_methods_predict_every_band(many_bands, key):
    data = heldout.Data.evaluate(many_bands, GRID, evenly_spaced(60, 8))
    combination = METHODS[key].leave_out(data, 1)
    assert combination.weights.shape[0] == 60
    wi, wo, above = GRID.directions()
    values = Values(
        np.stack([m.eval(wi[above], wo[above]) for m in many_bands]), cosine_weight(wi, wo)[above]
    )
    predicted = combination.evaluate(values)
    assert predicted.shape == values.f.shape[1:]
    # Better than the nearest of the others, in all bands as in those learned from.
    nearest = METHODS["nearest"].leave_out(data, 1).evaluate(values)
    assert relative_error(values.f[1], predicted, values.cosines) < relative_error(
        values.f[1], nearest, values.cosines
    )


# -- calibration -------------------------------------------------------------------------------------------


def test_standardised_errors_are_errors_over_expected_deviations(data):
    T = mapping_named("cube-root")
    weights = np.array([0.0, 0.3, 0.7, 0, 0, 0])
    combination = Combination(T, weights, variance=0.04)
    wrong = 0.3 * T.forward(data.f[1]) + 0.7 * T.forward(data.f[2]) - T.forward(data.f[0])
    expected = np.sqrt(np.mean(data.cosines[:, None] * wrong**2) / 0.04)
    assert heldout.standardised_error(data, 0, combination) == pytest.approx(expected, rel=1e-9)


# -- real files --------------------------------------------------------------------------------------------


def test_held_out_errors_on_the_real_files():
    """The figures of docs/design/held-out.md; a few percent are left for other processors and libraries."""
    folder = real_rgl_folder()
    files = [] if folder is None else sorted(folder.glob("*_rgb.bsdf"))
    if len(files) != 20:
        pytest.skip("needs the 20 real RGB files: set MANIFOLD_RGL_DIR to a folder of exactly those")
    keys = ("monochrome_3_1", "monochrome_2_1", "gplvm_2", "published", "pca_6_identity", "oracle")
    materials = [MeasuredBRDF(read_bsdf(path)) for path in files]
    results = {r.key: r for r in heldout.compare(materials, [METHODS[key] for key in keys])}
    best, shared, whole = results["monochrome_3_1"], results["monochrome_2_1"], results["gplvm_2"]
    assert (best.numbers, shared.numbers) == (6, 5)
    assert best.median <= 0.13
    assert best.p90 <= 0.38
    assert shared.median <= 0.17
    assert shared.p90 <= 0.42
    assert whole.median <= 0.34
    assert whole.p90 <= 0.65
    assert best.median <= 0.25 * results["published"].median
    assert best.median <= 0.4 * results["pca_6_identity"].median
    assert best.median <= 0.5 * results["oracle"].median
    assert best.negative_share == 0.0
