"""The quick ball against a render of the same ball, and against what is known of its light."""

from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from helpers import small_library

from manifold.brdf.measured import MeasuredBRDF
from manifold.colour import ball_colours
from manifold.colour.conversion import srgb_to_xyz
from manifold.core.records import Bands
from manifold.io_rgl import write_bsdf
from manifold.render.measured_plugin import load_bsdf

RGB = Bands(None)
PIXELS, FINER = 10, 9  # the render has a pixel at the centre of each of the ball's


def _render(path: Path) -> np.ndarray:
    """Linear sRGB of the ball's pixels, (K, 3), seen and lit as `ball_colours` says."""
    mi.set_variant("scalar_rgb")
    size = PIXELS * FINER
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2},
        "sensor": {
            "type": "orthographic",
            "to_world": mi.ScalarTransform4f().look_at(
                origin=(5 * ball_colours.VIEW).tolist(), target=[0, 0, 0], up=[0, 0, 1]
            ),
            "film": {
                "type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}, "pixel_format": "rgb",
            },
            "sampler": {"type": "independent", "sample_count": 64},
        },
        "light": {
            "type": "envmap",
            "bitmap": mi.Bitmap(ball_colours.environment().astype(np.float32)),
            "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], 90),
        },
        "ball": {"type": "sphere", "material": load_bsdf(mi, {"type": "measured", "filename": str(path)})},
    }  # fmt: skip
    picture = np.array(mi.render(mi.load_dict(scene)), dtype=float)
    # Nine pixels around each centre, for less noise.
    shifted = [
        picture[FINER // 2 + i :: FINER, FINER // 2 + j :: FINER] for i in (-1, 0, 1) for j in (-1, 0, 1)
    ]
    across = 2.0 * (np.arange(PIXELS) + 0.5) / PIXELS - 1.0
    return np.mean(shifted, axis=0)[across[:, None] ** 2 + across**2 < 1.0]


@pytest.mark.parametrize("name", ["syn_felt_green", "syn_metal_copper"])
def test_the_ball_has_the_colours_of_a_render_of_the_same_ball(tmp_path, name):
    file = small_library.measured(name)
    write_bsdf(tmp_path / "ball_rgb.bsdf", file)
    rendered = srgb_to_xyz(np.clip(_render(tmp_path / "ball_rgb.bsdf"), 0.0, 1.0))
    ball, brdf = ball_colours.ball(PIXELS), MeasuredBRDF(file)
    quick = ball.xyz(brdf.eval(ball.wi, ball.wo), RGB)
    inner = np.sum(ball.places**2, axis=1) < 0.9  # the render's pixels at the outline look past the ball
    # The quadrature is coarse: 1 in CIEDE2000. Another material of the library is 8 and more away.
    assert ball_colours.delta_e(quick[inner], rendered[inner]) < 2.0


def test_a_white_ball_is_as_bright_as_the_light_around_it():
    ball = ball_colours.ball(PIXELS, 96, 64)
    white = np.full((len(ball.wi), 3), 1.0 / np.pi)
    luminance = ball.of(white[:, 0])
    environment = ball_colours.environment()[..., 0]
    theta = np.pi * (np.arange(len(environment)) + 0.5) / len(environment)
    mean = np.sum(environment.mean(axis=1) * np.sin(theta)) / np.sum(np.sin(theta))
    # Over all normals the irradiance averages to that of the mean radiance; half of the ball is seen.
    assert 0.4 * mean < luminance.mean() < 1.6 * mean


def test_bands_and_rgb_of_a_grey_ball_have_the_same_colours():
    ball = ball_colours.ball(6)
    bands = Bands(tuple(np.linspace(380.0, 780.0, 21)))
    grey = np.full(len(ball.wi), 0.1)
    in_bands = ball.xyz(np.repeat(grey[:, None], 21, axis=1), bands)
    in_rgb = ball.xyz(np.repeat(grey[:, None], 3, axis=1), RGB)
    assert ball_colours.delta_e(in_bands, in_rgb) < 0.05  # adaptation to the white of a coarse table


def test_the_difference_of_a_ball_to_itself_is_zero_and_to_a_darker_one_is_not():
    ball = ball_colours.ball(6)
    f = np.full((len(ball.wi), 3), 0.1)
    bright, dark = ball.xyz(f, RGB), ball.xyz(0.5 * f, RGB)
    assert ball_colours.delta_e(bright, bright) == 0.0
    assert ball_colours.delta_e(bright, dark) > 5.0
