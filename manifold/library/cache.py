"""Arrays that can be computed again, kept in a library beside its materials."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from manifold.errors import LibraryError
from manifold.library import staging
from manifold.library.identity import hash_arrays
from manifold.library.schema import StoredArray
from manifold.library.zarr_arrays import open_group, read_array, write_array, write_group
from manifold.records import Array

MOST_BYTES = 1 << 30
"""Of all entries of a library together; those that were used longest ago go first."""


def get(library: Path, key: str) -> dict[str, Array] | None:
    """Arrays that `put` stored under a key, or None if there are none or they are damaged."""
    folder = library / "cache" / key
    if not folder.is_dir():
        return None
    try:
        group = open_group(folder)
        attributes: dict[str, Any] = dict(group.attrs)
        arrays = {name: read_array(group, name) for name in attributes["names"]}
        if attributes["sha256"] != hash_arrays(arrays):
            return None
        with suppress(OSError):  # of another user, or on read-only media
            os.utime(folder)
        return arrays
    except Exception:  # A cache never stops the work: whatever is wrong with it, compute again.
        return None


def put(library: Path, key: str, arrays: Mapping[str, Array]) -> None:
    """Store arrays under a key, atomically; no effect if the library cannot be written.

    Args:
        library: its folder.
        key: letters, digits, - and _.
        arrays: by name.
    """
    target = library / "cache" / key
    try:
        with staging.writing(library) as staged:
            folder = staged / key
            write_group(folder, {"names": list(arrays), "sha256": hash_arrays(arrays)})
            for name, array in arrays.items():
                write_array(folder / name, StoredArray(np.asarray(array)))
            staging.publish(folder, target)
            _prune(target.parent)
    except (OSError, LibraryError):
        return


def _prune(folder: Path) -> None:
    """Remove the entries that were used longest ago, until the rest is no more than `MOST_BYTES`."""
    entries = sorted(
        ((entry.stat().st_mtime_ns, entry.path) for entry in os.scandir(folder) if entry.is_dir()),
        reverse=True,
    )
    total = 0
    for _, path in entries:
        total += sum(file.stat().st_size for file in Path(path).rglob("*") if file.is_file())
        if total > MOST_BYTES:
            shutil.rmtree(path, ignore_errors=True)
