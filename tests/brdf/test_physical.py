"""Projection to physical files: nothing negative, reciprocal, no more light out than in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.real_materials import real_materials
from helpers.small_library import small_library

from manifold.analytic.base import Lambert
from manifold.brdf import goniometer, physical
from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.physical import AlbedoScaledBRDF, ReciprocalBRDF, physical_file
from manifold.brdf.plausibility import Plausibility, plausibility_of_file, quadrature_albedo
from manifold.brdf.unmeasured_cells import Cells
from manifold.brdf.warp import Warp
from manifold.core.directions import HORIZON, from_spherical
from manifold.core.errors import UsageError
from manifold.core.records import Bands
from manifold.estimate.predictions import predict
from manifold.io_rgl import read_bsdf
from manifold.library.store import Library
from manifold.model.manifold import Manifold
from manifold.model.output_file import OutputOptions
from manifold.model.prediction import ClippedBRDF
from manifold.model.settings import KINDS, BlendSettings

BANDS = Bands((500.0, 600.0))


class Tampered:
    """A Lambertian BRDF of albedo 0.5 and 1.5, with a negative and a non-reciprocal part."""

    bands = BANDS
    is_isotropic = True

    def __init__(self, tilt: float, dip: float):
        """Add tilt * (1 - cos(theta_i)) and subtract dip where both directions are steep."""
        self._tilt, self._dip = tilt, dip
        self._base = Lambert(np.array([0.5, 1.0]), BANDS)
        self.sample, self.pdf = self._base.sample, self._base.pdf

    def eval(self, wi, wo):
        wi, wo = np.broadcast_arrays(wi, wo)
        f = np.array([0.5, 1.5]) / np.pi + self._tilt * (1 - wi[..., 2:])
        dip = self._dip * (wi[..., 2:] * wo[..., 2:]) ** 8
        return (f - dip) * (wo[..., 2:] > 0)

    def eval_cos(self, wi, wo):
        return self.eval(wi, wo) * np.maximum(np.asarray(wo)[..., 2:], 0)

    def albedo(self, wi):
        raise NotImplementedError


def measured(brdf, **how):
    """A file, and what measures it on finer grids."""

    def measure(n_theta_i, resolution):
        return goniometer.measure(brdf, "x", n_theta_i=n_theta_i, resolution=resolution)

    return goniometer.measure(brdf, "x", **how), measure


def reciprocity_error(brdf, rng):
    theta, phi = rng.uniform(0.0, 1.5, (2, 200)), rng.uniform(-np.pi, np.pi, (2, 200))
    wi, wo = (from_spherical(t, p) for t, p in zip(theta, phi, strict=True))
    return np.abs(brdf.eval(wi, wo) - brdf.eval(wo, wi)).max()


def test_reciprocal_correction_leaves_a_difference_of_five_per_cent(rng):
    tilted = Tampered(0.2, 1.0)
    brdf = ReciprocalBRDF(tilted)
    wi, wo = from_spherical(0.3, 0.0), from_spherical(1.2, 2.0)
    f, exchanged = Tampered(0.2, 0.0).eval(wi, wo), Tampered(0.2, 0.0).eval(wo, wi)
    mean = (f * wo[2] + exchanged * wi[2]) / (wi[2] + wo[2])
    np.testing.assert_allclose(ReciprocalBRDF(Tampered(0.2, 0.0)).eval(wi, wo), 0.975 * mean, rtol=1e-12)
    np.testing.assert_allclose(ReciprocalBRDF(Tampered(0.2, 0.0)).eval(wo, wi), 1.025 * mean, rtol=1e-12)
    assert brdf.eval(wi, wo).min() >= 0.0
    assert not np.any(brdf.eval(wi, -wo))


def test_values_that_differ_by_less_stay_as_they_are_bit_for_bit(rng):
    brdf: BRDF = Tampered(0.005, 0.0)
    wi, wo = from_spherical(0.7, 0.1), from_spherical(0.2, 2.0)
    np.testing.assert_array_equal(ReciprocalBRDF(brdf).eval_cos(wi, wo), brdf.eval_cos(wi, wo))
    lambert = Lambert(np.array([0.5, 0.9]), BANDS)
    np.testing.assert_allclose(ReciprocalBRDF(lambert).albedo(wi), [0.5, 0.9], rtol=5e-3)  # 32 nodes


class UpToTheHorizon(Lambert):
    """f_cos that does not vanish at the outgoing horizon, as measured files extrapolate it: f is without bound."""

    def eval_cos(self, wi, wo):
        return super().eval(wi, wo) * 0.7 * (np.asarray(wi)[..., 2:] > 0)

    def eval(self, wi, wo):
        return self.eval_cos(wi, wo) / np.maximum(np.asarray(wo)[..., 2:], 1e-12)


@pytest.mark.parametrize(
    "brdf",
    [Tampered(0.2, 1.0), Tampered(0.0, 0.0), UpToTheHorizon(np.array([0.5, 1.0]), BANDS)],
    ids=["everything", "bright", "horizon"],
)
def test_a_projected_file_is_physical_between_its_nodes_too(brdf):
    file = physical_file(*measured(brdf))
    found = plausibility_of_file(file)
    assert file.spectra.min() >= 0.0
    assert found.reciprocity_error <= 0.05
    wi = from_spherical(np.deg2rad(np.linspace(1.0, 85.0, 43)), 0.0)
    assert MeasuredBRDF(file).albedo(wi, resolution=96).max() <= 1.0


def test_only_bands_that_return_too_much_are_scaled():
    file = physical_file(*measured(Tampered(0.0, 0.0), resolution=12))
    albedo = MeasuredBRDF(file).albedo(from_spherical(0.7, 0.0))
    np.testing.assert_allclose(albedo, [0.5, 0.99], rtol=0.02)  # files of 12 x 12 nodes err by less
    expected = goniometer.with_luminance(file).luminance
    np.testing.assert_allclose(file.luminance, expected, rtol=1e-6)  # float32


@pytest.mark.parametrize(("enough", "expected"), [(8, (4, 8)), (12, (8, 12)), (24, (12, 24))])
def test_grids_are_refined_until_the_file_is_reciprocal_at_most_threefold(enough, expected, monkeypatch):
    def found(brdf):
        return Plausibility(0.0, 0.04 if brdf.spectra.shape[1] >= enough else 0.07, 0.5, 0.0)

    monkeypatch.setattr(physical, "plausibility", found)
    file = physical_file(*measured(Tampered(0.0, 0.0), resolution=8, n_theta_i=4))
    assert (file.spectra.shape[1], file.spectra.shape[-1]) == expected


@pytest.mark.parametrize("kind", ["blend", "gplvm"])
def test_a_physical_prediction_is_a_physical_file(kind, tmp_path, rng):
    model = Manifold.fit(Library.open(small_library(tmp_path)), KINDS[kind](), calibrate=False)
    x = rng.dirichlet(np.ones(len(model.names))) @ model.X
    made = predict(model, x, tmp_path / "p.bsdf", options=OutputOptions(physical=True))
    file = MeasuredBRDF(read_bsdf(tmp_path / "p.bsdf"))
    albedo = file.albedo(from_spherical(np.deg2rad(np.linspace(1.0, 85.0, 15)), 0.0)).max()
    assert albedo <= 1.0
    assert made.plausibility.reciprocity_error <= 0.05
    assert made.plausibility.max_albedo == pytest.approx(albedo, abs=0.02)  # other incidences


def test_what_returns_more_light_than_it_gets_is_written_with_a_warning_or_refused_if_strict(
    tmp_path, monkeypatch
):
    model = Manifold.fit(Library.open(small_library(tmp_path)), BlendSettings(), calibrate=False)
    x = model.X.mean(axis=0)
    brighter = replace(model.combination(x, None), weights=2.0 * model.space.weights(x, None))
    monkeypatch.setattr(Manifold, "combination", lambda *_: brighter)
    output = tmp_path / "bright.bsdf"
    with pytest.raises(
        UsageError,
        match=r"bright\.bsdf: would have an albedo of .* at .* degrees, expected at most 1\.05; .* strict",
    ):
        predict(model, x, output, options=OutputOptions(strict=True))
    assert not output.exists()
    plain = predict(model, x, output)
    assert output.exists()
    at, albedo = plain.plausibility.albedo_incidence_deg, plain.plausibility.max_albedo
    written = MeasuredBRDF(read_bsdf(output)).albedo(from_spherical(np.deg2rad(at), 0.0)).max()
    assert written == pytest.approx(albedo, rel=1e-5)  # the same quadrature
    words = f"not energy-conserving: albedo {albedo:.2f} at {at:.0f} degrees"
    assert any(sentence.startswith(words) for sentence in plain.diagnostics)
    physical = predict(model, x, output, options=OutputOptions(physical=True))
    assert physical.plausibility.max_albedo <= 1.0


class Rim(Lambert):
    """A Lambertian surface whose second band returns far more than its light at grazing incidence."""

    def eval(self, wi, wo):
        wi, wo = np.broadcast_arrays(wi, wo)
        return super().eval(wi, wo) * (1.0 + 4.0 * ((1.0 - wi[..., 2:]) * (1.0 - wo[..., 2:])) ** 2)

    def eval_cos(self, wi, wo):
        return self.eval(wi, wo) * np.maximum(np.asarray(wo)[..., 2:], 0.0)


@pytest.mark.parametrize("keeps_hue", [False, True])
def test_light_is_taken_where_there_is_too_much_and_hue_is_kept_on_demand(keeps_hue, rng):
    bright = Rim(np.array([0.4, 0.9]), BANDS)
    theta = np.deg2rad(np.arange(0.0, 86.0, 5.0))
    wi = from_spherical(theta, 0.0)
    albedo = quadrature_albedo(bright, wi, 32)
    assert albedo[-1, 1] > 1.1
    dimmed = AlbedoScaledBRDF(bright, theta, albedo, keeps_hue)
    np.testing.assert_array_less(dimmed.albedo(wi), 1.001)  # 30 balances
    assert reciprocity_error(dimmed, rng) < 1e-12  # rounding
    upright, grazing = (
        (dimmed.eval(w, v) / bright.eval(w, v))
        for w, v in ((from_spherical(t, 0.0), from_spherical(t, 2.0)) for t in (0.2, 1.4))
    )
    np.testing.assert_array_equal(upright, 1.0)
    assert grazing[1] < 0.9
    assert grazing[0] == pytest.approx(grazing[1] if keeps_hue else 1.0)


class GrazingPaint(Lambert):
    """A matte base under a gloss, which returns too much light where both directions are beyond 80 degrees alone."""

    def eval(self, wi, wo):
        wi, wo = np.broadcast_arrays(wi, wo)
        half = wi + wo
        half = half / np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-9)
        gloss = 0.5 * np.exp(-((1.0 - half[..., 2:]) / 0.02))
        edge = np.prod([np.maximum(np.cos(np.deg2rad(80.0)) - w[..., 2:], 0.0) for w in (wi, wo)], axis=0)
        return super().eval(wi, wo) + (gloss + 3200.0 * edge) * (wo[..., 2:] > 0.0)

    def eval_cos(self, wi, wo):
        return self.eval(wi, wo) * np.maximum(np.asarray(wo)[..., 2:], 0.0)


@pytest.mark.parametrize("keeps_hue", [False, True])
def test_albedo_above_one_at_grazing_incidence_changes_nothing_elsewhere(keeps_hue):
    plain = goniometer.measure(GrazingPaint(np.array([0.3, 0.6]), BANDS), "paint")
    before = MeasuredBRDF(plain).albedo(from_spherical(np.deg2rad([0.0, 45.0, 79.0, 85.0]), 0.0)).max(axis=1)
    assert before[:3].max() < 0.97
    assert before[3] > 1.2
    projected = physical_file(plain, keeps_hue=keeps_hue)
    assert plausibility_of_file(projected).max_albedo <= 1.0
    is_wrong = MeasuredBRDF(plain).albedo(
        from_spherical(np.minimum(plain.theta_i_rad.astype(float), HORIZON), 0.0)
    )
    is_wrong = is_wrong.max(axis=1) > 1.0
    assert list(np.flatnonzero(is_wrong)) == [len(is_wrong) - 1]  # of the eight incidences
    changed = projected.spectra != plain.spectra
    below = np.rad2deg(plain.theta_i_rad[-2])
    for t in range(len(is_wrong) - 1):
        cells = Cells.seen_from(
            Warp(plain.vndf, plain.phi_i_rad, plain.theta_i_rad), 0.0, float(plain.theta_i_rad[t]),
            plain.spectra.shape[-2:], is_isotropic=True,
        )  # fmt: skip
        possible = np.rad2deg(np.arccos(np.clip(cells.wo[..., 2], -1.0, 1.0))) < below
        assert not np.any(changed[0, t][:, possible])
    wi, wo = from_spherical(np.deg2rad(45.0), 0.0), from_spherical(np.deg2rad(45.0), np.pi)
    np.testing.assert_array_equal(MeasuredBRDF(projected).eval(wi, wo), MeasuredBRDF(plain).eval(wi, wo))


def test_a_file_that_is_possible_stays_as_it_is():
    plain = goniometer.measure(Lambert(np.array([0.4, 0.95]), BANDS), "white")
    np.testing.assert_array_equal(physical_file(plain).spectra, plain.spectra)


def test_only_values_that_are_not_reciprocal_change():
    plain = goniometer.measure(Tampered(0.2, 0.0), "tilted", resolution=16)
    plain = replace(plain, spectra=0.4 * plain.spectra)
    file = MeasuredBRDF(plain)
    assert plausibility_of_file(plain).reciprocity_error > 0.05
    is_possible = (
        goniometer.remeasure(ReciprocalBRDF(file), plain).spectra == goniometer.remeasure(file, plain).spectra
    )
    projected = physical_file(plain)
    assert plausibility_of_file(projected).reciprocity_error <= 0.05
    assert 0.05 < is_possible.mean() < 0.95
    np.testing.assert_array_equal(projected.spectra[is_possible], plain.spectra[is_possible])


@pytest.mark.parametrize("name", ["paper_white", "aurora_white", "cm_toxic_green"])
def test_no_possible_value_of_a_real_file_changes(name):
    (material,) = (file for file in real_materials() if file.name == name)
    plain = goniometer.measure(ClippedBRDF(MeasuredBRDF(material)), name)
    file, projected = MeasuredBRDF(plain), physical_file(plain)
    changed = projected.spectra != plain.spectra
    if plausibility_of_file(plain).reciprocity_error <= 0.05:
        assert not np.any(changed)
        return
    averaged = goniometer.remeasure(ReciprocalBRDF(file), plain).spectra
    is_possible = averaged == goniometer.remeasure(file, plain).spectra
    assert 0.1 < changed.mean() < 0.6
    assert not np.any(changed & is_possible)
    assert plausibility_of_file(projected).reciprocity_error <= 0.05
