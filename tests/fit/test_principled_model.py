"""Mitsuba's `principled` and `diffuse` in NumPy: the plugins' values, and derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from manifold.analytic.principled import DEFAULTS
from manifold.core.directions import from_spherical
from manifold.core.errors import UsageError
from manifold.core.records import Bands
from manifold.render import backend
from manifold.render.bsdf_evaluation import AnalyticEvaluator, bsdf_dict, evaluator, is_analytic
from manifold.render.bsdf_parameters import BsdfFamily, FreeParameter, diffuse, principled
from manifold.render.fitted_brdf import FittedBRDF

EVERYTHING = principled(["base_color", *DEFAULTS])


def direction_pairs(rng, count: int = 120) -> tuple[np.ndarray, np.ndarray]:
    """Pairs over the hemisphere, every second one near the mirror direction."""
    theta, phi = np.arccos(rng.uniform(0.05, 1.0, (2, count))), rng.uniform(0.0, 2.0 * np.pi, (2, count))
    near = np.arange(count) % 2 == 1
    theta[1, near] = np.clip(theta[0, near] + rng.normal(0.0, 0.1, near.sum()), 0.0, 1.5)
    phi[1, near] = phi[0, near] + np.pi + rng.normal(0.0, 0.1, near.sum())
    return from_spherical(theta[0], phi[0]), from_spherical(theta[1], phi[1])


def values_of_mitsuba(family: BsdfFamily, values: dict, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """f_cos (M, 3) of the plugin itself, in a variant that needs no LLVM."""
    with backend.variant_kept():
        mi = backend.mitsuba(colour="rgb", backend=backend.Backend("scalar"))
        bsdf = mi.load_dict(bsdf_dict(family, values))
        si, out = mi.SurfaceInteraction3f(), []
        for a, b in zip(wi.tolist(), wo.tolist(), strict=True):
            si.wi = mi.Vector3f(*a)
            out.append(list(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(*b))))
    return np.array(out)


def random_vectors(layout, rng, count: int, edge: float) -> np.ndarray:
    """Parameters (count, K) in their ranges, this share of the range away from the ends."""
    margin = edge * (layout.maximum - layout.minimum)
    return rng.uniform(layout.minimum + margin, layout.maximum - margin, (count, layout.size))


@pytest.mark.parametrize("family", [EVERYTHING, diffuse(), principled()], ids=["all", "diffuse", "default"])
def test_values_are_those_of_mitsubas_plugin(family, rng):
    wi, wo = direction_pairs(rng)
    model = evaluator(family, wi, wo, 3)
    assert isinstance(model, AnalyticEvaluator)
    for p in random_vectors(model.layout, rng, 12, 0.15):
        expected = values_of_mitsuba(family, model.layout.split(p), wi, wo)
        # Mitsuba computes in single precision, and a lobe of alpha 0.02 turns 1e-7 of a normal into 1e-4 of a value.
        np.testing.assert_allclose(model.values(p)[0], expected, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("name", DEFAULTS)
def test_both_ends_of_every_parameter_are_those_of_mitsubas_plugin(name, rng):
    wi, wo = direction_pairs(rng, 60)
    model = evaluator(EVERYTHING, wi, wo, 3)
    values = {"base_color": [0.7, 0.4, 0.1], "metallic": 0.3, "clearcoat": 0.6, "sheen": 0.4, "flatness": 0.2}
    values |= {"spec_tint": 0.3, "sheen_tint": 0.5, "anisotropic": 0.4, "roughness": 0.5}
    values |= {"specular": 0.4, "clearcoat_gloss": 0.3}
    for end in (EVERYTHING.named(name).minimum, EVERYTHING.named(name).maximum):
        moved = values | {name: end}
        found = model.values(model.layout.join(moved))[0]
        expected = values_of_mitsuba(EVERYTHING, moved, wi, wo)
        # Single precision at alpha 0.001: 1e-7 of a normal is a share of 1e-2 of the steepest values.
        np.testing.assert_allclose(found, expected, rtol=2e-2, atol=1e-6)


def test_a_fixed_parameter_is_that_of_mitsubas_plugin(rng):
    wi, wo = direction_pairs(rng, 40)
    fixed = BsdfFamily(
        "principled", (FreeParameter("roughness", 0.1, 1.0, 0.5),), {"metallic": 1.0, "specular": 0.2}
    )
    expected = values_of_mitsuba(fixed, {"roughness": 0.3}, wi, wo)
    np.testing.assert_allclose(evaluator(fixed, wi, wo, 3).values(np.array([0.3]))[0], expected, rtol=1e-3)
    textured = BsdfFamily(
        "principled", fixed.parameters, {"base_color": {"type": "rgb", "value": [0.1, 0.2, 0.3]}}
    )
    assert is_analytic(fixed)
    assert not is_analytic(textured)  # Mitsuba evaluates it
    assert not is_analytic(BsdfFamily("principled", fixed.parameters, {"spec_trans": 0.5}))
    for odd in (FreeParameter("roughness", 0.1, 2.0, 0.5), FreeParameter("base_color", 0.0, 1.0, 0.5)):
        assert not is_analytic(BsdfFamily("principled", (odd,)))


def test_a_fit_is_evaluated_in_blocks(rng, monkeypatch):
    values = {"base_color": [0.5, 0.2, 0.1]} | {o.name: o.default for o in principled().parameters[1:]}
    fit = FittedBRDF.of(principled(), values, Bands(None), {})
    wi, wo = direction_pairs(rng, 50)
    whole = fit.eval(wi, wo)
    monkeypatch.setattr("manifold.render.fitted_brdf._BLOCK", 7)
    np.testing.assert_allclose(fit.eval(wi, wo), whole, rtol=1e-12)
    assert fit.eval(wi[:0], wo[:0]).shape == (0, 3)


@pytest.mark.parametrize("family", [EVERYTHING, diffuse()], ids=["all", "diffuse"])
def test_derivatives_are_those_of_the_values(family, rng):
    wi, wo = direction_pairs(rng, 60)
    model = evaluator(family, wi, wo, 3)
    h = 1e-6
    for p in random_vectors(model.layout, rng, 6, 0.1):
        value, J = model.jacobian(p)
        np.testing.assert_allclose(value, model.values(p)[0], rtol=1e-12)
        for k, step in enumerate(np.eye(model.layout.size) * h):
            difference = (model.values(p + step)[0] - model.values(p - step)[0]) / (2.0 * h)
            # Differences lose 1e-16 / h of the values, and h^2 of the curvature of narrow lobes.
            atol = 1e-8 * np.abs(value).max() + 1e-6 * np.abs(difference).max()
            np.testing.assert_allclose(
                J[..., k], difference, rtol=1e-5, atol=atol, err_msg=model.layout.labels[k]
            )


def test_derivatives_by_bands_are_those_of_the_values(rng):
    wi, wo = direction_pairs(rng, 40)
    model = evaluator(principled(), wi, wo, 5)
    (p,) = random_vectors(model.layout, rng, 1, 0.2)
    value, by_band = model.band_jacobian(p)
    whole, J = model.jacobian(p)
    np.testing.assert_allclose(value, whole, rtol=1e-12)
    own = J[..., model.layout.slices["base_color"]]
    np.testing.assert_allclose(by_band[..., 0], np.einsum("mbb->mb", own), rtol=1e-12)


def test_some_rows_and_many_vectors_have_the_values_of_each(rng):
    wi, wo = direction_pairs(rng, 50)
    model = evaluator(EVERYTHING, wi, wo, 3)
    p, rows = random_vectors(model.layout, rng, 4, 0.1), np.array([3, 30, 41])
    np.testing.assert_allclose(
        model.values(p, rows), np.stack([model.values(one)[0] for one in p])[:, rows], rtol=1e-12
    )


def test_nothing_is_reflected_below_the_horizon(rng):
    wi, wo = direction_pairs(rng, 4)
    wi[0, 2], wo[1, 2], wi[2, 2] = -wi[0, 2], 0.0, 0.0
    model = evaluator(EVERYTHING, wi, wo, 3)
    f_cos = model.values(random_vectors(model.layout, rng, 2, 0.1))
    assert np.all(f_cos[:, :3] == 0.0)
    assert np.all(f_cos[:, 3] > 0.0)


def test_tints_have_no_meaning_in_bands(rng):
    with pytest.raises(UsageError, match="spec_tint and sheen_tint need RGB"):
        evaluator(EVERYTHING, *direction_pairs(rng, 4), 5)
