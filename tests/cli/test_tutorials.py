"""Tutorials run as they are printed: cell by cell in an empty folder, in a shell and in Python without a notebook."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.paths import REPOSITORY
from helpers.small_library import NAMES, measured

from manifold.io_rgl import write_bsdf

CELL = re.compile(r"^```\{code-cell\} python3\n(.*?)^```$", flags=re.DOTALL | re.MULTILINE)
TUTORIALS = [
    path
    for folder in ("tutorials", "how-to")
    for path in sorted((REPOSITORY / "docs" / folder).glob("*.md"))
    if "{code-cell}" in path.read_text(encoding="utf-8")
]
SLOW = (
    "corpus",
    "edit",
    "extend",
    "few-readings",
    "inverse-rendering",
    "merl",
    "photograph",
    "rgl-files",
    "spectrophotometer",
    "textures",
)

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="cells of commands are for bash")


def cells(tutorial):
    return CELL.findall(tutorial.read_text(encoding="utf-8"))


def commands_of(cell):
    return cell.removeprefix("%%bash\n")


def run(program, text, folder):
    """Run text, given on stdin, as a user would who installed the package beside this Python.

    pip builds packages with the setuptools of this environment, which needs no network.
    """
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    done = subprocess.run(
        program,
        input=text,
        cwd=folder,
        env=os.environ | {"PATH": path, "MPLBACKEND": "agg", "PIP_NO_BUILD_ISOLATION": "0"},
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-2000:]


@pytest.fixture(scope="module")
def begun(tmp_path_factory):
    """The folder after a tutorial's first commands, which are run once for all tutorials that begin with them."""
    kept = {}

    def folder_after(commands):
        if commands not in kept:
            folder = tmp_path_factory.mktemp("begun")
            if commands:
                shutil.copytree(folder_after(commands[:-1]), folder, dirs_exist_ok=True)
                run(["bash", "-e"], commands_of(commands[-1]), folder)
            kept[commands] = folder
        return kept[commands]

    return folder_after


@pytest.mark.parametrize(
    "tutorial",
    [
        pytest.param(path, id=path.stem, marks=[pytest.mark.slow] if path.stem in SLOW else [])
        for path in TUTORIALS
    ],
)
def test_a_tutorial_runs_as_it_is_printed(tutorial, begun, tmp_path):
    printed = cells(tutorial)
    first = next(k for k, cell in enumerate(printed) if not cell.startswith("%%bash"))
    shutil.copytree(begun(tuple(printed[:first])), tmp_path, dirs_exist_ok=True)
    run_cells(printed[first:], tmp_path)


def test_the_first_tutorial_runs_on_some_of_its_files(tmp_path):
    """The corpus takes a minute to measure; what follows is as printed, but for the size of its balls."""
    printed = cells(REPOSITORY / "docs/tutorials/corpus.md")
    assert "manifold corpus corpus --rgb" in printed[0]
    assert sum("size=128" in cell for cell in printed) == 1
    printed = [cell.replace("size=128", "size=16") for cell in printed]
    (tmp_path / "corpus").mkdir()
    for name in {*NAMES[:2], *re.findall(r'"(syn_\w+)"', "".join(printed))}:
        write_bsdf(tmp_path / "corpus" / f"{name}_rgb.bsdf", measured(name))
    run_cells(printed[1:], tmp_path)


def run_cells(printed, folder):
    """Cells one after the other in one Python, those of commands by a shell."""
    python = ""
    for cell in printed:
        if cell.startswith("%%bash"):
            script = commands_of(cell)
            python += (
                f"__import__('subprocess').run(['bash', '-e'], input={script!r}, text=True, check=True)\n"
            )
        else:
            python += cell
    run([sys.executable, "-"], python, folder)


def test_tutorials_make_all_that_they_read():
    for tutorial in TUTORIALS:
        assert "os.environ" not in tutorial.read_text(encoding="utf-8"), tutorial.name
        assert "remove-" not in tutorial.read_text(encoding="utf-8"), tutorial.name
        made = ("manifold corpus ", "manifold predict vch_ultra_pink ")  # the corpus, or a built-in material
        assert cells(tutorial)[0].removeprefix("%%bash\n").startswith(made), tutorial.name
