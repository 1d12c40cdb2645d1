"""Projection to physical files: nothing negative, reciprocal, no more light out than in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.small_library import small_library

from manifold.brdf import goniometer, physical
from manifold.brdf.analytic.base import Lambert
from manifold.brdf.measured import BRDF, MeasuredBRDF
from manifold.brdf.physical import AlbedoScaledBRDF, ReciprocalBRDF, physical_file
from manifold.brdf.plausibility import Plausibility, plausibility_of_file
from manifold.directions import from_spherical
from manifold.errors import UsageError
from manifold.io_rgl import read_bsdf
from manifold.library.store import Library
from manifold.model.manifold import Manifold
from manifold.model.output_file import OutputOptions
from manifold.model.settings import Settings
from manifold.records import Bands
from manifold.workflows.prediction import predict

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


def reciprocity_error(brdf, rng):
    theta, phi = rng.uniform(0.0, 1.5, (2, 200)), rng.uniform(-np.pi, np.pi, (2, 200))
    wi, wo = (from_spherical(t, p) for t, p in zip(theta, phi, strict=True))
    return np.abs(brdf.eval(wi, wo) - brdf.eval(wo, wi)).max()


def test_both_orders_of_directions_are_averaged_by_their_cosines(rng):
    brdf = ReciprocalBRDF(Tampered(0.2, 1.0))
    assert reciprocity_error(brdf, rng) < 1e-12  # rounding
    wi, wo = from_spherical(0.3, 0.0), from_spherical(1.2, 2.0)
    f, swapped = Tampered(0.2, 0.0).eval(wi, wo), Tampered(0.2, 0.0).eval(wo, wi)
    expected = (f * wo[2] + swapped * wi[2]) / (wi[2] + wo[2])
    np.testing.assert_allclose(ReciprocalBRDF(Tampered(0.2, 0.0)).eval(wi, wo), expected, rtol=1e-12)
    assert brdf.eval(wi, wo).min() >= 0.0
    assert not np.any(brdf.eval(wi, -wo))


def test_a_reciprocal_brdf_stays_as_it_is(rng):
    brdf: BRDF = Lambert(np.array([0.5, 0.9]), BANDS)
    wi, wo = from_spherical(0.7, 0.1), from_spherical(0.2, 2.0)
    np.testing.assert_allclose(ReciprocalBRDF(brdf).eval(wi, wo), brdf.eval(wi, wo), rtol=1e-14)
    np.testing.assert_allclose(ReciprocalBRDF(brdf).albedo(wi), [0.5, 0.9], rtol=5e-3)  # 32 nodes


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
    file = physical_file(brdf, "projected")
    found = plausibility_of_file(file)
    assert file.spectra.min() >= 0.0
    assert found.reciprocity_error <= 0.05
    wi = from_spherical(np.deg2rad(np.linspace(1.0, 85.0, 43)), 0.0)
    assert MeasuredBRDF(file).albedo(wi, resolution=96).max() <= 1.0


def test_only_bands_that_return_too_much_are_scaled():
    file = physical_file(Tampered(0.0, 0.0), "x", resolution=12)
    albedo = MeasuredBRDF(file).albedo(from_spherical(0.7, 0.0))
    np.testing.assert_allclose(albedo, [0.5, 0.99], rtol=0.02)  # files of 12 x 12 nodes err by less
    expected = goniometer.with_luminance(file).luminance
    np.testing.assert_allclose(file.luminance, expected, rtol=1e-6)  # float32


@pytest.mark.parametrize(("enough", "expected"), [(8, (4, 8)), (12, (8, 12)), (24, (12, 24))])
def test_grids_are_refined_until_the_file_is_reciprocal_at_most_threefold(enough, expected, monkeypatch):
    def found(measured):
        return Plausibility(0.0, 0.04 if measured.tables[-1].shape[1] >= enough else 0.07, 0.5, 0.0)

    monkeypatch.setattr(physical, "plausibility", found)
    file = physical_file(Tampered(0.0, 0.0), "x", resolution=8, n_theta_i=4)
    assert (file.spectra.shape[1], file.spectra.shape[-1]) == expected


@pytest.mark.parametrize("kind", ["blend", "monochrome"])
def test_a_physical_prediction_is_a_physical_file(kind, tmp_path, rng):
    model = Manifold.fit(Library.open(small_library(tmp_path)), Settings(kind=kind), calibrate=False)
    x = rng.dirichlet(np.ones(len(model.names))) @ model.X
    made = predict(model, x, tmp_path / "p.bsdf", options=OutputOptions(physical=True))
    file = MeasuredBRDF(read_bsdf(tmp_path / "p.bsdf"))
    albedo = file.albedo(from_spherical(np.deg2rad(np.linspace(1.0, 85.0, 15)), 0.0)).max()
    assert albedo <= 1.0
    assert made.plausibility.reciprocity_error <= 0.05
    assert made.plausibility.max_albedo == pytest.approx(albedo, abs=0.02)  # other incidences


def test_what_returns_more_light_than_it_gets_is_not_written(tmp_path, monkeypatch):
    model = Manifold.fit(Library.open(small_library(tmp_path)), Settings(), calibrate=False)
    x = model.X.mean(axis=0)
    brighter = replace(model.combination(x, None), weights=2.0 * model.space.weights(x, None))
    monkeypatch.setattr(Manifold, "combination", lambda *_: brighter)
    output = tmp_path / "bright.bsdf"
    with pytest.raises(
        UsageError, match=r"bright\.bsdf: would have a directional albedo of .* at most 1\.05; .* force it"
    ):
        predict(model, x, output)
    assert not output.exists()
    forced = predict(model, x, output, options=OutputOptions(force=True))
    assert output.exists()
    assert any("not energy-conserving" in sentence for sentence in forced.diagnostics)
    assert predict(model, x, output, options=OutputOptions(physical=True)).plausibility.max_albedo <= 1.0


class Rim(Lambert):
    """A Lambertian surface whose second band returns far more than its light at grazing incidence."""

    def eval(self, wi, wo):
        wi, wo = np.broadcast_arrays(wi, wo)
        return super().eval(wi, wo) * (1.0 + 4.0 * ((1.0 - wi[..., 2:]) * (1.0 - wo[..., 2:])) ** 2)

    def eval_cos(self, wi, wo):
        return self.eval(wi, wo) * np.maximum(np.asarray(wo)[..., 2:], 0.0)


@pytest.mark.parametrize("keeps_hue", [False, True])
def test_light_is_taken_where_there_is_too_much_and_hue_is_kept_on_demand(keeps_hue, rng):
    bright = ReciprocalBRDF(Rim(np.array([0.4, 0.9]), BANDS))
    assert bright.albedo(from_spherical(np.deg2rad(85.0), 0.0))[1] > 1.1
    dimmed = AlbedoScaledBRDF(bright, keeps_hue)
    wi = from_spherical(np.deg2rad(np.arange(0.0, 86.0, 5.0)), 0.0)
    np.testing.assert_array_less(dimmed.albedo(wi), 0.991)  # 30 balances
    assert reciprocity_error(dimmed, rng) < 1e-12  # rounding
    upright, grazing = (
        (dimmed.eval(w, v) / bright.eval(w, v))
        for w, v in ((from_spherical(t, 0.0), from_spherical(t, 2.0)) for t in (0.2, 1.4))
    )
    assert upright.min() > 0.95  # by its largest albedo it would be dimmed to 0.85 everywhere
    assert grazing[1] < 0.9
    assert grazing[0] == pytest.approx(grazing[1] if keeps_hue else 1.0)
