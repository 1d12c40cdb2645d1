"""Libraries that somebody changed, or made to harm: refused in one line, or told apart."""

from __future__ import annotations

import errno
import json
import os
import re
import resource
import shutil
import threading
import warnings
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import zarr
from sample_files import WAVELENGTHS_NM, sample_file, write_samples

from manifold.errors import LibraryError, ManifoldError, UsageError
from manifold.io_rgl import write_bsdf
from manifold.library import cache
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
    for look in (lambda: library.info, lambda: library.read("m00"), lambda: library.content_hash):
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


def _pipe(folder: Path) -> None:
    (folder / "c.0").unlink()
    os.mkfifo(folder / "c.0")


def _endless(folder: Path) -> None:
    (folder / "zarr.json").unlink()
    (folder / "zarr.json").symlink_to("/dev/zero")


@pytest.mark.parametrize("harm", [_gzip, _words, _huge, _pipe, _endless])
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
    with pytest.raises(LibraryError, match=r"ZstdCodec.*expected plain numbers"):
        library.read("m00")


def test_no_library_is_made_in_a_library(library, tmp_path):
    inside = library.path / "materials" / "new.zarr"
    for make in (lambda: import_files(inside, tmp_path), lambda: Library.create(inside, library.bands)):
        with pytest.raises(UsageError, match=rf"in the library {re.escape(str(library.path))}, "):
            make()
    assert library.names == ("m00", "m01")


def test_a_path_that_cannot_be_resolved_is_one_error(library):
    for make in (Library.open, lambda path: Library.create(path, library.bands)):
        with pytest.raises(UsageError, match=r"~nobody_of_this_name/a.zarr: .*name another path"):
            make("~nobody_of_this_name/a.zarr")


@pytest.mark.parametrize("place", ["zarr.json", "extra/zarr.json", "extra/0/zarr.json", "extra/0/c.0"])
def test_pipes_in_place_of_files_are_not_waited_for(library, place):
    path = library.path / "materials" / "m00" / place
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(LibraryError, match="m00"):
        library.read("m00")


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


def test_names_that_differ_by_case_only_do_not_stand_side_by_side(library, tmp_path):
    for folder, name in (("a", "M00"), ("b", "new"), ("c", "NEW")):
        (tmp_path / folder).mkdir()
        write_bsdf(tmp_path / folder / f"{name}_spec.bsdf", sample_file(name, 9))
    made = import_files(library.path, [tmp_path / "a", tmp_path / "b", tmp_path / "c"])
    assert made.imported == ("new",)
    assert sorted(made.failed) == [
        str(tmp_path / "a" / "M00_spec.bsdf"),
        str(tmp_path / "c" / "NEW_spec.bsdf"),
    ]


def test_more_files_are_imported_than_may_be_open(tmp_path):
    paths = write_samples(tmp_path, 90)
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    used = len(os.listdir("/proc/self/fd"))
    resource.setrlimit(resource.RLIMIT_NOFILE, (used + 60, hard))
    try:
        made = import_files(tmp_path / "library.zarr", paths)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert not made.failed
    assert len(made.imported) == 90


def test_the_cache_forgets_what_was_used_longest_ago(library, monkeypatch):
    monkeypatch.setattr(cache, "MOST_BYTES", 30_000)
    for key in ("a", "b", "c"):
        library.cache_put(key, {"x": np.zeros(1000)})
        os.utime(library.path / "cache" / key, (1.0 + ord(key), 1.0 + ord(key)))
    assert library.cache_get("a") is not None  # which is used now
    library.cache_put("d", {"x": np.zeros(1000)})
    assert {key for key in "abcd" if library.cache_get(key) is not None} == {"a", "c", "d"}


def test_warnings_of_other_threads_are_kept_while_a_library_is_read(library):
    stop, lost = threading.Event(), []

    def watch() -> None:
        while not stop.is_set():
            if any(
                action == "ignore" and category is Warning for action, _, category, *_ in warnings.filters
            ):
                lost.append(True)

    watcher = threading.Thread(target=watch)
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        watcher.start()
        for _ in range(10):
            library.read("m00")
        stop.set()
        watcher.join()
    assert not lost


def test_a_planted_lock_file_does_not_lead_elsewhere(library, tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("mine")
    (tmp_path / ".library.zarr.lock").symlink_to(victim)
    with suppress(ManifoldError):
        import_files(library.path, write_samples(tmp_path / "more", 3))
    assert victim.read_text() == "mine"


def test_materials_are_on_the_disk_before_they_appear(tmp_path, monkeypatch):
    events, fsync, rename = [], os.fsync, os.rename
    monkeypatch.setattr(os, "fsync", lambda d: (events.append(os.readlink(f"/proc/self/fd/{d}")), fsync(d)))
    monkeypatch.setattr(os, "rename", lambda a, b: (events.append(("to", str(a), str(b))), rename(a, b)))
    path = tmp_path / "library.zarr"
    import_files(path, write_samples(tmp_path, 7))
    for name in Library.open(path).names:
        material = path / "materials" / name
        (at,) = [k for k, event in enumerate(events) if event[0] == "to" and event[2] == str(material)]
        expected = {str(Path(events[at][1]) / file.relative_to(material)) for file in material.rglob("*")}
        assert len(expected) > 10
        assert expected <= set(events[:at])
        assert str(path / "materials") in events[at:]


def test_a_disk_that_keeps_nothing_leaves_no_material(library, tmp_path, monkeypatch):
    def full(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    write_bsdf(tmp_path / "other.bsdf", sample_file("other", 9))
    monkeypatch.setattr(os, "fsync", full)
    with suppress(ManifoldError):
        report = import_files(library.path, [tmp_path / "other.bsdf"])
        assert "No space left" in str(report.failed)
    assert sorted(p.name for p in (library.path / "materials").iterdir()) == ["m00", "m01", "zarr.json"]
