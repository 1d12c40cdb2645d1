"""The recipe of the conda package: the version and the requirements of the wheel."""

from __future__ import annotations

import re
import tomllib

from helpers.paths import REPOSITORY

from manifold import __version__

RECIPE = (REPOSITORY / "conda" / "recipe.yaml").read_text(encoding="utf-8")
PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))


def entries(section):
    """Entries of a list of the recipe, without blanks."""
    block = re.search(rf"\n +{section}:\n((?: +- .*\n)+)", RECIPE)
    assert block is not None
    return [line.strip().removeprefix("- ").replace(" ", "") for line in block[1].splitlines()]


def test_it_has_the_version_of_the_package():
    assert f'version: "{__version__}"' in RECIPE


def test_the_recipe_requires_the_packages_of_the_wheel():
    assert entries("run") == ["python", *PROJECT["project"]["dependencies"]]
    assert entries("host") == ["python", "pip", *PROJECT["build-system"]["requires"]]


def test_the_recipe_requires_the_python_of_the_wheel():
    assert PROJECT["project"]["requires-python"] == ">=3.11"
    assert 'match(python, "<3.11")' in RECIPE
