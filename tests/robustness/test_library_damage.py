"""Libraries that somebody changed, or made to harm: refused in one line, or told apart."""

from __future__ import annotations

import json
import os
import re
import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest
import zarr
from helpers.sample_files import WAVELENGTHS_NM, sample_file, write_samples

from manifold.core.errors import LibraryError, UsageError
from manifold.io_rgl import write_bsdf
from manifold.library import store
from manifold.library.identity import require_material_name
from manifold.library.importing import import_files
from manifold.library.store import Library


@pytest.fixture
def library(tmp_path: Path) -> Library:
    """A library of two materials, m00 and m01."""
    import_files(tmp_path / "library.zarr", write_samples(tmp_path, 2))
    return Library.open(tmp_path / "library.zarr")


def _edit(path: Path, **changes: object) -> None:
    content = json.loads(path.read_text())
    content["attributes"] |= changes
    path.write_text(json.dumps(content))


def test_bands_that_were_changed_by_hand_are_found(library):
    _edit(library.path / "zarr.json", bands=[float(w) + 1.0 for w in WAVELENGTHS_NM])
    changed = Library.open(library.path)
    assert len(changed.verify()) == 2
    with pytest.raises(LibraryError, match=r"zarr\.json was changed"):
        changed.read("m00")


@pytest.mark.parametrize("bands", [[], [1.0, float("nan")], [2.0, 1.0], [10**400], "rgb", None, {}])
def test_bands_that_are_none_are_refused(library, bands):
    _edit(library.path / "zarr.json", bands=bands)
    with pytest.raises(LibraryError, match="'bands' is damaged"):
        Library.open(library.path)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("description", []), ("bytes", "many"), ("shape", None), ("shape", [1, 2]), ("pipeline_version", [[1]]),
        ("sha256", 7), ("is_synthetic", "no"), ("source_file", {}), ("bytes", 10**400), ("bytes", -1),
        ("shape", [1, 8, 10**400, 32, 32]),
    ],
)  # fmt: skip
def test_attributes_of_another_type_are_damage(library, key, value):
    _edit(library.path / "materials" / "m00" / "zarr.json", **{key: value})
    for look in (
        lambda: library.attributes("m00"),
        lambda: library.read("m00"),
        lambda: library.content_hash,
    ):
        with pytest.raises(LibraryError, match="m00"):
            look()


def _gzip(folder: Path) -> None:
    shutil.rmtree(folder)
    codec = zarr.codecs.GzipCodec()
    zarr.create_array(folder, shape=(10**6,), chunks=(10**6,), dtype="f4", compressors=codec)[:] = 0


def _words(folder: Path) -> None:
    shutil.rmtree(folder)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        zarr.create_array(folder, shape=(3,), dtype="str")[:] = "word"


def _huge(folder: Path) -> None:
    content = json.loads((folder / "zarr.json").read_text())
    content["shape"] = [1 << 40]
    content["chunk_grid"]["configuration"]["chunk_shape"] = [1 << 40]
    (folder / "zarr.json").write_text(json.dumps(content))
    with (folder / "c.0").open("wb") as stream:
        stream.truncate(4 << 40)


@pytest.mark.parametrize("harm", [_gzip, _words, _huge])
def test_arrays_that_announce_more_than_they_hold_are_refused_at_once(library, harm):
    harm(library.path / "materials" / "m00" / "theta_i")
    with pytest.raises(LibraryError, match="m00"):
        library.read("m00")


@pytest.mark.parametrize("part", ["codecs", "index_codecs"])
def test_compressed_chunks_of_a_shard_are_not_expanded(library, part):
    path = library.path / "materials" / "m00" / "spectra" / "zarr.json"
    content = json.loads(path.read_text())
    (shard,) = content["codecs"]
    shard["configuration"][part].append({"name": "zstd", "configuration": {"level": 0, "checksum": False}})
    path.write_text(json.dumps(content))
    with pytest.raises(LibraryError, match=r"zstd.*expected plain numbers"):
        library.read("m00")


def test_no_library_is_made_in_a_library(library, tmp_path):
    inside = library.path / "materials" / "new.zarr"
    for make in (lambda: import_files(inside, tmp_path), lambda: Library.create(inside, library.bands)):
        with pytest.raises(UsageError, match=rf"in the library {re.escape(str(library.path))}, "):
            make()
    assert library.names == ("m00", "m01")


@pytest.mark.parametrize(
    "name",
    [
        "a:b",
        "con",
        "COM1.x",
        "dot.",
        "space ",
        "a?b",
        'q"q',
        "back\\slash",
        "e\N{COMBINING ACUTE ACCENT}",
        "ä" * 101,
    ],
)
def test_names_that_other_systems_do_not_allow_are_refused(name):
    with pytest.raises(UsageError, match="on every system"):
        require_material_name(name)


def test_names_that_differ_by_case_only_are_not_imported_together(tmp_path):
    for name in ("new", "NEW"):
        (tmp_path / name).mkdir()
        write_bsdf(tmp_path / name / f"{name}_spec.bsdf", sample_file(name, 9))
    made = import_files(tmp_path / "library.zarr", [tmp_path / "new", tmp_path / "NEW"])
    assert made.imported == ("new",)
    assert list(made.failed) == [str(tmp_path / "NEW" / "NEW_spec.bsdf")]


def test_the_cache_forgets_what_was_used_longest_ago(library, monkeypatch):
    monkeypatch.setattr(store, "MOST_BYTES", 30_000)
    for key in ("a", "b", "c"):
        library.cache_put(key, {"x": np.zeros(1000)})
        os.utime(library.path / "cache" / key, (1.0 + ord(key), 1.0 + ord(key)))
    assert library.cache_get("a") is not None  # which is used now
    library.cache_put("d", {"x": np.zeros(1000)})
    assert {key for key in "abcd" if library.cache_get(key) is not None} == {"a", "c", "d"}
