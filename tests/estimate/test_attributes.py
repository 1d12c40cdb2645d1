"""Materials by gloss, lightness, chroma and hue."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
from helpers.small_library import small_library

from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import Plastic, RoughConductor
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import plausibility
from manifold.colour.difference import lab_under_d65
from manifold.colour.narrow_bands import in_daylight
from manifold.core.directions import from_spherical
from manifold.core.errors import ManifoldError, UsageError
from manifold.core.metrics import Errors
from manifold.core.records import Bands
from manifold.estimate import coat
from manifold.estimate.attributes import (
    COLOUR_TOLERANCE,
    GLOSS_TOLERANCE,
    Adjusted,
    Attributes,
    NotReachedWarning,
    Wanted,
    adjust,
    find,
    lab_of,
)
from manifold.estimate.coat import ColourSample, RecoatedBRDF, read_colours, with_gloss
from manifold.estimate.edits import own_values
from manifold.estimate.gloss import gloss_units
from manifold.estimate.predictions import predict
from manifold.formats.readings import GLOSS_ANGLES_DEG, Readings, Viewing
from manifold.io_rgl import read_bsdf
from manifold.model.colours import ColourChoice
from manifold.model.diagnostics import MOST_RESIDUAL, diagnose
from manifold.model.manifold import Manifold
from manifold.model.output_file import EXPECTED_ERROR
from manifold.model.places import Place
from manifold.model.settings import BlendSettings, GplvmSettings


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> Manifold:
    library = small_library(tmp_path_factory.mktemp("attributes"))
    return Manifold.fit(library, BlendSettings(), calibrate=False)


def test_without_attributes_a_material_stays_where_it_is(model):
    name = model.names[0]
    found = adjust(model, name, Attributes())
    np.testing.assert_array_equal(found.place.latent, model.latent(name))
    assert found.shortfalls == ()
    assert found.difference < 0.1


def test_what_is_reached_is_what_the_prediction_has_and_the_rest_is_said(model):
    for name, attributes in (
        (model.names[0], {"hue": Wanted(40.0, is_relative=True)}),
        (model.names[1], {"lightness": Wanted(60.0), "chroma": Wanted(20.0)}),
        (model.names[2], {"lightness": Wanted(99.0), "chroma": Wanted(90.0)}),  # no reflectance has these
    ):
        found = adjust(model, name, Attributes(attributes))
        np.testing.assert_array_equal(found.place.latent, model.latent(name))
        lab = lab_of(model.predict(found.place.latent, found.colours))
        reached = found.reached
        assert np.hypot(*lab[1:]) == pytest.approx(reached["chroma"], rel=1e-6)
        assert lab[0] == pytest.approx(reached["lightness"], rel=1e-6)
        assert bool(found.shortfalls) == (found.difference > COLOUR_TOLERANCE)
    assert found.shortfalls
    grey = Attributes({"lightness": Wanted(60.0), "chroma": Wanted(5.0)})
    assert not adjust(model, model.names[1], grey).shortfalls


def test_values_are_absolute_or_relative():
    assert [Wanted.parse(t).of(50.0) for t in ("30", "+10", "-10", ".5")] == [30.0, 60.0, 40.0, 0.5]
    assert Attributes.parse({"gloss": ["60=+10"]}).wanted == {"gloss_60": Wanted(10.0, is_relative=True)}
    for text in ("", "nan", "ten", "1e9", "--3"):
        with pytest.raises(UsageError, match="expected a number such as 30"):
            Wanted.parse(text)


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        (Attributes({"lightness": Wanted(120.0)}), "lightness 120"),
        (Attributes({"chroma": Wanted(-500.0, is_relative=True)}), "chroma -"),
        (Attributes({"gloss_60": Wanted(-3.0)}), "gloss of -3 units"),
        (Attributes({"gloss_60": Wanted(0.0)}), "at least 0.01"),
        (Attributes({"gloss_85": Wanted(2000.0)}), "2000 units at 85 degrees, expected 0 to 16"),
        (Attributes({"gloss_20": Wanted(2100.0)}), "2100 units at 20 degrees"),
    ],
)
def test_impossible_attributes_are_refused(model, attributes, message):
    with pytest.raises(UsageError, match=message):
        adjust(model, model.names[0], attributes)


def test_an_unknown_attribute_is_refused():
    with pytest.raises(
        UsageError, match="attribute 'gloss_45', expected one of gloss_20, gloss_60, gloss_85"
    ):
        Attributes({"gloss_45": Wanted(3.0)})


def test_texts_of_options_are_attributes():
    parsed = Attributes.parse({"gloss": ["60=40", "85=+3"], "lightness": None, "hue": "-20"})
    assert parsed is not None
    assert parsed.wanted == {
        "gloss_60": Wanted(40.0), "gloss_85": Wanted(3.0, is_relative=True), "hue": Wanted(-20.0, is_relative=True),
    }  # fmt: skip
    assert Attributes.parse({"gloss": None, "lightness": None}) is None


def test_what_was_not_reached_is_said():
    asked = {"gloss_60": 90.0, "lightness": 50.0, "chroma": 20.0, "hue": 30.0}
    reached = {"gloss_60": 40.0, "lightness": 55.0, "chroma": 25.0, "hue": 35.0}
    found = Adjusted(Place(np.zeros(2)), None, asked, reached)
    assert [text.split(":")[0] for text in found.shortfalls] == ["gloss at 60 degrees", "colour"]
    assert found.to_json()["reached"]["gloss"] == {"60": 40.0}
    assert "no reflectance" not in found.shortfalls[1]
    strong = {"lightness": 51.2, "chroma": 200.0, "hue": 72.0}
    (said,) = Adjusted(Place(np.zeros(2)), None, strong, strong | {"chroma": 90.0}).shortfalls
    assert said.endswith("no reflectance has the requested colour, this is the nearest in CIELAB")


def test_a_gplvm_takes_gloss_by_the_coat_and_no_colour(run, model, tmp_path):
    whole = Manifold.fit(model.library, GplvmSettings(), calibrate=False)
    whole.save(tmp_path / "gplvm.h5")
    given = ["predict", "syn_felt_green", "-M", tmp_path / "gplvm.h5", "-o", tmp_path / "a_rgb.bsdf"]
    code, out, _ = run(*given, "--gloss", "60=20", "--json", "-", cwd=tmp_path)
    assert code == 0
    found = json.loads(out)["attributes"]
    assert found["reached"]["gloss"]["60"] == pytest.approx(20.0, rel=GLOSS_TOLERANCE)
    assert found["ciede2000"] < 1.0
    assert np.array_equal(found["latent"], whole.latent("syn_felt_green"))
    code, _, err = run(*given, "--hue", "+20", cwd=tmp_path)
    assert code == 2
    assert "a map of kind gplvm, expected blend" in err


def test_the_command_writes_the_material_and_says_what_it_has(run, model, tmp_path):
    model.save(tmp_path / "model.h5")
    path = tmp_path / "glossy_rgb.bsdf"
    arguments = ["predict", "syn_felt_green", "--gloss", "60=20", "--hue", "+20", "-M", tmp_path / "model.h5"]
    code, out, _ = run(*arguments, "-o", path, "--json", "-", cwd=tmp_path)
    assert code == 0
    reached = json.loads(out)["attributes"]["reached"]
    written = gloss_units(MeasuredBRDF(read_bsdf(path)), [60.0])[60.0]
    assert written == pytest.approx(reached["gloss"]["60"], rel=0.2)  # the file's grid blurs highlights
    for wrong in (["--gloss", "45=3"], ["--hue", "red"], ["--latent", "0,0"]):
        code, _, err = run(*arguments[:2], *wrong, "-M", tmp_path / "model.h5", cwd=tmp_path)
        assert code == 2
        assert "expected" in err


def test_materials_are_found_by_colour_and_gloss(run, model, tmp_path):
    library = model.library
    for name in model.names:
        brdf = model.material(name)
        (first, *_) = find(library, lab=lab_of(brdf), gloss=gloss_units(brdf, [60.0]))
        assert (first.name, first.distance) == (name, pytest.approx(0.0, abs=1e-6))
    lab = ",".join(f"{v:.2f}" for v in lab_of(model.material("syn_gloss_red")))
    code, out, _ = run("find", "--lab", lab, "--count", "2", "-L", library.path, cwd=tmp_path)
    assert code == 0
    assert out.split("\n")[1].split()[0] == "syn_gloss_red"
    code, out, _ = run("find", "--gloss", "60=1", "-L", library.path, "--json", "-", cwd=tmp_path)
    gloss = [one["gloss"]["60"] for one in json.loads(out)["found"]]
    assert np.all(np.diff(np.abs(np.log(gloss))) >= 0)
    assert run("find", "--gloss", "60=0", "-L", library.path, cwd=tmp_path)[0] == 0
    for wrong in ([], ["--lab", "50,1"], ["--gloss", "45=3"], ["--gloss", "85=2000"]):
        code, _, err = run("find", *wrong, "-L", library.path, cwd=tmp_path)
        assert code == 2
        assert "expected" in err


def test_a_colour_and_gloss_are_reached_by_a_coat(run, model, tmp_path):
    path = tmp_path / "asked_rgb.bsdf"
    arguments = ["complete", "--lab", "45,30,15", "--gloss", "60=12", "-L", model.library.path, "-o", path]
    code, out, _ = run(*arguments, "--json", "-", cwd=tmp_path)
    assert code == 0
    made, brdf = json.loads(out), MeasuredBRDF(read_bsdf(path))
    np.testing.assert_allclose(made["lab"]["written"], lab_of(brdf))
    np.testing.assert_allclose(lab_of(brdf), [45.0, 30.0, 15.0], atol=0.2)
    assert gloss_units(brdf, [60.0])[60.0] == pytest.approx(12.0, rel=0.05)
    assert made["gloss"]["60"]["written"] == pytest.approx(gloss_units(brdf, [60.0])[60.0])
    assert made["expected"]["ball"] > 0.0
    assert made["diagnostics"] == []
    code, out, _ = run(*arguments, "--mixture", "--json", "-", cwd=tmp_path)
    assert code == 0
    assert "made_of" in json.loads(out)


def test_suggestions_of_a_colour_and_gloss_leave_the_coat_as_it_is(run, model, tmp_path):
    """A mixture of library materials, which completes readings, would miss the gloss."""
    common = ["complete", "--lab", "45,30,15", "--gloss", "60=12", "-L", model.library.path]
    assert run(*common, "-o", "plain.bsdf", cwd=tmp_path)[0] == 0
    code, out, _ = run(*common, "-o", "next.bsdf", "--suggest", "2", "--json", "next.json", cwd=tmp_path)
    assert code == 0
    assert "a dielectric coat" in out
    assert "Measure next" in out
    plain, following = (read_bsdf(tmp_path / f"{name}.bsdf") for name in ("plain", "next"))
    np.testing.assert_array_equal(following.spectra, plain.spectra)
    suggested = json.loads((tmp_path / "next.json").read_text())["suggested_deg"]
    assert np.shape(suggested) == (2, 3)
    (tmp_path / "colours.txt").write_text("red,50,60,40\n")
    code, _, err = run(
        "complete", "--lab", "colours.txt", "--suggest", "2", "-L", model.library.path, cwd=tmp_path
    )
    assert code == 2
    assert "--suggest works only with readings or one colour" in err


@pytest.mark.parametrize(("before", "after"), [(0.08, 0.3), (0.3, 0.08)])
def test_another_gloss_is_another_coat_over_the_same_base(before, after, rng):
    def paint(alpha):
        return Plastic(GGX.isotropic(alpha), np.array(1.5), np.array([0.4, 0.5, 0.6]), Bands(None))

    made, wanted = with_gloss(paint(before), gloss_units(paint(after), GLOSS_ANGLES_DEG)), paint(after)
    wi, wo = (from_spherical(rng.uniform(0.0, 1.2, 200), rng.uniform(0.0, 6.28, 200)) for _ in range(2))
    np.testing.assert_allclose(np.cbrt(made.eval(wi, wo)), np.cbrt(wanted.eval(wi, wo)), rtol=0.02)
    np.testing.assert_allclose(made.eval(wo, wi), made.eval(wi, wo), rtol=1e-9)
    np.testing.assert_allclose(lab_of(made), lab_of(paint(before)), atol=0.5)


@pytest.mark.parametrize("alpha", [0.3, 0.8])
def test_another_gloss_keeps_a_colour_darker_than_the_coat(alpha):
    """In blue there is no base that a coat of less light at 45/0 could uncover: chroma rose from 47 to 57."""
    paint = Plastic(GGX.isotropic(alpha), np.array(1.5), np.array([0.35, 0.16, 0.0]), Bands(None))
    glossy = with_gloss(paint, {60.0: 40.0})
    assert gloss_units(glossy, [60.0])[60.0] == pytest.approx(40.0, rel=GLOSS_TOLERANCE)
    np.testing.assert_allclose(lab_of(glossy), lab_of(paint), atol=0.1)


def test_facets_of_a_new_coat_reflect_at_most_all_light(rng):
    """Where the old coat's highlight is dark, the ratio of the highlights exceeds what any surface reflects."""
    bands, index = Bands(None), np.array(1.5)
    metal = RoughConductor(GGX.isotropic(0.8), np.full(3, 0.05), np.full(3, 6.0), bands)
    old, new = (Plastic(GGX.isotropic(alpha), index, np.zeros(3), bands) for alpha in (0.05, 0.4))
    made = RecoatedBRDF(metal, old, new, np.full(3, 50.0))
    wi, wo = (from_spherical(rng.uniform(0.0, 1.5, 200), rng.uniform(0.0, 6.28, 200)) for _ in range(2))
    facets = new.boundary.reflectance(np.sqrt(0.5 + 0.5 * np.sum(wi * wo, axis=1)))
    mirrors = new.boundary.eval(wi, wo) / facets
    assert np.all(made.eval(wi, wo) <= (metal.eval(wi, wo) + mirrors) * (1.0 + 1e-9))


def test_another_colour_of_the_base_leaves_a_dielectric_highlight_and_tints_that_of_a_metal():
    wi, wo = from_spherical(np.deg2rad(30.0), np.pi), from_spherical(np.deg2rad(30.0), 0.0)
    red = Plastic(GGX.isotropic(0.1), np.array(1.5), np.array([0.5, 0.1, 0.1]), Bands(None))
    grey = Plastic(red.ggx, red.eta, np.array([0.2, 0.2, 0.2]), red.bands)
    made, asked = own_values(red, Attributes({"chroma": Wanted(0.0), "lightness": Wanted(lab_of(grey)[0])}))
    assert asked.difference < 0.1
    np.testing.assert_allclose(made.eval(wi, wo), grey.eval(wi, wo), rtol=0.03)
    metal = RoughConductor(
        red.ggx, np.array([0.18, 0.42, 1.37]), np.array([3.4, 2.35, 1.77]), red.bands
    )  # gold
    made, asked = own_values(metal, Attributes({"chroma": Wanted(0.0)}))
    before, after = (brdf.eval(wi, wo) for brdf in (metal, made))
    assert np.ptp(before) / before.mean() > 0.4
    assert np.ptp(after) / after.mean() < 0.2
    same, _ = own_values(metal, Attributes({"hue": Wanted(0.0, is_relative=True)}))
    np.testing.assert_allclose(same.eval(wi, wo), before, rtol=1e-3)


def test_a_step_of_a_walk_takes_colour_and_gloss_as_it_is(model, tmp_path):
    """Another hue was looked for on the map, where there is another material."""
    step = f"{model.names[0]}:{model.names[1]}:0.5"
    for wanted in ({"hue": Wanted(0.0, is_relative=True)}, {"gloss_60": Wanted(0.0, is_relative=True)}):
        made = predict(model, step, tmp_path / "step_rgb.bsdf", attributes=Attributes(wanted))
        assert made.walk is not None
        assert made.change.ball < 1.0
        assert made.own.startswith("the step between")
    chosen = predict(model, step, tmp_path / "step_rgb.bsdf", colour=ColourChoice(srgb="#208020"))
    assert any(note.startswith("not the step of the walk") for note in chosen.diagnostics)


def test_a_measured_material_of_another_gloss_has_no_expected_error_of_the_map(model, tmp_path):
    name = model.names[0]
    asked = Attributes({"gloss_60": Wanted(20.0)})
    made = predict(model, name, tmp_path / "glossy_rgb.bsdf", attributes=asked)
    assert made.own == name
    assert made.expected is None
    assert made.rows["expected error"] == ("none, because the map is not used for the change",)
    assert EXPECTED_ERROR not in read_bsdf(made.path).extra


def test_a_hole_that_a_new_coat_makes_is_not_blamed_on_the_measured_file(model):
    name = model.names[0]
    place, brdf = model.place(name), model.material(name)
    hole = replace(plausibility(brdf), highlight_valley=0.5)
    for is_recoated, words in (
        (False, "the measured file has a dark hole"),
        (True, "dark hole or ring near"),
    ):
        notes = diagnose(model, place, brdf, found=hole, is_recoated=is_recoated).diagnostics
        assert any(note.startswith(words) for note in notes)


def test_a_colour_and_a_gloss_asked_for_together_are_both_reached(model, tmp_path):
    name = "syn_felt_orange"
    asked = Attributes({"gloss_60": Wanted(30.0), "chroma": Wanted(35.0)})
    made = predict(model, name, tmp_path / "a_rgb.bsdf", attributes=asked).attributes
    assert made["shortfalls"] == []
    assert made["reached"]["chroma"] == pytest.approx(35.0, abs=1.0)
    assert made["reached"]["gloss"]["60"] == pytest.approx(30.0, rel=GLOSS_TOLERANCE)


def test_a_given_colour_that_is_not_reached_is_said_also_with_a_gloss(model, tmp_path):
    white = ColourChoice(srgb="#ffffff")
    plain = predict(model, "syn_felt_orange", tmp_path / "a_rgb.bsdf", colour=white)
    assert plain.reflectance_residual > MOST_RESIDUAL
    glossy = predict(
        model, "syn_felt_orange", tmp_path / "b_rgb.bsdf",
        colour=white, attributes=Attributes({"gloss_60": Wanted(30.0)}),
    )  # fmt: skip
    assert glossy.reflectance_residual == plain.reflectance_residual
    assert any(note.startswith("requested reflectance cannot be reached") for note in glossy.diagnostics)


def test_what_cannot_be_reached_is_said_before_anything_is_written(model, tmp_path):
    """The light of a matt coat alone is brighter."""
    asked, path = Attributes({"gloss_60": Wanted(3.0), "lightness": Wanted(1.0)}), tmp_path / "a_rgb.bsdf"
    with pytest.warns(NotReachedWarning, match="colour: .* reached, L 1.0, .* requested"):
        made = predict(model, "syn_gloss_red", path, attributes=asked)
    assert made.attributes["shortfalls"]
    path.unlink()
    with warnings.catch_warnings():
        warnings.simplefilter("error", NotReachedWarning)
        with pytest.raises(NotReachedWarning):
            predict(model, "syn_gloss_red", path, attributes=asked)
    assert not path.exists()


def test_gloss_that_no_dielectric_has_is_said(run, model, tmp_path):
    arguments = [
        "complete",
        "--lab",
        "30,0,0",
        "--gloss",
        "20=900",
        "-L",
        model.library.path,
        "-o",
        "mirror.bsdf",
    ]
    code, out, _ = run(*arguments, "--json", "-", cwd=tmp_path)
    assert code == 0
    (note,) = json.loads(out)["diagnostics"]
    assert note.startswith("gloss at 20 degrees")
    assert "900 requested" in note


@pytest.mark.parametrize(
    ("asked", "why", "missed"),
    [
        ({20.0: 90.0, 60.0: 20.0}, "contradict each other", "gloss at 20 degrees (41 instead of 90)"),
        ({60.0: 0.02}, "every coat of this colour has more", "gloss at 60 degrees (0.5 instead of 0.02)"),
        ({20.0: 900.0}, "metals may have more", "gloss at 20 degrees (200 instead of 900)"),
    ],
)
def test_a_missed_request_is_part_of_the_expected_error(asked, why, missed, tmp_path):
    reached = {20.0: 41.0, 60.0: 76.0} if len(asked) > 1 else {60.0: 0.5, 20.0: 200.0}
    sample = ColourSample("red", (40.0, 50.0, 30.0), asked)
    assert all(why in note for note in coat._missed(sample, np.array(sample.lab), reached))
    made = coat.Coated(
        tmp_path,
        sample,
        0.1,
        1.5,
        np.array([44.0, 50.0, 30.0]),
        reached,
        Errors(ball=8.0),
        None,
        None,
        (),
        0.0,
    )
    first, *_ = made.rows["expected error"]
    assert first.startswith("missed: the colour, by CIEDE2000 3.6")
    assert missed in first


def test_a_missed_colour_adds_to_the_expected_error(model, tmp_path):
    made = [
        coat.complete(model.library.path, ColourSample("blue", lab, {60.0: 30.0}), tmp_path / "blue.bsdf")
        for lab in ((40.0, 10.0, -10.0), (40.0, 120.0, -120.0))
    ]
    assert made[0].ciede2000 < 1.0
    assert made[1].expected.ball == pytest.approx(np.hypot(made[0].expected.ball, made[1].ciede2000))


def test_a_list_of_colours_makes_a_folder(run, model, tmp_path):
    (tmp_path / "colours.csv").write_text("name;L*;a*;b*;gloss_60\nred;45;30;15;20\ngrey;50;0;0;5\n")
    arguments = ["complete", "--lab", "colours.csv", "-L", model.library.path, "-o", "made"]
    code, out, _ = run(*arguments, "--json", "-", cwd=tmp_path)
    assert code == 0
    for name, lab, units in (("red", [45, 30, 15], 20.0), ("grey", [50, 0, 0], 5.0)):
        brdf = MeasuredBRDF(read_bsdf(tmp_path / "made" / f"{name}.bsdf"))
        np.testing.assert_allclose(lab_of(brdf), lab, atol=0.2)
        assert gloss_units(brdf, [60.0])[60.0] == pytest.approx(units, rel=0.05)
    code, out, _ = run("find", "--lab", "colours.csv", "-L", model.library.path, "--json", "-", cwd=tmp_path)
    assert set(json.loads(out)["found"]) == {"red", "grey"}


def test_lists_of_colours_are_read_with_and_without_names(tmp_path):
    path = tmp_path / "colours.txt"
    path.write_text("# three\n50 20 -10\n\n60 0 0\n")
    assert [(one.name, one.lab) for one in read_colours(path, {})] == [
        ("colour_2", (50.0, 20.0, -10.0)), ("colour_4", (60.0, 0.0, 0.0)),
    ]  # fmt: skip
    path.write_text("red\t50\t60\t40\n")
    (one,) = read_colours(path, {60.0: 7.0})
    assert (one.name, one.lab, one.gloss) == ("red", (50.0, 60.0, 40.0), {60.0: 7.0})
    for wrong, said in (
        ("", "no colours"),
        ("red,50\n", "line 1: found 'red 50', expected name, L, a, b"),
        ("red,50,x,40\nb,1,2,3\n", "line 1: found 'x', expected a number; correct the cell"),
        ("a,50,1,1\na,60,1,1\n", "twice"),
        ("a,150,1,1\n", "L from 0 to 100"),
        (
            "42,55,30,85\n",
            "line 1: found '42 55 30 85', expected name, L, a, b",
        ),  # a name, or a decimal comma?
        ("name,X,Y,Z\nred,1,2,3\n", "found the header name, X, Y, Z"),
        ("name,L,a,b,gloss_60\nred,50,1,1,9999\n", "line 2: gloss of 9999 units"),
    ):
        path.write_text(wrong)
        with pytest.raises(ManifoldError, match=said):
            read_colours(path, {})


@pytest.mark.parametrize(
    "text",
    [
        "name,L,a,b\nRAL 1000,76.5,0,28\n2,75,-1,30\n",
        "RAL 1000,76.5,0,28\ngreen beige,75,-1,30\n",
        "RAL 1000;76,5;0;28\ngreen beige;75;-1;30\n",
        "RAL 1000 76,5 0 28\ngreen beige 75 -1 30\n",
        'name,L,a,b\n"RAL 1000","76,5",0,28\nx,75,-1,30\n',
        "b*\tL*\tname\ta*\n28\t76,5\tRAL 1000\t0\n30\t75\tx\t-1\n",
    ],
)
def test_names_with_blanks_and_decimal_commas_are_read(text, tmp_path):
    path = tmp_path / "colours.csv"
    path.write_text(text)
    first, second = read_colours(path, {})
    assert (first.name, first.lab, second.lab) == ("RAL_1000", (76.5, 0.0, 28.0), (75.0, -1.0, 30.0))


def test_the_header_of_a_list_names_the_light_of_its_colours(tmp_path):
    path = tmp_path / "colours.csv"
    path.write_text("name,L* (D50/2),a* (D50/2),b* (D50/2),gloss_60\nred,42,55,30,20 \n")
    (one,) = read_colours(path, {})
    np.testing.assert_allclose(one.lab, lab_under_d65(np.array([42.0, 55.0, 30.0]), Viewing("D50", 2)))
    assert one.gloss == {60.0: 20.0}
    assert read_colours(path, {}, Viewing("D50", 2))[0].lab == one.lab
    with pytest.raises(
        UsageError, match="the file says D50/2, the options say A/2; leave --illuminant and --observer out"
    ):
        read_colours(path, {}, Viewing("A", 2))
    path.write_text("# Illuminant D50, observer 2\nname,L,a,b,gloss_60\nred,42,55,30,20 \n")
    assert read_colours(path, {})[0].lab == one.lab


def test_a_colour_under_another_light_is_converted_once(run, model, tmp_path):
    """With an RGB library, the colour that was converted already was taken as one under the other light again."""
    viewing = Viewing("A", 2)
    lab = lab_under_d65(np.array([50.0, 20.0, 10.0]), viewing)
    library = ("-L", model.library.path)
    assert (
        run("complete", "--lab", "50,20,10", "--illuminant", "A", *library, "-o", "a.bsdf", cwd=tmp_path)[0]
        == 0
    )
    assert run("complete", "--lab", ",".join(map(str, lab)), *library, "-o", "b.bsdf", cwd=tmp_path)[0] == 0
    found, expected = (read_bsdf(tmp_path / name).spectra for name in ("a.bsdf", "b.bsdf"))
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_colours_of_a_file_are_not_taken_under_another_light(run, model, tmp_path):
    (tmp_path / "lab.csv").write_text(
        "Geometry,L* (D65/10),a* (D65/10),b* (D65/10)\n45as45,50,20,10\n45as110,45,18,9\n"
    )
    arguments = ("complete", "lab.csv", "--illuminant", "A", "-L", model.library.path, "-o", "x.bsdf")
    code, _, error = run(*arguments, cwd=tmp_path)
    assert (code, "colours under D65/10, found A/10; leave --illuminant" in error) == (2, True)


def test_readings_under_another_light_are_compared_in_daylight(model):
    name = model.names[1]
    wi, wo = from_spherical(np.pi / 4, 0.0)[None], from_spherical(0.0, 0.0)[None]
    seen = Readings(
        "seen", "table", wi, wo, None, model.material(name).eval(wi, wo), viewing=Viewing("A", 10)
    )
    distance = {one.name: one.distance for one in find(model.library, seen)}
    daylight = {one.name: one.distance for one in find(model.library, in_daylight(seen))}
    assert distance == daylight
    assert distance[name] > 0.1


def test_what_looks_most_like_a_material_is_found(run, model, tmp_path):
    name = model.names[1]
    (first, second, *_) = find(model.library, model.material(name))
    assert (first.name, first.distance) == (name, pytest.approx(0.0, abs=1e-6))
    assert second.distance > 0.5
    library = model.library.path
    code, out, _ = run("find", name, "-L", library, "--count", "1", "--json", "-", cwd=tmp_path)
    assert (code, json.loads(out)["found"][0]["name"]) == (0, name)
    wi, wo = from_spherical(np.pi / 4, 0.0)[None], from_spherical(0.0, 0.0)[None]
    seen = Readings("seen", "table", wi, wo, None, model.material(name).eval(wi, wo))
    assert find(model.library, seen)[0].name == name
    assert run("find", name, "--lab", "50,0,0", "-L", library, cwd=tmp_path)[0] == 2


def test_notes_of_readings_stand_below_the_materials_like_them(run, model, tmp_path):
    (tmp_path / "few.csv").write_text("theta_i,theta_o,R,G,B\n45,0,0.8,0.8,0.8\n60,0,0.8,0.8,0.8\n")
    code, out, _ = run("find", "few.csv", "-L", model.library.path, "--json", "few.json", cwd=tmp_path)
    assert code == 0
    assert "taken as reflectance factors" in " ".join(out.split())
    content = json.loads((tmp_path / "few.json").read_text())
    assert any("(--unit brdf, factor or percent)" in note for note in content["notes"])
    assert {one["light"] for one in content["found"]} == {"D65/2"}
