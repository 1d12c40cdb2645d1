"""The panel of lights: exact values of diffusers, and which lights are fitted and judged."""

from __future__ import annotations

import numpy as np
import pytest

from manifold.colour import ball_colours, panel
from manifold.colour.conversion import srgb_to_xyz
from manifold.core.pairs import Pairs
from manifold.core.records import Bands

RGB = Bands(None)


def pixels_of(name: str, f: np.ndarray) -> np.ndarray:
    lights = panel.panel((name,))
    return lights.of(np.broadcast_to(f, len(lights)))


def test_no_judged_light_is_fitted():
    assert not set(panel.FITTED) & set(panel.JUDGED)


def test_a_white_diffuser_in_white_light_is_white_everywhere():
    np.testing.assert_allclose(pixels_of("white", np.array([1.0 / np.pi])), 1.0, atol=0.01)


@pytest.mark.parametrize("degrees", [20, 45, 130])
def test_a_sun_lights_a_diffuser_by_the_cosine(degrees):
    ball = panel.panel((f"sun {degrees}",)).of_pixels(slice(None))
    np.testing.assert_allclose(pixels_of(f"sun {degrees}", np.array([1.0 / np.pi])), ball.wo[:, 2])
    between = np.rad2deg(np.arccos(np.sum(ball.wi * ball.wo, axis=1)))
    np.testing.assert_allclose(between, degrees)


def test_lights_count_the_same_whatever_their_pixels():
    lights = panel.judged()
    weights = lights.pixel_weights
    assert weights.mean() == pytest.approx(1.0)
    totals = [part.sum() for part in np.split(weights, np.cumsum(lights.counts)[:-1])]
    np.testing.assert_allclose(totals, totals[0])


def test_errors_name_the_worst_light():
    lights = panel.judged()
    f = np.full((len(lights), 3), 0.5 / np.pi)
    assert lights.errors(f, f, RGB).ball == 0.0
    darker, before = f.copy(), int(lights.counts[:3].sum())
    darker[lights.sums[before : before + int(lights.counts[3])].indices] *= 0.5
    found = lights.errors(darker, f, RGB)
    assert found.worst_light == panel.JUDGED[3]
    assert found.ball == pytest.approx(found.worst / len(panel.JUDGED))
    assert found.ball_itp > 0.0
    worst = f"worst {found.worst:.2f} ({panel.JUDGED[3]} degrees from the view)"
    assert str(found) == f"{found.ball:.2f} (mean of five lights), {worst}"


def test_pixels_are_those_of_their_balls():
    lights = panel.panel(("studio 0", "sun 45", "white"))
    f = np.random.default_rng(0).random((len(lights), 3)) * 0.1
    np.testing.assert_allclose(srgb_to_xyz(np.clip(lights.of(f), 0.0, 1.0)), lights.xyz(f, RGB), atol=1e-9)
    studio, sun = ball_colours.ball(), panel.sun(45)
    first, second = np.cumsum(lights.counts)[:2]
    np.testing.assert_allclose(lights.of(f)[:first], studio.of(f[: len(studio)]))
    np.testing.assert_allclose(lights.of(f)[first:second], sun.of(f[len(studio) :]))
    some = studio.of_pixels(slice(7, 20))
    used = np.unique(studio.sums[7:20].indices)
    np.testing.assert_allclose(some.of(f[used]), studio.of(f[: len(studio)])[7:20])
    np.testing.assert_allclose(some.mean(np.full(len(some), 3.0)), 3.0)


def test_a_signature_is_of_the_lights_and_not_of_the_last_digits():
    lights = panel.judged()
    rounded = panel.Panel(lights.names, Pairs(lights.wi * (1.0 + 1e-13), lights.wo), parts_of(lights))
    assert rounded.signature == panel.panel(panel.JUDGED).signature == lights.signature
    names = ("studio 0", "white", "sun 45", "sun 80", "sun 131")
    others = panel.panel(names), panel.panel(panel.JUDGED[:4]), panel.panel(panel.JUDGED, 48, 24, 16)
    brighter = panel.Panel(lights.names, lights[:], [1.001 * part for part in parts_of(lights)])
    signatures = {lights.signature, brighter.signature, *(other.signature for other in others)}
    assert len(signatures) == 5
    assert max(signatures) < 2**48  # as a number of a file, exactly


def parts_of(lights: panel.Panel) -> list:
    ends = np.cumsum(lights.counts)
    return [lights.sums[end - count : end] for end, count in zip(ends, lights.counts, strict=True)]
