"""Latents as people give them: by coordinates as they are printed, and by the names of materials."""

from __future__ import annotations

import re

import numpy as np
import pytest
from helpers.small_library import NAMES, small_library

from manifold.colour import ball_colours
from manifold.convert.contents import inspect
from manifold.core.errors import LatentError, UnknownNameError, UsageError
from manifold.estimate.descriptions import locate
from manifold.estimate.predictions import predict
from manifold.library.importing import import_files
from manifold.library.store import Library
from manifold.model.colours import ColourChoice
from manifold.model.diagnostics import predict_and_diagnose
from manifold.model.manifold import Manifold
from manifold.model.output_file import OutputOptions
from manifold.model.places import parse_walk
from manifold.model.settings import KINDS
from manifold.pictures import maps

MOST = 0.5  # CIEDE2000: half of what is noticed side by side


@pytest.fixture(scope="module", params=KINDS)
def model(request, tmp_path_factory):
    """The path of a model of each kind, its library beside it."""
    folder = tmp_path_factory.mktemp(request.param)
    library = Library.open(small_library(folder))
    Manifold.fit(library, KINDS[request.param]()).save(folder / "model.h5")
    return folder / "model.h5"


def distance(a, b):
    """Mean CIEDE2000 between the balls of two BRDFs."""
    ball = ball_colours.ball(6)
    return ball_colours.delta_e(*(ball.xyz(f.eval(ball.wi, ball.wo), f.bands) for f in (a, b)))


def test_the_coordinates_that_info_prints_give_the_materials_back(model):
    loaded = Manifold.load(model)
    ((_, rows),) = inspect(model).tables
    for name, *coordinates in rows:
        brdf = loaded.predict(",".join(coordinates[: loaded.X.shape[1]]))
        assert distance(brdf, loaded.material(name)) <= MOST


def test_the_coordinates_that_predict_and_locate_print_give_the_prediction_back(model, tmp_path):
    loaded = Manifold.load(model)
    file = model.parent / "files" / f"{NAMES[2]}_rgb.bsdf"
    located = locate(loaded, str(file))
    np.testing.assert_array_equal(locate(str(model), file).latent, located.latent)
    x = loaded.X.mean(axis=0) + 0.012345678
    made = predict(str(model), x, str(tmp_path / "middle.bsdf"), options=OutputOptions(resolution=8))
    for latent, coordinates in ((located.latent, located.coordinates), (x, made.coordinates)):
        printed = ",".join(coordinates)
        assert distance(loaded.predict(printed), loaded.predict(np.array(latent))) <= MOST


def test_a_printed_latent_makes_the_material_again_and_a_step_of_a_walk_has_none(model):
    loaded, (a, b) = Manifold.load(model), NAMES[:2]
    for text in (f"{a}:{b}:0.5", f"{a}:{b}:0", f"{a}:{b}:1", f"{a}:{a}:0.3", a, "0.1,0.2"):
        made = predict_and_diagnose(loaded, text)
        if text == f"{a}:{b}:0.5":
            assert (made.latent, made.coordinates, made.expected, made.nearest) == (None, (), None, [])
            assert made.walk == f"between {a} and {b}, t = 0.5"
            assert made.rows["expected error"] == ("none: a step of a walk has no point on the map",)
            assert made.to_json()["latent"] is None
            assert distance(made.brdf, loaded.predict(loaded.between(a, b, 0.5))) > 1.0  # another material
        else:
            assert made.walk is None
            assert distance(made.brdf, loaded.predict(made.latent)) == 0.0


def test_in_a_chosen_colour_a_step_is_the_place_between_the_two(model):
    loaded, step = Manifold.load(model), f"{NAMES[0]}:{NAMES[1]}:0.5"
    if not loaded.space.takes_colours:
        pytest.skip("latents fix the colours of this kind")
    made = predict_and_diagnose(loaded, step, ColourChoice(srgb="#3366aa"))
    colours = loaded.choose_colour(made.latent, ColourChoice(srgb="#3366aa")).colours
    assert made.walk is None
    assert made.expected is not None
    assert distance(made.brdf, loaded.predict(made.latent, colours)) == 0.0


def test_a_step_of_a_walk_cannot_be_marked_on_the_map(model, tmp_path):
    with pytest.raises(UsageError, match="has no point on the map"):
        maps.latent_map(model, tmp_path / "map.png", marked=f"{NAMES[0]}:{NAMES[1]}:0.5")


def test_a_material_is_a_latent_by_its_name(model):
    loaded, name = Manifold.load(model), NAMES[1]
    np.testing.assert_array_equal(loaded.place(name).latent, loaded.latent(name))
    (source,) = maps.sources([maps.PlaceSource(model, name)])
    assert distance(source.brdf, loaded.material(name)) == 0.0
    with pytest.raises(UsageError, match="did you mean syn_felt_green"):
        loaded.place("syn_felt_gren")


NO_PLACE = "nor coordinates such as -0.3,1.2, nor FROM:TO:T between two materials"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        *((text, NO_PLACE) for text in ("a,b", "1,x", "", "0.1;0.2", "0.1 2e-3", "nan 1", "-")),
        *((text, "expected finite") for text in ("0,nan", "inf,1")),
        *((text, "expected 2") for text in ("1", "1,2,3")),
        (f"{NAMES[0]}:{NAMES[1]}:1.5", "found '1.5' after two materials, expected a number from 0 to 1"),
        (f"{NAMES[0]}:{NAMES[1]}:half", "found 'half'"),
        (f"{NAMES[0]}:syn_felt_gren:0.5", "did you mean syn_felt_green"),
    ],
)
def test_texts_that_are_no_place_are_refused(model, text, words):
    with pytest.raises((UsageError, LatentError), match=re.escape(words)):
        Manifold.load(model).place(text)


def test_names_are_places_for_weights_and_errors_too(model):
    loaded, name = Manifold.load(model), NAMES[1]
    for ask in (loaded.weights, loaded.std, loaded.is_extrapolation):
        np.testing.assert_array_equal(ask(name), ask(loaded.latent(name)))
    assert loaded.expected_error(name).ball == loaded.expected_error(loaded.latent(name)).ball
    halfway = f"{NAMES[0]}:{NAMES[1]}:0.5"
    np.testing.assert_array_equal(loaded.weights(halfway), loaded.weights(loaded.between(*NAMES[:2], 0.5)))


def test_latents_of_a_model_cannot_be_written_to(model):
    loaded = Manifold.load(model)
    with pytest.raises(ValueError, match="read-only"):
        loaded.X[0] = 0.0
    fitted = Manifold.fit(loaded.library, loaded.settings, calibrate=False)
    with pytest.raises(ValueError, match="read-only"):
        fitted.X[:] += 1.0


def test_what_is_missing_is_also_the_error_that_python_raises(model, tmp_path):
    with pytest.raises(KeyError):
        Manifold.load(model).material("no such material")
    for open_missing in (Library.open, Manifold.load):
        with pytest.raises(FileNotFoundError):
            open_missing(tmp_path / "missing")


def test_an_embedded_material_says_what_it_is_in_a_line(model):
    loaded = Manifold.load(model)
    said = repr(loaded.embed(loaded.material(NAMES[0])))
    assert said.startswith("<Embedded: latent (")
    assert "\n" not in said


@pytest.mark.parametrize("x", [["a", "b"], [[0, 1], [2]], [{}, 0]])
def test_latents_that_are_no_numbers_are_told_so(model, x):
    loaded = Manifold.load(model)
    for ask in (loaded.predict, loaded.weights):
        with pytest.raises(LatentError, match=r"latent \[.*: expected numbers"):
            ask(x)


@pytest.mark.parametrize("t", [-0.1, 1.5, float("nan")])
def test_a_place_between_two_materials_is_between_them(model, t):
    loaded = Manifold.load(model)
    for ask in (loaded.between, loaded.interpolate):
        with pytest.raises(UsageError, match=f"t = {t:g}, expected a number from 0"):
            ask(*NAMES[:2], t)


def test_several_t_or_an_index_instead_of_a_name_are_told_so(model):
    loaded = Manifold.load(model)
    for ask in (loaded.between, loaded.interpolate):
        for t in ([0.0, 0.5], np.array([0.0, 0.5]), "0.5"):
            with pytest.raises(UsageError, match=r"t = a value of type .*, expected a number from 0"):
                ask(*NAMES[:2], t)
    with pytest.raises(UnknownNameError, match="no material '0' in this model"):
        loaded.material(0)


def test_a_material_whose_name_reads_as_coordinates_is_that_material(tmp_path):
    files = small_library(tmp_path).parent / "files"
    for name, path in zip(("0,0", "4711", "blue, matt"), sorted(files.glob("*.bsdf")), strict=False):
        path.rename(files / f"{name}_rgb.bsdf")
    import_files(tmp_path / "numbers.zarr", [files])
    named = Manifold.fit(tmp_path / "numbers.zarr", calibrate=False)
    for name in ("0,0", "4711", "blue, matt"):
        np.testing.assert_array_equal(named.place(name).latent, named.latent(name))
    np.testing.assert_array_equal(named.place("0, 0").latent, [0.0, 0.0])
    assert not np.array_equal(named.latent("0,0"), [0.0, 0.0])


@pytest.mark.parametrize(
    ("text", "names", "expected"),
    [
        ("a:b:0.5", {"a", "b"}, ("a", "b", 0.5)),
        ("lab:red:lab:blue:1e-3", {"lab:red", "lab:blue", "lab"}, ("lab:red", "lab:blue", 0.001)),
        ("red:lab:blue:1", {"red", "lab:blue"}, ("red", "lab:blue", 1.0)),
        ("3:a, b:0", {"3", "a, b"}, ("3", "a, b", 0.0)),
        ("a:b:0.5", {"a", "b", "a:b:0.5"}, None),
        ("lab:red:matt", {"lab:red:mat"}, None),
        ("a:0.5", {"a"}, None),
    ],
)
def test_a_path_is_between_any_two_names(text, names, expected):
    assert parse_walk(text, names) == expected


def test_a_path_that_could_be_two_is_refused():
    with pytest.raises(UsageError, match="from 'a' to 'b:c', and from 'a:b' to 'c'"):
        parse_walk("a:b:c:0.5", {"a", "b:c", "a:b", "c"})
