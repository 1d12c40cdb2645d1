"""A material is named by its file, by its name in a library, or by a place on a map, in every command."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from helpers.small_library import NAMES, small_model

from manifold.analytic.base import Lambert
from manifold.analytic.virtual_instruments import MA_T12_BANDS, write_ma_t12
from manifold.brdf import physical
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import mirror_difference
from manifold.brdf.unmeasured_cells import fill_unmeasured
from manifold.core.errors import MissingFileError, MissingModelError, UnknownNameError
from manifold.core.names import percent
from manifold.estimate import completions, descriptions, predictions
from manifold.estimate.attributes import readings_of_colour
from manifold.estimate.gloss import gloss_units
from manifold.estimate.source_files import read_source, source_file
from manifold.estimate.sources import FileSource, LibrarySource, PlaceSource, parse_source
from manifold.formats import registry
from manifold.formats.readings import GLOSS_ANGLES_DEG
from manifold.gp.encoding import encoding_pairs
from manifold.io_rgl import read_bsdf, write_bsdf
from manifold.library.store import Library
from manifold.model import diagnostics
from manifold.model.comparison import brdf_errors
from manifold.model.manifold import Manifold
from manifold.model.output_file import OutputOptions
from manifold.model.settings import GplvmSettings
from manifold.pictures import map_figure
from manifold.pictures.renders import ball_material

NAME, OTHER = NAMES[:2]
FILE = f"files/{NAME}_rgb.bsdf"
PLACE, STEP = "-0.1,0.2", f"{NAME}:{OTHER}:0.5"
MATERIALS = (FILE, NAME, PLACE, STEP)
SMALL = ("--size", "16", "--samples", "1")

pytestmark = pytest.mark.usefixtures("quick_pictures")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """`files/`, `library.zarr` and `model.h5`."""
    return small_model(tmp_path_factory.mktemp("sources")).parent


def test_a_text_is_a_file_then_a_name_then_a_place(folder, monkeypatch):
    monkeypatch.chdir(folder)
    model = folder / "model.h5"
    (folder / OTHER).mkdir(exist_ok=True)  # a folder of that name hides no material
    kinds = [type(parse_source(text, model)) for text in (*MATERIALS, OTHER, "files")]
    assert kinds == [FileSource, LibrarySource, PlaceSource, PlaceSource, LibrarySource, FileSource]
    (folder / NAME).write_bytes(b"a file")
    assert parse_source(NAME, model) == FileSource(parse_source(FILE, model).path.parent.parent / NAME)
    (folder / NAME).unlink()


def test_what_a_text_cannot_mean_is_said_in_one_line(folder):
    model = folder / "model.h5"
    with pytest.raises(
        UnknownNameError, match=r"neither a file, nor a material of library\.zarr \(did you mean syn_felt"
    ):
        parse_source("syn_felt_gren", model)
    for text in ("none.bsdf", "folder/none"):
        with pytest.raises(MissingFileError, match=f"{text}: no such file"):
            parse_source(text, model)
    with pytest.raises(MissingModelError, match=r"none\.h5: no such model"):
        parse_source("felt", folder / "none.h5")


def test_a_material_of_a_library_is_its_file(folder):
    library = folder / "library.zarr"
    source = LibrarySource(library, NAME)
    file, original = read_source(source), read_bsdf(folder / FILE)
    assert (file.name, file.description) == (original.name, original.description)
    assert (file.spectra == original.spectra).all()
    with source_file(source) as path:
        assert read_bsdf(path).name == NAME
    assert not path.exists()


@pytest.mark.parametrize(
    ("command", "made"),
    [
        (("slices", PLACE), "slices.png"),
        (("locate", NAME, "-o", "located.bsdf"), "located.bsdf"),
        (("reconstruct", STEP, "--without", NAME), "reconstructed.bsdf"),
        (("predict", NAME), "predicted.bsdf"),
        (("info", PLACE, "--json", "info.json"), "info.json"),
        (
            ("convert", STEP, "-o", "converted.bsdf", "--resolution", "8", "--incidences", "4"),
            "converted.bsdf",
        ),
        (("render", NAME, *SMALL), "render.png"),
        (("compare", STEP, FILE, *SMALL), "comparison.png"),
        (("fit", PLACE, "--free", "roughness", "-o", "one.fit.json"), "one.fit.json"),
        (("export", STEP, "-o", "one.glb"), "one.glb"),
        (("walk", OTHER, FILE, "--steps", "3"), "walk.png"),
        (("map", "--mark", PLACE), "map.png"),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else "",
)
def test_every_command_takes_a_material_by_any_name(run, folder, command, made):
    """The kinds by turns: one function reads them for all commands."""
    if command[0] in ("render", "compare", "walk", "map"):
        pytest.importorskip("mitsuba")
    status, _, err = run(*command, cwd=folder)
    assert (status, err) == (0, "")
    assert (folder / made).is_file()


@pytest.fixture(scope="module")
def negative(folder):
    """A Gaussian process on values as they are, and a place where a good part of its values is negative."""
    model = Manifold.fit(folder / "library.zarr", GplvmSettings(mapping="identity"), calibrate=False)
    model.save(folder / "process.h5")
    grid = encoding_pairs()
    places = model.X[:, None] * 0.5 + model.X[None] * 0.5
    shares = [
        np.mean(model.predict(x).eval(grid.wi, grid.wo) < 0.0) for x in places.reshape(-1, model.X.shape[1])
    ]
    x = places.reshape(-1, model.X.shape[1])[int(np.argmax(shares))]
    assert max(shares) > 0.05
    return ",".join(repr(float(v)) for v in x)


@pytest.mark.parametrize(
    ("command", "made"),
    [
        (("predict",), "n.bsdf"),
        (("render", *SMALL), "n.png"),
        (("render", *SMALL, "--from"), "n"),
        (("predict", "--resolution", "8", "--from"), "n"),
        (("convert",), "n.csv"),
        (("export",), "n.glb"),
        (("fit", "--free", "roughness"), "n.json"),
        (("slices",), "n.svg"),
        (("compare", FILE, *SMALL), "n.svg"),
        (("map", "--mark"), "n.svg"),
    ],
    ids=lambda value: "_".join(word for word in value if word.isalpha() or word == "--from")
    if isinstance(value, tuple) else "",
)  # fmt: skip
def test_every_command_says_what_speaks_against_a_prediction(run, folder, negative, command, made):
    if command[0] in ("render", "compare", "map", "export", "fit"):
        pytest.importorskip("mitsuba")
    place = negative
    if command[-1] == "--from":
        (folder / "points.csv").write_text(f"latent;name\n{negative.replace(',', ' ')};a\n")
        place = "points.csv"
    name = command[0] + made
    status, shown, err = run(*command, place, "-M", "process.h5", "-o", name, cwd=folder)
    assert status == 0, err
    if command[-1] == "--from":
        shown = (folder / name / f"{command[0]}s.csv".replace("predicts", "predictions")).read_text()
    assert "of the values were negative" in " ".join(shown.split())


def test_a_file_that_is_predicted_keeps_its_own_values(run, folder):
    status, out, _ = run("predict", FILE, "-o", "own.bsdf", "--json", "own.json", cwd=folder)
    assert status == 0
    assert out.splitlines()[1].split()[:3:2] == ["difference", "CIEDE2000"]
    made = json.loads((folder / "own.json").read_text())
    assert (made["own"], made["latent"], made["expected"]) == (FILE, None, None)
    assert made["change"]["ball"] == 0.0
    own, source = (read_bsdf(folder / name) for name in ("own.bsdf", FILE))
    np.testing.assert_array_equal(own.spectra, source.spectra)
    assert run("predict", FILE, "-o", "own.bsdf", "--physical", "--json", "own.json", cwd=folder)[0] == 0
    own, source = (MeasuredBRDF(read_bsdf(folder / name)) for name in ("own.bsdf", FILE))
    made = json.loads((folder / "own.json").read_text())
    assert made["change"]["ball"] == pytest.approx(brdf_errors(source, own).ball, rel=0.1)  # unmeasured cells
    assert 0.0 < made["change"]["ball"] < 1.0


def test_a_file_with_another_hue_is_that_file_recoloured(run, folder):
    arguments = ("predict", FILE, "-o", "hue.bsdf", "--json", "hue.json", "--resolution", "8")
    assert run(*arguments, "--hue", "+0", cwd=folder)[0] == 0
    assert json.loads((folder / "hue.json").read_text())["change"]["ball"] < 1.0
    assert run(*arguments, "--like", OTHER, cwd=folder)[0] == 0
    by_name = read_bsdf(folder / "hue.bsdf").spectra
    write_bsdf(folder / "other.bsdf", Library(folder / "library.zarr").read(OTHER))
    assert run(*arguments, "--like", "other.bsdf", cwd=folder)[0] == 0
    np.testing.assert_allclose(read_bsdf(folder / "hue.bsdf").spectra, by_name, rtol=0.02, atol=1e-3)
    status, _, err = run(*arguments, "--like", "none.bsdf", cwd=folder)
    assert status == 1
    assert "none.bsdf" in err


def test_readings_lead_to_what_makes_a_material_of_them(run, folder, rng):
    paper = Lambert(np.full(MA_T12_BANDS.count, 0.5), MA_T12_BANDS)
    write_ma_t12(folder / "sample.xlsx", paper, "sample", rng)
    for command in (
        ("import", "sample.xlsx"),
        ("render", "sample.xlsx"),
        ("convert", "sample.xlsx", "-o", "s.bsdf"),
    ):
        status, _, err = run(*command, cwd=folder)
        assert status in (1, 2)
        assert "`manifold complete`" in err, command


def test_several_kinds_are_fitted_into_one_folder(run, folder):
    pytest.importorskip("mitsuba")
    status, _, err = run(
        "fit", OTHER, "0.1,0.2", "--free", "roughness", "-o", "fits", "--json", "fits.json", cwd=folder
    )
    assert (status, err) == (0, "")
    assert {path.name for path in (folder / "fits").glob("*.fit.json")} == {
        f"{OTHER}.fit.json",
        "0.1,0.2.fit.json",
    }
    sources = [made["source"] for made in json.loads((folder / "fits.json").read_text())["fits"]]
    info = Library(folder / "library.zarr").attributes(OTHER)
    assert (sources[0]["file"], sources[0]["sha256"]) == (info.source_file, info.sha256)
    assert sources[1]["latent"] == [0.1, 0.2]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("render",), "no material is given; give one"),
        (("render", NAME, "--like", OTHER), "--like, --reflectance and --srgb work only with predictions"),
        (("compare", "0,0", "syn_felt_gren"), "did you mean"),
        (("export", "0,0", "-o", "x.glb", "--against", FILE), "works only with the JSON of a fit"),
        (("fit",), "no material is given"),
    ],
)
def test_what_cannot_be_followed_is_refused(run, folder, arguments, words):
    status, out, err = run(*arguments, cwd=folder)
    assert (status, out) == (2, "")
    assert words in " ".join(err.split())


@pytest.mark.parametrize("command", ["locate", "reconstruct"])
def test_a_refused_output_loses_neither_place_nor_errors(run, folder, monkeypatch, command):
    monkeypatch.setattr(diagnostics, "MOST_ALBEDO", 0.01)
    strict = ("--strict", "-o", "bright.bsdf", "--json", "found.json")
    status, out, err = run(command, FILE, *strict, cwd=folder)
    assert (status, (folder / "bright.bsdf").exists()) == (1, False)
    assert "bright.bsdf: would have an albedo of" in " ".join(err.split())
    assert "reconstruction error" in out
    assert "written to" not in out
    found = json.loads((folder / "found.json").read_text())
    assert found["path"] is None
    assert found["refusal"] in " ".join(err.split())
    assert found["errors"]["ball"] >= 0.0
    assert command == "reconstruct" or len(found["latent"]) == 2
    status, out, err = run(command, FILE, "-o", "bright.bsdf", cwd=folder)
    assert (status, err, (folder / "bright.bsdf").exists()) == (0, "", True)
    assert re.search(r"albedo (\S+) at \d+ degrees; the measured file has \d", " ".join(out.split()))
    (folder / "bright.bsdf").unlink()


@pytest.mark.parametrize("command", [("predict", "0.1,0.2"), ("locate", FILE), ("reconstruct", FILE)])
def test_a_projected_file_says_what_the_projection_changed(run, folder, command):
    status, out, err = run(*command, "--physical", "-o", "physical.bsdf", cwd=folder)
    assert (status, err) == (0, "")
    assert "made physical: largest albedo" in " ".join(out.split())


def test_errors_of_a_projected_file_are_those_of_what_was_written(folder, monkeypatch):
    monkeypatch.setattr(physical, "RECIPROCITY_ERROR", 0.001)  # so that the projection changes something
    options, library = OutputOptions(physical=True, resolution=16, incidences=4), folder / "library.zarr"
    path = folder / "projected.bsdf"
    made = descriptions.reconstruct(library, folder / FILE, path, without=[NAME], options=options)
    measured = MeasuredBRDF(fill_unmeasured(read_bsdf(folder / FILE)))
    assert made.errors == brdf_errors(measured, MeasuredBRDF(read_bsdf(path)))
    assert made.errors != brdf_errors(measured, made.brdf)
    readings = readings_of_colour(np.array([50.0, 20.0, 10.0]), {60.0: 40.0}, Library(library).bands)
    completed = completions.complete(library, readings, path, options=options)
    written, found = MeasuredBRDF(read_bsdf(path)), completed.completion
    np.testing.assert_array_equal(found.predicted, written.eval(found.readings.wi, found.readings.wo))
    assert found.gloss == gloss_units(written, GLOSS_ANGLES_DEG)
    assert completed.residual == found.residual_of_readings


def test_converting_a_place_evaluates_the_prediction_not_its_sampled_file(run, folder):
    status, _, err = run("convert", "0.1,0.2", "-o", "place.csv", cwd=folder)
    assert (status, err) == (0, "")
    read = registry.read_readings(folder / "place.csv", None)
    predicted = Manifold.load(folder / "model.h5").predict(np.array([0.1, 0.2]))
    expected = np.maximum(predicted.eval(read.wi, read.wo), 0.0)
    high = read.wo[:, 2] > np.sin(np.deg2rad(2.1))  # below, tables have the value at two degrees
    assert np.mean(high) > 0.9
    np.testing.assert_allclose(read.values[high], expected[high], rtol=1e-4, atol=1e-7)  # digits of both
    made = predictions.predict(folder / "model.h5", "0.1,0.2", folder / "place.bsdf")
    file = MeasuredBRDF(read_bsdf(folder / "place.bsdf"))
    assert np.abs(file.eval(read.wi, read.wo) / expected - 1.0).max() > 0.01
    assert made.mirror_difference == pytest.approx(mirror_difference(predicted, file))
    most = percent(made.mirror_difference, 1)
    words = f"differs from the prediction by at most {most} within 5 degrees of mirror directions"
    assert made.rows["file"] == words
    for made_for_it in (source_file, ball_material):  # of other commands, and of renders
        with made_for_it(PlaceSource(folder / "model.h5", "0.1,0.2")) as found:
            path = found if made_for_it is source_file else Path(found[0].bsdf["filename"])
            assert mirror_difference(predicted, MeasuredBRDF(read_bsdf(path))) < 0.5 * made.mirror_difference


def test_files_that_were_not_measured_are_not_called_measured(run, folder):
    pytest.importorskip("mitsuba")
    for command, origin in {
        ("predict", "0.1,0.2"): "predicted",
        ("reconstruct", FILE): "reconstructed",
        ("complete", "--lab", "50,20,10", "--gloss", "60=40", "--mixture"): "completed",
    }.items():
        assert run(*command, "-o", f"{origin}.bsdf", cwd=folder)[0] == 0
        file = f"{origin}.bsdf"
        commands = (("info", file), ("render", file, *SMALL), ("slices", file))
        shown = "".join(run(*words, cwd=folder)[1] for words in commands)
        assert shown.count(origin) >= 3, shown
        assert "measured file" not in shown
    (folder / "predicted.bsdf").rename(folder / "between.bsdf")
    assert run("import", FILE, f"files/{OTHER}_rgb.bsdf", "between.bsdf", "-L", "L", cwd=folder)[0] == 0
    assert "1 of them predicted" in run("info", "L", cwd=folder)[1]
    model = Manifold.fit(folder / "L", calibrate=False)
    assert map_figure.material_labels(model)[0] == "between (predicted)"
