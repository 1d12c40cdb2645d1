"""`predict --from` and `render --from`: tables of places, resuming, bad rows by their line."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from helpers.small_library import NAMES, measured, small_model
from typer.testing import CliRunner

from manifold.brdf.measured import MeasuredBRDF
from manifold.cli.main import app
from manifold.core.errors import FileFormatError, ManifoldError, UsageError
from manifold.estimate import predictions
from manifold.estimate.attributes import lab_of
from manifold.estimate.inputs import read_points
from manifold.io_rgl import read_bsdf, write_bsdf
from manifold.library.identity import file_sha256
from manifold.many import commands as many
from manifold.many.batch import OutputIndex, batch
from manifold.model.colours import ColourChoice
from manifold.model.manifold import Manifold
from manifold.model.output_file import OutputOptions


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return small_model(tmp_path_factory.mktemp("many"))


def run(*words):
    return CliRunner().invoke(app, list(map(str, words)))


def table(folder, text):
    path = folder / "points.csv"
    path.write_text(text, encoding="utf-8")
    return path


def predicted(folder, model, text, **options):
    """Outcomes of the predictions at a table's places, in a folder `out`."""
    rows, _ = read_points(table(folder, text), model)
    return batch(many.predictions_of(model, **options), rows, folder / "out").outcomes


def test_rows_are_predicted_as_one_by_one(model, tmp_path):
    (tmp_path / "red.txt").write_text("380 0.05\n580 0.05\n600 0.8\n780 0.8\n")
    rows = ",".join(["x", "y", "material", "name", "like", "srgb", "reflectance"]) + (
        f"\n0.1,-0.2,,plain,,,\n,,{NAMES[0]},felt,,,\n0,0.1,,orange,{NAMES[1]},,\n0,0,,blue,,#3366aa,\n0,0,,red,,,red.txt\n"
    )
    words = ["predict", "--from", table(tmp_path, rows), "-M", model, "-o", tmp_path / "out"]
    result = run(*words, "--json", tmp_path / "r.json")
    assert result.exit_code == 0, result.output
    made = json.loads((tmp_path / "r.json").read_text())
    assert [row["name"] for row in made["predictions"]] == ["plain", "felt", "orange", "blue", "red"]
    assert made["failed"] == []
    with (tmp_path / "out" / "predictions.csv").open(encoding="utf-8-sig") as file:
        stated = {row["name"]: float(row["expected CIEDE2000 (five lights)"]) for row in csv.DictReader(file)}
    loaded = Manifold.load(model)
    expected = {
        "plain": ((0.1, -0.2), ColourChoice()), "felt": (NAMES[0], ColourChoice()),
        "orange": ((0.0, 0.1), ColourChoice(like=NAMES[1])), "blue": ((0, 0), ColourChoice(srgb="#3366aa")),
        "red": ((0, 0), ColourChoice(reflectance=tmp_path / "red.txt")),
    }  # fmt: skip
    for name, (place, colour) in expected.items():
        alone = tmp_path / f"{name}_rgb.bsdf"
        made = predictions.predict(loaded, place, alone, colour=colour)
        assert stated[name] == pytest.approx((made.expected_in_chosen_colour or made.expected).ball)
        found = read_bsdf(tmp_path / "out" / f"{name}_rgb.bsdf")
        assert np.array_equal(found.spectra, read_bsdf(alone).spectra)


def test_a_second_run_makes_only_rows_that_changed(model, tmp_path, monkeypatch):
    folder = tmp_path / "out"
    assert not any(o.was_there for o in predicted(tmp_path, model, "x,y,name\n0,0,a\n0.1,0,b\n0.2,0,c\n"))
    (folder / "c_rgb.bsdf").write_bytes(b"changed")
    text = "x;y;name\n0;0;a\n0,15;0;b\n0,2;0;c\n"  # decimal commas
    again = predicted(tmp_path, model, text)
    assert [(o.source.name, o.was_there) for o in again] == [("a", True), ("b", False), ("c", False)]
    assert again[0].content["latent"] == [0.0, 0.0]
    coarse = OutputOptions(resolution=8)
    assert not any(o.was_there for o in predicted(tmp_path, model, text, options=coarse))
    monkeypatch.setattr(Manifold, "prepare", None)  # nothing to be made, nothing read
    assert all(o.was_there for o in predicted(tmp_path, model, text, options=coarse))
    words = ["predict", "--from", tmp_path / "points.csv", "-M", model, "-o", folder, "--resolution", "8"]
    assert "3 predictions in" in run(*words).stdout
    assert "3 of them kept" in run(*words).stdout


def test_bad_rows_are_named_by_their_lines_and_the_others_are_made(model, tmp_path):
    text = (
        "latent,name,like,srgb\n"
        '"0,0",good,,\n"0,0,0",three,,\n"0,nan",number,,\n,none,,\nnobody,stranger,,\n"0,0",../out,,\n'
        f'"0,0",good,,\n"0,0",both,{NAMES[0]},#112233\n"0,0",like,nobody,\n"0,0",srgb,,red\n"9,0,",Good2,,,,extra\n'
        '"0,0",good_rgb.bsdf,,\n"0,0",predictions,,\n'
    )
    words = ["predict", "--from", table(tmp_path, text), "-M", model, "-o", tmp_path / "out"]
    result = run(*words, "--json", tmp_path / "r.json")
    assert isinstance(result.exception, FileFormatError)
    assert str(result.exception).startswith(f"{words[2]}: line 5: ")
    made = json.loads((tmp_path / "r.json").read_text())
    assert [row["name"] for row in made["predictions"]] == ["good"]
    assert [words.partition(":")[0] for words in made["failed"]] == [
        "line 5", "line 7", "line 8", "line 9", "line 12", "three", "number", "stranger", "like", "srgb",
        "good_rgb.bsdf", "predictions",
    ]  # fmt: skip
    assert made["failed"][-2:] == [
        "good_rgb.bsdf: line 13 and line 2 have the same name, good_rgb.bsdf; use two folders",
        "predictions: has the name of the table of results; rename it",
    ]
    assert sorted(path.name for path in tmp_path.rglob("*.bsdf")) == ["good_rgb.bsdf"]


def test_names_are_rows_numbers_where_there_are_none(tmp_path):
    rows, _ = read_points(table(tmp_path, "\ufeffx1,x2,x3\n\n1,2,3\n4,5,6\n"), tmp_path)
    assert [(p.line, p.name, p.source.place) for p in rows] == [
        (3, "point-0001", (1.0, 2.0, 3.0)), (4, "point-0002", (4.0, 5.0, 6.0)),
    ]  # fmt: skip


@pytest.mark.parametrize(
    "content",
    [
        b"x\ty\tname\r\n-0,3\t1,2\ta\r\n",
        "x\ty\tname\r\n-0.3\t1.2\ta\r\n".encode("utf-8-sig"),
        b"sep=;\r\nx;y;name\r\n-0,3;1,2;a\r\n",
        b"sep=,\nx,y,name\n-0.3,1.2,a\n",
        b'"x","y","name",,\n"-0.3","1.2","a",,\n',
        b"latent;name;;\n-0.3 1.2;a;;\n",
        b'latent;name\n"-0,3;1,2";a\n',
    ],
)
def test_tables_are_read_as_spreadsheets_write_them(tmp_path, content):
    path = tmp_path / "points.csv"
    path.write_bytes(content)
    rows, failed = read_points(path, tmp_path)
    assert [(p.name, p.source.place) for p in rows] == [("a", (-0.3, 1.2))]
    assert failed == []


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "no row of points"),
        ("x,y\n", "no row of points"),
        ("1,2\n", "found the column '1'"),
        ("x,y,colour\n1,2,3\n", "found the column 'colour'"),
        ("x,z\n1,2\n", "found the columns x, z"),
        ("name\na\n", "found the columns name"),
        ("x,x\n1,2\n", "'x' twice"),
        ('x,y\n"1,2\n' + "a" * 200_000, "not a table"),
    ],
)
def test_a_file_that_is_no_table_is_one_clear_error(tmp_path, text, expected):
    with pytest.raises(ManifoldError, match=expected):
        read_points(table(tmp_path, text), tmp_path)


def test_pictures_are_rendered_and_kept(model, tmp_path):
    words = [
        "render",
        "--from",
        table(tmp_path, f"material,name\n{NAMES[0]},felt.exr\n{NAMES[3]},\n"),
        "-M",
        model,
    ]
    words += ["-o", tmp_path / "out", "--size", "16", "--samples", "1"]
    result = run(*words, "--json", "-")
    assert result.exit_code == 0, result.output
    made = json.loads(result.stdout)["renders"]
    assert [(row["name"], row["kept"], row["size"]) for row in made] == [
        ("felt.exr", False, 16),
        ("point-0002", False, 16),
    ]
    assert sorted(path.name for path in (tmp_path / "out").glob("[!.]*")) == [
        "felt.exr",
        "point-0002.png",
        "renders.csv",
        "renders.json",
        "renders.jsonl",
    ]
    assert "2 renders in" in run(*words).stdout
    assert "2 of them kept" in run(*words).stdout
    assert "kept" not in run(*words, "--seed", "1").stdout


DEEP = '{"file": ' + "[" * 100_000 + "]" * 100_000 + "}\n"


@pytest.mark.parametrize(
    "content",
    ["{}", "[]\n", '{"file": 1\n', '{"file": [1]}\n', '{"file": {"a": 1}}\n', '{"file": null}\n', DEEP],
    ids=lambda content: content[:15],
)
def test_an_index_of_other_content_is_refused(tmp_path, content):
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "predictions.jsonl").write_text(content)
    with pytest.raises(FileFormatError, match="not an index of predictions"):
        OutputIndex(folder, "predictions")


@pytest.mark.parametrize(
    "words", [(), ("--latent", "0,0"), ("--srgb", "#112233"), ("-o", "out.bsdf"), ("-o", "out.png")]
)
def test_a_place_is_given_once(model, tmp_path, words):
    points = () if not words else ("--from", table(tmp_path, "x,y\n0,0\n"))
    for command in ("predict", *(["render"] if words[:1] != ("--latent",) else [])):
        assert isinstance(run(command, *points, *words, "-M", model).exception, UsageError)


def test_an_interrupted_run_keeps_what_it_made(model, tmp_path):
    rows = "x,y\n" + "".join(f"{k / 100},0\n" for k in range(400))
    words = ["predict", "--from", table(tmp_path, rows), "-M", model, "-o", tmp_path / "out"]
    process = subprocess.Popen(
        [sys.executable, "-m", "manifold", *map(str, words)], stderr=subprocess.PIPE, text=True
    )
    out = tmp_path / "out"
    end = time.monotonic() + 240.0
    while time.monotonic() < end and len(list(out.glob("*.bsdf"))) < 2:
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGINT)
    _, complained = process.communicate(timeout=120)
    assert process.returncode == 130
    assert "interrupted; finished outputs are kept" in complained
    noted = [json.loads(line)["file"] for line in (out / "predictions.jsonl").read_text().splitlines()]
    assert len(noted) >= 1
    assert all(read_bsdf(out / name).name for name in noted)
    assert {path.name for path in out.glob("*.bsdf")} <= {f"point-{k:04d}_rgb.bsdf" for k in range(401)}


def test_an_index_knows_what_unchanged_files_were_made_of(tmp_path):
    path = tmp_path / "a.glb"
    path.write_bytes(b"made")
    OutputIndex(tmp_path, "exports").add(path, {"of": 1}, {"lost": 0.5}, {path.name: file_sha256(path)})
    index = OutputIndex(tmp_path, "exports")
    assert index.result(path, {"of": 1}) == {"lost": 0.5}
    assert index.result(path, {"of": 2}) is None
    path.write_bytes(b"changed")
    assert index.result(path, {"of": 1}) is None


@pytest.mark.parametrize(
    "changed",
    [{"result": {}}, {"result": []}, {"result": None}, {"made_of": []}, {"file_sha256": 1}, {"digest": 2}],
)
def test_a_line_that_others_have_changed_is_made_again(tmp_path, changed):
    path = tmp_path / "a.glb"
    path.write_bytes(b"made")
    OutputIndex(tmp_path, "exports").add(path, {"of": 1}, {"lost": 0.5}, file_sha256(path))
    lines = tmp_path / "exports.jsonl"
    lines.write_text(json.dumps(json.loads(lines.read_text()) | changed) + "\n")
    assert OutputIndex(tmp_path, "exports").result(path, {"of": 1}) is None


def test_a_line_that_a_killed_run_left_half_is_dropped(tmp_path):
    path = tmp_path / "a.glb"
    path.write_bytes(b"made")
    OutputIndex(tmp_path, "exports").add(path, {"of": 1}, {"lost": 0.5}, {path.name: file_sha256(path)})
    with (tmp_path / "exports.jsonl").open("a") as file:
        file.write('{"file": "b.glb", "made')
    index = OutputIndex(tmp_path, "exports")
    assert index.result(path, {"of": 1}) == {"lost": 0.5}
    index.add(path, {"of": 2}, {}, {path.name: file_sha256(path)})
    assert OutputIndex(tmp_path, "exports").result(path, {"of": 2}) == {}


def test_the_table_of_located_files_is_a_table_of_points(model, tmp_path):
    folder = tmp_path / "files"
    folder.mkdir()
    for name in NAMES[:2]:
        write_bsdf(folder / f"{name}_rgb.bsdf", measured(name))
    located = run("locate", folder, "-M", model, "-o", tmp_path / "located", "-j", "1")
    assert located.exit_code == 0, located.output
    rows = list(csv.DictReader((tmp_path / "located" / "locations.csv").open(encoding="utf-8-sig")))
    lab = {kind: [float(rows[0][f"{axis} {kind}"]) for axis in "Lab"] for kind in ("measured", "predicted")}
    assert lab["measured"] == pytest.approx(lab_of(MeasuredBRDF(measured(NAMES[0]))), abs=0.01)
    written = MeasuredBRDF(read_bsdf(tmp_path / "located" / rows[0]["file"]))
    assert lab["predicted"] == pytest.approx(lab_of(written), abs=0.01)
    assert rows[0]["Lab under"] == "D65/2, 45/0"
    words = ["predict", "--from", tmp_path / "located" / "locations.csv", "-M", model, "-o", tmp_path / "out"]
    predicted_again = run(*words, "-j", "1")
    assert predicted_again.exit_code == 0, predicted_again.output
    again = list(csv.DictReader((tmp_path / "out" / "predictions.csv").open(encoding="utf-8-sig")))
    assert [[row["name"], row["x1"], row["x2"]] for row in again] == [
        [row["name"], row["x1"], row["x2"]] for row in rows
    ]
