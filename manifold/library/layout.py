"""The layout of a library: one zarr v3 store of RGL files, one group per material.

    library.zarr/             attributes: schema, schema_version, bands (wavelengths in nm, or "RGB")
      materials/NAME/         attributes of `MaterialInfo`, and one array per field of `BsdfFile`
        spectra               (phi_i, theta_i, row, column, band), one chunk per direction and band range
        vndf_difference       from what `ndf` says, in units in the last place, see `manifold.library.visible_normals`;
                              libraries of schema 1 have `vndf` itself
        extra/0, 1, ...       fields this package does not interpret; attribute `field` holds the name
      materials/NAME/         of a compact material (`manifold.library.compact`):
        coefficients          (component, phi_i, theta_i, row, column)
        tables                everything else as bytes, as the attribute `tables` says
      cache/KEY/              arrays that can be computed again

`docs/explanation/storage-and-rendering.md` says why the chunks are what they are.

What zarr would trust in the files of others is checked first: sizes and codecs, and that no chunk is missing.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numcodecs.blosc import Blosc
from zarr.codecs import BloscCodec

from manifold.records import RGB_NAMES, AnyArray, Array, Bands

SCHEMA = "manifold-library"
SCHEMA_VERSION = 2
READABLE_VERSIONS = (1, 2)
VISIBLE_NORMALS, VNDF_DIFFERENCE = "visible_normals", "vndf_difference"
COEFFICIENTS, TABLES = "coefficients", "tables"
MAX_CHUNK_BANDS = 65  # 195 bands in three chunks of 266 kB per direction; fewer cost more than they save

# Field of BsdfFile, in the order in which they are hashed -> (array name and dimension names in the store, units).
FIELDS: dict[str, tuple[str, tuple[str, ...], str | None]] = {
    "phi_i_rad": ("phi_i", ("phi_i",), "rad"),
    "theta_i_rad": ("theta_i", ("theta_i",), "rad"),
    "wavelengths_nm": ("wavelengths", ("wavelengths",), "nm"),
    "sigma": ("sigma", ("sigma_row", "sigma_column"), None),
    "ndf": ("ndf", ("ndf_row", "ndf_column"), None),
    "vndf": ("vndf", ("phi_i", "theta_i", "vndf_row", "vndf_column"), None),
    "luminance": ("luminance", ("phi_i", "theta_i", "row", "column"), None),
    "spectra": ("spectra", ("phi_i", "theta_i", "row", "column", "wavelengths"), None),
    "valid": ("valid", ("valid_byte",), None),
}


@dataclass(frozen=True)
class StoredArray:
    """One array as it stands in the store.

    Attributes:
        values: in the axis order of the store.
        chunks: shape of a chunk, the whole array by default.
        shards: shape of what one file holds; None for one chunk per file.
        is_compressed: by zstd, losslessly.
    """

    values: AnyArray
    chunks: tuple[int, ...] | None = None
    shards: tuple[int, ...] | None = None
    dims: tuple[str, ...] | None = None
    attributes: dict[str, Any] = field(default_factory=dict)
    is_compressed: bool = False


def stored(name: str, values: Array, bands: Bands) -> StoredArray:
    """Return a field of `BsdfFile`, by its name there, as the store holds it."""
    _, dims, units = FIELDS[name]
    attributes: dict[str, Any] = {"units": units} if units else {}
    if name == "luminance":
        return StoredArray(values, (1, *values.shape[1:]), None, dims)
    if name == "valid" and values.ndim != 1:
        dims = tuple(f"valid_{axis}" for axis in range(values.ndim))
    if name != "spectra":
        return StoredArray(values, None, None, dims, attributes)
    values = np.moveaxis(values, 2, -1)  # (P, T, H, W, B), still the file's memory
    _, elevations, height, width, count = values.shape
    # As even as can be, so that the last chunk is not padded more than needed.
    n_ranges = -(-count // MAX_CHUNK_BANDS)
    n_bands = -(-count // n_ranges)
    if bands.is_rgb:
        dims = (*dims[:-1], "channel")
        attributes["channels"] = list(RGB_NAMES)
    chunks, shards = (1, 1, height, width, n_bands), (1, elevations, height, width, n_ranges * n_bands)
    return StoredArray(values, chunks, shards, dims, attributes)


def root_attributes(bands: Bands) -> dict[str, Any]:
    """Return the attributes of a new library."""
    wavelengths = "RGB" if bands.wavelengths_nm is None else list(bands.wavelengths_nm)
    return {"schema": SCHEMA, "schema_version": SCHEMA_VERSION, "bands": wavelengths}


_MOST_METADATA = 16 << 20  # bytes
_MOST_ARRAY = 4 << 30  # bytes
# By default every chunk of a shard is a task of its own, which takes several times as long.
zarr.config.set({"codec_pipeline.batch_size": 1024})
_PLAIN = (["BytesCodec"], ["ShardingCodec", "BytesCodec", "BytesCodec", "Crc32cCodec"])
_COMPRESSED = ["BytesCodec", "BloscCodec"]
_BLOSC_HEADER = 16  # bytes


def write_group(folder: Path, attributes: dict[str, Any]) -> None:
    """Make a folder that is a group."""
    zarr.create_group(folder, zarr_format=3, attributes=attributes)


def write_array(folder: Path, stored: StoredArray) -> None:
    """Make a folder that is an array of little-endian chunks, one file per chunk or shard."""
    values = np.asarray(stored.values, dtype=stored.values.dtype.newbyteorder("<"))
    array = zarr.create_array(
        folder,
        shape=values.shape,
        dtype=values.dtype,
        chunks=tuple(max(1, size) for size in stored.chunks or values.shape),
        shards=stored.shards,
        compressors=BloscCodec(typesize=4, cname="zstd", clevel=5, shuffle="bitshuffle")
        if stored.is_compressed
        else None,
        filters=None,
        # Dots, not folders in folders: on some file systems making a folder costs as much as a file.
        chunk_key_encoding={"name": "default", "separator": "."},
        fill_value=0,
        zarr_format=3,
        attributes=stored.attributes,
        dimension_names=stored.dims,
        config={"write_empty_chunks": True},
    )
    array[...] = values


def compressed_bytes(values: AnyArray) -> int:
    """Return the number of bytes of an array that is stored compressed."""
    return len(Blosc("zstd", clevel=5, shuffle=Blosc.BITSHUFFLE, typesize=4).encode(values))


def open_group(folder: Path) -> zarr.Group:
    """Open the group in a folder.

    zarr raises many kinds of errors: OSError, ValueError, KeyError, JSON errors.
    """
    _require_metadata(folder, "it lacks its zarr.json")
    return zarr.open_group(folder, mode="r", zarr_format=3, use_consolidated=False)


def read_attributes(folder: Path) -> dict[str, Any]:
    """Read the attributes of the group in a folder, without zarr, which takes thirty times as long."""
    _require_metadata(folder, "it lacks its zarr.json")
    found: dict[str, Any] = json.loads((folder / "zarr.json").read_bytes())["attributes"]
    return found


def read_array(group: zarr.Group, name: str) -> AnyArray:
    """Read one array, C-contiguous in the axis order of the store."""
    array = _array(group, name)
    _require_chunks(array)
    return np.asarray(array[:] if array.ndim else array[()])


def pack(tables: Mapping[str, AnyArray]) -> tuple[AnyArray, list[Any]]:
    """Join arrays into bytes (n,), and return name, dtype and shape of each, because few arrays read faster."""
    little = {name: np.asarray(array, array.dtype.newbyteorder("<")) for name, array in tables.items()}
    layout = [[name, array.dtype.str, list(array.shape)] for name, array in little.items()]
    return np.frombuffer(b"".join(array.tobytes() for array in little.values()), np.uint8), layout


def unpack(packed: AnyArray, layout: Any) -> dict[str, AnyArray]:
    """Restore the arrays from `pack`. Raises LookupError or ValueError if the layout does not fit the bytes."""
    tables, content, position = {}, packed.tobytes(), 0
    for name, kind, shape in layout:
        dtype = np.dtype(kind)
        if dtype.kind not in "iuf" or any(type(size) is not int or size < 0 for size in shape):
            raise LookupError(f"table '{name}' has dtype {kind} and shape {shape}, expected plain numbers")
        count = math.prod(shape)
        end = position + count * dtype.itemsize
        tables[str(name)] = np.frombuffer(content[position:end], dtype, count).reshape(shape)
        position = end
    return tables


def read_extra(group: zarr.Group) -> dict[str, Array]:
    """Read the fields of a material that this package does not interpret, by name."""
    folder = _folder(group) / "extra"
    if not folder.is_dir():
        return {}
    extra = open_group(folder)
    names = [str(i) for i in range(sum(entry.is_dir() for entry in os.scandir(folder)))]
    return {str(_array(extra, name).attrs["field"]): read_array(extra, name) for name in names}


def _array(group: zarr.Group, name: str) -> zarr.Array[Any]:
    """Return one of the group's arrays, after a check of its size and codecs."""
    _require_metadata(_folder(group) / name, f"it lacks its field '{name}'")
    array = group[name]
    if not isinstance(array, zarr.Array):
        raise LookupError(f"field '{name}' is no array")
    codecs: Any = getattr(array.metadata, "codecs", ())
    inner = [*getattr(codecs[0], "codecs", ()), *getattr(codecs[0], "index_codecs", ())] if codecs else []
    found = [type(codec).__name__ for codec in (*codecs, *inner)]
    if array.dtype.kind not in "iuf" or found not in (*_PLAIN, _COMPRESSED):
        raise LookupError(
            f"field '{name}' has dtype {array.dtype}, coded by {', '.join(found)}, expected plain numbers"
        )
    if array.nbytes > _MOST_ARRAY:
        raise LookupError(f"field '{name}' has {array.nbytes} bytes, expected at most {_MOST_ARRAY}")
    return array


def _require_chunks(array: zarr.Array[Any]) -> None:
    """Raise LookupError where a chunk is missing, which zarr would read as zeros."""
    if 0 in array.shape:
        return
    sizes = array.shards or array.chunks
    for index in np.ndindex(*(-(-n // size) for n, size in zip(array.shape, sizes, strict=True))):
        key = ".".join(["c", *map(str, index)])
        chunk = _folder(array) / key
        if not chunk.is_file():
            raise LookupError(f"field '{array.basename}' lacks its chunk {key}")
        if len(array.metadata.codecs) > 1:  # type: ignore[union-attr]
            _require_size(chunk, math.prod(array.chunks) * array.dtype.itemsize)


def _require_size(chunk: Path, expected: int) -> None:
    """Raise LookupError where a compressed chunk would expand to another size, for which memory would be taken."""
    with chunk.open("rb") as file:
        found = int.from_bytes(file.read(_BLOSC_HEADER)[4:8], "little")
    if found != expected:
        raise LookupError(
            f"chunk {chunk.name} of '{chunk.parent.name}' has {found} bytes, expected {expected}"
        )


def _require_metadata(folder: Path, lack: str) -> None:
    path = folder / "zarr.json"
    if not path.is_file():
        raise LookupError(lack)
    if path.stat().st_size > _MOST_METADATA:
        raise LookupError(f"{folder.name}/zarr.json has more than {_MOST_METADATA} bytes")


def _folder(node: zarr.Group | zarr.Array[Any]) -> Path:
    return Path(node.store.root, node.path)  # type: ignore[attr-defined]
