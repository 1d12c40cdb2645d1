"""What commands import: a prediction is not to wait for what it does without."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from helpers.small_library import small_model

from manifold.cli.application import COMMANDS

SCRIPT = """
import contextlib, io, json, sys
from manifold.cli.main import run
for words in json.loads(sys.argv[1]):
    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
        run(words)
    print(json.dumps([module for module in json.loads(sys.argv[2]) if module in sys.modules]))
"""
HEAVY = [
    "sklearn", "scipy.stats", "scipy.optimize", "scipy.spatial", "mitsuba", "drjit", "pydantic",
    "manifold.evaluate", "manifold.fit.principled",
]  # fmt: skip
PREDICT = ["predict", "--latent", "0.1,0.1", "-o", "made.bsdf"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("startup")
    small_model(path)
    return path


def _loaded(folder, *commands, heavy=HEAVY):
    """Which of the heavy modules are loaded after each command of one process."""
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, json.dumps(commands), json.dumps(heavy)],
        cwd=folder, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_helps_load_no_numbers_no_formats_and_no_packages_of_others(folder):
    commands = [["--version"], ["--help"], *([command, "--help-all"] for command in COMMANDS)]
    heavy = ["numpy", "email", "importlib.metadata", "manifold.core.records", *HEAVY]
    assert _loaded(folder, *commands, heavy=heavy) == [[]] * len(commands)


def test_a_prediction_loads_no_optimisers_and_nothing_that_only_writes_or_renders(folder):
    heavy = [*HEAVY, "rich", "zarr", "filelock"]
    assert _loaded(folder, PREDICT, heavy=heavy) == [[]]
    assert _loaded(folder, ["info", "model.h5"], ["info", "library.zarr"], heavy=[*HEAVY, "zarr"]) == [[], []]
    assert (folder / "made.bsdf").is_file()


@pytest.mark.slow
def test_maps_and_renders_load_no_scikit_learn(folder):
    pytest.importorskip("mitsuba")
    render = ["render", "0.1,0.1", "--size", "16", "--samples", "1", "-o", "made.png"]
    loaded = _loaded(folder, ["map", "-o", "map.png"], render)
    assert [("sklearn" in modules, "manifold.evaluate" in modules) for modules in loaded] == [
        (False, False)
    ] * 2
    assert (folder / "map.png").is_file()
    assert (folder / "made.png").is_file()
