"""Fits of BSDFs: known truths, what cannot be told apart, other plugins, spectra."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import real_rgl_files
from small_library import measured

from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.synthetic.ggx import GGX
from manifold.brdf.synthetic.microfacet import RoughConductor
from manifold.colour.conversion import to_srgb
from manifold.directions import from_spherical
from manifold.errors import ManifoldError, NumericalError, ShapeError, UsageError
from manifold.fitting import fit_samples
from manifold.fitting.adam_and_swarm import AdamOptions, SwarmOptions
from manifold.fitting.bsdf_evaluation import LaneEvaluator, ScalarEvaluator, evaluator
from manifold.fitting.bsdf_parameters import BsdfFamily, FreeParameter, Layout, principled
from manifold.fitting.fit_metrics import METRICS, Metric, best_diffuse, relative_residual
from manifold.fitting.fit_samples import FitSamples
from manifold.fitting.gauss_newton import GaussNewton, Minimum, search, select_minima
from manifold.fitting.identifiability import AMBIGUOUS, DETERMINED, UNSEEN
from manifold.fitting.principled import fit_bsdf
from manifold.io_rgl import read_bsdf
from manifold.metrics import RusinkiewiczGrid
from manifold.records import Bands
from manifold.rendering import backend

OLD_SENSORS_DEG = (
    (60, 0), (30, 0), (0, 0), (30, 180), (65, 180), (45, 60), (45, 120), (30, 90), (60, 60), (60, 120),
)  # fmt: skip


def grid_pairs(step: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """Direction pairs all over the hemisphere, dense around the mirror direction."""
    wi, wo, above = RusinkiewiczGrid().directions()
    keep = np.flatnonzero(above & (np.minimum(wi[:, 2], wo[:, 2]) > 0.05))[::step]
    return wi[keep], wo[keep]


def old_instrument() -> tuple[np.ndarray, np.ndarray]:
    """Incidence 15 and 45 degrees, ten sensors."""
    pairs = [
        (from_spherical(np.deg2rad(incidence), np.pi), from_spherical(np.deg2rad(theta), np.deg2rad(phi)))
        for incidence in (15, 45)
        for theta, phi in OLD_SENSORS_DEG
    ]
    return np.array([wi for wi, _ in pairs]), np.array([wo for _, wo in pairs])


def samples_of(
    family: BsdfFamily, values: dict, pairs, rng=None, relative: float = 0.0, floor: float = 0.0,
    bands: Bands | None = None,
) -> FitSamples:  # fmt: skip
    """Samples of a BSDF with known parameters, with Gaussian noise per value."""
    bands = Bands(None) if bands is None else bands
    whole = evaluator(family, *pairs, bands.count)
    f = whole.values(whole.layout.join(values))[0] / pairs[1][:, 2:]
    if rng is not None:
        f = np.maximum(f + (relative * f + floor) * rng.standard_normal(f.shape), 0.0)
    return FitSamples.from_arrays(*pairs, f, bands=bands)


def test_a_lane_evaluates_what_mitsuba_does(rng):
    # The lane textures and the wavefront of many parameters must change nothing in Mitsuba's own values.
    mi, dr = backend.mitsuba(colour="rgb"), backend.drjit()
    wi, wo = grid_pairs(40)
    family = principled()
    layout = Layout(family, 3)
    points = rng.uniform(np.maximum(layout.minimum, 0.05), np.minimum(layout.maximum, 0.95), (3, layout.size))
    values = evaluator(family, wi, wo, 3).values(points)
    for p, found in zip(points, values, strict=True):
        content = {k: v for k, v in layout.split(p).items() if k != "base_color"}
        bsdf = mi.load_dict(
            {"type": "principled", "base_color": {"type": "rgb", "value": p[:3].tolist()}} | content
        )
        if not mi.variant().startswith("llvm"):
            si = mi.SurfaceInteraction3f()
            expected = []
            for a, b in zip(wi, wo, strict=True):
                si.wi = mi.Vector3f(*a)
                expected.append(np.array(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(*b))))
            expected = np.array(expected)
        else:
            si = dr.zeros(mi.SurfaceInteraction3f, len(wi))
            si.wi = mi.Vector3f(wi.T.astype(np.float32))
            out = bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(wo.T.astype(np.float32)))
            expected = np.array(out).T
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-7)  # single precision


@pytest.mark.parametrize("n_bands", [3, 5])
def test_forward_derivatives_agree_with_differences(n_bands, rng):
    wi, wo = grid_pairs(60)
    whole = evaluator(principled(), wi, wo, n_bands)
    layout = whole.layout
    p = rng.uniform(np.maximum(layout.minimum, 0.2), np.minimum(layout.maximum, 0.8))
    _, J = whole.jacobian(p)
    h = 1e-3
    for k in range(layout.size):
        step = np.eye(layout.size)[k] * h
        difference = (whole.values(p + step)[0] - whole.values(p - step)[0]) / (2 * h)
        # Single precision over h = 1e-3, and curvature of narrow lobes.
        np.testing.assert_allclose(J[..., k], difference, atol=5e-3 * np.abs(difference).max() + 1e-4)


def test_scalar_and_llvm_variants_agree(rng):
    mi = backend.mitsuba(colour="rgb")
    if not mi.variant().startswith("llvm"):
        pytest.skip("no usable libLLVM here")
    wi, wo = grid_pairs(120)
    layout = Layout(principled(), 5)
    p = rng.uniform(np.maximum(layout.minimum, 0.2), np.minimum(layout.maximum, 0.8))
    lanes = LaneEvaluator(mi, principled(), wi, wo, 5)
    value, J = lanes.jacobian(p)
    by_band = lanes.band_jacobian(p)[1]
    try:
        scalar = ScalarEvaluator(
            backend.mitsuba(colour="rgb", backend=backend.Backend("scalar")), principled(), wi, wo, 5
        )
        other_value, other_J = scalar.jacobian(p)
        other_by_band = scalar.band_jacobian(p)[1]
    finally:
        backend.mitsuba(colour="rgb")
    np.testing.assert_allclose(value, other_value, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(J, other_J, atol=1e-2 * np.abs(J).max())  # differences there
    np.testing.assert_allclose(by_band, other_by_band, atol=1e-2 * np.abs(by_band).max())


def test_random_truths_are_recovered_where_the_fit_says_so(rng):
    family = principled()
    layout = Layout(family, 3)
    pairs = grid_pairs(5)
    whole = evaluator(family, *pairs, 3)
    low, high = np.maximum(layout.minimum, 0.02), np.minimum(layout.maximum, 0.98)
    recovered = as_low = claimed = 0
    n = 10
    for _ in range(n):
        p = rng.uniform(low, high)
        samples = samples_of(family, layout.split(p), pairs, rng, relative=0.005)
        result = fit_bsdf(samples, family, noise=0.005)
        sure = np.array([s.state == DETERMINED for s in result.statements])
        error = np.abs(layout.join(result.values) - p)
        claimed += int(sure.sum())
        recovered += bool(np.all(error[sure] <= layout.tolerance[sure]))
        truth = relative_residual(samples, Metric.of("cube-root", samples), whole.values(p)[0])
        as_low += result.residuals["cube-root"] <= truth * 1.0001
    assert recovered >= 0.9 * n
    assert as_low >= 0.9 * n
    assert claimed >= 0.7 * n * layout.size  # a fit that claims nothing would be always right


def test_dense_directions_tell_rough_black_from_smooth_grey(rng):
    family = principled()
    for values in (
        {"base_color": [0.01] * 3, "roughness": 0.95},
        {"base_color": [0.02] * 3, "roughness": 0.1},
    ):
        truth = {"metallic": 0, "specular": 0.5, "clearcoat": 0, "sheen": 0} | values
        result = fit_bsdf(samples_of(family, truth, grid_pairs(), rng, 0.05, 0.003), noise=0.05)
        rivals = [m.values["roughness"] for m in result.minima if m.as_good]
        assert np.ptp(rivals) < 0.1
        assert result.values["roughness"] == pytest.approx(values["roughness"], abs=0.03)


@pytest.mark.parametrize(
    ("colour", "roughness"), [(0.02, 0.1), pytest.param(0.01, 0.95, marks=pytest.mark.slow)]
)
def test_twenty_geometries_cannot_tell_rough_black_from_smooth_grey_and_both_are_listed(colour, roughness):
    rng = np.random.default_rng(3)
    truth = {"base_color": [colour] * 3, "roughness": roughness}
    truth |= {"metallic": 0, "specular": 0.5, "clearcoat": 0, "sheen": 0}
    result = fit_bsdf(samples_of(principled(), truth, old_instrument(), rng, 0.05, 0.003), noise=0.05)
    good = [m.values["roughness"] for m in result.minima if m.as_good]
    assert max(good) > 0.5
    assert min(good) < 0.3
    assert next(s.state for s in result.statements if s.name == "roughness") in (AMBIGUOUS, UNSEEN)
    assert any("ambiguous" in note for note in result.notes)


def test_dips_along_the_valley_of_a_sharp_clear_coat_are_found():
    """Few samples see a lobe this sharp: without the walk fits may end in a dip above the truth's cost."""
    file = measured("syn_felt_green")
    wi, wo = fit_samples.file_pairs(file)
    pairs = FitSamples.from_arrays(wi, wo, np.ones((len(wi), 3))).subsample(2048)
    family = principled()
    truth = {"base_color": [0.49, 0.48, 0.95], "metallic": 0.74, "roughness": 0.46, "specular": 0.56}
    truth |= {"clearcoat": 0.33, "clearcoat_gloss": 0.963, "sheen": 0.39}
    f_cos = evaluator(family, pairs.wi, pairs.wo, 3).values(Layout(family, 3).join(truth))[0]
    walked, unwalked = [], []
    for seed in range(2):
        noise = 1 + 0.005 * np.random.default_rng(seed).standard_normal(f_cos.shape)
        samples = FitSamples.from_arrays(pairs.wi, pairs.wo, f_cos / pairs.wo[:, 2:] * noise)
        least = relative_residual(samples, Metric.of("cube-root", samples), f_cos)
        walked.append(fit_bsdf(samples, family).residuals["cube-root"] / least)
        unwalked.append(
            fit_bsdf(samples, family, options=GaussNewton(n_walks=0)).residuals["cube-root"] / least
        )
    gain = np.array(unwalked) - walked
    assert max(walked) < 1.002  # values that noise hides keep their defaults, a little above the least
    assert gain.min() >= -1e-9
    assert gain.max() > 2e-4


def test_a_rival_is_listed_only_where_no_minimum_as_good_lies_in_its_part():
    part = np.array([0.0]), np.array([0.25])
    best = Minimum(np.array([0.9]), 1.0, True)
    rival, bad_rival = Minimum(np.array([0.25]), 1.5, True, part), Minimum(np.array([0.25]), 9.0, True, part)
    inside = Minimum(np.array([0.1]), 1.2, True)

    def is_as_good(cost, least):
        return cost < 2.0 * least

    assert select_minima([best, rival], is_as_good) == [best, rival]
    assert select_minima([best, bad_rival], is_as_good) == [best]
    assert select_minima([best, inside, rival], is_as_good) == [best, inside]


def test_a_lambertian_surface_becomes_diffuse_unless_principled_is_asked_for(rng):
    wi, wo = grid_pairs()
    samples = FitSamples.from_arrays(wi, wo, np.full((len(wi), 3), 0.9 / np.pi))
    result = fit_bsdf(samples)
    assert result.family.type == "diffuse"
    assert result.values["reflectance"] == pytest.approx([0.9] * 3, abs=1e-5)
    assert result.residuals["cube-root"] <= result.diffuse_residual + 1e-6
    assert "principled fits worse" in result.notes[0]
    asked = fit_bsdf(samples, principled())
    assert asked.family.type == "principled"
    assert any("no better than a diffuse surface" in note for note in asked.notes)


def test_anisotropic_materials_are_fitted_with_anisotropic_free():
    metal = RoughConductor(GGX.anisotropic(0.4, 0.1), np.array(1.5), np.array(3.0), Bands(None))
    found = fit_bsdf(metal)
    assert (
        "anisotropic"
        not in fit_bsdf(samples_of(principled(["roughness"]), {"roughness": 0.5}, grid_pairs())).values
    )
    # alpha = roughness^2 / aspect and roughness^2 aspect, aspect = sqrt(1 - 0.9 anisotropic)
    assert found.values["anisotropic"] == pytest.approx(0.833, abs=0.02)
    assert found.values["roughness"] == pytest.approx(0.2**0.5, abs=0.02)
    assert not any("azimuths" in note for note in found.notes)
    fixed = fit_bsdf(metal, principled())
    assert "let `anisotropic` be free" in fixed.notes[-1]
    assert fixed.residuals["cube-root"] > 5.0 * found.residuals["cube-root"]
    turned = fit_bsdf(RoughConductor(GGX.anisotropic(0.1, 0.4), np.array(1.5), np.array(3.0), Bands(None)))
    assert "turn it by a quarter" in turned.notes[-1]


def test_what_the_samples_do_not_show_is_said():
    # Without a clear coat its gloss changes nothing.
    truth = {"base_color": [0.4, 0.3, 0.2], "roughness": 0.5, "metallic": 0, "clearcoat": 0, "sheen": 0}
    family = BsdfFamily(
        "principled",
        tuple(principled().named(name) for name in ("base_color", "roughness", "clearcoat_gloss")),
        {"clearcoat": 0.0},
    )
    known = {name: truth[name] for name in ("base_color", "roughness")}
    result = fit_bsdf(samples_of(family, known, grid_pairs()), family)
    states = {s.name: s.state for s in result.statements}
    assert states["clearcoat_gloss"] == UNSEEN
    assert states["roughness"] == DETERMINED
    assert any("clearcoat_gloss" in note for note in result.notes)


def test_colours_outside_rec_709_are_found_and_reported():
    bands = Bands(tuple(np.linspace(400.0, 700.0, 31)))
    green = 0.02 + 0.9 * np.exp(-(((np.linspace(400, 700, 31) - 530) / 20) ** 2))
    truth = {"base_color": green, "roughness": 0.6, "metallic": 0.0, "clearcoat": 0.0, "sheen": 0.0}
    wide = principled(wide_colours=True)
    samples = samples_of(wide, truth | {"specular": 0.5}, grid_pairs(), bands=bands)
    result = fit_bsdf(samples, wide_colours=True)
    expected = to_srgb(green, bands)
    assert expected.min() < -0.05
    assert result.values["base_color"] == pytest.approx(expected.tolist(), abs=0.01)
    assert any("Rec. 709" in note for note in result.notes)


def test_base_colours_stay_in_the_range_of_engines_unless_wide_ones_are_asked_for():
    bands = Bands(tuple(np.linspace(400.0, 700.0, 31)))
    green = 0.02 + 0.9 * np.exp(-(((np.linspace(400, 700, 31) - 530) / 20) ** 2))
    samples = samples_of(principled(["base_color"]), {"base_color": green}, grid_pairs(40), bands=bands)
    narrow = fit_bsdf(samples, principled(["base_color"]))
    assert 0.0 <= min(narrow.values["base_color"]) < 1e-9
    assert max(narrow.values["base_color"]) <= 1.0
    assert any("end of the range: base_color[0]" in note for note in narrow.notes)
    assert min(fit_bsdf(samples, principled(["base_color"], wide_colours=True)).values["base_color"]) < -0.05


def test_what_the_samples_do_not_determine_keeps_the_defaults(rng):
    # A rough dark metal: its sheen, its index and the gloss of a clear coat that it does not have move nothing.
    truth = {"base_color": [0.9, 0.6, 0.3], "metallic": 1.0, "roughness": 0.3, "clearcoat": 0.0, "sheen": 0.7}
    result = fit_bsdf(samples_of(principled(), truth, grid_pairs(), rng, relative=0.02))
    kept = {s.name for s in result.statements if s.is_kept}
    assert {"specular", "sheen", "clearcoat_gloss"} <= kept
    defaults = {o.name: o.undetermined for o in principled().parameters}
    assert all(result.values[name] == defaults[name] for name in kept)
    assert result.values["roughness"] == pytest.approx(0.3, abs=0.01)
    assert result.values["metallic"] == pytest.approx(1.0, abs=0.02)
    assert any("left at the defaults" in note and "sheen" in note for note in result.notes)
    assert not any(s.at_bound for s in result.statements if s.is_kept)


def test_a_custom_python_bsdf_is_fitted():
    mi, dr = backend.mitsuba(colour="rgb"), backend.drjit()
    if not mi.variant().startswith("llvm"):
        pytest.skip("Python BSDFs of this test are vectorised")

    class PowerLobe(mi.BSDF):
        """albedo / pi plus a power of the cosine to the normal of the half vector."""

        def __init__(self, props):
            mi.BSDF.__init__(self, props)
            self.albedo = props["albedo"]
            self.exponent = mi.Float(props.get("exponent", 10.0))
            self.m_components = [mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide]
            self.m_flags = self.m_components[0]

        def traverse(self, callback):
            callback.put("albedo", self.albedo, mi.ParamFlags.Differentiable)
            callback.put("exponent", self.exponent, mi.ParamFlags.Differentiable)

        def parameters_changed(self, keys):
            pass

        def eval(self, ctx, si, wo, active):
            h = dr.normalize(si.wi + wo)
            lobe = 0.05 * (self.exponent + 2) * dr.power(dr.maximum(h.z, 1e-6), self.exponent)
            return (self.albedo.eval(si, active) * dr.inv_pi + lobe) * wo.z & (wo.z > 0)

        def to_string(self):
            return "PowerLobe"

    mi.register_bsdf("test_power_lobe", PowerLobe)
    family = BsdfFamily(
        "test_power_lobe",
        (
            FreeParameter("albedo", 0.0, 1.0, 0.5, per_band=True, affine=True),
            FreeParameter("exponent", 1.0, 500.0, 10.0, transform="log", tolerance=0.5),
        ),
    )
    truth = {"albedo": [0.7, 0.4, 0.1], "exponent": 60.0}
    result = fit_bsdf(samples_of(family, truth, grid_pairs()), family)
    assert result.values["albedo"] == pytest.approx(truth["albedo"], abs=1e-3)
    assert result.values["exponent"] == pytest.approx(60.0, rel=1e-3)


def test_a_bsdf_without_finite_values_is_one_clear_error():
    class Nowhere:
        layout = Layout(principled(), 3)

        def values(self, p, rows=None):
            return np.full((len(p), len(rows), 3), np.nan)

    wi, wo = grid_pairs(100)
    samples = FitSamples.from_arrays(wi, wo, np.full((len(wi), 3), 0.1))
    with pytest.raises(NumericalError, match="no finite values"):
        search(Nowhere(), samples, Metric.of("log", samples), GaussNewton(n_search=8))


def test_a_rough_conductor_with_a_spectral_index_is_fitted():
    bands = Bands((400.0, 450.0, 500.0, 550.0, 600.0, 650.0, 700.0))
    eta = np.array([1.47, 1.4, 0.97, 0.42, 0.25, 0.16, 0.13])  # gold, rounded
    k = np.array([1.95, 1.88, 1.87, 2.35, 3.0, 3.5, 4.1])
    family = BsdfFamily(
        "roughconductor",
        (
            FreeParameter("eta", 0.05, 4.0, 1.0, per_band=True),
            FreeParameter("k", 0.0, 8.0, 3.0, per_band=True),
            FreeParameter("alpha", 0.02, 1.0, 0.3, transform="log"),
        ),
        {"distribution": "ggx"},
    )
    samples = samples_of(family, {"eta": eta, "k": k, "alpha": 0.22}, grid_pairs(), bands=bands)
    result = fit_bsdf(samples, family)
    assert result.values["alpha"] == pytest.approx(0.22, abs=0.01)
    assert result.spectral_residual is not None
    assert result.spectral_residual < 0.01
    found_eta, found_k = np.array(result.spectra["eta"]), np.array(result.spectra["k"])

    def normal_reflectance(eta, k):
        return ((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2)

    np.testing.assert_allclose(normal_reflectance(found_eta, found_k), normal_reflectance(eta, k), atol=0.01)


def test_base_colours_per_band_are_recovered():
    bands = Bands(tuple(np.linspace(400.0, 700.0, 16)))
    colour = 0.1 + 0.6 / (1 + np.exp(-(np.linspace(400, 700, 16) - 580) / 25))
    truth = {
        "base_color": colour,
        "roughness": 0.4,
        "metallic": 0.3,
        "specular": 0.5,
        "clearcoat": 0.0,
        "sheen": 0.0,
    }
    result = fit_bsdf(samples_of(principled(), truth, grid_pairs(), bands=bands))
    assert result.spectra["base_color"] == pytest.approx(colour.tolist(), abs=0.01)
    assert result.values["roughness"] == pytest.approx(0.4, abs=0.01)


def test_tints_are_refused_for_spectra():
    bands = Bands((450.0, 550.0, 650.0, 700.0))
    samples = samples_of(principled(), {}, grid_pairs(100), bands=bands)
    with pytest.raises(UsageError, match="spec_tint need RGB"):
        fit_bsdf(samples, principled(["base_color", "roughness", "spec_tint"]))


@pytest.mark.parametrize("method", ["adam", "swarm"])
def test_the_older_methods_come_near_an_easy_truth(method):
    if method == "adam" and not backend.mitsuba(colour="rgb").variant().startswith("llvm"):
        pytest.skip("Adam needs the LLVM backend")
    family = principled(["base_color", "roughness", "metallic"])
    truth = {"base_color": [0.5, 0.3, 0.2], "roughness": 0.5, "metallic": 0.1}
    options = (
        AdamOptions(max_epochs=200, learning_rate=0.05) if method == "adam" else SwarmOptions(iterations=60)
    )
    samples = samples_of(family, truth, grid_pairs(20))
    result = fit_bsdf(samples, family, method=method, options=options)
    assert result.residuals["cube-root"] < 0.5 * result.diffuse_residual
    assert fit_bsdf(samples, family).residuals["cube-root"] < result.residuals["cube-root"]


def test_no_fit_of_a_real_file_is_worse_than_diffuse_or_at_an_unsaid_bound():
    paths = real_rgl_files()[::6]
    if not paths:
        pytest.skip("no real RGL files here")
    for path in paths:
        result = fit_bsdf(fit_samples.from_file(read_bsdf(path), max_pairs=800))
        assert result.residuals["cube-root"] < result.diffuse_residual, path.name
        said = " ".join(note for note in result.notes if note.startswith("at the end"))
        assert all(s.name in said for s in result.statements if s.at_bound), path.name


def test_samples_of_a_file_are_its_own_values():
    file = measured("syn_satin_gold")
    wi, _ = fit_samples.file_pairs(file)
    assert 0 < len(wi) <= file.measured_mask.sum()
    samples = fit_samples.from_file(file)
    np.testing.assert_allclose(
        samples.f, np.maximum(MeasuredBRDF(file).eval(samples.wi, samples.wo), 0), rtol=1e-12
    )


def test_a_file_without_a_usable_cell_is_refused():
    file = measured("syn_satin_gold")
    with pytest.raises(UsageError, match="nothing to fit"):
        fit_samples.file_pairs(replace(file, spectra=np.zeros_like(file.spectra)))


def test_the_best_diffuse_is_exact_for_a_diffuse_material():
    wi, wo = grid_pairs(50)
    samples = FitSamples.from_arrays(wi, wo, np.tile([0.1, 0.2, 0.3], (len(wi), 1)))
    for name in METRICS:
        albedo, cost = best_diffuse(samples, Metric.of(name, samples))
        np.testing.assert_allclose(albedo, np.pi * np.array([0.1, 0.2, 0.3]), rtol=1e-6)
        assert cost < 1e-10


@pytest.mark.parametrize("name", METRICS)
def test_slopes_of_metrics_agree_with_differences(name):
    metric = Metric(name, 1e-3)
    x = np.array([-2e-3, -1e-5, 0.0, 1e-4, 1e-3, 0.1, 10.0])
    h = 1e-7 * np.maximum(np.abs(x), 1e-2)
    difference = (metric(x + h) - metric(x - h)) / (2 * h)
    np.testing.assert_allclose(metric.slope(x), difference, rtol=1e-5)


def _bad(kind: str):
    wi, wo = grid_pairs(200)
    f = np.full((len(wi), 3), 0.1)
    if kind == "nan":
        f[3, 1] = np.nan
    elif kind == "negative":
        f[2, 0] = -0.1
    elif kind == "below":
        wo = wo * np.where(np.arange(len(wo)) == 1, -1, 1)[:, None]
    elif kind == "single":
        wi, wo, f = wi[[0] * 9], wo[[0] * 9], f[:9]
    elif kind == "zero":
        f[:] = 0
    else:
        f = f[:, :2]
    return wi, wo, f


@pytest.mark.parametrize(
    ("kind", "error", "words"),
    [
        ("nan", ShapeError, "not finite"),
        ("negative", UsageError, "negative"),
        ("below", ShapeError, "below the horizon"),
        ("single", UsageError, "different direction pairs"),
        ("zero", UsageError, "all 0"),
        ("bands", ShapeError, "expected .*RGB"),
    ],
)
def test_bad_samples_are_one_clear_error_each(kind, error, words):
    with pytest.raises(error, match=words) as raised:
        FitSamples.from_arrays(*_bad(kind))
    assert "\n" not in str(raised.value)


ETA = FreeParameter("eta", 0.5, 3.0, 1.0, per_band=True)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda s: fit_bsdf(s, method="simplex"), "no method"),
        (lambda s: fit_bsdf(s, metric="cubic"), "no residual"),
        (lambda s: fit_bsdf(s, noise=0.0), "noise 0"),
        (lambda s: fit_bsdf(s, method="swarm", options=GaussNewton()), "SwarmOptions"),
        (lambda s: fit_bsdf(s, principled(["colour"])), "no free parameter 'colour'"),
        (lambda s: fit_bsdf(s, BsdfFamily("no_such", (FreeParameter("a", 0, 1, 0.5),))), "no_such"),
        (lambda s: fit_bsdf(s, BsdfFamily("principled", (FreeParameter("shine", 0, 1, 0.5),))), "shine"),
        (
            lambda s: fit_bsdf(s, BsdfFamily("conductor", (ETA,))),
            "conductor reflects into discrete directions",
        ),
        (lambda s: FreeParameter("a", 1, 0, 0.5), "minimum < maximum"),
        (lambda s: FreeParameter("a", 0, 1, 0.5, transform="cube"), "transform 'cube'"),
        (lambda s: BsdfFamily.from_json({"type": "principled"}), "parameters"),
    ],
)
def test_bad_requests_are_one_clear_error_each(call, words):
    wi, wo = grid_pairs(400)
    samples = FitSamples.from_arrays(wi, wo, np.full((len(wi), 3), 0.1))
    with pytest.raises(ManifoldError, match=words) as raised:
        call(samples)
    assert "\n" not in str(raised.value)


def test_transforms_invert_and_their_slopes_agree_with_differences():
    layout = Layout(principled(), 3)
    p = np.random.default_rng(0).uniform(layout.minimum + 0.1, layout.maximum - 0.1)
    t = layout.inward(p)
    np.testing.assert_allclose(layout.outward(t), p, rtol=1e-12)
    h = 1e-6
    difference = (layout.outward(t + h) - layout.outward(t - h)) / (2 * h)
    np.testing.assert_allclose(layout.slope(t), difference, rtol=1e-6)


def test_a_family_is_the_same_after_json():
    family = principled(["base_color", "roughness"])
    assert BsdfFamily.from_json(family.to_json()) == family
