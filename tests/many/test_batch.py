"""Many files of one command: what is kept, what fails alone, and which files are of one sample."""

from __future__ import annotations

import csv
import json
import os
from concurrent.futures import Executor, Future
from typing import NamedTuple

import numpy as np
import pytest
from helpers.small_library import small_model

from manifold.analytic.base import Lambert
from manifold.analytic.virtual_instruments import MA_T12_BANDS, write_ma_t12
from manifold.cli.main import run as cli
from manifold.core.errors import ManifoldError, MissingFileError, UsageError
from manifold.estimate.inputs import Input, find_inputs, find_samples
from manifold.estimate.instruments import calibrate
from manifold.estimate.sources import FileSource, PlaceSource
from manifold.library import staging
from manifold.many.batch import BatchCommand, SheetWarning, _Made, ball_path, batch, cell
from manifold.model.colours import ColourChoice
from manifold.pictures import figures

COLUMNS = {"letters": lambda content: content["letters"]}


class Word(NamedTuple):
    name: str

    def __str__(self):
        return self.name

    def made_of(self):
        return {"name": self.name}


def command(make, **settings):
    return BatchCommand("words", make, {}, ".txt", columns=COLUMNS, **settings)


def run(folder, names, make, workers=None, **settings):
    return batch(command(make, **settings), list(map(Word, names)), folder, workers).outcomes


def written(word, path):
    path.write_text(word.name)
    return {"letters": len(word.name)}


def done(result):
    future = Future()
    future.set_result(result)
    return future


@pytest.mark.parametrize("moment", range(5))
def test_what_was_made_before_an_interruption_is_not_made_again(tmp_path, moment):
    names, made = [f"word{k}" for k in range(5)], []

    def make(word, path):
        if len(made) == moment:
            raise KeyboardInterrupt
        made.append(word.name)
        return written(word, path)

    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, names, make)
    again = []
    outcomes = run(tmp_path, names, lambda word, path: again.append(word.name) or written(word, path))
    assert made + again == names
    assert [o.was_there for o in outcomes] == [name in made for name in names]


def test_a_file_that_a_worker_wrote_elsewhere_is_one_failure(tmp_path):
    class Elsewhere(Executor):
        def submit(self, function, *args):
            return done((0, _Made({"letters": 4}, "0" * 64), None))

    (outcome,) = run(tmp_path, ["word"], written, Elsewhere())
    assert "word.txt: a worker wrote this file, but it is not visible here; use a folder" in outcome.failure


def test_a_failure_stops_nothing_and_stands_in_the_tables(tmp_path):
    def make(word, path):
        if word.name == "bad":
            raise ManifoldError("bad: not a word")
        return written(word, path) | ({"refusal": "too bright"} if word.name == "refused" else {})

    outcomes = run(tmp_path, ["a", "bad", "refused", "b"], make)
    assert [o.failure for o in outcomes] == [None, "bad: not a word", "too bright", None]
    with (tmp_path / "words.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["letters"] for row in rows] == ["1", "", "7", "1"]
    assert [row["failed"] for row in rows] == ["", "bad: not a word", "too bright", ""]
    assert len(json.loads((tmp_path / "words.json").read_text())["failed"]) == 2
    outcomes = run(tmp_path, ["a", "refused"], written)
    assert [o.was_there for o in outcomes] == [True, False]


def test_a_sheet_that_cannot_be_drawn_is_a_warning(tmp_path, monkeypatch):
    def fail(*_):
        raise OSError("no space left")

    monkeypatch.setattr(figures, "save", fail)

    def make(name, path):
        ball = ball_path(path)
        ball.parent.mkdir(exist_ok=True)
        ball.write_bytes(b"no picture")
        return written(name, path)

    with pytest.warns(SheetWarning, match="everything else is written"):
        (outcome,) = run(tmp_path, ["word"], make, has_balls=True)
    assert outcome.failure is None
    assert (tmp_path / "words.csv").is_file()


def test_no_file_takes_the_place_of_the_table(tmp_path):
    outcomes = run(tmp_path, ["words", "Words", "word"], written)
    assert [o.failure for o in outcomes] == [
        "has the name of the table of results; rename it",
        "has the name of the table of results; rename it",
        None,
    ]
    with (tmp_path / "words.csv").open(newline="") as file:
        assert [row["name"] for row in csv.DictReader(file)] == ["words", "Words", "word"]


def test_a_folder_is_one_runs_at_a_time(tmp_path):
    def make(name, path):
        with pytest.raises(UsageError, match="another run writes to this folder; wait until it is done"):
            run(tmp_path, ["b"], written)
        with pytest.raises(UsageError, match="another run writes to this folder"):  # whatever it writes
            batch(BatchCommand("letters", written, {}), [], tmp_path)
        return written(name, path)

    (outcome,) = run(tmp_path, ["a"], make)
    assert outcome.failure is None
    assert [o.was_there for o in run(tmp_path, ["a", "b"], written)] == [True, False]


@pytest.mark.parametrize("kind", ["pipe", "folder"])
def test_a_lock_that_is_no_file_is_refused(tmp_path, kind):
    """Some versions of filelock wait for ever for who opens the other end of a pipe."""
    lock = tmp_path / ".manifold.lock"
    os.mkfifo(lock) if kind == "pipe" else lock.mkdir()
    with pytest.raises(UsageError, match=r"\.manifold\.lock: not a regular file, expected a lock; remove it"):
        run(tmp_path, ["a"], written)
    library = tmp_path / ".library.lock"
    os.mkfifo(library) if kind == "pipe" else library.mkdir()
    with (
        pytest.raises(UsageError, match=r"\.library\.lock: not a regular file, expected a lock"),
        staging.writing(tmp_path / "library"),
    ):
        pass


def test_a_file_that_another_program_replaces_at_once_is_made_again(tmp_path):
    """The index holds the hash of what a run wrote, not of what is there when it notes it."""

    class Slow(Executor):
        def submit(self, function, *args):
            made = done(function(*args))
            args[-1][1].write_text("of another program")
            return made

    run(tmp_path, ["word"], written, Slow())
    (outcome,) = run(tmp_path, ["word"], written)
    assert not outcome.was_there
    assert (tmp_path / "word.txt").read_text() == "word"


def workbook(path, name, rng):
    write_ma_t12(path, Lambert(np.full(MA_T12_BANDS.count, 0.5), MA_T12_BANDS), name, rng)


def test_files_of_different_samples_are_not_merged(tmp_path, rng):
    for name in ("red", "blue"):
        workbook(tmp_path / f"{name}.xlsx", name, rng)
    samples = find_samples([tmp_path / "*.xlsx"])
    assert [(s.name, len(s.parts), s.note) for s in samples] == [("blue", 1, None), ("red", 1, None)]


def test_every_file_with_a_suffix_of_readings_has_a_row(tmp_path, rng):
    """Damaged workbooks, tables with an unknown head and links to nothing were left out without a word."""
    readings, out = tmp_path / "readings", tmp_path / "out"
    readings.mkdir()
    workbook(readings / "red.xlsx", "red", rng)
    damaged = {"cut.xlsx": (readings / "red.xlsx").read_bytes()[:3000], "red.XLS": b"junk", "empty.cxf": b""}
    damaged["heads.csv"] = b"AOI,AOR,BRDF\n30,30,0.5\n"
    for name, content in damaged.items():
        (readings / name).write_bytes(content)
    (readings / "gone.xlsx").symlink_to(readings / "nowhere")
    others = {"notes.txt": "notes", "~$red.xlsx": "lock", "._red.xlsx": "fork", "a.csv": "name,file,L\n"}
    for name, content in others.items():
        (readings / name).write_text(content)
    with pytest.raises(SystemExit, match="1"):
        cli(["complete", str(readings), "-o", str(out)])
    with (out / "completions.csv").open(newline="") as table:
        rows = {row["name"]: row["failed"] for row in csv.DictReader(table)}
    assert sorted(rows) == sorted(["red", *damaged, "gone.xlsx"])
    assert [name for name, failure in rows.items() if not failure] == ["red"]
    with pytest.raises(SystemExit, match="1"):
        cli(["convert", str(readings), "-o", str(tmp_path / "tables"), "--format", "csv"])
    with (tmp_path / "tables" / "conversions.csv").open(newline="") as table:
        assert sum(bool(row["failed"]) for row in csv.DictReader(table)) == len(damaged) + 1


def test_two_files_of_one_name_and_instrument_stay_apart_and_say_so(tmp_path, rng):
    for file in ("first", "second"):
        workbook(tmp_path / f"{file}.xlsx", "red", rng)
    samples = find_samples([tmp_path])
    assert [s.name for s in samples] == ["first", "second"]
    assert all("by one instrument" in s.note for s in samples)


def test_files_of_one_incidence_each_are_told_of_merging(tmp_path):
    head = "theta_i (deg),phi_i (deg),theta_o (deg),phi_o (deg),R,G,B"
    for incidence in (0, 30, 60):
        rows = [f"{incidence},0,{elevation},180,0.1,0.2,0.3" for elevation in (10, 40, 70)]
        (tmp_path / f"at_{incidence}.csv").write_text("\n".join([head, *rows]) + "\n")
    assert all("--merge" in sample.note for sample in find_samples([tmp_path]))
    (tmp_path / "again_60.csv").write_text((tmp_path / "at_60.csv").read_text())
    assert all(sample.note is None for sample in find_samples([tmp_path]))


def test_what_a_file_is_made_of_has_the_content_of_the_reflectance_and_not_its_path(tmp_path):
    model, spectrum = small_model(tmp_path), tmp_path / "green.txt"

    def made_of(values) -> dict:
        spectrum.write_text(
            "".join(f"{nm} {value}\n" for nm, value in zip((400, 500, 700), values, strict=True))
        )
        return Input("x", PlaceSource(model, "0,0", colour=ColourChoice(reflectance=spectrum))).made_of()

    assert made_of((0.1, 0.2, 0.3)) == made_of((0.1, 0.2, 0.3)) != made_of((0.1, 0.2, 0.4))
    spectrum.rename(tmp_path / "moved.txt")
    with pytest.raises(MissingFileError, match="no such file"):
        Input("x", PlaceSource(model, "0,0", colour=ColourChoice(reflectance=spectrum))).made_of()


def test_cells_of_tables_have_no_exponents_for_small_errors():
    assert [cell(value) for value in (2.51e-06, -2e-9, 0.0, 0.00214, 1.234, 12.34, None, "a")] == [
        "0.000", "0.000", "0", "0.00214", "1.23", "12.3", "", "a"
    ]  # fmt: skip


def test_every_file_of_a_folder_is_a_material(tmp_path, rng):
    for name in ("red", "blue"):
        workbook(tmp_path / f"{name}.xlsx", name, rng)
    found = find_inputs([FileSource(tmp_path)], lambda path: path.suffix == ".xlsx", samples=True)
    assert [one.name for one in found] == ["blue", "red"]


def test_two_folders_calibrate_by_the_names_of_their_samples(tmp_path, rng):
    pairs = []
    for name, shade in (("red", 0.2), ("blue", 0.4), ("white", 0.8)):
        for folder, bands in (("reference", "400,450,500,550,600,650,700"), ("other", "465,525,630")):
            (tmp_path / folder).mkdir(exist_ok=True)
            pairs.append(tmp_path / folder / f"{name}.csv")
            count = bands.count(",") + 1
            angles = [(i, o, p) for i in (10, 30, 50) for o in (5, 25, 45, 65) for p in (0, 90, 180)]
            values = (
                shade * np.linspace(0.5, 1.0, count) * rng.uniform(0.9, 1.0, (len(angles), count)) / np.pi
            )
            rows = [
                f"{name},{i},0,{o},{p}," + ",".join(map(str, row))
                for (i, o, p), row in zip(angles, values, strict=True)
            ]
            pairs[-1].write_text(f"name,theta_i,phi_i,theta_o,phi_o,{bands}\n" + "\n".join(rows) + "\n")
    by_folders = calibrate([tmp_path / "reference", tmp_path / "other"], tmp_path / "a.json")
    by_pairs = calibrate(pairs, tmp_path / "b.json")
    assert sorted(by_folders.samples) == ["blue", "red", "white"]
    one, other = by_folders.correction, by_pairs.correction
    assert (one.form, one.uncorrected) == (other.form, pytest.approx(other.uncorrected))
