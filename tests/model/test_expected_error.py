"""What error to expect of a prediction, by materials that were left out."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from helpers import reference
from helpers.small_library import small_library
from scipy.stats import spearmanr

from manifold.colour import panel
from manifold.colour.colour_science import colour_science
from manifold.core.judged_lights import JUDGED
from manifold.core.metrics import Errors
from manifold.gp.encoding import encoding_pairs
from manifold.library.store import Library
from manifold.model.colours import ColourChoice
from manifold.model.diagnostics import in_words, predict_and_diagnose
from manifold.model.expected_error import LEVEL, ExpectedError, LeftOut
from manifold.model.manifold import Manifold
from manifold.model.settings import KINDS


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return Library.open(small_library(tmp_path_factory.mktemp("expected")))


@pytest.fixture(scope="module")
def model(library):
    return Manifold.fit(library)


@pytest.fixture
def scattered(rng):
    """Sixty places whose errors grow along the first axis, with scatter."""
    X = rng.uniform(-4.0, 4.0, (60, 2))
    errors = np.exp(0.6 * X[:, 0] + rng.normal(scale=0.4, size=60))
    return X, errors


def test_nine_in_ten_left_out_materials_err_by_less_than_twice_the_expected(scattered):
    X, errors = scattered
    expected = []
    for i in range(len(X)):
        others = np.delete(np.arange(len(X)), i)
        fitted = ExpectedError.calibrate(X[others], X[others], errors[others], 1.0, 1e-3)
        expected.append(fitted.at(X[i : i + 1])[0])
    share = np.mean(errors < 2.0 * np.array(expected))
    assert 0.8 < share < 1.0  # 0.9, with 60 of them
    assert spearmanr(expected, errors)[0] > 0.6


def test_the_expected_error_grows_with_the_errors_around_and_with_the_distance(scattered):
    X, errors = scattered
    fitted = ExpectedError.calibrate(X, X, errors, 1.0, 1e-3)
    worse = ExpectedError.calibrate(X, X, 3.0 * errors, 1.0, 1e-3)
    x = np.array([[0.3, 0.2]])
    np.testing.assert_allclose(worse.at(x), 3.0 * fitted.at(x), rtol=1e-9)
    away = fitted.at(np.array([[10.0, 0.0], [20.0, 0.0], [40.0, 0.0]]))
    assert np.all(np.diff(away) > 0.0)


def test_the_expected_error_is_continuous(scattered, rng):
    X, errors = scattered
    fitted = ExpectedError.calibrate(X, X, errors, 1.0, 1e-3)
    x = rng.uniform(-4.0, 4.0, (200, 2))
    step = fitted.at(x + 1e-4) / fitted.at(x)
    assert np.abs(np.log(step)).max() < 1e-2  # weights turn over within a few tenths at most


def test_a_residual_tells_more_than_the_place(scattered, rng):
    X, errors = scattered
    residuals = 0.1 * errors * np.exp(rng.normal(scale=0.2, size=60))
    places = ExpectedError.calibrate(X, X, errors, 1.0, 1e-3)
    located = ExpectedError.calibrate(X, X, errors, 1.0, 1e-3, residuals)
    x = rng.uniform(-4.0, 4.0, (200, 2))
    true = np.exp(rng.normal(scale=1.0, size=200))  # whatever the place
    of_residual = np.array([located.at(x[[m]], 0.1 * true[m])[0] for m in range(200)])
    assert spearmanr(of_residual, true)[0] > 0.8 > 0.2 > abs(spearmanr(places.at(x), true)[0])


def test_a_recoloured_material_at_the_point_of_an_exact_copy_has_an_expected_error(library):
    """Copies are found where the other is, without error; what has other colours is not."""
    model = Manifold.fit(library)
    k, left_out = 2, model.left_out.errors
    errors = LeftOut(
        model.space, model.left_out.places,
        Errors(np.where(np.arange(len(model.names)) == k, 1e-6, left_out.ball), left_out.cube_root),
        None, model.left_out.residual, model.left_out.materials,
    )  # fmt: skip
    place = errors.expected(model.X[k])
    exact, other = (errors.expected(model.X[k], residual) for residual in (1e-9, 0.1))
    assert exact.ball < other.ball
    assert other.ball > 2.0 * place.ball


@pytest.mark.parametrize("kind", ["blend", "gplvm"])
def test_every_kind_is_calibrated_and_a_model_file_remembers(library, tmp_path, kind):
    fitted = Manifold.fit(library, KINDS[kind]())
    assert np.all(fitted.left_out.errors.ball > 0.0)
    assert np.all(np.isfinite(fitted.left_out.places))
    fitted.save(tmp_path / "model.h5")
    loaded = Manifold.load(tmp_path / "model.h5", library)
    x = fitted.X.mean(axis=0) + 0.1
    assert float(loaded.expected_error(x).ball) == float(fitted.expected_error(x).ball)


def test_without_calibration_nothing_is_expected_and_the_remedy_is_named(library):
    fitted = Manifold.fit(library, calibrate=False)
    assert fitted.expected_error(fitted.X.mean(axis=0)) is None
    made = predict_and_diagnose(fitted, fitted.X.mean(axis=0))
    assert made.expected is None
    assert "unknown: the model has no expected errors" in in_words(made.expected, made.materials)[0]


def test_a_left_out_material_is_predicted_by_the_others_alone(model):
    """Its error is that of an encode-decode without it: never 0, though the material itself is in the model."""
    assert model.left_out.errors.ball.min() > 0.05
    assert np.all(np.any(model.left_out.places != model.X, axis=1))


def test_a_material_s_own_place_has_no_error_and_its_neighbourhood_has(model):
    own = model.expected_error(model.X[0])
    assert (float(own.ball), float(own.cube_root)) == (0.0, 0.0)
    assert float(model.expected_error(model.X[0] + 1e-3).ball) > 0.1


def test_far_from_all_materials_the_data_support_nothing(model):
    assert model.is_extrapolation(model.X + 50.0).all()
    assert not model.is_extrapolation(model.X[1])


def test_far_from_small_errors_large_ones_are_expected(scattered):
    """The errors at the left are the smallest: beyond them nothing is known, and little would be expected."""
    X, errors = scattered
    fitted = ExpectedError.calibrate(X, X, errors, 1.0, 1e-3)
    left = X[X[:, 0].argmin()]
    away = fitted.at(left - np.array([[d, 0.0] for d in (0.2, 2.0, 4.0, 8.0, 30.0)]))
    assert away[0] < np.median(errors) < away[2]
    assert np.all(np.diff(away) >= 0.0)
    assert away[-1] == pytest.approx(errors.max())


def test_a_place_that_is_not_supported_has_no_expected_error_in_words(model):
    made = predict_and_diagnose(model, model.X[0] + 50.0)
    assert made.rows["expected error"] == ("unknown: not supported by the data, see note",)
    assert "unknown material" not in made.rows
    reason = made.diagnostics[0]
    assert "length scales away; choose a latent nearer" in reason
    assert "error" not in reason  # one answer
    document = made.to_json()
    assert (document["expected"], document["expected_in_chosen_colour"]) == (None, None)
    assert [of(document) for title, of in made.columns().items() if "expected" in title] == [None]


def test_the_bound_needs_enough_materials(model):
    found = model.left_out.reliability()["ball"]
    n = len(model.left_out.errors.ball)
    assert found.most_level == n / (n + 1)
    assert found.bound is None or found.bound > 0.0
    assert (found.bound is None) == (np.ceil(0.9 * (n + 1)) > n)


def test_nine_in_ten_new_materials_err_by_less_than_the_bound(rng):
    """Of materials exchangeable with those left out: errors that vary over the map, with light and with heavy tails."""
    below = []
    for _ in range(12):
        X = rng.normal(scale=2.0, size=(70, 2))
        light, heavy = np.exp(0.3 * X[:, 0] + rng.normal(size=70)), np.exp(rng.standard_t(2.0, size=70))
        known = slice(None, 30)
        space = SimpleNamespace(X=X[known], kernel=SimpleNamespace(length_scale=1.0))
        errors = LeftOut(
            space, X[known], Errors(light[known], 0.1 * heavy[known]), None, np.ones(30), np.arange(30)
        )
        bounds, expected = errors.reliability(), errors.expected(X[30:])
        below.append(light[30:] < bounds["ball"].bound * expected.ball)
        below.append(0.1 * heavy[30:] < bounds["cube_root"].bound * expected.cube_root)
    shares = np.mean(np.reshape(below, (12, 2, 40)), axis=(0, 2))
    np.testing.assert_allclose(shares, LEVEL, atol=0.06)  # 480 of each


def test_errors_that_do_not_fit_the_materials_are_refused(model):
    arrays = model.left_out.arrays
    arrays["left_out_in_lights_ball"] = arrays["left_out_in_lights_ball"][:-1]
    with pytest.raises(ValueError, match="'left_out_in_lights_ball' has shape"):
        LeftOut.from_arrays(arrays, model.space)


def test_errors_in_blended_colours_are_those_of_the_blend_of_the_others(model):
    """By formulas: shares at the place where it was found, cube roots added, balls compared in five lights."""
    lights, pairs = panel.judged(), encoding_pairs()
    brdfs = model.materials.with_negative_values()
    lit, grid = (np.array([brdf.eval(at.wi, at.wo) for brdf in brdfs]) for at in (lights, pairs))
    to_xyz = np.array([[0.41239080, 0.35758434, 0.18048079], [0.21263901, 0.71516868, 0.07219232],
                       [0.01933082, 0.11919478, 0.95053215]])  # fmt: skip
    white = to_xyz.sum(axis=1)

    def lab(f):
        t = np.cbrt(np.clip(lights.sums @ f, 0.0, 1.0) @ to_xyz.T / white)
        t = np.where(t > 6 / 29, t, (29 / 6) ** 2 / 3 * t**3 + 4 / 29)
        return np.stack([116 * t[:, 1] - 16, 500 * (t[:, 0] - t[:, 1]), 200 * (t[:, 1] - t[:, 2])], axis=1)

    ball, cube_root = [], []
    for i, place in enumerate(model.left_out.places):
        others = [j for j in range(len(brdfs)) if j != i]
        shares = reference.blend_shares(place, model.X[others], model.space.kernel.length_scale)
        on_ball, in_grid = (
            np.maximum(np.tensordot(shares, np.cbrt(f[others]), axes=1), 0.0) for f in (lit, grid)
        )
        apart = colour_science().delta_E(lab(lit[i]), lab(on_ball**3), method="CIE 2000")
        ball.append(np.mean([part.mean() for part in np.split(apart, np.cumsum(lights.counts)[:-1])]))
        weight, roots = np.cbrt(pairs.cosines)[:, None], np.cbrt(grid[i])
        cube_root.append(np.linalg.norm(weight * (in_grid - roots)) / np.linalg.norm(weight * roots))
    blended = model.left_out.blended
    np.testing.assert_allclose(
        blended.ball, ball, rtol=1e-4
    )  # eight digits of the matrix, and the kink of CIELAB
    np.testing.assert_allclose(blended.cube_root, cube_root, rtol=1e-9)


def test_the_expected_error_is_that_of_the_documents(model, rng):
    left_out, scale = model.left_out, model.space.kernel.length_scale
    for x in rng.uniform(-3.0, 3.0, (20, model.X.shape[1])):
        for errors, is_known in ((left_out.errors, True), (left_out.blended, False)):
            found = left_out.expected(x, is_colour_known=is_known)
            for name in ("ball", "cube_root"):
                by_hand = reference.expected_error(x, model.X, left_out.places, getattr(errors, name), scale)
                assert float(getattr(found, name)) == pytest.approx(by_hand, rel=1e-9)


def test_of_a_blended_colour_a_larger_error_is_expected_than_of_a_known_one(model):
    x = model.X.mean(axis=0) + 0.1
    blended, chosen = (
        predict_and_diagnose(model, x, choice) for choice in (ColourChoice(), ColourChoice(srgb="#aa5533"))
    )
    assert blended.expected.ball > 2.0 * chosen.expected.ball
    assert blended.expected_in_chosen_colour == chosen.expected
    assert chosen.expected_in_chosen_colour is None
    of_colour = f"{chosen.expected.ball:.1f} CIEDE2000 of the ball (mean of five lights)"
    assert chosen.rows["expected error"][0][0] == of_colour
    assert blended.rows["expected error"][0][0] == f"of a material of this colour: {of_colour}"
    unknown = f"{blended.expected.ball:.1f} CIEDE2000 of the ball (mean of five lights)"
    assert blended.rows["unknown material"][0] == f"located here, its colour not given: {unknown}"
    assert "unknown material" not in chosen.rows
    assert list(blended.summary)[:3] == ["point", "expected error", "unknown material"]


def test_a_material_in_another_colour_than_its_own_has_an_expected_error(model):
    own, other = (
        predict_and_diagnose(model, model.names[0], choice)
        for choice in (ColourChoice(), ColourChoice(like=model.names[1]))
    )
    assert own.expected.ball == 0.0 < other.expected.ball


def test_a_model_calibrated_in_other_lights_has_no_expected_errors(model, library, tmp_path, monkeypatch):
    model.save(tmp_path / "model.h5")
    assert Manifold.load(tmp_path / "model.h5", library).left_out is not None
    other = panel.panel((*JUDGED[:4], "sun 120"))
    monkeypatch.setattr(panel, "judged", lambda: other)
    loaded = Manifold.load(tmp_path / "model.h5", library)
    assert loaded.left_out is None
    made = predict_and_diagnose(loaded, model.X[0] + 0.2)
    assert made.expected is None
    assert "other lights" in made.rows["expected error"][0]
    assert "embed the library again" in made.rows["expected error"][0]


def test_a_model_of_an_earlier_version_has_no_expected_errors(model, library, tmp_path):
    """Such files hold errors in known colours alone."""
    earlier = {name: values for name, values in model.left_out.arrays.items() if "blended" not in name}
    assert LeftOut.from_arrays(earlier, model.space) is None
    loaded = Manifold(model.materials, model.space, model.settings, model.statistics)
    made = predict_and_diagnose(loaded, model.X[0] + 0.2)
    assert "embed the library again" in made.rows["expected error"][0]
