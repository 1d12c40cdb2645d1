"""Writing groups and arrays: zarr composes the metadata and the index of a shard, the chunks are plain bytes.

Written through `zarr.Array`, an import takes 1.4 to 1.8 times as long (docs/design/library.md).
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from zarr.codecs import BytesCodec
from zarr.storage import MemoryStore

from manifold.errors import LibraryError
from manifold.library.schema import StoredArray
from manifold.library.zarr_reading import chunk_keys
from manifold.records import Array

Shape = tuple[int, ...]


def write_group(folder: Path, attributes: dict[str, Any]) -> None:
    """Make a folder that is a group."""
    folder.mkdir()
    metadata = json.loads(_empty_group_metadata()) | {"attributes": attributes}
    (folder / "zarr.json").write_text(json.dumps(metadata, indent=2), encoding="ascii")


def write_array(folder: Path, stored: StoredArray) -> None:
    """Make a folder that is an array of little-endian chunks, one file per chunk, or per shard of several chunks."""
    array = np.asarray(stored.values, dtype=stored.values.dtype.newbyteorder("<"))
    chunks = tuple(max(1, size) for size in stored.chunks or array.shape)
    shards, dtype = stored.shards, array.dtype.str
    folder.mkdir()
    metadata = _array_metadata(array.shape, dtype, chunks, shards, stored.dims, json.dumps(stored.attributes))
    (folder / "zarr.json").write_bytes(metadata)
    buffer = np.empty(chunks, array.dtype)  # One for all chunks: fresh memory costs more than the copy.
    order, index = _shard_layout(shards, chunks, dtype) if shards else ([()], b"")
    for part, key in _blocks(array, shards or chunks):
        with (folder / key).open("wb") as stream:
            for position in order:
                block = _block(part, position, chunks) if shards else part
                stream.write(_whole_chunk(block, buffer).data)
            stream.write(index)


def _blocks(array: Array, size: Shape) -> Iterator[tuple[Array, str]]:
    """The parts of an array on a grid, with their file names; those at the end may be smaller."""
    counts = [range(-(-axis // part)) for axis, part in zip(array.shape, size, strict=True)]
    for position, key in zip(np.ndindex(*map(len, counts)), chunk_keys(counts), strict=True):
        yield _block(array, position, size), key


def _block(array: Array, position: Shape, size: Shape) -> Array:
    return array[tuple(slice(i * part, (i + 1) * part) for i, part in zip(position, size, strict=True))]


def _whole_chunk(block: Array, buffer: Array) -> Array:
    """A block C-contiguous and of full size, as zarr stores it, in the buffer where it has to be copied."""
    if block.shape == buffer.shape and block.flags.c_contiguous:
        return block
    if block.shape != buffer.shape:
        buffer[...] = 0
    inside = buffer[tuple(slice(0, axis) for axis in block.shape)]
    for last in range(block.shape[-1]):  # Each plane of a file in one go: 2.5 times as fast as one copy.
        inside[..., last] = block[..., last]
    return buffer


@lru_cache(maxsize=64)
def _shard_layout(shards: Shape, chunks: Shape, dtype: str) -> tuple[list[Shape], bytes]:
    """In which order zarr puts the chunks of a shard, and the index that it writes behind them.

    Raises:
        LibraryError: a version of zarr that lays shards out differently.
    """
    memory: dict[str, Any] = {}
    array = _create_in_memory(memory, shards, dtype, chunks, shards)
    array[...] = np.ones(shards, dtype)
    stored = next(value for key, value in memory.items() if key.startswith("c")).to_bytes()
    grid = tuple(shard // chunk for shard, chunk in zip(shards, chunks, strict=True))
    size = math.prod(chunks) * np.dtype(dtype).itemsize
    index = stored[math.prod(grid) * size :]
    places = np.frombuffer(index, "<u8", 2 * math.prod(grid)).reshape(-1, 2)  # offset and length of each
    order = np.argsort(places[:, 0])
    if list(places[order, 0]) != [i * size for i in range(len(order))] or np.any(places[:, 1] != size):
        raise LibraryError(f"zarr {zarr.__version__} lays out shards in an unknown way; install zarr 3.1")
    return [tuple(int(i) for i in np.unravel_index(place, grid)) for place in order], index


@lru_cache(maxsize=256)
def _array_metadata(
    shape: Shape,
    dtype: str,
    chunks: Shape,
    shards: Shape | None,
    dims: tuple[str, ...] | None,
    attributes: str,
) -> bytes:
    memory: dict[str, Any] = {}
    _create_in_memory(memory, shape, dtype, chunks, shards, dims, json.loads(attributes))
    return memory["zarr.json"].to_bytes()


def _create_in_memory(
    memory: dict[str, Any],
    shape: Shape,
    dtype: str,
    chunks: Shape,
    shards: Shape | None,
    dims: tuple[str, ...] | None = None,
    attributes: dict[str, Any] | None = None,
) -> zarr.Array:
    return zarr.create_array(
        MemoryStore(memory),
        shape=shape,
        dtype=dtype,
        chunks=chunks,
        shards=shards,
        compressors=None,
        filters=None,
        serializer=BytesCodec(endian="little") if np.dtype(dtype).itemsize > 1 else "auto",
        # Dots, not folders in folders: on some file systems making a folder costs as much as a file.
        chunk_key_encoding={"name": "default", "separator": "."},
        fill_value=0,
        zarr_format=3,
        attributes=attributes,
        dimension_names=dims,
    )


@lru_cache(maxsize=1)
def _empty_group_metadata() -> bytes:
    memory: dict[str, Any] = {}
    zarr.create_group(MemoryStore(memory), zarr_format=3, attributes={})
    return memory["zarr.json"].to_bytes()
