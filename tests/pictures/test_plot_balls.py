"""Maps and walks show what a person would look for: balls near their latents, highlights, and names beside them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.small_library import NAMES, measured, small_model
from matplotlib.image import imread
from matplotlib.offsetbox import AnnotationBbox

from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import Plausibility
from manifold.estimate.sources import LibrarySource
from manifold.model import diagnostics
from manifold.model.manifold import Manifold, Settings
from manifold.pictures import maps
from manifold.pictures.ball_figures import ball_map, spread, walk_strip
from manifold.render import thumbnails


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return small_model(tmp_path_factory.mktemp("balls")).parent


@pytest.fixture(scope="module")
def model(folder):
    return Manifold.load(folder / "model.h5")


@pytest.fixture(scope="module")
def balls(model):
    return thumbnails.of_materials(model)


def brightness(image):
    """Mean of the colours inside the ball, and the largest."""
    inside = image[..., :3][image[..., 3] > 0.99].mean(axis=1)
    return inside.mean(), inside.max()


def test_gloss_shows_a_highlight_and_felt_none(balls):
    mean, most = brightness(balls[NAMES.index("syn_gloss_red")])
    assert most > 1.9 * mean
    mean, most = brightness(balls[NAMES.index("syn_felt_green")])
    assert most < 1.6 * mean


def test_balls_have_the_colour_of_their_material(balls):
    red = balls[NAMES.index("syn_gloss_red")]
    green = balls[NAMES.index("syn_felt_green")]
    middle = np.s_[len(red) // 2, len(red) // 2]
    assert np.argmax(np.median(red[..., :3][red[..., 3] > 0.99], axis=0)) == 0
    assert np.argmax(np.median(green[..., :3][green[..., 3] > 0.99], axis=0)) == 1
    assert red[middle][3] == 1.0
    assert red[0, 0, 3] == 0.0


def test_measured_balls_are_rendered_once(model, balls, monkeypatch):
    monkeypatch.setattr(thumbnails, "of_material", lambda *_: pytest.fail("rendered again"))
    again = thumbnails.of_materials(model)
    np.testing.assert_allclose(again[0], balls[0], atol=1e-6)


def test_balls_stand_near_their_latents_and_do_not_cover_each_other(model, balls):
    figure = ball_map(model, balls)
    figure.canvas.draw()
    axes = figure.axes[0]
    boxes = [artist for artist in axes.artists if isinstance(artist, AnnotationBbox)]
    assert len(boxes) == len(NAMES)
    places = axes.transData.transform([box.xy for box in boxes])
    true = axes.transData.transform(model.X)
    assert np.median(np.linalg.norm(places - true, axis=1)) < 100
    apart = np.linalg.norm(places[:, None] - places[None], axis=2) + 1e9 * np.eye(len(places))
    assert apart.min() > 30
    labels = {text.get_text(): text.get_window_extent() for text in axes.texts}
    for place, name in zip(places, NAMES, strict=True):
        box = labels[name.removeprefix("syn_").replace("_", " ")]
        middle = np.array([0.5 * (box.x0 + box.x1), 0.5 * (box.y0 + box.y1)])
        nearest = places[np.argmin(np.linalg.norm(places - middle, axis=1))]
        np.testing.assert_allclose(nearest, place)


def test_a_line_above_all_balls_leads_from_each_moved_ball_to_its_latent(model, balls):
    """Where the map is crowded, others would hide the line."""
    X = 0.02 * model.X
    X[0] += 8.0  # one far away, so that the others are close in the picture
    space = replace(model.space, X=X)
    crowded = Manifold(model.materials, space, model.settings, model.statistics)
    axes = ball_map(crowded, balls).axes[0]
    boxes = [artist for artist in axes.artists if isinstance(artist, AnnotationBbox)]
    lines = [line for line in axes.lines if len(line.get_xdata()) == 2]
    to_pixels = axes.transData.transform
    radius = 15.0 * axes.figure.dpi / 72.0
    moved = 0
    for box, latent in zip(boxes, space.X, strict=True):
        centre, point = to_pixels([box.xy, latent])
        ends = [to_pixels(line.get_xydata()) for line in lines if line.zorder > box.zorder]
        mine = [edge for edge, end in ends if np.allclose(end, point, atol=0.1)]
        apart = np.linalg.norm(point - centre)
        if apart <= radius:
            assert not mine
            continue
        moved += 1
        (edge,) = mine
        assert np.linalg.norm(edge - centre) == pytest.approx(radius, abs=0.1)
        assert np.linalg.norm(edge - point) == pytest.approx(apart - radius, abs=0.1)
    assert moved >= 3


def test_spread_points_keep_apart_and_inside(rng):
    points = rng.normal(size=(30, 2)) * 5 + 200
    places = spread(points, np.array([20.0, 30.0]), np.array([0.0, 0.0, 400.0, 400.0]))
    distance = np.max(np.abs(places[:, None] - places[None]) / [20.0, 30.0], axis=2) + 9 * np.eye(30)
    assert distance.min() > 0.95
    assert places.min() >= 10
    assert places.max() <= 390
    far = np.array([[100.0, 100.0], [300.0, 300.0]])
    np.testing.assert_allclose(
        spread(far, np.array([20.0, 20.0]), np.array([0, 0, 400.0, 400.0])), far, atol=0.1
    )


@pytest.fixture
def coarse(monkeypatch):
    """Balls of few samples, which are quick to render."""
    monkeypatch.setattr(thumbnails, "SAMPLES", 8)


def ends(folder):
    """Of a walk."""
    return [LibrarySource(folder / "library.zarr", name) for name in ("syn_felt_green", "syn_gloss_red")]


def test_a_walk_begins_and_ends_with_the_materials(folder, model, coarse, tmp_path):
    maps.walk(folder / "model.h5", *ends(folder), tmp_path / "walk.png", steps=3)
    picture = imread(tmp_path / "walk.png")[..., :3]
    assert picture.std() > 0.1
    drawn = thumbnails.of_material(model.interpolate("syn_felt_green", "syn_gloss_red", 0.0))
    direct = thumbnails.of_material(MeasuredBRDF(measured("syn_felt_green")))
    assert np.abs(drawn - direct).mean() < 0.01


def test_strips_name_their_rows_and_steps(balls):
    figure = walk_strip("way", [0.0, 1.0], [("manifold", balls[:2]), ("linear", balls[:2])])
    assert [axes.get_ylabel() for axes in figure.axes[::2]] == ["manifold", "linear"]
    assert [axes.get_xlabel() for axes in figure.axes[2:]] == ["t = 0", "t = 1"]


def test_strips_mark_the_steps_that_the_data_do_not_support(balls):
    rows = [("manifold", balls[:2]), ("linear", balls[:2])]
    figure = walk_strip("way", [0.0, 1.0], rows, [False, True])
    assert [axes.get_title() for axes in figure.axes] == ["", "!", "", ""]
    assert "diagnostic" in figure.get_supxlabel()
    assert walk_strip("way", [0.0, 1.0], rows, [False, False]).get_supxlabel() == ""


def test_a_walk_says_what_speaks_against_its_steps(folder, coarse, tmp_path, monkeypatch):
    monkeypatch.setattr(diagnostics, "plausibility", lambda brdf: Plausibility(0.3, 0.0, 0.5, 0.0))
    ((t, made),) = maps.walk(folder / "model.h5", *ends(folder), tmp_path / "walk.png", steps=3).items()
    assert t == 0.5
    assert "30 % of the values were negative; the data do not support this point" in made.diagnostics


def test_long_names_are_broken_where_they_have_spaces(model, balls):
    figure = ball_map(model, balls)
    texts = {text.get_text() for axes in figure.axes for text in axes.texts}
    assert {name.removeprefix("syn_").replace("_", " ") for name in model.names} == {
        text.replace("\n", " ") for text in texts if text
    }
    assert all(len(line) <= 13 for text in texts for line in text.split("\n"))


def test_balls_on_a_line_stay_on_it_where_there_is_room(model, balls):
    line = Manifold.fit(model.library, Settings(latent_dim=1), names=NAMES[:2], calibrate=False)
    axes = ball_map(line, balls[:2]).axes[0]
    heights = [axes.transData.transform(box.xy)[1] for box in axes.artists if isinstance(box, AnnotationBbox)]
    below, above = axes.bbox.intervaly
    np.testing.assert_allclose(heights, 0.5 * (below + above), atol=0.02 * (above - below))


def test_walks_to_nowhere_are_refused(run, folder):
    status, _, err = run("walk", "syn_felt_gren", "syn_gloss_red", cwd=folder)
    assert status == 2
    assert "syn_felt_green" in err
