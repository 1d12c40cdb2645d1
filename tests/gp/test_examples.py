"""Examples in docstrings give what they say."""

from __future__ import annotations

import doctest
from importlib import import_module

import pytest

MODULES = (
    "manifold.dls", "manifold.gplvm", "manifold.gp.estimators", "manifold.core.mapping", "manifold.core.metrics",
    "manifold.analytic.base", "manifold.brdf.goniometer", "manifold.colour.conversion",
    "manifold.colour.difference", "manifold.colour.reflectances", "manifold.formats.geometries",
    "manifold.formats.readings", "manifold.gpr", "manifold.gp.kernels",
    "manifold.gp.nonnegative", "manifold.render.images",
)  # fmt: skip


@pytest.mark.parametrize("name", MODULES)
def test_examples_give_what_they_say(name):
    result = doctest.testmod(import_module(name))
    assert result.attempted > 0
    assert result.failed == 0
