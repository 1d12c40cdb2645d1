"""A fit drawn beside its material: the picture shows how well it fits, and a bad fit looks bad."""

from __future__ import annotations

import json

import numpy as np
import pytest
from helpers.small_library import measured, small_model
from matplotlib.image import imread

from manifold.brdf.measured import MeasuredBRDF
from manifold.core.directions import from_spherical
from manifold.estimate.source_files import source_file
from manifold.estimate.sources import FileSource, PlaceSource
from manifold.fit import fits
from manifold.fit.fits import FitSettings
from manifold.io_rgl import write_bsdf
from manifold.pictures.fit_comparison import picture_of_fit
from manifold.pictures.maps import sources
from manifold.pictures.renders import compare
from manifold.pictures.slice_figures import angle_slices
from manifold.render.ball import read_material
from manifold.render.bsdf_parameters import principled
from manifold.render.fitted_brdf import FittedBRDF
from manifold.render.render import RenderSettings

SETTINGS = RenderSettings(size=48, samples=32)
FIT = FitSettings()


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """A measured satin and the JSON of its fit."""
    folder = tmp_path_factory.mktemp("fit")
    material = folder / "satin_rgb.bsdf"
    write_bsdf(material, measured("syn_satin_gold"))
    outcome = fits.fit(material, folder / "satin.fit.json", FIT)
    return material, outcome.path


@pytest.fixture(scope="module")
def good(fitted, tmp_path_factory):
    """The picture of that fit."""
    material, fit = fitted
    path = tmp_path_factory.mktemp("picture") / "good.png"
    return *picture_of_fit(fit, material, path, SETTINGS), path


def test_the_picture_of_a_fit_shows_material_and_fit_alike(good):
    assert good[0] < 4.0
    picture = imread(good[2])[..., :3]
    rows, columns = picture.shape[0] // 3, picture.shape[1] // 4
    halves = [
        picture[rows // 4 : rows * 3 // 4, k * columns + columns // 4 : k * columns + columns * 3 // 4]
        for k in (0, 1)
    ]
    means = [half.reshape(-1, 3).mean(axis=0) for half in halves]
    assert np.abs(means[0] - means[1]).max() < 0.06
    assert means[0][0] > means[0][2] + 0.1  # gold, not grey


def test_a_bad_fit_looks_bad(fitted, good, tmp_path):
    material, fit = fitted
    content = json.loads(fit.read_text())
    content["mitsuba"]["base_color"]["color"] = [0.1, 0.1, 0.8]
    content["values"]["base_color"] = [0.1, 0.1, 0.8]
    bad = tmp_path / "bad.fit.json"
    bad.write_text(json.dumps(content))
    made = picture_of_fit(bad, material, tmp_path / "bad.png", SETTINGS)
    assert made[0] > 5 * good[0]
    assert made[1] > 2 * good[1]


def test_a_fitted_brdf_is_what_mitsuba_evaluates(fitted):
    _, fit = fitted
    brdf = FittedBRDF.read(fit)
    wi = from_spherical(0.6, 0.0)
    wo = from_spherical(np.array([0.1, 0.5, 1.0, 2.0]), np.array([0.3, 3.1, 2.0, 0.0]))
    f_cos = brdf.eval_cos(wi, wo)
    assert f_cos.shape == (4, 3)
    assert np.all(f_cos[3] == 0)  # below the horizon
    np.testing.assert_allclose(brdf.eval(wi, wo)[:3] * wo[:3, 2:], f_cos[:3], rtol=1e-6)
    truth = MeasuredBRDF(measured("syn_satin_gold")).eval_cos(wi, wo)
    np.testing.assert_allclose(f_cos[:3], truth[:3], rtol=0.25)


def test_fits_of_predictions_are_drawn_too(tmp_path):
    model = small_model(tmp_path)
    place = PlaceSource(model, "0.1,0.1")
    outcome = fits.fit(place, tmp_path / "p.fit.json", FitSettings(principled(["base_color", "roughness"])))
    with source_file(place) as path:
        made = picture_of_fit(outcome.path, path, tmp_path / "p.fit.png", SETTINGS)
    assert np.isfinite(made).all()
    assert (tmp_path / "p.fit.png").stat().st_size > 20_000


def test_a_fit_is_rendered_and_compared_like_a_file(fitted, tmp_path):
    material, fit = fitted
    source = read_material(fit)
    assert (source.is_rgb, source.route) == (True, "fitted principled")
    made = compare(FileSource(fit), FileSource(material), tmp_path / "both.png", SETTINGS)
    assert made.ciede2000_ball.mean < 4.0


def test_slices_show_a_fit_beside_its_material(fitted, tmp_path):
    material, fit = fitted
    drawn = sources([FileSource(material), FileSource(fit)])
    assert [source.label for source in drawn] == ["satin", "satin, fitted"]
    measured_line, fitted_line = angle_slices(drawn).axes[1].lines[:2]
    x = measured_line.get_xdata()
    shown = np.abs(x) < 60
    ratio = fitted_line.get_ydata()[shown] / measured_line.get_ydata()[shown]
    assert np.median(np.abs(ratio - 1.0)) < 0.15
