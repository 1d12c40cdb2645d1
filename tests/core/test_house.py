"""The search for circular imports: it sees annotations, functions and relative imports; the package has no circle."""

from __future__ import annotations

import house
import pytest


@pytest.mark.parametrize(
    ("back", "in_functions"),
    [
        ("from manifold.first import A", False),
        ("from .first import A", False),
        ("from . import first", False),
        ("if TYPE_CHECKING:\n    from manifold.first import A", False),
        ("def f():\n    from manifold.first import A", True),
    ],
)
def test_two_modules_that_import_each_other_are_a_circle(back, in_functions):
    files = {
        "manifold/__init__.py": "", "manifold/first.py": "import manifold.second", "manifold/second.py": back,
    }  # fmt: skip
    assert house.circles(house.imports(files, in_functions=True)) == [["manifold.first", "manifold.second"]]
    assert len(house.circles(house.imports(files, in_functions=False))) == (not in_functions)


def test_the_package_has_no_circle():
    assert house.print_circles(house.sources(None)) == 0
