"""Saturated pixels below the largest code are found, and smooth or evenly lit surfaces are not taken for them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import convolve, gaussian_filter

from manifold.colour.conversion import encode_srgb
from manifold.colour.saturation import find_plateau

SIZE, RADIUS = 160, 70.0
BLUR = np.outer([1.0, 2.0, 1.0], [1.0, 2.0, 1.0]) / 16.0


def ball(gloss=20.0, width=0.1, lamp=(0.4, 0.25, 0.88)):
    """A matt ball of brightness 1 where it faces the lamp, with a highlight of the given strength; shape (H, W)."""
    across = (np.arange(SIZE) + 0.5 - SIZE / 2) / RADIUS
    x, y = np.meshgrid(across, -across)
    z = np.sqrt(np.maximum(1.0 - x * x - y * y, 0.0))
    lamp = np.array(lamp) / np.linalg.norm(lamp)
    half = lamp + np.array([0.0, 0.0, 1.0])
    half /= np.linalg.norm(half)
    normal = np.stack([x, y, z], axis=-1)
    angle = np.arccos(np.clip(normal @ half, -1.0, 1.0))
    lit = np.maximum(normal @ lamp, 0.0) * (np.hypot(x, y) < 1.0)
    return lit * (1.0 + gloss / (1.0 + (angle / width) ** 2) ** 2)


def eight_bits(values):
    return np.rint(255.0 * encode_srgb(np.clip(values, 0.0, 1.0))).astype(np.uint8)


@pytest.fixture
def noise(rng):
    return 1.0 + 0.01 * rng.standard_normal((SIZE, SIZE))


STORED = {
    "14 bits in 16": lambda v, noise: np.rint(16383 * v).astype(np.uint16),
    "12 bits in 16": lambda v, noise: np.rint(4095 * v).astype(np.uint16),
    "code 243": lambda v, noise: eight_bits(0.9 * v),
    "code 243 with noise": lambda v, noise: eight_bits(0.9 * v * noise),
    "code 150": lambda v, noise: eight_bits(0.3 * v),
    "floats": lambda v, noise: (0.35 * v).astype(np.float32),
    "floats with noise": lambda v, noise: (0.35 * v * noise).astype(np.float32),
    "interpolated, with noise": lambda v, noise: (0.35 * convolve(v, BLUR) * noise).astype(np.float32),
}


@pytest.mark.parametrize("stored", STORED)
@pytest.mark.parametrize("level", [2.0, 6.0])
def test_pixels_of_a_saturated_highlight_are_found(noise, stored, level):
    values = ball()
    codes = STORED[stored](np.minimum(values / level, 1.0), noise)
    found = find_plateau(codes)
    saturated = values > level
    assert saturated.sum() > 100
    # Interpolation mixes the outermost pixels with those beside them; noise moves a few below the plateau.
    assert np.count_nonzero(found.pixels & saturated) > 0.85 * saturated.sum()
    assert np.all(values[found.pixels] > 0.75 * level)
    assert found.level == pytest.approx(np.median(codes[saturated]), rel=0.01)


@pytest.mark.parametrize("stored", STORED)
@pytest.mark.parametrize(
    "values",
    [
        ball(),
        ball(gloss=0.5),
        ball(gloss=0.0),
        ball(gloss=0.0, lamp=(0.0, 0.0, 1.0)),
        np.where(ball(0.0, lamp=(0.0, 0.0, 1.0)) > 0.0, 1.0, 0.0),  # evenly lit
        gaussian_filter(np.where(ball(0.0, lamp=(0.0, 0.0, 1.0)) > 0.0, 1.0, 0.0), 1.5),
        ball(0.0, lamp=(0.0, 0.0, 1.0)) ** 0.3,  # nearly flat, as felt under a flash
        np.sqrt(np.maximum(1.0 - np.linspace(-1.2, 1.2, SIZE) ** 2, 0.0)) * np.ones((SIZE, 1)),  # a tin
        np.ones((SIZE, SIZE)),
    ],
    ids=["glossy", "satin", "matt", "matt, flash", "even", "even, blurred", "felt", "cylinder", "white"],
)
def test_pictures_without_saturation_have_no_plateau(noise, stored, values):
    values = values / values.max()
    if stored.endswith("in 16"):  # no light is as even as exactly equal codes of more than eight bits
        values = values * (1.0 + 0.2 * (noise - 1.0))
    assert find_plateau(STORED[stored](values, noise)) is None


def test_a_ball_that_is_mostly_saturated_is_found_in_fine_codes(noise):
    values = ball(gloss=0.0, lamp=(0.0, 0.0, 1.0))
    codes = STORED["14 bits in 16"](np.minimum(20.0 * values, 1.0), noise)
    assert np.count_nonzero(find_plateau(codes).pixels) > 0.9 * np.count_nonzero(values)


def test_large_pictures_are_searched_at_a_lower_resolution(rng):
    values = np.kron(ball(), np.ones((12, 12)))
    values = gaussian_filter(values, 6.0) * (1.0 + 0.01 * rng.standard_normal(values.shape))
    found = find_plateau(np.rint(16383 * np.minimum(values / 6.0, 1.0)).astype(np.uint16))
    saturated = values > 6.0
    assert np.count_nonzero(found.pixels & saturated) > 0.95 * saturated.sum()


def test_black_and_tiny_channels_have_no_plateau():
    assert find_plateau(np.zeros((32, 32), np.uint8)) is None
    assert find_plateau(np.full((2, 2), 7, np.uint16)) is None
    assert find_plateau(np.full((32, 32), np.nan, np.float32)) is None
