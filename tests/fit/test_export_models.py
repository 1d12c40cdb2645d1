"""Shading models of engines: against Mitsuba where they coincide, against quadrature, and by what surfaces may do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from manifold.analytic.ggx import GGX
from manifold.core.directions import from_spherical, rotate_z
from manifold.core.errors import UsageError
from manifold.fit.exports import (
    TARGETS,
    gltf,
    lobes,
    openpbr,
    preview_surface,
    standard_surface,
    unity,
    unreal,
)
from manifold.fit.exports.lobes import ShadingPairs
from manifold.fit.exports.principled_values import PrincipledValues
from manifold.render.bsdf_evaluation import evaluator
from manifold.render.bsdf_parameters import diffuse, principled

FULL = PrincipledValues(
    (0.8, 0.3, 0.05), metallic=0.3, roughness=0.4, specular=0.7, clearcoat=0.8, clearcoat_gloss=0.9, sheen=0.5,
    spec_tint=0.2, sheen_tint=0.3, anisotropic=0.6, rotation_rad=0.5,
)  # fmt: skip


def directions(rng, n):
    cosine = rng.uniform(0.05, 1.0, n)
    return from_spherical(np.arccos(cosine), rng.uniform(0.0, 2.0 * np.pi, n))


def mitsuba(family, values, view, light):
    """f of a BSDF of Mitsuba."""
    made = evaluator(family, view, light, 3)
    return made.values(made.layout.join(values))[0] / light[:, 2:]


def hemisphere(n=64):
    """Directions, and the solid angle of each."""
    cosine = (np.arange(n) + 0.5) / n
    c, phi = np.meshgrid(cosine, 2.0 * np.pi * (np.arange(2 * n) + 0.5) / (2 * n))
    return from_spherical(np.arccos(c.ravel()), phi.ravel()), 2.0 * np.pi / c.size


@pytest.mark.parametrize(
    ("roughness", "anisotropic", "rtol"),
    [(0.2, 0.0, 2e-5), (0.5, 0.0, 2e-5), (1.0, 0.0, 2e-5), (0.5, 0.7, 1e-4)],
)
def test_a_rough_metal_in_gltf_equals_principled_except_for_masking(roughness, anisotropic, rtol, rng):
    # Both are GGX with Schlick's term; Mitsuba's masking is separable, and in single precision.
    view, light = directions(rng, 500), directions(rng, 500)
    values = {
        "base_color": [0.9, 0.5, 0.1],
        "roughness": roughness,
        "metallic": 1.0,
        "anisotropic": anisotropic,
    }
    expected = mitsuba(principled(values), values, view, light)
    material = PrincipledValues((0.9, 0.5, 0.1), metallic=1.0, roughness=roughness, anisotropic=anisotropic)
    surface = GGX.anisotropic(*material.alphas)
    alone = [2.0 / (1.0 + surface.stretched_length(each) / each[:, 2]) for each in (view, light)]
    correlated = 1.0 / (1.0 / alone[0] + 1.0 / alone[1] - 1.0)  # Heitz 2014, eq. 99
    expected = expected * (correlated / (alone[0] * alone[1]))[:, None]
    single, _ = lobes.single_scattering(ShadingPairs.of(view, light), min(material.alphas))
    expected = expected * (1.0 + np.array(material.base_color) * (1.0 / single - 1.0))
    np.testing.assert_allclose(
        gltf.brdf(gltf.parameters(material), ShadingPairs.of(view, light)), expected, rtol=rtol
    )


def test_a_film_in_gltf_has_the_colour_of_the_viewer_s_angle_and_leaves_the_diffuse():
    view = np.broadcast_to(from_spherical(0.9, 0.0), (2, 3))
    light = from_spherical(np.array([0.1, 1.3]), np.array([1.0, 3.0]))
    film = dict(zip(gltf.FILM, (1.0, 400.0, 1.7), strict=True))
    black, grey = (gltf.parameters(PrincipledValues((c, c, c), roughness=0.6)) for c in (0.0, 0.5))
    pairs = ShadingPairs.of(view, light)
    reflected = gltf.brdf(black | film, pairs) / lobes.specular_joint(pairs, 0.36, 0.36)[:, None]
    np.testing.assert_allclose(reflected[0], reflected[1], rtol=1e-9)  # whatever the light
    diffuse = [gltf.brdf(grey | each, pairs) - gltf.brdf(black | each, pairs) for each in ({}, film)]
    np.testing.assert_allclose(*diffuse, rtol=1e-9)


def test_the_diffuse_of_gltf_loses_what_each_channel_of_its_highlight_reflects():
    both = from_spherical(np.array([0.4]), np.array([0.0]))
    values = gltf.DEFAULTS | {"metallicFactor": 0.0, "ior": 2.0, "specularColorFactor": [1.0, 0.0, 0.5]}
    black = gltf.brdf(values | {"baseColorFactor": [0.0, 0.0, 0.0]}, ShadingPairs.of(both, both))
    found = gltf.brdf(values, ShadingPairs.of(both, both)) - black
    np.testing.assert_allclose(np.pi * found[0], 1.0 - np.array([1.0, 0.0, 0.5]) / 9.0, rtol=1e-9)


def test_a_metal_of_every_target_is_close_to_principled_away_from_grazing(rng):
    # At a roughness of 0.3 correlated masking and energy compensation change little away from grazing.
    view, light = directions(rng, 2000), directions(rng, 2000)
    steep = (view[:, 2] > 0.4) & (light[:, 2] > 0.4)
    view, light = view[steep], light[steep]
    values = {"base_color": [0.9, 0.5, 0.1], "roughness": 0.3, "metallic": 1.0}
    expected = mitsuba(principled(values), values, view, light)
    for target in TARGETS.values():
        made = target.parameters(PrincipledValues((0.9, 0.5, 0.1), metallic=1.0, roughness=0.3))
        found = target.brdf(made, ShadingPairs.of(view, light))
        limit = 0.1 if target.name == "standard-surface" else 0.05  # a conductor's Fresnel term
        assert np.median(np.abs(found / expected - 1.0)) < limit, target.name


@pytest.mark.parametrize(
    "name", [name for name in TARGETS if name != "unity"]
)  # whose base is Burley's, below 4 %
def test_a_diffuse_surface_is_lambertian(name, rng):
    target = TARGETS[name]
    view, light = directions(rng, 200), directions(rng, 200)
    expected = mitsuba(diffuse(), {"reflectance": [0.5, 0.3, 0.1]}, view, light)
    material = PrincipledValues.from_fit({"type": "diffuse"}, {"reflectance": [0.5, 0.3, 0.1]})
    found = target.brdf(target.parameters(material), ShadingPairs.of(view, light))
    if target.name.startswith(("usd", "openpbr")):  # at grazing they reflect whatever the index
        steep = (view[:, 2] > 0.85) & (light[:, 2] > 0.85)
        np.testing.assert_allclose(found[steep], expected[steep], rtol=0.01)
    else:
        np.testing.assert_allclose(found, expected, rtol=1e-5)


@pytest.mark.parametrize("target", TARGETS.values(), ids=lambda target: target.name)
def test_no_target_makes_light(target):
    light, solid_angle = hemisphere()
    white = PrincipledValues((1.0, 1.0, 1.0), roughness=0.6, clearcoat=1.0, clearcoat_gloss=0.2, sheen=1.0)
    for cosine in (0.2, 0.6, 1.0):
        view = np.broadcast_to([np.sqrt(1.0 - cosine**2), 0.0, cosine], light.shape)
        f = target.brdf(target.parameters(white), ShadingPairs.of(view, light))
        albedo = np.sum(f * light[:, 2:], axis=0) * solid_angle
        # these add lobes without taking what they reflect from the diffuse
        limit = 1.25 if target.name in ("unreal", "unity", "usd", "usd-materialx") else 1.02
        assert albedo.max() < limit, (target.name, cosine)
        assert f.min() >= 0.0


@pytest.mark.parametrize("name", ["gltf", "openpbr", "blender", "unity"])
def test_a_rough_white_metal_loses_nothing_where_light_scatters_between_facets(name):
    light, solid_angle = hemisphere(128)
    values = TARGETS[name].parameters(PrincipledValues((1.0, 1.0, 1.0), metallic=1.0, roughness=0.8))
    for cosine in (0.2, 0.6, 1.0):
        view = np.broadcast_to([np.sqrt(1.0 - cosine**2), 0.0, cosine], light.shape)
        albedo = (
            np.sum(TARGETS[name].brdf(values, ShadingPairs.of(view, light)) * light[:, 2:], axis=0)
            * solid_angle
        )
        assert albedo == pytest.approx([1.0] * 3, abs=0.01)  # quadratures of albedo and here


def test_an_anisotropic_lobe_with_joint_masking_is_the_isotropic_one_where_the_alphas_are_equal(rng):
    pairs = ShadingPairs.of(directions(rng, 100), directions(rng, 100))
    np.testing.assert_allclose(
        lobes.specular_joint(pairs, 0.3, 0.3), lobes.specular_correlated(pairs, 0.3, 0.3), rtol=1e-9
    )


@pytest.mark.parametrize("name", [name for name in TARGETS if not name.startswith("usd")])
@pytest.mark.parametrize("angle", [0.5, 2.5])
def test_the_parameters_of_a_turned_sample_are_those_of_the_sample_turned(name, angle, rng):
    target = TARGETS[name]
    view, light = directions(rng, 200), directions(rng, 200)
    turned = target.brdf(target.parameters(replace(FULL, rotation_rad=angle)), ShadingPairs.of(view, light))
    along_x = target.parameters(replace(FULL, rotation_rad=0.0))
    expected = target.brdf(along_x, ShadingPairs.of(rotate_z(view, -angle), rotate_z(light, -angle)))
    np.testing.assert_allclose(turned, expected, rtol=1e-9)
    assert not np.allclose(turned, target.brdf(along_x, ShadingPairs.of(view, light)), rtol=0.1)


def test_the_diffuse_of_unity_is_burley_s_and_its_coat_is_sharp():
    up, grazing = np.array([[0.0, 0.0, 1.0]]), from_spherical(np.array([1.4]), np.array([0.0]))
    plain = unity.DEFAULTS | {"_BaseColor": [1.0] * 3, "_Smoothness": 0.0}
    light = ShadingPairs.of(up, up)
    specular = 0.04 * lobes.specular_joint(light, 1.0, 1.0)[0]
    scattered = 1.0 + 0.04 * (1.0 / lobes.single_scattering(light, 1.0)[0][0, 0] - 1.0)
    found = unity.brdf(plain, ShadingPairs.of(up, up))[0, 0] - specular * scattered
    assert found == pytest.approx(1.0 / (1.03571 * np.pi), rel=1e-9)
    assert (
        unity.brdf(plain, ShadingPairs.of(grazing, grazing))[0, 0] > 1.5 / np.pi
    )  # a rough surface shines back
    metal = unity.DEFAULTS | {"_BaseColor": [0.0] * 3, "_Smoothness": 0.7}
    coated = unity.brdf(metal | {"_CoatMask": 1.0}, ShadingPairs.of(up, up))[0, 0]
    assert coated == pytest.approx(0.04 / (4.0 * np.pi * 1e-4), rel=0.01)  # the peak of the coat


def test_a_coat_in_unity_leaves_the_base_as_rough_as_it_was():
    coated = PrincipledValues((0.5, 0.5, 0.5), roughness=0.4, clearcoat=1.0, clearcoat_gloss=1.0)
    made = unity.parameters(coated)
    assert made["_CoatMask"] == 0.5
    assert made["_Smoothness"] > 0.6
    below = unity._widened((1.0 - made["_Smoothness"]) ** 2, unity._narrowing(0.5))
    assert below == pytest.approx(0.16, rel=1e-9)
    assert unity._widened(0.16, unity._narrowing(0.5)) > 0.16


def test_split_sums_are_the_albedo_of_the_lobe():
    light, solid_angle = hemisphere(128)
    for alpha, cosine in ((0.2, 0.9), (0.5, 0.3), (0.9, 0.6)):
        view = np.broadcast_to([np.sqrt(1.0 - cosine**2), 0.0, cosine], light.shape)
        pairs = ShadingPairs.of(view, light)
        lobe = lobes.specular_correlated(pairs, alpha, alpha) * light[:, 2] * solid_angle
        fresnel = (1.0 - pairs.cos_d) ** 5
        a, b = lobes.split_sum(pairs, alpha)
        expected = np.sum(lobe * (1.0 - fresnel)), np.sum(lobe * fresnel)
        assert (a[0], b[0]) == pytest.approx(expected, abs=0.01)  # 33 nodes, 24 x 24 samples


def test_fuzz_integrates_to_its_albedo():
    light, solid_angle = hemisphere(128)
    view = np.broadcast_to([0.8, 0.0, 0.6], light.shape)
    pairs = ShadingPairs.of(view, light)
    black, white = np.zeros((len(light), 3)), np.ones((len(light), 3))
    lobe = lobes.zeltner_layer(pairs, black, 1.0, np.ones(3), 0.5)
    below = lobes.zeltner_layer(pairs, white, 1.0, np.ones(3), 0.5) - lobe
    assert np.sum(lobe[:, 0] * light[:, 2]) * solid_angle == pytest.approx(1.0 - below[0, 0], rel=0.02)


def test_openpbr_under_a_coat_has_the_roughness_that_was_wanted():
    made = openpbr.parameters(
        PrincipledValues((0.5, 0.5, 0.5), roughness=0.4, clearcoat=1.0, clearcoat_gloss=0.5)
    )
    added = 2.0 * made["coat_roughness"] ** 4
    roughened = openpbr.roughened(made["specular_roughness"], added, made["coat_weight"])
    assert made["specular_roughness"] < 0.4
    assert roughened == pytest.approx(0.4, abs=1e-7)


def test_the_coat_has_the_peak_of_mitsuba_s(rng):
    # Seen and lit along the normal, Mitsuba's GTR1 and GGX of the matched alpha are one number.
    up = np.array([[0.0, 0.0, 1.0]])
    values = {
        "base_color": [0.0] * 3,
        "specular": 0.5,
        "roughness": 1.0,
        "clearcoat": 1.0,
        "clearcoat_gloss": 0.6,
    }
    both = mitsuba(principled(values), values, up, up) - mitsuba(
        principled(values), values | {"clearcoat": 0.0}, up, up
    )
    material = PrincipledValues((0.0, 0.0, 0.0), clearcoat=1.0, clearcoat_gloss=0.6)
    alpha = material.coat_alpha
    coat = 0.04 * lobes.specular_joint(ShadingPairs.of(up, up), alpha, alpha)
    assert coat[0] == pytest.approx(both[0, 0], rel=2e-3)


def test_sheens_have_mitsuba_s_albedo():
    # The constants of the table in docs/how-to/export.md.
    light, solid_angle = hemisphere(48)
    cosines = np.array([0.2, 0.4, 0.6, 0.8])
    pairs = [
        ShadingPairs.of(np.broadcast_to([np.sqrt(1 - c * c), 0.0, c], light.shape), light) for c in cosines
    ]
    black = np.zeros((len(light), 3))

    def albedo(lobe):
        return np.array([np.sum(lobe(p) * light[:, 2]) * solid_angle for p in pairs])

    expected = albedo(lambda p: (1.0 - p.cos_d) ** 5)
    sheens = {
        "gltf": lambda p: gltf.SHEEN_SCALE * gltf._sheen_lobe(p, gltf.SHEEN_ROUGHNESS),
        "standard": lambda p: (
            standard_surface.SHEEN_SCALE * lobes.imageworks_sheen(p, standard_surface.SHEEN_ROUGHNESS)
        ),
        "openpbr": lambda p: (
            openpbr.FUZZ_SCALE * lobes.zeltner_layer(p, black, 1.0, np.ones(3), openpbr.FUZZ_ROUGHNESS)[:, 0]
        ),
    }
    for name, lobe in sheens.items():
        np.testing.assert_allclose(albedo(lobe), expected, atol=0.004, err_msg=name)


def test_parameters_stay_in_the_ranges_of_the_targets(rng):
    for _ in range(50):
        values = {
            name: float(rng.uniform())
            for name in PrincipledValues.__dataclass_fields__
            if name != "is_diffuse"
        }
        material = PrincipledValues(**values | {"base_color": tuple(rng.uniform(size=3))})
        for target in TARGETS.values():
            made = target.parameters(material)
            assert made.keys() == target.defaults.keys()
            for key, value in made.items():
                highest = 2.0 if "ior" in key.lower() else 1.0
                if "hickness" in key:  # nm, of a film that there is not
                    assert value == target.defaults[key]
                    continue
                if "angent" in key:  # the azimuth of the highlights, in degrees
                    highest = 360.0
                if key == "specularColorFactor":  # the one colour that glTF lets go above 1
                    highest = np.inf
                assert np.all(np.asarray(value) >= 0.0), (target.name, key, value)
                assert np.all(np.asarray(value) <= highest), (target.name, key, value)


def test_parameters_at_principled_defaults_become_defaults_of_the_target():
    plain = PrincipledValues((0.5, 0.4, 0.3), roughness=0.35)
    for target in TARGETS.values():
        made = target.parameters(plain)
        moved = {key for key, value in made.items() if value != target.defaults[key]}
        words = ("color", "roughness", "smoothness", "metallicfactor", "workflow")
        assert all(any(word in key.replace(" ", "").lower() for word in words) for key in moved), moved


def test_values_at_the_end_of_a_range_are_the_end_and_colours_are_clipped():
    values = {"base_color": [-0.2, 0.5, 1.2], "clearcoat": 4e-10, "metallic": 0.99999, "roughness": 0.3}
    made = PrincipledValues.from_fit({"type": "principled"}, values)
    assert made.base_color == (0.0, 0.5, 1.0)
    assert (made.clearcoat, made.metallic) == (0.0, 1.0)


@pytest.mark.parametrize(
    "kind", [{"type": "roughconductor"}, {"type": "principled", "fixed": {"spec_trans": 1.0}}]
)
def test_what_engines_do_not_have_is_refused(kind):
    with pytest.raises(UsageError, match=r"spec_trans|roughconductor"):
        PrincipledValues.from_fit(kind, {"base_color": [0.5] * 3})


def test_light_and_viewer_may_be_exchanged_where_the_model_is_reciprocal(rng):
    view, light = directions(rng, 100), directions(rng, 100)
    for model in (preview_surface, unreal):
        values = model.parameters(FULL)
        there, back = ShadingPairs.of(view, light), ShadingPairs.of(light, view)
        np.testing.assert_allclose(model.brdf(values, there), model.brdf(values, back), rtol=1e-10)


@pytest.mark.parametrize("target", TARGETS.values(), ids=lambda target: target.name)
def test_values_at_pairs_that_were_used_before_are_those_at_new_ones(target, rng):
    view, light = directions(rng, 600), directions(rng, 600)  # more than a film is tabulated at
    used, values = ShadingPairs.of(view, light), target.parameters(FULL)
    for name in target.film:
        entry = target.entries[name]
        values[name] = 0.5 * (entry.low + entry.high)
    target.brdf(values, used)
    for name, entry in target.entries.items():
        if np.ndim(values[name]) == 0 and (entry.is_free or name in target.film):
            changed = values | {name: entry.low + 0.37 * (entry.high - entry.low)}
            found = target.brdf(changed, used)
            np.testing.assert_array_equal(found, target.brdf(changed, ShadingPairs.of(view, light)))
            assert not np.array_equal(found, target.brdf(values, used)), name
