"""Stores from which libraries are read: folders, zip files, and addresses that fsspec opens.

All have the interface `Store`, and paths separated by slashes, such as `materials/satin_gold/zarr.json`.
"""

from __future__ import annotations

import json
import os
import re
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, Protocol

from manifold.core.errors import LibraryError
from manifold.core.extras import require

if TYPE_CHECKING:  # helps name the built-in library, and need no numbers
    import numpy as np
    from numpy.typing import NDArray

METADATA, MATERIALS = "zarr.json", "materials"
CONSOLIDATED = "consolidated_metadata"
"""The key in a group's metadata under which zarr stores the metadata of all groups and arrays in it."""

_ADDRESS = re.compile(r"([a-z][a-z0-9+.-]+):/+(?=[^/])")  # two letters or more: one is a drive of Windows


def address_of(path: PurePath | str) -> str | None:
    """Return the address that a text or path denotes, such as `https://example.org/library.zarr`, or None.

    A `Path` made from an address is accepted as well, although it has lost the second slash.
    """
    text = path.as_posix() if isinstance(path, PurePath) else path
    found = _ADDRESS.match(text)
    return None if found is None else f"{found[1]}://{text[found.end() :]}".rstrip("/")


def _bytes(content: bytes) -> NDArray[np.uint8]:
    """Return bytes as a writable array."""
    import numpy as np

    return np.frombuffer(bytearray(content), np.uint8)


class Store(Protocol):
    """Files by path, read only."""

    def folders(self, path: str) -> Iterable[str]:
        """Return the names of the folders in a folder; none if it does not exist."""
        ...

    def is_folder(self, path: str) -> bool:
        """Return whether the store has this folder."""
        ...

    def size(self, path: str) -> int | None:
        """Return the size of a file in bytes, or None if there is no such file."""
        ...

    def read(self, path: str, most: int = -1) -> NDArray[np.uint8]:
        """Return the first bytes of a file, by default all, as a new array."""
        ...


@dataclass(frozen=True)
class Entry:
    """A file or folder of a store, whether it exists or not; the empty path is the root."""

    store: Store
    path: str = ""

    @classmethod
    def of_folder(cls, path: Path) -> Entry:
        """Return the entry of a folder of the file system."""
        return cls(FolderStore(path))

    def __truediv__(self, name: str) -> Entry:
        return Entry(self.store, f"{self.path}/{name}" if self.path else name)

    @property
    def name(self) -> str:
        """The last part of the path."""
        return self.path.rpartition("/")[2] or "the root"

    @property
    def folders(self) -> set[str]:
        """The names of the folders in this folder."""
        return set(self.store.folders(self.path))

    @property
    def is_folder(self) -> bool:
        """Return whether this folder exists."""
        return self.store.is_folder(self.path)

    @property
    def size(self) -> int | None:
        """The size of this file in bytes; None if it does not exist."""
        return self.store.size(self.path)

    def read(self, most: int = -1) -> NDArray[np.uint8]:
        """Return the first bytes of this file, by default all, as a new array."""
        return self.store.read(self.path, most)


@dataclass(frozen=True)
class FolderStore:
    """A folder of the file system."""

    root: Path

    def folders(self, path: str) -> list[str]:
        """Return the names of the folders in a folder. Raises OSError if it cannot be read."""
        return [entry.name for entry in os.scandir(self.root / path) if entry.is_dir()]

    def is_folder(self, path: str) -> bool:
        """Return whether the store has this folder."""
        return os.path.isdir(self.root / path)

    def size(self, path: str) -> int | None:
        """Return the size of a file in bytes, or None if there is no such file."""
        file = self.root / path
        return os.path.getsize(file) if os.path.isfile(file) else None

    def read(self, path: str, most: int = -1) -> NDArray[np.uint8]:
        """Return the first bytes of a file, by default all."""
        import numpy as np

        return np.fromfile(self.root / path, np.uint8, most)


class ZipStore:
    """A zip file that holds a library: at its root, or as its only folder."""

    def __init__(self, path: Path) -> None:
        """Read the directory of the file.

        Raises:
            LibraryError: it is damaged, or holds no library.
        """
        try:
            self._zip = zipfile.ZipFile(path)
        except (zipfile.BadZipFile, NotImplementedError, OSError, ValueError) as error:
            raise LibraryError(f"{path}: cannot be read as a zip file ({error}); make it again") from error
        names = [info.filename for info in self._zip.infolist()]
        roots = [name.removesuffix(METADATA) for name in names if name.endswith(METADATA)]
        top = min(roots, key=len, default=None)
        if top is None or top.count("/") > 1:
            raise LibraryError(
                f"{path}: a zip file, but not of a library: it has no {METADATA}; zip the folder"
            )
        self._top = top
        files = [name.removeprefix(top) for name in names if name.startswith(top) and not name.endswith("/")]
        self._folders: dict[str, set[str]] = {}
        for file in files:
            *parents, _ = file.split("/")
            for k, parent in enumerate(parents):
                self._folders.setdefault("/".join(parents[:k]), set()).add(parent)
            self._folders.setdefault("/".join(parents), set())

    def folders(self, path: str) -> set[str]:
        """Return the names of the folders in a folder."""
        return self._folders.get(path, set())

    def is_folder(self, path: str) -> bool:
        """Return whether the store has this folder."""
        return path in self._folders

    def size(self, path: str) -> int | None:
        """Return the size of a file in bytes, or None if there is no such file."""
        try:
            return self._zip.getinfo(self._top + path).file_size
        except KeyError:
            return None

    def read(self, path: str, most: int = -1) -> NDArray[np.uint8]:
        """Return the first bytes of a file, by default all. Raises RuntimeError or BadZipFile if it is damaged."""
        with self._zip.open(self._top + path) as file:
            return _bytes(file.read(most))


def is_zip(path: Path) -> bool:
    """Return whether a path is a regular file that zip made; `is_zipfile` would wait for the data of a pipe."""
    return os.path.isfile(path) and zipfile.is_zipfile(path)


def is_zipped_library(path: Path) -> bool:
    """Return whether a file is a zip file that holds a library."""
    if not is_zip(path):
        return False
    try:
        ZipStore(path)
    except LibraryError:
        return False
    return True


class RemoteStore:
    """An address that fsspec opens.

    The metadata of all materials are read at once, from the metadata of their group. A file is fetched when its size
    is requested, and kept until it is read.
    """

    def __init__(self, address: str) -> None:
        """Fetch the metadata.

        Raises:
            LibraryError: there is no library at the address, or it lacks consolidated metadata.
            MissingPackageError: fsspec, or what it needs for the address, is not installed.
        """
        fsspec = require("fsspec")
        self._address = address
        self._fetched: dict[str, bytes] = {}
        try:
            self._files, self._root = fsspec.url_to_fs(address)
            root, group = (self._json(path) for path in (METADATA, f"{MATERIALS}/{METADATA}"))
            below = group.pop(CONSOLIDATED, {}).get("metadata")
        except ImportError as error:  # fsspec names what the protocol needs
            raise LibraryError(
                f"{address}: {error}; pip install 'brdf-manifold[remote]', or the package of its protocol"
            ) from error
        except Exception as error:  # of protocols and servers: no common class
            reason = str(error).partition("\n")[0] or type(error).__name__
            is_zip = address.lower().endswith(".zip")
            remedy = (
                "download a zip file and name that"
                if is_zip
                else "name the address of a folder made by `manifold import`"
            )
            raise LibraryError(f"{address}: no library can be read there ({reason}); {remedy}") from error
        if below is None:
            raise LibraryError(
                f"{address}: its {MATERIALS}/{METADATA} lacks the metadata of the materials, as versions before 0.5 "
                "wrote it; import its files again where it is stored"
            )
        metadata = {MATERIALS: group} | {f"{MATERIALS}/{path}": each for path, each in below.items()}
        self._metadata = {METADATA: root} | {f"{path}/{METADATA}": each for path, each in metadata.items()}
        self._groups = set(metadata)

    def folders(self, path: str) -> list[str]:
        """Return the names of the folders in a folder."""
        prefix = f"{path}/" if path else ""
        inside = [group.removeprefix(prefix) for group in self._groups if group.startswith(prefix)]
        return [name for name in inside if "/" not in name]

    def is_folder(self, path: str) -> bool:
        """Return whether the store has this folder."""
        return path in self._groups

    def size(self, path: str) -> int | None:
        """Return the size of a file in bytes, or None if there is no such file."""
        try:
            return len(self._content(path))
        except FileNotFoundError:
            return None

    def read(self, path: str, most: int = -1) -> NDArray[np.uint8]:
        """Return the first bytes of a file, by default all. Raises OSError if it cannot be fetched."""
        content = self._content(path)
        if most < 0:
            self._fetched.pop(path, None)
        return _bytes(content if most < 0 else content[:most])

    def _json(self, path: str) -> dict[str, Any]:
        return dict(json.loads(self._files.cat_file(f"{self._root}/{path}")))

    def _content(self, path: str) -> bytes:
        if path in self._metadata:
            return json.dumps(self._metadata[path]).encode()
        found = self._fetched.get(path)
        if found is None:
            found = self._fetched[path] = self._files.cat_file(f"{self._root}/{path}")
        return found


@lru_cache(maxsize=8)
def remote(address: str) -> RemoteStore:
    """Return the store of an address, fetched once per process."""
    return RemoteStore(address)
