"""Completion of readings: hypotheses, weights, expected errors, suggested readings, and the command."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.chi_square import chi_square_p_value
from helpers.readings import DIRECTIONS, readings
from helpers.small_library import NAMES, measured

from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import Plastic
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import Plausibility
from manifold.cli import terminal
from manifold.cli.photograph_commands import show_completed
from manifold.colour import panel
from manifold.colour.conversion import luminance
from manifold.colour.narrow_bands import SPECTRUM
from manifold.core.directions import from_spherical
from manifold.core.errors import BandMismatchError, LibraryError, UnknownNameError, UsageError
from manifold.core.metrics import Errors, cube_root_error
from manifold.core.records import Bands
from manifold.estimate import Completion, calibrate, expected, suggest
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.channels import in_channels, srgb_responses
from manifold.estimate.completions import NextStep, advise
from manifold.estimate.completions import _of_unit as of_unit
from manifold.estimate.evidence import Evidence, for_library, in_all_bands
from manifold.estimate.expected import Calibration, errors_of, leave_out, plausible_errors
from manifold.estimate.left_out_readings import LeftOutReadings, left_out_readings
from manifold.estimate.mixtures import (
    COATED,
    LIKE_ONE,
    SHARES,
    Alike,
    ReadingRoots,
    atom_pairs,
    band_mixtures,
    log_prior_of,
    material_prior,
    posterior,
)
from manifold.estimate.residual import coordinates, covariance, residual_factors
from manifold.estimate.solving import completion_weights
from manifold.estimate.suggestions import DIRECTIONS as INSTRUMENTS
from manifold.estimate.suggestions import Deviations, _residual, next_readings
from manifold.formats import csv_table
from manifold.formats.readings import mean_of_repeats
from manifold.gp.encoding import encoding_pairs
from manifold.io_rgl import read_bsdf
from manifold.library.store import Library
from manifold.model.output_file import COMPLETION_OPTIONS, output_file
from manifold.model.prediction import ClippedBRDF

APART = np.arange(9.0)[:, None] * np.full(3, 50.0)
"""Coordinates of nine readings without correlation."""

INCIDENCES_DEG = np.rad2deg(np.arccos(DIRECTIONS[0][:, 2]))


def random_atoms(rng, n=6, P=9, Q=40):
    """Cube roots of n atoms and a Lambertian at P readings and in all Q directions, and their inner products."""
    everywhere = rng.random((n + 1, Q)) + 0.1
    return everywhere[:, :P], everywhere, everywhere @ everywhere.T / Q


def roots(atoms, material, where=APART, weights=None):
    """Readings (P,) in one band, or (B, P)."""
    return ReadingRoots(atoms, np.atleast_2d(material), np.ones(9) if weights is None else weights, where)


# -- hypotheses -------------------------------------------------------------------------------------------------


def of_materials(count, per=2):
    """Materials of atoms, and of the Lambertian."""
    return np.append(np.repeat(np.arange(count), per), count)


def test_mixtures_meet_the_readings_as_a_search_over_scale_and_lambertian_does(rng):
    at, _, gram = random_atoms(rng)
    target, weights, where = rng.random(9) + 0.2, rng.random(9) + 0.5, rng.random((9, 3)) * 6.0
    found = posterior(roots(at, target, where, weights), gram, of_materials(3))
    assert found.probability.sum() == pytest.approx(1.0)
    level = np.sqrt(target**2 + np.average(target**2, weights=weights))
    noise = np.diag(0.02**2 / weights) + 0.04**2 * covariance(where / 2.0, where / 2.0)

    def cost(k, a, lambertian):
        mixed = found.share[k] * at[found.first[k]] + (1 - found.share[k]) * at[found.second[k]]
        wrong = (a * mixed + lambertian * at[-1] - target) / level
        return wrong @ np.linalg.solve(noise, wrong) + ((a - 1.0) / 0.15) ** 2 + (lambertian / 0.5) ** 2

    for k in rng.choice(len(found.share), 20, replace=False):
        best = cost(k, found.scale[k], found.lambertian[k])
        for da, dl in rng.normal(0.0, 0.05, (50, 2)):
            moved = max(found.scale[k] + da, 0.0), max(found.lambertian[k] + dl, 0.0)
            assert cost(k, *moved) >= best - 1e-9


def test_the_mixture_that_was_read_is_among_the_likeliest(rng):
    at, _, gram = random_atoms(rng)
    target = 0.5 * at[1] + 0.5 * at[4]
    found = posterior(roots(at, target), gram, of_materials(3))
    best = found.most_probable(1)[0]
    assert {found.first[best], found.second[best]} == {1, 4}
    np.testing.assert_allclose(found.weights(np.array([best]))[0] @ at, target, rtol=0.02)


def test_a_dark_mixture_gains_nothing_by_what_it_leaves_unexplained(rng):
    """Its squared norm of 0 was rewarded beyond any misfit: thousands of readings ended in a black completion."""
    at, everywhere, _ = random_atoms(rng)
    at[0], everywhere[0] = 1e-6 * at[0], 1e-6 * everywhere[0]
    gram = everywhere @ everywhere.T / everywhere.shape[1]
    peak = at[2] + 5.0 * (np.arange(9) == 4)  # a highlight that no atom has
    found = posterior(roots(at, peak), gram, of_materials(3))
    (best,) = found.weights(found.most_probable(1))
    assert best @ at[:, 0] > 0.2 * peak[0]


def test_no_mixture_is_certain_where_none_meets_the_readings(rng):
    at, _, gram = random_atoms(rng)

    def candidates(material):  # how many mixtures it is spread over: the exponential of its entropy
        p = posterior(roots(at, material), gram, of_materials(3)).probability
        return np.exp(-np.sum(p * np.log(p + 1e-300)))

    assert candidates(at[1] * np.where(np.arange(9) % 2, 1.6, 0.6)) > 3.0 * candidates(at[1] * 1.02)


def test_residuals_of_mixtures_at_neighbouring_readings_count_once(rng):
    """Three readings beside each other that are all 10 % brighter tell less against a mixture than three apart."""
    at, _, gram = random_atoms(rng)
    brighter = at[1] * np.where(np.arange(9) < 3, 1.1, 1.0)
    together = APART.copy()
    together[:3] = [[0.0, 0.0, 0.0], [0.6, 0.0, 0.0], [0.0, 0.6, 0.0]]  # in three cells
    doubt_beside, doubt_apart = (
        1.0 - posterior(roots(at, brighter, where), gram, of_materials(3)).probability[1]
        for where in (together, APART)
    )
    assert doubt_beside < 0.5 * doubt_apart


def test_a_material_of_the_library_is_likelier_than_a_mixture_of_two_that_reads_the_same(rng):
    at, everywhere, _ = random_atoms(rng)
    at[3], everywhere[3] = 0.5 * (at[0] + at[5]), 0.5 * (everywhere[0] + everywhere[5])
    gram = everywhere @ everywhere.T / everywhere.shape[1]
    found = posterior(roots(at, at[3]), gram, of_materials(3))
    both = (found.first == 0) & (found.second == 5) & (found.share == 0.5)
    # 15 mixtures are within a material, 36 of two.
    assert found.probability[3] / found.probability[both].sum() == pytest.approx(
        0.8 / 15 / (0.2 / 36), rel=1e-6
    )


def test_large_libraries_mix_some_pairs_of_materials_and_all_bands_of_each():
    first, second, share = atom_pairs(200, 3)
    is_pair = (share == SHARES[0]) & (first // 3 != second // 3)
    assert np.count_nonzero(is_pair) == 40_000  # of 179,100
    assert len(set(zip(first[is_pair].tolist(), second[is_pair].tolist(), strict=True))) == 40_000
    assert len(np.unique(np.concatenate([first[is_pair], second[is_pair]]))) == 600
    own = (share == SHARES[0]) & (first // 3 == second // 3)
    assert np.count_nonzero(own) == 200 * 3
    assert np.count_nonzero(share == 1.0) == 600


def test_priors_of_mixtures_are_those_of_their_materials():
    """Coats have their share of single materials and of pairs, which are the rest; all together have 1."""
    first, second = (a.ravel() for a in np.meshgrid(np.arange(7), np.arange(7), indexing="ij"))
    once = first <= second
    first, second = first[once], second[once]
    prior = np.exp(log_prior_of(first, second, material_prior(7, 4)))
    assert prior.sum() == pytest.approx(1.0)
    assert prior[first == second].sum() == pytest.approx(LIKE_ONE)
    has_coat = second >= 4
    assert prior[has_coat].sum() == pytest.approx(COATED)
    np.testing.assert_allclose(material_prior(4), 0.25)


def test_weights_are_never_negative_and_meet_what_atoms_can(rng):
    at, _, gram = random_atoms(rng)
    truth = np.array([[0.5, 0, 0.3, 0, 0, 0, 0.2], [0.2, 0, 0.6, 0, 0, 0, 0.1]])
    targets = truth @ at
    prior = np.tile(truth.mean(axis=0), (2, 1))
    found = completion_weights(roots(at, targets), gram, prior)
    assert found.min() >= 0.0
    assert np.abs(found @ at - targets).max() < 0.05 * targets.max()
    targets[1, :4] = np.nan
    some = completion_weights(roots(at, targets), gram, prior)
    assert np.abs(some[1] @ at - truth[1] @ at).max() < 0.1 * targets[0].max()
    targets[1] = np.nan
    np.testing.assert_allclose(completion_weights(roots(at, targets), gram, prior)[1], prior[1])


def white_and_tinted_coats(rng):
    """Two bands of three materials at nine readings: the first is grey, the others are red below a highlight.

    The mean over bands of the second and the third is the same, but the second's highlight is white.
    """
    highlight = np.exp(-np.arange(9.0) / 2.0)
    body = 0.5 + 0.1 * rng.random(9)
    materials = [[body, body], [0.4 * body + highlight, 1.6 * body + highlight]]
    materials.append([0.4 * (body + highlight), 1.6 * (body + highlight)])
    return np.vstack([np.array(materials).reshape(6, 9), np.full((1, 9), 0.7)])


def test_colours_tell_a_white_highlight_from_a_tinted_one_of_the_same_mean(rng):
    at = white_and_tinted_coats(rng)
    gram, of = at @ at.T / 9.0, of_materials(3)
    for material in (1, 2):
        targets = 0.9 * at[of == material]
        of_mean = posterior(roots(at, targets.mean(axis=0)), gram, of)
        found = band_mixtures(of_mean, roots(at, targets), gram, of)
        assert found.probability.sum() == pytest.approx(1.0)
        assert np.bincount(of, found.weights[0]).argmax() == material
        assert found.probability[0] > 0.5
        assert np.abs(found.mean @ at - targets).max() < 0.05 * targets.max()
        assert found.mean.min() >= 0.0


def test_bands_without_readings_follow_the_mean_of_the_others(rng):
    at = white_and_tinted_coats(rng)
    gram, of = at @ at.T / 9.0, of_materials(3)
    targets = at[of == 1]
    of_mean = posterior(roots(at, targets.mean(axis=0)), gram, of)
    gaps = targets.copy()
    gaps[1, 2:4] = np.nan
    full, some = (band_mixtures(of_mean, roots(at, t), gram, of) for t in (targets, gaps))
    np.testing.assert_allclose(some.mean @ at, full.mean @ at, atol=0.05)
    gaps[1] = np.nan
    nothing = band_mixtures(of_mean, roots(at, gaps), gram, of)
    np.testing.assert_allclose(nothing.mean[0] @ at, targets[0], atol=0.05)
    np.testing.assert_allclose(nothing.mean[1], nothing.mean[0])


def test_the_residual_at_readings_is_carried_to_their_neighbourhood(rng):
    wi, wo = DIRECTIONS
    where = coordinates(wi, wo)
    predicted = rng.random((2, 12)) + 0.5
    targets = predicted * np.array([[1.2], [0.9]])
    found = residual_factors(targets, predicted, where, INCIDENCES_DEG, np.ones(12), 0.1)
    # Between nothing and all: of readings 15 degrees apart some agree.
    share = (found.at(where) - 1.0) / np.array([[0.2], [-0.1]])
    assert np.all((share > 0.6) & (share < 1.2))
    grazing = from_spherical(np.deg2rad(85.0), np.pi), from_spherical(np.deg2rad(85.0), np.pi / 2)
    np.testing.assert_allclose(found.at(coordinates(*(w[None] for w in grazing))), 1.0, atol=0.01)
    np.testing.assert_allclose(found.at(coordinates(wo, wi)), found.at(where))  # reciprocal
    mirrored = np.array([1.0, -1.0, 1.0])
    np.testing.assert_allclose(found.at(coordinates(wi * mirrored, wo * mirrored)), found.at(where))
    targets[1, :5] = np.nan
    some = residual_factors(targets, predicted, where, INCIDENCES_DEG, np.ones(12), 0.1)
    np.testing.assert_allclose(some.at(where)[0], found.at(where)[0], atol=5e-3)  # noise is that of all bands
    of_measured = residual_factors(
        targets[1:, 5:], predicted[1:, 5:], where[5:], INCIDENCES_DEG[5:], np.ones(7), 0.1
    )
    np.testing.assert_allclose(some.at(where)[1], of_measured.at(where)[0], atol=5e-3)


def test_thousands_of_readings_are_averaged_where_they_are_near_each_other(rng):
    wi, wo = (
        from_spherical(np.arccos(rng.uniform(0.1, 1.0, 3000)), rng.uniform(-np.pi, np.pi, 3000)) for _ in "io"
    )
    incidences_deg = np.rad2deg(np.arccos(wi[:, 2]))
    where, change = coordinates(wi, wo), 0.2 * wo[:, 2] * wi[:, 2]
    read = 1.0 + change + 0.2 * rng.standard_normal((1, 3000))
    found = residual_factors(read, np.ones((1, 3000)), where, incidences_deg, np.ones(3000), 0.03)
    assert found.strength.shape[1] <= 256
    wrong = found.at(where)[0] - 1.0 - change
    assert np.sqrt(np.mean(wrong**2)) < 0.05  # a quarter of the noise


def test_the_residual_says_whether_readings_are_reciprocal():
    where = coordinates(*DIRECTIONS)

    def found(residual):
        measured = 1.0 + np.tile(residual, (3, 1))
        return residual_factors(measured, np.ones((3, 12)), where, INCIDENCES_DEG, np.ones(12), 0.0025)

    assert found(0.04 * np.sin(where[:, 0] / 2.0)).not_reciprocal == 0.0
    apart = found(np.where(INCIDENCES_DEG < 30.0, -0.04, 0.04)).not_reciprocal
    assert apart == pytest.approx(3.0 * 0.08, rel=0.01)  # of values, whose cube roots are apart by 0.08


def test_a_completion_says_that_readings_are_not_reciprocal(atoms):
    wi, wo = DIRECTIONS
    f = MeasuredBRDF(measured("syn_felt_orange")).eval(wi, wo)
    contradicting = readings(f * np.where(INCIDENCES_DEG < 30.0, 0.85, 1.15)[:, None])
    said = [" ".join(Completion.of(atoms, read).notes) for read in (readings(f), contradicting)]
    assert ["readings with the directions exchanged differ" in notes for notes in said] == [False, True]


def test_the_repeatability_that_a_note_names_fits_the_mean_of_exchanged_readings(atoms):
    wi, wo = DIRECTIONS
    f = MeasuredBRDF(measured("syn_felt_orange")).eval(wi, wo)
    contradicting = readings(f * np.where(INCIDENCES_DEG < 30.0, 0.85, 1.15)[:, None])
    (note,) = (
        n for n in Completion.of(atoms, contradicting).notes if "--repeatability" in n and "exchanged" in n
    )
    named = float(re.search(r"--repeatability (\d+)", note)[1])
    again = Completion.of(atoms, replace(contradicting, repeatability=named / 100.0))
    assert "directions exchanged" not in " ".join(again.notes)


def test_the_next_reading_is_the_one_that_lowers_both_errors_most(rng):
    H, M, D, P, K = 30, 12, 7, 11, 5

    def deviations(count, n_directions):
        tables = [rng.standard_normal((count, n)) / np.sqrt(count) for n in (D, K, n_directions)]
        return Deviations(*tables, noise=0.02 * rng.random(D))

    structure, colour = deviations(H, P), deviations(M, 0)

    def left(unknown, read):
        """Variances of the pixels and in all directions that a Gaussian process leaves."""
        joint = np.hstack([unknown.on_ball, unknown.everywhere])
        at = unknown.at_candidates[:, read]
        gain = np.linalg.solve(at.T @ at + np.diag(unknown.noise[read]), at.T @ joint)
        variance = np.sum(joint**2, axis=0) - np.sum((joint.T @ at) * gain.T, axis=1)
        return variance[:K], variance[K:]

    def error(read):
        (pixels, everywhere), (of_colour, _) = left(structure, read), left(colour, read)
        return 0.5 * np.log(everywhere.sum()) + 3.0 * np.log(np.mean(np.sqrt(pixels + of_colour) + 1e-4))

    read: list[int] = []
    for best in next_readings((structure, colour), 3):
        options = {d: error([*read, d]) for d in range(D) if d not in read}
        assert best == min(options, key=options.get)
        read.append(int(best))


def test_residuals_of_all_hypotheses_are_known_near_readings_as_regression_says(rng):
    where, taken = (rng.random((n, 3)) * 4.0 for n in (6, 3))
    lights = panel.fitted_pixels()
    lit, on_ball, level = coordinates(lights.wi, lights.wo), rng.random(len(lights.wi)), rng.random(6) + 0.5
    found = _residual(where, taken, level, on_ball)
    gain = np.linalg.solve(covariance(taken, taken) + 0.3 * np.eye(3), covariance(taken, where)).T
    left = covariance(where, where) - gain @ covariance(taken, where)
    expected = 0.1**2 * left * np.outer(level, level)
    np.testing.assert_allclose(found.at_candidates.T @ found.at_candidates, expected, atol=1e-6)
    pixel = lights.sums[[0]]
    first, light = pixel.indices, on_ball[pixel.indices] ** 3 * pixel.data
    to_pixel = (covariance(where, lit[first]) - gain @ covariance(taken, lit[first])) @ light / light.sum()
    pixel = np.cbrt(min(light.sum(), 1.0))
    np.testing.assert_allclose(
        found.at_candidates.T @ found.on_ball[:, 0], 0.1**2 * level * to_pixel * pixel, atol=1e-6
    )


def test_the_first_suggested_readings_include_a_highlight_and_a_body_direction(atoms):
    found = suggest(atoms, 3)
    half = found.wi + found.wo
    away = np.degrees(np.arccos(half[:, 2] / np.linalg.norm(half, axis=1)))
    assert away.min() < 5.0
    assert away.max() > 15.0


def test_suggestions_do_not_look_at_balls_in_the_test_lights(atoms):
    blind = replace(atoms, ball=np.zeros_like(atoms.ball))
    np.testing.assert_array_equal(suggest(blind, 4).wo, suggest(atoms, 4).wo)


# -- completions ------------------------------------------------------------------------------------------------


def test_a_completion_is_never_negative_meets_its_readings_and_grows_better_with_more(atoms):
    material = NAMES.index("syn_satin_gold")
    errors = []
    for count in (2, 40):
        found = suggest(atoms, count)
        directions = (found.wi, found.wo)
        made = leave_out(atoms, material, readings(np.ones((count, 3)), directions))
        errors.append(errors_of(atoms, material, made.on_grid, made.on_ball).cube_root)
        assert made.weights.min() >= 0.0
    assert errors[1] < errors[0]
    assert float(np.median(made.misfits)) < 0.1


def test_readings_are_met_as_well_as_the_instrument_repeats_them(atoms, tmp_path):
    """Of a paint whose flop no material of the library has; also in the file."""
    wi, wo = DIRECTIONS
    flop = 1.0 + 0.3 * np.cos(3.0 * np.arccos(np.clip(np.sum(wi * wo, axis=1), -1.0, 1.0)))
    read = readings(flop[:, None] * np.array([0.4, 0.1, 0.05]) / np.pi)
    met = [
        Completion.of(atoms, replace(read, repeatability=noise)).colour_misfits.max()
        for noise in (0.001, 0.3)
    ]
    assert met[0] < 0.05
    assert met[1] > 10.0 * met[0]
    made = Completion.of(atoms, read)
    file = output_file(made.brdf, "paint", COMPLETION_OPTIONS).file
    assert made.as_written(MeasuredBRDF(file)).colour_misfits.max() < 0.5


@pytest.mark.parametrize("alpha", [0.03, 0.12])
def test_gloss_that_no_material_of_the_library_has_is_that_of_a_dielectric(atoms, alpha):
    """Readings in the mirror direction and 20 degrees beside it tell the width by Fresnel's equations."""
    matt = atoms
    for name in ("syn_gloss_red", "syn_satin_gold"):
        matt = matt.without(matt.names.index(name))
    paint = Plastic(GGX.isotropic(alpha), np.array(1.5), np.array([0.5, 0.1, 0.05]), Bands(None))
    theta = np.deg2rad([(i, o) for i in (20, 40) for o in range(-60, 61, 20)])
    directions = from_spherical(theta[:, 0], np.pi), from_spherical(theta[:, 1], 0.0)
    read = readings(paint.eval(*directions), directions)
    made = Completion.of(matt, read)
    grid = matt.grid
    truth = paint.eval(grid.wi, grid.wo)
    error = cube_root_error(truth, made.brdf.eval(grid.wi, grid.wo), grid.cosines)
    assert error < 0.08
    np.testing.assert_allclose(made.on_grid, made.brdf.eval(grid.wi, grid.wo), rtol=1e-5, atol=1e-9)
    assert sum(weight for name, weight in made.made_of if name.startswith("dielectric coat")) > 0.7


def test_a_material_of_the_library_is_completed_to_what_it_is(atoms, library):
    brdf = MeasuredBRDF(Library.open(library).read("syn_paper_white"))
    wi, wo = DIRECTIONS
    made = Completion.of(atoms, readings(brdf.eval(wi, wo)))
    assert made.misfits.max() < 0.05
    grid = from_spherical(np.deg2rad(30.0), np.pi), from_spherical(np.deg2rad(10.0), 0.7)
    np.testing.assert_allclose(made.brdf.eval(*grid), brdf.eval(*grid), rtol=0.1)
    np.testing.assert_allclose(made.brdf.eval(wi, wo), made.predicted, rtol=1e-6)
    pairs = encoding_pairs()
    np.testing.assert_allclose(made.brdf.eval(pairs.wi, pairs.wo), made.on_grid, rtol=1e-5, atol=1e-9)
    assert sum(a.probability for a in made.alternatives) <= 1.0 + 1e-9
    assert np.all(made.factors_at(wi, wo) >= 1.0)


@pytest.mark.parametrize("name", ["syn_paper_white", "syn_gloss_red"])
def test_files_of_completions_are_sampled_as_they_reflect(atoms, library, name, rng):
    """Renders of them are as smooth as those of measured files: f cos / pdf is almost constant."""
    brdf = MeasuredBRDF(Library.open(library).read(name))
    made = Completion.of(atoms, readings(brdf.eval(*DIRECTIONS))).brdf
    file = MeasuredBRDF(output_file(ClippedBRDF(made), "completed")[0])
    for theta_deg in (20.0, 60.0):
        wi = from_spherical(np.deg2rad(theta_deg), 0.4)
        assert chi_square_p_value(file, wi, rng, n_samples=50_000) > 1e-3 / 4  # four tests of this kind
        w = np.broadcast_to(wi, (20_000, 3))
        wo, density = file.sample(w, rng.random((20_000, 2)))
        seen = density > 0.0
        weight = luminance(file.eval_cos(w[seen], wo[seen]), file.bands) / density[seen]
        assert weight.std() < 0.12 * weight.mean()  # 0.05 to 0.1, in measured files as well


def test_a_reading_without_light_has_a_finite_error(atoms, library):
    values = MeasuredBRDF(Library.open(library).read("syn_paper_white")).eval(*DIRECTIONS)
    values[5] = 0.0
    made = Completion.of(atoms, readings(values))
    assert 0.1 < made.misfits[5] < 20.0  # of a tenth of the mean, which the others have
    with pytest.raises(UsageError, match="none of 12 readings"):
        Completion.of(atoms, readings(np.zeros((12, 3))))


@pytest.fixture(scope="module")
def calibration(atoms):
    return calibrate(atoms, readings(np.ones((12, 3))))


def three(errors):
    """Ball, cube-root and linear errors: the rows of an array."""
    return np.array([errors.ball, errors.cube_root, errors.linear])


def test_errors_near_the_mirror_direction_are_apart_from_those_elsewhere(atoms, calibration):
    own, n = atoms.material_of == 0, atoms.n_grid
    truth = atoms.directions[own, :n].T ** 3
    mirrored = np.sum(atoms.grid.wi * atoms.grid.wo * [-1.0, -1.0, 1.0], axis=1)
    for is_wrong, near, elsewhere in (
        (mirrored > np.cos(np.deg2rad(10.0)), 1.0, 0.0),
        (mirrored < np.cos(np.deg2rad(10.0)), 0.0, 1.0),
    ):
        made = np.where(is_wrong[:, None], 8.0 * truth, truth)
        errors = expected.errors_of(atoms, 0, made, atoms.ball[own].T ** 3)
        # Eight times the value has twice the cube root; values are kept in single precision.
        assert (errors.near_mirror, errors.elsewhere) == pytest.approx((near, elsewhere), abs=1e-5)
    words = " ".join(calibration.expected_of_left_out.over(lambda values: float(values[0])).words)
    assert "within 10 degrees of the mirror direction" in words


def test_expected_errors_are_learned_from_the_other_materials(atoms, calibration):
    for m in (0, 5):
        made = leave_out(atoms, m, readings(np.ones((12, 3))))
        found = errors_of(atoms, m, made.on_grid, made.on_ball)
        np.testing.assert_allclose(three(calibration.errors)[:, m], three(found))
        np.testing.assert_allclose(calibration.residuals[m], made.residual)
        np.testing.assert_allclose(three(calibration.plausible)[:, m], three(plausible_errors(made)))
        others = np.arange(len(NAMES)) != m
        arrays = [Errors(*three(each)[:, others]) for each in (calibration.errors, calibration.plausible)]
        known = Calibration(*arrays, calibration.residuals[others])
        np.testing.assert_allclose(three(calibration.expected_of_left_out)[:, m], three(known.expected(made)))


def test_a_calibration_is_kept_in_the_library_for_its_instrument(
    atoms, calibration, library, tmp_path, monkeypatch
):
    path = tmp_path / "library.zarr"
    shutil.copytree(library, path)
    shutil.rmtree(path / "cache", ignore_errors=True)  # other tests may have kept this calibration
    opened = Library.open(path)
    computed = []

    def fake(atoms, evidence):
        computed.append(evidence.gloss)
        return calibration

    monkeypatch.setattr(expected, "_calibrated", fake)
    read = readings(np.ones((12, 3)))
    brighter = readings(np.full((12, 3), 2.0))  # at the same directions
    for one in (read, brighter):
        kept = calibrate(atoms, one, opened)
        np.testing.assert_array_equal(three(kept.errors), three(calibration.errors))
        np.testing.assert_array_equal(three(kept.plausible), three(calibration.plausible))
        np.testing.assert_array_equal(kept.residuals, calibration.residuals)
    assert len(computed) == 1
    for other in (
        replace(read, gloss={60.0: 1.0}), read.select_pairs(np.arange(11)), replace(read, weights=np.full(12, 2.0)),
    ):  # fmt: skip
        calibrate(atoms, other, opened)
    assert len(computed) == 4
    # Left-out materials are completed in the library's bands, and these are the same ones.
    calibrate(atoms, readings(np.ones((12, 3)), nm=np.array([450.0, 550.0, 650.0])), opened)
    assert len(computed) == 4
    for _ in range(2):  # of five of the materials: not the one that was kept for all six
        calibrate(atoms.without(0), read, opened)
    assert len(computed) == 5
    with monkeypatch.context() as changed:
        changed.setattr(panel, "judged", lambda: panel.panel(("white",)))
        calibrate(atoms, read, opened)
    assert len(computed) == 6
    for part in (path / "cache").rglob("*"):
        if part.is_file():
            part.write_bytes(b"damage")
    calibrate(atoms, read, opened)
    assert len(computed) == 7
    shutil.rmtree(path / "cache")
    monkeypatch.setattr("manifold.library.staging.writing", read_only)
    calibrate(atoms, read, opened)
    calibrate(atoms, read, opened)
    assert len(computed) == 9


def read_only(path):
    raise LibraryError(f"{path}: read-only")


def test_errors_of_bands_that_are_not_read_are_expected(atoms):
    """Calibrated on colours that were read, a completion from one band expected the error of a known colour."""
    spectral = replace(atoms, bands=Bands((450.0, 550.0, 650.0)))
    every, one = (
        readings(np.ones((12, len(nm))), nm=np.array(nm)) for nm in ([440.0, 560.0, 700.0], [540.0])
    )
    for m in range(len(atoms.names)):
        grey = leave_out(spectral, m, one)
        np.testing.assert_array_equal(grey.weights, grey.weights[:1].repeat(3, axis=0))
    coloured = calibrate(spectral, every).errors
    np.testing.assert_allclose(three(coloured), three(calibrate(spectral, readings(np.ones((12, 3)))).errors))
    missed = calibrate(spectral, one)
    assert np.median(missed.errors.ball) > 2.0 * np.median(coloured.ball)
    assert missed.expected(grey).ball > np.median(missed.errors.ball) / 2.0


def test_a_library_of_more_bands_than_atoms_have_is_calibrated_in_those_of_its_atoms(atoms):
    seven = Bands(tuple(np.linspace(400.0, 700.0, 7)))
    some = replace(atoms, bands=seven, atom_bands=np.array([0, 3, 6]))
    nm = np.array(seven.wavelengths_nm)
    read = readings(np.full((12, 7), 0.1), nm=nm)
    three = replace(atoms, bands=some.band_axis)
    fewer = replace(read, wavelengths_nm=nm[::3], values=read.values[:, ::3])
    for kind, errors in calibrate(three, fewer).errors.known.items():
        np.testing.assert_allclose(getattr(calibrate(some, read).errors, kind), errors, rtol=1e-9)


def test_a_residual_larger_than_of_any_left_out_material_is_noted(atoms, calibration, rng):
    most = int(calibration.residuals.argmax())
    own = leave_out(atoms, most, readings(np.ones((12, 3))))
    assert calibration.notes(own) == ()
    (note,) = calibration.notes(Completion.of(atoms, readings(np.exp(2.0 * rng.standard_normal((12, 3))))))
    assert "other units or directions" in note


@pytest.mark.parametrize(
    ("excess", "words"), [(1e-12, None), (0.04, None), (0.06, "is 10.6 %, .* at most 10 %")]
)
def test_a_residual_that_is_the_largest_but_for_rounding_is_not_noted(excess, words):
    ones = Errors(*np.ones((3, 4)))
    calibration = Calibration(ones, ones, np.array([0.02, 0.02, 0.02, 0.1]))
    read = SimpleNamespace(residual=0.1 * (1.0 + excess), evidence=Evidence())
    notes = calibration.notes(read)
    assert re.search(words, notes[0]) if words else notes == ()


@pytest.mark.parametrize(("N", "share"), [(19, 20.0 / 39.0), (1999, 20.0 / 2019.0)])
def test_expected_errors_are_the_plausible_ones_times_typical_ratios(rng, N, share):
    plausible = np.exp(rng.standard_normal((3, N)))
    # Of ratios from 0 to 1, half are below 0.5 and 90 % below 0.9. The world has 0.65, 1.35 and 1.2 (`_OF_WORLD`).
    ratios = np.array([np.linspace(0.0, 1.0, N)] * 3) * [[2.0], [1.0], [4.0]]
    held = Calibration(Errors(*plausible * ratios), Errors(*plausible), np.linspace(0.0, 0.1, N))
    own = np.median(ratios, axis=1)
    want = own * np.maximum(np.array([0.65, 1.35, 1.2]) / own, 1.0) ** share
    at, known = Errors(2.0, 3.0, 4.0), np.full(N, True)
    np.testing.assert_allclose(three(held.at(at, 0.05, known)), want * [2.0, 3.0, 4.0])
    never_seen = 0.5
    np.testing.assert_allclose(three(held.at(at, never_seen, known)), 5.0 * want * [2.0, 3.0, 4.0])


def test_a_typical_error_allows_for_one_more_than_were_seen():
    assert expected.typical(np.append(np.ones(8), 10.0)) == 5.0
    assert expected.typical(np.append(np.ones(99), 10.0)) == 1.0


def test_atoms_as_bright_as_in_the_library_keep_their_shares():
    found = Alike(np.full(2, 0.5), np.arange(2), np.array([2.0, 0.05]), np.array([1.0, 0.1]), 2)
    np.testing.assert_allclose(
        found.as_bright_as_atoms.scale, [1.0, 0.5]
    )  # no scale below a tenth is raised to 1
    np.testing.assert_allclose(found.as_bright_as_atoms.lambertian, [0.5, 1.0])


def test_errors_of_highlights_shrink_once_a_mirror_direction_is_read(atoms):
    mirror = from_spherical(np.deg2rad([45.0]), np.pi), from_spherical(np.deg2rad([45.0]), 0.0)
    with_mirror = tuple(np.vstack(both) for both in zip(DIRECTIONS, mirror, strict=True))
    for name in ("syn_felt_green", "syn_gloss_red"):
        off, on = (
            plausible_errors(leave_out(atoms, NAMES.index(name), readings(np.ones((len(pair[0]), 3)), pair)))
            for pair in (DIRECTIONS, with_mirror)
        )
        assert on.near_mirror < 0.7 * off.near_mirror


def test_readings_that_contradict_each_other_raise_the_expected_error(atoms, calibration):
    """0.1 and 0.9 at each geometry are no 0.5: their scatter is a residual."""
    wi, wo = (np.repeat(w, 2, axis=0) for w in DIRECTIONS)
    single = mean_of_repeats(*DIRECTIONS, np.full((12, 3), 0.5))
    both = mean_of_repeats(wi, wo, np.tile([[0.1], [0.9]], (12, 3)))
    assert single[4] == ()
    assert "contradict each other" in both[4][0]
    np.testing.assert_allclose(both[2], single[2])
    np.testing.assert_allclose(both[3], np.std(np.cbrt([0.1, 0.9]), ddof=1) / np.mean(np.cbrt([0.1, 0.9])))
    agreed, contradicted = (
        calibration.expected(Completion.of(atoms, replace(readings(found[2] / np.pi), scatter=found[3])))
        for found in (single, both)
    )
    assert contradicted.ball > 3.0 * agreed.ball
    assert contradicted.ball > 20.0  # half the difference in lightness is 29


def test_no_expected_error_is_nan(atoms, calibration):
    """Of twelve readings one alone is lit: no mixture is, and the residual is all that was read."""
    values = np.zeros((12, 3))
    values[3] = 0.1
    made = Completion.of(atoms, readings(values))
    assert np.all(np.isfinite(three(calibration.expected(made))))
    assert calibration.expected(made).cube_root > calibration.errors.cube_root.max()
    assert np.all(np.isfinite([a.difference for a in made.alternatives]))
    assert any("no mixture of two materials explains" in note for note in made.notes)


def test_notes_name_bands_and_highlights_that_were_not_read(atoms):
    made = Completion.of(atoms, readings(np.full((12, 3), 0.1)))
    red = readings(np.full((12, 1), 0.1), nm=np.array([650.0]))
    spectral = Completion.of(replace(atoms, bands=Bands((450.0, 550.0, 650.0))), red)
    assert "read at 650 nm only" in spectral.notes[0]
    assert any("the nearest reading is 15 degrees from a mirror direction" in note for note in made.notes)
    at = from_spherical(np.deg2rad(30.0), np.pi), from_spherical(np.deg2rad(28.0), 0.0)
    both = tuple(np.vstack([w, a]) for w, a in zip(DIRECTIONS, at, strict=True))
    assert not Completion.of(atoms, readings(np.full((13, 3), 0.1), both)).notes


def test_records_are_shown_in_one_line(atoms, calibration):
    made = Completion.of(atoms, readings(np.full((12, 3), 0.1)))
    assert repr(made.readings) == "<Readings: sample, 12 of test, RGB>"
    assert repr(made).startswith("<Completion: sample from 12 readings, ")
    assert repr(made.brdf).startswith("<AdjustedBRDF: RGB, of <PredictedBRDF: RGB, of ")
    assert repr(calibration).startswith("<Calibration: 6 materials left out, medians: ")


def test_suggestions_leave_out_what_was_read_and_keep_to_the_instrument(atoms):
    first = suggest(atoms, 12, instrument="ma-t12")
    assert len({tuple(row) for row in first.angles_deg.round()}) == 12
    made = Completion.of(atoms, readings(np.full((12, 3), 0.1)))
    part = replace(made, evidence=replace(made.evidence, readings=made.readings.select_pairs(np.arange(10))))
    for count, known, left in ((1, made, 0), (3, part, 2)):
        with pytest.raises(UsageError, match=f"only {left} of 12 directions of ma-t12 are left"):
            suggest(atoms, count, known, "ma-t12")
    assert len(suggest(atoms, 3, made).wi) == 3
    with pytest.raises(UsageError, match="no instrument"):
        suggest(atoms, 1, instrument="gonio")


def test_no_reading_is_suggested_where_the_receiver_hides_the_light(atoms):
    for instrument in (None, *INSTRUMENTS):
        found = suggest(atoms, 8, instrument=instrument)
        assert np.all(np.sum(found.wi * found.wo, axis=1) < np.cos(np.deg2rad(14.0)))


def test_alternatives_have_names_and_the_residual_that_the_note_has(atoms):
    """A hypothesis without light was a row without a name; of others that look alike, one's residual was shown."""
    made = Completion.of(atoms, readings(np.full((12, 3), 0.1)))
    (of,) = made.solution.hypotheses
    weights = np.zeros_like(of.weights[:3])
    weights[1] = of.weights[0]
    weights[2] = 1.01 * weights[1]  # looks like the second
    hypotheses = replace(of, probability=np.array([0.7, 0.2, 0.1]), weights=weights)
    black = replace(made, solution=replace(made.solution, hypotheses=(hypotheses,)))
    first, second = black.alternatives
    assert first.like == (("black", 1.0),)
    assert (first.probability, second.probability) == pytest.approx((0.7, 0.3))
    assert first.misfit == pytest.approx(1.0)
    total = np.sqrt(sum(a.probability * a.misfit**2 for a in black.alternatives))
    assert black.residual_of_mixtures == pytest.approx(total)
    note = next(note for note in black.notes if note.startswith("no mixture of two"))
    assert f"{100 * total:.0f} % before" in note
    assert f"{100 * black.residual_of_readings:.1f} % after" in note


def test_libraries_of_thousands_are_refused(library, monkeypatch):
    monkeypatch.setattr("manifold.estimate.atoms.MOST_MATERIALS", 3)
    with pytest.raises(UsageError, match="materials, expected at most 3 to complete readings from"):
        LibraryAtoms.of_library(Library.open(library))


# -- bands ------------------------------------------------------------------------------------------------------


def test_spectra_become_rgb_for_photographs_and_rgb_no_spectrum():
    nm = np.arange(400.0, 701.0, 10.0)
    white = readings(np.full((12, 31), 1.0 / np.pi), nm=nm)
    taken = in_channels(white, srgb_responses(white.bands))
    np.testing.assert_allclose(taken.values, 1.0 / np.pi, rtol=0.02)  # the light beyond 400 to 700 nm
    gaps = np.array(white.values)
    gaps[3, 5:7], gaps[4, -1] = np.nan, np.nan
    found = in_channels(readings(gaps, nm=nm), srgb_responses(Bands(nm))).values
    np.testing.assert_allclose(found[3], taken.values[3])
    assert np.isnan(found[4]).all()
    narrow = readings(np.tile([0.1, 0.2, 0.3], (12, 1)), nm=np.array([465.0, 525.0, 630.0]))
    assert for_library(narrow, Bands((400.0, 500.0, 600.0, 700.0))).bands == SPECTRUM
    with pytest.raises(BandMismatchError, match="expected blue, green and red"):
        for_library(readings(np.ones((12, 3)), nm=np.array([800.0, 900.0, 1000.0])), Bands(None))
    with pytest.raises(BandMismatchError, match="linear sRGB"):
        for_library(readings(np.ones((12, 3))), Bands((400.0, 500.0)))


def test_colours_of_coarse_bands_are_noted_for_an_rgb_library():
    coarse = readings(np.ones((12, 7)), nm=np.arange(400.0, 701.0, 50.0))
    (note,) = for_library(coarse, Bands(None)).notes
    assert note.startswith(
        "colours are interpolated between 7 bands, 400.0 to 700.0 nm: expected colour error 2.0"
    )
    assert for_library(coarse, Bands((400.0, 500.0))).notes == ()
    assert for_library(readings(np.ones((12, 16)), nm=np.arange(400.0, 701.0, 20.0)), Bands(None)).notes == ()


def test_spectra_survive_an_rgb_library(atoms):
    assert atoms.bands.is_rgb
    nm = np.arange(400.0, 701.0, 10.0)
    dyed = 0.2 + 0.15 * np.sin(nm / 25.0)  # which no three numbers are
    read = readings(np.tile(dyed / np.pi, (12, 1)), nm=nm)
    made = Completion.of(atoms, read)
    assert made.brdf.bands == read.bands
    np.testing.assert_allclose(made.brdf.eval(read.wi, read.wo), read.values, rtol=0.02)
    assert made.on_ball.shape[1] == 31
    assert not any("extrapolated" in note for note in made.notes)


def test_the_error_of_estimated_colours_is_part_of_the_expected_one(atoms, calibration):
    made = Completion.of(atoms, readings(np.full((12, 3), 0.1), nm=np.array([465.0, 525.0, 630.0])))
    assert made.readings.colour_error > 1.0
    assert any("spectra are estimated from 3 bands at 465, 525, 630 nm" in note for note in made.notes)
    measured = replace(made.readings, colour_error=0.0)
    known = replace(made, evidence=replace(made.evidence, readings=measured))
    measured, estimated = (calibration.expected(one).ball for one in (known, made))
    assert estimated == pytest.approx(np.hypot(measured, made.readings.colour_error))


def test_weights_between_bands_are_linear_and_beyond_them_constant():
    bands = Bands((380.0, 400.0, 410.0, 420.0, 800.0))
    read = readings(np.ones((12, 2)), nm=np.array([400.0, 420.0]))
    weights = in_all_bands(np.array([[1.0, 0.0], [3.0, 0.0]]), read, bands)
    np.testing.assert_allclose(weights[:, 0], [1.0, 1.0, 2.0, 3.0, 3.0])
    assert not weights[:, 1].any()


# -- the command ------------------------------------------------------------------------------------------------


def test_the_command_writes_a_file_from_a_table_of_readings(run, library, tmp_path):
    brdf = MeasuredBRDF(Library.open(library).read("syn_felt_orange"))
    wi, wo = DIRECTIONS
    csv_table.write(tmp_path / "felt.csv", readings(brdf.eval(wi, wo)))
    status, out, err = run(
        "complete", "felt.csv", "-L", library, "-o", "felt_rgb.bsdf", "--suggest", "2", "--json", "felt.json",
        "--report", "felt.html", cwd=tmp_path,
    )  # fmt: skip
    assert status == 0, err
    shown = [
        out.index(each)
        for each in ("expected error", "next", "manifold export felt_rgb.bsdf", "Measure next")
    ]
    assert shown == sorted(shown)
    mixtures = json.loads((tmp_path / "felt.json").read_text())["alternatives"]
    table = (tmp_path / "felt.html").read_text().partition("Most probable mixtures")[2]
    assert all(f"{100 * mixture['difference']:.0f} %" in table for mixture in mixtures)
    written = MeasuredBRDF(read_bsdf(tmp_path / "felt_rgb.bsdf"))
    assert float(np.median(np.abs(written.eval(wi, wo) / brdf.eval(wi, wo) - 1.0))) < 0.05
    document = json.loads((tmp_path / "felt.json").read_text())
    assert len(document["suggested_deg"]) == 2
    assert document["expected"]["ball"] > 0.0


def test_without_readings_the_first_directions_are_suggested_or_asked_for(run, library, tmp_path):
    status, out, err = run("complete", "-L", library, "--suggest", "2", cwd=tmp_path)
    assert (status, out.startswith("Measure first")) == (0, True), err
    for arguments, what in (
        (("complete", "-L", library), "no readings are given"),
        (("complete", "felt.csv", "-L", library, "--instrument", "ma-t12"), "give --suggest K"),
        (
            ("complete", "-L", "none.zarr", "--instrument", "ma-t12", "--suggest", "13"),
            "only 12 of 12 directions",
        ),
        (("chart", "--readings", "--model", "model.h5"), "leave --model"),
    ):
        status, _, err = run(*arguments, cwd=tmp_path)
        assert (status, what in err) == (2, True)


@pytest.mark.parametrize(
    ("unit", "albedo", "is_said"), [("brdf", 2.5, True), ("brdf", 0.9, False), (None, 2.5, False)]
)
def test_an_albedo_above_1_of_values_without_a_unit_asks_for_the_unit(unit, albedo, is_said):
    read = replace(readings(np.full((len(DIRECTIONS[0]), 3), 0.8)), assumed_unit=unit)
    plausibility = Plausibility(
        negative_share=0.0, reciprocity_error=0.0, max_albedo=albedo, highlight_valley=0.0
    )
    notes = of_unit(read, plausibility)
    assert [("--unit factor" in note and "expected error" in note) for note in notes] == [True] * is_said


@pytest.mark.parametrize(
    ("fault", "unit", "step", "begins"),
    [
        (None, None, NextStep.EXPORT, "use it"),
        (None, "a BRDF in 1/sr", NextStep.EXPORT, "use it if the values are a BRDF in 1/sr"),
        (
            "albedo 2.21; check the unit", "a BRDF in 1/sr", NextStep.CHECK_OBSERVATIONS,
            "do not use it: albedo 2.21",
        ),
    ],
)  # fmt: skip
def test_a_completion_in_doubt_is_not_simply_to_be_used(fault, unit, step, begins):
    sure = Errors(ball=0.5, cube_root=0.05, near_mirror=0.05, elsewhere=0.05)
    advised, said = advise(sure, None, fault=fault, unit=unit)
    assert advised is step
    assert said is not None
    assert said.startswith(begins)
    assert (said == "use it") == (fault is None and unit is None)


@pytest.mark.parametrize("large", [{"near_mirror": 0.9}, {"near_mirror": 0.9, "elsewhere": 0.9}])
def test_large_expected_errors_ask_for_more_readings(large):
    errors = Errors(**({"ball": 9.0, "cube_root": 0.9, "near_mirror": 0.05, "elsewhere": 0.05} | large))
    assert advise(errors, None).step is NextStep.READ_MORE


def test_readings_darker_than_all_materials_ask_for_their_unit(atoms):
    f = np.ones((len(DIRECTIONS[0]), 3))
    dark, usual = (Completion.of(atoms, readings(scale * f)) for scale in (1e-9, 0.1))
    assert dark.is_too_dark
    assert "check their unit" in dark.notes[0]
    assert not usual.is_too_dark


def test_a_material_is_left_out_by_its_name_or_its_index_and_unknown_ones_are_refused(atoms):
    by_name, by_index = atoms.without(NAMES[1]), atoms.without(1)
    assert by_name.names == by_index.names == (NAMES[0], *NAMES[2:])
    assert len(by_name) < len(atoms)
    for unknown in ("chm_mint", len(NAMES), -1):
        with pytest.raises(UnknownNameError, match=f"no material '?{unknown}"):
            atoms.without(unknown)


def test_a_left_out_reading_is_that_which_the_others_predict(atoms):
    wi, wo = DIRECTIONS
    brdf = MeasuredBRDF(measured("syn_felt_orange"))
    read = readings(brdf.eval(wi, wo))
    found = left_out_readings(Completion.of(atoms, read))
    assert found is not None
    others = Completion.of(atoms, read.select_pairs(np.arange(len(wi)) != 4))
    f, f_star = read.values[4], others.brdf.eval(wi[[4]], wo[[4]])[0]
    expected = np.linalg.norm(np.cbrt(f_star) - np.cbrt(f)) / np.linalg.norm(np.cbrt(f))
    assert found.relative[4] == pytest.approx(expected, rel=1e-6)
    assert found.relative.shape == found.ciede2000.shape == (len(wi),)


def test_expected_errors_are_at_least_those_of_left_out_readings(atoms):
    made = Completion.of(atoms, readings(np.full((12, 3), 0.1)))
    calibration = calibrate(made.atoms, made.exposed)
    usual = calibration.expected(made)
    better, worse = (LeftOutReadings(np.full(12, off), np.full(12, 50.0 * off)) for off in (1e-3, 0.9))
    assert calibration.expected(made, better) == usual
    raised = calibration.expected(made, worse)
    assert (raised.ball, raised.elsewhere, raised.near_mirror) == (45.0, 0.9, usual.near_mirror)
    assert advise(raised, None).words == "do not use it: 90 % expected cube-root error beside highlights"


def test_many_readings_or_one_are_not_left_out_in_turn(atoms):
    one = readings(np.full((12, 3), 0.1)).select_pairs([0])
    assert left_out_readings(Completion.of(atoms, one)) is None


@pytest.mark.parametrize(
    ("step", "suggested", "next_step"),
    [
        (NextStep.EXPORT, None, "manifold export a.bsdf -o a.glb"),
        (NextStep.READ_MORE, None, "manifold complete a.csv --suggest 3"),
        (NextStep.READ_MORE, object(), "measure the directions below"),
        (NextStep.CHECK_OBSERVATIONS, None, None),
    ],
)
def test_the_next_step_follows_from_the_advice(capsys, step, suggested, next_step):
    made = SimpleNamespace(
        summary={"advice": "in words"}, next_step=step, path=Path("a.bsdf"), suggested=suggested,
        diagnostics=tuple("abcdef"),
    )  # fmt: skip
    show_completed(terminal.Results(), made, None, [Path("a.csv")])
    out = capsys.readouterr().out
    assert (next_step is None and "  next " not in out) or f"next        {next_step}" in out
    assert "2 (--json lists all as diagnostics)" in out
