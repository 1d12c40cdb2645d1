"""Completion of readings: weights, hypotheses, what to read next, two instruments as one, and the command."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from small_library import NAMES

from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import Plausibility
from manifold.colour.correction import learn_correction
from manifold.directions import from_spherical
from manifold.errors import BandMismatchError, FileFormatError, UsageError
from manifold.experiments.readings.curve import measure_curves
from manifold.formats import csv_table, registry
from manifold.formats.readings import MA_T12_NAMES, Readings, geometry_ma_t12
from manifold.formats.registry import read_readings
from manifold.io_rgl import read_bsdf
from manifold.library.store import Library
from manifold.model.completion import calibrate, complete, suggest
from manifold.model.completion.correction_file import read_correction, write_correction
from manifold.model.completion.expected import Calibration, completion_errors, indicators_of, leave_out
from manifold.model.completion.hybrid import Hybrid, InstrumentCorrection, combine, corrected
from manifold.model.completion.reading_bands import for_library, in_all_bands
from manifold.models.band_mixtures import band_mixtures
from manifold.models.completion_weights import completion_weights
from manifold.models.decoder import EncodingPairs
from manifold.models.mixtures import log_of_norm, normalised, posterior
from manifold.models.nearby import covariance, nearby_factors, places
from manifold.models.next_readings import colours, hypotheses, missed, next_readings
from manifold.records import Bands
from manifold.workflows import completions

DIRECTIONS = geometry_ma_t12()
APART = np.arange(9.0)[:, None] * np.full(3, 50.0)
"""Places of nine readings that have nothing to do with each other."""


def readings(values, directions=DIRECTIONS, nm=None):
    return Readings("sample", "test", *directions, nm, values)


def random_samples(rng, n=5, P=9, Q=40):
    everywhere = rng.random((n + 1, Q)) + 0.1
    return everywhere[:, :P], everywhere, everywhere @ everywhere.T / Q


# -- hypotheses -------------------------------------------------------------------------------------------------


def of_materials(count, per=2):
    """Groups of samples, and of the Lambertian."""
    return np.append(np.repeat(np.arange(count), per), count)


def test_mixtures_meet_the_readings_as_a_search_over_scale_and_lambertian_does(rng):
    at, _, gram = random_samples(rng, n=6)
    target, weights, where = rng.random(9) + 0.2, rng.random(9) + 0.5, rng.random((9, 3)) * 6.0
    found = posterior(at, target, weights, where, gram, of_materials(3))
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
    at, _, gram = random_samples(rng, n=6, P=9)
    target = 0.5 * at[1] + 0.5 * at[4]
    found = posterior(at, target, np.ones(9), APART, gram, of_materials(3))
    best = found.most_probable(1)[0]
    assert {found.first[best], found.second[best]} == {1, 4}
    np.testing.assert_allclose(found.weights(np.array([best]))[0] @ at, target, rtol=0.02)


def test_a_mixture_without_light_is_never_the_most_probable():
    """Its squared norm of 0 was rewarded beyond any misfit: thousands of readings ended in a black completion."""
    probability = normalised(-log_of_norm(np.array([0.0, 1.0, 4.0])))
    np.testing.assert_allclose(probability, np.array([0.0, 1.0, 4.0**-2.5]) / (1.0 + 4.0**-2.5))
    np.testing.assert_array_equal(log_of_norm(np.zeros(3)), np.zeros(3))


def candidates(at, target, where, gram):
    """How many mixtures a posterior is spread over: the exponential of its entropy."""
    p = posterior(at, target, np.ones(9), where, gram, of_materials(3)).probability
    return np.exp(-np.sum(p * np.log(p + 1e-300)))


def test_no_mixture_is_certain_where_none_meets_the_readings(rng):
    at, _, gram = random_samples(rng, n=6, P=9)
    near, far = at[1] * 1.02, at[1] * np.where(np.arange(9) % 2, 1.6, 0.6)
    assert candidates(at, far, APART, gram) > 3.0 * candidates(at, near, APART, gram)


def test_what_mixtures_miss_at_neighbouring_readings_is_counted_once(rng):
    """Three readings beside each other that are all 10 % brighter tell less against a mixture than three apart."""
    at, _, gram = random_samples(rng, n=6, P=9)
    brighter = at[1] * np.where(np.arange(9) < 3, 1.1, 1.0)
    together = APART.copy()
    together[:3] = [[0.0, 0.0, 0.0], [0.6, 0.0, 0.0], [0.0, 0.6, 0.0]]  # in three cells
    doubt_beside, doubt_apart = (
        1.0 - posterior(at, brighter, np.ones(9), where, gram, of_materials(3)).probability[1]
        for where in (together, APART)
    )
    assert doubt_beside < 0.5 * doubt_apart


def test_a_material_of_the_library_is_likelier_than_a_mixture_of_two_that_reads_the_same(rng):
    at, everywhere, _ = random_samples(rng, n=6, P=9)
    at[3], everywhere[3] = 0.5 * (at[0] + at[5]), 0.5 * (everywhere[0] + everywhere[5])
    gram = everywhere @ everywhere.T / everywhere.shape[1]
    found = posterior(at, at[3], np.ones(9), APART, gram, of_materials(3))
    alone = found.probability[3]
    both = (found.first == 0) & (found.second == 5) & (found.share == 0.5)
    # 15 mixtures are within a material, 36 of two.
    assert alone / found.probability[both].sum() == pytest.approx(0.8 / 15 / (0.2 / 36), rel=1e-6)


def test_weights_are_never_negative_and_meet_what_samples_can(rng):
    at, _, gram = random_samples(rng, n=6, P=9)
    truth = np.array([[0.5, 0, 0.3, 0, 0, 0, 0.2], [0.2, 0, 0.6, 0, 0, 0, 0.1]])
    targets = truth @ at
    supposed = np.tile(truth.mean(axis=0), (2, 1))
    found = completion_weights(at, targets, np.ones(9), gram, supposed)
    assert found.min() >= 0.0
    assert np.abs(found @ at - targets).max() < 0.05 * targets.max()
    targets[1, :4] = np.nan
    some = completion_weights(at, targets, np.ones(9), gram, supposed)
    assert np.isfinite(some).all()
    assert np.abs(some[1] @ at - truth[1] @ at).max() < 0.1 * targets[0].max()
    targets[1] = np.nan
    np.testing.assert_allclose(completion_weights(at, targets, np.ones(9), gram, supposed)[1], supposed[1])


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
    gram = at @ at.T / 9.0
    group = of_materials(3)
    for material in (1, 2):
        targets = 0.9 * at[group == material]
        of_mean = posterior(at, targets.mean(axis=0), np.ones(9), APART, gram, group)
        found = band_mixtures(of_mean, at, targets, np.ones(9), APART, gram, group)
        assert found.probability.sum() == pytest.approx(1.0)
        likeliest = np.bincount(group, found.weights[0])
        assert likeliest.argmax() == material
        assert found.probability[0] > 0.5
        assert np.abs(found.mean @ at - targets).max() < 0.05 * targets.max()
        assert found.mean.min() >= 0.0


def test_bands_that_were_not_measured_are_not_asked(rng):
    at = white_and_tinted_coats(rng)
    gram, group = at @ at.T / 9.0, of_materials(3)
    targets = at[group == 1]
    of_mean = posterior(at, targets.mean(axis=0), np.ones(9), APART, gram, group)
    gaps = targets.copy()
    gaps[1, 2:4] = np.nan
    full, some = (band_mixtures(of_mean, at, t, np.ones(9), APART, gram, group) for t in (targets, gaps))
    np.testing.assert_allclose(some.mean @ at, full.mean @ at, atol=0.05)
    gaps[1] = np.nan
    nothing = band_mixtures(of_mean, at, gaps, np.ones(9), APART, gram, group)
    np.testing.assert_allclose(nothing.mean[0] @ at, targets[0], atol=0.05)
    np.testing.assert_allclose(nothing.mean[1], nothing.mean[0])


def test_what_is_missed_at_readings_is_carried_to_their_neighbourhood(rng):
    wi, wo = DIRECTIONS
    where = places(wi, wo)
    predicted = rng.random((2, 12)) + 0.5
    targets = predicted * np.array([[1.2], [0.9]])
    found = nearby_factors(targets, predicted, where, np.ones(12))
    # Between nothing and all: of readings 15 degrees apart some agree.
    assert np.all((found.at(where) - 1.0) / np.array([[0.2], [-0.1]]) > 0.6)
    assert np.all((found.at(where) - 1.0) / np.array([[0.2], [-0.1]]) < 1.2)
    grazing = from_spherical(np.deg2rad(85.0), np.pi), from_spherical(np.deg2rad(85.0), np.pi / 2)
    np.testing.assert_allclose(found.at(places(*(w[None] for w in grazing))), 1.0, atol=0.01)
    np.testing.assert_allclose(found.at(places(wo, wi)), found.at(where))  # reciprocal
    mirrored = np.array([1.0, -1.0, 1.0])
    np.testing.assert_allclose(found.at(places(wi * mirrored, wo * mirrored)), found.at(where))
    targets[1, :5] = np.nan
    some = nearby_factors(targets, predicted, where, np.ones(12))
    np.testing.assert_allclose(some.at(where)[0], found.at(where)[0])
    of_measured = nearby_factors(targets[1:, 5:], predicted[1:, 5:], where[5:], np.ones(7))
    np.testing.assert_allclose(some.at(where)[1], of_measured.at(where)[0], rtol=1e-6)


def test_thousands_of_readings_are_averaged_where_they_are_near_each_other(rng):
    wi, wo = (
        from_spherical(np.arccos(rng.uniform(0.1, 1.0, 3000)), rng.uniform(-np.pi, np.pi, 3000)) for _ in "io"
    )
    where = places(wi, wo)
    predicted = np.ones((1, 3000))
    found = nearby_factors(
        1.0 + 0.2 * wo[:, 2] * wi[:, 2] + 0.2 * rng.standard_normal((1, 3000)),
        predicted,
        where,
        np.ones(3000),
    )
    assert found.strength.shape[1] <= 256
    wrong = found.at(where)[0] - 1.0 - 0.2 * wo[:, 2] * wi[:, 2]
    assert np.sqrt(np.mean(wrong**2)) < 0.05  # a quarter of the noise


def test_the_next_reading_is_the_one_that_lowers_both_errors_most(rng):
    H, M, D, P, K = 30, 12, 7, 11, 5
    everywhere, weights = rng.random((H, P)) + 1.0, rng.random(P)
    on_ball, candidates, probability = rng.random((H, K)), rng.random((H, D)) + 1.0, np.full(H, 1.0 / H)
    colour_ball, colour_at = rng.standard_normal((M, K)) / 5.0, rng.standard_normal((M, D + 1)) / 5.0
    square, taken_square = np.mean(candidates**2, axis=0), np.array([1.3])
    structure = hypotheses(everywhere, on_ball, candidates, probability, weights)
    colour = colours(colour_ball, colour_at[:, :D], square, colour_at[:, D:], taken_square)
    chosen = next_readings((structure, colour), 3)

    def left(covariance, wanted, read, noise):
        k = wanted + np.array(read, dtype=int)
        K_read = covariance[np.ix_(k, k)] + np.diag(noise[np.array(read, dtype=int)])
        posterior = covariance - covariance[:, k] @ np.linalg.solve(K_read, covariance[k])
        return np.diag(posterior)[:wanted]

    of_structure = np.cov(np.hstack([everywhere, on_ball, candidates]).T, bias=True)
    joint = np.hstack([colour_ball, colour_at])
    of_colour = joint.T @ joint / M
    squares = np.append(square, taken_square)
    noise = 0.02**2 * (square + 0.1**2 * square.mean())
    colour_noise = 0.05**2 * (squares + 0.1**2 * squares.mean())

    def error(read):
        variance = left(of_structure, P + K, read, noise)
        pixels = variance[P:] + left(of_colour, K, [D, *read], colour_noise)
        return 0.5 * np.log(variance[:P] @ weights) + 3.0 * np.log(np.mean(np.sqrt(pixels) + 1e-4))

    read: list[int] = []
    for best in chosen:
        options = {d: error([*read, d]) for d in range(D) if d not in read}
        assert best == min(options, key=options.get)
        read.append(int(best))


def test_what_no_hypothesis_meets_is_known_near_readings_as_regression_says(rng):
    where, taken, lit = (rng.random((n, 3)) * 4.0 for n in (6, 3, 10))
    level, light, starts, pixels = rng.random(6) + 0.5, rng.random(10), np.array([0, 4]), np.array([0.7, 0.4])
    found = missed(where, taken, level, lit, light, starts, pixels)
    K = covariance(taken, taken) + 0.3 * np.eye(3)
    left = covariance(where, where) - covariance(where, taken) @ np.linalg.solve(K, covariance(taken, where))
    expected = 0.1**2 * left * np.outer(level, level)
    np.testing.assert_allclose(found.at_candidates.T @ found.at_candidates, expected, atol=1e-6)
    shares = np.zeros((10, 2))
    shares[:4, 0], shares[4:, 1] = light[:4] / light[:4].sum(), light[4:] / light[4:].sum()
    to_lit = covariance(where, lit) - covariance(where, taken) @ np.linalg.solve(K, covariance(taken, lit))
    expected = 0.1**2 * level[:, None] * (to_lit @ shares) * pixels
    np.testing.assert_allclose(found.at_candidates.T @ found.on_ball, expected, atol=1e-6)


def test_readings_after_a_mirror_direction_are_told_to_look_at_the_colour(samples):
    """What the colour of a body is cannot be seen in its highlight: of two readings, one is away from it."""
    found = suggest(samples, 3)
    half = found.wi + found.wo
    away = np.degrees(np.arccos(half[:, 2] / np.linalg.norm(half, axis=1)))
    assert away.min() < 5.0
    assert away.max() > 15.0


# -- completions ------------------------------------------------------------------------------------------------


def test_a_completion_is_never_negative_meets_its_readings_and_grows_better_with_more(samples):
    material = NAMES.index("syn_satin_gold")
    errors = []
    for count in (2, 40):
        found = suggest(samples, count)
        directions = (found.wi, found.wo)
        at = samples.at(*directions)
        made = leave_out(samples, material, at, readings(np.ones((count, 3)), directions))
        errors.append(completion_errors(samples, material, made)[1])
        assert made.weights.min() >= 0.0
    assert errors[1] < errors[0]
    assert float(np.median(made.misfits)) < 0.1


def test_a_material_of_the_library_is_completed_to_what_it_is(samples, library):
    brdf = MeasuredBRDF(Library.open(library).read("syn_paper_white"))
    wi, wo = DIRECTIONS
    made = complete(samples, readings(brdf.eval(wi, wo)))
    assert made.misfits.max() < 0.05
    grid = from_spherical(np.deg2rad(30.0), np.pi), from_spherical(np.deg2rad(10.0), 0.7)
    np.testing.assert_allclose(made.brdf.eval(*grid), brdf.eval(*grid), rtol=0.1)
    np.testing.assert_allclose(made.brdf.eval(wi, wo), made.predicted, rtol=1e-6)
    pairs = EncodingPairs.default()
    np.testing.assert_allclose(made.brdf.eval(pairs.wi, pairs.wo), made.on_grid, rtol=1e-5, atol=1e-9)
    assert sum(a.probability for a in made.alternatives) <= 1.0 + 1e-9
    assert len(made.spread_at(wi, wo)) == 12


def test_a_reading_without_light_has_an_error_that_can_be_told(samples, library):
    brdf = MeasuredBRDF(Library.open(library).read("syn_paper_white"))
    values = brdf.eval(*DIRECTIONS)
    values[5] = 0.0
    made = complete(samples, readings(values))
    assert 0.1 < made.misfits[5] < 20.0  # of a tenth of the mean, which the others have


def test_expected_errors_are_learned_from_the_other_materials(samples):
    found = calibrate(samples, readings(np.ones((12, 3))))
    at = samples.at(*DIRECTIONS)
    for m in (0, 5):
        made = leave_out(samples, m, at, readings(np.ones((12, 3))))
        np.testing.assert_allclose(found.errors[m], completion_errors(samples, m, made))
        np.testing.assert_allclose(found.indicators[m], indicators_of(made))
        others = np.arange(len(NAMES)) != m
        learned = Calibration(found.errors[others], found.indicators[others]).expected(made)
        np.testing.assert_allclose(found.left_out[m], list(learned.values()))


def test_errors_of_bands_that_are_not_read_are_expected(samples):
    """Calibrated on colours that were read, a completion from one band expected the error of a known colour."""
    spectral = replace(samples, bands=Bands((450.0, 550.0, 650.0)))
    at = samples.at(*DIRECTIONS)
    every, one = (
        readings(np.ones((12, len(nm))), nm=np.array(nm)) for nm in ([440.0, 560.0, 700.0], [540.0])
    )
    for m in range(len(samples.names)):
        grey = leave_out(spectral, m, at, one)
        np.testing.assert_array_equal(grey.weights, grey.weights[:1].repeat(3, axis=0))
    coloured = calibrate(spectral, every).errors
    np.testing.assert_allclose(coloured, calibrate(spectral, readings(np.ones((12, 3)))).errors)
    missed = calibrate(spectral, one)
    assert np.median(missed.errors[:, 0]) > 2.0 * np.median(coloured[:, 0])
    assert missed.expected(grey)["ball"] > np.median(missed.errors[:, 0]) / 2.0


def test_readings_that_no_material_meets_so_badly_are_said(samples, rng):
    calibration = calibrate(samples, readings(np.ones((12, 3))))
    own = leave_out(samples, 2, samples.at(*DIRECTIONS), readings(np.ones((12, 3))))
    assert calibration.notes(own) == ()
    (note,) = calibration.notes(complete(samples, readings(np.exp(2.0 * rng.standard_normal((12, 3))))))
    assert "other units or directions" in note


def test_expected_errors_are_the_line_of_their_logarithms(rng):
    x = rng.standard_normal((400, 2))
    x = (x - x.mean(axis=0)) @ np.linalg.inv(np.linalg.cholesky(np.cov(x.T, bias=True)).T)  # uncorrelated
    slopes = np.array([[1.0, 0.0, 0.0], [0.0, 0.5, -1.0]])
    held = Calibration(np.exp(1.0 + x @ slopes), np.exp(x))
    # Ridge regression on standardised, uncorrelated indicators divides slopes by 1 + 0.1; negative ones are 0.
    line = np.array([[1.0 / 1.1, 0.0, 0.0], [0.0, 0.5 / 1.1, 0.0]])
    above = x @ (slopes - line)
    # Twice the expected is enough for 90 %: only the third kind, which no sign tells, needs more than the median.
    raised = np.maximum(np.median(above, axis=0), np.quantile(above, 0.9, axis=0) - np.log(2.0))
    assert raised[2] > np.median(above[:, 2])
    expected = held.expected(SimpleNamespace(misfits=np.exp([1.0]), spread=np.exp(0.5)))
    want = np.exp(1.0 + np.array([1.0, 0.5]) @ line + raised)
    np.testing.assert_allclose(list(expected.values()), want, rtol=1e-6)  # 1e-6 is added to deviations


def test_a_completion_says_that_one_band_tells_no_colour(samples):
    made = complete(samples, readings(np.full((12, 3), 0.1)))
    red = readings(np.full((12, 1), 0.1), nm=np.array([650.0]))
    spectral = replace(made, samples=SimpleNamespace(bands=Bands((450.0, 550.0, 650.0))), readings=red)
    assert spectral.notes[0].startswith("read at 650 nm only, which tells no colour: the result is")


def test_a_completion_says_that_no_reading_sees_mirrors(samples):
    from_spectro = complete(samples, readings(np.full((12, 3), 0.1)))
    assert any("no reading within 15 degrees of a mirror direction" in note for note in from_spectro.notes)
    at = from_spherical(np.deg2rad(30.0), np.pi), from_spherical(np.deg2rad(28.0), 0.0)
    both = tuple(np.vstack([w, a]) for w, a in zip(DIRECTIONS, at, strict=True))
    assert not complete(samples, readings(np.full((13, 3), 0.1), both)).notes


def test_suggestions_leave_out_what_was_read_and_keep_to_the_instrument(samples):
    first = suggest(samples, 12, instrument="ma-t12")
    assert len({tuple(row) for row in first.angles_deg.round()}) == 12
    made = complete(samples, readings(np.full((12, 3), 0.1)))
    with pytest.raises(UsageError, match="have all 12 directions of ma-t12 already"):
        suggest(samples, 1, made, "ma-t12")
    part = replace(made, readings=made.readings.select_pairs(np.arange(10)))
    with pytest.raises(
        UsageError, match=r"3 readings .* 12 directions of ma-t12 and 10 of them read, expected 1 to 2;"
    ):
        suggest(samples, 3, part, "ma-t12")
    assert len(suggest(samples, 3, made).wi) == 3
    with pytest.raises(UsageError, match="no instrument"):
        suggest(samples, 1, instrument="gonio")


def test_curves_of_readings_are_those_of_completions(samples):
    curves = measure_curves(samples, (1, 6), ("completion", "nearest"))
    assert [curve.key for curve in curves] == ["completion", "nearest", "ma_t12", "ma_t12_gloss"]
    at = samples.at(*DIRECTIONS)
    own = completion_errors(samples, 2, leave_out(samples, 2, at, readings(np.ones((12, 3)))))
    np.testing.assert_allclose(curves[-2].errors[0, 2], own, rtol=1e-9)
    assert [curve.counts for curve in curves[-2:]] == [(12,), (14,)]
    assert np.median(curves[-1].errors[0, :, 1]) < np.median(curves[-2].errors[0, :, 1])
    with pytest.raises(UsageError, match="no method"):
        measure_curves(samples, (1,), ("magic",))


def test_interrupted_curves_are_continued_and_finished_ones_measured_again(samples, library, monkeypatch):
    measured: list[int] = []

    def measure(samples, m, counts, methods, candidates, fixed):
        measured.append(m)
        return {method.key: np.full((len(counts), 3), float(m)) for method in methods} | {
            key: np.full((1, 3), -float(m)) for key in fixed
        }

    def interrupt(done: int, total: int, name: str) -> None:
        if done == 2:
            raise KeyboardInterrupt

    def curves(on_progress=None, only=("nearest",), on_result=None):
        measured.clear()
        return measure_curves(samples, (1, 6), only, on_progress, Library.open(library), on_result)

    monkeypatch.setattr("manifold.experiments.readings.curve._errors_of", measure)
    everything = list(range(len(samples.names)))

    def interrupt_drawing(curves) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        curves(interrupt)
    assert measured == [0, 1]
    curves(only=("completion",))
    assert measured == everything  # another chart shares nothing with it
    with pytest.raises(KeyboardInterrupt):
        curves(on_result=interrupt_drawing)
    assert measured == everything[2:]
    nearest, fixed, _ = curves()
    assert measured == []
    np.testing.assert_array_equal(nearest.errors[1, :, 2], everything)
    np.testing.assert_array_equal(fixed.errors[0, :, 2], -np.array(everything))
    curves()
    assert measured == everything


@pytest.mark.slow
def test_curves_of_fits_begin_where_readings_make_one_and_are_plain_json(samples):
    fitted = measure_curves(samples, (1, 6), ("principled",))[0]
    assert not fitted.is_measured(0)
    assert fitted.is_measured(1)
    json.dumps(fitted.to_json(), allow_nan=False)


# -- bands ------------------------------------------------------------------------------------------------------


def test_spectra_become_rgb_for_an_rgb_library_and_rgb_no_spectrum():
    nm = np.arange(400.0, 701.0, 10.0)
    white = readings(np.full((12, 31), 1.0 / np.pi), nm=nm)
    taken = for_library(white, Bands(None))
    np.testing.assert_allclose(taken.values, 1.0 / np.pi, rtol=0.02)  # the light beyond 400 to 700 nm
    gaps = np.array(white.values)
    gaps[3, 5:7], gaps[4, -1] = np.nan, np.nan
    found = for_library(readings(gaps, nm=nm), Bands(None)).values
    np.testing.assert_allclose(found[3], taken.values[3])
    assert np.isnan(found[4]).all()
    narrow = readings(np.tile([0.1, 0.2, 0.3], (12, 1)), nm=np.array([465.0, 525.0, 630.0]))
    np.testing.assert_array_equal(for_library(narrow, Bands(None)).values[0], [0.3, 0.2, 0.1])
    with pytest.raises(BandMismatchError, match="linear sRGB"):
        for_library(readings(np.ones((12, 3))), Bands((400.0, 500.0)))


def test_weights_between_bands_are_linear_and_beyond_them_constant():
    bands = Bands((380.0, 400.0, 410.0, 420.0, 800.0))
    read = readings(np.ones((12, 2)), nm=np.array([400.0, 420.0]))
    weights = in_all_bands(np.array([[1.0, 0.0], [3.0, 0.0]]), read, bands)
    np.testing.assert_allclose(weights[:, 0], [1.0, 1.0, 2.0, 3.0, 3.0])
    assert not weights[:, 1].any()


def test_no_reading_with_light_is_one_error(samples):
    with pytest.raises(UsageError, match="none of 12 readings"):
        complete(samples, readings(np.zeros((12, 3))))


# -- two instruments --------------------------------------------------------------------------------------------


def test_an_exact_linear_relation_is_found_and_continued_in_proportion(rng):
    x = rng.random((20, 3))
    M = rng.random((3, 5))
    found = learn_correction(x, x @ M)
    assert found.form == "linear"
    np.testing.assert_allclose(found.apply(7.0 * x), 7.0 * x @ M, rtol=1e-9)


def test_overfitting_forms_lose_on_values_left_out(rng):
    x = rng.random((12, 3)) + 0.05
    y = (x @ rng.random((3, 4))) * (1.0 + 0.05 * rng.standard_normal((12, 4)))
    found = learn_correction(x, y)
    assert found.errors["Cheung 2004, 10 terms"] > found.errors["linear"]
    assert found.form in ("linear", "root polynomial of degree 2")
    with pytest.raises(UsageError, match="four or more"):
        learn_correction(x[:3], y[:3])


def test_a_correction_from_few_directions_is_read_as_it_was_written(rng, tmp_path):
    x = rng.random((4, 3)) + 0.1
    learned = InstrumentCorrection(
        learn_correction(x, x @ rng.random((3, 2))), Bands((465.0, 525.0, 630.0)), Bands((450.0, 650.0))
    )
    assert np.isnan(learned.colours.errors["linear"])  # three terms of four values: none can be left out
    write_correction(tmp_path / "c.json", learned)
    found = read_correction(tmp_path / "c.json")
    assert (found.source, found.target) == (learned.source, learned.target)
    assert np.isnan(found.colours.errors["linear"])
    np.testing.assert_array_equal(found.colours.apply(x), learned.colours.apply(x))


def test_samples_are_left_out_whole(rng):
    x, groups = rng.random((12, 3)) + 0.05, np.repeat(np.arange(4), 3)
    y = (x @ rng.random((3, 4))) * (1.0 + 0.05 * rng.standard_normal((12, 4)))
    found = learn_correction(x, y, ("linear",), groups)
    norm = np.linalg.norm(y, axis=1, keepdims=True) + 1e-3 * x.max()  # what is darker counts as this dark
    missed = []
    for g in range(4):
        out = groups == g
        M = np.linalg.lstsq((x / norm)[~out], (y / norm)[~out], rcond=None)[0]
        missed.append((x / norm)[out] @ M - (y / norm)[out])
    expected = np.sqrt(np.mean(np.sum(np.vstack(missed) ** 2, axis=1)))
    assert found.errors["linear"] == pytest.approx(expected, rel=1e-6)


def test_a_goniometer_gets_the_colours_of_the_spectrophotometer(samples, library, rng):
    brdf = MeasuredBRDF(Library.open(library).read("syn_felt_green"))
    nm = np.linspace(400.0, 700.0, 31)
    spectra = np.array([np.interp(nm, [420.0, 550.0, 650.0], row[::-1]) for row in brdf.eval(*DIRECTIONS)])
    theta_i, theta_o, phi = (
        a.ravel() for a in np.meshgrid([0, 20, 40, 60], np.arange(0, 75, 5), np.arange(0, 181, 20))
    )
    wi = from_spherical(np.deg2rad(theta_i.astype(float)), np.pi)
    wo = from_spherical(np.deg2rad(theta_o.astype(float)), np.deg2rad(phi.astype(float)))
    camera = np.array([[0.7, 0.1, 0.1], [0.2, 0.9, 0.1], [0.0, 0.1, 0.5]])
    gonio = readings(brdf.eval(wi, wo) @ camera, (wi, wo), np.array([465.0, 525.0, 630.0]))
    found = combine(readings(spectra, nm=nm), gonio)
    assert found.shared >= 6
    assert found.correction is not None
    truth = np.array([np.interp(nm, [420.0, 550.0, 650.0], row[::-1]) for row in brdf.eval(wi, wo)])
    made = found.readings.values[12:]
    assert float(np.median(np.abs(made - truth) / truth.max(axis=1, keepdims=True))) < 0.03
    assert found.readings.bands.count == 31
    assert "a leave-one-out error of" in found.readings.notes[-1]
    assert "one sample" not in found.readings.notes[-1]
    of_another = replace(gonio, values=gonio.values[rng.permutation(len(gonio))], name="other")
    mixed = combine(readings(spectra, nm=nm), of_another)
    assert mixed.readings.notes[-1].endswith("do both files read one sample, sample and other?")
    with pytest.raises(BandMismatchError, match="expected three bands, to be corrected"):
        combine(readings(spectra, nm=nm), readings(spectra[:, :5], nm=nm[:5]))


# -- the command ------------------------------------------------------------------------------------------------


def test_the_command_writes_a_file_from_a_table_of_readings(run, library, tmp_path):
    brdf = MeasuredBRDF(Library.open(library).read("syn_felt_orange"))
    wi, wo = DIRECTIONS
    csv_table.write(tmp_path / "felt.csv", readings(brdf.eval(wi, wo)))
    status, out, err = run(
        "complete", "felt.csv", "-L", library, "-o", "felt_rgb.bsdf", "--suggest", "2", "--json", "felt.json",
        cwd=tmp_path,
    )  # fmt: skip
    assert status == 0, err
    assert "expected error" in out
    mixtures = [a["probability"] for a in json.loads((tmp_path / "felt.json").read_text())["alternatives"]]
    table = out.partition("Mixtures of materials that explain")[2].partition("Measure next")
    assert table[1]
    assert table[0].count(" %") == 2 * sum(p >= 0.005 for p in mixtures)  # the others are in the JSON alone
    written = MeasuredBRDF(read_bsdf(tmp_path / "felt_rgb.bsdf"))
    assert float(np.median(np.abs(written.eval(wi, wo) / brdf.eval(wi, wo) - 1.0))) < 0.05
    document = json.loads((tmp_path / "felt.json").read_text())
    assert len(document["suggested_deg"]) == 2
    assert document["expected"]["ball"] > 0.0


def test_directions_to_measure_first_are_the_first_line(run, library, tmp_path):
    status, out, err = run("complete", "-L", library, "--suggest", "2", cwd=tmp_path)
    assert status == 0, err
    assert out.startswith("Measure first")
    assert len(out.splitlines()) == 4


def test_what_returns_too_much_light_can_be_made_physical_and_keeps_its_hue(library, tmp_path, monkeypatch):
    asked = {}

    def write(*_, **how):
        asked.update(how)
        return Plausibility(0.0, 0.2, 0.99, 0.0)

    monkeypatch.setattr(completions, "write_checked", write)
    hybrid = Hybrid(readings(np.full((12, 3), 0.5)), None, 0)
    made = completions.complete_readings(hybrid, library, tmp_path / "x.bsdf", physical=True)
    assert (asked["physical"], asked["keeps_hue"]) == (True, True)
    assert "--physical" in asked["remedy"]
    assert any("still differ" in note for note in made.diagnostics)


def test_options_that_would_be_ignored_are_usage_errors(run, library, tmp_path):
    for arguments, what in (
        (("complete", "-L", library), "no file of readings"),
        (("complete", "felt.csv", "-L", library, "--instrument", "ma-t12"), "give --suggest K"),
        (("complete", "-L", "none.zarr", "--instrument", "ma-t12", "--suggest", "13"), "expected 1 to 12"),
        (("chart", "--readings", "--model", "model.h5"), "leave --model"),
    ):
        status, _, err = run(*arguments, cwd=tmp_path)
        assert (status, what in err) == (2, True)


def test_a_file_named_like_the_sample_is_not_replaced(run, library, tmp_path):
    csv_table.write(tmp_path / "read.csv", readings(np.full((12, 3), 0.1)))
    (tmp_path / "sample.bsdf").write_bytes(b"tensor_file of somebody")
    status, _, err = run("complete", "read.csv", "-L", library, cwd=tmp_path)
    assert (status, "exists, and was not" in err) == (2, True)
    assert (tmp_path / "sample.bsdf").read_bytes() == b"tensor_file of somebody"


def test_a_correction_is_learned_across_samples_written_and_applied(run, tmp_path, rng):
    nm = np.arange(400.0, 701.0, 20.0)
    theta_i, theta_o, phi = (
        a.ravel() for a in np.meshgrid([0, 20, 40, 60], np.arange(0, 75, 10), [0, 60, 120, 180])
    )
    wi = from_spherical(np.deg2rad(theta_i.astype(float)), np.pi)
    wo = from_spherical(np.deg2rad(theta_o.astype(float)), np.deg2rad(phi.astype(float)))
    sensors = rng.random((3, len(nm)))

    names = []
    for k in range(5):
        spectrum = 0.1 + rng.random(3) @ np.array(
            [np.exp(-(((nm - c) / 60.0) ** 2)) for c in (450, 550, 650)]
        )
        flat = readings(np.tile(spectrum, (12, 1)), nm=nm)
        gonio = readings(np.tile(sensors @ spectrum, (len(wi), 1)), (wi, wo), np.array([465.0, 525.0, 630.0]))
        csv_table.write(tmp_path / f"s{k}.csv", flat)
        csv_table.write(tmp_path / f"g{k}.csv", gonio)
        names += [f"s{k}.csv", f"g{k}.csv"]
    status, out, err = run("calibrate", *names, "-o", "c.json", cwd=tmp_path)
    assert status == 0, err
    assert "chosen" in out
    learned = read_correction(tmp_path / "c.json")
    made = corrected(read_readings(tmp_path / "g3.csv"), learned)
    truth = read_readings(tmp_path / "s3.csv").values[0]
    np.testing.assert_allclose(made.values, np.tile(truth, (len(made), 1)), rtol=0.05)
    with pytest.raises(BandMismatchError, match="another instrument"):
        corrected(readings(np.ones((12, 3))), learned)
    status, out, err = run("convert", "g3.csv", "-o", "g3.bsdf", "--correction", "c.json", cwd=tmp_path)
    assert status == 0, err
    spectral = MeasuredBRDF(read_bsdf(tmp_path / "g3.bsdf"))
    assert spectral.bands == learned.target
    np.testing.assert_allclose(spectral.eval(wi[5], wo[5]), truth, rtol=0.05)
    status, _, err = run("convert", "g3.bsdf", "-o", "g4.bsdf", "--correction", "c.json", cwd=tmp_path)
    assert (status, "leave --correction out" in err) == (2, True)
    (tmp_path / "c.json").write_text("{}")
    with pytest.raises(FileFormatError, match="not a colour correction"):
        read_correction(tmp_path / "c.json")
    assert run("calibrate", names[0], cwd=tmp_path)[0] == 2
    for count, words in (
        (1, "one sample determines the correction of its own colour"),
        (3, "3 samples determine"),
    ):
        status, out, err = run("calibrate", *names[: 2 * count], "-o", f"c{count}.json", cwd=tmp_path)
        assert status == 0, err
        assert f"note: {words}" in out
        assert ("reading by reading of the one sample" in out) == (count == 1)


def test_fit_takes_readings_and_says_what_they_do_not_determine(run, library, tmp_path):
    brdf = MeasuredBRDF(Library.open(library).read("syn_felt_orange"))
    wi, wo = DIRECTIONS
    csv_table.write(tmp_path / "felt.csv", readings(brdf.eval(wi, wo)))
    status, _, err = run("fit", "felt.csv", "-o", "felt.fit.json", cwd=tmp_path)
    assert status == 0, err
    content = json.loads((tmp_path / "felt.fit.json").read_text())
    assert content["source"]["file"] == "felt.csv"
    assert content["residuals"]["cube-root"] < 0.1
    csv_table.write(tmp_path / "few.csv", readings(brdf.eval(wi, wo)).select_pairs(np.arange(2)))
    status, _, err = run("fit", "few.csv", "-o", "few.fit.json", cwd=tmp_path)
    assert status == 1
    assert "expected 4 or more" in err
    status, _, err = run("fit", "felt.csv", "-o", "again.fit.json", "--picture", cwd=tmp_path)
    assert (status, "leave --picture" in err) == (2, True)
    assert not (tmp_path / "again.fit.json").exists()


def table_of(path, samples):
    rows = [f"{name},{g},{v},{v},{v}" for name, v in samples.items() for g in MA_T12_NAMES]
    path.write_text("\n".join(["Name,Geometry,465,525,630", *rows]))


def test_samples_of_two_files_are_paired_by_name(tmp_path):
    """`calibrate` advised --sample, which it does not have."""
    a, b, c = (tmp_path / f"{name}.csv" for name in "abc")
    table_of(a, {"red": 0.2, "blue": 0.4})
    table_of(b, {"blue": 0.4, "red": 0.2, "green": 0.3})
    table_of(c, {"other": 0.2})
    assert [(x.name, y.name) for x, y in registry.read_pairs(a, b)] == [("red", "red"), ("blue", "blue")]
    assert [(x.name, y.name) for x, y in registry.read_pairs(c, c)] == [("other", "other")]
    with pytest.raises(UsageError, match=r"a\.csv holds 2 samples, c\.csv 1, and no name is in both"):
        registry.read_pairs(a, c)


def test_a_sample_is_chosen_of_every_file_with_several(run, tmp_path):
    table_of(tmp_path / "one.csv", {"own": 0.2})
    table_of(tmp_path / "several.csv", {"red": 0.2, "blue": 0.4})
    both = [tmp_path / "several.csv", tmp_path / "one.csv"]
    for files in (both, both[::-1]):
        assert completions.read(files, "blue").readings.values.max() == pytest.approx(0.4 / np.pi)
    with pytest.raises(UsageError, match="no sample 'blue'; it holds own"):
        completions.read(both[1:], "blue")
    with pytest.raises(UsageError, match="no file holds a sample 'blue', but own; name another"):
        completions.read([both[1]] * 2, "blue")
    with pytest.raises(UsageError, match="no sample 'own'; it holds red, blue"):
        completions.read(both[::-1], "own")
    for name in ("red", "blue"):
        status, out, err = run("fit", "several.csv", "--sample", name, "-o", "x.fit.json", cwd=tmp_path)
        assert (status, "up to date" in out) == (0, False), err
        assert json.loads((tmp_path / "x.fit.json").read_text())["source"]["name"] == name
    status, _, err = run("fit", "several.csv", cwd=tmp_path)
    assert (status, err.count("several.csv")) == (1, 1)


def test_a_correction_that_is_no_text_is_refused_in_plain_words(tmp_path):
    path = tmp_path / "correction.json"
    path.write_bytes(bytes(range(128, 256)))
    with pytest.raises(
        FileFormatError, match="found no text, expected a colour correction of `manifold calibrate`"
    ):
        read_correction(path)
