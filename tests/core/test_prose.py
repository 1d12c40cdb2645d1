"""The check of formulas finds fractions that some converters misread."""

from __future__ import annotations

import prose
import pytest


@pytest.mark.parametrize("formula", [r"\tfrac12 K", r"\frac14\,", r"\dfrac 1 2"])
def test_fractions_without_braces_are_found(tmp_path, formula):
    (tmp_path / "README.md").write_text(f"# Title\n\nThe value is ${formula}$.\n")
    assert [place[:2] for place in prose.unbraced_fractions(tmp_path / "README.md")] == ["3:"]


@pytest.mark.parametrize("formula", [r"\tfrac{1}{2} K", r"\frac{14}{15}", r"\frac1n", "12/15"])
def test_other_fractions_pass(tmp_path, formula):
    (tmp_path / "README.md").write_text(f"${formula}$\n")
    assert list(prose.unbraced_fractions(tmp_path / "README.md")) == []


def test_documents_are_those_of_the_repository(tmp_path):
    for name in ("README.md", "docs/page.md", "docs/_build/html/page.md"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("# Title\n")
    assert [path.name for path in prose.documents(tmp_path)] == ["README.md", "page.md"]
