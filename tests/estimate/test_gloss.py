"""Gloss of BRDFs, and completions of readings beside which gloss was read."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.readings import DIRECTIONS, readings
from helpers.small_library import NAMES
from scipy.integrate import dblquad

from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import Plastic
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import Plausibility
from manifold.colour import panel
from manifold.core.errors import FileFormatError, ShapeError, UsageError
from manifold.core.metrics import Errors
from manifold.core.records import Bands
from manifold.estimate import Completion, calibrate, completions
from manifold.estimate.coat import coat_of
from manifold.estimate.completions import Completed, parse_gloss
from manifold.estimate.expected import errors_of, leave_out
from manifold.estimate.gloss import gloss_meter, gloss_units, value_of_unit
from manifold.estimate.mixtures import GlossReadings
from manifold.formats import csv_table, registry
from manifold.formats.column_heads import gloss_angle
from manifold.formats.readings import GLOSS_ANGLES_DEG, MOST_GLOSS
from manifold.io_rgl import read_bsdf
from manifold.library.store import Library
from manifold.model.output_file import OutputOptions

RECEPTORS_DEG = {20: (1.8, 3.6), 60: (4.4, 11.7), 85: (4.0, 6.0)}


def analytic(f):
    """A BRDF of one band that is a function of both directions."""
    return SimpleNamespace(bands=Bands((550.0,)), eval=lambda wi, wo: f(wi, wo)[:, None])


def black_glass(angle):
    """Fresnel's reflectance of a dielectric of index 1.567."""
    c, n = np.cos(np.deg2rad(angle)), 1.567
    t = np.sqrt(1.0 - (1.0 - c**2) / n**2)
    return 0.5 * (((c - n * t) / (c + n * t)) ** 2 + ((t - n * c) / (t + n * c)) ** 2)


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
    assert meter.of(np.full(len(meter), 12.5 * value_of_unit(60)))[0] == pytest.approx(12.5)


# -- completions ------------------------------------------------------------------------------------------------


def test_gloss_tells_apart_what_readings_cannot(atoms):
    """Of every material left out; errors of values fall in the median."""
    without, known = (
        calibrate(atoms, readings(np.ones((12, 3)), gloss=gloss)) for gloss in ({}, {20: 1.0, 60: 1.0})
    )
    for kind in ("cube_root", "linear"):
        assert getattr(known.errors.median, kind) < getattr(without.errors.median, kind)
    glossy = NAMES.index("syn_gloss_red")
    only_60 = leave_out(atoms, glossy, readings(np.ones((12, 3)), gloss={60: 1.0}))
    assert (
        errors_of(atoms, glossy, only_60.on_grid, only_60.on_ball).cube_root
        < without.errors.cube_root[glossy]
    )


@pytest.mark.parametrize("name", NAMES)
def test_the_gloss_of_a_completion_is_near_the_one_read(atoms, library, name):
    brdf = MeasuredBRDF(Library.open(library).read(name))
    gloss = gloss_units(brdf, GLOSS_ANGLES_DEG)
    made = Completion.of(atoms, readings(brdf.eval(*DIRECTIONS), gloss=gloss))
    assert list(made.gloss) == list(gloss)
    for angle, units in gloss.items():
        assert made.gloss[angle] == pytest.approx(units, rel=0.15)
    assert not any("mirror direction" in note for note in made.notes)


def test_the_order_of_gloss_readings_does_not_matter(atoms, rng):
    read = readings(rng.random((12, 3)) + 0.1, gloss={20: 3.0, 60: 14.0, 85: 40.0})
    made, turned = (
        Completion.of(atoms, one) for one in (read, replace(read, gloss=dict(reversed(read.gloss.items()))))
    )
    assert turned.gloss_misfits == pytest.approx(made.gloss_misfits, rel=1e-6)
    np.testing.assert_allclose(turned.on_grid, made.on_grid, rtol=1e-6)


@pytest.mark.parametrize("angle", GLOSS_ANGLES_DEG)
def test_a_coat_has_the_gloss_that_was_asked_for_at_its_angle(angle):
    """Other angles have other units, so gloss taken at a default angle would miss."""
    wanted = gloss_units(Plastic(GGX.isotropic(0.1), np.array(1.5), np.full(3, 0.1), Bands(None)), [angle])
    coat, alpha = coat_of(np.array([40.0, 10.0, 20.0]), wanted, Bands(None))
    assert gloss_units(coat, [angle])[angle] == pytest.approx(wanted[angle], rel=0.05)
    assert alpha == pytest.approx(0.1, rel=0.1)


def test_gloss_is_compared_in_the_luminance_of_each_hypothesis():
    atoms = np.array([[1.0], [2.0]])
    gloss = GlossReadings(atoms, np.array([1.5]), np.array([0.25, 0.75]), np.zeros((1, 3)), np.ones(1))
    green = np.array([[1.0, 0.0], [0.0, 1.0]])  # 1 in the first band, 2 in the second
    luminous = (0.25 * 1.0 + 0.75 * 8.0) ** (1.0 / 3.0)
    variance = (0.02**2 + 0.04**2) * (1.5**2 + 0.5**2)
    assert gloss.misfit(green, 0.5) == pytest.approx((luminous - 1.5) ** 2 / variance)
    met = gloss.scaled(green @ atoms)
    assert np.cbrt(gloss.luminance @ met**3) == pytest.approx(1.5)
    assert met[1] / met[0] == pytest.approx(2.0)


def test_gloss_of_zero_dims_highlights_and_negative_gloss_is_refused(atoms, rng):
    read = readings(rng.random((12, 3)) + 0.1)
    with pytest.raises(
        ShapeError, match="gloss of -1 units at 60 degrees, expected 0 to 1000, that of a perfect mirror"
    ):
        replace(read, gloss={60: -1.0})
    made = Completion.of(atoms, read)
    assert made.gloss == pytest.approx(gloss_units(made.brdf, GLOSS_ANGLES_DEG))
    assert Completion.of(atoms, replace(read, gloss={60: 0.0})).gloss[60] < gloss_units(made.brdf, [60])[60]


def test_the_most_gloss_is_that_of_a_mirror():
    for angle, most in MOST_GLOSS.items():
        assert most == pytest.approx(100.0 / black_glass(angle), rel=0.005)


def test_gloss_that_is_not_reproduced_is_noted_and_raises_the_expected_error(atoms):
    """A dull paint cannot have the gloss of a mirror; 12 readings of it and its own gloss go together."""
    read = readings(np.full((12, 3), 0.1))
    dull = Completion.of(atoms, read)
    own = replace(read, gloss=gloss_units(dull.brdf, [60.0]))
    false = replace(read, gloss={60.0: 990.0})
    calibration = calibrate(atoms, own)
    agreeing, missing = (Completion.of(atoms, one) for one in (own, false))
    assert not any("not reproduced" in note for note in agreeing.notes)
    assert any("gloss at 60 degrees is not reproduced" in note for note in missing.notes)
    assert missing.gloss_misfits[60.0] > 5.0 * agreeing.gloss_misfits[60.0]
    for kind, error in calibration.expected(missing).known.items():
        assert error > 1.2 * getattr(calibration.expected(agreeing), kind)


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
        f"Sample;20° gloss;Gloss;Geometry;{HEADS.replace(',', ';')}\nred;1,5;12;45/0;,1;,2;,3;,4\n"
        "blue;;-;45/0;,1;,2;,3;,4\n",
    ],
)
def test_gloss_is_read_beside_reflectance(table, tmp_path):
    (tmp_path / "t.csv").write_text(table)
    red, blue = registry.read_all(tmp_path / "t.csv")
    assert (red.name, blue.name) == ("red", "blue")
    assert dict(red.gloss) == {20.0: 1.5, 60.0: 12.0}
    assert dict(blue.gloss) == {}
    np.testing.assert_allclose(red.values[0, :3] * np.pi, [0.1, 0.2, 0.3])


def test_words_about_gloss_are_no_readings_of_it(tmp_path):
    (tmp_path / "t.csv").write_text(f"# gloss: matt\nGeometry,Gloss,{HEADS}\n45as15,matt,.1,.2,.3,.4\n")
    (one,) = registry.read_all(tmp_path / "t.csv")
    assert dict(one.gloss) == {}


def test_negative_gloss_in_a_table_is_an_error(tmp_path):
    (tmp_path / "t.csv").write_text(f"Geometry,Gloss,{HEADS}\n45as15,-3,.1,.2,.3,.4\n")
    with pytest.raises(
        FileFormatError, match=r"row 2, column 2: gloss of -3 units at 60 degrees, expected 0 to 1000"
    ):
        registry.read_all(tmp_path / "t.csv")


def test_gloss_survives_a_csv_file_and_is_shown(run, tmp_path, rng):
    csv_table.write(tmp_path / "t.csv", readings(rng.random((12, 3)), gloss={60: 12.25, 20: 0.5}))
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
        (["60=-2"], "gloss of -2 units at 60 degrees, expected 0 to 1000"),
        (["60=1e9"], "gloss of 1e+09 units at 60 degrees, expected 0 to 1000, that of a perfect mirror"),
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


def test_gloss_contributes_the_change_of_the_ball_without_it(atoms, library):
    brdf = MeasuredBRDF(Library.open(library).read("syn_gloss_red"))
    read = readings(brdf.eval(*DIRECTIONS))
    others = atoms.without(NAMES.index("syn_gloss_red"))
    dull, glossy = (
        Completion.of(others, replace(read, gloss=gloss)) for gloss in ({}, gloss_units(brdf, [60.0]))
    )
    assert dull.contributions == {}
    lights = panel.judged()
    change = lights.errors(dull.on_ball, glossy.on_ball, atoms.bands).ball
    assert glossy.contributions == pytest.approx({"gloss": change})
    assert change > 0.1


def test_the_residual_of_the_json_includes_gloss_that_is_not_reproduced(atoms, tmp_path):
    missed = Completion.of(atoms, replace(readings(np.full((12, 3), 0.1)), gloss={60.0: 990.0}))
    sound = Plausibility(negative_share=0.0, reciprocity_error=0.0, max_albedo=0.9, highlight_valley=0.0)
    shown = Completed(path=tmp_path, completion=missed, expected=Errors(), plausibility=sound)
    document = shown.to_json()
    assert document["residual"] == missed.gloss_misfits[60.0]
    assert "exposure" not in shown.rows
    assert document["residual"] > 2.0 * np.sqrt(np.mean(np.square(document["misfits"])))


def test_the_note_on_gloss_that_is_not_reproduced_is_of_the_file(library, tmp_path):
    path, options = tmp_path / "dull.bsdf", OutputOptions(resolution=8, incidences=4)
    read = readings(np.full((12, 3), 0.1), gloss={60.0: 990.0})
    made = completions.complete(library, read, path, options=options)
    units = gloss_units(MeasuredBRDF(read_bsdf(path)), [60.0])[60.0]
    assert f"{units:.3g}" != f"{gloss_units(made.completion.brdf, [60.0])[60.0]:.3g}"
    assert any(f"not reproduced: {units:.3g} units instead of 990" in note for note in made.diagnostics)


def test_a_fit_of_readings_has_their_notes_and_says_that_it_uses_no_gloss(run, tmp_path):
    rows = "".join(f"{name},80,10,20,30,40\n" for name in ("45as15", "45as25", "45as45", "45as75", "45as110"))
    (tmp_path / "t.csv").write_text(f"Geometry,Gloss,{HEADS}\n{rows}")
    status, out, err = run("fit", "t.csv", "-o", "t.json", cwd=tmp_path)
    assert status == 0, err
    notes = json.loads((tmp_path / "t.json").read_text())["notes"]
    assert "taken as percent" in notes[0]
    assert "fits do not use gloss" in notes[1]
    assert "fits do not use gloss" in out
