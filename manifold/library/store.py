"""The library: RGL files in one zarr store, opened for reading; its layout is in `manifold.library.schema`.

Written once, renamed into place when whole (`manifold.library.staging`), never changed.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from manifold.errors import LibraryError, ManifoldError, UsageError
from manifold.library import cache, location, staging
from manifold.library.identity import MaterialInfo, content_sha256, info_of, is_material_name
from manifold.library.schema import FIELDS, SCHEMA_VERSION
from manifold.library.writing import first_line, make_store, read_bands
from manifold.library.zarr_reading import attributes_of, open_group, read_array, read_extra, shape_of
from manifold.records import Array, Bands, BsdfFile, Progress
from manifold.system.stages import with_progress

if TYPE_CHECKING:
    import zarr

T = TypeVar("T")

_TRIES = 50  # of reads that a replacement came in between
_PAUSE_S = 0.005


@dataclass(frozen=True)
class LibraryInfo:
    """The contents of a library, as `manifold info` shows them.

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

    Nothing is cached: materials imported by another process are visible immediately.
    """

    def __init__(self, path: Path, bands: Bands) -> None:
        """Use `open` or `create`."""
        self.path = path
        self.bands = bands

    def __repr__(self) -> str:
        try:
            held = f"{len(self)} materials"
        except LibraryError:
            held = "cannot be read"
        return f"<Library: {self.path.name}, {held}, {self.bands}>"

    @classmethod
    def open(cls, path: Path | str) -> Library:
        """Open a library for reading; write permission is not needed.

        Raises:
            LibraryError: nothing there, no library of this package, another schema version, or damaged.
        """
        folder = location.resolved(path)
        if folder.exists() and not folder.is_dir():
            raise LibraryError(f"{path}: a file, expected a library, which is a folder; name another path")
        if not folder.is_dir():
            raise LibraryError(
                f"{path}: no such library; create it with `manifold import FILES --library {path}`"
            )
        staging.recover(folder)
        return cls(folder, read_bands(folder, path))

    @classmethod
    def create(cls, path: Path | str, bands: Bands) -> Library:
        """Create an empty library for materials of the given bands.

        Raises:
            UsageError: the path lies in a library.
            LibraryError: something is there already, or the folder cannot be written.
        """
        folder = location.resolved(path)
        location.require_outside_libraries(folder)
        folder.parent.mkdir(parents=True, exist_ok=True)
        with staging.writing(folder) as staged:
            make_store(folder, bands, staged)
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
        """One material, equal to the imported file in every value, shape and dtype, verified by its hash.

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
        if file.bands != self.bands:  # those of the library stand in its root, which no hash covers
            raise LibraryError(
                f"{name}: has {file.bands}, but {self.path.name} says {self.bands}; its zarr.json was changed: "
                "import its files again into a new library"
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
            attributes = attributes_of(group)
            arrays = {
                field: read_array(group, stored)
                for field, (stored, _, _) in FIELDS.items()
                if field != "wavelengths_nm" or not self.bands.is_rgb
            }
            arrays["spectra"] = np.moveaxis(arrays["spectra"], -1, 2)
            return BsdfFile(
                name=name,
                description=str(attributes["description"]),
                version=tuple(attributes["pipeline_version"]),
                jacobian=bool(attributes["jacobian"]),
                extra=MappingProxyType(read_extra(group)),
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
        """A part of one material's spectra; only the chunks that contain it are read, so no hash is verified.

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
            shape = shape_of(group, "spectra")
            selection = (
                _one(phi_index, shape[0], f"{name}: phi_index"),
                _one(theta_index, shape[1], f"{name}: theta_index"),
                slice(0, shape[2]),
                slice(0, shape[3]),
                _band_range(bands, shape[4], name),
            )
            return np.moveaxis(read_array(group, "spectra", selection), -1, 2)

    def attributes(self, name: str) -> MaterialInfo:
        """Metadata of a material, without reading its arrays.

        Raises:
            UsageError: no such material.
            LibraryError: the material is damaged.
        """
        return self._settled(name, lambda: self._attributes(name))

    def _attributes(self, name: str) -> MaterialInfo:
        with self._material(name) as group:
            return info_of(name, attributes_of(group))

    @property
    def content_hash(self) -> str:
        """SHA-256 over the bands and every name and file hash, by which a model identifies its library."""
        digest = hashlib.sha256(json.dumps(self.bands.wavelengths_nm).encode())
        for name in self.names:
            digest.update(f"\n{name}\t{self.attributes(name).sha256}".encode())
        return digest.hexdigest()

    @property
    def info(self) -> LibraryInfo:
        """All metadata of the library."""
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
        for name in with_progress(self.names, callback, str):
            try:
                self.read(name)
            except ManifoldError as error:
                problems.append(str(error))
        return problems

    def cache_get(self, key: str) -> dict[str, Array] | None:
        """Arrays that `cache_put` stored under a key, or None if there are none or they are damaged."""
        return cache.get(self.path, key)

    def cache_put(self, key: str, arrays: Mapping[str, Array]) -> None:
        """Store arrays under a key, atomically; no effect if the library cannot be written."""
        cache.put(self.path, key, arrays)

    @contextmanager
    def _material(self, name: str) -> Iterator[zarr.Group]:
        """The material's group; whatever goes wrong with it becomes one LibraryError that names it."""
        if name not in self:
            raise UsageError(
                f"{name}: no such material in {self.path.name}, which holds {len(self)} materials"
            )
        try:
            yield open_group(self.path / "materials" / name)
        except ManifoldError:
            raise
        except Exception as error:  # zarr lets many kinds through: OSError, ValueError, KeyError, JSON errors
            raise LibraryError(
                f"{name}: damaged in the library ({first_line(error)}); {self._repair(name)}"
            ) from error

    def _repair(self, name: str) -> str:
        return f"delete {self.path / 'materials' / name} and import its file again"


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
