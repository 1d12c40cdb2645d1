"""Leave-one-out: nothing sees the material it predicts, and all methods are weighted sums of measured values."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.real_materials import real_materials
from helpers.reference import left_out
from helpers.small_library import NAMES, measured, spectral_materials

from manifold.brdf.measured import MeasuredBRDF
from manifold.core.errors import ShapeError
from manifold.core.metrics import cube_root_error, relative_error, rmse
from manifold.core.pairs import RusinkiewiczGrid
from manifold.evaluate.baselines import fit_pca
from manifold.evaluate.cross_validation import cross_validate, encode_all, leave_out
from manifold.evaluate.errors import measure_errors, standardised_error
from manifold.evaluate.latent_models import fit_settings
from manifold.evaluate.method_data import Data
from manifold.evaluate.methods import STANDARD, standard_methods
from manifold.gplvm import GPLVM
from manifold.model.combination import Combination, Values, evaluate
from manifold.registries import MAPPINGS

GRID = RusinkiewiczGrid(14, 8, 6)
METHODS = {m.key: m for m in standard_methods()}
MODELS = [key for key, method in METHODS.items() if method.fits_model]
PROCESSES = [key for key in MODELS if key.startswith(("published", "gplvm"))]
SUMS_TO_1 = [key for key in METHODS if key in PROCESSES or key not in MODELS]


@pytest.fixture(scope="module")
def data():
    return Data.evaluate([MeasuredBRDF(measured(name)) for name in NAMES], GRID)


@pytest.fixture(scope="module")
def many_bands():
    return spectral_materials()


# -- combinations ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mapping", MAPPINGS)
def test_a_unit_vector_gives_the_measured_values_bit_for_bit(data, mapping):
    for n, weights in enumerate(np.eye(len(NAMES))):
        predicted = Combination(MAPPINGS[mapping], weights, is_clipped=False).evaluate(data)
        np.testing.assert_array_equal(predicted, data.f[n])


@pytest.mark.parametrize("mapping", MAPPINGS)
def test_a_combination_is_the_inverse_of_a_weighted_sum(data, mapping, rng):
    T = MAPPINGS[mapping]
    weights = rng.dirichlet(np.ones(len(NAMES)))
    cosines = data.cosines[:, None]
    expected = T.inverse(
        sum(w * T.forward(f, cosines) for w, f in zip(weights, data.f, strict=True)), cosines
    )
    found = Combination(T, weights, is_clipped=False).evaluate(data)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-15)


def test_many_predictions_at_once_are_those_made_alone(data, rng):
    T, R = MAPPINGS["cube-root"], MAPPINGS["log-relative"]
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
    every = Data.evaluate(many_bands, grid, np.arange(60))
    some = Data.evaluate(many_bands, grid, bands)
    whole = Combination(MAPPINGS["cube-root"], rng.normal(size=(60, 12)) / 6, np.array([10, 59]))
    found = whole.in_bands(bands).evaluate(some)
    np.testing.assert_allclose(found, whole.evaluate(every)[:, bands], rtol=1e-10, atol=1e-12)
    with pytest.raises(ShapeError, match="bands \\[59\\] are needed"):
        whole.in_bands(np.array([3, 10, 40]))


def test_negative_values_are_cut_where_a_method_says_so(data):
    weights = np.array([2.0, -1.0, 0, 0, 0, 0])
    T = MAPPINGS["identity"]
    assert Combination(T, weights, is_clipped=False).evaluate(data).min() < 0.0
    assert Combination(T, weights).evaluate(data).min() == 0.0


# -- methods -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", PROCESSES)
def test_models_are_fitted_without_the_left_out_material(data, key, monkeypatch):
    seen = []

    def recording(original):
        def fit_gram(self, S, *arguments, **options):
            seen.append(S.copy())
            return original(self, S, *arguments, **options)

        return fit_gram

    monkeypatch.setattr(GPLVM, "fit_gram", recording(GPLVM.fit_gram))
    other = data.f.copy()
    other[2] = 3.0 * data.f[4][::-1]
    for f in (data.f, other):
        left_out(METHODS[key], Data(f, data.wi, data.wo), 2)
    np.testing.assert_allclose(seen[0], seen[1], rtol=1e-12)


@pytest.mark.parametrize("key", SUMS_TO_1)
def test_no_method_gives_the_left_out_material_a_weight(data, key):
    combination = left_out(METHODS[key], data, 2)
    weights = combination.weights.reshape(*combination.weights.shape[:-1], len(NAMES), -1)
    assert np.all(weights[..., 2, :] == 0.0)
    np.testing.assert_allclose(combination.weights.sum(axis=-1), 1.0, atol=1e-9)
    assert np.all(np.isfinite(combination.evaluate(data)))


def predicted(method, data, i):
    """The values of material i as the method predicts them from the others, at the data's pairs and bands."""
    return left_out(method, data, i).in_bands(data.bands).evaluate(data)


@pytest.mark.parametrize("key", [key for key in MODELS if key != "published"])
def test_models_of_this_package_predict_nothing_negative(data, key):
    assert predicted(METHODS[key], data, 1).min() >= 0.0


def test_more_knowledge_is_never_worse(data):
    """Nearest, the best point between the nearest two, the best between any two: each contains the one before."""
    for i in range(len(NAMES)):
        errors = [
            data.relative_error(i, predicted(METHODS[key], data, i))
            for key in ("nearest", "linear", "oracle")
        ]
        assert errors == sorted(errors, reverse=True)


def test_the_nearest_material_has_the_smallest_error(data):
    for i in range(len(NAMES)):
        found = data.relative_error(i, predicted(METHODS["nearest"], data, i))
        assert found == pytest.approx(min(data.relative_error(i, f) for n, f in enumerate(data.f) if n != i))


def test_the_mix_of_two_is_the_best_of_all_mixes(data):
    best = data.relative_error(0, predicted(METHODS["oracle"], data, 0))
    for a in range(1, 6):
        for b in range(1, a):
            for t in np.linspace(0.0, 1.0, 11):
                assert best <= data.relative_error(0, t * data.f[a] + (1 - t) * data.f[b]) + 1e-12


def test_pca_with_all_components_projects_on_the_others(data):
    """An identity projection: the residual is orthogonal to what the others span."""
    encode = fit_pca("identity", 10)(data, np.arange(1, len(NAMES)))
    predicted = encode(0).evaluate(data)
    w = data.cosines[:, None]
    centred = data.f[1:] - data.f[1:].mean(axis=0)
    products = np.sum(w * (data.f[0] - predicted) * centred, axis=(1, 2))
    scale = np.sqrt(np.sum(w * data.f[0] ** 2) * np.sum(w * centred**2, axis=(1, 2)))
    np.testing.assert_allclose(products / scale, 0.0, atol=1e-8)


def test_pca_agrees_with_a_singular_value_decomposition(data):
    T = MAPPINGS["cube-root"]
    rows = (T.forward(data.f) * np.sqrt(data.cosines)[:, None]).reshape(len(NAMES), -1)
    mean = rows[1:].mean(axis=0)
    axes = np.linalg.svd(rows[1:] - mean, full_matrices=False)[2][:2]
    expected = mean + axes.T @ (axes @ (rows[0] - mean))
    encode = fit_pca("cube-root", 2)(data, np.arange(1, len(NAMES)))
    found = (encode(0).mapped(data) * np.sqrt(data.cosines)[:, None]).reshape(-1)
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def test_a_training_material_is_encoded_to_itself(data):
    everything = np.arange(len(NAMES))
    predicted = fit_settings(STANDARD["gplvm_2"])(data, everything)(2).evaluate(data)
    assert data.relative_error(2, predicted) < 0.02


def test_a_comparison_is_the_sum_of_what_methods_predict(data):
    chosen = [METHODS["linear"], METHODS["pca_6_cube_root"]]
    errors = measure_errors([encode_all(data, m).combinations for m in chosen], data.bands, _blocks(data, 3))
    for method, found in zip(chosen, errors, strict=True):
        values = [predicted(method, data, i) for i in range(len(NAMES))]
        n_pairs = len(data.cosines) + 10
        errors = found.of_values(n_pairs)
        for i, f in enumerate(values):
            assert errors.linear[i] == pytest.approx(relative_error(data.f[i], f, data.cosines), rel=1e-9)
            assert errors.cube_root[i] == pytest.approx(cube_root_error(data.f[i], f, data.cosines), rel=1e-9)
            assert errors.rmse[i] == pytest.approx(rmse(data.f[i], f, n_pairs=n_pairs), rel=1e-9)
        assert found.negative_share == np.mean(np.array(values) < 0)


def _blocks(data, count):
    pairs = np.array_split(np.arange(len(data.cosines)), count)
    return [Values(data.f[:, rows], data.wi[rows], data.wo[rows]) for rows in pairs]


def test_every_material_is_left_out_once(data):
    for count in (None, 4):
        splits = leave_out(len(NAMES), count)
        assert len(splits) == (len(NAMES) if count is None else count)
        assert sorted(i for _, out in splits for i in out) == list(range(len(NAMES)))
        for training, out in splits:
            assert sorted([*training, *out]) == list(range(len(NAMES)))


def test_folds_predict_as_their_own_fits_do(data):
    """Times are those that the lap says, and only the first fits map the values anew."""
    tables = []

    def fit(here, training):
        tables.append(here)
        return METHODS["pca_6_cube_root"].fit(here, training)

    splits = leave_out(len(NAMES), 3)
    encoded = cross_validate(data, fit, splits, lap=lambda work: (work(), 7.0), own_tables=2)
    assert encoded.fit_times == (7.0, 7.0, 7.0)
    assert tables[0] is not tables[1] is tables[2] is not data
    for training, out in splits:
        for i in out:
            expected = METHODS["pca_6_cube_root"].fit(data, training)(i).weights
            np.testing.assert_allclose(encoded.combinations[i].weights, expected, atol=1e-12)


def test_the_error_of_a_fit_says_what_it_learned_from(data):
    alike = Data(np.concatenate([data.f[:1], np.repeat(data.f[1:2], 5, axis=0)]), data.wi, data.wo)
    with pytest.raises(ShapeError, match=r"learning from 5 of 6 materials: .*; import more that differ"):
        cross_validate(alike, fit_settings(STANDARD["gplvm_2"]), leave_out(6))


def test_gram_matrices_are_sums_over_pairs(data):
    T = MAPPINGS["cube-root"]
    root = np.sqrt(data.cosines)[:, None]
    flat = (T.forward(data.f) * root).reshape(len(NAMES), -1)
    np.testing.assert_allclose(data.gram(T), flat @ flat.T, rtol=1e-9)
    samples = np.concatenate([(T.forward(f) * root).T for f in data.f])
    np.testing.assert_allclose(data.gram(T, np.arange(3)), samples @ samples.T, rtol=1e-9)


# -- many bands --------------------------------------------------------------------------------------------


def test_of_many_bands_some_are_selected_evenly(many_bands):
    found = Data.evaluate(many_bands[:2], GRID)
    assert found.f.shape[2] == 20
    assert (found.bands[0], found.bands[-1]) == (0, 59)
    assert set(np.diff(found.bands)) <= {3, 4}


# -- calibration -------------------------------------------------------------------------------------------


def test_standardised_errors_are_errors_over_expected_deviations(data):
    T = MAPPINGS["cube-root"]
    weights = np.array([0.0, 0.3, 0.7, 0, 0, 0])
    combination = Combination(T, weights, variance=0.04)
    wrong = 0.3 * T.forward(data.f[1]) + 0.7 * T.forward(data.f[2]) - T.forward(data.f[0])
    expected = np.sqrt(np.mean(data.cosines[:, None] * wrong**2) / 0.04)
    assert standardised_error(data, 0, combination) == pytest.approx(expected, rel=1e-9)


# -- real materials --------------------------------------------------------------------------------------------


def errors_on_real_materials(keys):
    """Median and 90th percentile by method, as in docs/explanation/accuracy.md."""
    materials = [MeasuredBRDF(file) for file in real_materials()]
    data = Data.evaluate(materials, RusinkiewiczGrid.named("default"))
    errors = measure_errors([encode_all(data, METHODS[key]).combinations for key in keys], data.bands, [data])
    linear = {key: e.of_values().linear for key, e in zip(keys, errors, strict=True)}
    median, p90 = ({key: np.quantile(e, q) for key, e in linear.items()} for q in (0.5, 0.9))
    return median, p90


# A few percent are left for other processors and libraries, whose rounding leads to other latents. The median of
# gplvm_6 is below 0.210 with the BLAS kernels of Zen, and 0.213 with those of Prescott.


def test_held_out_errors_on_real_materials():
    median, p90 = errors_on_real_materials(("gplvm_6", "published", "pca_6_identity", "oracle"))
    assert median["gplvm_6"] <= 0.22
    assert p90["gplvm_6"] <= 0.52
    # Measured, where both are found by cube roots: 0.31, and 0.28 on the files themselves.
    assert median["gplvm_6"] <= 0.33 * median["published"]
    assert median["gplvm_6"] <= median["pca_6_identity"]
