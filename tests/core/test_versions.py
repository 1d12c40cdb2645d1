"""Files that version 0.1.0 wrote are read, or refused with what brings them up to date; newer ones are refused."""

from __future__ import annotations

import json
import zipfile

import numpy as np
import pytest
from helpers.paths import REPOSITORY

import manifold
from manifold.colour.correction import read_correction
from manifold.core.errors import FileFormatError, LibraryError, ModelError
from manifold.formats import read_readings
from manifold.io_rgl import read_bsdf
from manifold.render import fit_json

OLD = REPOSITORY / "tests" / "data" / "0.1.0"


@pytest.fixture
def library(tmp_path):
    with zipfile.ZipFile(OLD / "library.zip") as archive:
        archive.extractall(tmp_path)
    return tmp_path / "library.zarr"


def test_a_library_of_0_1_0_is_read_bit_for_bit(library):
    opened = manifold.Library.open(library)
    assert list(opened.names) == [f"plastic_{k}" for k in range(4)]
    file, stored = read_bsdf(OLD / "plastic_0_rgb.bsdf"), opened.read("plastic_0")
    for name in ("spectra", "ndf", "vndf", "sigma", "luminance", "theta_i_rad"):
        np.testing.assert_array_equal(getattr(stored, name), getattr(file, name))


def test_a_model_of_0_1_0_is_refused_and_embedding_its_library_again_brings_it_up_to_date(library, tmp_path):
    with pytest.raises(ModelError, match="model format 3, expected 4; run `manifold embed` again"):
        manifold.Manifold.load(OLD / "model.h5")
    manifold.Manifold.fit(library, calibrate=False).save(tmp_path / "model.h5")
    assert len(manifold.Manifold.load(tmp_path / "model.h5").names) == 4


def test_a_fit_of_0_1_0_is_read():
    content = fit_json.read(OLD / "plastic.fit.json")
    assert content["program"] == "manifold 0.1.0"
    assert 0.0 <= content["values"]["roughness"] <= 1.0


def test_readings_and_a_correction_of_0_1_0_are_read():
    for name in ("readings.csv", "readings.astm"):
        readings = read_readings(OLD / name)
        assert (readings.name, readings.values.shape) == ("syn_gloss_red", (12, 31))
    assert read_correction(OLD / "correction.json").matrix.shape[1] == 31


def test_newer_versions_are_refused_by_their_number(library, tmp_path):
    def changed(name, **entries):
        path = tmp_path / name
        path.write_text(json.dumps(json.loads((OLD / name).read_text()) | entries))
        return path

    root = library / "zarr.json"
    root.write_text(root.read_text().replace('"schema_version": 1', '"schema_version": 99'))
    with pytest.raises(LibraryError, match="schema version 99, expected 1 or 2"):
        manifold.Library.open(library)
    with pytest.raises(FileFormatError, match="99"):
        fit_json.read(changed("plastic.fit.json", format_version=99))
    with pytest.raises(FileFormatError, match="format version 99, expected 1"):
        read_correction(changed("correction.json", format_version=99))
    newer = tmp_path / "readings.csv"
    newer.write_text("# format: manifold readings 99\n" + (OLD / "readings.csv").read_text())
    with pytest.raises(FileFormatError, match="'manifold readings 99', expected 'manifold readings 1'"):
        read_readings(newer)
