"""Figures of the documents come from results that say how they were made."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import zipfile
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.paths import REPOSITORY

sys.path.insert(0, str(REPOSITORY / "benchmarks"))
sys.path.insert(0, str(REPOSITORY / "docs"))

import bench_designs
import bench_lamps
import evidence
import figures
import run_all

PAGES = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").rglob("*.md"))]


@pytest.mark.parametrize("name", sorted(path.stem for path in evidence.FOLDER.glob("*.json")))
def test_every_result_says_how_it_was_made(name):
    record = evidence.record(name)
    assert record.keys() >= {
        "command",
        "version",
        "commit",
        "code",
        "data",
        "date",
        "processor",
        "processor_seconds",
    }
    assert record["command"] == evidence.RESULTS[name].command
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", str(record["date"]))


def test_the_code_of_a_result_is_all_that_it_imports():
    for result in evidence.RESULTS.values():
        assert result.sources, result.command
    names = {str(path.relative_to(REPOSITORY)) for path in evidence.RESULTS["letter"].sources}
    assert {"benchmarks/bench_letter.py", "manifold/gplvm.py", "manifold/dls.py"} <= names
    assert "manifold/gp/likelihood.py" in names  # imported by gplvm
    of_page = {str(path.relative_to(REPOSITORY)) for path in evidence.RESULTS["page"].sources}
    assert "tests/helpers/browser.py" in of_page


def test_a_change_of_a_loop_of_its_build_or_of_a_file_of_the_package_changes_the_code(tmp_path, monkeypatch):
    for folder in ("cpp", "benchmarks", "manifold/data"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "benchmarks" / "bench.py").write_text("import beside\n")
    (tmp_path / "benchmarks" / "beside.py").write_text("x = 1\n")
    monkeypatch.setattr(evidence, "REPOSITORY", tmp_path)
    evidence._imported.cache_clear()
    result = evidence.Result("bench.py FILES")
    hashes = []
    for file, text in (
        ("cpp/a.cpp", "int x;"), ("cpp/a.cpp", "int y;"), ("benchmarks/beside.py", "x = 2\n"),
        ("setup.py", "flags = ['-O2']\n"), ("setup.py", "flags = ['-O3']\n"), ("manifold/data/built_in.json", "{}"),
    ):  # fmt: skip
        (tmp_path / file).write_text(text)
        hashes.append(result.code_hash)
    evidence._imported.cache_clear()
    assert len(set(hashes)) == 6


STAND_IN = """
import json, os, pathlib, signal, sys
target = pathlib.Path(sys.argv[sys.argv.index("--json") + 1])
target.write_text(json.dumps({"first": 1}))
END
target.write_text(json.dumps({"first": 1, "second": 2}))
"""
"""A benchmark that writes its result in two steps."""


@pytest.fixture
def stand_in(tmp_path, monkeypatch):
    """Return a function that runs a stand-in benchmark by `run_all` and returns the result that is kept."""
    for folder in ("benchmarks", "cpp", "results"):
        (tmp_path / folder).mkdir()
    kept, program = tmp_path / "results" / "stand_in.json", tmp_path / "benchmarks" / "stand_in.py"
    results = {"stand_in": evidence.Result("stand_in.py")}
    for module, name, value in (
        (evidence, "REPOSITORY", tmp_path), (evidence, "FOLDER", kept.parent), (evidence, "RESULTS", results),
        (run_all, "HERE", program.parent), (run_all, "FOLDER", kept.parent), (run_all, "RESULTS", results),
        (sys, "argv", ["run_all.py", "stand_in"]),
    ):  # fmt: skip
        monkeypatch.setattr(module, name, value)
    subprocess.run(["git", "init", "--quiet", str(tmp_path)], check=True)
    author = ["-c", "user.name=a", "-c", "user.email=a@b.c"]
    commit = ["git", "-C", str(tmp_path), *author, "commit", "--quiet", "--allow-empty", "-m", "Start"]
    subprocess.run(commit, check=True)

    def run(end):
        program.write_text(STAND_IN.replace("END", end))
        kept.write_text(json.dumps({"_made": {"processor_seconds": None, "data": {}}, "first": 0}))
        run_all.main()
        return json.loads(kept.read_text())

    run.kept = kept
    return run


def test_a_finished_benchmark_is_kept_with_its_code(stand_in):
    found = stand_in("pass")
    assert (found["first"], found["second"]) == (1, 2)
    assert found["_made"]["code"] == evidence.RESULTS["stand_in"].code_hash


@pytest.mark.parametrize(
    ("end", "reason"),
    [
        ("os.kill(os.getpid(), signal.SIGKILL)", "exit status -9"),
        ("raise ValueError", "exit status 1"),
        ("pathlib.Path(__file__).write_text('x = 1')", "its code changed during the run"),
        ("target.unlink(); sys.exit()", "it wrote no result"),
    ],
)
def test_a_benchmark_that_ends_midway_leaves_the_kept_result(stand_in, capfd, end, reason):
    with pytest.raises(SystemExit, match="failed: stand_in"):
        stand_in(end)
    assert json.loads(stand_in.kept.read_text())["first"] == 0
    assert f"not kept: {reason}" in capfd.readouterr().out


def test_every_figure_of_a_page_belongs_to_a_result_of_the_list():
    known = figures.figures()
    names = {name for page in PAGES for _, name in figures.NAMED.findall(page.read_text(encoding="utf-8"))}
    assert names
    for name in names:
        assert name in known, f"{name}: no such entry in benchmarks/results"
        assert any(name.startswith(f"{result}_") for result in evidence.RESULTS), name


def test_the_hash_of_code_sees_code_alone():
    source = '"""A module."""\n\ndef f(x):\n    """Double."""\n    # why\n    return g(2 * x, 0, "key")\n'
    reworded = '"""Some module."""\ndef f(x):\n    """Of x."""\n    return g(\n        2*x, 0,\n        "key",\n    )\n'
    assert evidence.bare(source) == evidence.bare(reworded)
    for old, new in (("2 *", "3 *"), ("x, 0", "x, False"), ("x, 0", "x, None"), ("key", "word")):
        assert evidence.bare(source) != evidence.bare(source.replace(old, new))


def test_the_hash_of_code_does_not_see_the_wording_of_messages():
    source = "raise UsageError(f'{path}: not a file', hint='name a file')\n"
    assert evidence.bare(source) == evidence.bare(
        "raise UsageError(f'no file is at {path}', hint='give a file')\n"
    )
    assert evidence.bare(source) != evidence.bare(source.replace("UsageError", "FileError"))


def test_the_hash_of_code_sees_names_with_blanks_and_what_is_imported_under_a_name():
    for source, changed in (
        ("LIGHTS = ('sun 45', 'white')\n", "LIGHTS = ('sun 60', 'white')\n"),
        ("from manifold.a import DEFAULT as G\n", "from manifold.a import HIKICHI as G\n"),
        ("error = found['ball ITP']\n", "error = found['cube root']\n"),
        (
            "COMMAND = 'complete readings.csv --unit brdf'\n",
            "COMMAND = 'complete readings.csv --unit factor'\n",
        ),
        (
            "HEADING = re.compile('distribution function of a surface')\n",
            "HEADING = re.compile('of any surface at all')\n",
        ),
    ):
        assert evidence.bare(source) != evidence.bare(changed)
    moved = "from manifold.b import DEFAULT as G\n"
    assert evidence.bare(moved) == evidence.bare("from manifold.a.c import DEFAULT as G\n")


def test_the_code_of_a_result_includes_what_a_registry_names_and_files_of_the_package():
    page = {
        path.name for path in evidence.closure([evidence.REPOSITORY / "manifold" / "page" / "commands.py"])
    }
    assert "renders.py" in page  # named by "manifold.pictures.renders:render"
    assert evidence.REPOSITORY / "cli" / "terminal.py" in evidence.closure([REPOSITORY / "cli" / "main.py"])
    beside = {path.name for path in evidence.RESULTS["counts"].files_beside}
    assert {"built_in.zip", "built_in.h5"} <= beside
    assert not {path for path in beside if path.endswith((".py", ".so"))}


def test_the_hash_of_data_sees_contents_and_not_how_they_are_packed(tmp_path):
    folder, packed = tmp_path / "fits", tmp_path / "fits.zip"
    folder.mkdir()
    (folder / "gold.h5").write_bytes(b"1")
    with zipfile.ZipFile(packed, "w") as target:
        target.write(folder / "gold.h5", "any/gold.h5")
    before = evidence.data_hash([folder])
    (folder / "README.md").write_text("notes")
    assert evidence.data_hash([folder]) == evidence.data_hash([packed]) == before
    (folder / "gold.h5").write_bytes(b"2")
    assert evidence.data_hash([folder]) != before


def test_refused_pictures_count_as_if_their_lamps_were_given():
    given = {"sun, geometry": {str(n): 2.0 for n in (1, 2, 3, 5, 8)}}
    given["sun, geometry and card"] = dict.fromkeys(given["sun, geometry"], 1.0)
    estimated = given | {
        f"sun, {knows}": dict.fromkeys(given["sun, geometry"], 3.0) for knows in ("card", "nothing")
    }
    refused = given | {"sun, nothing": {"1": 4.0}}
    whole = bench_lamps.with_refused([estimated, refused], ["sun"])
    assert whole["sun, nothing"] == {
        "1": [3.0, 4.0],
        "2": [3.0, 2.0],
        "3": [3.0, 2.0],
        "5": [3.0, 2.0],
        "8": [3.0, 2.0],
    }
    assert whole["sun, card"]["3"] == [3.0, 1.0]
    with pytest.raises(ValueError, match="although the lamps are given"):
        bench_lamps.with_refused([{}], ["sun"])


def test_a_design_has_the_lowest_condition_number_of_all(rng):
    """The test tries all designs of a few candidates. A singular value decomposition computes the components."""
    n, on_grid, candidates, count = 8, 60, 11, 4
    cosines, theta = rng.uniform(0.1, 1.0, on_grid), rng.uniform(0.1, 1.5, (2, candidates))
    roots, at = rng.uniform(0.05, 0.4, (n, on_grid)), rng.uniform(0.05, 0.4, (n, candidates))
    wi, wo = (np.stack([np.sin(t), 0.0 * t, np.cos(t)], axis=1) for t in theta)
    others = SimpleNamespace(
        n_measured=n, n_grid=on_grid, directions=roots, grid=SimpleNamespace(cosines=cosines)
    )
    chosen = bench_designs.lowest_condition(SimpleNamespace(others=others, at=at, wi=wi, wo=wo), count)
    logs, logs_at = (
        np.log(table**3 * weight + 1e-3)
        for table, weight in ((roots, cosines), (at, np.cos(theta).prod(axis=0)))
    )
    directions = np.linalg.svd(logs - logs.mean(axis=0))[0][:, : n - 1]
    components = (logs_at - logs_at.mean(axis=0)).T @ directions
    designs = combinations(range(candidates), count)
    assert tuple(sorted(chosen)) == min(designs, key=lambda design: np.linalg.cond(components[list(design)]))


DATA_WORDS = {*run_all.MEASURED, *run_all.MADE_OF, "CORPUS", "CORPUS_LIBRARY", "CHART"}


@pytest.mark.parametrize("name", evidence.RESULTS)
def test_commands_of_results_name_only_known_data(name):
    words = evidence.RESULTS[name].command.split()
    assert {word for word in words if word.isupper()} <= DATA_WORDS


ONLY_PARSE = """
import argparse, pathlib, runpy, sys
parse = argparse.ArgumentParser.parse_args
def parsed(self, *arguments):
    parse(self, *arguments)
    sys.exit("parsed")
argparse.ArgumentParser.parse_args = parsed
del sys.argv[0]
sys.path.insert(0, str(pathlib.Path(sys.argv[0]).parent))
runpy.run_path(sys.argv[0], run_name="__main__")
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [n for n, r in evidence.RESULTS.items() if r.command.split()[0].endswith(".py")]
)
def test_benchmark_imports_what_it_needs_and_has_the_options_of_its_command(name):
    program, *words = evidence.RESULTS[name].command.split()
    path = REPOSITORY / "benchmarks" / program
    command = [sys.executable, "-c", ONLY_PARSE, str(path), *words, "--json", "FILE"]
    ran = subprocess.run(command, capture_output=True, text=True, cwd=REPOSITORY.parent, check=False)
    assert ran.stderr.endswith("parsed\n"), ran.stderr
