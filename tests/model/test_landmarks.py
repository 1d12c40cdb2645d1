"""Claims about maps by landmarks: what they predict, locate, store and refuse."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.small_library import NAMES, measured, small_library
from matplotlib.collections import PathCollection

from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured_cells import fill_unmeasured
from manifold.colour import ball_colours
from manifold.core.errors import UsageError
from manifold.evaluate.report import make_report
from manifold.library.store import Library
from manifold.model import embedding, expected_error, landmarks
from manifold.model.colours import ColourChoice
from manifold.model.manifold import Manifold
from manifold.model.settings import BlendSettings, GplvmSettings
from manifold.page.page_data import tabulate, to_document
from manifold.pictures import map_figure

MORE = ("syn_paint_sand", "syn_paper_red", "syn_satin_white", "syn_gloss_green")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("landmarks")


@pytest.fixture(scope="module")
def model(folder):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(expected_error, "_SAMPLE", 6)
        patch.setattr(landmarks, "_AROUND", 6)
        library = Library.open(small_library(folder, names=NAMES + MORE))
        return Manifold.fit(library, BlendSettings(landmarks=5))


def test_predictions_at_all_materials_are_their_files_with_unmeasured_cells_filled(model):
    ball = ball_colours.ball()
    assert len(model.landmarks) == 5
    for name in model.names:
        predicted = model.predict(name).eval(ball.wi, ball.wo)
        np.testing.assert_array_equal(
            predicted, MeasuredBRDF(fill_unmeasured(measured(name))).eval(ball.wi, ball.wo)
        )


def test_materials_that_are_no_landmarks_are_found_where_they_are(model):
    for k in np.delete(np.arange(len(model.names)), model.landmarks):
        found = model.embed(model.material(model.names[k]))
        np.testing.assert_allclose(found.latent, model.X[k], atol=1e-6)
        assert found.relative_error < 0.02  # negative values are cut, colours coordinates of a path


def test_a_saved_map_predicts_the_same(model, folder):
    model.save(folder / "m.h5")
    loaded = Manifold.load(folder / "m.h5")
    x, ball = model.X.mean(axis=0), ball_colours.ball()
    colours = model.choose_colour(x, ColourChoice(srgb="#aa5533")).colours
    for chosen in (None, colours):
        np.testing.assert_array_equal(
            loaded.predict(x, chosen).eval(ball.wi, ball.wo), model.predict(x, chosen).eval(ball.wi, ball.wo)
        )
    assert loaded.expected_error(x).ball == model.expected_error(x).ball
    np.testing.assert_array_equal(loaded.landmarks, model.landmarks)


def test_a_chosen_colour_is_reached_as_on_any_map(model):
    x = model.X.mean(axis=0)
    chosen = model.choose_colour(x, ColourChoice(srgb="#808080"))
    assert chosen.residual < 0.01  # of a reflectance, after two steps of Newton


def test_expected_errors_are_calibrated_by_a_sample(model):
    errors = model.left_out
    assert len(errors.materials) == 6
    assert errors.places.shape == (6, 2)
    assert 0.0 < model.expected_error(model.X.mean(axis=0)).ball < 50.0


def test_a_page_blends_the_landmarks_and_shows_the_others_as_points(model):
    document = to_document(model, tabulate(model))
    assert len(document["names"]) == len(document["paths"]["vertices"]) == 5
    assert len(document["others"]["X"]) == len(document["others"]["colours"]) == 5
    assert sorted(document["names"] + document["others"]["names"]) == sorted(model.names)


def test_a_picture_shows_few_landmarks_in_detail_and_all_others_as_points(model, monkeypatch):
    monkeypatch.setattr("manifold.model.manifold._PICTURED", 3)
    axes = map_figure.latent_map(model).axes[0]
    counts = [len(drawn.get_offsets()) for drawn in axes.collections if isinstance(drawn, PathCollection)]
    assert sorted(counts) == [3, 7]


def test_a_report_on_a_map_by_landmarks_is_refused(model):
    with pytest.raises(UsageError, match="map of 10, 5 of them landmarks, expected a map without landmarks"):
        make_report(model)


def test_the_kind_that_grows_with_the_cube_refuses_many_materials(model, monkeypatch):
    monkeypatch.setattr(embedding, "MOST_LAID_OUT", 9)
    with pytest.raises(UsageError, match="10 materials for kind gplvm, expected at most 9"):
        Manifold.fit(model.library, GplvmSettings())


def test_landmarks_are_refused_where_they_cannot_span_the_map():
    with pytest.raises(UsageError, match="landmarks = 3 in 2 dimensions, expected at least 4"):
        BlendSettings(landmarks=3)
