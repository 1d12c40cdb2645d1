"""Compact materials, and tables of visible normals that follow from `ndf`."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.paths import real_rgl_files
from helpers.sample_files import assert_same, assert_same_array, sample_file, write_samples
from helpers.small_library import measured, small_library, small_model, spectral_materials

from manifold.analytic import corpus
from manifold.brdf import goniometer
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured_cells import unmeasured_cells
from manifold.core.errors import LibraryError, UsageError
from manifold.core.records import Bands, BsdfFile
from manifold.io_rgl import read_bsdf, write_bsdf
from manifold.library import staging, visible_normals
from manifold.library.compacting import CUBE_ROOT_PER_BALL, compact_library, encode
from manifold.library.importing import import_files
from manifold.library.layout import StoredArray, write_array
from manifold.library.store import Library
from manifold.model.comparison import brdf_errors


@pytest.fixture
def compacted(tmp_path: Path) -> Library:
    """A compact library of six RGB materials; their files are in `files` beside it."""
    path = small_library(tmp_path)
    compact_library(path)
    return Library(path)


def stored_bytes(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


# Visible normals


def odd_vndf(file: BsdfFile, rng: np.random.Generator) -> BsdfFile:
    """Zeros of both signs, the smallest number and a large one."""
    vndf = rng.random(file.vndf.shape, dtype=np.float32)
    vndf[..., 0, :4] = [0.0, -0.0, 1e-45, 1e30]
    return replace(file, vndf=vndf)


@pytest.mark.parametrize("azimuths", [1, 2, 9])
@pytest.mark.parametrize("kind", ["as measured", "random", "odd"])
def test_vndf_comes_back_bit_for_bit(rng, kind: str, azimuths: int) -> None:
    file = sample_file("m", azimuths=azimuths) if kind != "as measured" else measured("syn_satin_gold")
    file = odd_vndf(file, rng) if kind == "odd" else file
    differences, slices = visible_normals.encode(file)
    slices = visible_normals.Slices.from_json(json.loads(json.dumps(slices.to_json())))
    found = visible_normals.decode(differences, slices, file.ndf, file.phi_i_rad)
    assert_same_array(found, file.vndf, "vndf")


def test_vndf_that_follows_from_ndf_is_rounding_alone() -> None:
    differences, _ = visible_normals.encode(measured("syn_satin_gold"))
    assert np.mean(differences == 0) > 0.5
    assert np.percentile(np.abs(differences), 98) < 256


def test_anisotropic_vndf_that_follows_from_ndf_is_rounding_alone() -> None:
    brushed = corpus.anisotropic_materials()[0].truth(Bands((550.0,)))
    file = goniometer.measure(brushed, "brushed", resolution=4, n_theta_i=3, n_phi_i=3, warp_exponent=1.0)
    differences, slices = visible_normals.encode(file)
    assert np.percentile(np.abs(differences), 90) < 256
    found = visible_normals.decode(differences, slices, file.ndf, file.phi_i_rad)
    assert_same_array(found, file.vndf, "vndf")


def test_a_library_of_schema_1_is_read(tmp_path: Path) -> None:
    (path,) = write_samples(tmp_path, 1)
    import_files(tmp_path / "library.zarr", [path])
    group = tmp_path / "library.zarr" / "materials" / "m00"
    shutil.rmtree(group / "vndf_difference")
    write_array(group / "vndf", StoredArray(read_bsdf(path).vndf))
    for of, key, value in (
        (group, "visible_normals", None),
        (tmp_path / "library.zarr", "schema_version", 1),
    ):
        content = json.loads((of / "zarr.json").read_text())
        content["attributes"].pop(key)
        content["attributes"] |= {} if value is None else {key: value}
        (of / "zarr.json").write_text(json.dumps(content))
    assert_same(Library(tmp_path / "library.zarr").read("m00"), read_bsdf(path))


def test_a_chunk_that_would_expand_is_refused(tmp_path: Path) -> None:
    import_files(tmp_path / "library.zarr", write_samples(tmp_path, 1))
    chunk = tmp_path / "library.zarr" / "materials" / "m00" / "vndf_difference" / "c.0.0.0.0"
    content = bytearray(chunk.read_bytes())
    content[4:8] = (1 << 31).to_bytes(4, "little")
    chunk.write_bytes(content)
    with pytest.raises(LibraryError, match=r"m00: .*has 2147483648 bytes, expected 432"):
        Library(tmp_path / "library.zarr").read("m00")


@pytest.mark.skipif(not real_rgl_files(), reason="no real files at hand: set MANIFOLD_RGL_DIR")
def test_real_files_come_back_byte_for_byte(tmp_path: Path) -> None:
    paths = [path for path in real_rgl_files() if path.name.endswith("_rgb.bsdf")]
    import_files(tmp_path / "library.zarr", paths)
    library = Library(tmp_path / "library.zarr")
    for path in paths:
        write_bsdf(tmp_path / "back.bsdf", library.read(path.name.removesuffix("_rgb.bsdf")))
        assert (tmp_path / "back.bsdf").read_bytes() == path.read_bytes(), path.name
    assert library.disk_bytes < 0.3 * sum(path.stat().st_size for path in paths)


# Encoding


@pytest.mark.parametrize("tolerance", [0.5, 0.05])
def test_errors_are_those_of_reports_and_within_the_tolerance(tolerance: float) -> None:
    spectral = spectral_file()
    for file in (measured("syn_satin_gold"), spectral):
        compact = encode(file, tolerance)
        found = brdf_errors(MeasuredBRDF(file), MeasuredBRDF(replace(file, **compact.decode())))
        assert found.ball == pytest.approx(compact.accuracy.ball)
        assert found.cube_root == pytest.approx(compact.accuracy.cube_root)
        assert 0.0 < found.ball <= tolerance
        assert found.cube_root <= CUBE_ROOT_PER_BALL * tolerance


def spectral_file() -> BsdfFile:
    """A material in 60 bands."""
    brdf, file = spectral_materials()[-1], measured("syn_satin_gold")
    spectra = np.moveaxis(brdf.spectra.reshape(1, *brdf.spectra.shape), -1, 2)
    return replace(file, spectra=spectra, wavelengths_nm=np.array(brdf.bands.wavelengths_nm, np.float32))


def test_what_is_not_approximated_is_kept(rng: np.random.Generator) -> None:
    for file in (sample_file("m", azimuths=3, size=8), odd_vndf(measured("syn_felt_green"), rng)):
        found = replace(file, **encode(file, 1.0).decode())
        for name in ("phi_i_rad", "theta_i_rad", "sigma", "ndf", "valid"):
            assert_same_array(getattr(found, name), getattr(file, name), name)
        assert list(found.extra) == list(file.extra)
        for name, values in file.extra.items():
            assert_same_array(found.extra[name], values, name)
        np.testing.assert_allclose(found.vndf, file.vndf, rtol=2.0**-13, atol=1e-40)
        assert np.all(found.vndf >= 0.0)
        is_dark = np.all(file.spectra == 0, axis=2)
        np.testing.assert_array_equal(np.all(found.spectra == 0, axis=2), is_dark)
        # Directions follow from the rounded vndf: a cell at the horizon may move across it.
        assert np.mean(unmeasured_cells(found) != unmeasured_cells(file)) < 1e-3
        assert found.spectra.min() >= 0.0
        assert found.spectra.dtype == found.luminance.dtype == np.float32


def test_dim_cells_do_not_become_unmeasured() -> None:
    file = measured("syn_felt_green")
    spectra = file.spectra.copy()
    spectra[0, 2, :, 10:14] *= np.float32(1e-12)
    dim = replace(file, spectra=spectra)
    found = replace(dim, **encode(dim, 0.5).decode())
    np.testing.assert_array_equal(np.any(found.spectra != 0, axis=2), np.any(spectra != 0, axis=2))


def test_a_black_material_stays_black() -> None:
    file = measured("syn_felt_green")
    black = replace(file, spectra=np.zeros_like(file.spectra), luminance=np.zeros_like(file.luminance))
    assert not np.any(encode(black).decode()["spectra"])


def test_a_tolerance_that_cannot_be_kept_leaves_the_material(tmp_path: Path) -> None:
    path = small_library(tmp_path, names=["syn_felt_green"])
    result = compact_library(path, 1e-9)
    assert "syn_felt_green: its compact form differs by" in result.failed["syn_felt_green"]
    assert_same(Library(path).read("syn_felt_green"), measured("syn_felt_green"))
    result = import_files(tmp_path / "other.zarr", [tmp_path / "files"], tolerance=1e-9)
    assert next(iter(result.failed.values())).startswith("syn_felt_green: its compact form")
    for tolerance in (0.0, -1.0, np.nan):
        with pytest.raises(UsageError, match="expected a number above 0"):
            compact_library(path, tolerance)


# Libraries


def test_a_compact_library_is_small_and_reads_as_before(tmp_path: Path) -> None:
    path = small_library(tmp_path)
    library, before = Library(path), Library(path).content_hash
    size = library.disk_bytes
    result = compact_library(path)
    assert list(result.compacted) == list(library.names)
    assert library.disk_bytes < 0.15 * size
    assert library.content_hash == before  # models stay valid
    assert library.verify() == []
    assert [path.name for path in tmp_path.glob(".*")] == [".library.zarr.lock"]  # locks stay, empty
    assert {p.name for p in (path / "materials" / "syn_felt_green").iterdir()} == {
        "zarr.json", "coefficients", "tables",
    }  # fmt: skip
    again = compact_library(path, 0.1)
    assert again.compacted == {}
    assert again.skipped == library.names


def test_compact_import_and_compacted_import_are_the_same(tmp_path: Path, compacted: Library) -> None:
    import_files(tmp_path / "at_once.zarr", [tmp_path / "files"], tolerance=0.2)
    at_once = Library(tmp_path / "at_once.zarr")
    for name in compacted.names:
        assert at_once.attributes(name) == compacted.attributes(name)
        assert_same(at_once.read(name), compacted.read(name))


def test_importing_with_replace_changes_the_form(tmp_path: Path, compacted: Library) -> None:
    files = tmp_path / "files"
    assert import_files(compacted.path, [files]).skipped == compacted.names
    assert import_files(compacted.path, [files], replace=True).replaced == compacted.names
    assert_same(compacted.read("syn_felt_green"), measured("syn_felt_green"))
    import_files(compacted.path, [files], replace=True, tolerance=0.5)
    assert compacted.attributes("syn_felt_green").accuracy.tolerance == 0.5  # type: ignore[union-attr]


@pytest.mark.parametrize("harm", ["coefficients", "tables", "attribute"])
def test_damage_of_a_compact_material_is_found(compacted: Library, harm: str) -> None:
    group = compacted.path / "materials" / "syn_felt_green"
    if harm == "attribute":
        content = json.loads((group / "zarr.json").read_text())
        content["attributes"]["tables"][0][2] = [1 << 40]
        (group / "zarr.json").write_text(json.dumps(content))
    else:
        chunk = next((group / harm).glob("c.*"))
        content = bytearray(chunk.read_bytes())
        content[-3] ^= 0x40
        chunk.write_bytes(content)
    assert len(compacted.verify()) == 1
    with pytest.raises(LibraryError, match=r"^syn_felt_green: .*import its file again$"):
        compacted.read("syn_felt_green")


def test_values_that_would_not_fit_into_memory_are_refused(
    compacted: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("manifold.library.compact._MOST_VALUES", 1000)
    with pytest.raises(LibraryError, match="24576 values, expected at most 1000"):
        compacted.read("syn_felt_green")


@pytest.mark.parametrize("rows", [[0, 0, 0, 0, 0, 0, 0, 0], [0], 0])
def test_a_basis_of_another_shape_is_refused_before_it_is_used(rows: list[int] | int) -> None:
    compact = encode(measured("syn_felt_green"))
    compact.tables["basis"] = compact.tables["basis"][rows]
    with pytest.raises(ValueError, match=r"^coefficients \(.* with a basis \(.* expected \(K, P, T, H, W\)"):
        compact.decode()


@pytest.mark.parametrize("step", ["rename", "replace", "rmtree"])
def test_compacting_cut_short_leaves_every_material_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    path = small_library(tmp_path, names=["syn_felt_green", "syn_satin_gold"])

    def cut_short(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    def supplant(staged: Path, target: Path) -> None:
        monkeypatch.setattr(shutil if step == "rmtree" else os, step, cut_short)
        whole(staged, target)

    whole = staging.supplant
    with monkeypatch.context() as patched:
        patched.setattr(staging, "supplant", supplant)
        with pytest.raises(KeyboardInterrupt):
            compact_library(path)
    monkeypatch.undo()
    library = Library(path)
    assert library.names == ("syn_felt_green", "syn_satin_gold")
    assert library.verify() == []
    result = compact_library(path)
    assert sorted([*result.compacted, *result.skipped]) == ["syn_felt_green", "syn_satin_gold"]
    assert all(library.attributes(name).accuracy for name in library.names)
    assert len(list((path / "materials").glob("*/*"))) == 6


def test_a_whole_material_that_claims_to_be_compact_keeps_its_arrays(tmp_path: Path) -> None:
    path = small_library(tmp_path, names=["syn_felt_green", "syn_satin_gold"])
    attributes = path / "materials" / "syn_felt_green" / "zarr.json"
    content = json.loads(attributes.read_text())
    content["attributes"]["accuracy"] = {"tolerance": 0.2, "ball": 0.1, "cube_root": 0.001}
    before = sorted(attributes.parent.rglob("*"))
    attributes.write_text(json.dumps(content))
    result = compact_library(path)
    assert (list(result.compacted), list(result.failed)) == (["syn_satin_gold"], ["syn_felt_green"])
    assert "lacks its field 'coefficients'" in result.failed["syn_felt_green"]
    assert sorted(attributes.parent.rglob("*")) == before
    content["attributes"]["accuracy"] = None
    attributes.write_text(json.dumps(content))
    assert Library(path).verify() == []


@pytest.mark.parametrize("linked", ["syn_felt_green", "syn_felt_green/spectra"])
def test_a_link_into_another_library_is_not_compacted(tmp_path: Path, linked: str) -> None:
    victim = small_library(tmp_path, names=["syn_felt_green"])
    own = tmp_path / "own.zarr"
    shutil.copytree(victim, own)
    shutil.rmtree(own / "materials" / linked)
    (own / "materials" / linked).symlink_to(victim / "materials" / linked)
    result = compact_library(own)
    assert (result.compacted, list(result.failed)) == ({}, ["syn_felt_green"])
    assert f"{linked}: a link to" in result.failed["syn_felt_green"]
    assert Library(victim).attributes("syn_felt_green").accuracy is None
    assert Library(victim).verify() == []


# Commands


def test_commands_read_compact_libraries_with_models_fitted_before(tmp_path: Path, run) -> None:
    small_model(tmp_path)
    predict = ("predict", "--latent", "0.1,0.1", "-o")
    assert run(*predict, "before_rgb.bsdf", cwd=tmp_path)[0] == 0
    status, out, _ = run("compact", "library.zarr", "--tolerance", "0.3", cwd=tmp_path)
    assert status == 0
    assert "compacted        6" in out
    assert run(*predict, "after_rgb.bsdf", cwd=tmp_path)[0] == 0
    before, after = (MeasuredBRDF(read_bsdf(tmp_path / f"{n}_rgb.bsdf")) for n in ("before", "after"))
    assert brdf_errors(before, after).ball < 0.3
    status, out, _ = run("info", "library.zarr", cwd=tmp_path)
    assert "6 of the materials, largest errors 0." in out
    assert "ball, cube root" in out


def test_tolerance_without_compact_is_refused(tmp_path: Path, run) -> None:
    status, _, complaint = run("import", ".", "--tolerance", "0.1", cwd=tmp_path)
    assert status == 2
    assert "--tolerance without --compact" in complaint
