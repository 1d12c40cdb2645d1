"""What the documents name is there."""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
import re
import tomllib

import pytest
import typer
from helpers.paths import REPOSITORY

DOCUMENTS = [
    *(REPOSITORY / name for name in ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md")),
    *(
        path
        for path in sorted((REPOSITORY / "docs").rglob("*.md"))
        if not {"_build", "_work", "gallery", "generated", "api"} & {*path.parts}
        and path.name not in ("api.md", "commands.md")
    ),
]
_spec = importlib.util.spec_from_file_location("figures", REPOSITORY / "docs" / "figures.py")
_module = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(_module)
figures, NAMED = _module.figures, _module.NAMED
FOLDERS = ("manifold", "cli", "tests", "benchmarks", "tools", "docs")


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_paths_and_modules_in_documents_exist(document):
    text = document.read_text(encoding="utf-8")
    paths = re.findall(rf"`((?!docs/_build)(?:{'|'.join(FOLDERS)})/[\w./-]*)`", text)
    links = re.findall(r"\]\((?!https?:)([^)#]+)\)", text)
    missing = [path for path in paths if not (REPOSITORY / path).exists()]
    generated = {"api.md"}  # by docs/conf.py
    missing += [link for link in links if link not in generated and not (document.parent / link).exists()]
    assert not missing
    for name in re.findall(r"`(manifold(?:\.(?!glsl|hlsl|metal|ktx2|json)\w+)+)`", text):
        module, _, last = name.rpartition(".")
        assert hasattr(importlib.import_module(module), last) or importlib.import_module(name), name


ARCHITECTURE = (REPOSITORY / "ARCHITECTURE.md").read_text(encoding="utf-8")
DRAWN = r"^.{19} *(\w+(?: · \w+)*)(?: {2,}|$)"  # names in the picture of the floors


def test_modules_and_functions_in_the_architecture_exist():
    """There, names of the package stand without it: `model.places.Place`, and all in the picture of the floors."""
    folders = {path.stem for path in (REPOSITORY / "manifold").iterdir()}
    named = re.findall(r"`([a-z_]+(?:\.[A-Za-z_]+)+)`", ARCHITECTURE)
    named = [name for name in named if name.split(".")[0] in folders]
    drawn = re.findall(DRAWN, ARCHITECTURE.split("```")[1], flags=re.MULTILINE)
    floors = [name for floor in drawn for name in floor.split(" · ")]
    assert len(named) > 30
    assert len(floors) > 20
    for name in (*named, *floors):
        pkgutil.resolve_name(f"manifold.{name}")


def test_floors_of_the_architecture_are_the_layers_that_import_linter_checks():
    floors = re.split(r"^(?=\d)", ARCHITECTURE.split("```")[1], flags=re.MULTILINE)[1:]
    lines = [re.findall(DRAWN, floor, flags=re.MULTILINE) for floor in floors]
    drawn = [{name for names in floor for name in names.split(" · ")} for floor in lines]
    contracts = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["tool"][
        "importlinter"
    ]
    layers = [set(re.findall(r"\w+", layer)) - {"__main__"} for layer in contracts["contracts"][0]["layers"]]
    assert len(layers) == 8
    assert drawn == layers


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_options_of_commands_in_documents_exist(document):
    from manifold.cli.main import app

    commands = typer.main.get_command(app).commands
    text = document.read_text(encoding="utf-8")
    for name, line in re.findall(r"(?:`|^ *)(?:\$ )?manifold ([a-z]+)([^`\n#]*)", text, flags=re.MULTILINE):
        if name in commands:
            known = {"--help"} | {o for p in commands[name].params for o in (*p.opts, *p.secondary_opts)}
            unknown = set(re.findall(r"(?<![\w-])--?[a-z][a-z-]*", line)) - known
            assert not unknown, f"manifold {name}{line}"


# Numbers with a unit or a decimal point are measured figures, which come from benchmarks/results. What is defined, not
# measured, stands in code or mathematics, and versions of programs follow a name.
FIGURE = re.compile(
    r"(?<![\w.,])(?:\d[\d,.]* / \d[\d,. /]*\d|\d[\d,]*\.\d+"
    r"|\d[\d,.]* ?(?:%|m?s|[kMG]?B|seconds|minutes|times|CIEDE2000))(?!\w)"
)
NOT_FIGURES = re.compile(
    r"^---\n.*?\n---\n|<!-- results -->.*?<!-- end of results -->|```.*?```|\$\$.*?\$\$|\$[^$]+\$"
    r"|`[^`\n]+`|\]\([^)]*\)|<!--.*?-->|[A-Z]\w* \d+\.\d+(?:\.\d+)*|^ {4}[^\n]*",
    flags=re.DOTALL | re.MULTILINE,
)


def measured_figures(document):
    """Numbers of a page that look as if somebody had measured them, but do not name their result."""
    return FIGURE.findall(NOT_FIGURES.sub(" ", NAMED.sub(" ", document.read_text(encoding="utf-8"))))


@pytest.mark.parametrize(
    "document",
    [
        d
        for d in DOCUMENTS
        if d.name in ("README.md", "installation.md") or d.parent.name in ("explanation", "how-to")
    ],
    ids=lambda path: path.name,
)
def test_figures_in_pages_are_those_of_the_results(document):
    assert measured_figures(document) == []
    held = figures()
    named = NAMED.findall(document.read_text(encoding="utf-8"))
    assert [(value, name) for value, name in named if held.get(name) != value] == []


def test_rounding_errors_of_sums_are_shown_as_zero():
    assert _module.shown(7.1e-15) == "0"
    assert _module.shown(0.00312) == "0.0031"
