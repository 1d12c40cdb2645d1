"""Gloss of BRDFs, and completions of readings beside which gloss was read."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import dblquad
from small_library import NAMES

from manifold.brdf.gloss import gloss_meter, gloss_units
from manifold.brdf.measured import MeasuredBRDF
from manifold.errors import FileFormatError, ShapeError, UsageError
from manifold.experiments.readings.curve import Curve
from manifold.formats import csv_table, registry
from manifold.formats.readings import GLOSS_ANGLES_DEG, Readings, geometry_ma_t12
from manifold.formats.table_cells import gloss_angle
from manifold.library.store import Library
from manifold.model.completion import calibrate, complete
from manifold.model.completion.expected import completion_errors, leave_out
from manifold.model.completion.hybrid import combine
from manifold.models.gloss_readings import GlossReadings
from manifold.plots.plot_readings import readings_chart
from manifold.records import Bands
from manifold.workflows.completions import parse_gloss

DIRECTIONS = geometry_ma_t12()
RECEPTORS_DEG = {20: (1.8, 3.6), 60: (4.4, 11.7), 85: (4.0, 6.0)}


def analytic(f):
    """A BRDF of one band that is a function of both directions."""
    return SimpleNamespace(bands=Bands((550.0,)), eval=lambda wi, wo: f(wi, wo)[:, None])


def black_glass(angle):
    """Fresnel's reflectance of a dielectric of index 1.567."""
    c, n = np.cos(np.deg2rad(angle)), 1.567
    t = np.sqrt(1.0 - (1.0 - c**2) / n**2)
    return 0.5 * (((c - n * t) / (c + n * t)) ** 2 + ((t - n * c) / (t + n * c)) ** 2)


def readings(values, gloss=None, directions=DIRECTIONS, nm=None):
    return Readings("sample", "test", *directions, nm, values, gloss=gloss or {})


# -- gloss meters -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", GLOSS_ANGLES_DEG)
def test_a_perfect_diffuser_has_the_gloss_of_the_integral_over_the_receptor(angle):
    theta = np.deg2rad(angle)
    x, y = np.tan(np.deg2rad(RECEPTORS_DEG[angle]) / 2.0)

    def projected(b, a):  # a receptor in a plane across the mirror direction, at distance 1
        return max(np.cos(theta) - a * np.sin(theta), 0.0) / (1.0 + a**2 + b**2) ** 2 / np.pi

    share = dblquad(projected, -x, x, -y, y)[0]
    found = gloss_units(analytic(lambda wi, wo: np.full(len(wi), 1.0 / np.pi)), [angle])
    assert found[angle] == pytest.approx(100.0 * share / black_glass(angle), rel=2e-3)


@pytest.mark.parametrize("angle", GLOSS_ANGLES_DEG)
def test_black_glass_has_100_gloss_units(angle):
    """A surface that spreads the mirror direction over a fifth of a degree, as far as nodes are apart."""
    sigma = np.deg2rad(0.2)

    def f(wi, wo):
        mirror = wi * [-1.0, -1.0, 1.0]
        squared = np.sum((wo - mirror) ** 2, axis=1)
        lobe = np.exp(-0.5 * squared / sigma**2) / (2.0 * np.pi * sigma**2)
        return black_glass(angle) * lobe / wo[:, 2]

    # The receptor at 20 degrees ends 2.6 deviations from the edge of the source's image.
    assert gloss_units(analytic(f), [angle])[angle] == pytest.approx(100.0, rel=1e-3)


def test_gloss_is_luminous_and_meters_have_three_angles():
    green, grey = (
        SimpleNamespace(bands=Bands(None), eval=lambda wi, wo, f=f: np.broadcast_to(f, (len(wi), 3)))
        for f in ([0.0, 0.3, 0.0], [0.3, 0.3, 0.3])
    )
    assert gloss_units(green, [60])[60] / gloss_units(grey, [60])[60] == pytest.approx(0.7152, abs=1e-4)
    with pytest.raises(UsageError, match=r"gloss at 45 degrees, expected 20, 60 or 85"):
        gloss_meter(45)
    meter = gloss_meter(60)
    assert meter.units(np.full(len(meter.wi), meter.mean_value(12.5))) == pytest.approx(12.5)


# -- completions ------------------------------------------------------------------------------------------------


def test_gloss_tells_apart_what_readings_cannot(samples):
    """Of every material left out; errors of values fall in the median."""
    without, known = (
        calibrate(samples, readings(np.ones((12, 3)), gloss)) for gloss in ({}, {20: 1.0, 60: 1.0})
    )
    assert np.all(np.median(known.errors[:, 1:], axis=0) < np.median(without.errors[:, 1:], axis=0))
    at, at_gloss = samples.at(*DIRECTIONS), samples.gloss((60,))
    glossy = NAMES.index("syn_gloss_red")
    some, more = (
        leave_out(samples, glossy, at, readings(np.ones((12, 3)), gloss), at_gloss[:, : len(gloss)])
        for gloss in ({}, {60: 1.0})
    )
    assert completion_errors(samples, glossy, more)[1] < completion_errors(samples, glossy, some)[1]


@pytest.mark.parametrize("name", NAMES)
def test_the_gloss_of_a_completion_is_near_the_one_read(samples, library, name):
    brdf = MeasuredBRDF(Library.open(library).read(name))
    gloss = gloss_units(brdf)
    made = complete(samples, readings(brdf.eval(*DIRECTIONS), gloss))
    assert list(made.gloss) == list(gloss)
    for angle, units in gloss.items():
        assert made.gloss[angle] == pytest.approx(units, rel=0.15)
    assert not any("mirror direction" in note for note in made.notes)


def test_gloss_is_compared_in_the_luminance_of_each_hypothesis():
    samples = np.array([[1.0], [2.0]])
    gloss = GlossReadings(samples, np.array([1.5]), np.array([0.25, 0.75]), np.zeros((1, 3)))
    green = np.array([[1.0, 0.0], [0.0, 1.0]])  # 1 in the first band, 2 in the second
    luminous = (0.25 * 1.0 + 0.75 * 8.0) ** (1.0 / 3.0)
    variance = (0.02**2 + 0.04**2) * (1.5**2 + 0.5**2)
    assert gloss.misfit(green, 0.5) == pytest.approx((luminous - 1.5) ** 2 / variance)
    met = gloss.scaled(green @ samples)
    assert np.cbrt(gloss.luminance @ met**3) == pytest.approx(1.5)
    assert met[1] / met[0] == pytest.approx(2.0)


def test_gloss_of_zero_dims_highlights_and_negative_gloss_is_refused(samples, rng):
    read = readings(rng.random((12, 3)) + 0.1)
    with pytest.raises(
        ShapeError, match="gloss of -1 units at 60 degrees, expected 0 or more, at 20, 60 or 85"
    ):
        replace(read, gloss={60: -1.0})
    made = complete(samples, read)
    assert made.gloss == {}
    assert complete(samples, replace(read, gloss={60: 0.0})).gloss[60] < gloss_units(made.brdf, [60])[60]


def test_two_instruments_put_together_keep_the_gloss_of_both(rng):
    one, other = (readings(rng.random((12, 3)), gloss) for gloss in ({60: 3.0}, {60: 9.0, 20: 1.0}))
    assert dict(combine(one, other).readings.gloss) == {60: 3.0, 20: 1.0}


# -- files ------------------------------------------------------------------------------------------------------

HEADS = ",".join(f"{nm} nm" for nm in range(400, 701, 100))


@pytest.mark.parametrize(
    ("head", "angle"),
    [
        ("Gloss 60°", 60), ("60° Gloss", 60), ("gloss", 60), ("Gloss (20)", 20), ("GU 85", 85), ("Gloss 20° [GU]", 20),
        ("85 deg gloss", 85), ("Glanz 20°", 20), ("Gloss units", 60), ("Gloss 75", None), ("glossy", None),
        ("gloss trap", None), ("GUARD 60", None), ("60", None),
    ],
)  # fmt: skip
def test_columns_of_gloss_are_told_by_their_heads(head, angle):
    assert gloss_angle(head) == angle


@pytest.mark.parametrize(
    "table",
    [
        f"Sample,Geometry,Gloss 20°,Gloss 60°,{HEADS}\nred,45as15,,,.1,.2,.3,.4\nred,45as45,1.5,12,.1,.2,.3,.4\n"
        "blue,45as15,,,.1,.2,.3,.4\n",
        f"Sample;Gloss 20°;{';'.join(f'{g} {nm}' for g in ('45as15', '45as45') for nm in (400, 500, 600))};Gloss 60°\n"
        "red;1,5;,1;,2;,3;,1;,2;,3;12\nblue;;,1;,2;,3;,1;,2;,3;-\n",
        f"Geometry 45/0\nSample;20° gloss;Gloss;{HEADS.replace(',', ';')}\nred;1,5;12;,1;,2;,3;,4\n"
        "blue;;;,1;,2;,3;,4\n",
    ],
)
def test_gloss_is_read_beside_reflectance(table, tmp_path):
    (tmp_path / "t.csv").write_text(table)
    red, blue = registry.read_all(tmp_path / "t.csv")
    assert (red.name, blue.name) == ("red", "blue")
    assert dict(red.gloss) == {20.0: 1.5, 60.0: 12.0}
    assert dict(blue.gloss) == {}
    np.testing.assert_allclose(red.values[0, :3] * np.pi, [0.1, 0.2, 0.3])


def test_a_table_without_geometries_is_of_the_one_that_its_title_names(tmp_path):
    rows = f"Sample,{HEADS}\nred,.1,.2,.3,.4\n"
    (tmp_path / "t.csv").write_text(f"spectro 45°/0°,,\n{rows}")
    (red,) = registry.read_all(tmp_path / "t.csv")
    np.testing.assert_allclose(red.wo[0], [0.0, 0.0, 1.0], atol=1e-12)
    assert np.rad2deg(np.arccos(red.wi[0, 2])) == pytest.approx(45.0)
    for title in ("", "d/8,,\n", "45/0 and 0/45,,\n", "on 2045/01,,\n"):
        (tmp_path / "t.csv").write_text(title + rows)
        with pytest.raises(FileFormatError, match="no table of reflectance found"):
            registry.read_all(tmp_path / "t.csv")


def test_words_about_gloss_are_no_readings_of_it(tmp_path):
    (tmp_path / "t.csv").write_text(f"# gloss: matt\nGeometry,Gloss,{HEADS}\n45as15,matt,.1,.2,.3,.4\n")
    (one,) = registry.read_all(tmp_path / "t.csv")
    assert dict(one.gloss) == {}


def test_negative_gloss_in_a_table_is_an_error(tmp_path):
    (tmp_path / "t.csv").write_text(f"Geometry,Gloss,{HEADS}\n45as15,-3,.1,.2,.3,.4\n")
    with pytest.raises(
        FileFormatError, match=r"row 2, column 2: found gloss of -3 units, expected 0 or more"
    ):
        registry.read_all(tmp_path / "t.csv")


def test_gloss_survives_a_csv_file_and_is_shown(run, tmp_path, rng):
    csv_table.write(tmp_path / "t.csv", readings(rng.random((12, 3)), {60: 12.25, 20: 0.5}))
    (back,) = csv_table.read(tmp_path / "t.csv")
    assert dict(back.gloss) == {60.0: 12.25, 20.0: 0.5}
    status, out, err = run("info", "t.csv", "--json", "t.json", cwd=tmp_path)
    assert status == 0, err
    assert "12.25 at 60 degrees" in out
    assert json.loads((tmp_path / "t.json").read_text())["samples"][0]["gloss"] == {"60": 12.25, "20": 0.5}


# -- the command ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (["sixty=1"], "gloss 'sixty=1', expected an angle and gloss units, such as 60=12.5"),
        (["60"], "gloss '60', expected an angle and gloss units"),
        (["60=-2"], "gloss '60=-2', expected an angle and gloss units"),
        (["60=nan"], "gloss '60=nan', expected"),
        (["75=20"], "gloss at 75 degrees, expected 20, 60 or 85"),
        (["60=1", "60=2"], "gloss at 60 degrees twice, expected once"),
    ],
)
def test_gloss_that_is_none_is_named(texts, message):
    with pytest.raises(UsageError) as error:
        parse_gloss(texts)
    assert message in str(error.value)


def test_the_command_takes_gloss_and_shows_what_became_of_it(run, library, tmp_path):
    brdf = MeasuredBRDF(Library.open(library).read("syn_gloss_red"))
    units = gloss_units(brdf, [20, 60])
    csv_table.write(tmp_path / "red.csv", readings(brdf.eval(*DIRECTIONS)))
    given = [text for angle, value in units.items() for text in ("--gloss", f"{angle}={value:.3f}")]
    status, out, err = run("complete", "red.csv", "-L", library, "--json", "red.json", *given, cwd=tmp_path)
    assert status == 0, err
    assert "at 60 degrees" in out
    found = json.loads((tmp_path / "red.json").read_text())["gloss"]
    assert found["60"]["completed"] == pytest.approx(found["60"]["read"], rel=0.15)
    assert found["20"]["read"] == pytest.approx(units[20], abs=1e-3)


def test_a_fit_of_readings_has_their_notes_and_says_that_it_uses_no_gloss(run, tmp_path):
    rows = "".join(f"{name},80,10,20,30,40\n" for name in ("45as15", "45as25", "45as45", "45as75", "45as110"))
    (tmp_path / "t.csv").write_text(f"Geometry,Gloss,{HEADS}\n{rows}")
    status, out, err = run("fit", "t.csv", "-o", "t.json", cwd=tmp_path)
    assert status == 0, err
    notes = json.loads((tmp_path / "t.json").read_text())["notes"]
    assert "taken as percent" in notes[0]
    assert "fits do not use gloss" in notes[1]
    assert "fits do not use gloss" in out


def test_the_chart_of_readings_draws_every_curve():
    curves = [
        Curve(f"m{k}", f"method {k}", (2, 4)[: 1 + k % 2], np.full((1 + k % 2, 3, 3), 0.1)) for k in range(9)
    ]
    (legend,) = readings_chart(curves).legends
    assert [text.get_text() for text in legend.get_texts()] == [curve.title for curve in curves]
