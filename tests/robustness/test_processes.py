"""Forks, kills and variants: what a process does to others, and to what its user has set."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import numpy as np
import pytest
from helpers.small_library import measured

from manifold.core.errors import RendererError
from manifold.pictures import figures
from manifold.render import backend
from manifold.render.ball import render_material
from manifold.render.render import RenderSettings

FORK = """
import os, signal, sys
import numpy as np
from manifold.analytic.base import Lambert
from manifold.brdf.goniometer import measure
from manifold.brdf.measured import MeasuredBRDF
from manifold.core.records import Bands
material = MeasuredBRDF(measure(Lambert(np.full(3, 0.5), Bands(None)), "grey", resolution=8, n_theta_i=4))
w = np.tile([0.0, 0.6, 0.8], (1000, 1))
before = material.eval(w, w)
pid = os.fork()
if pid == 0:
    signal.alarm(60)
    np.testing.assert_array_equal(material.eval(w, w), before)
    os._exit(0)
sys.exit(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))
"""


def test_a_fork_evaluates_what_its_parent_did():
    ended = subprocess.run([sys.executable, "-c", FORK], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr


def test_a_fork_of_a_process_that_rendered_is_refused_instead_of_hanging():
    backend.mitsuba("rgb", backend.Backend("scalar"))
    pid = os.fork()
    if pid == 0:
        signal.alarm(20)
        try:
            backend.mitsuba("spectral", backend.Backend("scalar"))
        except RendererError as error:
            os._exit(0 if "spawn" in str(error) else 1)
        os._exit(2)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0


def test_rendering_leaves_the_users_variant(monkeypatch):
    mi = backend.mitsuba_of_any_variant()
    before = mi.variant()
    for variant in ("scalar_rgb", "scalar_mono"):
        if variant not in mi.variants():
            continue
        mi.set_variant(variant)
        render_material(measured("syn_felt_green"), RenderSettings(size=8, samples=1))
        assert mi.variant() == variant
    mi.set_variant(before)  # else every render of the tests that follow would set it twice


@pytest.mark.parametrize("name", ["$x_1$", r"\$", "100 $ paint_$"])
def test_names_with_dollars_are_drawn(tmp_path, name):
    figure = figures.new_figure(2, 2)
    axes = figure.add_subplot()
    axes.set_title(figures.shortened(name))
    axes.plot(np.arange(3), label=figures.shortened(name))
    axes.legend()
    figures.save(figure, tmp_path / "x.png")
    assert (tmp_path / "x.png").stat().st_size > 1000
