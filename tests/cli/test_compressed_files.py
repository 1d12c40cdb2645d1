"""RGL files that gzip compressed are taken wherever RGL files are, and paths are told apart in one place."""

from __future__ import annotations

import gzip
import json
import shutil
import tracemalloc

import numpy as np
import pytest
from helpers.small_library import NAMES, measured, small_model

from manifold.core.errors import FileFormatError
from manifold.formats import recognition
from manifold.formats.recognition import Kind, kind_of
from manifold.io_rgl import read_bsdf, write_bsdf
from manifold.model.model_file import read_model

NAME = NAMES[0]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A model, its library, and a material as it is (`plain`) and compressed (`packed`), in folders of their own."""
    path = tmp_path_factory.mktemp("compressed")
    small_model(path)
    for kind in ("plain", "packed"):
        (path / kind).mkdir()
    plain = path / "plain" / f"{NAME}_rgb.bsdf"
    write_bsdf(plain, measured(NAME))
    (path / "packed" / f"{NAME}_rgb.bsdf.gz").write_bytes(gzip.compress(plain.read_bytes(), 1))
    return path


@pytest.fixture
def packed(folder):
    return folder / "packed" / f"{NAME}_rgb.bsdf.gz"


def test_a_compressed_file_is_the_file(packed, folder):
    file, plain = read_bsdf(packed), read_bsdf(folder / "plain" / f"{NAME}_rgb.bsdf")
    assert file.name == plain.name == NAME
    np.testing.assert_array_equal(file.spectra, plain.spectra)
    np.testing.assert_array_equal(file.valid, plain.valid)


@pytest.mark.parametrize(
    "words",
    [
        ["info", "{file}"],
        ["import", "{file}", "--library", "one_{kind}.zarr"],
        ["import", "{kind}", "--library", "all_{kind}.zarr"],
        ["locate", "{file}"],
        ["reconstruct", "{file}", "-o", "reconstructed_{kind}.bsdf"],
        ["convert", "{file}", "-o", "{kind}.csv"],
        ["find", "{file}"],
        ["predict", "{file}", "-o", "predicted_{kind}.bsdf"],
    ],
    ids=lambda words: " ".join(words[:2]),
)
def test_commands_take_compressed_files(words, folder, run):
    said = {}
    for kind in ("plain", "packed"):
        file = next((folder / kind).iterdir())
        filled = [word.format(file=f"{kind}/{file.name}", kind=kind) for word in words]
        status, said[kind], error = run(*filled, "--json", "-", cwd=folder)
        assert status == 0, error
    results = [json.loads(said[kind].replace(kind, "KIND").replace(".bsdf.gz", ".bsdf")) for kind in said]
    for key in ("seconds", "size", "sha256"):
        for result in results:
            result.pop(key, None)
    assert results[0] == results[1]


def test_mitsuba_renders_compressed_files(packed, folder, run):
    pytest.importorskip("mitsuba")
    from manifold.render.ball import render_ball

    plain = render_ball(folder / "plain" / f"{NAME}_rgb.bsdf", size=16, samples=1)
    np.testing.assert_array_equal(render_ball(packed, size=16, samples=1), plain)
    pictures = ["render", str(packed), "--size", "16", "--samples", "1", "-o", "packed.png"]
    assert run(*pictures, cwd=folder)[0] == 0


@pytest.mark.parametrize(
    ("harm", "words"),
    [
        (lambda content: content[:-4] + (2**31 + 1).to_bytes(4, "little"), "expected at most"),
        (
            lambda content: content[:-4] + (100).to_bytes(4, "little"),
            "has a header cut off|ends beyond|cannot be decompressed",
        ),
        (lambda content: content[: len(content) // 2], "that it announces|expected|ends beyond"),
        (lambda content: content + content, "that it announces"),
        (
            lambda content: content[:5000] + bytes(100) + content[5100:],
            "cannot be decompressed|that it announces",
        ),
    ],
    ids=["too large", "smaller", "cut off", "twice", "damaged"],
)
def test_damaged_compressed_files_are_refused(harm, words, packed, tmp_path):
    path = tmp_path / "x.bsdf.gz"
    path.write_bytes(harm(packed.read_bytes()))
    with pytest.raises(FileFormatError, match=rf"x\.bsdf\.gz: .*({words})"):
        read_bsdf(path)


def test_a_file_of_unused_bytes_is_refused_before_it_is_expanded(packed, tmp_path):
    padded = tmp_path / "x_rgb.bsdf.gz"
    padded.write_bytes(gzip.compress(gzip.decompress(packed.read_bytes()) + bytes(64 << 20), 1))
    assert _refused_with_peak(padded, r"\d+ bytes that belong to no field") < 8 << 20


def test_a_file_that_expands_beyond_what_it_announces_takes_no_more_memory(packed, tmp_path):
    plain = gzip.decompress(packed.read_bytes())
    path = tmp_path / "x.bsdf.gz"
    content = gzip.compress(plain + bytes(64 << 20), 1)
    path.write_bytes(content[:-4] + len(plain).to_bytes(4, "little"))
    assert _refused_with_peak(path, "that it announces") < 8 << 20


def _refused_with_peak(path, words):
    """Return the peak of memory in bytes while a file is refused."""
    tracemalloc.start()
    try:
        with pytest.raises(FileFormatError, match=words):
            read_bsdf(path)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_what_a_path_is(folder, packed, tmp_path):
    from PIL import Image

    Image.new("RGB", (4, 4)).save(tmp_path / "a.png")
    (tmp_path / "readings.csv").write_text("theta_i,theta_o,550 nm\n45,0,0.2\n45,30,0.1\n")
    (tmp_path / "notes.md").write_text((tmp_path / "readings.csv").read_text())
    (tmp_path / "a.fit.json").write_text("{}")
    (tmp_path / "damaged.bsdf").write_text("no")
    shutil.copy(packed, tmp_path / "nameless")
    shutil.copy(folder / "model.h5", tmp_path / "model.bin")
    (tmp_path / "packed.csv.gz").write_bytes(gzip.compress(b"a,b\n"))
    kinds = {
        folder / "library.zarr": Kind.LIBRARY, tmp_path: Kind.FOLDER, packed: Kind.RGL,
        tmp_path / "nameless": Kind.RGL, tmp_path / "damaged.bsdf": Kind.RGL, tmp_path / "model.bin": Kind.MODEL,
        tmp_path / "a.fit.json": Kind.FIT, tmp_path / "readings.csv": Kind.READINGS, tmp_path / "a.png": Kind.PICTURE,
        tmp_path / "notes.md": Kind.OTHER, tmp_path / "packed.csv.gz": Kind.OTHER, tmp_path / "none": Kind.NOTHING,
    }  # fmt: skip
    assert {path: kind_of(path) for path in kinds} == kinds
    assert not recognition.is_rgl(tmp_path / "packed.csv.gz")
    assert read_model(tmp_path / "model.bin").names
