"""Pixels of a ball as sums over direction pairs, against Mitsuba and in closed form."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.small_library import measured

from manifold.brdf.measured import MeasuredBRDF
from manifold.colour.ball_colours import delta_e
from manifold.colour.conversion import srgb_to_xyz
from manifold.colour.lights import ENVIRONMENTS, environment
from manifold.core.errors import UsageError
from manifold.estimate.lamps import Lamp
from manifold.estimate.outlines import Circle, Photograph
from manifold.estimate.pixels import Camera, Environment, block_sums, blocks_of, direction_pairs
from manifold.estimate.sightings import Sighting
from manifold.io_rgl import write_bsdf
from manifold.render.render import render_floating_ball

SIZE, MARGIN = 96, 0.05
CIRCLE = Circle(SIZE / 2, SIZE / 2, SIZE / 2 / (1 + MARGIN))


def photograph(values):
    return Photograph(Path("ball.exr"), values.astype(np.float32), np.zeros(values.shape, bool))


@pytest.mark.parametrize(
    ("name", "light", "camera"),
    [
        ("syn_satin_gold", "room", Camera(40.0, 20.0, 6.0)),
        ("syn_gloss_red", "sky", Camera(-100.0, 0.0, np.inf)),
        ("syn_felt_green", "one-lamp", Camera(0.0, -10.0, 3.0)),
    ],
)
def test_pixels_are_those_of_mitsuba(tmp_path, name, light, camera):
    file, image = measured(name), environment(light, 128)
    write_bsdf(tmp_path / "ball_rgb.bsdf", file)
    picture = render_floating_ball(
        tmp_path / "ball_rgb.bsdf", True, image, size=SIZE, samples=128, margin=MARGIN,
        turn_deg=camera.turn_deg, elevation_deg=camera.elevation_deg, distance=camera.distance,
    )  # fmt: skip
    blocks = blocks_of(photograph(picture), CIRCLE)
    brdf = MeasuredBRDF(file)
    pairs = direction_pairs(blocks, camera, Environment.of(image), 1024)
    sums = block_sums(lambda wi, wo: np.maximum(brdf.eval(wi, wo), 0.0).T, *pairs)
    pixels = np.stack([sums[c, c] for c in range(3)], axis=1)
    xyz = [srgb_to_xyz(np.clip(each, 0.0, 1.0)) for each in (pixels, blocks.values)]
    assert delta_e(*xyz) < 0.5


def test_a_lambertian_in_uniform_light_has_its_albedo_everywhere():
    blocks = blocks_of(photograph(np.ones((SIZE, SIZE, 3))), CIRCLE)
    light = Environment.of(np.full((8, 16, 3), 2.0))
    pairs = direction_pairs(blocks, Camera(), light, 512)
    sums = block_sums(lambda wi, wo: np.full((1, len(wi)), 0.3 / np.pi), *pairs)
    assert np.allclose(sums, 0.6, rtol=0.05)  # 512 samples: a standard deviation of 1.3 %


@pytest.mark.parametrize("height", [10, 64, 700])
def test_environments_of_any_size_keep_their_light(rng, height):
    image = rng.random((height, 2 * height, 3))
    assert np.allclose(Environment.of(image).radiance.mean(axis=(0, 1)), image.mean(axis=(0, 1)))


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_light_is_sampled_with_its_density(rng, name):
    light = Environment.of(environment(name, 64))
    normals = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    probabilities = light.cell_probabilities(normals)
    directions = light.sample(probabilities, rng.random((2, 20000, 3)))
    rows = 512  # those of the fine pixels
    theta, azimuth = np.meshgrid(
        (np.arange(rows) + 0.5) * np.pi / rows, (np.arange(2 * rows) + 0.5) * np.pi / rows
    )
    sine = np.sin(theta)
    grid = np.stack([sine * np.sin(azimuth), sine * np.cos(azimuth), np.cos(theta)], axis=-1).reshape(-1, 3)
    solid_angles = (sine * (np.pi / rows) ** 2).ravel()
    pixels = np.broadcast_to(light.at(grid)[1], (2, len(grid)))
    shares = light.density(probabilities, pixels) * solid_angles
    assert np.allclose(shares.sum(axis=1), 1.0, rtol=1e-3)  # solid angles at the middle of a cell of the grid

    def octants(of):
        return (of > 0.0) @ [1, 2, 4]

    for sampled, share in zip(directions, shares, strict=True):
        counts = np.bincount(octants(sampled), minlength=8)
        expected = len(sampled) * np.bincount(octants(grid), weights=share, minlength=8)
        assert np.all(np.abs(counts - expected) <= 5.0 * np.sqrt(expected) + 5.0)


@pytest.mark.parametrize(
    ("image", "words"),
    [(np.ones((10, 10, 3)), "twice as wide"), (np.zeros((8, 16, 3)), "black"), (np.full((8, 16, 3), np.nan), "finite")],
)  # fmt: skip
def test_environments_of_wrong_shape_black_or_nan_are_refused(image, words):
    with pytest.raises(UsageError, match=words):
        Environment.of(image)


def test_clipped_pixels_are_lower_bounds_and_transparent_ones_are_left_out():
    values = np.full((SIZE, SIZE, 3), 0.5)
    values[40:50, 40:50] = 1.0
    values[60:64] = np.nan
    picture = Photograph(Path("ball.png"), values.astype(np.float32), values >= 1.0)
    blocks = blocks_of(picture, CIRCLE)
    assert np.allclose(blocks.values[blocks.is_clipped], 1.0)
    assert np.allclose(blocks.values[~blocks.is_clipped], 0.5)
    assert blocks.counts[blocks.is_clipped.all(axis=1)].sum() == 100


def test_measured_channels_of_clipped_pixels_stay_data():
    values = np.full((SIZE, SIZE, 3), 0.5)
    values[40:50, 40:50] = [1.0, 0.7, 0.2]
    values[44:46, 44:46, 2] = 1.0
    picture = Photograph(Path("ball.png"), values.astype(np.float32), values >= 1.0)
    blocks = blocks_of(picture, CIRCLE)
    counts = [blocks.counts[own].sum() for own in blocks.is_clipped.T]
    assert counts == [100, 0, 4]
    only_red = blocks.is_clipped @ [1, 2, 4] == 1
    assert np.allclose(blocks.values[only_red], [1.0, 0.7, 0.2])
    sighting = Sighting(blocks, Camera(), (Lamp.towards(np.array([0.0, 0.0, 1.0])),))
    red, green, blue = sighting.rows(np.zeros((1, 3, len(blocks.values))))
    assert np.allclose(red.seen[red.is_bound], 1.0)
    assert np.allclose(blue.seen[blue.is_bound], 1.0)
    assert not green.is_bound.any()


@pytest.mark.parametrize(
    ("values", "is_clipped", "words"),
    [(1.0, True, "100 % of the ball.*is clipped"), (np.nan, False, "0 % was seen"), (0.0, False, "black")],
)
def test_balls_of_which_nothing_is_seen_are_refused(values, is_clipped, words):
    picture = Photograph(
        Path("ball.exr"), np.full((SIZE, SIZE, 3), values, np.float32), np.full((SIZE, SIZE, 3), is_clipped)
    )
    with pytest.raises(UsageError, match=words):
        blocks_of(picture, CIRCLE)
