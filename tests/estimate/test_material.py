"""Materials found in photographs of their balls."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from manifold.analytic.free_lobes import bernstein, cos_theta_d, microfacet_lobe
from manifold.colour.lights import environment
from manifold.core.directions import from_spherical
from manifold.core.records import Bands
from manifold.estimate import Completion, calibrate, expected
from manifold.estimate.channels import wiener_matrix
from manifold.estimate.completions import advise
from manifold.estimate.evidence import channel_atoms, seen_instead
from manifold.estimate.expected import errors_of_weights
from manifold.estimate.gloss import gloss_units
from manifold.estimate.outlines import Circle, Photograph
from manifold.estimate.pixel_mixtures import PixelPosterior
from manifold.estimate.pixels import Camera, Environment, block_sums, blocks_of
from manifold.estimate.sightings import Sighting
from manifold.estimate.solving import estimate
from manifold.formats.readings import Readings, aspecular_pair
from manifold.library.store import Library
from manifold.model.estimator import Observation

SIZE, MARGIN = 96, 0.3
RGB = Bands(None)


class SummedOnce(Sighting):
    """A sighting whose sums are kept, as several tests ask for them."""

    sums = cache(Sighting.sums)


def sighting(picture, light, turn_deg=0.0):
    circle = Circle(SIZE / 2, SIZE / 2, SIZE / 2 / (1 + MARGIN))
    seen = Photograph(Path("ball.exr"), np.minimum(picture, 1.0).astype(np.float32), picture >= 1.0)
    return SummedOnce(
        blocks_of(seen, circle), Camera(turn_deg, 15.0, 8.0), Environment.of(environment(light, 128))
    )


def errors(atoms, name, found):
    return errors_of_weights(atoms, atoms.names.index(name), found.weights)


@pytest.fixture(scope="module")
def felt(photo_atoms, render):
    """The felt as the studio shows it, and what was found."""
    seen = sighting(render("syn_felt_green", "studio"), "studio")
    return seen, Completion.of(photo_atoms, [seen])


def test_a_material_of_the_library_is_found(photo_atoms, felt):
    found = errors(photo_atoms, "syn_felt_green", felt[1])
    assert found.ball < 1.5  # in lights other than the photograph's
    assert found.cube_root < 0.1
    assert felt[1].residual < 0.05
    assert "check the light" not in expected_notes(felt[1])


def expected_notes(found):
    """What a user reads of the material and its expected errors."""
    calibration = calibrate(found.atoms, found.exposed)
    return " ".join((*calibration.notes(found), *found.notes))


def test_errors_of_left_out_materials_are_kept_in_the_library(felt, library, monkeypatch):
    first = calibrate(felt[1].atoms, felt[1].exposed, Library(library)).expected(felt[1])
    monkeypatch.setattr(expected, "_calibrated", None)
    assert calibrate(felt[1].atoms, felt[1].exposed, Library(library)).expected(felt[1]) == first
    assert first.near_mirror > first.elsewhere  # which no lamp of the studio shows


def test_a_wrong_exposure_is_no_error_with_the_brightness_aside(photo_atoms, felt):
    own = channel_atoms(photo_atoms, photo_atoms.names.index("syn_felt_green"))
    grid, ball = (
        values[own].T for values in (photo_atoms.on_grid / photo_atoms.grid.cosines, photo_atoms.on_ball)
    )
    off = expected.errors_of(photo_atoms, int(photo_atoms.material_of[own[0]]), 0.5 * grid, 0.5 * ball)
    assert off.ball > 5.0
    assert off.scaled_ball < 0.1
    assert "scaled_ball" not in calibrate(photo_atoms, felt[1].exposed).expected(felt[1]).known


def test_pictures_of_unknown_exposure_ask_for_a_card_or_a_reading(photo_atoms, felt):
    found = Completion.of(photo_atoms, [felt[0]], exposure=None)
    errors = calibrate(photo_atoms, found.exposed).expected(found)
    assert errors.words[0].endswith("after matching the brightness")
    assert errors.scaled_ball < errors.ball
    assert "--grey" in str(advise(errors, None).words)
    wi, wo = aspecular_pair(45.0, 45.0)
    own = photo_atoms.material_of == photo_atoms.names.index("syn_felt_green")
    read = Readings(
        "felt", "", wi[None], wo[None], None, photo_atoms.at(wi[None], wo[None])[: len(own)][own][:3].T
    )
    assert not Completion.of(photo_atoms, [felt[0], read], exposure=None).is_brightness_guessed


def test_a_channel_without_any_light_is_black(photo_atoms, render):
    picture = render("syn_felt_green", "studio").copy()
    picture[..., 2] = 0.0
    found = Completion.of(photo_atoms, [sighting(picture, "studio")])
    errors_then = calibrate(photo_atoms, found.exposed).expected(found)
    assert np.isfinite(list(errors_then.known.values())).all()
    wi, wo = from_spherical(0.7, 0.0), from_spherical(0.2, 2.0)
    assert found.brdf.eval(wi, wo)[2] < 0.01 * found.brdf.eval(wi, wo)[1]


def test_a_colour_that_changes_with_incidence_is_found(photo_atoms, felt):
    def iridescent(wi, wo):
        lobe = 0.3 * microfacet_lobe(wi, wo, 0.1) * bernstein(cos_theta_d(wi, wo), 5)[[1, 3, 5]]
        return 0.02 + np.where((wi[:, 2] > 0.0) & (wo[:, 2] > 0.0), lobe, 0.0)

    sums = block_sums(iridescent, *felt[0].pairs)
    values = np.stack([sums[c, c] for c in range(3)], axis=1)
    seen = replace(felt[0], blocks=replace(felt[0].blocks, values=values))
    found = Completion.of(photo_atoms, [seen])
    assert found.residual < 0.05  # 0.08 with Fresnel terms of dielectrics and mirrors alone


def test_the_brdf_is_the_sum_of_its_atoms(rng, photo_atoms):
    wi, wo = (from_spherical(rng.uniform(0.0, 1.4, 200), rng.uniform(0.0, 6.0, 200)) for _ in range(2))
    weights = rng.random((3, len(photo_atoms))) * (rng.random(len(photo_atoms)) < 0.2)
    predicted = photo_atoms.predicted(weights, RGB).eval(wi, wo)
    assert np.allclose(predicted.T, weights @ photo_atoms.at(wi, wo), rtol=1e-6)


def test_a_left_out_material_lit_by_one_lamp_keeps_its_albedo(atoms, render):
    m = atoms.names.index("syn_gloss_red")
    others = atoms.without(m).in_values
    found = Completion.of(others, [sighting(render("syn_gloss_red", "one-lamp"), "one-lamp")])
    elevations = from_spherical(np.deg2rad([0.0, 45.0, 75.0, 85.0]), np.zeros(4))
    assert found.brdf.albedo(elevations).max() < 1.05
    assert "no lamp shows highlights" in " ".join(found.notes)


def test_the_exposure_is_found_where_it_is_not_known(photo_atoms, render):
    seen = sighting(0.5 * render("syn_satin_gold", "studio"), "studio")
    found = Completion.of(photo_atoms, [seen], exposure=None)
    assert found.exposure == pytest.approx(0.5, rel=0.25)  # the prior of scales is as wide


def test_two_photographs_tell_more_than_one(photo_atoms, render):
    seen = [sighting(render("syn_metal_copper", light), light) for light in ("one-lamp", "studio")]
    one, two = (Completion.of(photo_atoms, some) for some in (seen[:1], seen))
    assert (
        errors(photo_atoms, "syn_metal_copper", two).cube_root
        < errors(photo_atoms, "syn_metal_copper", one).cube_root + 0.02
    )
    assert len(two.solution.channels[0].seen) > len(one.solution.channels[0].seen)


def test_a_wrong_light_is_noticed(photo_atoms, render):
    found = Completion.of(photo_atoms, [sighting(render("syn_gloss_red", "one-lamp"), "sky", 180.0)])
    assert "check the light" in expected_notes(found)


def test_readings_count_beside_pixels(photo_atoms, felt):
    elevations = np.deg2rad(np.linspace(0.0, 60.0, 40))
    wi, wo = from_spherical(np.full(40, 0.7), 0.0), from_spherical(elevations, np.pi)
    bright = Readings("sample", "test", wi, wo, None, np.full((40, 3), 0.9 / np.pi), np.ones(40))
    found = Completion.of(photo_atoms, [felt[0], bright])
    at = found.brdf.eval(wi, wo).mean()
    assert at > 1.2 * felt[1].brdf.eval(wi, wo).mean()


def test_gloss_counts_beside_pixels(photo_atoms, felt):
    before = gloss_units(felt[1].brdf, [60.0])[60.0]
    given = 4.0 * before + 5.0
    found = Completion.of(photo_atoms, [felt[0], {60.0: given}])
    after = gloss_units(found.brdf, [60.0])[60.0]
    assert 2.0 * before < after < given  # pixels contradict it
    assert found.residual >= felt[1].residual - 1e-6  # of all rows: gloss contradicts these pixels


def test_what_stands_beside_pixels_neither_chooses_the_prior_nor_is_clipped(photo_atoms, felt):
    pixels = felt[0].rows(felt[0].sums(photo_atoms)[0])
    level = np.array([0.9])
    read = [Observation(rows.atoms[:, :1], level, np.ones(1), np.zeros(1, bool)) for rows in pixels]
    both = [rows.beside(other) for rows, other in zip(pixels, read, strict=True)]
    for alone, prior in zip(*(estimate(photo_atoms, rows)[1] for rows in (pixels, both)), strict=True):
        np.testing.assert_array_equal(alone.mean, prior.mean)
    clipped = replace(both[0], is_bound=np.arange(len(both[0].seen)) == 0)
    other = seen_instead(clipped, clipped.seen + 1.0)  # of a brighter material
    assert other.is_bound[:-1].all()
    assert not other.is_bound[-1]
    assert other.seen[-1] == level + 1.0


def test_neutral_colours_have_flat_spectra(rng):
    spectra = rng.random((50, 31))
    responses = rng.random((3, 31))
    responses /= responses.sum(axis=1, keepdims=True)
    assert np.allclose(wiener_matrix(spectra, responses) @ np.full(3, 0.4), 0.4)


def test_pixels_under_many_exposures_are_those_divided_by_each(photo_atoms):
    rng = np.random.default_rng(3)
    index = rng.choice(len(photo_atoms), 40)
    pixels = photo_atoms.on_grid[:, index]
    seen = 0.6 * pixels[4] + 0.01 * rng.random(40)
    seen[:4] = 0.0, 0.002, 0.02, 0.05  # some are darker than `LEAST` under some exposures only
    rows = Observation(pixels, seen, 1.0 + rng.random(40), np.arange(40) >= 37)
    exposures, usable = np.array([0.1, 1.0, 5.0]), np.ones(len(photo_atoms), bool)
    together = PixelPosterior.of(photo_atoms, rows, usable, exposures)
    for e, exposure in enumerate(exposures.tolist()):
        alone = PixelPosterior.of(photo_atoms, rows.scaled(exposure), usable, np.ones(1))
        assert together.at(e).evidence == pytest.approx(alone.at(0).evidence, rel=1e-9)
        np.testing.assert_allclose(together.at(e).misfit, alone.at(0).misfit, rtol=1e-7, atol=1e-7)
