"""`--photo` of complete and locate: from a picture to a file."""

from __future__ import annotations

import json

import numpy as np
import pytest
from helpers.small_library import measured

from manifold.brdf.measured import MeasuredBRDF
from manifold.colour.environments import environment
from manifold.io_rgl import read_bsdf, write_bsdf
from manifold.model.comparison import brdf_errors
from manifold.model.manifold import Manifold, Settings
from manifold.rendering.images import write_image
from manifold.rendering.render import render_floating_ball


@pytest.fixture(scope="module")
def folder(tmp_path_factory, library):
    """A photograph of satin gold, linear and in 8 bits, and its light."""
    made = tmp_path_factory.mktemp("photographs")
    light = environment("studio", 128)
    write_bsdf(made / "gold_rgb.bsdf", measured("syn_satin_gold"))
    ball = render_floating_ball(
        made / "gold_rgb.bsdf", True, light, size=128, samples=32, margin=0.3, distance=8.0
    )
    write_image(made / "ball.exr", ball)
    write_image(made / "light.exr", light)
    Manifold.fit(library, Settings()).save(made / "model.h5")
    return made


def test_a_photograph_is_completed(run, folder, library):
    code, out, err = run(
        "complete", "--photo", "ball.exr", "--light", "light.exr", "--distance", 8, "--library", library,
        "-o", "found.bsdf", "--picture", "--json", "found.json", cwd=folder,
    )  # fmt: skip
    assert code == 0, err
    truth, found = (MeasuredBRDF(read_bsdf(folder / name)) for name in ("gold_rgb.bsdf", "found.bsdf"))
    assert brdf_errors(truth, found).ball < 2.0
    assert (folder / "found.png").stat().st_size > 10_000
    document = json.loads((folder / "found.json").read_text())
    assert document["photographs"][0]["circle"] == pytest.approx([64, 64, 64 / 1.3], abs=1.0)
    assert document["plausibility"]["max_albedo"] <= 1.05
    assert set(document["expected"]) == {"ball", "cube_root", "linear"}
    assert "expected error" in out


def test_a_photograph_is_located_near_its_material(run, folder, library):
    code, out, err = run(
        "locate", "--photo", "ball.exr", "--light", "studio", "--distance", 8, "--circle", "64,64,49.2",
        "--library", library, "-o", "there.bsdf", cwd=folder,
    )  # fmt: skip
    assert code == 0, err
    assert "satin_gold" in out.split("nearest")[1].split("\n")[0]
    assert np.isfinite(read_bsdf(folder / "there.bsdf").spectra).all()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--photo", "ball.exr"], "--light ENV.exr"),
        (["--photo", "ball.exr", "--light", "nowhere.exr"], "no such file"),
        (["--photo", "ball.exr", "--light", "ball.exr"], "twice as wide"),
        (["--photo", "light.exr", "--light", "studio", "--circle", "900,10,40"], "expected one inside it"),
        (["--photo", "ball.exr", "--light", "studio", "--exposure", "bright"], "or free"),
        (["--photo", "ball.exr", "--light", "studio", "--turn", 1, "--turn", 2], "2 turns for 1 photographs"),
        (["--photo", "ball.exr", "--light", "studio", "--camera", "curves.csv"], "spectral library"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(run, folder, library, arguments, words):
    code, _, err = run("complete", *arguments, "--library", library, "-o", "x.bsdf", cwd=folder)
    assert code in (1, 2)
    assert words in " ".join(err.split())
    assert not (folder / "x.bsdf").exists()
