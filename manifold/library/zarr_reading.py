"""Reading groups and arrays through zarr, after validating their declared sizes, which zarr trusts."""

from __future__ import annotations

import math
import os
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from manifold.records import Array

_MOST_METADATA = 16 << 20  # bytes
_MOST_ARRAY = 4 << 30  # bytes
# By default every chunk of a shard is a task of its own. zarr asks its configuration at every read, from any thread, so
# that it cannot be set for our arrays alone: other arrays of the process are read in such batches, too.
zarr.config.set({"codec_pipeline.batch_size": 1024})
_NUMBERS, _INDEX = (
    ["BytesCodec"],
    ["BytesCodec", "Crc32cCodec"],
)  # of this package: no few bytes stand for many


def open_group(folder: Path) -> zarr.Group:
    """The group in a folder; zarr raises many kinds of errors: OSError, ValueError, KeyError, JSON errors."""
    _require_file(folder / "zarr.json", 0, _MOST_METADATA, "it lacks its zarr.json")
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
    folder = Path(group.store.root, group.path, "extra")  # type: ignore[attr-defined]
    if not folder.is_dir():
        return {}
    extra = open_group(folder)
    names = [str(i) for i in range(sum(entry.is_dir() for entry in os.scandir(folder)))]
    return {str(_array(extra, name).attrs["field"]): read_array(extra, name) for name in names}


def chunk_keys(ranges: list[range]) -> Iterator[str]:
    """File names of chunks: `c.0.1`, and `c` for an array without axes."""
    starts = [part.start for part in ranges]
    for index in np.ndindex(*(len(part) for part in ranges)):
        yield ".".join(["c", *(str(start + i) for start, i in zip(starts, index, strict=True))])


def _array(group: zarr.Group, name: str) -> zarr.Array:
    """One of the group's arrays, whose size and codecs can be trusted.

    Raises:
        LookupError: there is none, or it is not as this package writes them.
    """
    folder = Path(group.store.root, group.path, name)  # type: ignore[attr-defined]
    _require_file(folder / "zarr.json", 0, _MOST_METADATA, f"it lacks its field '{name}'")
    array = group[name]
    if not isinstance(array, zarr.Array):
        raise LookupError(f"field '{name}' is no array")
    codecs: Any = getattr(array.metadata, "codecs", ())
    is_sharded = _names(codecs) == ["ShardingCodec"]
    inner = codecs[0].codecs if is_sharded else codecs
    index = _names(codecs[0].index_codecs) if is_sharded else _INDEX
    if array.dtype.kind not in "iuf" or _names(inner) != _NUMBERS or index != _INDEX:
        found = f"dtype {array.dtype}, coded by {', '.join([*_names(inner), *index * is_sharded])}"
        raise LookupError(f"field '{name}' has {found}, expected plain numbers")
    if array.nbytes > _MOST_ARRAY:
        raise LookupError(f"field '{name}' has {array.nbytes} bytes, expected at most {_MOST_ARRAY}")
    return array


def _names(codecs: Iterable[object]) -> list[str]:
    return [type(codec).__name__ for codec in codecs]


def _require_chunks(array: zarr.Array, selection: tuple[slice, ...]) -> None:
    """Zarr reads a chunk file that is gone as fill values, without a word, and waits for pipes: look first."""
    if 0 in array.shape:
        return
    folder = Path(array.store.root, array.path)  # type: ignore[attr-defined]
    size = array.shards or array.chunks
    ranges = [
        range(part.start // step, (part.stop - 1) // step + 1)
        for part, step in zip(selection, size, strict=True)
    ]
    least = math.prod(size) * array.dtype.itemsize
    most = (
        least + 16 * math.prod(size) // math.prod(array.chunks) + 4
    )  # the index of a shard, and its checksum
    for key in chunk_keys(ranges):
        _require_file(folder / key, least, most, f"field '{array.basename}' lacks its chunk {key}")


def _require_file(path: Path, least: int, most: int, lack: str) -> None:
    """Raise LookupError unless there is a regular file of a size between two; `lack` says what it is without."""
    try:
        status = path.stat()
    except OSError as error:
        reason = "" if isinstance(error, FileNotFoundError) else f" ({error.strerror})"
        raise LookupError(lack + reason) from error
    if not stat.S_ISREG(status.st_mode) or not least <= status.st_size <= most:
        found = f"{status.st_size} bytes" if stat.S_ISREG(status.st_mode) else "not a regular file"
        raise LookupError(f"{path.parent.name}/{path.name} has {found}, expected {least} to {most} bytes")
