"""Write the pages of the reference that come from the code: commands with their options, and the Python interface."""

from __future__ import annotations

import csv
import importlib
import inspect
import itertools
import json
import re
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import typer

from manifold import __version__

HERE = Path(__file__).resolve().parent
REFERENCE = HERE / "reference"
RESULTS = HERE.parent / "benchmarks" / "results"


class Page(NamedTuple):
    """The examples of a page: the code at its top, and the example of each name, in the order in which they run."""

    setup: str
    examples: dict[str, str]


def read_examples() -> dict[str, Page]:
    """Return the examples of `reference/examples.py` by package or module, and there by full name."""
    text = (REFERENCE / "examples.py").read_text(encoding="utf-8")
    sections = re.split(r"^# === (manifold(?:\.\w+)*)$", text, flags=re.MULTILINE)
    pages = {}
    for package, section in zip(sections[1::2], sections[2::2], strict=True):
        setup, *parts = re.split(r"^# (manifold(?:\.\w+)+)$", section, flags=re.MULTILINE)
        pages[package] = Page(setup.strip(), dict(zip(parts[::2], map(str.strip, parts[1::2]), strict=True)))
    return pages


def write_commands(*_: object) -> None:
    """Write the help of all commands, with all options, in the groups of `manifold --help`: reference/commands.md."""
    from manifold.cli import application
    from manifold.cli.main import app

    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    lines = [
        "# Commands",
        "",
        "This page shows the help of every command with all options, as `manifold COMMAND --help-all` prints it. "
        "[Environment variables and exit codes](environment.md) are the same for all commands.",
        "",
    ]
    application.Command.shows_all = True
    for title, names in application.GROUPS.items():
        lines += [f"## {title}", ""]
        for name in names:
            context = type(commands[name]).context_class(commands[name], info_name=f"manifold {name}")
            context.terminal_width = 80
            lines += [f"### {name}", "", "```text", commands[name].get_help(context).rstrip(), "```", ""]
    application.Command.shows_all = False
    write_if_changed(REFERENCE / "commands.md", "\n".join(lines))


def write_api(*_: object) -> None:
    """Write the Python interface, from docstrings and examples: reference/api.md, and one page per package."""
    pages = read_examples()
    lines = [
        "# Python reference",
        "",
        "These pages list signatures, parameters and examples of all names that stay the same between versions. All "
        "examples run in one folder, in the order of the pages: `manifold corpus corpus --rgb` writes the files in "
        "`corpus`, the page `manifold` makes `corpus.zarr` and `corpus.h5`, and `sample.xlsx` is an MA-T12 workbook "
        "with pictures. [Python interface](python.md) is a tour.",
        "",
        "| page | names |",
        "|---|---|",
    ]
    for package, page in pages.items():
        module = _module(package)
        names = [name.rpartition(".")[2] for name in page.examples if name != package]
        listed = ", ".join(f"`{name}`" for name in names) or _first_sentence(module)
        lines.append(f"| [`{package}`](api/{package}.md) | {listed} |")
        write_if_changed(REFERENCE / "api" / f"{package}.md", "\n".join(_page_of(package, module, page)))
    lines += ["", "```{toctree}", ":hidden:", *(f"api/{package}" for package in pages), "```", ""]
    write_if_changed(REFERENCE / "api.md", "\n".join(lines))


def _module(name: str) -> ModuleType:
    """Return a package, or a module that a package has under a name of its own."""
    package, _, attribute = name.rpartition(".")
    names = getattr(importlib.import_module(package), "__all__", ()) if package else ()
    return (
        getattr(importlib.import_module(package), attribute)
        if attribute in names
        else importlib.import_module(name)
    )


def _page_of(package: str, module: ModuleType, page: Page) -> list[str]:
    lines = [f"# {package}", "", inspect.getdoc(module) or "", ""]
    if page.setup:
        lines += ["The examples below begin with:", "", "```python", page.setup, "```", ""]
    for full, code in page.examples.items():
        if full == package:
            own = [] if hasattr(module, "__path__") else _entries_of(module)
            lines += ["```python", code, "```", "", *own]
            continue
        value = getattr(module, full.rpartition(".")[2])
        lines += [f"## {full.rpartition('.')[2]}", ""]
        if inspect.ismodule(value):
            lines += [inspect.getdoc(value) or "", "", *_entries_of(value)]
        elif callable(value):
            lines += _entry(full, value)
        else:
            lines += [f"Every {value.what}, by name.", ""]
        lines += ["```python", code, "```", ""]
    return lines


def _entries_of(module: ModuleType) -> list[str]:
    """Return the entries of a module's own public classes and functions, in the order of its source."""
    own = [
        (name, value)
        for name, value in vars(module).items()
        if callable(value) and getattr(value, "__module__", "") == module.__name__ and name[0] != "_"
    ]
    return [
        line for name, value in own if value.__doc__ for line in _entry(f"{module.__name__}.{name}", value)
    ]


def _entry(full: str, value: Any) -> list[str]:
    """Return the directive that documents a class or function."""
    kind = "autoclass" if inspect.isclass(value) else "autofunction"
    requests = ", ".join(name for name in dir(value) if re.fullmatch(r"set_\w+_request", name))
    options = ["   :members:", f"   :exclude-members: {requests}"] if kind == "autoclass" else []
    return ["```{eval-rst}", f".. {kind}:: {full}", *options, "```", ""]


def _first_sentence(module: ModuleType) -> str:
    return (inspect.getdoc(module) or "").split("\n")[0]


def write_citation(*_: object) -> None:
    """Write the BibTeX entry of this version: reference/manifold.bib."""
    entry = f"""@software{{manifold,
  author  = {{{{The manifold developers}}}},
  title   = {{manifold: whole {{BRDFs}} from a few measurements, and materials between measured ones}},
  version = {{{__version__}}},
  license = {{MIT}}
}}
"""
    write_if_changed(REFERENCE / "manifold.bib", entry)


def write_failure_modes(*_: object) -> None:
    """Write the table of failure modes, from the results of `manifold stability`: explanation/failure-modes.csv."""
    kept = json.loads((RESULTS / "stability.json").read_text(encoding="utf-8"))
    rows = []
    for mode in kept["modes"]:
        outcomes: dict[str, list[str]] = {}
        for row in kept["rows"]:
            if row["mode"] == mode["key"]:
                found = [(one["outcome"], one["severity"]) for one in row["results"]]
                changes = [f"{b} from {s:g}" for (a, _), (b, s) in itertools.pairwise(found) if a != b]
                outcomes.setdefault(", ".join([found[0][0], *changes]), []).append(row["method"])
        said = [f"{', '.join(methods)}: {outcome}" for outcome, methods in outcomes.items()]
        severity = f"{mode['severity']} ({', '.join(f'{s:g}' for s in mode['severities'])})"
        rows.append((f"{mode['key']}: {mode['concerns']}", severity, "; ".join(said), mode["advice"]))
    with (HERE / "explanation" / "failure-modes.csv").open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([("mode", "severity", "what happened", "what to do"), *rows])


def write_if_changed(target: Path, text: str) -> None:
    """Write a page, unless it stands there already: Sphinx reads changed files again."""
    if not target.exists() or target.read_text(encoding="utf-8") != text:
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text, encoding="utf-8")
