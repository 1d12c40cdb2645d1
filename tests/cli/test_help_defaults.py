"""Defaults in helps: none is written by hand beside the code that has it."""

from __future__ import annotations

import ast
import re

import pytest
from helpers.paths import REPOSITORY

from manifold import registries
from manifold.core import defaults

COMMANDS = sorted((REPOSITORY / "cli").glob("*.py"))
NAMES = {
    name
    for registry in vars(registries).values()
    if isinstance(registry, registries.Registry)
    for name in registry
}
PHRASE = re.compile(r"\[default[^:\]]*:([^\]]*)\]|by default ([^,;.]*)|([^,;:]*) by default", re.DOTALL)


def texts(source: str) -> list[str]:
    """Return the string literals of a module, with `{}` for what an f-string computes."""
    tree = ast.parse(source)
    parts = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    documents = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            found.append("".join(p.value if isinstance(p, ast.Constant) else "{}" for p in node.values))
        elif (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and id(node) not in parts | documents
        ):
            found.append(node.value)
    return found


def by_hand(source: str) -> list[str]:
    """Return the defaults in texts of a module that name a number, a file, or an entry of a registry."""
    found = []
    for text in texts(source):
        for phrase in PHRASE.finditer(text):
            said = re.sub(r"\{[^}]*\}", "", next(part for part in phrase.groups() if part is not None))
            words = set(re.findall(r"[\w-]+", said))
            if re.search(r"\d|[a-z]\.\w", said) or words & NAMES:
                found.append(said.strip())
    return found


@pytest.mark.parametrize("path", COMMANDS, ids=lambda path: path.name)
def test_defaults_in_helps_come_from_the_code_that_has_them(path):
    assert by_hand(path.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    ("written", "found"),
    [
        ('help="Rounds. [default: 300]"', ["300"]),
        ('help="Kernel. [default: se]"', ["se"]),
        ('help="The file. [default: made.bsdf, or files]"', ["made.bsdf, or files"]),
        ('help="Nodes; 64 by default"', ["64"]),
        ('help="Rounds. [default: {manifold.core.defaults.MOST_LAID_OUT}]"', []),
        ('help=f"The file. [default: {NAME}, or files]"', []),
        ('help="The outline. [default: estimated]"', []),
    ],
)
def test_the_check_finds_defaults_that_are_written_by_hand(written, found):
    assert by_hand(f"Option({written})") == found


def test_a_changed_default_changes_the_help(run, monkeypatch, tmp_path):
    monkeypatch.setattr(defaults, "SHADER_TOLERANCE", 0.7)
    monkeypatch.setattr(defaults, "REPEATABILITY", 0.005)
    assert "[default: 0.7]" in " ".join(run("export", "--help-all", cwd=tmp_path)[1].split())
    assert "0.50% for spectrophotometers" in " ".join(run("complete", "--help-all", cwd=tmp_path)[1].split())
