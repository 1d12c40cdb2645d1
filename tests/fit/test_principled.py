"""Fits of BSDFs: known truths, what cannot be told apart, other plugins, spectra."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.real_materials import real_materials
from helpers.small_library import measured

from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import Plastic, RoughConductor
from manifold.brdf import goniometer
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured_cells import fill_unmeasured
from manifold.colour import panel
from manifold.colour.conversion import to_srgb
from manifold.core.directions import from_spherical
from manifold.core.errors import ManifoldError, UsageError
from manifold.core.pairs import RusinkiewiczGrid
from manifold.core.records import Bands
from manifold.fit import fit_samples
from manifold.fit.adam_and_swarm import AdamOptions, SwarmOptions
from manifold.fit.fit_metrics import METRICS, Criterion, Metric, best_diffuse, missed_highlight
from manifold.fit.fit_samples import FitSamples
from manifold.fit.gauss_newton import GaussNewton, Minimum, select_minima
from manifold.fit.identifiability import AMBIGUOUS, DETERMINED, UNSEEN
from manifold.fit.principled import fit_bsdf
from manifold.render import backend
from manifold.render.bsdf_evaluation import LaneEvaluator, evaluator
from manifold.render.bsdf_parameters import BsdfFamily, FreeParameter, ParameterLayout, principled

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


def lane_evaluator(family: BsdfFamily, wi, wo, n_bands: int) -> LaneEvaluator:
    """Mitsuba's evaluation of a BSDF, that of `fit --bsdf`, of one that NumPy evaluates as well."""
    mi = backend.mitsuba(colour="rgb")
    if not mi.variant().startswith("llvm"):
        pytest.skip("no usable libLLVM here")
    return LaneEvaluator(mi, family, wi, wo, n_bands)


def test_lanes_evaluate_what_mitsuba_does(rng):
    # The lane textures and the wavefront of many parameters must change nothing in Mitsuba's own values.
    wi, wo = grid_pairs(40)
    lanes = lane_evaluator(principled(), wi, wo, 3)
    mi, dr, layout = backend.mitsuba(colour="rgb"), backend.drjit(), lanes.layout
    points = rng.uniform(np.maximum(layout.minimum, 0.05), np.minimum(layout.maximum, 0.95), (3, layout.size))
    for p, found in zip(points, lanes.values(points), strict=True):
        content = {k: v for k, v in layout.split(p).items() if k != "base_color"}
        bsdf = mi.load_dict(
            {"type": "principled", "base_color": {"type": "rgb", "value": p[:3].tolist()}} | content
        )
        si = dr.zeros(mi.SurfaceInteraction3f, len(wi))
        si.wi = mi.Vector3f(wi.T.astype(np.float32))
        out = bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(wo.T.astype(np.float32)))
        np.testing.assert_allclose(found, np.array(out).T, rtol=1e-5, atol=1e-7)  # single precision


@pytest.mark.parametrize("n_bands", [3, 5])
def test_forward_derivatives_agree_with_differences(n_bands, rng):
    wi, wo = grid_pairs(60)
    whole = lane_evaluator(principled(), wi, wo, n_bands)
    layout = whole.layout
    p = rng.uniform(np.maximum(layout.minimum, 0.2), np.minimum(layout.maximum, 0.8))
    _, J = whole.jacobian(p)
    h = 1e-3
    for k in range(layout.size):
        step = np.eye(layout.size)[k] * h
        difference = (whole.values(p + step)[0] - whole.values(p - step)[0]) / (2 * h)
        # Single precision over h = 1e-3, and curvature of narrow lobes.
        np.testing.assert_allclose(J[..., k], difference, atol=5e-3 * np.abs(difference).max() + 1e-4)


def test_random_truths_are_recovered_where_the_fit_says_so(rng):
    family = principled()
    layout = ParameterLayout(family, 3)
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
        truth = Criterion(samples, "cube-root").relative(whole.values(p)[0])
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


def test_a_rival_is_listed_only_where_no_minimum_as_good_lies_in_its_part():
    part = np.array([0.0]), np.array([0.25])
    best = Minimum(np.array([0.9]), 1.0, True)
    rival, bad_rival = Minimum(np.array([0.25]), 1.5, True, part), Minimum(np.array([0.25]), 9.0, True, part)
    inside = Minimum(np.array([0.1]), 1.2, True)
    assert select_minima([best, rival], 1.0) == [best, rival]
    assert select_minima([best, bad_rival], 1.0) == [best]
    assert select_minima([best, inside, rival], 1.0) == [best, inside]


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
    assert any("free the parameter `anisotropic`" in note for note in fixed.notes)
    assert fixed.residuals["cube-root"] > 5.0 * found.residuals["cube-root"]
    turned = fit_bsdf(RoughConductor(GGX.anisotropic(0.1, 0.4), np.array(1.5), np.array(3.0), Bands(None)))
    assert turned.rotation_deg == 90.0
    assert turned.values["anisotropic"] == pytest.approx(0.833, abs=0.02)
    assert turned.errors.ball < 1.0


def test_an_anisotropic_file_is_fitted_where_its_highlights_are_wide_along_x():
    normals = GGX.anisotropic(0.5, 0.2, float(np.deg2rad(50.0)))
    metal = RoughConductor(normals, np.array(1.5), np.array(3.0), Bands(None))
    found = fit_bsdf(goniometer.measure(metal, "brushed", resolution=20, n_theta_i=8, n_phi_i=9))
    assert found.values["anisotropic"] == pytest.approx(0.667, abs=0.1)  # a coarse file
    assert found.rotation_deg == pytest.approx(50.0, abs=0.3)
    assert found.errors.ball < 1.5  # in the sample's own frame: 5 where it is not turned
    assert any(f"wide along {found.rotation_deg:.1f} degrees" in note for note in found.notes)


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
    for file in real_materials()[::6]:
        result = fit_bsdf(file)
        assert result.residuals["appearance"] < result.diffuse_residual, file.name
        said = " ".join(note for note in result.notes if note.startswith("at the end"))
        assert all(s.name in said for s in result.statements if s.at_bound), file.name


def test_a_file_and_its_brdf_have_the_same_fit():
    file = measured("syn_satin_gold")
    by_file, by_brdf = fit_bsdf(file), fit_bsdf(MeasuredBRDF(file))
    # A BRDF is taken as it is, of a file what was not measured is filled.
    assert by_file.errors.ball == pytest.approx(by_brdf.errors.ball, abs=0.1)
    filled = fill_unmeasured(file)
    assert fit_bsdf(MeasuredBRDF(filled)).values == fit_bsdf(filled).values == by_file.values


def test_unmeasured_cells_of_a_file_are_filled():
    file = measured("syn_satin_gold")
    values, hole = file.spectra.copy(), np.zeros_like(file.measured_mask)
    hole[..., 8:20, 8:20] = True
    values[np.broadcast_to(hole[:, :, None], values.shape)] = 0.0
    whole, pierced = fit_bsdf(file), fit_bsdf(replace(file, spectra=values))
    assert pierced.values["roughness"] == pytest.approx(whole.values["roughness"], abs=0.03)
    assert pierced.values["base_color"] == pytest.approx(whole.values["base_color"], abs=0.03)


def test_a_file_that_is_black_is_refused():
    file = measured("syn_satin_gold")
    with pytest.raises(UsageError, match="nothing to fit"):
        fit_bsdf(replace(file, spectra=np.zeros_like(file.spectra)))


class GlossyPaint:
    """A red base below a sharp highlight with a wide foot, which no parameters of principled make."""

    bands, is_isotropic, name = Bands(None), True, "paint"
    base, peaks = np.array([0.4, 0.08, 0.05]) / np.pi, ((0.03, 0.05), (0.25, 0.15))

    def eval(self, wi, wo):
        wi, wo = np.broadcast_arrays(wi, wo)
        h = wi + wo
        h = h / np.linalg.norm(h, axis=-1, keepdims=True)
        tan2 = (1.0 - h[..., 2] ** 2) / np.maximum(h[..., 2], 1e-6) ** 2
        lobes = sum(
            weight * np.exp(-tan2 / alpha**2) / (4.0 * np.pi * alpha**2 * np.maximum(h[..., 2], 0.05) ** 4)
            for alpha, weight in self.peaks
        )
        return (self.base + lobes[..., None]) * ((wi[..., 2:] > 0) & (wo[..., 2:] > 0))

    def eval_cos(self, wi, wo):
        return self.eval(wi, wo) * np.maximum(np.asarray(wo)[..., 2:], 0.0)

    def sample(self, wi, u):
        raise NotImplementedError

    def pdf(self, wi, wo):
        raise NotImplementedError


def test_a_fit_looks_like_its_material_in_a_light_that_it_did_not_see():
    paint = GlossyPaint()
    seen, by_samples = fit_bsdf(paint), fit_bsdf(paint, metric="cube-root")
    assert seen.errors.ball < 0.6 * by_samples.errors.ball
    assert seen.errors.fitted_ball < 0.6 * by_samples.errors.fitted_ball
    assert seen.residuals["appearance"] < by_samples.residuals["appearance"]
    assert by_samples.residuals["cube-root"] < seen.residuals["cube-root"]
    lights = panel.judged()
    fitted = evaluator(seen.family, lights.wi, lights.wo, 3)
    f = fitted.values(fitted.layout.join(seen.values))[0] / lights.wo[:, 2:]
    expected = lights.errors(f, paint.eval(lights.wi, lights.wo), Bands(None))
    assert seen.errors.ball == pytest.approx(expected.ball, rel=1e-6)
    assert (seen.errors.worst_light, seen.errors.worst) == (
        expected.worst_light,
        pytest.approx(expected.worst, rel=1e-6),
    )


def test_a_highlight_that_the_model_lacks_is_said():
    class Rainbow(GlossyPaint):
        def eval(self, wi, wo):
            h = wi + wo
            theta = np.arccos(np.clip(h[..., 2] / np.linalg.norm(h, axis=-1), -1.0, 1.0))
            hue = np.stack([np.cos(9.0 * theta + turn) for turn in (0.0, 2.1, 4.2)], axis=-1)
            return 0.1 + np.exp(-((theta / 0.3) ** 2))[..., None] * (0.3 + 0.3 * hue)

    found = fit_bsdf(Rainbow())
    assert any(note.startswith("its highlight is missed") for note in found.notes)

    class Grey(GlossyPaint):
        base, peaks = np.array([0.4, 0.4, 0.4]) / np.pi, ((0.4, 0.05),)

    assert not any("missed" in note for note in fit_bsdf(Grey()).notes)


@pytest.mark.parametrize(("reflectances", "alphas"), [((0.2, 0.6), (0.2, 0.2)), ((0.2, 0.2), (0.2, 0.22))])
def test_a_highlight_is_not_missed_where_all_differs_or_none_is_seen_to(reflectances, alphas):
    fitted, material = (
        Plastic(GGX.isotropic(alpha), np.array(1.5), np.full(3, reflectance), Bands(None))
        for reflectance, alpha in zip(reflectances, alphas, strict=True)
    )
    assert missed_highlight(fitted, material) is None


def test_samples_alone_have_no_ball_and_are_fitted_in_cube_roots():
    samples = samples_of(principled(), {"roughness": 0.4}, grid_pairs(20))
    by_default, by_roots = fit_bsdf(samples), fit_bsdf(samples, metric="cube-root")
    assert by_default.errors is None
    assert by_default.values == by_roots.values


def test_colours_per_band_are_those_of_the_ball():
    bands = Bands((450.0, 500.0, 550.0, 600.0, 650.0))

    class Paint(GlossyPaint):
        base = np.array([0.02, 0.03, 0.05, 0.2, 0.4]) / np.pi

    Paint.bands = bands
    found = fit_bsdf(Paint())
    by_samples = fit_bsdf(Paint(), metric="cube-root")
    assert found.errors.ball < 0.7 * by_samples.errors.ball


def test_slopes_of_the_criterion_agree_with_differences(rng):
    criterion = Criterion(fit_samples.from_brdf(GlossyPaint()), "appearance")
    f_cos = GlossyPaint().eval_cos(criterion.wi, criterion.wo) * 1.3
    direction = f_cos[..., None] * rng.random((1, 3, 2))
    slope = criterion.slope(f_cos, direction)
    h = 1e-6
    for k in range(2):
        moved = [criterion.residual(f_cos + sign * h * direction[..., k]) for sign in (1, -1)]
        np.testing.assert_allclose(
            slope[..., k], (moved[0] - moved[1]) / (2 * h), atol=1e-5 * np.abs(slope).max()
        )
    assert criterion.relative(GlossyPaint().eval_cos(criterion.wi, criterion.wo)) == 0.0


def test_what_is_brighter_than_white_hardly_counts():
    dim, bright = GlossyPaint(), GlossyPaint()
    dim.base, bright.base = np.full(3, 100.0), np.full(3, 200.0)  # both are white in a picture
    samples = fit_samples.from_brdf(dim)
    of_ball = Criterion(samples, "appearance"), Criterion(replace(samples, pixels=None), "appearance")
    f_cos = bright.eval_cos(of_ball[0].wi, of_ball[0].wo)
    cost, of_samples = (np.sum(criterion.residual(f_cos) ** 2) for criterion in of_ball)
    assert cost - of_samples < 0.2 * of_samples


def test_the_best_diffuse_is_exact_for_a_diffuse_material():
    wi, wo = grid_pairs(50)
    samples = FitSamples.from_arrays(wi, wo, np.tile([0.1, 0.2, 0.3], (len(wi), 1)))
    for name in METRICS:
        albedo, cost = best_diffuse(Criterion(samples, name))
        np.testing.assert_allclose(albedo, np.pi * np.array([0.1, 0.2, 0.3]), rtol=1e-6)
        assert cost < 1e-10


@pytest.mark.parametrize("name", METRICS)
def test_slopes_of_metrics_agree_with_differences(name):
    metric = Metric(name, 1e-3)
    x = np.array([-2e-3, -1e-5, 0.0, 1e-4, 1e-3, 0.1, 10.0])
    h = 1e-7 * np.maximum(np.abs(x), 1e-2)
    difference = (metric(x + h) - metric(x - h)) / (2 * h)
    np.testing.assert_allclose(metric.slope(x), difference, rtol=1e-5)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda wi, wo, f: (wi, wo, np.where(np.arange(3) == 1, np.nan, f)), "not finite"),
        (lambda wi, wo, f: (wi, wo, -f), "negative"),
        (lambda wi, wo, f: (wi, -wo, f), "below the horizon"),
        (lambda wi, wo, f: (wi[[0] * 9], wo[[0] * 9], f[:9]), "different direction pairs"),
        (lambda wi, wo, f: (wi, wo, 0.0 * f), "all 0"),
        (lambda wi, wo, f: (wi, wo, f[:, :2]), "expected .*RGB"),
    ],
)
def test_bad_samples_are_one_clear_error_each(change, words):
    wi, wo = grid_pairs(200)
    with pytest.raises(ManifoldError, match=words) as raised:
        FitSamples.from_arrays(*change(wi, wo, np.full((len(wi), 3), 0.1)))
    assert "\n" not in str(raised.value)


ETA = FreeParameter("eta", 0.5, 3.0, 1.0, per_band=True)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda s: fit_bsdf(s, method="simplex"), "no method"),
        (lambda s: fit_bsdf(s, metric="cubic"), "there is no metric"),
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
    ],
)
def test_bad_requests_are_one_clear_error_each(call, words):
    wi, wo = grid_pairs(400)
    samples = FitSamples.from_arrays(wi, wo, np.full((len(wi), 3), 0.1))
    with pytest.raises(ManifoldError, match=words) as raised:
        call(samples)
    assert "\n" not in str(raised.value)


def test_transforms_invert_and_their_slopes_agree_with_differences():
    layout = ParameterLayout(principled(), 3)
    p = np.random.default_rng(0).uniform(layout.minimum + 0.1, layout.maximum - 0.1)
    t = layout.inward(p)
    np.testing.assert_allclose(layout.outward(t), p, rtol=1e-12)
    h = 1e-6
    difference = (layout.outward(t + h) - layout.outward(t - h)) / (2 * h)
    np.testing.assert_allclose(layout.slope(t), difference, rtol=1e-6)


def test_a_bsdf_family_is_the_same_after_json():
    family = principled(["base_color", "roughness"])
    assert BsdfFamily.from_json(family.to_json()) == family
