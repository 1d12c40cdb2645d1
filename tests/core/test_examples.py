"""Examples in docstrings give what they say."""

from __future__ import annotations

import doctest
import re
from importlib import import_module
from pathlib import Path

import pytest

import manifold

PACKAGE = Path(manifold.__file__).parent
EXAMPLE = re.compile(r"^\s*>>> (?!.*\+SKIP)", re.MULTILINE)
MODULES = [
    ".".join(["manifold", *path.relative_to(PACKAGE).with_suffix("").parts])
    for path in sorted(PACKAGE.rglob("*.py"))
    if EXAMPLE.search(path.read_text(encoding="utf-8"))
]


def test_all_modules_with_examples_are_found():
    assert {"manifold.gplvm", "manifold.gp.kernels", "manifold.formats.text"} <= set(MODULES)


@pytest.mark.parametrize("name", MODULES)
def test_examples_give_what_they_say(name):
    result = doctest.testmod(import_module(name))
    assert result.attempted > 0
    assert result.failed == 0
