"""Pictures of BRDF values show what a person would look for: highlights where they belong, and none on felt."""

from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from helpers.small_library import measured, small_model
from matplotlib import rc_context

from manifold.analytic.base import Lambert
from manifold.brdf import goniometer
from manifold.brdf.measured import MeasuredBRDF
from manifold.core.directions import from_spherical
from manifold.core.errors import UsageError
from manifold.core.records import Bands
from manifold.estimate.sources import FileSource, LibrarySource, PlaceSource
from manifold.io_rgl import write_bsdf
from manifold.pictures import figures
from manifold.pictures.comparison_figure import comparison
from manifold.pictures.maps import slices, sources
from manifold.pictures.slice_figures import (
    INCIDENCES_DEG,
    ShownBRDF,
    angle_slices,
    curves,
    rusinkiewicz_images,
    spectra_at,
)

BANDS = Bands((450.0, 550.0, 650.0))


@pytest.fixture(scope="module")
def gloss():
    return ShownBRDF("gloss", MeasuredBRDF(measured("syn_gloss_red")))


@pytest.fixture(scope="module")
def felt():
    return ShownBRDF("felt", MeasuredBRDF(measured("syn_felt_green")))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return small_model(tmp_path_factory.mktemp("slices")).parent


def pixels(figure):
    """The drawn picture, shape (rows, columns, 3), from 0 to 1."""
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())[..., :3] / 255.0


def test_the_highlight_stands_in_the_mirror_direction(gloss):
    grid = np.array(angle_slices([gloss]).axes).reshape(3, 3)
    for column, incidence in enumerate(INCIDENCES_DEG[:2]):  # at 60 degrees grazing values are higher
        x, y = grid[0, column].lines[0].get_data()
        shown = np.abs(x) < 75
        assert x[shown][np.argmax(y[shown])] == pytest.approx(incidence, abs=6.0)


def test_slices_of_a_diffuser_are_level_to_their_ends():
    """Beyond them f = f_cos / cos of its file rises, because linear interpolation does not vanish at the horizon."""
    diffuser = MeasuredBRDF(goniometer.measure(Lambert(0.5, BANDS), "diffuse"))
    lines = [
        axes.lines[0].get_data() for axes in angle_slices([ShownBRDF("diffuse", diffuser)], [550.0]).axes
    ]
    assert all(np.ptp(x) == 170.0 for x, _ in lines)
    np.testing.assert_allclose([y for _, y in lines], 0.5 / np.pi, rtol=0.2)  # the last degrees: 15 %
    beyond = diffuser.eval(from_spherical(np.deg2rad(20.0), 0.0), from_spherical(np.deg2rad(89.0), np.pi))
    assert beyond.max() > 0.6 / np.pi


def test_unmeasured_cells_are_gaps_and_no_zigzags(tmp_path):
    file = goniometer.measure(Lambert(0.5, BANDS), "whole")
    spectra = file.spectra.copy()
    spectra[:, :4, :, 8:20, 12:20] = 0.0
    write_bsdf(tmp_path / "hole_spec.bsdf", replace(file, spectra=spectra))
    write_bsdf(tmp_path / "whole_spec.bsdf", file)
    hole, whole = sources([FileSource(tmp_path / f"{name}_spec.bsdf") for name in ("hole", "whole")])
    figure = angle_slices([hole, whole])
    gaps = 0
    for axes in figure.axes:
        values, truth = (line.get_ydata() for line in axes.lines[:2])
        known = ~np.isnan(values)
        gaps += np.sum(~known)
        np.testing.assert_allclose(values[known], truth[known], rtol=1e-6)
    assert gaps > 0
    assert "not measured" in figure.axes[-1].get_xlabel()
    assert "not measured" not in angle_slices([whole]).axes[-1].get_xlabel()
    assert not np.isnan(rusinkiewicz_images([hole]).axes[0].images[0].get_array()).any()


def test_felt_shows_no_highlight(felt, gloss):
    def contrast(source):
        x, y = angle_slices([source]).axes[0].lines[0].get_data()
        shown = np.abs(x) < 75
        return y[shown].max() / np.median(y[shown])

    assert contrast(felt) < 2.0 < 5.0 < contrast(gloss)  # at 20 degrees: 8


def test_the_image_is_bright_where_gloss_mirrors_and_dark_for_felt(felt, gloss):
    figure = rusinkiewicz_images([gloss, felt])
    left, right = (axes.images[0].get_array() for axes in figure.axes)
    near, away = (slice(30, 90), slice(0, 10)), (slice(30, 90), slice(100, 140))
    assert left[near].mean() > 3 * left[away].mean()
    assert right[near].mean() < 2 * right[away].mean() + 0.05
    assert np.median(left.max(axis=-1)) > 0.3  # the colour beside the highlight is seen


def test_every_material_has_its_line_its_style_and_its_name(felt, gloss):
    figure = angle_slices([felt, gloss])
    lines = figure.axes[0].lines[:2]
    assert lines[0].get_color() != lines[1].get_color()
    assert lines[0].get_linestyle() != lines[1].get_linestyle()
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["felt", "gloss"]
    assert pixels(figure).std() > 0.02  # something is drawn


def test_bands_take_the_place_of_colours():
    grey = ShownBRDF("grey", Lambert(np.array([0.1, 0.2, 0.4]), BANDS))
    figure = angle_slices([grey], [450.0, 650.0])
    assert len(figure.axes) == 2 * len(INCIDENCES_DEG)
    np.testing.assert_allclose(figure.axes[0].lines[0].get_ydata(), 0.1 / np.pi)
    np.testing.assert_allclose(figure.axes[-1].lines[0].get_ydata(), 0.4 / np.pi)


def test_spectra_are_those_of_the_material():
    grey = ShownBRDF("grey", Lambert(np.array([0.1, 0.2, 0.4]), BANDS))
    for axes in spectra_at([grey]).axes:
        np.testing.assert_allclose(axes.lines[0].get_xdata(), BANDS.wavelengths_nm)
        np.testing.assert_allclose(axes.lines[0].get_ydata(), np.array([0.1, 0.2, 0.4]) / np.pi)


def test_spectra_are_highest_in_the_mirror_direction(gloss):
    peaks = {axes.get_title(): axes.lines[0].get_ydata().max() for axes in spectra_at([gloss]).axes}
    assert "mirror direction" in max(peaks, key=peaks.get)
    assert sum("mirror direction" in title for title in peaks) == 1


def test_what_cannot_be_drawn_is_refused(gloss):
    grey = ShownBRDF("grey", Lambert(np.array([0.1, 0.2, 0.4]), BANDS))
    with pytest.raises(UsageError, match="1 to 6"):
        angle_slices([gloss] * 7)
    with pytest.raises(UsageError, match="RGB"):
        angle_slices([gloss], [500.0])
    with pytest.raises(UsageError, match="expected 450"):
        angle_slices([grey], [900.0])


def test_spectra_beside_rgb_are_drawn_in_its_channels(gloss):
    grey = ShownBRDF("grey", Lambert(np.full(3, 0.3), BANDS))
    for axes in spectra_at([grey, gloss]).axes:
        x, f = axes.lines[0].get_data()
        np.testing.assert_array_equal(x, [0, 1, 2])
        np.testing.assert_allclose(f, 0.3 / np.pi, rtol=0.02)  # E to D65, in three bands


def test_the_values_of_curves_are_those_that_are_drawn(gloss):
    made = curves("angles", [gloss])
    of_40 = made["f"]["gloss"][1, :, 0]
    np.testing.assert_array_equal(of_40, angle_slices([gloss]).axes[1].lines[0].get_ydata())
    assert made["outgoing_deg"][of_40.argmax()] == pytest.approx(40.0, abs=1.0)
    grey = ShownBRDF("grey", Lambert(np.array([0.1, 0.2, 0.4]), BANDS))
    made = curves("spectra", [grey])
    assert made["wavelengths_nm"]["grey"] == BANDS.wavelengths_nm
    np.testing.assert_allclose(made["f"]["grey"], np.tile([0.1, 0.2, 0.4], (4, 1)) / np.pi)
    assert curves("image", [grey]) is None


@pytest.mark.parametrize("kind", ["angles", "image", "spectra"])
def test_files_materials_and_predictions_are_drawn_together(folder, tmp_path, kind):
    drawn = sources(
        [
            FileSource(folder / "files" / "syn_gloss_red_rgb.bsdf"),
            LibrarySource(folder / "library.zarr", "syn_felt_green"),
            PlaceSource(folder / "model.h5", [0.1, 0.2]),
        ]
    )
    assert [s.label for s in drawn] == ["syn_gloss_red", "syn_felt_green", "predicted at 0.1, 0.2"]
    slices(drawn, tmp_path / "picture.png", kind=kind)
    assert (tmp_path / "picture.png").stat().st_size > 10_000


def test_files_of_one_name_are_labelled_by_their_paths(folder, tmp_path):
    file = folder / "files" / "syn_gloss_red_rgb.bsdf"
    other = tmp_path / file.name
    other.write_bytes(file.read_bytes())
    named = [LibrarySource(folder / "library.zarr", name) for name in ("syn_gloss_red", "syn_felt_green")]
    drawn = sources([FileSource(file), FileSource(other), *named])
    assert [s.label for s in drawn] == [str(file), str(other), "syn_gloss_red", "syn_felt_green"]


def test_nothing_to_draw_is_refused():
    with pytest.raises(UsageError, match="no material to draw"):
        sources([])


def test_names_are_drawn_as_they_are(tmp_path):
    """No formula, no control character that makes an SVG unreadable, no error for what the font lacks."""
    figure = figures.new_figure(2.0, 1.0)
    name = "a\x01b\x1b[31m $x_1$ \u6f06"
    figure.text(0.1, 0.5, figures.shortened(name))
    with rc_context({"svg.fonttype": "none"}):
        figures.save(figure, tmp_path / "a.svg")
    texts = [element.text for element in ElementTree.parse(tmp_path / "a.svg").iter() if element.text]
    assert "a?b?[31m $x_1$ \u6f06" in texts


def test_fonts_in_a_pdf_are_truetype(tmp_path):
    """Journals refuse those of Type 3."""
    figure = figures.new_figure(2.0, 1.0)
    figure.text(0.1, 0.5, "latent $x_1$")
    figures.save(figure, tmp_path / "a.pdf")
    content = (tmp_path / "a.pdf").read_bytes()
    assert b"/FontFile2" in content
    assert b"/Type3" not in content


def test_the_difference_of_two_materials_is_that_of_their_balls():
    """A mean over the picture would shrink with the background around them."""
    pictures, difference = np.zeros((2, 4, 4, 3)), np.zeros((4, 4))
    difference[1:3, 1:3] = 8.0
    whole = comparison(*pictures, difference, difference / 10, ("a", "b"), "studio, D65")
    ball = comparison(*pictures, difference, difference / 10, ("a", "b"), "studio, D65", difference > 0)
    titles = [{axes.get_title() for axes in figure.axes} for figure in (whole, ball)]
    assert titles[0] >= {
        "CIEDE2000 (studio, D65), mean over the picture 2.00",
        "FLIP, mean over the picture 0.200",
    }
    assert titles[1] >= {"CIEDE2000 (studio, D65), mean over the ball 8.00", "FLIP, mean over the ball 0.800"}


@pytest.mark.parametrize(
    ("name", "lines"),
    [
        ("cardboard", ["cardboard"]),
        ("acrylic_felt_green", ["acrylic_", "felt_green"]),
        ("x" * 25, ["x" * 12, "x" * 12, "x"]),
        ("one two three four five six", ["one two", "three four", "five six"]),
        ("one two three four five six seven", ["one two", "three four", "five six…"]),
        ("", [""]),
    ],
)
def test_long_names_are_broken_and_cut_only_after_the_last_line(name, lines):
    assert figures.in_lines(name, 12).split("\n") == lines
