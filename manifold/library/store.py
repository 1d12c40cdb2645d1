"""The library: RGL files in one zarr store, opened for reading; its layout is in `manifold.library.layout`.

Every material is written once, renamed into place when complete (`manifold.library.staging`), and never changed.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from platformdirs import user_cache_path

from manifold.core import progress, shipped
from manifold.core.errors import (
    FileFormatError,
    LibraryError,
    ManifoldError,
    MissingLibraryError,
    ShapeError,
    UnknownNameError,
    UsageError,
)
from manifold.core.names import names_like
from manifold.core.records import AnyArray, Array, Bands, BsdfFile
from manifold.core.stores import METADATA, Entry, ZipStore, address_of, is_zip, remote
from manifold.io_rgl import require_sound
from manifold.library import compact, staging, visible_normals
from manifold.library.identity import (
    MaterialInfo,
    content_sha256,
    hash_arrays,
    info_of,
    is_material_name,
    require_outside_libraries,
)
from manifold.library.layout import (
    COEFFICIENTS,
    FIELDS,
    READABLE_VERSIONS,
    SCHEMA,
    TABLES,
    VISIBLE_NORMALS,
    VNDF_DIFFERENCE,
    StoredArray,
    read_array,
    read_attributes,
    read_extra,
    unpack,
    write_array,
    write_group,
)
from manifold.library.staging import make_store

MOST_BYTES = 1 << 30
"""Largest total size of a library's cache in bytes; the least recently used entries are removed first."""


def _prune(folder: Path) -> None:
    """Remove the least recently used entries until the rest takes at most `MOST_BYTES`."""
    entries = sorted(
        ((entry.stat().st_mtime_ns, entry.path) for entry in os.scandir(folder) if entry.is_dir()),
        reverse=True,
    )
    total = 0
    for _, path in entries:
        total += sum(file.stat().st_size for file in Path(path).rglob("*") if file.is_file())
        if total > MOST_BYTES:
            shutil.rmtree(path, ignore_errors=True)


class Library:
    """A library opened for reading; `import_files` in `manifold.library.importing` adds materials.

    Materials that another process imports into the folder are visible immediately, because nothing is cached.

    Attributes:
        path: path of the folder or zip file, `built-in`, or an address.
    """

    def __init__(self, path: Path | str) -> None:
        """Open a library for reading; write permission is not needed.

        Args:
            path: a folder, a zip file of one, `built-in`, or an address such as https://example.org/library.zarr.

        Raises:
            MissingLibraryError: nothing there.
            LibraryError: no library of this package, another schema version, or damaged.
            UsageError: the built-in library of another version.
            MissingPackageError: addresses need the extra `remote`.
        """
        self._root = _root(path)
        self.path = shipped.BUILT_IN if shipped.is_built_in(path) else shipped.resolved(path)
        self.schema_version, self.bands = _read_root(self._root, address_of(path) or path)

    def __reduce__(self) -> tuple[type[Library], tuple[str]]:
        return Library, (shipped.named(self.path),)

    def __repr__(self) -> str:
        try:
            held = f"{len(self)} materials"
        except LibraryError:
            held = "cannot be read"
        return f"<Library: {self.path.name}, {held}, {self.bands}>"

    @classmethod
    def open(cls, path: Path | str) -> Library:
        """Open a library for reading."""
        return cls(path)

    @classmethod
    def create(cls, path: Path | str, bands: Bands) -> Library:
        """Create an empty library for materials of the given bands.

        Raises:
            UsageError: the path lies in a library.
            LibraryError: the path exists already, or the folder cannot be written.
        """
        require_folder(path)
        folder = Path(path).expanduser().resolve()  # staging beside the library, not beside a link
        require_outside_libraries(folder)
        with staging.writing(folder) as staged:
            make_store(folder, bands, staged)
        return cls(folder)

    @property
    def folder(self) -> Path:
        """Return the folder of the library for writing. Raises UsageError for a read-only library."""
        require_folder(self.path)
        return self.path

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the materials, sorted."""
        try:
            return tuple(sorted(staging.standing_names(self._root / "materials")))
        except OSError as error:
            raise LibraryError(
                f"{self.path.name}: its folder 'materials' cannot be read ({error.strerror}); "
                "import its files again into a new library"
            ) from error

    def __len__(self) -> int:
        return len(self.names)

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and is_material_name(name) and self._folder(name).is_folder

    def read(self, name: str) -> BsdfFile:
        """Read one material and verify it by its hash.

        The record equals the imported file in every value, shape and dtype. A compact material differs from it;
        `attributes` holds its errors.

        Returns:
            A record whose `spectra` (P, T, B, H, W) is a view: `np.moveaxis(spectra, 2, -1)` is C-contiguous.

        Raises:
            UsageError: no such material.
            LibraryError: the material is damaged.
        """
        with self._named(name) as folder:
            info = info_of(name, read_attributes(folder))
            file, found = read_material(folder, info, is_rgb=self.bands.is_rgb)
            if found != info.content_sha256:
                raise LibraryError(
                    f"{name}: content has SHA-256 {found[:12]}..., expected {info.content_sha256[:12]}...; "
                    f"{self._repair(name)}"
                )
            require_sound(file)  # whoever writes a library can write the hash
        if file.bands != self.bands:  # those of the library stand in its root, which no hash covers
            raise LibraryError(
                f"{name}: has {file.bands}, but {self.path.name} says {self.bands}; its zarr.json was changed: "
                "import its files again into a new library"
            )
        return file

    def attributes(self, name: str) -> MaterialInfo:
        """Return the metadata of a material, without reading its arrays.

        Raises:
            UsageError: no such material.
            LibraryError: the material is damaged.
        """
        with self._named(name) as folder:
            return info_of(name, read_attributes(folder))

    @property
    def disk_bytes(self) -> int:
        """Return the size in bytes of the materials' files or of the zip file; 0 for a library at an address."""
        files = [shipped.LIBRARY_FILE] if self.path == shipped.BUILT_IN else [self.path]
        if self.path.is_dir():
            files = list((self.path / "materials").rglob("*"))
        return sum(path.stat().st_size for path in files if path.is_file())

    @property
    def content_hash(self) -> str:
        """Return the SHA-256 over bands, names, file hashes and rotations, by which a model identifies its library."""
        digest = hashlib.sha256(json.dumps(self.bands.wavelengths_nm).encode())
        for name in self.names:
            info = self.attributes(name)
            turned = f"\t{info.rotation_rad}" if info.rotation_rad else ""
            digest.update(f"\n{name}\t{info.sha256}{turned}".encode())
        return digest.hexdigest()

    def verify(self) -> list[str]:
        """Read and hash every material again.

        Returns:
            One line of text per damaged material, which names it; empty if every material is intact.
        """
        problems = []
        for name in progress.each(self.names, str):
            try:
                self.read(name)
            except ManifoldError as error:
                problems.append(str(error))
        return problems

    def cache_get(self, key: str) -> dict[str, Array] | None:
        """Return the arrays that `cache_put` stored under a key, or None if there are none or they are damaged.

        Read-only libraries may contain cached arrays.
        """
        for home in dict.fromkeys((Entry.of_folder(self._cache_home), self._root)):
            folder = home / "cache" / key
            try:
                if not folder.is_folder:
                    continue
                attributes = read_attributes(folder)
                arrays = {name: read_array(folder, name) for name in attributes["names"]}
                if attributes["sha256"] != hash_arrays(arrays):
                    continue
                with suppress(OSError):  # of another user, or on read-only media
                    os.utime(self._cache_home / "cache" / key)
                return arrays
            except Exception:  # A cache never stops the work: whatever is wrong with it, compute again.
                continue
        return None

    def cache_put(self, key: str, arrays: Mapping[str, Array]) -> None:
        """Cache arrays under a key of letters, digits, - and _; do nothing if the cache cannot be written."""
        target = self._cache_home / "cache" / key
        try:
            with staging.writing(self._cache_home) as staged:
                target.parent.mkdir(parents=True, exist_ok=True)
                folder = staged / key
                write_group(folder, {"names": list(arrays), "sha256": hash_arrays(arrays)})
                for name, array in arrays.items():
                    write_array(folder / name, StoredArray(np.asarray(array)))
                staging.publish(folder, target)
                _prune(target.parent)
        except (OSError, LibraryError):
            return

    @cached_property
    def _cache_home(self) -> Path:
        """The folder of the cache: the library's own, or the user's if the library is only read."""
        # Locks and staging folders stand beside a library, but in one that is a mount point.
        homes = (self.path, self.path if os.path.ismount(self.path) else self.path.parent)
        if self.path.is_dir() and all(os.access(home, os.W_OK) for home in homes):
            return self.path
        return user_cache_path("manifold") / "libraries" / self.content_hash

    def _folder(self, name: str) -> Entry:
        """Return the folder of a material, whether it exists or not."""
        return staging.standing(self._root / "materials", name)

    @contextmanager
    def _named(self, name: str) -> Iterator[Entry]:
        """Yield the material's folder; any fault of it becomes a LibraryError that names it."""
        if name not in self:
            raise UnknownNameError(
                f"{name}: no such material in {self.path.name}, which holds {len(self)} materials; "
                f"{names_like(self.names, name, 'among them')}"
            )
        try:
            yield self._folder(name)
        except Exception as error:  # of files of others: OSError, ValueError, KeyError, JSON errors
            if isinstance(error, ManifoldError) and not isinstance(error, FileFormatError):
                raise
            raise LibraryError(
                f"{name}: damaged in the library ({_first_line(error)}); {self._repair(name)}"
            ) from error

    def _repair(self, name: str) -> str:
        if not self.path.is_dir():
            return "install or copy the library again"
        return f"delete {self.path / 'materials' / name} and import its file again"


def require_folder(path: Path | str) -> None:
    """Raise UsageError if a path names a read-only library: the built-in one, a zip file, or an address."""
    name = address_of(path)
    if shipped.is_built_in(path):
        name = "the built-in library"
    elif name is None and Path(path).is_file():
        name = str(path)
    if name is not None:
        raise UsageError(
            f"{name} is read only, expected a folder; import the files into a library of your own"
        )


def _root(path: Path | str) -> Entry:
    """Return the root of the store of a library."""
    if shipped.is_built_in(path):
        return Entry(ZipStore(shipped.library_file(path)))
    if (address := address_of(path)) is not None:
        return Entry(remote(address))
    real = shipped.resolved(path)
    if not real.exists():
        raise MissingLibraryError(f"{path}: no such library; create one with `manifold import`")
    if real.is_dir():
        return Entry.of_folder(real)
    if not is_zip(real):
        raise LibraryError(
            f"{path}: a file, expected a library, which is a folder, or a zip file of one; name another path"
        )
    return Entry(ZipStore(real))


def _read_root(folder: Entry, shown: Path | str) -> tuple[int, Bands]:
    """Return schema version and bands of the library in a folder, which is `shown` in errors."""
    again = "import its files again into a new library"
    try:
        attributes: dict[str, Any] = read_attributes(folder)
    except Exception as error:  # No zarr.json, no JSON, zarr version 2, no permission, ...
        is_there = (folder / METADATA).size is not None
        found = (
            f"its zarr.json cannot be used ({_first_line(error)})"
            if is_there
            else "a folder without zarr.json"
        )
        raise LibraryError(
            f"{shown}: not a library: {found}, expected a folder made by `manifold import`; name another path"
        ) from error
    if attributes.get("schema") != SCHEMA:
        raise LibraryError(f"{shown}: a zarr store, but not a library made by `manifold import`")
    version, bands = attributes.get("schema_version"), attributes.get("bands")
    if version not in READABLE_VERSIONS:
        expected = " or ".join(map(str, READABLE_VERSIONS))
        raise LibraryError(f"{shown}: schema version {version}, expected {expected}; {again}")
    if bands == "RGB":
        return version, Bands(None)
    try:
        if isinstance(bands, list) and all(isinstance(w, int | float) for w in bands):
            return version, Bands.from_array(np.array(bands, dtype=np.float64))
        raise ShapeError("not a list of numbers")
    except (ShapeError, OverflowError) as error:
        raise LibraryError(f"{shown}: attribute 'bands' is damaged ({error}); {again}") from error


def _first_line(error: Exception) -> str:
    """Return the first line of an error, or its type if it has no message."""
    if type(error) is KeyError:
        return f"it lacks {error}"
    return str(error).splitlines()[0] if str(error) else type(error).__name__


def read_material(folder: Entry, info: MaterialInfo, *, is_rgb: bool) -> tuple[BsdfFile, str]:
    """Read a material and return it with the hash of its data; an RGB material has no wavelengths."""
    hashed: dict[str, AnyArray] | None = None
    attributes = read_attributes(folder)
    if info.accuracy is None:
        fields = _as_imported(folder, attributes, is_rgb=is_rgb)
    else:
        stored = compact.Compact(
            read_array(folder, COEFFICIENTS),
            unpack(read_array(folder, TABLES), attributes[TABLES]),
            info.accuracy,
        )
        hashed, fields = stored.arrays, stored.decode()
    file = BsdfFile(
        name=info.name,
        description=info.description,
        version=info.pipeline_version,
        jacobian=bool(attributes["jacobian"]),
        rotation_rad=info.rotation_rad,
        **{"wavelengths_nm": None, **fields},
    )
    return file, content_sha256(file, info.source_file, info.sha256, hashed)


def _as_imported(folder: Entry, attributes: Mapping[str, Any], *, is_rgb: bool) -> dict[str, Any]:
    """Return the fields of `BsdfFile` that hold arrays."""
    fields: dict[str, Any] = {
        field: read_array(folder, stored)
        for field, (stored, _, _) in FIELDS.items()
        if field != "vndf" and not (field == "wavelengths_nm" and is_rgb)
    }
    if VISIBLE_NORMALS in attributes:
        slices = visible_normals.Slices.from_json(attributes[VISIBLE_NORMALS])
        difference = read_array(folder, VNDF_DIFFERENCE)
        fields["vndf"] = visible_normals.decode(difference, slices, fields["ndf"], fields["phi_i_rad"])
    else:
        fields["vndf"] = read_array(folder, "vndf")
    return fields | {
        "spectra": np.moveaxis(fields["spectra"], -1, 2),
        "extra": MappingProxyType(read_extra(folder)),
    }
