"""Analytic BRDFs: distributions, Fresnel, energy, reciprocity, sampling."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.chi_square import chi_square_p_value
from hypothesis import given, settings
from hypothesis import strategies as st

from manifold.analytic.base import Lambert, Sheen
from manifold.analytic.diffuse import RoughDiffuse
from manifold.analytic.fresnel import fresnel_conductor, fresnel_dielectric, fresnel_thin_film
from manifold.analytic.ggx import GGX, GGXMixture
from manifold.analytic.layers import Immersed, Layered, MixedBRDF, Retroreflection
from manifold.analytic.microfacet import Plastic, RoughConductor, RoughDielectric, ThinFilm
from manifold.colour.reflectances import metal_ior
from manifold.core.directions import from_spherical, half_vector, hemisphere_quadrature, normalize
from manifold.core.errors import BandMismatchError, ShapeError, UsageError
from manifold.core.records import Array, Bands

BANDS = Bands((400.0, 550.0, 700.0))
NM = np.array(BANDS.wavelengths_nm)
GOLD = metal_ior("Au", NM)
RED = np.array([0.05, 0.1, 0.7])
SKEW = np.array([[4.0, 5.0], [0.5, 3.0]])

SURFACES = {
    "smooth": GGX.isotropic(0.1),
    "rough": GGX.isotropic(0.6),
    "anisotropic": GGX.anisotropic(0.1, 0.4, 0.5),
    "skewed": GGX.skewed(SKEW),
}


def models() -> dict[str, object]:
    """One of each, over all kinds of surfaces."""
    made: dict[str, object] = {}
    for name, ggx in SURFACES.items():
        made[f"conductor, {name}"] = RoughConductor(ggx, *GOLD, BANDS)
    skewed, rough = SURFACES["skewed"], SURFACES["rough"]
    lambert = Lambert(RED, BANDS)
    sheen = Sheen(0.3, 0.8, BANDS)
    made["single scattering"] = RoughConductor(rough, *GOLD, BANDS, multiple_scattering=False)
    made["dielectric"] = RoughDielectric(skewed, np.array([1.53, 1.51, 1.5]), BANDS)
    made["film"] = ThinFilm(rough, 1.4, 350.0, *GOLD, BANDS)
    made["plastic"] = Plastic(skewed, 1.5, RED, BANDS)
    made["white plastic"] = Plastic(rough, np.array([1.53, 1.51, 1.5]), 1.0, BANDS)
    made["lambert"] = lambert
    made["sheen"] = sheen
    made["mixed"] = MixedBRDF([(0.5, RoughConductor(skewed, *GOLD, BANDS)), (0.3, sheen), (0.2, lambert)])
    made["coat"] = Layered(RoughDielectric(rough, 1.5, BANDS), RoughConductor(skewed, *GOLD, BANDS))
    made["cloth"] = Layered(sheen, lambert)
    made["rough diffuse"] = RoughDiffuse(RED, 0.7, BANDS)
    made["white rough diffuse"] = RoughDiffuse(1.0, 1.0, BANDS)
    several = RoughConductor(GGXMixture([(0.7, 0.15), (0.3, 0.5)]), *GOLD, BANDS)
    made["conductor, several roughnesses"] = several
    made["retroreflection"] = Retroreflection(several)
    made["immersed"] = Immersed(several, 1.5, np.array([0.9, 0.7, 1.0]))
    made["lacquer"] = Layered(RoughDielectric(rough, 1.5, BANDS), Immersed(several, 1.5))
    return made


MODELS = models()
every_model = pytest.mark.parametrize("name", MODELS)

WI = [from_spherical(np.radians(t), p) for t, p in ((0.0, 0.0), (35.0, 0.4), (65.0, 2.0), (85.0, 4.0))]


def even_numbers(n: int) -> Array:
    """n pairs spread evenly over the unit square and over each axis (Roberts 2018, the R2 sequence)."""
    return (0.5 + np.arange(n)[:, None] * (0.7548776662466927, 0.5698402909980532)) % 1.0


def sampled_albedo(brdf: object, wi: Array, n: int = 30_000) -> Array:
    """Albedo by the model's own sampling with n even numbers, independent of its tables."""
    wo, pdf = brdf.sample(wi, even_numbers(n))  # type: ignore[attr-defined]
    f_cos = brdf.eval_cos(wi, wo[pdf > 0])  # type: ignore[attr-defined]
    return (1.0 / pdf[pdf > 0]) @ f_cos / n


def random_directions(rng: np.random.Generator, n: int) -> Array:
    w = rng.normal(size=(n, 3))
    w[:, 2] = np.abs(w[:, 2])
    return normalize(w)


# ---------------------------------------------------------------- the microsurface


@pytest.mark.parametrize(("alpha_x", "alpha_y"), [(0.37, 0.37), (0.2, 0.7)])
def test_ggx_is_the_textbook_closed_form(rng, alpha_x, alpha_y):
    w = random_directions(rng, 1000)
    x, y, z = w.T
    stretched = (x / alpha_x) ** 2 + (y / alpha_y) ** 2 + z**2
    textbook = 1.0 / (np.pi * alpha_x * alpha_y * stretched**2)  # Burley 2012
    np.testing.assert_allclose(GGX.anisotropic(alpha_x, alpha_y).D(w), textbook, rtol=1e-12)


def test_masking_is_smiths_closed_form(rng):
    alpha_x, alpha_y, turn = 0.2, 0.7, 0.6
    w = random_directions(rng, 1000)
    x = np.cos(turn) * w[:, 0] + np.sin(turn) * w[:, 1]
    y = -np.sin(turn) * w[:, 0] + np.cos(turn) * w[:, 1]
    slope2 = (x**2 * alpha_x**2 + y**2 * alpha_y**2) / w[:, 2] ** 2
    lam = 0.5 * (np.sqrt(1 + slope2) - 1)  # Heitz 2014, eq. 72 and 86
    ggx = GGX.anisotropic(alpha_x, alpha_y, turn)
    wo, lam_o = np.roll(w, 1, axis=0), np.roll(lam, 1)
    D = ggx.D(half_vector(w, wo))
    np.testing.assert_allclose(4 * w[:, 2] * ggx.pdf_reflection(w, wo) / D, 1 / (1 + lam), rtol=1e-10)
    G2 = 4 * w[:, 2] * wo[:, 2] * ggx.reflection_factor(w, wo) / D
    np.testing.assert_allclose(G2, 1 / (1 + lam + lam_o), rtol=1e-10)


def test_skewed_surface_is_the_anisotropic_one_along_its_principal_axes(rng):
    stretches, axes = np.linalg.eigh(SKEW @ SKEW.T)
    turn = np.arctan2(axes[1, 0], axes[0, 0])
    ggx, same = GGX.skewed(SKEW), GGX.anisotropic(*(1 / np.sqrt(stretches)), turn)
    w = random_directions(rng, 100)
    np.testing.assert_allclose(ggx.D(w), same.D(w), rtol=1e-10)
    np.testing.assert_allclose(ggx.pdf_reflection(w, w[::-1]), same.pdf_reflection(w, w[::-1]), rtol=1e-10)
    assert ggx.alphas == pytest.approx(tuple(sorted(1 / np.sqrt(stretches))))


@pytest.mark.parametrize("name", SURFACES)
def test_distribution_projects_to_unit_area(name):
    nodes, weights = hemisphere_quadrature(400, 200)
    total = (weights * nodes[:, 2]) @ SURFACES[name].D(nodes)
    assert total == pytest.approx(1.0, abs=1e-6)  # the quadrature's error at roughness 0.1


@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("wi", WI[1:])
def test_visible_normals_are_normalised(name, wi):
    # Smith's masking is the one function for which this holds: D and G1 belong together.
    nodes, weights = hemisphere_quadrature(400, 200)
    facing = nodes @ wi
    seen, weights, facing = nodes[facing > 0], weights[facing > 0], facing[facing > 0]
    wo = 2.0 * facing[:, None] * seen - wi
    density = 4.0 * facing * SURFACES[name].pdf_reflection(np.broadcast_to(wi, wo.shape), wo)
    assert weights @ density == pytest.approx(1.0, abs=2e-3)  # kink at <wi, h> = 0


def test_transform_that_moves_heights_is_refused():
    tilted = np.eye(3)
    tilted[2, 0] = 0.3
    with pytest.raises(UsageError, match="third row"):
        GGX(tilted)
    with pytest.raises(UsageError, match="singular"):
        GGX.skewed(np.array([[1.0, 2.0], [2.0, 4.0]]))
    with pytest.raises(ShapeError, match="3, 3"):
        GGX(np.eye(4))
    with pytest.raises(UsageError, match="alpha_x"):
        GGX.isotropic(0.0)


# ---------------------------------------------------------------- Fresnel


def complex_fresnel(cos_theta: float, index: complex) -> float:
    """The slow reference: Snell and Fresnel in complex numbers."""
    sin_t = np.sqrt(1 - cos_theta**2) / index
    cos_t = np.sqrt(1 - sin_t**2 + 0j)
    if (index * cos_t).imag < 0:
        cos_t = -cos_t
    s = (cos_theta - index * cos_t) / (cos_theta + index * cos_t)
    p = (index * cos_theta - cos_t) / (index * cos_theta + cos_t)
    return float(0.5 * (abs(s) ** 2 + abs(p) ** 2))


def test_conductor_fresnel_is_the_complex_formula(rng):
    cosines = np.concatenate([rng.random(50), [1.0, 1e-4]])
    eta, k = rng.uniform(0.05, 5, 20), rng.uniform(0, 8, 20)
    eta[:3], k[:3] = (1.5, 1.0, 1 / 1.5), 0.0  # dielectrics from outside, of index 1, and from inside
    expected = [[complex_fresnel(c, complex(e, x)) for e, x in zip(eta, k, strict=True)] for c in cosines]
    # the complex reference itself loses digits to |n| cos near grazing
    np.testing.assert_allclose(fresnel_conductor(cosines, eta, k), expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(
        fresnel_dielectric(cosines, eta[:3]), fresnel_conductor(cosines, eta[:3], k[:3])
    )


def test_film_of_no_thickness_or_of_the_bases_index_is_the_bare_base(rng):
    c = rng.random(30)
    bare = fresnel_conductor(c, *GOLD)
    np.testing.assert_allclose(fresnel_thin_film(c, NM, np.full(3, 1.4), 0.0, *GOLD), bare, rtol=1e-10)
    same = fresnel_thin_film(c, NM, np.full(3, 1.5), 300.0, np.full(3, 1.5), np.zeros(3))
    np.testing.assert_allclose(same, fresnel_dielectric(c, np.full(3, 1.5)), rtol=1e-10, atol=1e-14)
    air = fresnel_thin_film(c, NM, np.ones(3), 300.0, *GOLD)
    np.testing.assert_allclose(air, bare, rtol=1e-10)


def test_quarter_wave_film_of_the_root_index_is_an_antireflection_coating():
    film = np.sqrt(1.5)
    f = fresnel_thin_film(
        np.array([1.0]), np.array([550.0]), np.array([film]), 550 / (4 * film), np.array([1.5]), np.zeros(1)
    )
    assert f[0, 0] == pytest.approx(0.0, abs=1e-15)


# ---------------------------------------------------------------- every model


unit = st.floats(0.0, 1.0)
directions = st.builds(lambda z, p: from_spherical(np.arccos(z), 2 * np.pi * p), st.floats(1e-4, 1.0), unit)


@every_model
@given(wi=directions, wo=directions)
@settings(max_examples=25, deadline=None)
def test_reciprocity(name, wi, wo):
    there, back = MODELS[name].eval(wi, wo), MODELS[name].eval(wo, wi)
    assert np.all(np.isfinite(there) & (there >= 0))
    np.testing.assert_allclose(there, back, rtol=1e-10)


@every_model
def test_no_model_reflects_more_than_arrives(name):
    for degrees, phi in ((0.0, 0.0), (40.0, 1.0), (70.0, 2.5), (85.0, 0.0), (85.0, 2.5), (89.0, 1.0)):
        energy = sampled_albedo(MODELS[name], from_spherical(np.radians(degrees), phi), n=10_000)
        assert np.all(energy <= 1.0 + 5e-3), (degrees, phi)  # 10,000 samples


@every_model
def test_albedo_is_the_integral_of_f_cos(name):
    wi = np.stack([*WI, from_spherical(np.radians(85.0), 1.0)])
    expected = np.stack([sampled_albedo(MODELS[name], w) for w in wi])
    np.testing.assert_allclose(MODELS[name].albedo(wi), expected, atol=2e-3)


@every_model
def test_density_integrates_to_at_most_one_and_misses_the_invalid_samples(name):
    wi = WI[2]
    nodes, weights = hemisphere_quadrature(200, 256)
    total = weights @ MODELS[name].pdf(wi, nodes)
    invalid = np.mean(MODELS[name].sample(wi, even_numbers(30_000))[1] == 0)
    assert total <= 1.0 + 1e-3  # quadrature of the narrowest lobe
    assert total + invalid == pytest.approx(1.0, abs=3e-3)


CHI_SQUARE = [
    "conductor, smooth",
    "conductor, anisotropic",
    "conductor, skewed",
    "plastic",
    "sheen",
    "mixed",
    "coat",
    "conductor, several roughnesses",
    "lacquer",
]


@pytest.mark.parametrize("name", CHI_SQUARE)
def test_samples_follow_the_density(name, rng):
    p_values = [chi_square_p_value(MODELS[name], wi, rng, n_samples=100_000) for wi in WI[1:3]]
    # 18 tests in all: a right sampler fails here once in ten thousand seeds, and the seed is fixed
    assert min(p_values) > 1e-4 / len(CHI_SQUARE) / 2, p_values


def test_chi_square_notices_a_density_that_is_slightly_off(rng):
    class Off:
        def __init__(self, sampled: object, claimed: object) -> None:
            self.sample, self.pdf = sampled.sample, claimed.pdf  # type: ignore[attr-defined]

    sampled = RoughConductor(GGX.isotropic(0.30), *GOLD, BANDS)
    claimed = RoughConductor(GGX.isotropic(0.33), *GOLD, BANDS)
    assert chi_square_p_value(Off(sampled, claimed), WI[1], rng) < 1e-6


@every_model
def test_shapes_broadcast_and_the_horizon_is_black(name):
    brdf = MODELS[name]
    wi, wo = np.stack(WI)[:, None], np.stack([WI[1], WI[2], -WI[1], np.array([1.0, 0.0, 0.0])])
    f = brdf.eval(wi, wo)
    assert f.shape == (4, 4, 3)
    assert np.all(f[:, :2] > 0)
    assert np.all(f[:, 2:] == 0)
    assert np.all(brdf.eval(-wi, wo) == 0)
    np.testing.assert_allclose(brdf.eval_cos(wi, wo), f * np.maximum(wo[:, 2:], 0), rtol=1e-14)
    pdf = brdf.pdf(wi, wo)
    assert pdf.shape == (4, 4)
    assert np.all(pdf[:, 2:] == 0)
    one = brdf.eval(WI[1], WI[2])
    np.testing.assert_allclose(one, f[1, 1], rtol=1e-12)
    below, density = brdf.sample(-WI[1], np.full((5, 2), 0.3))
    assert below.shape == (5, 3)
    assert np.all(density == 0)
    assert np.all(brdf.albedo(-WI[1]) == 0)


@every_model
def test_isotropy_is_what_it_says(name):
    brdf = MODELS[name]
    turned = [from_spherical(np.radians(t), p + 0.7) for t, p in ((35.0, 0.4), (65.0, 2.0))]
    same = np.allclose(brdf.eval(WI[1], WI[2]), brdf.eval(*turned), rtol=1e-9)
    assert same == brdf.is_isotropic


def test_bad_directions_and_numbers_are_refused():
    brdf = MODELS["plastic"]
    with pytest.raises(ShapeError, match="length"):
        brdf.eval(np.array([0.0, 0.0, 2.0]), WI[0])
    with pytest.raises(ShapeError, match="broadcast"):
        brdf.eval(np.stack(WI), np.stack(WI[:3]))
    with pytest.raises(ShapeError, match=r"\[0, 1\]"):
        brdf.sample(WI[0], np.array([0.5, 1.5]))


def test_bad_parameters_are_refused():
    ggx = SURFACES["rough"]
    with pytest.raises(ShapeError, match="eta"):
        RoughConductor(ggx, np.ones(4), np.ones(3), BANDS)
    with pytest.raises(UsageError, match="reflectance"):
        Lambert(1.2, BANDS)
    with pytest.raises(UsageError, match="roughness"):
        Sheen(0.0, 0.5, BANDS)
    with pytest.raises(UsageError, match="weights"):
        MixedBRDF([(0.7, Lambert(0.5, BANDS)), (0.7, Lambert(0.5, BANDS))])
    with pytest.raises(BandMismatchError, match="component 1"):
        MixedBRDF([(0.5, Lambert(0.5, BANDS)), (0.5, Lambert(0.5, Bands(None)))])


# ---------------------------------------------------------------- energy


def mirror(ggx: GGX, *, multiple_scattering: bool = True) -> RoughConductor:
    """A conductor whose facets reflect everything (to 4e-6)."""
    return RoughConductor(ggx, 1.0, 1e6, Bands((550.0,)), multiple_scattering)


@pytest.mark.parametrize("alpha", [0.1, 0.3, 0.6, 1.0])
@pytest.mark.parametrize("kind", ["isotropic", "anisotropic", "skewed"])
def test_white_furnace(kind, alpha):
    ggx = {
        "isotropic": GGX.isotropic(alpha),
        "anisotropic": GGX.anisotropic(alpha, 0.4, 0.9),
        "skewed": GGX.skewed(np.array([[1.0, 1.5], [0.2, 1.0]]) / alpha),
    }[kind]
    for degrees in (0.0, 30.0, 60.0, 75.0, 85.0):
        energy = sampled_albedo(mirror(ggx), from_spherical(np.radians(degrees), 0.3), n=40_000)
        assert energy[0] == pytest.approx(1.0, abs=2e-3), degrees  # measured: 5e-4; asked for: 1e-2


def test_without_multiple_scattering_a_rough_mirror_loses_more_than_a_third():
    single = mirror(GGX.isotropic(1.0), multiple_scattering=False)
    assert sampled_albedo(single, WI[1])[0] < 0.66


def test_plastic_over_a_white_base_loses_nothing():
    brdf = Plastic(GGX.isotropic(0.4), 1.5, 1.0, Bands((550.0,)))
    for wi in WI:
        assert sampled_albedo(brdf, wi)[0] == pytest.approx(1.0, abs=1e-3)  # grid and table


def test_tabulated_albedo_is_the_exact_one_for_very_smooth_and_very_unlike_surfaces():
    for ggx in (GGX.isotropic(0.02), GGX.anisotropic(0.05, 0.5, 0.3)):
        single = mirror(ggx, multiple_scattering=False)
        for wi in WI[::3]:
            exact = sampled_albedo(single, wi, n=250_000)
            assert single.albedo(wi)[0] == pytest.approx(exact[0], abs=5e-4)


def test_white_rough_diffuse_surfaces_lose_nothing_and_lambert_is_the_smooth_one(rng):
    for roughness in (0.0, 0.4, 1.0):
        albedo = RoughDiffuse(1.0, roughness, BANDS).albedo(np.stack(WI))
        np.testing.assert_allclose(albedo, 1.0, rtol=1e-12)
    wi, wo = random_directions(rng, 50), random_directions(rng, 50)
    np.testing.assert_allclose(
        RoughDiffuse(RED, 0.0, BANDS).eval(wi, wo), Lambert(RED, BANDS).eval(wi, wo), rtol=1e-12
    )


def test_rough_diffuse_surfaces_send_light_back_to_where_it_comes_from():
    rough, wi = RoughDiffuse(0.5, 1.0, BANDS), WI[2]
    assert np.all(rough.eval(wi, wi) > 1.3 * rough.eval(wi, wi * (-1.0, -1.0, 1.0)))


def test_an_absorbing_layer_deepens_the_colour_towards_grazing():
    white = MODELS["white plastic"]
    amber = Immersed(white, 1.5, np.array([0.2, 0.7, 0.9]))
    ratios = [amber.eval(w, w)[0] / amber.eval(w, w)[2] for w in WI[:3]]
    assert ratios[0] == pytest.approx(
        (0.2 / 0.9) ** 2 * white.eval(WI[0], WI[0])[0] / white.eval(WI[0], WI[0])[2]
    )
    assert ratios[0] > ratios[1] > ratios[2]


# ---------------------------------------------------------------- Mitsuba


def test_conductor_agrees_with_mitsuba(rng):
    mi = pytest.importorskip("mitsuba")
    before = mi.variant()
    mi.set_variant("scalar_rgb")
    try:
        plugin = mi.load_dict(
            {
                "type": "roughconductor",
                "distribution": "ggx",
                "alpha_u": 0.15,
                "alpha_v": 0.4,
                "eta": 0.9,
                "k": 3.0,
            }
        )
        context, interaction = mi.BSDFContext(), mi.SurfaceInteraction3f()
        wi, wo = random_directions(rng, 300), random_directions(rng, 300)
        f_cos, pdf = np.empty(300), np.empty(300)
        for i in range(300):
            interaction.wi = mi.Vector3f(*wi[i].tolist())
            out = mi.Vector3f(*wo[i].tolist())
            f_cos[i] = plugin.eval(context, interaction, out)[0]
            pdf[i] = plugin.pdf(context, interaction, out)
    finally:
        if before is not None:
            mi.set_variant(before)
    ggx = GGX.anisotropic(0.15, 0.4)
    brdf = RoughConductor(ggx, 0.9, 3.0, Bands((550.0,)), multiple_scattering=False)
    # Mitsuba masks both directions independently, we in correlation with height (Heitz 2014).
    zi, zo = (w[:, 2] / ggx.stretched_length(w) for w in (wi, wo))
    separable = 2.0 * (zi + zo) / ((1.0 + zi) * (1.0 + zo))  # G1(wi) G1(wo) / G2(wi, wo)
    # float32: 1e-4 of values that span seven decades
    np.testing.assert_allclose(brdf.eval_cos(wi, wo)[:, 0] * separable, f_cos, rtol=1e-3, atol=1e-7)
    np.testing.assert_allclose(brdf.pdf(wi, wo), pdf, rtol=1e-3, atol=1e-7)
