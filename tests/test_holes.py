"""Holes of measured files are found above the horizon and closed from their rims."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import real_rgl_files

from manifold.brdf import goniometer
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured import close_holes, find_holes, share_of_holes
from manifold.directions import from_spherical
from manifold.io_rgl import read_bsdf
from manifold.records import Bands
from manifold.synthetic.microfacet import GGX, Plastic


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


def test_a_file_without_holes_is_returned_itself(whole):
    assert not np.any(find_holes(whole))
    assert close_holes(whole) is whole


@pytest.mark.parametrize("share", [0.01, 0.1, 0.3])
def test_holes_above_the_horizon_are_found_and_closed(whole, share):
    file, out = punched(whole, share)
    holes = find_holes(file)
    assert np.all(out[holes])  # nothing that was empty before
    steep = file.theta_i_rad < np.deg2rad(85)
    assert holes[:, steep].sum() > 0.85 * out[:, steep].sum()
    closed = close_holes(file)
    np.testing.assert_array_equal(closed.spectra[:, :, 0][~holes], file.spectra[:, :, 0][~holes])
    assert np.all(closed.spectra[:, :, 0][holes] > 0)


@pytest.mark.parametrize("share", [0.01, 0.1, 0.3])
def test_closing_brings_values_back(whole, share):
    file, _ = punched(whole, share)
    wi = from_spherical(np.deg2rad(40.0), 0.0)
    theta, phi = np.meshgrid(np.deg2rad(np.arange(5.0, 75.0, 5.0)), np.deg2rad(np.arange(0.0, 360.0, 20.0)))
    wo = from_spherical(theta, phi)
    truth = MeasuredBRDF(whole).eval(wi, wo)

    def error(candidate):
        return np.linalg.norm(MeasuredBRDF(candidate).eval(wi, wo) - truth) / np.linalg.norm(truth)

    assert error(close_holes(file)) < 0.25 * error(file)


def test_an_empty_slice_stays_empty(whole):
    spectra = whole.spectra.copy()
    spectra[:, 2] = 0.0
    closed = close_holes(replace(whole, spectra=spectra))
    assert np.all(closed.spectra[:, 2] == 0)


@pytest.mark.parametrize("path", real_rgl_files(), ids=lambda path: path.stem)
def test_real_files_have_no_holes_at_measured_elevations(path):
    file = read_bsdf(path)
    assert close_holes(file) is file


def test_cells_marked_as_not_measured_are_holes_whatever_they_hold(whole):
    marked = np.zeros_like(whole.measured_mask)
    marked[:, :5, 8:14, 8:14] = True
    wrong = np.where(marked[:, :, None], 7.0, whole.spectra).astype(np.float32)
    file = replace(
        whole, spectra=wrong, valid=goniometer.pack_valid(whole.measured_mask & ~marked, whole.version)
    )
    holes = find_holes(file)
    np.testing.assert_array_equal(holes, marked & whole.measured_mask)
    assert close_holes(file).spectra.max() <= whole.spectra.max()
    assert share_of_holes(file, holes) == pytest.approx(holes.sum() / np.any(file.spectra != 0, axis=2).sum())
