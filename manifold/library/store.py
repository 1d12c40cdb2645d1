"""The library: one zarr v3 store of RGL files, one group per material. This module alone imports zarr.

    library.zarr/             attributes: schema, schema_version, bands (wavelengths in nm, or "RGB")
      materials/NAME/         attributes of `MaterialInfo`, and one array per field of `BsdfFile`
        spectra               (phi_i, theta_i, row, column, band), one chunk per direction and band range
        extra/0, 1, ...       fields this package does not interpret; attribute `field` holds the name
      cache/KEY/              arrays that can be computed again

Written once, renamed into place when whole (`manifold.library.staging`), never changed. `docs/design/library.md` says
why the chunks are what they are, with the figures.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
import zarr
from zarr.codecs import BytesCodec
from zarr.storage import MemoryStore

from manifold.errors import LibraryError, ManifoldError, UsageError
from manifold.library import staging
from manifold.library.identity import (
    MaterialInfo,
    content_sha256,
    describe,
    hash_arrays,
    is_material_name,
    present_arrays,
)
from manifold.records import RGB_NAMES, Array, Bands, BsdfFile, Progress

T = TypeVar("T")

SCHEMA = "manifold-library"
SCHEMA_VERSION = 1
_TRIES = 50  # of reads that a replacement came in between
_PAUSE_S = 0.005
MAX_CHUNK_BANDS = 65  # 195 bands in three chunks of 266 kB per direction; measured in docs/design/library.md


# Field of BsdfFile -> (array name and dimension names in the store, units).
_FIELDS: dict[str, tuple[str, tuple[str, ...], str | None]] = {
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
class LibraryInfo:
    """What `manifold info` shows of a library.

    Attributes:
        path: the library's folder.
        schema_version: of the store.
        bands: the one band grid.
        content_hash: see `Library.content_hash`.
        bytes: of all materials' arrays together.
        materials: one entry per material, sorted by name.
    """

    path: Path
    schema_version: int
    bands: Bands
    content_hash: str
    bytes: int
    materials: tuple[MaterialInfo, ...]


class Library:
    """A library opened for reading; `import_files` in `manifold.library.importing` adds materials.

    Materials imported by another process while it is open are seen at once: nothing is remembered.
    """

    def __init__(self, path: Path, bands: Bands) -> None:
        """Use `open` or `create`."""
        self.path = path
        self.bands = bands

    @classmethod
    def open(cls, path: Path | str) -> Library:
        """Open a library for reading; a read-only folder will do.

        Raises:
            LibraryError: nothing there, no library of this package, another schema version, or damaged.
        """
        folder = staging.resolved(path)
        if folder.exists() and not folder.is_dir():
            raise LibraryError(f"{path}: a file, expected a library, which is a folder; name another path")
        if not folder.is_dir():
            raise LibraryError(f"{path}: no such library; `manifold import FILES --library {path}` makes one")
        staging.recover(folder)
        return cls(folder, _bands_of(_root_attributes(folder, path), path))

    @classmethod
    def create(cls, path: Path | str, bands: Bands) -> Library:
        """Make an empty library for materials of the given bands.

        Raises:
            LibraryError: something is there already, or the folder cannot be written.
        """
        folder = staging.resolved(path)
        folder.parent.mkdir(parents=True, exist_ok=True)
        with staging.writing(folder) as staged:
            _create(folder, bands, staged)
        return cls(folder, bands)

    @property
    def names(self) -> tuple[str, ...]:
        """The materials' names, sorted."""
        folder = self.path / "materials"
        try:
            found = [entry.name for entry in os.scandir(folder) if entry.is_dir()]
        except OSError as error:
            raise LibraryError(
                f"{self.path.name}: its folder 'materials' cannot be read ({error.strerror}); "
                "import its files again into a new library"
            ) from error
        return tuple(sorted(name for name in found if not name.startswith(".")))

    def __len__(self) -> int:
        return len(self.names)

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and is_material_name(name) and (self.path / "materials" / name).is_dir()

    def read(self, name: str) -> BsdfFile:
        """One whole material, equal to the imported file in every value, shape and dtype, which its hash proves.

        Returns:
            A record whose `spectra` (P, T, B, H, W) is a view: `np.moveaxis(spectra, 2, -1)` is C-contiguous.
        Raises:
            UsageError: no such material.
            LibraryError: the material is damaged.
        """
        return self._settled(name, lambda: self._read_checked(name))

    def _read_checked(self, name: str) -> BsdfFile:
        info, file = self._attributes(name), self._read(name)
        found = content_sha256(file, info.source_file, info.sha256)
        if found != info.content_sha256:
            raise LibraryError(
                f"{name}: content has SHA-256 {found[:12]}..., expected {info.content_sha256[:12]}...; "
                f"{self._repair(name)}"
            )
        return file

    def _settled(self, name: str, read: Callable[[], T]) -> T:
        """What `read` makes of a material, again where another process replaced it meanwhile.

        Files are opened one by one, so that a reader may meet some of the old material and some of the new.
        """
        for _ in range(_TRIES):
            before = self._folder_id(name)
            try:
                found = read()
            except ManifoldError:
                if not staging.is_replacing(self.path, name) and self._folder_id(name) == before:
                    raise
                time.sleep(_PAUSE_S)
            else:
                if self._folder_id(name) == before:
                    return found
        return read()

    def _folder_id(self, name: str) -> tuple[int, int] | None:
        """What tells a material's folder from the one that replaces it; None while there is none.

        Its number alone would not do: a file system gives that of a deleted folder to the next one.
        """
        try:
            status = os.stat(self.path / "materials" / name)
        except (OSError, ValueError):
            return None
        return status.st_ino, status.st_mtime_ns

    def _read(self, name: str) -> BsdfFile:
        with self._material(name) as group:
            attributes = _attributes(group)
            arrays = {
                field: _read(group, stored)
                for field, (stored, _, _) in _FIELDS.items()
                if field != "wavelengths_nm" or not self.bands.is_rgb
            }
            arrays["spectra"] = np.moveaxis(arrays["spectra"], -1, 2)
            return BsdfFile(
                name=name,
                description=str(attributes["description"]),
                version=tuple(attributes["pipeline_version"]),
                jacobian=bool(attributes["jacobian"]),
                extra=MappingProxyType(_read_extra(group)),
                **{"wavelengths_nm": None, **arrays},  # type: ignore[arg-type]
            )

    def read_spectra(
        self,
        name: str,
        *,
        theta_index: int | None = None,
        phi_index: int | None = None,
        bands: slice | None = None,
    ) -> Array:
        """A part of one material's spectra; only the chunks that hold it are read, so no hash proves it.

        Args:
            name: the material.
            theta_index: one incident elevation, or all.
            phi_index: one incident azimuth, or all.
            bands: a range of bands with step 1, or all.
        Returns:
            Shape (P, T, B, H, W), all five axes kept, band axis contiguous in memory.
        Raises:
            UsageError: no such material, index, or step.
            LibraryError: the material is damaged.
        """
        return self._settled(name, lambda: self._read_part(name, theta_index, phi_index, bands))

    def _read_part(
        self, name: str, theta_index: int | None, phi_index: int | None, bands: slice | None
    ) -> Array:
        with self._material(name) as group:
            shape = _array(group, "spectra").shape
            selection = (
                _one(phi_index, shape[0], f"{name}: phi_index"),
                _one(theta_index, shape[1], f"{name}: theta_index"),
                slice(0, shape[2]),
                slice(0, shape[3]),
                _band_range(bands, shape[4], name),
            )
            return np.moveaxis(_read(group, "spectra", selection), -1, 2)

    def attributes(self, name: str) -> MaterialInfo:
        """What is known of a material without reading its arrays.

        Raises:
            UsageError: no such material.
            LibraryError: the material is damaged.
        """
        return self._settled(name, lambda: self._attributes(name))

    def _attributes(self, name: str) -> MaterialInfo:
        with self._material(name) as group:
            values = _attributes(group)
            known = {field.name: values[field.name] for field in fields(MaterialInfo) if field.name != "name"}
            known["shape"] = tuple(known["shape"])
            known["pipeline_version"] = tuple(known["pipeline_version"])
            return MaterialInfo(name=name, **known)

    @property
    def content_hash(self) -> str:
        """SHA-256 over the bands and every name and file hash: how a model refers to its library."""
        digest = hashlib.sha256(json.dumps(self.bands.wavelengths_nm).encode())
        for name in self.names:
            digest.update(f"\n{name}\t{self.attributes(name).sha256}".encode())
        return digest.hexdigest()

    @property
    def info(self) -> LibraryInfo:
        """Everything but the arrays."""
        materials = tuple(self.attributes(name) for name in self.names)
        total = sum(material.bytes for material in materials)
        return LibraryInfo(self.path, SCHEMA_VERSION, self.bands, self.content_hash, total, materials)

    def verify(self, callback: Progress | None = None) -> list[str]:
        """Read and hash every material again.

        Args:
            callback: called with (done, total, name) after each material.
        Returns:
            One line per damaged material, naming it; empty if all is well.
        """
        problems = []
        names = self.names
        for done, name in enumerate(names, start=1):
            try:
                self.read(name)
            except ManifoldError as error:
                problems.append(str(error))
            if callback:
                callback(done, len(names), name)
        return problems

    def cache_get(self, key: str) -> dict[str, Array] | None:
        """Arrays that `cache_put` stored under a key, or None if there are none or they are damaged."""
        folder = self.path / "cache" / _cache_key(key)
        if not folder.is_dir():
            return None
        try:
            group = _open_group(folder)
            attributes = _attributes(group)
            arrays = {name: _read(group, name) for name in attributes["names"]}
            return arrays if attributes["sha256"] == hash_arrays(arrays) else None
        except Exception:  # A cache never stops the work: whatever is wrong with it, compute again.
            return None

    def cache_put(self, key: str, arrays: Mapping[str, Array]) -> None:
        """Keep arrays under a key, in one step; without effect where the library cannot be written."""
        target = self.path / "cache" / _cache_key(key)
        try:
            with staging.writing(self.path) as staged:
                folder = staged / key
                _write_group(folder, {"names": list(arrays), "sha256": hash_arrays(arrays)})
                for name, array in arrays.items():
                    _write_array(folder / _cache_key(name), np.asarray(array), np.shape(array))
                if target.exists():
                    os.rename(target, staged / "old")
                staging.publish(folder, target)
        except (OSError, LibraryError):
            return

    @contextmanager
    def _material(self, name: str) -> Iterator[zarr.Group]:
        """The material's group; whatever goes wrong with it becomes one LibraryError that names it."""
        if name not in self:
            raise UsageError(
                f"{name}: no such material in {self.path.name}, which holds {len(self)} materials"
            )
        try:
            yield _open_group(self.path / "materials" / name)
        except ManifoldError:
            raise
        except Exception as error:  # zarr lets many kinds through: OSError, ValueError, KeyError, JSON errors
            raise LibraryError(
                f"{name}: damaged in the library ({_first_line(error)}); {self._repair(name)}"
            ) from error

    def _repair(self, name: str) -> str:
        return f"delete {self.path / 'materials' / name} and import its file again"


def write_material(folder: Path, file: BsdfFile, source_file: str, sha256: str) -> None:
    """Write a material's group into a folder that does not exist yet (it is published by a rename).

    Args:
        folder: the group's folder.
        file: what to store.
        source_file: name of the imported file.
        sha256: of the imported file, in hexadecimal.
    """
    info = describe(file, source_file, sha256)
    _write_group(folder, asdict(info) | {"jacobian": bool(file.jacobian)})
    for name, array in present_arrays(file).items():
        _write_field(folder, name, array, file.bands)
    if file.extra:
        _write_group(folder / "extra", {})
        for number, (name, array) in enumerate(file.extra.items()):
            _write_array(folder / "extra" / str(number), array, array.shape, attributes={"field": name})


def open_or_create(path: Path, bands: Bands, staged: Path) -> Library:
    """The library at a resolved path, made if there is none; the caller holds its write lock.

    Raises:
        LibraryError: what is there is not a library.
    """
    if not path.exists():
        _create(path, bands, staged)
    return Library(path, _bands_of(_root_attributes(path, path), path))


def _create(folder: Path, bands: Bands, staged: Path) -> None:
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise LibraryError(f"{folder}: exists already; choose a path where there is nothing yet")
    root = staged / "library"
    wavelengths = bands.wavelengths_nm
    _write_group(
        root,
        {
            "schema": SCHEMA,
            "schema_version": SCHEMA_VERSION,
            "bands": "RGB" if wavelengths is None else list(wavelengths),
        },
    )
    _write_group(root / "materials", {})
    _write_group(root / "cache", {})
    staging.publish(root, folder)


def _root_attributes(folder: Path, shown: Path | str) -> dict[str, Any]:
    try:
        attributes = _attributes(_open_group(folder))
    except Exception as error:  # No zarr.json, no JSON, zarr version 2, no permission, ...
        found = f"its zarr.json cannot be used ({_first_line(error)})"
        if not (folder / "zarr.json").exists():
            found = "a folder without zarr.json"
        raise LibraryError(
            f"{shown}: not a library: {found}, expected a folder made by `manifold import`; name another path"
        ) from error
    if attributes.get("schema") != SCHEMA:
        raise LibraryError(f"{shown}: a zarr store, but not a library made by `manifold import`")
    if attributes.get("schema_version") != SCHEMA_VERSION:
        raise LibraryError(
            f"{shown}: schema version {attributes.get('schema_version')}, expected {SCHEMA_VERSION}; "
            "import its files again into a new library"
        )
    return attributes


def _bands_of(attributes: dict[str, Any], shown: Path | str) -> Bands:
    stored = attributes.get("bands")
    if stored == "RGB":
        return Bands(None)
    if isinstance(stored, list) and stored and all(isinstance(w, int | float) for w in stored):
        return Bands(tuple(float(w) for w in stored))
    raise LibraryError(f"{shown}: attribute 'bands' is damaged; import its files again into a new library")


def _cache_key(key: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,127}", key):
        raise UsageError(f"{key!r} cannot be a cache key; use letters, digits, - and _")
    return key


def _one(index: int | None, count: int, where: str) -> slice:
    if index is None:
        return slice(0, count)
    if not 0 <= index < count:
        raise UsageError(f"{where} is {index}, expected 0 to {count - 1}")
    return slice(index, index + 1)


def _band_range(bands: slice | None, count: int, where: str) -> slice:
    start, stop, step = (bands or slice(None)).indices(count)
    if step != 1 or start >= stop:
        raise UsageError(
            f"{where}: {bands} selects no range of the {count} bands; use a non-empty one with step 1"
        )
    return slice(start, stop)


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__


# Reading: through zarr, so that whatever zarr can decode can be read.


_SILENCE = threading.Lock()


@contextmanager
def _silence() -> Iterator[None]:
    """No warnings of zarr, one thread at a time: filters belong to the process, and restores that cross lose them."""
    with _SILENCE, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _open_group(folder: Path) -> zarr.Group:
    with _silence():
        return zarr.open_group(folder, mode="r", zarr_format=3, use_consolidated=False)


def _attributes(group: zarr.Group) -> dict[str, Any]:
    return dict(group.attrs)


def _array(group: zarr.Group, name: str) -> zarr.Array:
    array = group[name]
    if not isinstance(array, zarr.Array):
        raise LookupError(f"field '{name}' is no array")
    return array


def _read(group: zarr.Group, name: str, selection: tuple[slice, ...] | None = None) -> Array:
    """One array, or a part of it, C-contiguous in the axis order of the store."""
    array = _array(group, name)
    selection = selection or tuple(slice(0, size) for size in array.shape)
    _require_chunks(array, selection)
    return np.asarray(array[selection])


def _require_chunks(array: zarr.Array, selection: tuple[slice, ...]) -> None:
    """Zarr reads a chunk file that is gone as fill values, without a word: look first."""
    if 0 in array.shape:
        return
    folder = Path(array.store.root, array.path)  # type: ignore[attr-defined]
    ranges = [
        range(part.start // size, (part.stop - 1) // size + 1)
        for part, size in zip(selection, array.shards or array.chunks, strict=True)
    ]
    for key in _chunk_keys(ranges):
        if not (folder / key).exists():
            raise LookupError(f"field '{array.basename}' lacks its chunk {key}")


def _chunk_keys(ranges: list[range]) -> Iterator[str]:
    """File names of chunks: `c.0.1`, and `c` for an array without axes."""
    starts = [part.start for part in ranges]
    for index in np.ndindex(*(len(part) for part in ranges)):
        yield ".".join(["c", *(str(start + i) for start, i in zip(starts, index, strict=True))])


def _read_extra(group: zarr.Group) -> dict[str, Array]:
    if "extra" not in group:
        return {}
    extra = _open_group(Path(group.store.root, group.path, "extra"))  # type: ignore[attr-defined]
    count = sum(entry.is_dir() for entry in os.scandir(extra.store.root))  # type: ignore[attr-defined]
    return {str(extra[str(i)].attrs["field"]): _read(extra, str(i)) for i in range(count)}


# Writing: zarr composes the metadata and the index of a shard, once per kind of array; the chunks are plain
# bytes and need no codec. Written through zarr.Array, a material takes several times as long
# (docs/design/library.md).


def _write_field(folder: Path, field: str, array: Array, bands: Bands) -> None:
    stored, dims, units = _FIELDS[field]
    attributes: dict[str, Any] = {"units": units} if units else {}
    chunks, shards = array.shape, None
    if field in ("vndf", "luminance"):
        chunks = (1, *array.shape[1:])
    elif field == "spectra":
        array = np.moveaxis(array, 2, -1)  # (P, T, H, W, B), still the file's memory
        _, elevations, height, width, count = array.shape
        width_in_bands = _chunk_bands(count)
        chunks = (1, 1, height, width, width_in_bands)
        shards = (1, elevations, height, width, -(-count // width_in_bands) * width_in_bands)
        if bands.is_rgb:
            dims = (*dims[:-1], "channel")
            attributes["channels"] = list(RGB_NAMES)
    elif field == "valid" and array.ndim != 1:
        dims = tuple(f"valid_{axis}" for axis in range(array.ndim))
    _write_array(folder / stored, array, chunks, shards=shards, dims=dims, attributes=attributes)


def _chunk_bands(count: int) -> int:
    """Bands per chunk: as even as can be, so that the last chunk is not padded more than needed."""
    chunks = -(-count // MAX_CHUNK_BANDS)
    return -(-count // chunks)


def _write_group(folder: Path, attributes: dict[str, Any]) -> None:
    folder.mkdir()
    metadata = json.loads(_empty_group_metadata()) | {"attributes": attributes}
    (folder / "zarr.json").write_text(json.dumps(metadata, indent=2), encoding="ascii")


def _write_array(
    folder: Path,
    array: Array,
    chunks: tuple[int, ...],
    *,
    shards: tuple[int, ...] | None = None,
    dims: tuple[str, ...] | None = None,
    attributes: dict[str, Any] | None = None,
) -> None:
    """Write a zarr array of little-endian chunks, one file per chunk, or per shard of several chunks."""
    array = np.asarray(array, dtype=array.dtype.newbyteorder("<"))
    chunks = tuple(max(1, size) for size in chunks)
    folder.mkdir()
    metadata = _array_metadata(
        array.shape, array.dtype.str, chunks, shards, dims, json.dumps(attributes or {})
    )
    (folder / "zarr.json").write_bytes(metadata)
    buffer = np.empty(chunks, array.dtype)  # One for all chunks: fresh memory costs more than the copy.
    order, index = _shard_layout(shards, chunks, array.dtype.str) if shards else ([()], b"")
    for part, key in _blocks(array, shards or chunks):
        with (folder / key).open("wb") as stream:
            for position in order:
                block = _block(part, position, chunks) if shards else part
                stream.write(_whole_chunk(block, buffer).data)
            stream.write(index)


def _blocks(array: Array, size: tuple[int, ...]) -> Iterator[tuple[Array, str]]:
    """The parts of an array on a grid, with their file names; those at the end may be smaller."""
    counts = [range(-(-axis // part)) for axis, part in zip(array.shape, size, strict=True)]
    for position, key in zip(np.ndindex(*map(len, counts)), _chunk_keys(counts), strict=True):
        yield _block(array, position, size), key


def _block(array: Array, position: tuple[int, ...], size: tuple[int, ...]) -> Array:
    return array[tuple(slice(i * part, (i + 1) * part) for i, part in zip(position, size, strict=True))]


def _whole_chunk(block: Array, buffer: Array) -> Array:
    """A block C-contiguous and of full size, as zarr stores it, in the buffer where it has to be copied."""
    if block.shape == buffer.shape and block.flags.c_contiguous:
        return block
    if block.shape != buffer.shape:
        buffer[...] = 0
    inside = buffer[tuple(slice(0, axis) for axis in block.shape)]
    for last in range(
        block.shape[-1]
    ):  # Reads each plane of a file in one go: 2.5 times as fast as one copy.
        inside[..., last] = block[..., last]
    return buffer


@lru_cache(maxsize=64)
def _shard_layout(
    shards: tuple[int, ...], chunks: tuple[int, ...], dtype: str
) -> tuple[list[tuple[int, ...]], bytes]:
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
    shape: tuple[int, ...],
    dtype: str,
    chunks: tuple[int, ...],
    shards: tuple[int, ...] | None,
    dims: tuple[str, ...] | None,
    attributes: str,
) -> bytes:
    memory: dict[str, Any] = {}
    _create_in_memory(memory, shape, dtype, chunks, shards, dims, json.loads(attributes))
    return memory["zarr.json"].to_bytes()


def _create_in_memory(
    memory: dict[str, Any],
    shape: tuple[int, ...],
    dtype: str,
    chunks: tuple[int, ...],
    shards: tuple[int, ...] | None,
    dims: tuple[str, ...] | None = None,
    attributes: dict[str, Any] | None = None,
) -> zarr.Array:
    with _silence():
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
