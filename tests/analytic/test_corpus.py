"""The built-in corpus: what it promises about itself."""

from __future__ import annotations

import numpy as np
import pytest
from bench_goniometer import corpus_error

from manifold.analytic import corpus
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import quadrature_albedo
from manifold.brdf.unmeasured_cells import unmeasured_cells, unmeasured_share
from manifold.core import progress
from manifold.core.directions import from_spherical
from manifold.core.errors import UsageError
from manifold.core.records import Bands
from manifold.io_rgl import read_bsdf, write_bsdf

ISOTROPIC = {m.name: m for m in corpus.isotropic_materials()}
FAMILIES = {
    "felt", "paper", "paint", "card", "leaf", "standard", "satin", "gloss", "metallic", "chrome", "flake",
    "iridescent", "metal",
}  # fmt: skip


def test_there_are_51_isotropic_and_11_anisotropic_materials():
    anisotropic = corpus.anisotropic_materials()
    assert len(ISOTROPIC) == 51
    assert {m.family for m in ISOTROPIC.values()} == FAMILIES
    assert len({m.name for m in anisotropic}) == 11
    assert sorted(m.resolution for m in ISOTROPIC.values())[-2:] == [48, 64]


@pytest.mark.parametrize(
    "material", [*ISOTROPIC.values(), *corpus.anisotropic_materials()], ids=lambda m: m.name
)
def test_every_material_is_reciprocal_and_conserves_energy(material, rng):
    brdf = material.truth(Bands(tuple(np.linspace(360.0, 1000.0, 9))))
    theta, phi = rng.uniform(0.0, np.deg2rad(89.0), (2, 200)), rng.uniform(-np.pi, np.pi, (2, 200))
    wi, wo = (from_spherical(*angles) for angles in zip(theta, phi, strict=True))
    np.testing.assert_allclose(brdf.eval(wi, wo), brdf.eval(wo, wi), rtol=1e-9)  # rounding
    assert np.all(brdf.eval(wi, wo) > 0.0)
    at = from_spherical(np.deg2rad([0.0, 30.0, 60.0, 80.0, 89.0]), 0.3)
    assert quadrature_albedo(brdf, at, 64).max() < 1.0


@pytest.mark.parametrize(
    "name", ["syn_gloss_white", "syn_chrome_plain", "syn_metal_copper", "syn_standard_white"]
)
def test_files_of_the_brightest_materials_conserve_energy(name):
    brdf = MeasuredBRDF(corpus.measure(ISOTROPIC[name]))
    at = from_spherical(np.deg2rad([0.0, 45.0, 60.0, 70.0, 75.0, 80.0, 85.0]), 0.0)
    assert brdf.albedo(at).max() < 1.0


@pytest.mark.parametrize("name", ["syn_felt_pink", "syn_gloss_red", "syn_chrome_mint", "syn_flake_graphite"])
def test_noiseless_files_evaluate_in_mitsuba_as_the_analytic_material(name):
    mean, high = corpus_error(ISOTROPIC[name], 1000)
    # As GGX of alpha 0.05 over a diffuse base: 3.6 % in the mean on the grid of the instrument; these: 2 to 3 %.
    assert mean < 0.04
    assert high < 0.10


@pytest.mark.parametrize("name", ["syn_satin_gold", "syn_gloss_yellow"])
def test_files_have_the_shape_of_the_real_ones(name):
    file = corpus.measure(ISOTROPIC[name])
    n = ISOTROPIC[name].resolution
    assert file.spectra.shape == (1, 8, 195, n, n)
    assert file.wavelengths_nm[0] == pytest.approx(358.63, abs=0.01)
    assert file.wavelengths_nm[-1] == pytest.approx(1001.89, abs=0.01)
    assert np.all(file.spectra >= 0)
    # The real files have 0.8 to 25 % exact zeros.
    assert 0.008 < np.mean(file.spectra == 0) < 0.25
    non_zero = np.any(file.spectra != 0, axis=2)
    unmeasured = 1.0 - file.measured_mask[non_zero].mean()
    assert 0.01 < unmeasured < 0.05  # 3 to 4 % of the non-zero cells of real files are extrapolated,
    assert unmeasured_share(file, unmeasured_cells(file)) < 0.01  # all of them next to the horizon


def test_a_seed_determines_every_byte(tmp_path):
    paths = [tmp_path / f"{k}_spec.bsdf" for k in range(3)]
    for path, seed in zip(paths, (0, 0, 1), strict=True):
        write_bsdf(path, corpus.measure(ISOTROPIC["syn_felt_green"], seed=seed))
    first, same, other = (path.read_bytes() for path in paths)
    assert first == same
    assert first != other


@pytest.mark.parametrize("name", ["syn_felt_orange", "syn_satin_gold", "syn_metal_copper", "syn_paint_olive"])
def test_files_follow_the_analytic_truth(name, rng):
    material = ISOTROPIC[name]
    brdf, truth = MeasuredBRDF(corpus.measure(material)), material.truth()
    theta = rng.uniform(0, np.deg2rad(70), (2, 2000))
    wi, wo = (from_spherical(t, rng.uniform(-np.pi, np.pi, 2000)) for t in theta)
    error = np.abs(brdf.eval(wi, wo) / truth.eval(wi, wo) - 1.0)
    # Interpolation, 0.3 % of speckle, 0.5 % of drift, up to 0.8 % of detector noise, the odd unmeasured cell.
    assert np.median(error) < 0.02
    assert np.quantile(error, 0.9) < 0.12


def test_writing_a_corpus_reports_progress_and_readable_files(tmp_path, monkeypatch):
    few = tuple(ISOTROPIC.values())[:2]
    monkeypatch.setattr(corpus, "isotropic_materials", lambda: few)
    seen = []
    with progress.listen(lambda *step: seen.append(step)):
        paths = corpus.write(tmp_path / "new", rgb=True)
    assert [read_bsdf(path).name for path in paths] == [m.name for m in few]
    assert seen == [(1, 2, few[0].name), (2, 2, few[1].name)]


def test_a_folder_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(UsageError, match="cannot make this folder"):
        corpus.write(tmp_path / "file" / "corpus")
