"""Unmeasured cells of files are found above the horizon and filled from their rims."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.paths import real_rgl_files

from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import Plastic
from manifold.brdf import goniometer
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured_cells import fill_unmeasured, unmeasured_cells, unmeasured_share
from manifold.core.directions import from_spherical
from manifold.core.records import Bands
from manifold.io_rgl import read_bsdf


@pytest.fixture(scope="module")
def whole():
    return goniometer.measure(Plastic(GGX.isotropic(0.4), 1.5, 0.3, Bands(None)), "whole", resolution=24)


def punched(file, share, seed=0):
    """The file with that share of its cells zero, and which were non-zero before."""
    rng = np.random.default_rng(seed)
    out = rng.random(file.luminance.shape) < share
    spectra = file.spectra.copy()
    spectra[np.broadcast_to(out[:, :, None], spectra.shape)] = 0.0
    return replace(file, spectra=spectra), out & np.any(file.spectra != 0, axis=2)


def test_a_fully_measured_file_is_returned_itself(whole):
    assert not np.any(unmeasured_cells(whole))
    assert fill_unmeasured(whole) is whole


@pytest.mark.parametrize("share", [0.01, 0.1, 0.3])
def test_unmeasured_cells_above_the_horizon_are_found_and_filled(whole, share):
    file, out = punched(whole, share)
    cells = unmeasured_cells(file)
    assert np.all(out[cells])  # nothing that was empty before
    steep = file.theta_i_rad < np.deg2rad(85)
    assert cells[:, steep].sum() > 0.85 * out[:, steep].sum()
    closed = fill_unmeasured(file)
    np.testing.assert_array_equal(closed.spectra[:, :, 0][~cells], file.spectra[:, :, 0][~cells])
    assert np.all(closed.spectra[:, :, 0][cells] > 0)


def test_cells_are_filled_in_place_where_no_copy_is_wanted(whole):
    file, _ = punched(whole, 0.1)
    expected = fill_unmeasured(file)
    found = fill_unmeasured(file, copy=False)
    assert found.spectra is file.spectra
    np.testing.assert_array_equal(found.spectra, expected.spectra)


@pytest.mark.parametrize("share", [0.01, 0.1, 0.3])
def test_filling_brings_values_back(whole, share):
    file, _ = punched(whole, share)
    wi = from_spherical(np.deg2rad(40.0), 0.0)
    theta, phi = np.meshgrid(np.deg2rad(np.arange(5.0, 75.0, 5.0)), np.deg2rad(np.arange(0.0, 360.0, 20.0)))
    wo = from_spherical(theta, phi)
    truth = MeasuredBRDF(whole).eval(wi, wo)

    def error(candidate):
        return np.linalg.norm(MeasuredBRDF(candidate).eval(wi, wo) - truth) / np.linalg.norm(truth)

    assert error(fill_unmeasured(file)) < 0.25 * error(file)


def test_an_empty_slice_stays_empty(whole):
    spectra = whole.spectra.copy()
    spectra[:, 2] = 0.0
    closed = fill_unmeasured(replace(whole, spectra=spectra))
    assert np.all(closed.spectra[:, 2] == 0)


@pytest.mark.parametrize("path", real_rgl_files(), ids=lambda path: path.stem)
def test_real_files_have_no_unmeasured_cells_at_measured_elevations(path):
    file = read_bsdf(path)
    assert fill_unmeasured(file) is file


def test_cells_marked_as_not_measured_count_as_such_whatever_they_hold(whole):
    marked = np.zeros_like(whole.measured_mask)
    marked[:, :5, 8:14, 8:14] = True
    wrong = np.where(marked[:, :, None], 7.0, whole.spectra).astype(np.float32)
    file = replace(
        whole, spectra=wrong, valid=goniometer.pack_valid(whole.measured_mask & ~marked, whole.version)
    )
    cells = unmeasured_cells(file)
    np.testing.assert_array_equal(cells, marked & whole.measured_mask)
    assert fill_unmeasured(file).spectra.max() <= whole.spectra.max()
    assert unmeasured_share(file, cells) == pytest.approx(
        cells.sum() / np.any(file.spectra != 0, axis=2).sum()
    )
