"""What users may rely on: the names in the `__init__.pyi` of packages, each with a line in the reference."""

from __future__ import annotations

import ast
import inspect
import re
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
REFERENCE = ROOT / "docs" / "reference" / "python.md"


def public_names():
    """Packages and names of their stubs, sorted."""
    for stub in sorted((ROOT / "manifold").rglob("__init__.pyi")):
        package = ".".join(stub.parent.relative_to(ROOT).parts)
        tree = ast.parse(stub.read_text(encoding="utf-8"))
        listed = [ast.literal_eval(n.value) for n in tree.body if isinstance(n, ast.Assign)]
        yield from ((package, name) for name in sorted(listed[0], key=str.lower))


def summary(package, name):
    """The first line of a public object's docstring; of a registry, what it is of."""
    found = getattr(import_module(package), name)
    if isinstance(found, dict):
        return f"Every {found.what}, by name: {found}."
    return (inspect.getdoc(found) or "").split("\n")[0]


@pytest.mark.parametrize(("package", "name"), list(public_names()))
def test_every_public_name_is_explained_in_one_line_of_the_reference(package, name):
    if name == "MapWidget":
        pytest.importorskip("anywidget")
    said = summary(package, name)
    assert said.endswith("."), said
    assert f"| `{package}.{name}` | {said.replace('|', '/')} |" in REFERENCE.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "path",
    [
        "README.md",
        "docs/reference/python.md",
        *sorted(str(path.relative_to(ROOT)) for path in (ROOT / "docs" / "examples").glob("*.py")),
    ],
)
def test_pages_for_users_import_public_names_alone(path):
    known = {f"{package}.{name}" for package, name in public_names()}
    text = (ROOT / path).read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL) if path.endswith(".md") else [text]
    for node in ast.walk(ast.parse("\n".join(blocks))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("manifold"):
            assert {f"{node.module}.{each.name}" for each in node.names} <= known
