"""Writes folders of a library atomically: each is staged beside the library and renamed into place when complete.

Beside a library `NAME` lies the lock `.NAME.lock`, an empty file, and during writing the staging folder
`.NAME.importing-*`; the next writer removes staging folders that a killed process has left. If the library is a mount
point, both lie inside it, because a rename cannot cross file systems. While a folder is being replaced, the old one
is kept as `.NAME.replaced` beside it.
"""

from __future__ import annotations

import glob
import json
import os
import shutil
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from manifold.core import disk
from manifold.core.errors import LibraryError
from manifold.core.records import Bands, BsdfFile
from manifold.core.stores import CONSOLIDATED, MATERIALS, METADATA, Entry
from manifold.library import visible_normals
from manifold.library.compact import Compact
from manifold.library.identity import describe, present_arrays
from manifold.library.layout import (
    COEFFICIENTS,
    FIELDS,
    TABLES,
    VISIBLE_NORMALS,
    VNDF_DIFFERENCE,
    StoredArray,
    pack,
    root_attributes,
    stored,
    write_array,
    write_group,
)

_REPLACED = ".replaced"
_PARTS = ("materials", "cache")  # folders in which folders are replaced


@contextmanager
def writing(library: Path) -> Iterator[Path]:
    """Hold the write lock of a library, which may not exist yet, and yield an empty staging folder beside it."""
    from filelock import FileLock, Timeout  # what only reads does without

    prefix = f".{library.name}.importing-"
    home = library if os.path.ismount(library) else library.parent
    lock = FileLock(home / f".{library.name}.lock")
    disk.require_lockable(Path(lock.lock_file))
    try:
        home.mkdir(parents=True, exist_ok=True)
        lock.acquire(timeout=0.1)
        for name in _PARTS:
            require_no_link(library / name)
        for stale in home.glob(f"{glob.escape(prefix)}*"):
            shutil.rmtree(stale, ignore_errors=True)
        for name in _PARTS:
            for old in (library / name).glob(f".*{_REPLACED}"):
                _conclude(old.with_name(old.name[1 : -len(_REPLACED)]))
        staging = Path(tempfile.mkdtemp(prefix=prefix, dir=home))
    except Timeout:
        raise LibraryError(
            f"{library.name}: another process is writing to it; try again when it has ended"
        ) from None
    except OSError as error:
        raise LibraryError(
            f"{library.name}: cannot write in {home} ({error.strerror}); choose a writable folder"
        ) from error
    try:
        yield staging
    finally:
        shutil.rmtree(staging, ignore_errors=True)
        lock.release()  # the file stays: unlinked, it would be locked by some and made anew by others


def require_no_link(folder: Path) -> None:
    """Raise LibraryError if a folder of a library is a link: writing would change another library without its lock."""
    if folder.is_symlink():
        raise LibraryError(
            f"{folder}: a link to {os.path.realpath(folder)}, expected a folder of the library's own; "
            "remove the link, and import the files"
        )


def contents(library: Path) -> list[Path]:
    """Return the paths in a folder, without the lock and the staging folder."""
    return [path for path in library.iterdir() if not path.name.startswith(f".{library.name}.")]


def supplant(staged: Path, target: Path) -> None:
    """Replace a group by a finished group with other array names; one of the two always exists.

    A killed process may leave arrays of the other group, which `keep_arrays` removes.
    """
    for path in staged.rglob("*"):
        if path.is_file():
            with path.open("rb") as written:
                os.fsync(written.fileno())
    arrays = [path for path in staged.iterdir() if path.is_dir()]
    for path in arrays:
        shutil.rmtree(target / path.name, ignore_errors=True)
        os.rename(path, target / path.name)
    os.replace(staged / "zarr.json", target / "zarr.json")
    keep_arrays(target, {path.name for path in arrays})


def keep_arrays(group: Path, names: Collection[str]) -> None:
    """Remove all arrays of a group except the named ones."""
    for path in group.iterdir():
        if path.is_dir() and path.name not in names:
            shutil.rmtree(path)


def publish(staged: Path, target: Path) -> None:
    """Rename a finished staged folder to its final name, replacing an existing folder.

    If the process is killed in between, `standing` finds the old folder, and the next writer moves it back.
    """
    if target.exists():
        os.rename(target, _replaced(target))
    os.rename(staged, target)
    _conclude(target)


def standing(folder: Entry, name: str) -> Entry:
    """Return the current path of a folder's subfolder; during a replacement this is the backup beside it."""
    target, replaced = folder / name, folder / f".{name}{_REPLACED}"
    return replaced if not target.is_folder and replaced.is_folder else target


def standing_names(folder: Entry) -> set[str]:
    """Return the names of a folder's subfolders, including those that are being replaced."""
    found = folder.folders
    replaced = {
        name[1 : -len(_REPLACED)] for name in found if name.startswith(".") and name.endswith(_REPLACED)
    }
    return {name for name in found | replaced if name and not name.startswith(".")}


def _replaced(target: Path) -> Path:
    return target.with_name(f".{target.name}{_REPLACED}")


def _conclude(target: Path) -> None:
    """End a replacement: remove the old folder, or put it back if there is no new one."""
    old = _replaced(target)
    if not target.exists():
        os.rename(old, target)
    elif old.is_symlink():
        old.unlink()
    else:
        shutil.rmtree(old, ignore_errors=True)


def consolidate(library: Path) -> None:
    """Write the metadata of all materials into their parent group, so that reading over HTTP takes few requests."""
    group = library / MATERIALS
    parts = {file: file.parent.relative_to(group).parts for file in sorted(group.rglob(METADATA))}
    below = {
        "/".join(names): json.loads(file.read_bytes())
        for file, names in parts.items()
        if names and not names[0].startswith(".")  # which are being replaced
    }
    own = json.loads((group / METADATA).read_bytes())
    own[CONSOLIDATED] = {"kind": "inline", "must_understand": False, "metadata": below}
    disk.write_bytes(group / METADATA, json.dumps(own).encode())


def make_store(folder: Path, bands: Bands, staged: Path) -> None:
    """Make an empty library; the caller holds its write lock and provides a staging folder."""
    if folder.exists() and (not folder.is_dir() or contents(folder)):
        raise LibraryError(f"{folder}: already exists; choose a new path")
    root = staged / "library"
    write_group(root, root_attributes(bands))
    write_group(root / "materials", {})
    write_group(root / "cache", {})
    if os.path.ismount(folder):  # which cannot be replaced
        for path in sorted(root.iterdir()):  # zarr.json, which makes it a library, comes last
            os.rename(path, folder / path.name)
    else:
        publish(root, folder)


def write_material(
    folder: Path, file: BsdfFile, source_file: str, sha256: str, compact: Compact | None = None
) -> None:
    """Write a material's group into a new folder; `publish` later renames it into place.

    `source_file` and `sha256` are the name and hash of the imported file. If `compact` is None, the file is stored
    unchanged.
    """
    attributes: dict[str, Any] = {"jacobian": bool(file.jacobian)}
    if compact is not None:
        info = describe(file, source_file, sha256, (compact.arrays, compact.accuracy))
        tables, layout = pack(compact.tables)
        write_group(folder, asdict(info) | attributes | {TABLES: layout})
        axes = ("component", "phi_i", "theta_i", "row", "column")
        write_array(folder / COEFFICIENTS, StoredArray(compact.coefficients, dims=axes, is_compressed=True))
        write_array(folder / TABLES, StoredArray(tables, is_compressed=True))
        return
    info = describe(file, source_file, sha256)
    difference, slices = visible_normals.encode(file)
    write_group(folder, asdict(info) | attributes | {VISIBLE_NORMALS: slices.to_json()})
    chunks, dims = (1, *difference.shape[1:]), FIELDS["vndf"][1]
    write_array(folder / VNDF_DIFFERENCE, StoredArray(difference, chunks, None, dims, is_compressed=True))
    for name, array in present_arrays(file).items():
        if name == "vndf":
            continue
        write_array(folder / FIELDS[name][0], stored(name, array, file.bands))
    if file.extra:
        write_group(folder / "extra", {})
        for number, (name, array) in enumerate(file.extra.items()):
            write_array(folder / "extra" / str(number), StoredArray(array, attributes={"field": name}))
