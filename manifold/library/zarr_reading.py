"""Reading groups and arrays through zarr, so that whatever zarr can decode can be read."""

from __future__ import annotations

import os
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from manifold.records import Array

_SILENCE = threading.Lock()


@contextmanager
def silence() -> Iterator[None]:
    """No warnings of zarr, one thread at a time: filters belong to the process, and restores that cross lose them."""
    with _SILENCE, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def open_group(folder: Path) -> zarr.Group:
    """The group in a folder; zarr raises many kinds of errors: OSError, ValueError, KeyError, JSON errors."""
    with silence():
        return zarr.open_group(folder, mode="r", zarr_format=3, use_consolidated=False)


def attributes_of(group: zarr.Group) -> dict[str, Any]:
    """The group's attributes."""
    return dict(group.attrs)


def shape_of(group: zarr.Group, name: str) -> tuple[int, ...]:
    """Shape of one of the group's arrays."""
    return _array(group, name).shape


def read_array(group: zarr.Group, name: str, selection: tuple[slice, ...] | None = None) -> Array:
    """One array, or a part of it, C-contiguous in the axis order of the store."""
    array = _array(group, name)
    selection = selection or tuple(slice(0, size) for size in array.shape)
    _require_chunks(array, selection)
    return np.asarray(array[selection])


def read_extra(group: zarr.Group) -> dict[str, Array]:
    """The fields of a material that this package does not interpret, by name."""
    if "extra" not in group:
        return {}
    folder = Path(group.store.root, group.path, "extra")  # type: ignore[attr-defined]
    extra = open_group(folder)
    count = sum(entry.is_dir() for entry in os.scandir(folder))
    return {str(extra[str(i)].attrs["field"]): read_array(extra, str(i)) for i in range(count)}


def chunk_keys(ranges: list[range]) -> Iterator[str]:
    """File names of chunks: `c.0.1`, and `c` for an array without axes."""
    starts = [part.start for part in ranges]
    for index in np.ndindex(*(len(part) for part in ranges)):
        yield ".".join(["c", *(str(start + i) for start, i in zip(starts, index, strict=True))])


def _array(group: zarr.Group, name: str) -> zarr.Array:
    array = group[name]
    if not isinstance(array, zarr.Array):
        raise LookupError(f"field '{name}' is no array")
    return array


def _require_chunks(array: zarr.Array, selection: tuple[slice, ...]) -> None:
    """Zarr reads a chunk file that is gone as fill values, without a word: look first."""
    if 0 in array.shape:
        return
    folder = Path(array.store.root, array.path)  # type: ignore[attr-defined]
    ranges = [
        range(part.start // size, (part.stop - 1) // size + 1)
        for part, size in zip(selection, array.shards or array.chunks, strict=True)
    ]
    for key in chunk_keys(ranges):
        if not (folder / key).exists():
            raise LookupError(f"field '{array.basename}' lacks its chunk {key}")
