"""Materials as non-negative combinations of all samples of a library and analytic lobes."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.real_materials import real_materials
from helpers.small_library import NAMES, measured, small_library

from manifold.analytic.base import Lambert
from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import RoughConductor
from manifold.brdf import goniometer
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import plausibility
from manifold.core.directions import from_spherical, half_vector
from manifold.core.errors import BandMismatchError, UsageError
from manifold.core.metrics import cube_root_error, relative_error
from manifold.core.pairs import RusinkiewiczGrid, cosine_weight
from manifold.core.records import Bands
from manifold.model import reconstruction
from manifold.model.comparison import brdf_errors
from manifold.model.location import reconstruct_file
from manifold.model.manifold import Manifold
from manifold.model.reconstruction import reconstruct

LEFT_OUT = "syn_satin_gold"
GRID = RusinkiewiczGrid(20, 11, 7, offset=0.3)  # not the pairs that weights are found at


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    names = [name for name in NAMES if name != LEFT_OUT]
    return Manifold.fit(small_library(tmp_path_factory.mktemp("reconstruct"), names=names), calibrate=False)


@pytest.fixture(scope="module")
def pairs():
    wi, wo, above = GRID.directions()
    return wi[above], wo[above]


@pytest.mark.parametrize("name", ["syn_gloss_red", "syn_felt_green"])
def test_a_training_material_comes_back(model, pairs, name):
    (material,) = model.materials.filled([name])  # as predictions combine it: unmeasured cells are filled
    truth, found = material.eval(*pairs), model.reconstruct(material).eval(*pairs)
    # its own bands are samples; what is left is the ridge on the Gram matrix
    assert relative_error(truth, found, cosine_weight(*pairs)) < 1e-4


def test_a_new_material_is_nearer_than_any_of_the_library(model, pairs):
    brdf, cosines = MeasuredBRDF(measured(LEFT_OUT)), cosine_weight(*pairs)
    truth, predicted = brdf.eval(*pairs), model.reconstruct(brdf)
    found = predicted.eval(*pairs)
    nearest = min(cube_root_error(truth, m.eval(*pairs), cosines) for m in model.materials.filled())
    assert cube_root_error(truth, found, cosines) < 0.2 * nearest
    assert found.min() >= 0.0
    assert plausibility(predicted).negative_share == 0.0


def test_materials_of_many_groups_describe_one_as_well_as_all_at_once(model, monkeypatch):
    brdf = MeasuredBRDF(measured(LEFT_OUT))
    at_once = brdf_errors(brdf, model.reconstruct(brdf))
    monkeypatch.setattr(reconstruction, "_SAMPLES_AT_ONCE", 2)
    in_groups = brdf_errors(brdf, model.reconstruct(brdf))
    # One that had no weight among a few may have one among all, so a little is lost.
    assert in_groups.cube_root < 1.1 * at_once.cube_root
    assert in_groups.ball < 1.1 * at_once.ball + 0.05


def test_more_numbers_describe_a_new_material_better(model):
    brdf = MeasuredBRDF(measured(LEFT_OUT))
    errors = [brdf_errors(brdf, model.reconstruct(brdf, numbers)) for numbers in (3, 8, 24)]
    assert np.all(np.diff([error.cube_root for error in errors]) < 0.0)
    assert errors[2].ball < 0.5 * errors[0].ball
    with pytest.raises(UsageError, match="found a limit of 0 parameters"):
        model.reconstruct(brdf, 0)


def test_errors_of_reports_between_any_two_brdfs(model):
    brdf = MeasuredBRDF(measured(LEFT_OUT))
    found = brdf_errors(brdf, model.reconstruct(brdf))
    wi, wo, above = RusinkiewiczGrid.named("default").directions()
    f, grey = brdf.eval(wi[above], wo[above]), Lambert(np.full(3, 0.2), brdf.bands)
    errors = brdf_errors(brdf, grey)
    cosines = cosine_weight(wi[above], wo[above])
    assert errors.linear == pytest.approx(relative_error(f, np.full_like(f, 0.2 / np.pi), cosines))
    assert errors.cube_root == pytest.approx(cube_root_error(f, np.full_like(f, 0.2 / np.pi), cosines))
    for name in ("ball", "cube_root", "linear"):
        assert 0.0 < getattr(found, name) < 0.3 * getattr(errors, name)
        assert getattr(brdf_errors(brdf, brdf), name) == 0.0
    with pytest.raises(BandMismatchError, match="the prediction: found 2 bands"):
        brdf_errors(brdf, Lambert(np.full(2, 0.2), Bands(np.array([500.0, 600.0]))))
    with pytest.raises(UsageError, match="the prediction: found str"):
        brdf_errors(brdf, "prediction_rgb.bsdf")


def test_a_black_material_is_refused_in_words(model):
    with pytest.raises(UsageError, match="the material to reconstruct is black"):
        model.reconstruct(Lambert(np.zeros(3), model.bands))


RGB = Bands.from_array(None)


def brushed(alpha_x: float, alpha_y: float) -> RoughConductor:
    return RoughConductor(GGX.anisotropic(alpha_x, alpha_y), np.array(1.5), np.array(3.0), RGB)


class DimmedBeside:
    """A BRDF of half the brightness wherever the half vector is not in the plane of x and z."""

    is_isotropic, bands = False, RGB

    def __init__(self, brdf):
        self._brdf = brdf

    def eval(self, wi, wo):
        beside = np.abs(half_vector(wi, wo)[..., 1]) > 1e-9
        return self._brdf.eval(wi, wo) * np.where(beside, 0.5, 1.0)[..., None]

    eval_cos = eval  # not called


def test_errors_see_all_azimuths_of_half_vectors():
    # Found at half vectors in one plane, all three errors but the ball's would be 0.
    metal = brushed(0.3, 0.3)
    found = brdf_errors(metal, DimmedBeside(metal))
    assert found.linear == pytest.approx(0.5, abs=0.01)
    assert found.cube_root == pytest.approx(1.0 - 0.5 ** (1 / 3), abs=0.01)


class CacheOf:
    """A cache of given materials."""

    def __init__(self, *materials):
        self.names = range(len(materials))
        self._materials = materials

    def in_bands(self, bands, names):
        return [self._materials[k] for k in names]


def test_an_anisotropic_material_is_reconstructed_at_all_azimuths():
    # In the plane of x and z the two of the library look alike, and like what is to be found.
    library = CacheOf(brushed(0.3, 0.6), brushed(0.3, 0.15))
    truth = brushed(0.3, 0.5)
    found = brdf_errors(truth, reconstruct(library, np.arange(3), truth))
    assert found.cube_root < 0.015  # by half vectors in the plane alone 0.020
    assert found.ball < 0.5  # 1.6


def test_an_anisotropic_file_is_said_to_be_reconstructed_from_isotropic_materials(model):
    file = goniometer.measure(brushed(0.2, 0.5), "x", resolution=8)
    assert reconstruct_file(model.library, file).diagnostics == (
        "anisotropic, but reconstructed from isotropic materials: the same at all azimuths",
    )


def test_other_bands_are_refused(model):
    other = Lambert(np.array([0.5]), Bands((500.0, 600.0)))
    with pytest.raises(BandMismatchError, match="the material to reconstruct"):
        model.reconstruct(other)


class OthersThan:
    """A cache of materials that lacks one."""

    def __init__(self, materials, name):
        self._materials = {m.name: m for m in materials if m.name != name}
        self.names = tuple(self._materials)

    def in_bands(self, bands, names):
        return [self._materials[name].select_bands(bands) for name in names]


def test_real_materials_that_were_left_out_are_physical():
    materials = [MeasuredBRDF(file) for file in real_materials()]
    wi = from_spherical(np.deg2rad([0.0, 45.0, 70.0, 85.0]), 0.0)
    bright = sorted(materials, key=lambda m: -m.albedo(wi, 16).max())[:5]
    for material in bright:
        predicted = reconstruct(OthersThan(materials, material.name), np.arange(3), material)
        assert predicted.albedo(wi).max() <= 1.02
        assert predicted.eval(wi[1], from_spherical(np.linspace(0, 1.5, 300), np.pi)).min() >= 0.0
