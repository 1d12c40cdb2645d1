"""Latents as people give them: by coordinates as they are printed, and by the names of materials."""

from __future__ import annotations

import numpy as np
import pytest
from small_library import NAMES, small_library

from manifold.colour import ball_colours
from manifold.errors import LatentError, UsageError
from manifold.library import Library, import_files
from manifold.model.latents import on_path
from manifold.model.located import locate
from manifold.model.manifold import Manifold
from manifold.model.predicted_file import predict
from manifold.model.settings import KINDS, Settings
from manifold.workflows import pictures
from manifold.workflows.inspection import inspect

MOST = 0.5  # CIEDE2000: half of what is noticed side by side


@pytest.fixture(scope="module", params=KINDS)
def model(request, tmp_path_factory):
    """The path of a model of each kind, its library beside it."""
    folder = tmp_path_factory.mktemp(request.param)
    library = Library.open(small_library(folder))
    Manifold.fit(library, Settings(kind=request.param)).save(folder / "model.h5")
    return folder / "model.h5"


def distance(a, b):
    """Mean CIEDE2000 between the balls of two BRDFs."""
    ball = ball_colours.ball(6)
    return ball_colours.delta_e(*(ball.xyz(f.eval(ball.wi, ball.wo), f.bands) for f in (a, b)))


def test_the_coordinates_that_info_prints_give_the_materials_back(model):
    loaded = Manifold.load(model)
    (table,) = inspect(model).tables
    for name, *coordinates in table.rows:
        brdf = loaded.predict(loaded.require_latent(",".join(coordinates)))
        assert distance(brdf, loaded.material(name)) <= MOST


def test_the_coordinates_that_predict_and_locate_print_give_the_prediction_back(model, tmp_path):
    loaded = Manifold.load(model)
    file = model.parent / "files" / f"{NAMES[2]}_rgb.bsdf"
    located = locate(loaded, str(file))
    assert locate(str(model), file).latent == located.latent
    x = loaded.X.mean(axis=0) + 0.012345678
    made = predict(str(model), x, str(tmp_path / "middle.bsdf"), resolution=8)
    for latent, coordinates in ((located.latent, located.coordinates), (x, made.coordinates)):
        printed = ",".join(coordinates)
        assert distance(loaded.predict(printed), loaded.predict(np.array(latent))) <= MOST


def test_a_material_is_a_latent_by_its_name(model):
    loaded, name = Manifold.load(model), NAMES[1]
    np.testing.assert_array_equal(loaded.require_latent(name), loaded.latent(name))
    (source,) = pictures.sources([], [name], model)
    assert distance(source.brdf, loaded.material(name)) == 0.0
    with pytest.raises(UsageError, match="did you mean syn_felt_green"):
        loaded.require_latent("syn_felt_gren")
    with pytest.raises(LatentError, match=r"latents of shape \(3, 2\), expected one, \(2,\)"):
        loaded.predict(np.zeros((3, 2)))


@pytest.mark.parametrize("text", ["a,b", "1,x", "", "0.1;0.2", "0.1 2e-3", "nan 1", " ", "-"])
def test_what_is_neither_numbers_nor_a_name_is_refused(model, text):
    with pytest.raises(
        UsageError, match=r"expected one, or numbers separated by commas, like -0\.3,1\.2, or FROM:TO:T"
    ):
        Manifold.load(model).require_latent(text)


def test_names_are_places_for_weights_and_errors_too(model):
    loaded, name = Manifold.load(model), NAMES[1]
    loaded.calibrate()
    for ask in (loaded.weights, loaded.std, loaded.is_extrapolation):
        np.testing.assert_array_equal(ask(name), ask(loaded.latent(name)))
    assert loaded.expected_error(name).ball == loaded.expected_error(loaded.latent(name)).ball
    halfway = f"{NAMES[0]}:{NAMES[1]}:0.5"
    np.testing.assert_array_equal(loaded.weights(halfway), loaded.weights(loaded.between(*NAMES[:2], 0.5)))


@pytest.mark.parametrize("x", [["a", "b"], [[0, 1], [2]], [{}, 0]])
def test_latents_that_are_no_numbers_are_told_so(model, x):
    loaded = Manifold.load(model)
    for ask in (loaded.predict, loaded.weights):
        with pytest.raises(LatentError, match=r"latent \[.*: expected numbers"):
            ask(x)


@pytest.mark.parametrize("t", [-0.1, 1.5, float("nan")])
def test_a_place_between_two_materials_is_between_them(model, t):
    loaded = Manifold.load(model)
    for ask in (loaded.between, loaded.interpolate, loaded.blend):
        with pytest.raises(UsageError, match=f"t = {t:g}, expected a number from 0"):
            ask(*NAMES[:2], t)


def test_parts_of_a_model_say_what_they_are_in_a_line(model):
    loaded = Manifold.load(model)
    parts = [loaded, loaded.space, loaded.materials]
    if loaded.space.takes_colours:
        parts.append(loaded.colours)
    for part in parts:
        said = repr(part)
        assert said.startswith(f"<{type(part).__name__}: ")
        assert "6 materials" in said
        assert len(said) < 200


@pytest.mark.parametrize("text", ["0,nan", "inf,1", "1", "1,2,3"])
def test_coordinates_as_text_are_finite_and_as_many_as_dimensions(model, text):
    with pytest.raises(LatentError, match=r"expected (finite|2)"):
        Manifold.load(model).require_latent(text)


def test_a_material_whose_name_reads_as_coordinates_is_that_material(tmp_path):
    files = small_library(tmp_path).parent / "files"
    for name, path in zip(("0,0", "4711", "blue, matt"), sorted(files.glob("*.bsdf")), strict=False):
        path.rename(files / f"{name}_rgb.bsdf")
    import_files(tmp_path / "numbers.zarr", [files])
    named = Manifold.fit(tmp_path / "numbers.zarr")
    for name in ("0,0", "4711", "blue, matt"):
        np.testing.assert_array_equal(named.require_latent(name), named.latent(name))
    np.testing.assert_array_equal(named.require_latent("0, 0"), [0.0, 0.0])
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
    assert on_path(text, names) == expected


def test_a_path_that_could_be_two_is_refused():
    with pytest.raises(UsageError, match="from 'a' to 'b:c', and from 'a:b' to 'c'"):
        on_path("a:b:c:0.5", {"a", "b:c", "a:b", "c"})
