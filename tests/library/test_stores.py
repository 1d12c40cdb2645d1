"""Libraries in folders, zip files and on the web, read through one interface: `manifold.core.stores`."""

from __future__ import annotations

import functools
import http.server
import json
import shutil
import threading
import zipfile
from pathlib import Path

import numpy as np
import pytest
import zarr
from helpers.sample_files import assert_same, write_samples

from manifold.core import stores
from manifold.core.errors import LibraryError, UsageError
from manifold.library.compacting import compact_library
from manifold.library.importing import import_files
from manifold.library.store import Library


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    """Keep the user's cache out of the tests."""
    monkeypatch.setattr("manifold.library.store.user_cache_path", lambda name: tmp_path / "user" / name)


@pytest.fixture(params=["as imported", "compact"])
def folder(tmp_path, request):
    """A library of two materials with unknown fields."""
    write_samples(tmp_path / "files", 2)
    path = tmp_path / "place" / "library.zarr"
    import_files(path, tmp_path / "files", tolerance=5.0 if request.param == "compact" else None)
    return path


def zipped(folder: Path, within: str = "") -> Path:
    """Zip a library, under a folder of the zip file."""
    target = folder.parents[1] / "library.zip"
    with zipfile.ZipFile(target, "w") as archive:
        for path in folder.rglob("*"):
            if path.is_file():
                archive.write(path, within + path.relative_to(folder).as_posix())
    return target


@pytest.fixture
def served(folder):
    """The address of the library, and the requests that its server has answered."""
    requests: list[str] = []

    class Handler(http.server.SimpleHTTPRequestHandler):
        def log_message(self, format, *arguments):
            requests.append(f"{self.command} {self.path}")

    server = http.server.ThreadingHTTPServer(
        ("127.0.0.1", 0), functools.partial(Handler, directory=str(folder.parent))
    )
    threading.Thread(target=server.serve_forever, daemon=True).start()
    stores.remote.cache_clear()
    yield f"http://127.0.0.1:{server.server_port}/{folder.name}", requests
    server.shutdown()
    server.server_close()


def assert_equal_libraries(one: Library, other: Library) -> None:
    assert (one.names, one.bands, one.content_hash) == (other.names, other.bands, other.content_hash)
    for name in one.names:
        assert one.attributes(name) == other.attributes(name)
        assert_same(one.read(name), other.read(name))
    assert other.verify() == []


@pytest.mark.parametrize("within", ["", "library.zarr/"])
def test_a_zipped_library_is_read_as_its_folder_is(folder, within):
    assert_equal_libraries(Library(folder), Library(zipped(folder, within)))


def test_a_library_over_http_is_read_as_its_folder_is(folder, served):
    assert_equal_libraries(Library(folder), Library(served[0]))
    assert_equal_libraries(
        Library(folder), Library(Path(served[0]))
    )  # as options have it, which drops a slash


def test_opening_a_library_over_http_takes_two_requests(served):
    address, requests = served
    library = Library(address)
    assert [library.attributes(name).name for name in library.names] == list(library.names)
    assert library.content_hash
    assert requests == [f"GET /library.zarr/{path}" for path in ("zarr.json", "materials/zarr.json")]


def test_each_file_is_fetched_once(folder, served):
    address, requests = served
    Library(address).read("m00")
    chunks = [
        path for path in (folder / "materials" / "m00").rglob("*") if path.is_file() and path.name[0] == "c"
    ]
    assert len(requests) == len(set(requests)) == 2 + len(chunks)


def test_a_missing_chunk_over_http_names_the_material(folder, served):
    chunk = next(path for path in (folder / "materials" / "m00").rglob("c.0*") if path.is_file())
    chunk.unlink()
    with pytest.raises(LibraryError, match=r"m00: damaged in the library .*lacks its chunk"):
        Library(served[0]).read("m00")


def test_a_zip_file_over_http_is_to_be_downloaded(served):
    with pytest.raises(LibraryError, match="download a zip file and name that"):
        Library(f"{served[0]}.zip")


def test_an_address_without_a_library_is_an_error_of_one_line(served):
    with pytest.raises(LibraryError, match=r"http://127.0.0.1:\d+/nothing: no library can be read there"):
        Library(served[0].replace("library.zarr", "nothing"))


def test_a_library_without_consolidated_metadata_says_how_to_get_them(folder, served):
    path = folder / "materials" / "zarr.json"
    group = json.loads(path.read_text())
    del group["consolidated_metadata"]
    path.write_text(json.dumps(group))
    with pytest.raises(LibraryError, match="import its files again where it is stored"):
        Library(served[0])


def test_consolidated_metadata_are_those_that_zarr_expects(folder, tmp_path):
    write_samples(tmp_path / "more", 3)
    import_files(folder, tmp_path / "more")
    compact_library(folder, 5.0)
    group = zarr.open_consolidated(folder / "materials")
    assert sorted(group.group_keys()) == ["m00", "m01", "m02"]
    stored = zarr.open_group(folder, use_consolidated=False)["materials"]
    for name in ("m00", "m02"):
        assert sorted(group[name].array_keys()) == sorted(stored[name].array_keys())
        assert dict(group[name].attrs) == dict(stored[name].attrs)


def test_the_metadata_of_a_library_do_not_grow_with_its_materials(folder, tmp_path):
    before = (folder / "zarr.json").read_bytes()
    write_samples(tmp_path / "more", 3)
    import_files(folder, tmp_path / "more")
    assert (folder / "zarr.json").read_bytes() == before


def test_what_is_only_read_is_cached_for_the_user(folder, tmp_path):
    library = Library(zipped(folder))
    before = sorted(tmp_path.glob("*"))
    library.cache_put("key", {"a": np.arange(3)})
    np.testing.assert_array_equal(Library(library.path).cache_get("key")["a"], np.arange(3))
    assert set(tmp_path.glob("*")) - set(before) == {tmp_path / "user"}


def test_a_zipped_library_brings_its_cache_along(folder):
    Library(folder).cache_put("key", {"a": np.arange(3)})
    path = zipped(folder)
    shutil.rmtree(folder)
    np.testing.assert_array_equal(Library(path).cache_get("key")["a"], np.arange(3))


@pytest.mark.parametrize("path", ["built-in", "https://example.org/library.zarr", None])
def test_writers_refuse_what_is_only_read(folder, tmp_path, path):
    path = path or zipped(folder)
    for write in (
        lambda: import_files(path, tmp_path / "files"),
        lambda: Library.create(path, Library(folder).bands),
    ):
        with pytest.raises(UsageError, match="is read only"):
            write()
    assert not Path("built-in").exists()


def test_the_built_in_and_zipped_libraries_are_not_compacted(folder):
    for path in ("built-in", zipped(folder)):
        with pytest.raises(UsageError, match="is read only"):
            compact_library(path)


@pytest.mark.parametrize(
    ("name", "content"), [("a.zip", b"PK\x05\x06" + bytes(18)), ("b.zip", b"PK\x03\x04 no directory")]
)
def test_another_zip_file_is_no_library(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(LibraryError, match=name):
        Library(tmp_path / name)


def test_addresses_are_told_from_paths():
    assert stores.address_of("https://example.org/a/library.zarr/") == "https://example.org/a/library.zarr"
    assert stores.address_of(Path("s3://bucket/library.zarr")) == "s3://bucket/library.zarr"
    assert stores.address_of(Path("c:/library.zarr")) is stores.address_of("satin:gold:0.5") is None
    assert stores.address_of(Path("folder/library.zarr")) is None
