"""What commands write over, and what they leave alone."""

from __future__ import annotations

import json
import os
from pathlib import Path

import h5py
import numpy as np
import pytest
import typer
from small_library import NAMES, small_model
from test_cli import COMMANDS, one_line

from manifold.cli import terminal
from manifold.cli.main import app
from manifold.cli.outputs import require_replaceable
from manifold.errors import UsageError
from manifold.formats import merl
from manifold.plots.explorer.page import make_page


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """`files/`, `library.zarr` and `model.h5`."""
    return small_model(tmp_path_factory.mktemp("outputs")).parent


def _content(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_columns_of_a_table_are_straight_whatever_script_its_cells_are_in(capsys):
    terminal.Results().table(["material", "error"], [["日本語", "1.25"], ["paper", "12.5"]])
    assert capsys.readouterr().out.splitlines() == ["material  error", "日本語     1.25", "paper      12.5"]


@pytest.mark.parametrize(
    "arguments", [("explore", "--html"), ("fit", f"files/{NAMES[0]}_rgb.bsdf", "-o"), ("embed", "-o")]
)
def test_a_dash_is_no_file_s_name(run, folder, arguments):
    status, out, err = run(*arguments, "-", cwd=folder)
    assert (status, out) == (2, "")
    assert "-: this command writes a file" in one_line(err)
    assert not (folder / "-").exists()


def test_outputs_that_would_destroy_inputs_are_refused_and_leave_them(run, folder):
    file = f"files/{NAMES[0]}_rgb.bsdf"
    (folder / "link").symlink_to("model.h5")
    os.link(folder / "model.h5", folder / "second_name.h5")
    before = _content(folder)
    for words, arguments in {
        "is an input of this command": ("info", "model.h5", "--json", "model.h5"),
        "an input of this": ("info", "model.h5", "--json", "link"),
        "an input": ("info", "model.h5", "--json", "second_name.h5"),
        "in the library": ("info", "library.zarr", "--json", "library.zarr/zarr.json"),
        "in the": ("info", "library.zarr", "--json", "library.zarr/materials/new.json"),
        "was not written by this command": ("info", "library.zarr", "--json", "model.h5"),
        "not written by this": ("embed", "-M", file),
        "not written by": ("predict", "--latent", "0,0", "-o", file),
        "name two files": ("report", "--picture", "x.png", "--json", "x.png"),
    }.items():
        status, _, err = run(*arguments, cwd=folder)
        assert status == 2, arguments
        assert words in one_line(err)
    assert _content(folder) == before


def test_outputs_that_nobody_named_destroy_nothing_either(run, folder):
    small, file = ("--resolution", "8", "--incidences", "4"), f"files/{NAMES[0]}_rgb.bsdf"
    assert run("predict", "--latent", "0,0", *small, "-o", "reconstructed.bsdf", cwd=folder)[0] == 0
    before = _content(folder)
    for words, arguments in {
        "reconstructed.bsdf: is an input of this command": ("reconstruct", "reconstructed.bsdf"),
        "named for --output and for --json": ("predict", "--latent", "0,0", "--json", "predicted.bsdf"),
        "named for --output and for": ("render", file, "--json", "render.png"),
    }.items():
        status, _, err = run(*arguments, cwd=folder)
        assert status == 2, arguments
        assert words in one_line(err)
    assert _content(folder) == before


@pytest.mark.parametrize(
    "arguments",
    [("corpus",), ("demo",), ("fetch", "--to"), ("fit", "files", "-o"), ("export", "files", "-o")],
)
@pytest.mark.parametrize("place", ["library.zarr", "library.zarr/materials/new"])
def test_no_command_writes_its_files_into_a_library(run, folder, arguments, place):
    before = _content(folder / "library.zarr")
    status, _, err = run(*arguments, place, cwd=folder)
    assert status == 2
    assert f"{place}: in the library {folder / 'library.zarr'}, " in one_line(err)
    assert _content(folder / "library.zarr") == before
    assert not (folder / "library.zarr/materials/new").exists()


def test_the_json_of_results_never_replaces_a_result(run, folder):
    fit = f"{NAMES[0]}.fit.json"
    status, _, err = run(
        "fit", f"files/{NAMES[0]}_rgb.bsdf", "--free", "roughness", "--json", fit, cwd=folder
    )
    assert status == 2
    assert f"{fit}: exists, and was not written" in one_line(err)
    assert json.loads((folder / fit).read_text())["format"] == "manifold fit"


def test_commands_write_again_what_they_wrote(run, folder):
    for arguments in (
        ("info", "model.h5", "--json", "info.json"),
        (
            "predict",
            "--latent",
            "0,0",
            "-o",
            "predicted_rgb.bsdf",
            "--resolution",
            "8",
            "--json",
            "predict.json",
        ),
        ("embed", "-M", "again.h5", "--json", "embed.json"),
    ):
        for _ in range(2):
            status, _, err = run(*arguments, cwd=folder)
            assert status == 0, err
    assert json.loads((folder / "embed.json").read_text())["program"].startswith("manifold ")


def test_force_writes_over_a_foreign_file(run, folder):
    (folder / "notes.json").write_text('{"mine": 1}')
    assert run("info", "model.h5", "--json", "notes.json", cwd=folder)[0] == 2
    assert run("info", "model.h5", "--json", "notes.json", "--force", cwd=folder)[0] == 0
    assert "settings" in json.loads((folder / "notes.json").read_text())


def test_every_command_that_writes_files_has_force():
    commands = typer.main.get_command(app).commands
    for name in {*COMMANDS} - {"demo"}:
        assert "force" in [parameter.name for parameter in commands[name].params], name


def test_files_are_replaced_by_their_own_kind_only(tmp_path):
    fit, other = '{"format": "manifold fit", "program": "manifold 1"}', '{"program": "manifold 1"}'
    with h5py.File(tmp_path / "old.h5", "w") as file:
        file.attrs["format"] = "manifold-model"
    with h5py.File(tmp_path / "data.h5", "w") as file:
        file["data"] = 1
    for name, text in {
        "fit.json": fit, "info.json": other, "fits.json": '{"program": "manifold 1", "fits": [' + fit + "]}",
        "correction.json": fit.replace("fit", "colour correction"),
        "scene.json": '{"type": "scene"}', "empty": "", "a.bsdf": "tensor_file",
        "p.bsdf": "tensor_file ... Predicted (1, 2) from a synthetic corpus by manifold 0.1", "x.svg": "<?xml?><svg>",
        "x.png": "notes", "page.md": "Written by `manifold stability`", "mine.md": "# Mine",
        "map.html": make_page({}), "site.html": "<title>Mine</title>",
    }.items():  # fmt: skip
        (tmp_path / name).write_text(text)

    def is_taken(command: str, name: str, file: str) -> bool:
        try:
            require_replaceable(command, {name: tmp_path / file})
        except UsageError:
            return False
        return True

    for command, name, right, wrong in (
        (
            "fit",
            "output",
            ("fit.json", "empty", "absent"),
            ("info.json", "fits.json", "scene.json", "a.bsdf"),
        ),
        ("calibrate", "output", ("correction.json", "empty"), ("info.json", "fit.json")),
        ("info", "json", ("info.json", "empty"), ("fit.json", "correction.json", "scene.json", "old.h5")),
        ("fit", "json", ("fits.json",), ("fit.json",)),
        ("embed", "model", ("old.h5", "empty"), ("data.h5", "a.bsdf")),
        ("predict", "output", ("p.bsdf", "empty"), ("a.bsdf", "x.png")),
        ("map", "output", ("x.svg",), ("x.png", "fit.json")),
        ("explore", "output", ("map.html",), ("site.html", "fit.json")),
        ("stability", "markdown", ("page.md",), ("mine.md",)),
    ):
        for file in right:
            assert is_taken(command, name, file), (command, file)
        for file in wrong:
            assert not is_taken(command, name, file), (command, file)


@pytest.mark.parametrize("name", ["a.bsdf", "a.astm", "a.csv"])
def test_conversions_are_written_again_over_their_own_format_only(run, folder, name):
    source = f"files/{NAMES[0]}_rgb.bsdf"
    convert = ("convert", source, "--resolution", "8", "--incidences", "4", "-o")
    for _ in range(2):
        status, _, err = run(*convert, name, cwd=folder)
        assert status == 0, err
    other = "csv" if name != "a.csv" else "astm"
    before = (folder / name).read_bytes()
    status, _, err = run(*convert, name, "--format", other, cwd=folder)
    assert status == 2
    assert "was not written by this command" in one_line(err)
    assert (folder / name).read_bytes() == before


def test_a_format_of_binary_values_replaces_its_own_kind(tmp_path):
    path = tmp_path / "a.binary"
    path.write_bytes(np.array(merl.SHAPE, "<i4").tobytes() + bytes(8 * 3 * int(np.prod(merl.SHAPE))))
    require_replaceable("convert", {"output": path, "to": None})
    path.write_bytes(b"notes of mine")
    with pytest.raises(UsageError, match="was not written by this command"):
        require_replaceable("convert", {"output": path, "to": None})


def test_sentences_of_a_tuple_begin_on_their_own_lines(capsys):
    terminal.Results(None).rows(
        "Title", {"nearest": ["a (1)", "b (2)"], "diagnostics": ("word, " * 20, "second")}
    )
    lines = capsys.readouterr().out.splitlines()
    assert lines[1] == "  nearest      a (1), b (2)"
    assert lines[-1] == "               second"
    assert max(map(len, lines)) <= 80


def test_sentences_are_broken_at_80_columns_and_paths_are_not(capsys):
    words = "a sentence of more words than one line of a terminal has room for, which readers would have to scroll"
    results = terminal.Results()
    path = Path("/folder with blanks" * 5)
    results.rows("Completed", {"note 1": words, "notes": [words], "file": path, "n": 3})
    results.sentence(words)
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if len(line) > 80] == [f"  file    {path}"]
    assert " ".join(" ".join(lines[1:3]).split()) == f"note 1 {words}"
    assert lines[2].startswith(10 * " ")
    assert " ".join(line.strip() for line in lines[-2:]) == words
