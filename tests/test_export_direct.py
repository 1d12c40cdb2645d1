"""Direct fits of targets' own models."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from manifold.colour import ball_colours
from manifold.fitting import fit_samples
from manifold.fitting.exports import TARGETS, Principled, blender, gltf, loss, standard_surface
from manifold.fitting.exports.direct import fit_target
from manifold.records import Bands

TRUTH = Principled((0.6, 0.2, 0.1), roughness=0.35, specular=0.6, clearcoat=0.6, clearcoat_gloss=0.7)
START = Principled((0.5, 0.5, 0.5), roughness=0.6, metallic=0.2)


@dataclass
class Own:
    """A material that the target has."""

    target: object
    values: dict
    bands: Bands = Bands(None)  # noqa: RUF009
    is_isotropic: bool = True

    def eval(self, wi, wo):
        return self.target.brdf(self.values, wi, wo)


@pytest.mark.parametrize(
    "name",
    [
        "usd",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("gltf", "openpbr", "standard-surface", "blender", "unreal", "unity")
        ),
    ],
)
def test_a_material_of_the_target_is_found_again(name):
    target = TARGETS[name]
    truth = Own(target, target.parameters(TRUTH))
    samples = fit_samples.from_brdf(truth)
    found = fit_target(target, target.parameters(START), samples, truth)
    assert found.keys() == target.defaults.keys()

    def ball(values):
        return loss.rgb_xyz(lambda view, light: target.brdf(values, view, light))

    before = ball_colours.delta_e(ball(target.parameters(START)), ball(truth.values))
    after = ball_colours.delta_e(ball(found), ball(truth.values))
    assert before > 5.0
    assert after < 0.5  # a fit of 40 evaluations, pulled a little towards its start


def test_what_nothing_determines_stays_and_a_coat_that_is_not_there_is_none():
    target = TARGETS["gltf"]
    metal = Principled((0.9, 0.6, 0.3), metallic=1.0, roughness=0.3)
    truth = Own(target, target.parameters(metal))
    found = fit_target(target, target.parameters(metal), fit_samples.from_brdf(truth), truth)
    assert found["clearcoatFactor"] == found["clearcoatRoughnessFactor"] == 0.0
    assert found["sheenColorFactor"] == [0.0, 0.0, 0.0]
    assert found["anisotropyStrength"] == found["iridescenceFactor"] == 0.0
    assert found["metallicFactor"] == 1.0  # not 0.9999999
    np.testing.assert_allclose(found["baseColorFactor"], metal.base_color, atol=0.02)


def test_a_sheen_that_shows_at_the_rim_alone_is_not_made_up():
    # Narrower than principled's, it is a coloured line that hardly any sample determines.
    target = TARGETS["gltf"]
    narrow = {"sheenColorFactor": [1.0, 0.0, 0.0], "sheenRoughnessFactor": 0.05}
    truth = Own(target, target.parameters(Principled((0.4, 0.3, 0.1), roughness=0.5)) | narrow)
    start = target.parameters(Principled((0.4, 0.3, 0.1), roughness=0.5))
    found = fit_target(target, start, fit_samples.from_brdf(truth), truth)
    assert found["sheenRoughnessFactor"] == 0.0 or found["sheenRoughnessFactor"] >= gltf.SHEEN_ROUGHNESS


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "film"),
    [
        ("gltf", dict(zip(gltf.FILM, (0.8, 420.0, 1.5), strict=True))),
        ("standard-surface", dict(zip(standard_surface.FILM, (420.0, 1.5), strict=True))),
        ("blender", dict(zip(blender.FILM, (420.0, 1.5), strict=True))),
    ],
)
def test_a_thin_film_is_found_where_hues_change_with_the_angle(name, film):
    target = TARGETS[name]
    metal = target.parameters(Principled((0.7, 0.6, 0.5), metallic=1.0, roughness=0.4))
    truth = Own(target, metal | film)
    start = target.parameters(Principled((0.6, 0.6, 0.6), metallic=0.8, roughness=0.5))
    found = fit_target(target, start, fit_samples.from_brdf(truth), truth)

    def ball(values):
        return loss.rgb_xyz(lambda view, light: target.brdf(values, view, light))

    bare = fit_target(replace(target, film=()), start, fit_samples.from_brdf(truth), truth)
    assert ball_colours.delta_e(ball(bare), ball(truth.values)) > 2.3  # a just noticeable difference
    assert ball_colours.delta_e(ball(found), ball(truth.values)) < 1.0
