"""Weighted combinations of measured materials, and how physical they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.chi_square import chi_square_p_value
from helpers.small_library import measured

from manifold.analytic.base import Lambert
from manifold.analytic.free_lobes import Lobes
from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import Plastic, RoughConductor
from manifold.brdf import goniometer
from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import mirrored_quadrature, plausibility
from manifold.brdf.sums import WeightedSum
from manifold.core.directions import from_spherical, hemisphere_quadrature
from manifold.core.errors import BandMismatchError, ShapeError
from manifold.core.mapping import CubeRoot
from manifold.core.pairs import Pairs
from manifold.core.records import Bands
from manifold.model.combination import Combination, Dictionary, Values
from manifold.model.prediction import ClippedBRDF, PredictedBRDF
from manifold.registries import MAPPINGS

RGB = Bands(None)
MATERIALS = [
    Lambert(np.array([0.8, 0.4, 0.2]), RGB),
    Plastic(GGX.isotropic(0.2), np.array(1.5), np.array([0.1, 0.3, 0.6]), RGB),
    RoughConductor(GGX.isotropic(0.3), np.full(3, 0.2), np.full(3, 3.0), RGB),
]


def combined(mapping, *weights):
    return PredictedBRDF(MATERIALS, Combination(MAPPINGS[mapping], np.array(weights)))


def directions(rng, n):
    theta, phi = rng.uniform(0, np.deg2rad(85), (2, n)), rng.uniform(-np.pi, np.pi, (2, n))
    return from_spherical(theta[0], phi[0]), from_spherical(theta[1], phi[1])


@pytest.mark.parametrize("mapping", MAPPINGS)
@pytest.mark.parametrize("index", range(3))
def test_a_unit_vector_gives_the_material_bit_for_bit(mapping, index, rng):
    wi, wo = directions(rng, 200)
    predicted = PredictedBRDF(MATERIALS, Combination(MAPPINGS[mapping], np.eye(3)[index]))
    np.testing.assert_array_equal(predicted.eval(wi, wo), MATERIALS[index].eval(wi, wo))
    np.testing.assert_array_equal(predicted.eval_cos(wi, wo), MATERIALS[index].eval_cos(wi, wo))


@pytest.mark.parametrize("mapping", MAPPINGS)
def test_predictions_are_combined_in_the_mapped_domain(mapping, rng):
    weights = np.array([0.5, 0.7, -0.2])
    T = MAPPINGS[mapping]
    predicted = PredictedBRDF(MATERIALS, Combination(T, weights))
    wi, wo = directions(rng, 50)
    for a, b in zip(wi, wo, strict=True):
        cosines = np.array(a[2] * b[2])
        mapped = [T.forward(m.eval(a, b), cosines) for m in MATERIALS]
        expected = T.inverse(sum(w * t for w, t in zip(weights, mapped, strict=True)), cosines)
        np.testing.assert_allclose(predicted.eval(a, b), expected, rtol=1e-12, atol=1e-15)


class Wrapped:
    """A measured BRDF that the fused loops do not recognise, so that predictions take the general path."""

    def __init__(self, brdf):
        self._brdf = brdf
        self.bands, self.is_isotropic = brdf.bands, brdf.is_isotropic
        self.sample, self.pdf, self.albedo = brdf.sample, brdf.pdf, brdf.albedo
        self.eval, self.eval_cos = brdf.eval, brdf.eval_cos


@pytest.fixture(scope="module")
def measured_materials():
    """Isotropic and anisotropic, two resolutions, one with negative values."""
    files = [measured("syn_satin_gold"), measured("syn_gloss_yellow")]
    files.append(
        goniometer.measure(Plastic(GGX.anisotropic(0.2, 0.4), np.array(1.5), np.full(3, 0.3), RGB), "brushed")
    )
    noisy = measured("syn_felt_green")
    files.append(replace(noisy, spectra=noisy.spectra - np.float32(0.05)))
    return [MeasuredBRDF(file) for file in files]


@pytest.mark.parametrize("mapping", MAPPINGS)
@pytest.mark.parametrize("n", [1, 100, 9000])
def test_measured_materials_are_combined_in_one_pass_as_one_by_one(measured_materials, mapping, n, rng):
    weights = np.array([0.6, -0.3, 0.5, 0.2])
    wi, wo = directions(rng, n)
    wo[::7] *= [1.0, 1.0, -1.0]  # some below the horizon
    fused = PredictedBRDF(measured_materials, Combination(MAPPINGS[mapping], weights)).eval(wi, wo)
    wrapped = PredictedBRDF([Wrapped(m) for m in measured_materials], Combination(MAPPINGS[mapping], weights))
    general = wrapped.eval(wi, wo)
    # Fused values are in single precision, as files have them; differences of large terms cost some more.
    np.testing.assert_allclose(fused, general, rtol=2e-6, atol=1e-7 * np.abs(general).max())
    assert not np.any(fused[::7])


def test_a_mapping_of_ones_own_is_not_taken_for_the_one_it_derives_from(measured_materials, rng):
    class FifthRoot(CubeRoot):
        def forward(self, values, cosine_weight=None):
            return np.sign(values) * np.abs(values) ** 0.2

        def inverse(self, mapped, cosine_weight=None):
            return mapped**5

    own = Combination(FifthRoot(), np.array([0.6, 0.1, 0.3, 0.0]))
    wi, wo = directions(rng, 50)
    roots = [FifthRoot().forward(material.eval(wi, wo)) for material in measured_materials]
    expected = sum(weight * root for weight, root in zip(own.weights, roots, strict=True)) ** 5
    np.testing.assert_allclose(PredictedBRDF(measured_materials, own).eval(wi, wo), expected, rtol=1e-6)


@pytest.mark.parametrize("weights", [[0.6, -0.3, 0.5, 0.2], [0.0, 1.0, 0.0, 0.0]])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_predictions_are_written_to_the_memory_that_is_given(measured_materials, dtype, weights, rng):
    predicted = PredictedBRDF(measured_materials, Combination(MAPPINGS["cube-root"], np.array(weights)))
    wi, wo = directions(rng, 1200)
    wi, wo, out = wi.reshape(3, 400, 3), wo.reshape(3, 400, 3), np.full((3, 400, 3), np.nan, dtype)
    assert predicted.eval(wi, wo, out=out) is out
    np.testing.assert_array_equal(out, predicted.eval(wi, wo).astype(dtype))
    with pytest.raises(ShapeError, match="out is"):
        predicted.eval(wi, wo, out=out[..., :2])


@pytest.mark.parametrize("cube_root", [False, True])
@pytest.mark.parametrize("count", [1, 4, 5, 9])
def test_a_weighted_sum_is_that_of_its_materials(measured_materials, count, cube_root, rng):
    """Other grids, symmetries and groups beside each other; neighbours in one cell, in one slice, below the horizon."""
    theta, phi = np.deg2rad(rng.uniform(1.0, 89.0, 200)), rng.uniform(-np.pi, np.pi, 200)
    wi = np.repeat(from_spherical(theta, phi), 5, axis=0)
    wo = np.repeat(directions(rng, 200)[1], 5, axis=0) + 1e-3 * rng.normal(size=(1000, 3))
    wo /= np.linalg.norm(wo, axis=1, keepdims=True)
    wo[::7] *= [1.0, 1.0, -1.0]
    materials = [measured_materials[k % len(measured_materials)] for k in range(count)]
    weights = rng.normal(size=count)
    summed = WeightedSum(materials, weights, cube_root=cube_root)
    found = np.zeros((1000, 3), summed.dtype)
    summed.add_to(found, Pairs(wi, wo))
    terms = np.array([material.eval(wi, wo) for material in materials])
    terms = np.cbrt(terms) if cube_root else terms
    # Values, weights and the sums of four materials are in single precision: about 6e-8 each, of the terms.
    atol = 5e-7 * np.tensordot(np.abs(weights), np.abs(terms), 1)
    assert np.all(np.abs(found - np.tensordot(weights, terms, 1)) <= atol)


def test_values_at_located_pairs_are_those_of_eval(measured_materials, rng):
    wi, wo = directions(rng, 300)
    pairs = Pairs(wi, wo)
    for material in measured_materials:
        np.testing.assert_allclose(material.eval_at(pairs), material.eval(wi, wo), rtol=1e-12)


@pytest.mark.parametrize("theta_deg", [0.0, 45.0, 75.0])
def test_samples_of_a_prediction_follow_its_pdf(theta_deg, rng):
    predicted = combined("cube-root", 0.5, 0.8, -0.3)
    assert chi_square_p_value(predicted, from_spherical(np.deg2rad(theta_deg), 1.0), rng) > 1e-4


def test_albedo_of_a_prediction_is_its_integral():
    predicted = combined("cube-root", 0.4, 0.3, 0.3)
    wo, weights = hemisphere_quadrature(96, 192)
    for theta in (0.0, 0.6, 1.1):
        wi = from_spherical(theta, 0.4)
        np.testing.assert_allclose(predicted.albedo(wi), weights @ predicted.eval_cos(wi, wo), rtol=5e-3)


def test_quadrature_around_the_mirror_direction_integrates_sharp_lobes():
    mirror = RoughConductor(GGX.isotropic(0.02), np.full(3, 0.2), np.full(3, 3.0), RGB)
    wi = from_spherical(0.7, 0.0)
    wo, measure = mirrored_quadrature(wi)
    np.testing.assert_allclose(measure @ mirror.eval_cos(wi, wo), mirror.albedo(wi), rtol=0.01)


def test_predictions_share_the_protocol_and_broadcast(rng):
    predicted = combined("cube-root", 0.5, 0.5, 0.0)
    assert isinstance(predicted, BRDF)
    assert isinstance(ClippedBRDF(predicted), BRDF)
    wi, wo = directions(rng, 6)
    assert predicted.eval(wi[0], wo.reshape(2, 3, 3)).shape == (2, 3, 3)
    assert not np.any(predicted.eval(wi[0], -wo))


class OneSided(Lambert):
    """Brighter where light comes from above; not reciprocal."""

    def eval(self, wi, wo):
        return super().eval(wi, wo) * (1.0 + np.asarray(wi)[..., 2:])


class FromTheSide(Lambert):
    """Anisotropic, and brighter where light comes from the side."""

    is_isotropic = False

    def eval(self, wi, wo):
        return super().eval(wi, wo) * (1.0 + 3.0 * np.abs(np.asarray(wi)[..., 1:2]))


def test_plausibility_sees_negative_values_gained_energy_and_a_lack_of_reciprocity():
    found = plausibility(Lambert(np.array([1.0, 0.5, 0.1]), RGB))
    assert found.negative_share == 0.0
    assert found.reciprocity_error < 1e-12
    assert found.max_albedo == pytest.approx(1.0, abs=0.01)  # 32 x 32 quadrature nodes
    assert plausibility(combined("identity", -1.0, 2.0, 0.0)).negative_share > 0.1
    assert plausibility(combined("identity", 1.0, 0.0, 1.0)).max_albedo > 1.5
    assert plausibility(OneSided(np.array([0.5]), RGB)).reciprocity_error > 0.1
    assert plausibility(FromTheSide(np.array([0.5]), RGB)).max_albedo > 1.2


def test_clipping_removes_and_counts_negative_values(rng):
    wi, wo = directions(rng, 500)
    predicted = combined("identity", -1.0, 2.0, 0.0)
    clipped = ClippedBRDF(predicted)
    raw = predicted.eval(wi, wo)
    np.testing.assert_array_equal(clipped.eval(wi, wo), np.maximum(raw, 0.0))
    assert clipped.clipped_share == pytest.approx(np.mean(raw < 0))


@pytest.mark.parametrize(
    "weights", [np.ones(2), np.zeros(3), np.array([1.0, np.nan, 0.0]), np.ones((1, 3))], ids=str
)
def test_weights_that_fit_nothing_are_refused(weights):
    with pytest.raises(ShapeError, match=r"weights (have shape|are zero)"):
        PredictedBRDF(MATERIALS, Combination(MAPPINGS["identity"], weights))


def test_materials_of_different_bands_are_refused():
    other = Lambert(np.array([0.5]), Bands((500.0, 600.0)))
    with pytest.raises(BandMismatchError):
        PredictedBRDF([MATERIALS[0], other], Combination(MAPPINGS["identity"], np.array([0.5, 0.5])))


# -- samples and lobes -------------------------------------------------------------------------------------


def of_atoms(rng, dictionary, *, sparsity=0.9):
    """Weights (B, n') >= 0 of the atoms of three materials in three bands and of lobes, most of them zero."""
    weights = rng.random((3, dictionary.size(9))) * (rng.random(dictionary.size(9)) > sparsity)
    weights[:, [1, -5]] = 0.3  # at least one sample and one lobe
    return 0.3 * weights / weights.sum(axis=1, keepdims=True)


@pytest.mark.parametrize(
    "dictionary", [Dictionary(), Dictionary((1.0, 0.6, 1.5), Lobes((0.1, 0.3), (2.0,)))], ids=["A", "B"]
)
@pytest.mark.parametrize("wrapped", [False, True])
def test_atoms_are_combined_as_tabulated_values_are(measured_materials, dictionary, wrapped, rng):
    materials = [measured_materials[k] for k in (0, 1, 3)]  # the last has negative values
    weights = of_atoms(rng, dictionary)
    combination = Combination(MAPPINGS["cube-root"], weights, np.arange(3), dictionary=dictionary)
    wi, wo = directions(rng, 3000)
    values = Values(np.stack([m.eval(wi, wo) for m in materials]), wi, wo)
    samples = np.maximum(np.cbrt(np.moveaxis(values.f, 2, 1).reshape(9, -1)), 0.0)
    powers = [samples**exponent for exponent in dictionary.exponents]
    expected = weights @ np.vstack([*powers, dictionary.lobes.cube_roots(wi, wo)])
    tabulated = combination.evaluate(values)
    np.testing.assert_allclose(tabulated, expected.T**3, rtol=1e-9)
    predicted = PredictedBRDF([Wrapped(m) for m in materials] if wrapped else materials, combination)
    np.testing.assert_allclose(predicted.eval(wi, wo), tabulated, rtol=1e-6)  # roots in single precision
    assert tabulated.min() >= 0.0
    assert not np.any(predicted.eval(wi, wo * [1, 1, -1]))


def test_a_prediction_of_lobes_alone_needs_no_material(rng):
    dictionary = Dictionary(lobes=Lobes((0.2,), (2.0,)))
    weights = np.zeros((3, dictionary.size(9)))
    weights[:, -7] = 0.8  # the Lambertian
    predicted = PredictedBRDF(
        MATERIALS, Combination(MAPPINGS["cube-root"], weights, np.arange(3), dictionary=dictionary)
    )
    wi, wo = directions(rng, 20)
    np.testing.assert_allclose(predicted.eval(wi, wo), 0.8**3 / np.pi)


@pytest.mark.parametrize("theta_deg", [0.0, 45.0, 75.0])
def test_samples_of_lobes_follow_their_pdf(theta_deg, rng):
    dictionary = Dictionary(lobes=Lobes((0.1, 0.4), (1.5, 2.0, 3.0)))
    weights = of_atoms(rng, dictionary, sparsity=0.5)
    predicted = PredictedBRDF(
        MATERIALS, Combination(MAPPINGS["cube-root"], weights, np.arange(3), dictionary=dictionary)
    )
    assert chi_square_p_value(predicted, from_spherical(np.deg2rad(theta_deg), 1.0), rng) > 1e-4
