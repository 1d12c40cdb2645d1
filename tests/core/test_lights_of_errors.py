"""Every printed colour difference names its lights: the mean of five, or one by its name."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from manifold.colour.panel import JUDGED
from manifold.core.judged_lights import BALL, BALL_COLUMN
from manifold.core.judged_lights import LIGHTS as NUMBER
from manifold.core.metrics import Errors

ROOT = Path(__file__).parents[2]
LIGHTS = re.compile(r"\blights?\b|D65|DAYLIGHT|\bsun\b|studio|viewing|\bBALL\b|LIGHTS|self\.errors")
NAMED_BESIDE = {
    ("manifold/evaluate/report_text.py", "CIEDE2000"),  # the note below the table names them
    ("manifold/pictures/renders.py", "CIEDE2000 of the ball"),  # the row of the light
    ("manifold/pictures/renders.py", "CIEDE2000 of the picture"),
    ("cli/fit_commands.py", "CIEDE2000 of the ball"),  # the value of the row, `Errors` in words
    ("cli/fit_commands.py", "f'CIEDE2000 of the ball in {name}'"),  # likewise
    ("manifold/fit/principled.py", "CIEDE2000 of the ball"),  # likewise
    ("manifold/convert/contents.py", "CIEDE2000 of the ball"),  # likewise
}
"""Texts whose lights stand beside them."""


def texts(path):
    """Yield the strings of a module that are no docstrings; those with values as they are written."""
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    docstrings = {node.value for node in nodes if isinstance(node, ast.Expr)}
    joined = [node for node in nodes if isinstance(node, ast.JoinedStr)]
    parts = {part for node in joined for part in ast.walk(node)} - set(joined)
    for node in nodes:
        if isinstance(node, ast.JoinedStr):
            yield ast.unparse(node)
        elif (
            isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in docstrings | parts
        ):
            yield node.value


def test_every_text_with_a_colour_difference_names_its_lights():
    unnamed = {
        (path.relative_to(ROOT).as_posix(), text)
        for folder in ("manifold", "cli")
        for path in (ROOT / folder).rglob("*.py")
        for text in texts(path)
        if "CIEDE2000" in text and not LIGHTS.search(text)
    }
    assert unnamed == NAMED_BESIDE


def test_every_text_of_the_page_does_likewise():
    for path in sorted((ROOT / "manifold" / "page").glob("*.js")):
        for text in re.findall(r"[`\"][^`\"\n]*CIEDE2000[^`\"\n]*[`\"]", path.read_text(encoding="utf-8")):
            assert LIGHTS.search(text), (path.name, text)


def test_the_mean_is_of_five_lights():
    assert len(JUDGED) == 5
    assert NUMBER == "five lights"
    assert all(NUMBER in words for words in (BALL, BALL_COLUMN))
    errors = Errors.of_lights({"studio 0": 1.0, "sun 45": 3.0}, 2.0)
    assert str(errors) == "2.00 (mean of five lights), worst 3.00 (sun 45 degrees from the view)"
    assert errors.words == [f"2.0 {BALL}", "3.0 in the worst light (sun 45 degrees from the view)"]
