"""The distributions: what the archive of the sources holds, and a wheel made from it in an environment of its own."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tarfile
import venv
from pathlib import Path

import pytest
from helpers.paths import REPOSITORY
from helpers.small_library import NAMES, measured

from manifold.io_rgl import write_bsdf

pytestmark = pytest.mark.slow

COMMANDS = (
    ("import", "files"),
    ("embed",),
    ("predict", "--latent", "0.1,0.1", "-o", "made.bsdf"),
    ("map", "-o", "map.png"),
    ("info", "model.h5"),
)
RENDER = ("render", "made.bsdf", "--size", "24", "--samples", "4", "-o", "made.png")


def python(executable, *arguments, cwd, **options):
    done = subprocess.run(
        [str(executable), *map(str, arguments)],
        cwd=cwd,
        capture_output=True,
        text=True,
        check=False,
        **options,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    """The unpacked archive of the sources."""
    folder = tmp_path_factory.mktemp("sources")
    unwanted = (".git", ".venv", "build", "dist", "demo", "*.egg-info", "__pycache__", ".*_cache", "results")
    shutil.copytree(REPOSITORY, folder / "copy", ignore=shutil.ignore_patterns(*unwanted))
    script = f"from setuptools import build_meta; print(build_meta.build_sdist({str(folder)!r}))"
    name = python(sys.executable, "-c", script, cwd=folder / "copy").splitlines()[-1]
    with tarfile.open(folder / name) as archive:
        archive.extractall(folder / "unpacked", filter="data")
    return next((folder / "unpacked").iterdir())


@pytest.fixture(scope="module")
def environment(sources, tmp_path_factory):
    """An environment with the wheel and, from where this test runs, what it depends on; its folder of programs."""
    folder = tmp_path_factory.mktemp("wheel")
    pip = ("-m", "pip", "--disable-pip-version-check", "--no-input")
    build = (*pip, "wheel", "--no-deps", "--no-build-isolation", "-w", folder, sources)
    python(sys.executable, *build, cwd=folder)
    venv.create(folder / "environment", with_pip=False, symlinks=True)
    interpreter = folder / "environment" / "bin" / "python"
    wheel = next(folder.glob("*.whl"))
    python(
        sys.executable, *pip, "--python", interpreter, "install", "--no-deps", "--no-index", wheel, cwd=folder
    )
    own = Path(python(interpreter, "-c", "import site; print(site.getsitepackages()[0])", cwd=folder).strip())
    # Folders that a .pth file adds have no .pth files of their own read: an editable install here stays unseen.
    (own / "dependencies.pth").write_text("\n".join(p for p in sys.path if p.endswith("-packages")) + "\n")
    return interpreter.parent


@pytest.fixture
def files(tmp_path):
    (tmp_path / "files").mkdir()
    for name in NAMES[:4]:
        write_bsdf(tmp_path / "files" / f"{name}_rgb.bsdf", measured(name))
    return tmp_path


def test_the_archive_of_the_sources_holds_what_the_tests_need(sources):
    expected = {path.name for path in (REPOSITORY / "tests").glob("*.py")}
    assert {path.name for path in (sources / "tests").glob("*.py")} == expected
    for name in ("Makefile", "README.md", "docs/reference/glossary.md", "tools/setup.sh", "cli/main.py"):
        assert (sources / name).is_file(), name


def test_a_wheel_brings_the_package_and_no_module_named_cli(environment, tmp_path):
    script = "import manifold.cli.main as main, manifold; from importlib.util import find_spec as find\n"
    script += "print(manifold.__file__, find('cli'))"
    place, cli = python(environment / "python", "-c", script, cwd=tmp_path).split()
    assert Path(place).is_relative_to(environment.parent)
    assert cli == "None"


def test_the_program_of_a_wheel_works(environment, files):
    for words in (*COMMANDS, RENDER):
        python(environment / "manifold", *words, cwd=files)
    assert (files / "made.png").stat().st_size > 500


def test_the_program_of_a_wheel_works_without_mitsuba(environment, files):
    (files / "mitsuba.py").write_text("raise ImportError('no wheel for this platform')")
    script = "import sys; sys.path.insert(0, '.'); from manifold.cli.main import run; run(sys.argv[1:])"
    for words in COMMANDS:
        python(environment / "python", "-c", script, *words, cwd=files)
    done = subprocess.run(
        [environment / "python", "-c", script, *RENDER],
        cwd=files,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert "need Mitsuba, which is not installed (no wheel for this platform)" in done.stderr
