"""Anisotropic samples that lie turned against the materials of a map: found, and predicted turned."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import RoughConductor
from manifold.brdf import goniometer
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.orientation import rotation_of
from manifold.core.directions import rotate_z
from manifold.core.metrics import relative_error
from manifold.core.pairs import RusinkiewiczGrid, cosine_weight
from manifold.core.records import Bands, BsdfFile
from manifold.estimate.attributes import Attributes, Wanted
from manifold.estimate.gloss import gloss_units
from manifold.estimate.predictions import predict
from manifold.estimate.sources import FileSource
from manifold.io_rgl import read_bsdf, write_bsdf
from manifold.library.importing import import_files
from manifold.model.location import locate, reconstruct_file
from manifold.model.manifold import Manifold
from manifold.model.output_file import OutputOptions

PAIRS = RusinkiewiczGrid(20, 11, 7, is_turned=True).directions()[:2]
EXTINCTIONS = {
    "red": [4.0, 2.0, 1.5],
    "grey": [3.0, 3.0, 3.0],
    "blue": [1.5, 2.5, 4.0],
    "new": [3.0, 2.5, 2.0],
}
ALPHAS = {"red": (0.5, 0.2), "grey": (0.4, 0.3), "blue": (0.35, 0.15), "new": (0.5, 0.25)}


@cache
def brushed(name: str, angle_deg: float = 0.0, resolution: int = 16) -> BsdfFile:
    """A brushed metal, turned."""
    normals = GGX.anisotropic(*ALPHAS[name], float(np.deg2rad(angle_deg)))
    metal = RoughConductor(normals, np.array(1.5), np.array(EXTINCTIONS[name]), Bands(None))
    return goniometer.measure(metal, name, resolution=resolution, n_theta_i=8, n_phi_i=9)


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """A map of three brushed metals, of which one lies turned, but was aligned."""
    folder = tmp_path_factory.mktemp("turned")
    for name in ("red", "grey", "blue"):
        write_bsdf(folder / f"{name}_rgb.bsdf", brushed(name, 40.0 if name == "blue" else 0.0))
    assert not import_files(folder / "library.zarr", [folder], rotation_rad="auto").failed
    return Manifold.fit(folder / "library.zarr", calibrate=False)


def test_a_turned_file_is_located_where_it_would_be_unturned_and_predicted_turned(model):
    angle_deg = -35.0
    unturned, turned = locate(model, brushed("new")), locate(model, brushed("new", angle_deg))
    assert unturned.rotation_rad == 0.0
    assert abs((np.rad2deg(turned.rotation_rad) - angle_deg + 90.0) % 180.0 - 90.0) < 0.3
    # At other azimuths the coarse grids of the files interpolate differently: errors differ by 5 %, and the latents,
    # between which errors hardly change, by less than a twentieth of the 4.5 between the materials.
    np.testing.assert_allclose(turned.latent, unturned.latent, atol=0.22)
    assert turned.errors.cube_root == pytest.approx(unturned.errors.cube_root, rel=0.3, abs=0.01)
    back = [rotate_z(w, -np.deg2rad(angle_deg)) for w in PAIRS]
    expected, weight = unturned.brdf.eval(*back), cosine_weight(*PAIRS)
    error = relative_error(expected, turned.brdf.eval(*PAIRS), weight)
    assert error < 0.3 * relative_error(expected, unturned.brdf.eval(*PAIRS), weight)


def test_a_turned_file_is_reconstructed_turned(model):
    file = brushed("new", 90.0)
    found = reconstruct_file(model.library, file)
    assert abs(np.rad2deg(found.rotation_rad)) == pytest.approx(90.0, abs=0.3)
    assert found.errors.cube_root < 0.05


def test_a_turned_sample_with_other_attributes_stays_turned(model, tmp_path):
    write_bsdf(tmp_path / "new_rgb.bsdf", brushed("new", 90.0, resolution=8))
    options = OutputOptions(resolution=8, incidences=6)
    made = predict(
        model, FileSource(tmp_path / "new_rgb.bsdf"), tmp_path / "written_rgb.bsdf", options=options,
        attributes=Attributes({"gloss_60": Wanted(-1.0, is_relative=True)}),
    )  # fmt: skip
    written = read_bsdf(tmp_path / "written_rgb.bsdf")
    assert abs(np.rad2deg(rotation_of(written))) == pytest.approx(90.0, abs=1.0)
    # Gloss is that of the sample as it lies: 20 % more than across it.
    reached = made.attributes["reached"]["gloss"]["60"]
    assert gloss_units(MeasuredBRDF(written), [60.0])[60.0] == pytest.approx(reached, rel=0.1)


def test_samples_that_lie_turned_against_each_other_are_found_while_they_are_read(tmp_path):
    for name, angle_deg in (("red", 0.0), ("grey", 10.0), ("blue", 40.0)):
        write_bsdf(tmp_path / f"{name}_rgb.bsdf", brushed(name, angle_deg, resolution=8))
    import_files(tmp_path / "library.zarr", [tmp_path])
    *names, angle = Manifold.fit(tmp_path / "library.zarr", calibrate=False).materials.farthest_turned
    assert names == ["blue", "red"]
    assert np.rad2deg(angle) == pytest.approx(40.0, abs=0.5)
    import_files(tmp_path / "library.zarr", [tmp_path], rotation_rad="auto", replace=True)
    aligned = Manifold.fit(tmp_path / "library.zarr", calibrate=False)
    assert np.rad2deg(aligned.materials.farthest_turned[2]) < 0.2
