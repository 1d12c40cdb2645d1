"""The measured BRDF: agreement with Mitsuba, sampling, albedo, and input it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.chi_square import chi_square_p_value
from helpers.mitsuba_reference import measured
from helpers.paths import real_rgl_files
from helpers.sample_files import sample_file
from hypothesis import given, settings
from hypothesis import strategies as st

from manifold.analytic import corpus
from manifold.brdf import goniometer
from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.warp import cumulative_sums
from manifold.core.directions import from_spherical, hemisphere_quadrature, to_spherical
from manifold.core.errors import ShapeError
from manifold.core.records import Bands
from manifold.io_rgl import read_bsdf, write_bsdf

PAIRS = 5_000
ANISOTROPIC = {m.name for m in corpus.anisotropic_materials()}
BY_NAME = {m.name: m for m in corpus.isotropic_materials() + corpus.anisotropic_materials()}

# Ten files of the corpus: dull to sharp, the 48 x 48 and 64 x 64 ones, three anisotropic, two RGB.
CASES = [
    ("syn_felt_green", False),
    ("syn_standard_white", False),
    ("syn_satin_gold", False),
    ("syn_gloss_yellow", False),
    ("syn_chrome_plain", False),
    ("syn_flake_blue_fine", False),
    ("syn_brushed_chromium", False),
    ("syn_weave_sari", False),
    ("syn_iridescent_green", True),
    ("syn_brushed_gold", True),
]


def random_directions(rng, n):
    """Uniform over the hemisphere down to the horizon, in single precision as Mitsuba takes them."""
    z = rng.uniform(0.0, 1.0, n)
    phi = rng.uniform(-np.pi, np.pi, n)
    s = np.sqrt(1.0 - z * z)
    w = np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=-1).astype(np.float32).astype(np.float64)
    return w / np.linalg.norm(w, axis=-1, keepdims=True)


@pytest.fixture(scope="module")
def corpus_file(tmp_path_factory):
    """Path of a corpus file, measured once per module; the anisotropic ones without noise, in few bands."""
    folder = tmp_path_factory.mktemp("corpus")

    def path_of(name, rgb):
        path = folder / f"{name}_{'rgb' if rgb else 'spec'}.bsdf"
        if not path.exists():
            made = few_bands if name in ANISOTROPIC else corpus.measure
            write_bsdf(path, made(BY_NAME[name], rgb=rgb))
        return path

    return path_of


def few_bands(material, *, rgb):
    """A material measured at nine wavelengths, or at three that stand for RGB."""
    bands = Bands((465.0, 525.0, 630.0) if rgb else tuple(np.linspace(360.0, 1000.0, 9)))
    file = goniometer.measure(material.truth(bands), material.name, resolution=material.resolution)
    return replace(file, wavelengths_nm=None) if rgb else file


def reference_tables(file, wi, wo):
    """Where direction pairs fall in the tables of a file, in plain NumPy.

    Returns a function of a shift of the warped coordinates that gives the stored values (K, B), the luminance
    density (K,), and the factors that turn them into f_cos and pdf.
    """
    m = wi + wo
    m /= np.linalg.norm(m, axis=-1, keepdims=True)
    (theta_i, phi_i), (theta_m, phi_m) = to_spherical(wi), to_spherical(m)
    x = np.sqrt(theta_m * 2 / np.pi)
    y = (phi_m - phi_i + np.pi) / (2 * np.pi) % 1.0
    nodes = file.theta_i_rad.astype(float)
    k = np.clip(np.searchsorted(nodes, theta_i, side="right") - 1, 0, len(nodes) - 2)
    t = np.clip((theta_i - nodes[k]) / np.diff(nodes)[k], 0, 1)
    uv, vndf_pdf = invert(file.vndf, k, t, x, y)
    scale = bilinear(file.ndf[None, None], 0 * k, x, y)[:, 0] / (
        4
        * bilinear(file.sigma[None, None], 0 * k, np.sqrt(theta_i * 2 / np.pi), phi_i / (2 * np.pi) + 0.5)[
            :, 0
        ]
    )
    jacobian = 2 * np.pi**2 * x * np.sin(theta_m) * 4 * np.sum(wi * m, axis=-1)
    density = cumulative_sums(np.maximum(file.luminance, 0))[0]
    density = density.reshape(len(file.theta_i_rad), 1, *file.luminance.shape[2:])
    density = density * (density.shape[2] - 1) * (density.shape[3] - 1)

    def evaluate(shift):
        u, v = np.clip(uv + shift, 0, 1).T
        stored, luminance = (
            (1 - t)[:, None] * bilinear(table, k, u, v) + t[:, None] * bilinear(table, k + 1, u, v)
            for table in (file.spectra[0], density)
        )
        return stored * scale[:, None], luminance[:, 0] * vndf_pdf / jacobian

    return evaluate


def invert(values, k, t, x, y):
    """Variates (K, 2) of points of the warp between slices k and k + 1, and the densities there."""
    data, conditional, marginal = cumulative_sums(values)
    rows, columns = data.shape[1:]
    j = np.clip((x * (columns - 1)).astype(int), 0, columns - 2)
    i = np.clip((y * (rows - 1)).astype(int), 0, rows - 2)
    tx, ty = x * (columns - 1) - j, y * (rows - 1) - i

    def at(table, *node):
        return (1 - t) * table[(k, *node)] + t * table[(k + 1, *node)]

    def along(table, column):
        return (1 - ty) * at(table, i, column) + ty * at(table, i + 1, column)

    left, right, total = along(data, j), along(data, j + 1), along(conditional, -1)
    u = (along(conditional, j) + tx * left + tx**2 / 2 * (right - left)) / total
    low, high = at(conditional, i, -1), at(conditional, i + 1, -1)
    v = at(marginal, i) + ty * low + ty**2 / 2 * (high - low)
    return np.stack([u, v], axis=-1), ((1 - tx) * left + tx * right) * (rows - 1) * (columns - 1)


def bilinear(tables, k, x, y):
    """Values at (x, y) of tables[k], shape (T, B, H, W): (K, B)."""
    rows, columns = tables.shape[2:]
    j = np.clip((x * (columns - 1)).astype(int), 0, columns - 2)
    i = np.clip((y * (rows - 1)).astype(int), 0, rows - 2)
    tx, ty = (x * (columns - 1) - j)[:, None], (y * (rows - 1) - i)[:, None]
    corner = [tables[k, :, i + a, j + b].astype(np.float64) for a in (0, 1) for b in (0, 1)]
    return (1 - ty) * ((1 - tx) * corner[0] + tx * corner[1]) + ty * ((1 - tx) * corner[2] + tx * corner[3])


def compare_with_mitsuba(path, rng):
    """For f_cos and pdf on random pairs: our value, and Mitsuba's."""
    file = read_bsdf(path)
    brdf = MeasuredBRDF(file)
    wi, wo = random_directions(rng, PAIRS), random_directions(rng, PAIRS)
    if file.wavelengths_nm is None:
        bands, wavelengths = np.tile(np.arange(3), (PAIRS, 1)), None
    else:
        bands = rng.integers(0, len(file.wavelengths_nm), (PAIRS, 4))
        wavelengths = file.wavelengths_nm[bands].astype(np.float64)
    expected_f, expected_pdf = measured(path, wi, wo, wavelengths)
    f = np.take_along_axis(brdf.eval_cos(wi, wo), bands, axis=1)
    return (f, expected_f), (brdf.pdf(wi, wo), expected_pdf), (file, wi, wo)


def assert_agrees(found, expected, slack=0.0):
    deviation = np.abs(found - expected)
    assert np.mean(deviation <= 1e-3 * np.abs(expected) + slack) >= 0.999
    assert deviation.max() <= 1e-4 * np.abs(expected).max()


@pytest.mark.parametrize(("name", "rgb"), CASES)
def test_corpus_files_evaluate_as_in_mitsuba(corpus_file, rng, name, rgb):
    f, pdf, _ = compare_with_mitsuba(corpus_file(name, rgb), rng)
    assert_agrees(*f)
    assert_agrees(*pdf)


@pytest.mark.parametrize("path", real_rgl_files() or [None], ids=lambda p: p.stem if p else "none")
def test_real_files_evaluate_as_in_mitsuba(path, rng, tmp_path):
    if path is None:
        pytest.skip("no real RGL files: set MANIFOLD_RGL_DIR to a folder of them")
    if read_bsdf(path).luminance.min() < 0:
        # A handful of cells just below zero would make Mitsuba's density negative; ours counts them as zero.
        file = read_bsdf(path)
        path = tmp_path / path.name
        write_bsdf(path, replace(file, luminance=np.maximum(file.luminance, 0)))
    f, pdf, (file, wi, wo) = compare_with_mitsuba(path, rng)
    # In real files the last column of the warped grid, beyond the horizon, is zero. Close to it a value is
    # proportional to 1 - u, of which single precision keeps few digits or none: moving u and v by one unit
    # in the last place changes it by `slack`, and that much Mitsuba may be off.
    slack_f, slack_pdf = np.zeros_like(f[0]), np.zeros_like(pdf[0])
    if file.is_isotropic and file.wavelengths_nm is None:
        evaluate = reference_tables(file, wi, wo)
        here_f, here_pdf = evaluate(np.zeros(2))
        for shift in 2.0**-23 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]):
            moved_f, moved_pdf = evaluate(shift)
            slack_f = np.maximum(slack_f, np.abs(moved_f - here_f))
            slack_pdf = np.maximum(slack_pdf, np.abs(moved_pdf - here_pdf))
    assert_agrees(*f, slack_f)
    assert_agrees(*pdf, slack_pdf)


@pytest.mark.parametrize("name", ["syn_iridescent_green", "syn_chrome_plain"])
def test_evaluation_agrees_with_plain_numpy(corpus_file, rng, name):
    file = read_bsdf(corpus_file(name, True))
    brdf = MeasuredBRDF(file)
    wi, wo = random_directions(rng, 3000), random_directions(rng, 3000)
    f_cos, pdf = reference_tables(file, wi, wo)(np.zeros(2))
    for found, expected in ((brdf.eval_cos(wi, wo), f_cos), (brdf.pdf(wi, wo), pdf)):
        # Where values vanish, u is near 1 and 1 - u loses digits.
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12 * expected.max())


@pytest.mark.parametrize("name", ["syn_iridescent_green", "syn_chrome_plain", "syn_weave_sari"])
def test_directions_in_single_precision_give_such_values(corpus_file, rng, name):
    brdf = MeasuredBRDF(read_bsdf(corpus_file(name, True))).turned(0.3)
    wi, wo = (random_directions(rng, 3000).astype(np.float32) for _ in range(2))
    u = rng.random((3000, 2), np.float32)
    single = brdf.eval(wi, wo), brdf.eval_cos(wi, wo), brdf.pdf(wi, wo), *brdf.sample(wi, u)
    wi, wo, u = (a.astype(float) for a in (wi, wo, u))
    double = brdf.eval(wi, wo), brdf.eval_cos(wi, wo), brdf.pdf(wi, wo), *brdf.sample(wi, u)
    for found, expected in zip(single, double, strict=True):
        assert found.dtype == np.float32
        assert expected.dtype == np.float64
        # Directions are turned back after they were rounded.
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["syn_satin_gold", "syn_weave_sari"])
def test_one_direction_is_evaluated_with_all_others(corpus_file, rng, name):
    brdf = MeasuredBRDF(read_bsdf(corpus_file(name, False)))
    wi, wo = random_directions(rng, 1)[0], random_directions(rng, 3000)
    all_wi = np.tile(wi, (3000, 1))
    for of in (brdf.eval, brdf.eval_cos, brdf.pdf):
        np.testing.assert_array_equal(of(wi, wo), of(all_wi, wo))
        np.testing.assert_array_equal(of(wo, wi), of(wo, all_wi))
    u = rng.random((3000, 2))
    for found, expected in zip(brdf.sample(wi, u), brdf.sample(all_wi, u), strict=True):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(
    ("case", "theta_deg"),
    [(CASES[2], 80.0), (CASES[4], 40.0), (CASES[6], 0.0), (CASES[6], 80.0), (CASES[8], 40.0)],
)
def test_samples_follow_the_pdf(corpus_file, rng, case, theta_deg):
    name, rgb = case
    brdf = MeasuredBRDF(read_bsdf(corpus_file(name, rgb)))
    wi = from_spherical(np.deg2rad(theta_deg), 0.7)
    # Chrome's lobes, three degrees wide, need 24 points a cell for their expected counts.
    assert chi_square_p_value(brdf, wi, rng, order=24 if "chrom" in name else 8) > 1e-4


@pytest.mark.parametrize(("name", "rgb"), [CASES[0], CASES[3], CASES[7]])
def test_sampled_pdf_is_the_pdf(corpus_file, rng, name, rgb):
    brdf = MeasuredBRDF(read_bsdf(corpus_file(name, rgb)))
    wi = random_directions(rng, 2000)
    wo, pdf = brdf.sample(wi, rng.random((2000, 2)))
    kept = pdf > 0
    assert kept.mean() > 0.5
    # Near the normal of the half vector an angle of 1e-16 is a coordinate of 1e-8.
    np.testing.assert_allclose(brdf.pdf(wi[kept], wo[kept]), pdf[kept], rtol=1e-6)


@pytest.mark.parametrize("name", ["syn_satin_gold", "syn_weave_sari"])
def test_albedo_is_the_integral_over_the_hemisphere(corpus_file, name):
    brdf = MeasuredBRDF(read_bsdf(corpus_file(name, False)))
    wi = from_spherical(np.deg2rad([0.0, 30.0, 60.0]), 0.3)
    wo, weights = hemisphere_quadrature(96, 192)
    for k in range(3):
        integral = weights @ brdf.eval_cos(wi[k], wo)
        np.testing.assert_allclose(brdf.albedo(wi[k]), integral, rtol=5e-3)  # both are quadratures


def test_isotropic_files_do_not_change_when_both_directions_turn(corpus_file, rng):
    brdf = MeasuredBRDF(read_bsdf(corpus_file("syn_satin_gold", False)))
    wi, wo = random_directions(rng, 500), random_directions(rng, 500)
    turn = np.array([[np.cos(1.1), -np.sin(1.1), 0], [np.sin(1.1), np.cos(1.1), 0], [0, 0, 1]])
    np.testing.assert_allclose(brdf.eval(wi @ turn.T, wo @ turn.T), brdf.eval(wi, wo), rtol=1e-7, atol=1e-9)


def test_half_turn_files_look_the_same_after_half_a_turn(corpus_file, rng):
    brdf = MeasuredBRDF(read_bsdf(corpus_file("syn_weave_sari", False)))
    wi, wo = random_directions(rng, 500), random_directions(rng, 500)
    half = np.array([-1.0, -1.0, 1.0])
    np.testing.assert_allclose(brdf.eval(wi * half, wo * half), brdf.eval(wi, wo), rtol=1e-9)


def test_nothing_is_reflected_below_the_horizon(corpus_file):
    brdf = MeasuredBRDF(read_bsdf(corpus_file("syn_satin_gold", False)))
    up, down = from_spherical(0.4, 0.0), from_spherical(2.0, 0.0)
    flat = np.array([1.0, 0.0, 0.0])
    for wi, wo in [(up, down), (down, up), (down, down), (up, flat), (flat, up)]:
        assert not np.any(brdf.eval(wi, wo))
        assert brdf.pdf(wi, wo) == 0.0
    assert brdf.sample(down, np.array([0.3, 0.6]))[1] == 0.0


@settings(deadline=None, max_examples=25)
@given(lead=st.lists(st.integers(1, 4), max_size=3), seed=st.integers(0, 1000))
def test_directions_broadcast(corpus_file, lead, seed):
    rng = np.random.default_rng(seed)
    brdf = MeasuredBRDF(read_bsdf(corpus_file("syn_iridescent_green", True)))
    wi = random_directions(rng, 1)[0]
    wo = random_directions(rng, int(np.prod(lead))).reshape(*lead, 3)
    f = brdf.eval(wi, wo)
    assert f.shape == (*lead, 3)
    one = (0,) * len(lead)
    np.testing.assert_array_equal(f[one], brdf.eval(wi, wo[one]))


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 0.0), (np.float32, 1e-6)])
def test_values_are_written_where_asked(corpus_file, rng, dtype, tolerance):
    brdf = MeasuredBRDF(read_bsdf(corpus_file("syn_satin_gold", False)))
    wi, wo = (random_directions(rng, 60).reshape(3, 20, 3) for _ in range(2))
    out = np.full((3, 20, brdf.bands.count), np.nan, dtype)
    assert brdf.eval(wi, wo, out=out) is out
    np.testing.assert_allclose(out, brdf.eval(wi, wo), rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("name", ["syn_satin_gold", "syn_brushed_chromium"])
def test_few_pairs_have_the_values_that_they_have_among_many(corpus_file, rng, name):
    """Few are evaluated in one thread."""
    brdf = MeasuredBRDF(read_bsdf(corpus_file(name, False)))
    wi, wo = random_directions(rng, 5000), random_directions(rng, 5000)
    for of in (brdf.eval, brdf.eval_cos):
        np.testing.assert_allclose(of(wi[-7:], wo[-7:]), of(wi, wo)[-7:], rtol=1e-12)  # rounding


@pytest.mark.parametrize(
    "out",
    [np.empty(195, np.float16), np.empty((195, 2))[:, 0], np.empty(194)],
    ids=["half", "strided", "short"],
)
def test_what_values_do_not_fit_into_is_refused(corpus_file, out):
    brdf = MeasuredBRDF(read_bsdf(corpus_file("syn_satin_gold", False)))
    up = np.array([0.0, 0.0, 1.0])
    with pytest.raises(ShapeError, match=r"out is float.* expected contiguous float32 or float64 \(195,\)"):
        brdf.eval(up, up, out=out)


@pytest.mark.parametrize(
    ("wi", "words"),
    [
        (np.zeros((2, 2)), "shape"),
        (np.array([0.0, 0.0, np.nan]), "finite"),
        (np.array([0.0, 0.0, 2.0]), "length 2"),
        (np.zeros(3), "length 0"),
        ([[0.0, 0.0, 1.0], [0.0, 1.0]], "wi: rows of different lengths"),
        (np.array([0.0, 0.0, 1.0j]), "wi: values of type complex128, expected real numbers"),
        (["x", "y", "z"], "wi: values of type <U1"),
        (None, "shape"),
    ],
)
def test_what_is_no_direction_is_refused(corpus_file, wi, words):
    brdf, up = MeasuredBRDF(read_bsdf(corpus_file("syn_iridescent_green", True))), np.array([0.0, 0.0, 1.0])
    u = np.array([0.3, 0.6])
    for call in (
        lambda: brdf.eval(wi, up),
        lambda: brdf.pdf(wi, up),
        lambda: brdf.sample(wi, u),
        lambda: brdf.albedo(wi),
    ):
        with pytest.raises(ShapeError, match=words):
            call()


def test_memory_of_the_directions_is_no_room_for_values():
    file = sample_file("m", wavelengths_nm=np.array([450.0, 550.0, 650.0]))
    brdf, wi = MeasuredBRDF(file), np.tile([0.0, 0.6, 0.8], (5, 1))
    other = wi[::-1].copy()
    for out in (wi, other):
        with pytest.raises(ShapeError, match="out overlaps the directions"):
            brdf.eval(wi, other, out=out)
    np.testing.assert_array_equal(wi, np.tile([0.0, 0.6, 0.8], (5, 1)))


@pytest.mark.parametrize("cosine", [0.0, 1e-12, 1e-9])
def test_at_the_horizon_nothing_is_sampled_and_the_albedo_is_0(cosine):
    brdf = MeasuredBRDF(sample_file("m", 1, size=8))
    wi, up = np.array([np.sqrt(1.0 - cosine**2), 0.0, cosine]), np.array([0.0, 0.0, 1.0])
    assert not np.any(brdf.eval(wi, up))
    assert brdf.pdf(wi, up) == 0.0
    assert brdf.sample(wi, np.array([0.3, 0.6]))[1] == 0.0
    assert not np.any(brdf.albedo(wi))
    above = np.array([np.sqrt(1.0 - 1e-16), 0.0, 1e-8])
    assert brdf.sample(above, np.array([0.3, 0.6]))[1] > 0.0
    assert np.any(brdf.albedo(above))


def test_measured_and_analytic_brdfs_share_the_protocol(corpus_file):
    measured_brdf = MeasuredBRDF(read_bsdf(corpus_file("syn_iridescent_green", True)))
    assert isinstance(measured_brdf, BRDF)
    assert isinstance(BY_NAME["syn_gloss_red"].truth(), BRDF)


def test_no_directions_give_no_values_and_directions_below_the_horizon_no_albedo():
    brdf = MeasuredBRDF(sample_file("m", 1, size=8))
    none = np.zeros((0, 3))
    assert brdf.eval(none, none).shape == (0, brdf.bands.count)
    assert brdf.albedo(none).shape == (0, brdf.bands.count)
    assert not np.any(brdf.albedo(np.array([0.0, 0.0, -1.0])))


@pytest.mark.parametrize("bands", range(1, 7))
@pytest.mark.parametrize("count", [1, 2, 31, 32, 33, 70])
def test_values_are_written_within_the_memory_that_is_given(bands, count, rng):
    nm = np.arange(500.0, 500.0 + bands)
    brdf = MeasuredBRDF(sample_file("few_bands", wavelengths_nm=nm))
    wi, wo = (from_spherical(rng.uniform(0.0, 1.4, count), rng.uniform(-3.0, 3.0, count)) for _ in range(2))
    memory = np.full((count + 4, bands), -7.0)
    brdf.eval(wi, wo, out=memory[:count])
    np.testing.assert_array_equal(memory[count:], -7.0)
    np.testing.assert_allclose(memory[:count], brdf.eval(wi, wo))
