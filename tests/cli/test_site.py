"""What the documentation site makes of formulas; skipped without the extra `docs` and KaTeX."""

from __future__ import annotations

import importlib.util
import re

import pytest
from helpers.paths import REPOSITORY

pytest.importorskip("sphinx", reason="the extra docs is not installed")
_spec = importlib.util.spec_from_file_location("formulas", REPOSITORY / "docs" / "formulas.py")
formulas = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(formulas)

pytestmark = pytest.mark.skipif(
    not formulas.DIST.is_dir(), reason="KaTeX is not installed: tools/setup.sh docs"
)


def mathml(tex):
    return re.sub(
        r"<annotation.*?</annotation>", "", formulas.to_html(tex, display=False).split("</math>")[0]
    )


def test_one_half_without_braces_is_one_half():
    assert mathml(r"\tfrac12 \log K") == mathml(r"\tfrac{1}{2} \log K")
    assert "<mn>1</mn><mn>2</mn>" in mathml(r"\tfrac12 \log K")


def test_indices_of_accented_letters_stand_beside_them():
    assert "<msubsup><mover" in mathml(r"\hat y_q^{1/3}")


def test_equations_beside_each_other_are_converted_one_by_one():
    assert formulas.parts_of(r"a = b, \qquad c = d") == ["a = b, ", " c = d"]
    whole = r"\begin{aligned} a &= b \qquad c \end{aligned}"
    assert formulas.parts_of(whole) == [whole]


def test_a_formula_with_an_unknown_command_is_an_error():
    with pytest.raises(Exception, match=r"\\unknown"):
        formulas.to_html(r"\unknown{x}", display=True)
