"""Findings on files whose values were damaged, and none on files whose values were not."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace

import numpy as np
import pytest
from bench_inspection import DAMAGES, with_own_luminance
from helpers.real_materials import real_materials
from helpers.small_library import measured

from manifold.analytic import GGX, Plastic, RoughConductor, corpus
from manifold.brdf import goniometer
from manifold.brdf.consistency import check_consistency
from manifold.core.records import Bands, plain

MATERIALS = ("syn_felt_green", "syn_metal_copper", "syn_paper_white")


@pytest.fixture(scope="module")
def spectral():
    """A dark spectral file of the corpus: its albedo times pi is still below 1."""
    (material,) = (m for m in corpus.isotropic_materials() if m.name == "syn_card_brown")
    return corpus.measure(material)


def anisotropic(warp_exponent=0.5):
    brdf = RoughConductor(
        GGX.anisotropic(0.15, 0.4), np.array([0.2, 0.9, 1.1]), np.array([3.9, 2.4, 2.2]), Bands(None)
    )
    return goniometer.measure(brdf, "brushed", n_phi_i=5, resolution=16, warp_exponent=warp_exponent)


def damaged(damage, file):
    """A file that can be read: flipped bits may make values that are not finite, which reading refuses."""
    tries = (DAMAGES[damage](file, np.random.default_rng(seed)) for seed in itertools.count(1))
    return next(each for each in tries if np.all(np.isfinite(each[0].spectra)))


@pytest.mark.parametrize("name", MATERIALS)
def test_measured_files_have_no_finding(name):
    assert check_consistency(measured(name)).findings == ()


def test_a_spectral_file_has_no_finding(spectral):
    assert check_consistency(spectral).findings == ()


def test_files_that_this_package_writes_have_no_finding():
    assert check_consistency(anisotropic()).findings == ()
    plastic = Plastic(GGX.isotropic(0.1), 1.5, 0.4, Bands(None))
    assert check_consistency(goniometer.measure(plastic, "plastic")).findings == ()


def test_no_material_of_the_database_has_a_finding():
    findings = {
        file.name: check_consistency(file, has_exact_luminance=False).findings for file in real_materials()
    }
    assert not any(findings.values()), findings


@pytest.mark.parametrize("is_isotropic", [True, False])
def test_a_projected_area_that_does_not_follow_from_the_normals_is_named(is_isotropic):
    file = measured("syn_felt_green") if is_isotropic else anisotropic()
    doubled = check_consistency(replace(file, sigma=2.0 * file.sigma)).findings
    # an anisotropic file is 2 % off before
    assert re.fullmatch(
        r"the field 'sigma' is 2(\.0\d)? times the projected area that 'ndf' implies", doubled[0]
    )
    halved = file.sigma.copy()
    halved[:, 100:] *= 0.5
    found = check_consistency(replace(file, sigma=halved)).findings
    assert re.match("the field 'sigma' is down to (0.5|0.499) times", found[0])
    unscaled = replace(file, jacobian=False, sigma=2.0 * file.sigma)  # where neither field counts
    assert not any("sigma" in finding for finding in check_consistency(unscaled).findings)


def test_a_normal_distribution_that_is_zero_everywhere_is_named():
    file = measured("syn_felt_green")
    empty = check_consistency(replace(file, ndf=np.zeros_like(file.ndf)))
    assert empty.findings == ("the field 'ndf' is zero everywhere, and so is the BRDF",)


@pytest.mark.parametrize("name", MATERIALS)
@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_is_named(damage, name):
    file, is_named = damaged(damage, measured(name))
    found = check_consistency(file)
    assert found.findings
    assert is_named(plain(found)), found.findings


def test_rows_for_columns_disagree_by_no_factor():
    """No channel times anything explains them, and nothing that is divided by zero agrees."""
    file = measured("syn_felt_green")
    turned = replace(file, spectra=np.ascontiguousarray(np.swapaxes(file.spectra, 3, 4)))
    findings = check_consistency(turned).findings
    assert findings
    assert not any(" 0 times" in finding for finding in findings)


@pytest.mark.parametrize("damage", ["cell", "negated", "incidence"])
def test_damage_of_a_spectral_file_is_named(spectral, damage):
    file, is_named = damaged(damage, spectral)
    found = check_consistency(file)
    assert is_named(plain(found)), found.findings


@pytest.mark.parametrize("damage", ["scaled", "cell", "negated", "bits"])
def test_damage_of_a_bright_material_is_flagged_without_the_help_of_its_luminance(damage):
    file, _ = damaged(damage, measured("syn_paper_white"))
    assert check_consistency(with_own_luminance(file)).findings


def test_an_incidence_is_named_without_the_help_of_the_luminance():
    file = measured("syn_felt_green")
    spectra = file.spectra.copy()
    spectra[:, 4] *= 3.0
    degrees = f"{np.rad2deg(file.theta_i_rad[4]):.1f} degrees"
    findings = check_consistency(with_own_luminance(replace(file, spectra=spectra))).findings
    assert any(re.search(f"^albedo of .* at {degrees}, between incidences with", words) for words in findings)
    assert any(re.search(rf"f\(wi, wo\) is [23].* at {degrees}", words) for words in findings)


def test_one_azimuth_of_an_anisotropic_file_is_named():
    file = with_own_luminance(anisotropic(warp_exponent=1.0))  # as measured files have it
    spectra = file.spectra.copy()
    spectra[1, 3] *= 3.0
    assert check_consistency(file).findings == ()
    finding = check_consistency(replace(file, spectra=spectra)).findings[0]
    where = f"{np.rad2deg(file.theta_i_rad[3]):.1f} (azimuth -135) degrees"
    assert finding == f"values are 3 times what the field 'luminance' implies, at {where}"


def test_a_cell_stands_beside_its_neighbours_and_what_it_should_be():
    file = measured("syn_felt_green")
    spectra = file.spectra.copy()
    spectra[0, 2, 1, 10, 12] *= 1000.0
    found = check_consistency(replace(file, spectra=spectra))
    (cell,) = found.cells
    assert cell.at == (0, 2, 1, 10, 12)
    # single precision of the luminance, over the share of the channel in it
    assert cell.expected == pytest.approx(float(file.spectra[cell.at]), rel=1e-5)
    around = np.delete(file.spectra[0, 2, 1, 9:12, 11:14].ravel(), 4)
    assert (cell.low, cell.high) == (float(around.min()), float(around.max()))
    (sentence,) = found.findings
    where = f"G at {np.rad2deg(file.theta_i_rad[2]):.1f} degrees, row 10, column 12"
    assert f"farthest {where}: {cell.value:.3g}, expected {cell.expected:.3g}" in sentence


def test_findings_on_whole_incidences_do_not_repeat_those_on_cells():
    file = measured("syn_paper_white")
    spectra = file.spectra.copy()
    spectra[0, 2, 1, 10, 12] = 1e30  # the albedo is 1e27
    found = check_consistency(replace(file, spectra=spectra))
    assert len(found.findings) == 1
    assert found.albedo.max() > 1e20


def test_rounding_of_values_is_no_finding():
    file = measured("syn_felt_green")
    rounded = file.spectra.astype(np.float16).astype(np.float32)
    assert check_consistency(replace(file, spectra=rounded)).findings == ()


def test_measurements_are_those_of_the_material():
    file = measured("syn_paper_white")
    found = check_consistency(file)
    assert found.albedo.shape == (1, len(file.theta_i_rad), 3)
    assert np.all((found.albedo > 0.7) & (found.albedo < 1.0))
    is_far = np.rad2deg(file.theta_i_rad) <= 75.0
    np.testing.assert_array_equal(np.isfinite(found.reciprocity[0]), is_far)
    np.testing.assert_allclose(found.reciprocity[0, is_far], 1.0, atol=0.05)
    assert not found.negative_share.any()
