"""A satin and a glossy material as shaders, and a browser."""

from __future__ import annotations

import pytest
from helpers.browser import chromium
from helpers.small_library import measured

from manifold.shader import code
from manifold.shader.exporting import make_shader
from manifold.shader.lobes import fit_lobes
from manifold.shader.table import Shape, tabulate


@pytest.fixture(scope="session")
def satin():
    """A satin gold as a shader, within the default tolerance."""
    return make_shader(measured("syn_satin_gold"))


@pytest.fixture(scope="session")
def gloss():
    """A red under a gloss coat, whose highlight is sharp."""
    return make_shader(measured("syn_gloss_red"))


@pytest.fixture(scope="session")
def reduced(satin):
    """The satin gold as a table of half of its incidences, like those of predictions."""
    file = measured("syn_satin_gold")
    shape = Shape.of(5, 24, 32, 16, 128)
    return tabulate(file, shape, fit_lobes(satin.source, file.theta_i_rad))


@pytest.fixture(scope="session")
def glsl(satin):
    """The code of the satin gold."""
    return code.glsl(satin.table, satin.name)


@pytest.fixture(scope="module")
def browser():
    """Chromium, or skipped tests."""
    with chromium() as started:
        yield started
