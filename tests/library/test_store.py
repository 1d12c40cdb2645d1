"""The library: `manifold.library.store`, `manifold.library.importing`, `manifold.library.staging`."""

from __future__ import annotations

import dataclasses
import errno
import hashlib
import os
import shutil
import signal
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
import zarr
from helpers.fork_server import ForkServer, fork_server
from helpers.sample_files import WAVELENGTHS_NM, assert_same, assert_same_array, sample_file, write_samples
from helpers.small_library import measured

from manifold.core import progress
from manifold.core.errors import BandMismatchError, LibraryError, MissingFileError, UsageError
from manifold.core.records import Bands, BsdfFile
from manifold.core.stores import Entry
from manifold.io_rgl import read_bsdf, write_bsdf
from manifold.library import layout, staging
from manifold.library.identity import is_material_name
from manifold.library.importing import ImportResult, InconsistentFileWarning, import_files
from manifold.library.store import Library


def _outcomes(result: ImportResult) -> tuple[object, ...]:
    return result.imported, result.skipped, result.replaced, result.failed


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three spectral files."""
    write_samples(tmp_path / "files", 3)
    return tmp_path / "files"


@pytest.fixture
def library(tmp_path: Path, folder: Path) -> Library:
    """A library of the three files."""
    import_files(tmp_path / "library.zarr", [folder])
    return Library.open(tmp_path / "library.zarr")


def beside(library: Path) -> set[str]:
    """Hidden files beside a library and its materials, without locks."""
    found = {path.name for folder in (library.parent, library / "materials") for path in folder.glob(".*")}
    return {name for name in found if not name.endswith(".zarr.lock")}


# Reading


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"wavelengths_nm": None},
        {"azimuths": 9},
        {"wavelengths_nm": np.linspace(360, 1000, 195, dtype=np.float32), "size": 8},
        {"wavelengths_nm": np.array([550], np.float32)},
    ],
    ids=["spectral", "rgb", "anisotropic", "195 bands", "one band"],
)
def test_a_material_reads_back_as_the_imported_file_bit_for_bit(tmp_path: Path, options: dict) -> None:
    paths = write_samples(tmp_path, 2, **options)
    result = import_files(tmp_path / "library.zarr", paths)
    assert _outcomes(result) == (("m00", "m01"), (), (), {})
    library = Library.open(tmp_path / "library.zarr")
    for path in paths:
        file = read_bsdf(path)
        found = library.read(file.name)
        assert_same(found, file)
        assert np.moveaxis(found.spectra, 2, -1).flags.c_contiguous
    assert library.bands == file.bands
    assert library.verify() == []


def test_names_are_sorted_and_found(library: Library) -> None:
    assert library.names == ("m00", "m01", "m02")
    assert len(library) == 3
    assert "m01" in library
    assert "m1" not in library
    assert "../materials/m01" not in library


def test_attributes_tell_where_a_material_comes_from(library: Library, folder: Path) -> None:
    info = library.attributes("m01")
    file = read_bsdf(folder / "m01_spec.bsdf")
    assert info.source_file == "m01_spec.bsdf"
    assert info.sha256 == hashlib.sha256((folder / "m01_spec.bsdf").read_bytes()).hexdigest()
    assert info.description == file.description
    assert info.is_synthetic
    assert info.pipeline_version == (3, 1)
    assert info.shape == (1, 3, 70, 4, 4)
    arrays = [v for v in vars(file).values() if isinstance(v, np.ndarray)] + list(file.extra.values())
    assert info.bytes == sum(array.nbytes for array in arrays)


def test_the_library_hash_changes_with_its_materials_only(
    library: Library, tmp_path: Path, folder: Path
) -> None:
    before = library.content_hash
    library.cache_put("gram", {"S": np.eye(2)})
    assert library.content_hash == before
    import_files(tmp_path / "other.zarr", [folder])
    assert Library.open(tmp_path / "other.zarr").content_hash == before
    write_bsdf(tmp_path / "new_spec.bsdf", sample_file("new", 9))
    import_files(library.path, [tmp_path / "new_spec.bsdf"])
    assert library.content_hash != before


def test_a_shard_that_is_gone_is_no_black_material(library: Library) -> None:
    (library.path / "materials" / "m01" / "spectra" / "c.0.0.0.0.0").unlink()
    with pytest.raises(LibraryError, match=r"m01: .*'spectra' lacks its chunk c\.0\.0\.0\.0\.0"):
        library.read("m01")


def test_an_unknown_material_is_a_usage_error(library: Library) -> None:
    for call in (library.read, library.attributes):
        with pytest.raises(
            UsageError, match=r"felt: no such material in library\.zarr, which holds 3 materials; among them"
        ):
            call("felt")  # type: ignore[operator]


# The store as others see it


@pytest.mark.parametrize(
    ("chunks", "shards", "is_compressed"),
    [
        (None, None, False), (None, None, True), ((1, 2, 3), None, False), ((1, 2, 3), None, True),
        ((1, 2, 3), (3, 4, 6), False), ((4, 5, 7), (4, 5, 7), False),
    ],
)  # fmt: skip
@pytest.mark.parametrize("dtype", ["u1", "i4", "f2", "<f8"])
def test_arrays_are_read_as_zarr_reads_them(
    tmp_path: Path,
    dtype: str,
    chunks: tuple[int, ...] | None,
    shards: tuple[int, ...] | None,
    is_compressed: bool,
) -> None:
    values = np.arange(4 * 5 * 7).reshape(4, 5, 7).astype(dtype)
    layout.write_array(
        tmp_path / "a", layout.StoredArray(values, chunks, shards, is_compressed=is_compressed)
    )
    found = layout.read_array(Entry.of_folder(tmp_path), "a")
    by_zarr = np.asarray(zarr.open_array(tmp_path / "a", mode="r")[...])
    np.testing.assert_array_equal(found, by_zarr, strict=True)
    np.testing.assert_array_equal(found, values)
    assert found.flags.writeable
    assert found.flags.c_contiguous


@pytest.mark.parametrize("values", [np.float32(2.5), np.zeros((0, 3), np.int16)])
def test_numbers_and_empty_arrays_are_read(tmp_path: Path, values: np.ndarray) -> None:
    layout.write_array(tmp_path / "a", layout.StoredArray(np.asarray(values)))
    np.testing.assert_array_equal(
        layout.read_array(Entry.of_folder(tmp_path), "a"), np.asarray(values), strict=True
    )


@pytest.mark.parametrize("change", [-1, 1])
def test_shards_of_another_size_are_refused(library: Library, change: int) -> None:
    path = library.path / "materials" / "m01" / "spectra" / "c.0.0.0.0.0"
    content = path.read_bytes()
    path.write_bytes(content[:-1] if change < 0 else content + b"x")
    with pytest.raises(LibraryError, match=rf"has {len(content) + change} bytes, expected {len(content)}"):
        library.read("m01")


def test_zarr_alone_reads_the_store(library: Library, folder: Path) -> None:
    root = zarr.open_group(library.path, mode="r")
    file = read_bsdf(folder / "m02_spec.bsdf")
    spectra = root["materials/m02/spectra"]
    assert spectra.metadata.dimension_names == ("phi_i", "theta_i", "row", "column", "wavelengths")
    assert spectra.chunks == (1, 1, 4, 4, 35)
    np.testing.assert_array_equal(np.moveaxis(spectra[...], -1, 2), file.spectra)
    np.testing.assert_array_equal(root["materials/m02/ndf"][...], file.ndf)
    assert root["materials/m02/extra/1"].attrs["field"] == "path/../odd"
    assert sorted(root["materials"].group_keys()) == ["m00", "m01", "m02"]


def test_the_store_opens_in_xarray_with_coordinates(library: Library, folder: Path) -> None:
    xarray = pytest.importorskip("xarray")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", InconsistentFileWarning)  # values of samples are random
        data = xarray.open_zarr(library.path, group="materials/m00", consolidated=False, zarr_format=3)
    file = read_bsdf(folder / "m00_spec.bsdf")
    assert set(data.coords) == {"phi_i", "theta_i", "wavelengths"}
    assert data.wavelengths.attrs["units"] == "nm"
    found = data.spectra.isel(theta_i=1).sel(wavelengths=700, method="nearest")
    band = int(np.argmin(np.abs(WAVELENGTHS_NM - 700)))
    np.testing.assert_array_equal(found.values, file.spectra[:, 1, band])
    assert data.attrs["source_file"] == "m00_spec.bsdf"


def test_an_rgb_store_opens_in_xarray_with_channels(tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    import_files(tmp_path / "library.zarr", write_samples(tmp_path, 1, wavelengths_nm=None))
    data = xarray.open_zarr(
        tmp_path / "library.zarr", group="materials/m00", consolidated=False, zarr_format=3
    )
    assert data.spectra.dims == ("phi_i", "theta_i", "row", "column", "channel")
    assert data.spectra.attrs["channels"] == ["R", "G", "B"]


def test_an_inconsistent_file_is_imported_with_a_warning_once(tmp_path: Path) -> None:
    file = measured("syn_paper_white")
    write_bsdf(tmp_path / "paper_rgb.bsdf", file)
    write_bsdf(tmp_path / "scaled_rgb.bsdf", dataclasses.replace(file, spectra=file.spectra * 3.0))
    with pytest.warns(InconsistentFileWarning) as warned:
        result = import_files(tmp_path / "library.zarr", [tmp_path])
    (message,) = (str(warning.message) for warning in warned)
    assert message.startswith("scaled_rgb.bsdf: values are 3 times what the field 'luminance' implies")
    assert "\n" not in message
    assert result.imported == ("paper", "scaled")
    assert list(result.inconsistent) == [str(tmp_path / "scaled_rgb.bsdf")]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = import_files(tmp_path / "library.zarr", [tmp_path])
    assert again.skipped == ("paper", "scaled")
    assert again.inconsistent == {}


def test_no_zarr_warning_reaches_the_user(tmp_path: Path, folder: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", InconsistentFileWarning)  # values of samples are random
        import_files(tmp_path / "library.zarr", [folder])
        library = Library.open(tmp_path / "library.zarr")
        library.verify()
        library.cache_put("k", {"a": np.ones(2, np.float16), "b": np.array(b"text")[None].view(np.uint8)})
        assert library.cache_get("k") is not None
        assert library.bands.count == 70


@contextmanager
def without_write_permission(folder: Path) -> Iterator[None]:
    """Take write permission from a folder and all in it, and root's rights from this process."""
    for path in [folder, *folder.rglob("*")]:
        path.chmod(0o555 if path.is_dir() else 0o444)
    user = os.geteuid()
    if user == 0:
        os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(user)
        for path in [folder, *folder.rglob("*")]:
            path.chmod(0o777)


def test_a_library_that_cannot_be_written_opens_and_reads() -> None:
    home = Path(tempfile.mkdtemp())  # Not `tmp_path`: its parents are closed to other users.
    try:
        paths = write_samples(home / "files", 2)
        import_files(home / "library.zarr", paths[:1])
        expected = read_bsdf(paths[0])
        assert Library.open(home / "library.zarr").verify() == []  # Loads all modules while it may.
        with without_write_permission(home):
            library = Library.open(home / "library.zarr")
            assert_same(library.read("m00"), expected)
            assert library.verify() == []
            library.cache_put("gram", {"S": np.eye(2)})
            assert library.cache_get("gram") is None
            with pytest.raises(LibraryError, match=r"library\.zarr: cannot write in .* writable folder"):
                import_files(library.path, paths)
    finally:
        shutil.rmtree(home)


# What is no library


def test_a_missing_library_says_how_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(LibraryError, match="no such library; create one with `manifold import"):
        Library.open(tmp_path / "library.zarr")


@pytest.mark.parametrize(
    "content", [None, "not json", '{"zarr_format":2}', '{"zarr_format":3,"node_type":"group"}']
)
def test_another_folder_is_no_library(tmp_path: Path, content: str | None, folder: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    (other / "file").write_text("")
    if content is not None:
        (other / "zarr.json").write_text(content)
    with pytest.raises(LibraryError, match=r"other: .*not a library"):
        Library.open(other)
    with pytest.raises(LibraryError, match="other"):
        import_files(other, [folder])
    with pytest.raises(LibraryError, match="already exists"):
        Library.create(other, Bands(None))


# Importing


def test_importing_again_skips_what_is_there(library: Library, folder: Path) -> None:
    write_bsdf(folder / "new_spec.bsdf", sample_file("new", 9))
    before = {path: path.stat().st_mtime_ns for path in (library.path / "materials" / "m00").rglob("*")}
    seen: list[tuple[int, int, str]] = []
    with progress.listen(lambda *step: seen.append(step)):
        result = import_files(library.path, [folder])
    assert _outcomes(result) == (("new",), ("m00", "m01", "m02"), (), {})
    assert before == {
        path: path.stat().st_mtime_ns for path in (library.path / "materials" / "m00").rglob("*")
    }
    assert [done for done, _, _ in seen] == list(range(1, 9))
    assert {total for _, total, _ in seen} == {8}


def test_files_with_readings_in_a_folder_are_named_and_not_imported(tmp_path: Path) -> None:
    """They were skipped without a word."""
    files = tmp_path / "files"
    write_samples(files, 1)
    (files / "table.csv").write_text("theta_i,theta_o,phi_o,550nm\n45,0,0,0.1\n")
    (files / "broken.xlsx").write_text("no workbook")
    (files / "README.txt").write_text("A licence.\n")
    result = import_files(tmp_path / "library.zarr", [files])
    assert result.readings == (files / "broken.xlsx", files / "table.csv")
    assert (len(result.imported), result.failed) == (1, {})
    (only,) = files.glob("*.bsdf")
    assert import_files(tmp_path / "other.zarr", [only]).readings == ()
    only.unlink()
    said = "holds no .bsdf file; `manifold complete` reads the readings in broken.xlsx, table.csv"
    with pytest.raises(MissingFileError, match=said):
        import_files(tmp_path / "other.zarr", [files])


def test_folders_are_searched_at_every_depth_and_only_for_files(tmp_path: Path) -> None:
    write_samples(tmp_path / "files" / "deep" / "er", 2)
    (tmp_path / "files" / "folder_spec.bsdf").mkdir()
    (tmp_path / "files" / "dangling_spec.bsdf").symlink_to(tmp_path / "nowhere")
    assert import_files(tmp_path / "library.zarr", [tmp_path / "files"]).imported == ("m00", "m01")


@pytest.mark.parametrize("kind", ["empty folder", "missing"])
def test_a_source_without_files_is_a_usage_error(tmp_path: Path, kind: str) -> None:
    source = tmp_path / "source"
    if kind == "empty folder":
        source.mkdir()
    with pytest.raises(UsageError, match=r"source: (holds no \.bsdf file|no such file)"):
        import_files(tmp_path / "library.zarr", [source])
    assert not (tmp_path / "library.zarr").exists()


def test_one_bad_file_does_not_stop_the_others(tmp_path: Path, folder: Path) -> None:
    (folder / "bad_spec.bsdf").write_bytes(b"tensor_file\0\1\0")
    result = import_files(tmp_path / "library.zarr", [folder])
    assert result.imported == ("m00", "m01", "m02")
    assert list(result.failed) == [str(folder / "bad_spec.bsdf")]
    assert "bad_spec.bsdf" in result.failed[str(folder / "bad_spec.bsdf")]


def test_bad_files_alone_make_no_library(tmp_path: Path) -> None:
    (tmp_path / "bad_spec.bsdf").write_bytes(b"nothing")
    assert import_files(tmp_path / "library.zarr", [tmp_path]).failed
    assert not (tmp_path / "library.zarr").exists()
    assert beside(tmp_path / "library.zarr") == set()


def test_two_files_of_one_name_and_different_content_are_told_apart(tmp_path: Path, folder: Path) -> None:
    (folder / "z").mkdir()
    write_bsdf(folder / "z" / "m00_spec.bsdf", sample_file("m00", 9))
    shutil.copy(folder / "m01_spec.bsdf", folder / "z")
    result = import_files(tmp_path / "library.zarr", [folder])
    assert result.imported == ("m00", "m01", "m02")
    assert list(result.failed) == [str(folder / "z" / "m00_spec.bsdf")]
    assert_same(Library.open(tmp_path / "library.zarr").read("m00"), read_bsdf(folder / "m00_spec.bsdf"))


@pytest.mark.parametrize("other", [{"wavelengths_nm": None}, {"wavelengths_nm": WAVELENGTHS_NM + 1}])
def test_mixing_band_grids_is_refused_before_anything_is_written(
    tmp_path: Path, folder: Path, library: Library, other: dict
) -> None:
    stray = write_samples(tmp_path / "stray", 1, **other)[0]
    before = sorted(library.path.rglob("*"))
    with pytest.raises(
        BandMismatchError, match=rf"{stray.name}: found .*, expected 70 bands, .*library of its own"
    ):
        import_files(library.path, [stray])
    assert sorted(library.path.rglob("*")) == before
    with pytest.raises(BandMismatchError):
        import_files(tmp_path / "fresh.zarr", [folder, stray])
    assert not (tmp_path / "fresh.zarr").exists()


def test_other_content_under_a_name_needs_replace(library: Library, folder: Path) -> None:
    old = read_bsdf(folder / "m00_spec.bsdf")
    (folder / "m00_spec.bsdf").unlink()
    write_bsdf(folder / "m00_spec.bsdf", sample_file("m00", 99))
    refused = import_files(library.path, [folder])
    assert refused.skipped == ("m01", "m02")
    assert "'m00' is in the library with SHA-256" in refused.failed[str(folder / "m00_spec.bsdf")]
    assert_same(library.read("m00"), sample_file("m00", 0))
    replaced = import_files(library.path, [folder], replace=True)
    assert _outcomes(replaced) == ((), ("m01", "m02"), ("m00",), {})
    assert_same(library.read("m00"), sample_file("m00", 99))
    assert old.name == "m00"
    assert beside(library.path) == set()


@pytest.mark.parametrize("renames", [1, 2])
def test_a_replacement_cut_short_is_finished_by_importing_again(
    library: Library, folder: Path, forks: ForkServer, renames: int
) -> None:
    (folder / "m00_spec.bsdf").unlink()
    write_bsdf(folder / "m00_spec.bsdf", sample_file("m00", 99))
    script = f"""
import os, signal
from manifold.library.importing import import_files
rename, count = os.rename, 0
def killed(*paths):
    global count
    rename(*paths)
    count += 1
    if count == {renames}:
        os.kill(os.getpid(), signal.SIGKILL)
os.rename = killed
import_files({str(library.path)!r}, [{str(folder)!r}], replace=True)
"""
    forks.start(script)
    assert forks.wait() == [-signal.SIGKILL]
    opened = Library.open(library.path)
    seeds = {1: 0, 2: 99}  # moved away, the old one is there still
    for _ in range(2):  # now, and after another writer
        assert opened.names == ("m00", "m01", "m02")
        assert opened.verify() == []
        assert_same(opened.read("m00"), sample_file("m00", seeds[renames]))
        opened.cache_put("key", {"numbers": np.zeros(1)})
    assert beside(library.path) == set()
    import_files(library.path, [folder], replace=True)
    assert_same(opened.read("m00"), sample_file("m00", 99))
    assert beside(library.path) == set()


def test_a_second_writer_is_refused(library: Library, folder: Path) -> None:
    write_bsdf(folder / "new_spec.bsdf", sample_file("new", 9))
    with (
        staging.writing(library.path),
        pytest.raises(LibraryError, match=r"library\.zarr: another process is writing to it"),
    ):
        import_files(library.path, [folder])
    assert import_files(library.path, [folder]).imported == ("new",)


def test_two_imports_at_once_leave_a_sound_library(tmp_path: Path, forks: ForkServer) -> None:
    write_samples(tmp_path / "files", 30)
    forks.start(import_script(tmp_path), 3)
    ends = forks.wait()
    assert 0 in ends
    assert all("is writing to it" in forks.error(k) for k, end in enumerate(ends) if end)
    library = Library.open(tmp_path / "library.zarr")
    assert len(library) == 30
    assert library.verify() == []


def test_the_lock_file_outlives_its_writer(library: Library) -> None:
    """Removed, it could be locked by one that had opened it, and made anew and locked by another."""
    lock = library.path.with_name(f".{library.path.name}.lock")
    inode = lock.stat().st_ino
    with staging.writing(library.path):
        assert lock.stat().st_ino == inode
    assert lock.stat().st_ino == inode


def test_a_library_whose_materials_are_those_of_another_is_not_written_to(
    tmp_path: Path, library: Library, folder: Path
) -> None:
    other = Library.create(tmp_path / "other.zarr", library.bands).path
    shutil.rmtree(other / "materials")
    (other / "materials").symlink_to(library.path / "materials")
    with pytest.raises(LibraryError, match=r"other\.zarr/materials: a link to .*library\.zarr/materials"):
        import_files(other, [folder], replace=True)
    assert library.verify() == []


def test_a_link_that_is_replaced_leaves_what_it_leads_to(
    tmp_path: Path, library: Library, folder: Path
) -> None:
    other = Library.create(tmp_path / "other.zarr", library.bands)
    (other.path / "materials" / "m00").symlink_to(library.path / "materials" / "m00")
    (folder / "m00_spec.bsdf").unlink()
    write_bsdf(folder / "m00_spec.bsdf", sample_file("m00", 99))
    assert import_files(other.path, [folder], replace=True).replaced == ("m00",)
    assert_same(other.read("m00"), sample_file("m00", 99))
    assert_same(library.read("m00"), sample_file("m00", 0))
    assert beside(other.path) == set()


@pytest.mark.parametrize("field", ["theta_i_rad", "luminance"])
def test_shapes_that_disagree_are_refused_whatever_the_hash_says(library: Library, field: str) -> None:
    """Compiled code relies on them, and whoever writes a library can write the hash."""
    file = library.read("m00")
    values = getattr(file, field)
    forged = dataclasses.replace(file, **{field: np.concatenate([values, values[-1:]])})
    shutil.rmtree(library.path / "materials" / "m00")
    staging.write_material(library.path / "materials" / "m00", forged, "m00_spec.bsdf", "0" * 64)
    with pytest.raises(
        LibraryError, match=r"^m00: damaged in the library \(m00: field .* expected .*import its"
    ):
        library.read("m00")


def test_the_library_may_be_a_link(tmp_path: Path, folder: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    import_files(tmp_path / "elsewhere" / "real.zarr", [folder / "m00_spec.bsdf"])
    (tmp_path / "link.zarr").symlink_to(tmp_path / "elsewhere" / "real.zarr")
    import_files(tmp_path / "link.zarr", [folder])
    assert len(Library.open(tmp_path / "elsewhere" / "real.zarr")) == 3
    assert (tmp_path / "link.zarr").is_symlink()


# Killed at any moment


@pytest.fixture(scope="module")
def forks(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ForkServer]:
    """Processes that import."""
    with fork_server(tmp_path_factory.mktemp("forks")) as server:
        yield server


def import_script(home: Path) -> str:
    return f"""
from manifold.library.importing import import_files
import_files({str(home / "library.zarr")!r}, [{str(home / "files")!r}])
"""


def test_an_import_killed_at_any_moment_leaves_exactly_the_finished_materials(
    tmp_path: Path, rng: np.random.Generator, forks: ForkServer
) -> None:
    paths = write_samples(tmp_path / "files", 16)
    expected = {file.name: file for file in map(read_bsdf, paths)}
    library = tmp_path / "library.zarr"
    start = time.monotonic()
    forks.start(import_script(tmp_path))
    assert forks.wait() == [0]
    duration_s = time.monotonic() - start
    counts = []
    for moment in (np.arange(3) + rng.random(3)) / 3:  # One in each third of an uninterrupted run.
        shutil.rmtree(library)
        (child,) = forks.start(import_script(tmp_path))
        time.sleep(moment * duration_s)
        with suppress(ProcessLookupError):  # it has ended before
            os.kill(child, signal.SIGKILL)
        forks.wait()
        finished = names_of_whole_materials(library, expected)
        counts.append(len(finished))
        result = import_files(library, [tmp_path / "files"])
        assert result.skipped == finished
        assert len(result.imported) == 16 - len(finished)
        assert beside(library) == set()
    assert names_of_whole_materials(library, expected) == tuple(expected)
    assert any(0 < count < 16 for count in counts), counts


def names_of_whole_materials(library: Path, expected: dict[str, BsdfFile]) -> tuple[str, ...]:
    """The names in a library, after comparing each material with its file."""
    if not library.exists():  # Killed before the library itself was made.
        return ()
    opened = Library.open(library)
    for name in opened.names:
        assert_same(opened.read(name), expected[name])
    return opened.names


def test_a_full_disk_keeps_what_is_finished(
    library: Library, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_bsdf(folder / "n0_spec.bsdf", sample_file("n0", 9))
    write_bsdf(folder / "n1_spec.bsdf", sample_file("n1", 10))
    write = staging.write_array

    def full(folder: Path, *arguments: object, **named: object) -> None:
        if "n1" in folder.parts:
            raise OSError(28, "No space left on device")
        write(folder, *arguments, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(staging, "write_array", full)
    with pytest.raises(LibraryError, match=r"No space left on device.*import again"):
        import_files(library.path, [folder])
    assert "n1" not in library
    assert library.verify() == []
    assert beside(library.path) == set()


# Damage


def damage_chunk(group: Path) -> None:
    path = group / "spectra" / "c.0.0.0.0.0"
    content = bytearray(path.read_bytes())
    content[100] ^= 1
    path.write_bytes(content)


def damage_attribute(group: Path) -> None:
    path = group / "zarr.json"
    path.write_text(path.read_text().replace("naïve", "naive").replace("na\\u00efve", "naive"))


def truncate_chunk(group: Path) -> None:
    os.truncate(group / "ndf" / "c.0.0", 10)


@pytest.mark.parametrize(
    "damage",
    [
        damage_chunk,
        damage_attribute,
        truncate_chunk,
        lambda group: (group / "theta_i" / "c.0").unlink(),
        lambda group: (group / "vndf_difference" / "zarr.json").write_text("{"),
        lambda group: shutil.rmtree(group / "extra"),
        lambda group: (group / "zarr.json").unlink(),
    ],
    ids=["flipped bit", "attribute", "truncated", "missing chunk", "metadata", "extra", "group"],
)
def test_verify_finds_damage_and_names_the_material(
    library: Library, damage: Callable[[Path], object]
) -> None:
    damage(library.path / "materials" / "m01")
    seen: list[tuple[int, int, str]] = []
    with progress.listen(lambda *step: seen.append(step)):
        problems = library.verify()
    assert len(problems) == 1
    assert problems[0].startswith("m01: ")
    assert problems[0].endswith("materials/m01 and import its file again")
    assert seen == [(1, 3, "m00"), (2, 3, "m01"), (3, 3, "m02")]
    with pytest.raises(LibraryError, match=r"^m01: .*import its file again$"):
        library.read("m01")


# The cache


@pytest.fixture
def arrays(rng: np.random.Generator) -> dict[str, np.ndarray]:
    return {"S": rng.random((5, 5)), "count": np.array(3), "empty": np.zeros((0, 2))}


def test_the_cache_gives_back_what_was_put(library: Library, arrays: dict) -> None:
    assert library.cache_get("gram-1") is None
    library.cache_put("gram-1", arrays)
    found = Library.open(library.path).cache_get("gram-1")
    assert found is not None
    assert list(found) == list(arrays)
    for name, array in arrays.items():
        assert_same_array(found[name], array, name)
    library.cache_put("gram-1", {"S": np.zeros(1)})
    assert list(library.cache_get("gram-1") or {}) == ["S"]


def test_a_damaged_cache_entry_is_ignored(library: Library, arrays: dict) -> None:
    library.cache_put("gram-1", arrays)
    path = library.path / "cache" / "gram-1" / "S" / "c.0.0"
    path.write_bytes(bytes(200))
    assert library.cache_get("gram-1") is None


def test_the_cache_waits_for_nobody(library: Library, arrays: dict) -> None:
    with staging.writing(library.path):
        library.cache_put("gram-1", arrays)
    assert library.cache_get("gram-1") is None


@pytest.mark.parametrize("name", ["bad\udcff", "line\nbreak", "\x1b[31mred", "\u2028", ".hidden", "", "a/b"])
def test_names_that_cannot_be_written_out_are_no_names_of_materials(name: str) -> None:
    assert not is_material_name(name)
    assert is_material_name("naïve gold 2")


def test_a_library_may_be_a_mount_point(tmp_path, monkeypatch):
    """A container's volume: no rename crosses its border, and its folder cannot be replaced."""
    volume, rename, files = tmp_path / "volume", os.rename, tmp_path / "files"
    volume.mkdir()
    write_samples(files, 2)
    first, second = sorted(files.iterdir())

    def rename_within_a_device(source, target):
        if (volume in Path(source).parents) != (volume in Path(target).parents):
            raise OSError(errno.EXDEV, "Invalid cross-device link")
        rename(source, target)

    monkeypatch.setattr(os, "rename", rename_within_a_device)
    monkeypatch.setattr(os.path, "ismount", lambda path: Path(path) == volume)
    for file in (first, second):  # into an empty volume, and into one with a library
        assert len(import_files(volume, [file]).imported) == 1
    Library(volume).cache_put("key", {"numbers": np.arange(3.0)})  # as fits of models do
    np.testing.assert_array_equal(Library(volume).cache_get("key")["numbers"], np.arange(3.0))
    assert len(Library(volume)) == 2
    assert {path.name for path in volume.iterdir()} == {"zarr.json", "materials", "cache", ".volume.lock"}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["files", "volume"]


def test_a_rotation_is_stored_beside_the_file_as_it_was_measured(tmp_path: Path) -> None:
    paths = write_samples(tmp_path, 2, azimuths=9)
    path, plain = tmp_path / "library.zarr", tmp_path / "plain.zarr"
    import_files(plain, paths)
    import_files(path, paths, rotation_rad=0.5)
    library = Library(path)
    assert library.attributes("m00").rotation_rad == library.read("m00").rotation_rad == 0.5
    assert_same(dataclasses.replace(library.read("m00"), rotation_rad=0.0), read_bsdf(paths[0]))
    assert library.verify() == []
    assert library.content_hash != Library(plain).content_hash
    assert import_files(path, paths, rotation_rad=0.5, replace=True).skipped == ("m00", "m01")
    assert import_files(path, paths, rotation_rad=0.0, replace=True).replaced == ("m00", "m01")
    assert library.content_hash == Library(plain).content_hash


def test_isotropic_materials_have_no_rotation(tmp_path: Path) -> None:
    import_files(tmp_path / "library.zarr", write_samples(tmp_path, 1), rotation_rad=0.5)
    assert Library(tmp_path / "library.zarr").attributes("m00").rotation_rad == 0.0
