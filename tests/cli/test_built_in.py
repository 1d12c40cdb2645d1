"""Commands without a library or model of the user's: they take the built-in ones if they only read."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest

import manifold as mf
from manifold.core import shipped
from manifold.core.errors import UsageError
from manifold.estimate.inputs import find_inputs
from manifold.estimate.sources import parse_source
from manifold.formats.recognition import Kind, kind_of
from manifold.library.store import Library
from manifold.model.model_file import read_model

NOTE = "manifold: no library.zarr or model.h5 here: using the built-in library, 20 measured materials in RGB"


@pytest.mark.parametrize(
    "command",
    [
        ("predict", "0.3,0.2", "-o", "made.bsdf"),
        ("find", "--lab", "50,20,10"),
        ("complete", "--lab", "50,20,10", "--gloss", "60=30", "-o", "made.bsdf"),
        ("locate", "paper_white"),
        ("reconstruct", "paper_white"),
        ("info",),
    ],
    ids=lambda command: command[0],
)
def test_a_command_that_reads_takes_the_built_in_library_and_says_so(run, tmp_path, command):
    status, out, err = run(*command, "--json", "made.json", cwd=tmp_path)
    assert status == 0, err
    assert err.count(NOTE) == 1
    assert out
    assert json.loads((tmp_path / "made.json").read_text())["library"] == shipped.named("built-in")
    assert not list(tmp_path.glob(".*"))  # no lock


@pytest.mark.parametrize(
    "command", [("embed",), ("import", "FILE"), ("compact",)], ids=lambda command: command[0]
)
def test_a_command_that_writes_does_not(run, tmp_path, command):
    file = tmp_path / "a_rgb.bsdf"
    mf.write_bsdf(file, Library("built-in").read("paper_white"))
    own = ("-L", "built-in") if command[0] == "import" else ()
    words = [str(file) if word == "FILE" else word for word in command]
    status, _, err = run(*words, *own, cwd=tmp_path)
    assert status != 0
    assert NOTE not in err
    assert [path.name for path in tmp_path.iterdir()] == [file.name]


def test_a_library_or_model_that_is_there_is_taken_instead(run, tmp_path):
    (tmp_path / "model.h5").write_bytes(b"not a model")
    status, _, err = run("predict", "0.3,0.2", cwd=tmp_path)
    assert status == 1
    assert "model.h5" in err
    assert NOTE not in err


def test_a_missing_library_that_was_named_is_an_error(run, tmp_path):
    status, _, err = run("find", "--lab", "50,20,10", "--library", "mine.zarr", cwd=tmp_path)
    assert status == 1
    assert "mine.zarr: no such library" in err


def test_files_need_no_library_and_have_no_note(run, tmp_path):
    mf.write_bsdf(tmp_path / "a_rgb.bsdf", Library("built-in").read("paper_white"))
    status, _, err = run("info", "a_rgb.bsdf", cwd=tmp_path)
    assert (status, err) == (0, "")


@pytest.mark.parametrize(
    "options", [("-M", "built-in"), ("-L", "built-in"), ("-M", "built-in", "-L", "built-in")]
)
def test_the_built_in_ones_can_be_named(run, tmp_path, options):
    status, _, err = run("predict", "0.3,0.2", "-o", "made.bsdf", *options, cwd=tmp_path)
    assert (status, err) == (0, "")


def test_info_shows_source_licence_citation_and_checksums(run, tmp_path):
    status, out, err = run("info", "built-in", "--verify", cwd=tmp_path)
    assert (status, err) == (0, "")
    for words in ("RGL material database", "CC0 1.0", "10.1145/3272127.3275059", "all hashes match"):
        assert words in " ".join(out.split())
    for checksum in shipped.about()["sha256"].values():
        assert checksum in out


@pytest.fixture
def own_files(tmp_path):
    """Return the files of own.zarr, whose model is own.h5."""
    files = [tmp_path / f"{name}_rgb.bsdf" for name in ("paper_white", "paper_blue", "cardboard")]
    for file in files:
        mf.write_bsdf(file, Library("built-in").read(file.stem.removesuffix("_rgb")))
    mf.import_files(tmp_path / "own.zarr", files)
    mf.Manifold.fit(tmp_path / "own.zarr", calibrate=False).save(tmp_path / "own.h5")
    return files


@pytest.mark.usefixtures("own_files")
def test_info_of_a_model_opens_the_library_of_the_model(run, tmp_path):
    status, out, err = run("info", "own.h5", cwd=tmp_path)
    assert (status, err) == (0, "")
    assert "own.zarr" in out


def test_a_given_model_is_used_with_its_own_library(run, tmp_path, own_files):
    mf.import_files(tmp_path / "library.zarr", own_files[:1])
    status, out, _ = run("find", "--lab", "60,0,0", "--model", "own.h5", cwd=tmp_path)
    assert status == 0
    assert "cardboard" in out
    status, out, _ = run("find", "--lab", "60,0,0", cwd=tmp_path)
    assert status == 0
    assert "cardboard" not in out


def test_the_built_in_map_is_that_of_the_built_in_library():
    model = mf.built_in()
    assert model.names == model.library.names == tuple(sorted(shipped.about()["materials"]))
    assert read_model(shipped.BUILT_IN).library == shipped.BUILT_IN
    assert model.notes == ()
    assert model.left_out is not None
    assert np.median(model.left_out.errors.ball) < 5.0


def test_a_model_of_the_built_in_library_names_it(tmp_path):
    fitted = mf.Manifold.fit(Library("built-in"), names=mf.built_in().names[:4], calibrate=False)
    (tmp_path / "folder").mkdir()
    fitted.save(tmp_path / "folder" / "model.h5")
    (tmp_path / "folder" / "model.h5").rename(tmp_path / "model.h5")
    assert read_model(tmp_path / "model.h5").library == shipped.BUILT_IN
    assert mf.Manifold.load(tmp_path / "model.h5").library.path == shipped.BUILT_IN


def test_that_of_another_version_is_refused():
    assert Library(shipped.named("built-in")).names
    for opened in (Library, mf.Manifold.load):
        with pytest.raises(UsageError, match="another version of manifold; this version contains built-in@"):
            opened("built-in@0123456789ab")


def test_a_pickled_built_in_library_keeps_its_name_and_hash():
    library = pickle.loads(pickle.dumps(Library("built-in")))
    assert library.content_hash == Library("built-in").content_hash
    assert shipped.named("built-in").encode() in pickle.dumps(library)


def test_a_source_called_built_in_lists_its_materials():
    source = parse_source("built-in", shipped.BUILT_IN)
    assert kind_of(source.path) is Kind.LIBRARY
    assert [each.name for each in find_inputs([source])] == list(Library("built-in").names)


def test_all_that_is_shipped_takes_less_than_a_megabyte():
    assert (
        sum(file.stat().st_size for file in (shipped.LIBRARY_FILE, shipped.MODEL_FILE, shipped.ABOUT_FILE))
        < 1e6
    )
