"""The layout of a library: one zarr v3 store of RGL files, one group per material.

    library.zarr/             attributes: schema, schema_version, bands (wavelengths in nm, or "RGB")
      materials/NAME/         attributes of `MaterialInfo`, and one array per field of `BsdfFile`
        spectra               (phi_i, theta_i, row, column, band), one chunk per direction and band range
        vndf_difference       `vndf` less its value computed from `ndf`, in units in the last place, see
                                `manifold.library.visible_normals`; libraries of schema 1 have `vndf` itself
        extra/0, 1, ...       fields this package does not interpret; attribute `field` holds the name
      materials/NAME/         of a compact material (`manifold.library.compact`):
        coefficients          (component, phi_i, theta_i, row, column)
        tables                everything else as bytes, as the attribute `tables` says
      cache/KEY/              arrays that can be computed again

`docs/explanation/storage-and-rendering.md` explains the choice of the chunks.

zarr writes the arrays. NumPy reads those layouts that this package writes, because importing zarr and reading with it
take longer than computing a prediction. Before reading, sizes and codecs are checked, and that no chunk is missing.
The metadata of `materials` include the metadata of all materials (zarr's consolidated metadata), for reading over
HTTP.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manifold.core.records import RGB_NAMES, AnyArray, Array, Bands
from manifold.core.stores import METADATA, Entry

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
    """One array of the zarr store.

    Attributes:
        values: the values, in the axis order of the store.
        chunks: shape of a chunk; the whole array by default.
        shards: shape of the part that one file holds; None for one chunk per file.
        is_compressed: whether zstd compresses the array, losslessly.
    """

    values: AnyArray
    chunks: tuple[int, ...] | None = None
    shards: tuple[int, ...] | None = None
    dims: tuple[str, ...] | None = None
    attributes: dict[str, Any] = field(default_factory=dict)
    is_compressed: bool = False


def stored(name: str, values: Array, bands: Bands) -> StoredArray:
    """Return the stored form of a field of `BsdfFile`, given its name and values."""
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
    """Return the zarr attributes of a new library with the given bands."""
    wavelengths = "RGB" if bands.wavelengths_nm is None else list(bands.wavelengths_nm)
    return {"schema": SCHEMA, "schema_version": SCHEMA_VERSION, "bands": wavelengths}


_MOST_METADATA = 16 << 20  # bytes
_MOST_ARRAY = 4 << 30  # bytes
_BLOSC_HEADER, _CHECKSUM = 16, 4  # bytes
_KINDS = frozenset(
    [f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)] + ["float16", "float32", "float64"]
)
_DOTS = {"name": "default", "configuration": {"separator": "."}}


def write_group(folder: Path, attributes: dict[str, Any]) -> None:
    """Write a folder that is a zarr group with these attributes."""
    import zarr

    zarr.create_group(folder, zarr_format=3, attributes=attributes)


def write_array(folder: Path, stored: StoredArray) -> None:
    """Write a folder that is a zarr array of little-endian chunks, one file per chunk or shard."""
    import zarr
    from zarr.codecs import BloscCodec

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
    # By default every chunk of a shard is a task of its own, which takes several times as long.
    with zarr.config.set({"codec_pipeline.batch_size": 1024}):
        array[...] = values


def compressed_bytes(values: AnyArray) -> int:
    """Return the number of bytes of an array that is stored compressed."""
    from numcodecs.blosc import Blosc

    return len(Blosc("zstd", clevel=5, shuffle=Blosc.BITSHUFFLE, typesize=4).encode(values))


def read_attributes(folder: Entry) -> dict[str, Any]:
    """Read the attributes of the group in a folder. Raises OSError, LookupError, TypeError or ValueError."""
    return dict(_metadata(folder, "group", "it lacks its zarr.json")["attributes"])


def read_array(group: Entry, name: str) -> AnyArray:
    """Read one array of a group; the result is writeable and C-contiguous in the axis order of the store.

    Raises OSError, LookupError, TypeError or ValueError.
    """
    metadata = _metadata(group / name, "array", f"it lacks its field '{name}'")
    return _Form.of(name, metadata).read(group / name)


def pack(tables: Mapping[str, AnyArray]) -> tuple[AnyArray, list[Any]]:
    """Join arrays into one byte array (n,), which reads faster; return it with the name, dtype and shape of each."""
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


def read_extra(group: Entry) -> dict[str, Array]:
    """Read the fields of a material that this package does not interpret, by name."""
    folder = group / "extra"
    if not folder.is_folder:
        return {}
    names = [str(i) for i in range(len(folder.folders))]
    fields = [_metadata(folder / name, "array", f"it lacks its field '{name}'") for name in names]
    return {
        str(metadata["attributes"]["field"]): read_array(folder, name)
        for name, metadata in zip(names, fields, strict=True)
    }


@dataclass(frozen=True)
class _Form:
    """How the files of an array hold it: plain, compressed, or as shards of plain chunks, all little-endian."""

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    file_shape: tuple[int, ...]
    chunk_shape: tuple[int, ...]
    is_compressed: bool
    is_sharded: bool

    @classmethod
    def of(cls, name: str, metadata: Mapping[str, Any]) -> _Form:
        """Return the form that metadata describe. Raises LookupError for those that are not written here."""
        kind, codecs = metadata["data_type"], metadata["codecs"]
        names = [codec["name"] for codec in codecs]
        file_shape = chunk_shape = metadata["chunk_grid"]["configuration"]["chunk_shape"]
        inner: list[Any] = []
        if names == ["sharding_indexed"]:
            sharding = codecs[0]["configuration"]
            chunk_shape, inner = sharding["chunk_shape"], [*sharding["codecs"], *sharding["index_codecs"]]
            names += [codec["name"] for codec in inner] + [sharding.get("index_location", "end")]
        orders = [codec.get("configuration", {}).get("endian", "little") for codec in (*codecs, *inner)]
        is_known = names in (
            ["bytes"],
            ["bytes", "blosc"],
            ["sharding_indexed", "bytes", "bytes", "crc32c", "end"],
        )
        if kind not in _KINDS or not is_known or {*orders} != {"little"}:
            raise LookupError(
                f"field '{name}' has dtype {kind}, coded by {', '.join(map(str, names))}, expected plain numbers"
            )
        form = cls(
            name, _sizes(metadata["shape"]), np.dtype(kind).newbyteorder("<"), _sizes(file_shape), _sizes(chunk_shape),
            names[-1] == "blosc", bool(inner),
        )  # fmt: skip
        if metadata["chunk_key_encoding"] != _DOTS or metadata.get("storage_transformers"):
            raise LookupError(f"field '{name}' has other names of chunks than c.0.0")
        if not len(form.shape) == len(form.file_shape) == len(form.chunk_shape) or 0 in form.chunk_shape:
            raise LookupError(f"field '{name}' has chunks that do not fit its shape")
        if any(whole % part for whole, part in zip(form.file_shape, form.chunk_shape, strict=True)):
            raise LookupError(f"field '{name}' has shards that are not made of whole chunks")
        for shape in (form.shape, form.file_shape):
            if (size := math.prod(shape) * form.dtype.itemsize) > _MOST_ARRAY:
                raise LookupError(f"field '{name}' has {size} bytes, expected at most {_MOST_ARRAY}")
        return form

    def read(self, folder: Entry) -> AnyArray:
        """Return the array; no memory is taken before all files are known to have its size."""
        if 0 in self.shape:
            return np.empty(self.shape, self.dtype)
        files = []
        for index in np.ndindex(*_grid(self.shape, self.file_shape)):
            file = folder / ".".join(["c", *map(str, index)])
            start = tuple(k * size for k, size in zip(index, self.file_shape, strict=True))
            within = (min(n - a, size) for n, a, size in zip(self.shape, start, self.file_shape, strict=True))
            chunks = _grid(tuple(within), self.chunk_shape)  # the others of a shard lie outside the array
            self._require_size(file, math.prod(chunks))
            files.append((start, chunks, file))
        if self.chunk_shape == self.shape and not self.is_sharded:
            return self._chunk(file.read())
        values = np.empty(self.shape, self.dtype)
        for start, chunks, file in files:
            for inner, chunk in self._chunks(file.read(), chunks):
                first = [a + k * size for a, k, size in zip(start, inner, self.chunk_shape, strict=True)]
                here = values[
                    tuple(slice(a, a + size) for a, size in zip(first, self.chunk_shape, strict=True))
                ]
                here[...] = chunk[tuple(slice(size) for size in here.shape)]
        return values

    def _chunks(
        self, content: NDArray[np.uint8], chunks: tuple[int, ...]
    ) -> Iterator[tuple[tuple[int, ...], AnyArray]]:
        """Yield the chunks of a file, with their indices in it. A shard ends with an index and its checksum."""
        if not self.is_sharded:
            yield (0,) * len(self.shape), self._chunk(content)
            return
        grid = _grid(self.file_shape, self.chunk_shape)
        places = content[-self._index_bytes : -_CHECKSUM].view("<u8").reshape(*grid, 2)
        for index in np.ndindex(*chunks):
            offset, size = map(int, places[index])
            if size != self._bytes or offset + size > len(content):
                raise LookupError(f"field '{self.name}' lacks a chunk of a shard")
            yield index, self._chunk(content[offset : offset + size])

    def _chunk(self, content: NDArray[np.uint8]) -> AnyArray:
        if not self.is_compressed:
            return content.view(self.dtype).reshape(self.chunk_shape)
        from numcodecs.blosc import Blosc

        values = np.empty(self.chunk_shape, self.dtype)
        Blosc().decode(content, values)
        return values

    @property
    def _bytes(self) -> int:
        return math.prod(self.chunk_shape) * self.dtype.itemsize

    @property
    def _index_bytes(self) -> int:
        """Return the size of the index of a shard: an offset and a size of each chunk, and a checksum."""
        return 16 * math.prod(_grid(self.file_shape, self.chunk_shape)) + _CHECKSUM

    def _require_size(self, file: Entry, chunks: int) -> None:
        """Raise LookupError where a file is missing, which zarr would read as zeros, or has another size."""
        size, expected = file.size, self._bytes
        if size is None:
            raise LookupError(f"field '{self.name}' lacks its chunk {file.name}")
        if self.is_compressed:
            size = int.from_bytes(file.read(_BLOSC_HEADER)[4:8].tobytes(), "little")
        elif self.is_sharded:
            expected = chunks * self._bytes + self._index_bytes
        if size != expected:
            raise LookupError(f"chunk {file.name} of '{self.name}' has {size} bytes, expected {expected}")


def _sizes(values: Any) -> tuple[int, ...]:
    if not isinstance(values, list) or any(type(size) is not int or size < 0 for size in values):
        raise LookupError(f"found the shape {values!r:.80}, expected whole numbers")
    return tuple(values)


def _grid(shape: tuple[int, ...], parts: tuple[int, ...]) -> tuple[int, ...]:
    """Return how many parts a shape has along each axis."""
    return tuple(-(-n // size) for n, size in zip(shape, parts, strict=True))


def _metadata(folder: Entry, kind: str, lack: str) -> dict[str, Any]:
    """Return the metadata in `zarr.json` of a group or an array."""
    file = folder / METADATA
    if (size := file.size) is None:
        raise LookupError(lack)
    if size > _MOST_METADATA:
        raise LookupError(f"{folder.name}/{METADATA} has more than {_MOST_METADATA} bytes")
    metadata: dict[str, Any] = json.loads(file.read().tobytes())
    if metadata["zarr_format"] != 3 or metadata["node_type"] != kind:
        raise LookupError(f"{folder.name} is no {kind} of zarr version 3")
    return metadata
