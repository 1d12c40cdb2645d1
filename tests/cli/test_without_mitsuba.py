"""Commands without Mitsuba: those that `test_core_alone` does not run, and what says that it is missing."""

from __future__ import annotations

import json

import pytest
from helpers.one_process import run_together
from helpers.small_library import NAMES, small_library
from PIL import Image

from manifold.render.bsdf_parameters import BsdfFamily, FreeParameter

ONCE = "from manifold.evaluate import held_out; held_out._REPEATS = 1"  # no time is looked at
CORPUS = """
from manifold.analytic import corpus
from manifold.core.records import Bands
every = (*corpus.isotropic_materials(), *corpus.anisotropic_materials())
print(len([material.truth(Bands((450.0, 550.0, 650.0))) for material in every]))
"""

WORKS = {
    "import": ["import", "files"],
    "embed": ["embed"],
    "predict": ["predict", "--latent", "0.1,0.1", "--srgb", "#c87832", "-o", "made.bsdf"],
    "slices": ["slices", "made.bsdf", "syn_satin_gold"],
    "map": ["map", "--mark", "0.1,0.1"],
    "compare": ["compare", "one.png", "other.png"],
    "chart": ["chart", "--only", "nearest", "--only", "fit_gauss-newton"],
    "fit": ["fit", "made.bsdf"],
    "fit by Adam": ["fit", "made.bsdf", "--method", "adam", "--free", "base_color", "-o", "adam.fit.json"],
    "export of a fit": ["export", "made.fit.json"],
    "report of fits": ["report", "--principled"],
}
FAILS = {
    "render": ["render", "made.bsdf"],
    "walk": ["walk", "syn_satin_gold", "syn_gloss_red"],
    "fit of another BSDF": ["fit", "made.bsdf", "--bsdf", "metal.json"],
    "budget": ["budget", "--example", "felt"],
}


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory):
    """Status, stdout and stderr of every command, run in one process one after the other, then the corpus's size."""
    folder = tmp_path_factory.mktemp("without")
    small_library(folder, names=NAMES[2:], library=folder / "other.zarr")  # as few as a chart takes
    for name, grey in (("one", 100), ("other", 120)):
        Image.new("RGB", (32, 32), (grey, grey, grey)).save(folder / f"{name}.png")
    free = FreeParameter("alpha", 0.01, 1.0, 0.3)
    (folder / "metal.json").write_text(json.dumps(BsdfFamily("roughconductor", (free,)).to_json()))
    return run_together(["mitsuba", "drjit"], WORKS | FAILS, folder, ONCE, CORPUS)


@pytest.mark.parametrize("name", WORKS)
def test_commands_that_do_not_render_work_without_mitsuba(outcomes, name):
    status, _, err = outcomes[name]
    assert status == 0, err


@pytest.mark.parametrize("name", FAILS)
def test_commands_that_render_name_the_missing_package(outcomes, name):
    status, _, err = outcomes[name]
    assert status == 1
    (line,) = err.splitlines()
    assert line.startswith("manifold: rendering, and fits by --bsdf, need Mitsuba, which is not installed (")
    assert "brdf-manifold[render]" in line


def test_a_map_says_that_its_balls_are_left_out(outcomes):
    assert "left out rendered balls, because Mitsuba is missing" in " ".join(outcomes["map"][1].split())


def test_the_metals_of_the_corpus_need_no_mitsuba(outcomes):
    assert outcomes["last"] == 62
