"""What the documents name is there."""

from __future__ import annotations

import importlib
import re

import pytest
import typer
from helpers.paths import REPOSITORY

DOCUMENTS = [
    *(REPOSITORY / name for name in ("README.md", "ARCHITECTURE.md")),
    *sorted((REPOSITORY / "docs").rglob("*.md")),
]
FOLDERS = ("manifold", "cli", "tests", "benchmarks", "tools", "docs")


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_paths_and_modules_in_documents_exist(document):
    text = document.read_text(encoding="utf-8")
    paths = re.findall(rf"`((?:{'|'.join(FOLDERS)})/[\w./-]*)`", text)
    links = re.findall(r"\]\((?!https?:)([^)#]+)\)", text)
    missing = [path for path in paths if not (REPOSITORY / path).exists()]
    missing += [link for link in links if not (document.parent / link).exists()]
    assert not missing
    for name in re.findall(r"`(manifold(?:\.\w+)+)`", text):
        module, _, last = name.rpartition(".")
        assert hasattr(importlib.import_module(module), last) or importlib.import_module(name), name


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_options_of_commands_in_documents_exist(document):
    from manifold.cli.main import app

    commands = typer.main.get_command(app).commands
    text = document.read_text(encoding="utf-8")
    for name, line in re.findall(r"(?:`|^ *)(?:\$ )?manifold ([a-z]+)([^`\n#]*)", text, flags=re.MULTILINE):
        if name in commands:
            known = {o for p in commands[name].params for o in (*p.opts, *p.secondary_opts)}
            unknown = set(re.findall(r"(?<![\w-])--?[a-z][a-z-]*", line)) - known
            assert not unknown, f"manifold {name}{line}"
