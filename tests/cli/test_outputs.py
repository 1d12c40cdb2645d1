"""What commands write over, and what they leave alone."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from helpers.small_library import NAMES, small_model
from rich.cells import cell_len
from test_cli import one_line

from manifold.cli import batch_options, terminal


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """`files/`, `library.zarr` and `model.h5`."""
    return small_model(tmp_path_factory.mktemp("outputs")).parent


def _content(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_columns_of_a_table_are_straight_whatever_script_its_cells_are_in(capsys):
    terminal.Results().table(["material", "error"], [["日本語", "1.25"], ["paper" * 40, "12.5"], ["[b]", 2]])
    lines = capsys.readouterr().out.splitlines()
    assert {cell_len(line) for line in lines} == {207}
    assert lines[1].split() == ["日本語", "1.25"]
    assert lines[3].startswith("[b] ")


@pytest.mark.parametrize(
    "arguments", [("explore", "-o"), ("fit", f"files/{NAMES[0]}_rgb.bsdf", "-o"), ("embed", "-o")]
)
def test_a_dash_is_refused_as_an_output_file(run, folder, arguments):
    status, out, err = run(*arguments, "-", cwd=folder)
    assert (status, out) == (2, "")
    assert "-: this command writes a file" in one_line(err)
    assert not (folder / "-").exists()


def test_outputs_that_would_destroy_inputs_are_refused_and_leave_them(run, folder):
    (folder / "link").symlink_to("model.h5")
    before = _content(folder)
    file = f"files/{NAMES[0]}_rgb.bsdf"
    for words, arguments in (
        ("is an input of this command", ("info", "model.h5", "--json", "model.h5")),
        ("is an input of this command", ("info", "model.h5", "--json", "link")),
        ("in the library", ("info", "library.zarr", "--json", "library.zarr/zarr.json")),
        ("in the library", ("info", "library.zarr", "--json", "library.zarr/materials/new.json")),
        ("name two files", ("report", "--picture", "--json", "model.png")),
        ("is an input of this command", ("explore", "-o", "model.h5")),
        ("is an input of this command", ("convert", file, "-o", "x.csv", "--report", file)),
        ("in the library", ("embed", "-o", "library.zarr/model.h5")),
    ):
        status, _, err = run(*arguments, cwd=folder)
        assert status == 2, arguments
        assert words in one_line(err)
    assert _content(folder) == before


def test_outputs_that_nobody_named_destroy_nothing_either(run, folder):
    small, file = ("--resolution", "8", "--incidences", "4"), f"files/{NAMES[0]}_rgb.bsdf"
    assert run("predict", "--latent", "0,0", *small, "-o", "reconstructed.bsdf", cwd=folder)[0] == 0
    (folder / "predictions.csv").write_text("x,y\n0.1,0.1\n0.2,0.2\n")
    before = _content(folder)
    for words, arguments in {
        "predictions.csv: is an input of this command": ("predict", "--from", "predictions.csv", "-o", "."),
        "reconstructed.bsdf: is an input of this command": ("reconstruct", "reconstructed.bsdf"),
        "named for --json and for --output": ("predict", "--latent", "0,0", "--json", "predicted.bsdf"),
        "named for --json and for": ("render", file, "--json", "render.png"),
    }.items():
        status, _, err = run(*arguments, cwd=folder)
        assert status == 2, arguments
        assert words in one_line(err)
    assert _content(folder) == before


@pytest.mark.parametrize(
    "arguments",
    [("corpus",), ("demo",), ("fetch", "-o"), ("fit", "files", "-o"), ("export", "files", "-o")],
)
@pytest.mark.parametrize("place", ["library.zarr", "library.zarr/materials/new"])
def test_no_command_writes_its_files_into_a_library(run, folder, arguments, place):
    before = _content(folder / "library.zarr")
    status, _, err = run(*arguments, place, cwd=folder)
    assert status == 2
    assert f"{place}: lies in the library {folder / 'library.zarr'}, " in one_line(err)
    assert _content(folder / "library.zarr") == before
    assert not (folder / "library.zarr/materials/new").exists()


def test_outputs_replace_what_is_there(run, folder):
    for arguments in (
        ("info", "model.h5", "--json", "info.json"),
        ("predict", "--latent", "0,0", "-o", "p_rgb.bsdf", "--resolution", "8", "--json", "p.json"),
        ("embed", "-M", "again.h5", "--json", "embed.json"),
    ):
        for _ in range(2):
            status, _, err = run(*arguments, cwd=folder)
            assert status == 0, err
    (folder / "embed.json").write_text('{"mine": 1}')
    assert run("info", "model.h5", "--json", "embed.json", cwd=folder)[0] == 0
    assert json.loads((folder / "embed.json").read_text())["program"].startswith("manifold ")


def test_rows_are_broken_between_words_and_lose_none(capsys):
    values = {"nearest": ["a (1)", "b (2)"], "diagnostics": ("word, " * 20, "second"), "file": "/folder" * 20}
    terminal.Results().rows("Title", values)
    lines = capsys.readouterr().out.splitlines()
    assert lines[1] == "  nearest      a (1), b (2)"
    assert [line for line in lines if len(line) > 80] == ["  file         " + values["file"]]
    assert " ".join(lines).split().count("word,") == 20


def test_a_note_on_many_materials_is_printed_once():
    notes = {name: ["no unit given"] for name in "abcd"}
    assert batch_options._grouped(notes) == ["all 4: no unit given"]
    notes["a"] = ["no unit given", "one band"]
    assert batch_options._grouped({**notes, "e": []}) == ["4 of 5: no unit given", "a: one band"]
    assert batch_options._grouped({"a": ["x"], "b": ["x"]}) == ["a, b: x"]
