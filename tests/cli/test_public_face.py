"""What `import manifold` offers, and what it costs."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import inspect
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import typer
from helpers.paths import REPOSITORY
from helpers.small_library import NAMES, measured
from surface.surface_twins import workbook

import manifold
from manifold.cli import application
from manifold.cli.main import app
from manifold.io_rgl import write_bsdf
from manifold.render import backend

PACKAGES = sorted(
    ".".join(file.parent.relative_to(REPOSITORY).parts)
    for file in (REPOSITORY / "manifold").rglob("__init__.pyi")  # which lists what is public
)
NAMES_OF = [
    (package, name)
    for package in PACKAGES
    for name in sorted(importlib.import_module(package).__all__, key=str.lower)
]
REFERENCE = (REPOSITORY / "docs/reference/python.md").read_text(encoding="utf-8")
IN_PYTHON = REFERENCE.split("## A tour")[1].split("\n## ")[0]


@pytest.mark.parametrize("package", PACKAGES)
def test_every_package_lists_its_names_and_has_them(package):
    module = importlib.import_module(package)
    assert module.__all__
    for name in module.__all__:
        assert getattr(module, name) is not None
    with pytest.raises(AttributeError, match="no_such_name"):
        module.no_such_name  # noqa: B018


def reference_pages():
    """The module that writes the reference."""
    spec = importlib.util.spec_from_file_location("reference_pages", REPOSITORY / "docs/reference_pages.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_public_name_has_an_example():
    named = [name for page in reference_pages().read_examples().values() for name in page.examples]
    assert sorted(named) == sorted(f"{package}.{name}" for package, name in NAMES_OF)


def test_the_reference_of_commands_has_every_option_in_the_order_of_the_groups(tmp_path, monkeypatch):
    pages = reference_pages()
    monkeypatch.setattr(pages, "REFERENCE", tmp_path)
    pages.write_commands()
    written = (tmp_path / "commands.md").read_text(encoding="utf-8")
    assert re.findall(r"^### (.*)$", written, re.MULTILINE) == list(application.COMMANDS)
    helps = dict(zip(application.COMMANDS, written.split("\n### ")[1:], strict=True))
    for name, command in typer.main.get_command(app).commands.items():
        shown = [p for p in command.params if p.param_type_name == "option" and not p.hidden]
        assert [p.opts[0] for p in shown if p.opts[0] not in helps[name]] == []


@pytest.mark.parametrize(("package", "name"), NAMES_OF)
def test_every_public_name_is_described_by_a_sentence(package, name):
    value = getattr(importlib.import_module(package), name)
    assert isinstance(value, dict) or inspect.getdoc(value).split("\n")[0].endswith(".")


@pytest.mark.slow
@pytest.mark.skipif(not backend.is_available(), reason="Mitsuba is not installed")
def test_the_examples_of_the_reference_run(tmp_path, monkeypatch):
    (tmp_path / "corpus").mkdir()
    for name in NAMES:
        write_bsdf(tmp_path / "corpus" / f"{name}_rgb.bsdf", measured(name))
    workbook(tmp_path / "sample.xlsx", np.random.default_rng(0))
    monkeypatch.chdir(tmp_path)
    after: dict[str, dict[str, object]] = {}
    for package, page in reference_pages().read_examples().items():
        after[package] = {}
        exec("\n".join([page.setup, *page.examples.values()]), after[package])
    assert after["manifold.model"]["errors"].ball < 5.0  # a material of the library, described by all of it
    assert after["manifold.surface"]["written"].name


@pytest.mark.parametrize(
    "path", ["README.md", "docs/reference/python.md", *sorted((REPOSITORY / "docs/examples").glob("*.py"))]
)
def test_pages_for_users_import_public_names_alone(path):
    known = {f"{package}.{name}" for package, name in NAMES_OF}
    text = (REPOSITORY / path).read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL) if str(path).endswith(".md") else [text]
    for node in ast.walk(ast.parse("\n".join(blocks))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("manifold"):
            assert {f"{node.module}.{each.name}" for each in node.names} <= known


def test_importing_the_package_is_quick_and_loads_nothing_heavy():
    script = (
        "import sys, time; start = time.process_time(); import manifold; seconds = time.process_time() - start\n"
        "heavy = {'mitsuba', 'drjit', 'zarr', 'matplotlib', 'colour', 'sklearn', 'numpy'} & set(sys.modules)\n"
        "print(seconds, *heavy)"
    )
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    seconds, *heavy = run.stdout.split()
    assert heavy == []
    assert float(seconds) < 0.3  # of processor time, which other processes hardly change


def test_the_tour_of_the_reference_runs(tmp_path, monkeypatch):
    (tmp_path / "corpus").mkdir()
    for name in NAMES:
        write_bsdf(tmp_path / "corpus" / f"{name}_spec.bsdf", measured(name))
    script = "".join(re.findall(r"```python\n(.*?)```", IN_PYTHON, flags=re.DOTALL))
    assert 'illuminant="F11"' in script  # which the RGB materials of this test do not take
    script = script.replace("size=256", "size=24, samples=4").replace('illuminant="F11"', 'illuminant="D65"')
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(script, names)
    assert names["picture"].shape == (24, 24, 3)
    assert set(names["fit"].values) >= {"base_color", "roughness"}
    assert Path("halfway_spec.bsdf").is_file()
    wi, wo = names["wi"], names["wo"]
    read, completed = (each.eval(wi, wo) for each in (names["brdf"], names["completed"].brdf))
    assert manifold.core.metrics.cube_root_error(read, completed) < 0.05  # at what was read
    assert names["found"].relative_error < 0.05  # of the library itself: the posterior beside the material
    assert Path("corpus.h5").is_file()
    n = len(NAMES)
    assert repr(manifold.Library.open("corpus.zarr")) == f"<Library: corpus.zarr, {n} materials, RGB>"
    assert repr(names["model"]).startswith(f"<Manifold: {n} materials, RGB, 2 dimensions, kind blend")
    assert repr(names["halfway"]).startswith("<PredictedBRDF: RGB, of syn_")
    assert repr(names["brdf"]) == "MeasuredBRDF('syn_satin_gold', RGB)"


def test_a_library_that_went_away_can_still_be_printed(tmp_path):
    library = manifold.Library.create(tmp_path / "library.zarr", manifold.Bands(None))
    shutil.rmtree(library.path)
    assert repr(library) == "<Library: library.zarr, cannot be read, RGB>"
