"""Reads and writes model files, which are HDF5; a file is read only if its hash is right.

    bytes 0 to 511      the user block: magic, format version, SHA-256 of all other bytes
    the rest            HDF5: the arrays in `space`, and `record`

`record` is JSON in UTF-8 with names, settings, statistics and the library. The measured data stay in the library. The
record names the library by its path relative to the model, by its address, or as `built-in`, and holds its hash.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import struct
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from manifold.core import disk, shipped
from manifold.core.errors import LibraryError, MissingModelError, ModelError, UnknownNameError, UsageError
from manifold.core.records import Array
from manifold.core.stores import address_of
from manifold.formats.recognition import MODEL_MAGIC
from manifold.library.store import Library
from manifold.model.blend_space import BlendSpace
from manifold.model.expected_error import LeftOut
from manifold.model.gplvm_space import GplvmSpace
from manifold.model.latent_space import LatentSpace
from manifold.model.settings import KINDS, Settings

FORMAT = "manifold-model"
FORMAT_VERSION = 4
LAYOUT = "neighbourhoods"
"""Name of the method that lays out maps of blends; files of version 0.4 have no such name."""
OLD_LAYOUT = "laid out by version 0.4: run `manifold embed` again to place similar materials closer together"
_ADDED_SETTINGS = {"as_published": False}  # of earlier files of this version, which lack them
_OLD_KINDS = {"material": "gplvm"}  # names of earlier versions

_HEADER = struct.Struct("<16sI16x")  # magic, version
_DIGEST = slice(_HEADER.size, _HEADER.size + 32)
_USER_BLOCK = 512  # the least that HDF5 takes
_MOST_BYTES = 1 << 30
_HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"


@dataclass(frozen=True, eq=False)
class ModelRecord:
    """The content of a model file.

    Attributes:
        library_hash: hash of the library's content when the model was fitted.
        settings, statistics: plain values by name.
        arrays: arrays of the latent space, by name.
        layout: name of the layout of a map of blends; None for files of version 0.4.
    """

    library: Path
    library_hash: str
    names: tuple[str, ...]
    settings: dict[str, Any]
    statistics: dict[str, float]
    arrays: dict[str, Array]
    layout: str | None = LAYOUT

    @property
    def has_old_layout(self) -> bool:
        """Return whether the model is a map of blends of version 0.4."""
        return self.layout is None and self.settings["kind"] == "blend"

    @property
    def n_bands(self) -> int | None:
        """Return the number of bands if the model holds reflectances; None for kind `gplvm`."""
        found = self.arrays.get("reflectances")
        return None if found is None or found.ndim == 0 else found.shape[-1]


def write_model(path: Path, record: ModelRecord) -> None:
    """Write a model file, atomically."""
    values = {
        "library": _reference(record.library, path),
        "library_hash": record.library_hash,
        "names": record.names,
        "settings": record.settings,
        "statistics": record.statistics,
        "layout": record.layout,
    }
    memory = io.BytesIO()  # since HDF5 ends the process where a disk is full
    try:
        with h5py.File(memory, "w", userblock_size=_USER_BLOCK) as file:
            file.attrs["format"] = FORMAT
            file.attrs["format_version"] = FORMAT_VERSION
            space = file.create_group("space")
            for name, array in record.arrays.items():
                space.create_dataset(name, data=_finite(np.asarray(array, dtype="<f8"), name))
            text = json.dumps(values, default=_plain, allow_nan=False)
            file.create_dataset("record", data=np.frombuffer(text.encode(), np.uint8))
    except ValueError as error:
        raise ModelError(f"{path}: cannot be written ({error}); fit again with other settings") from error
    content = bytearray(memory.getvalue())
    _HEADER.pack_into(content, 0, MODEL_MAGIC, FORMAT_VERSION)
    content[_DIGEST] = _digest(content)
    disk.write_bytes(path, bytes(content))


def _reference(library: Path, path: Path) -> str:
    """Return the name of a library in a model: relative to it, so that a folder with both can be moved."""
    if shipped.is_elsewhere(library):
        return address_of(library) or shipped.BUILT_IN.name
    return os.path.relpath(library.resolve(), path.resolve().parent)


def read_model(path: Path) -> ModelRecord:
    """Read a model file, or the built-in model."""
    path = shipped.model_file(path)
    if not path.exists():
        raise MissingModelError(f"{path}: no such model; create one with `manifold embed`")
    if path.is_dir():
        raise ModelError(f"{path}: a folder, expected a model; create one with `manifold embed`")
    try:
        content = disk.read_bytes(path, advice="name a model", most=_MOST_BYTES)
    except UsageError as error:
        raise ModelError(str(error)) from error
    if not content.startswith(MODEL_MAGIC):
        is_hdf5 = content.startswith(_HDF5_MAGIC)
        what = "another HDF5 file, or a model of an old version" if is_hdf5 else "unknown or damaged header"
        raise ModelError(
            f"{path}: {what}, expected a manifold model of format {FORMAT_VERSION}; name another, or embed again"
        )
    _, *version = _HEADER.unpack_from(content.ljust(_HEADER.size))
    if version != [FORMAT_VERSION]:
        raise ModelError(
            f"{path}: model format {version[0]}, expected {FORMAT_VERSION}; run `manifold embed` again"
        )
    try:
        return _record_of(content, path)
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError, OSError, RuntimeError) as error:
        raise damaged(path, error) from error


def damaged(path: Path, error: Exception) -> ModelError:
    """Return the exception for a model file whose content is damaged."""
    reason = str(error).partition("\n")[0]
    return ModelError(f"{path}: not a readable model ({reason}); embed again")


def _record_of(content: bytes, path: Path) -> ModelRecord:
    if content[_DIGEST] != _digest(content):
        raise ValueError("its hash does not match its content")
    with h5py.File(io.BytesIO(content)) as file:
        values = json.loads(file["record"][()].tobytes(), parse_constant=disk.refuse_constant)
        arrays: dict[str, Array] = {}
        for name, dataset in file["space"].items():
            if dataset.nbytes > len(content):
                raise ValueError(f"array '{name}' has shape {dataset.shape}, more than the file holds")
            arrays[name] = _finite(np.asarray(dataset[()], dtype=np.float64), name)
    names = [str(name) for name in values["names"]]
    if len(set(names)) < len(names):
        raise ValueError("a material is named twice")
    library = Path(str(values["library"]))
    if not shipped.is_elsewhere(library):
        library = Path(os.path.normpath(path.resolve().parent / library))
    return ModelRecord(
        library=library,
        library_hash=str(values["library_hash"]),
        names=tuple(names),
        settings=dict(values["settings"]),
        statistics={name: _finite(float(value), name) for name, value in values["statistics"].items()},
        arrays=arrays,
        layout=values.get("layout"),
    )


def _digest(content: bytes | bytearray) -> bytes:
    """Return the SHA-256 of all bytes except those that hold it."""
    view = memoryview(content)
    digest = hashlib.sha256(view[: _DIGEST.start])
    digest.update(view[_DIGEST.stop :])
    return digest.digest()


def _plain(value: Any) -> Any:
    """Return a NumPy scalar as a Python value."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"a model cannot hold {type(value).__name__}")


def _finite(values: Any, name: str) -> Any:
    if not np.all(np.isfinite(values)):
        raise ValueError(f"'{name}' has values that are not finite")
    return values


SPACES: dict[str, type[LatentSpace]] = {space.kind: space for space in (BlendSpace, GplvmSpace)}
"""Classes of latent spaces, by the name of their kind."""


def open_library(path: Path, stored: ModelRecord, library: Library | Path | str | None) -> Library:
    """Open the library that a model file names, or the given library."""
    if library is None:
        library = stored.library
        if not shipped.exists(library):
            raise LibraryError(
                f"{path}: its library is not at {library}; give its location with --library FOLDER, "
                "or library= in Python"
            )
    if not isinstance(library, Library):
        library = Library(library)
    missing = sorted(set(stored.names) - set(library.names))
    if missing:
        shown = ", ".join(missing[:3]) + (", ..." if len(missing) > 3 else "")
        raise LibraryError(
            f"{library.path.name} lacks {len(missing)} of the {len(stored.names)} materials of {path.name} "
            f"({shown}); import them again, name the right library, or embed again"
        )
    if stored.n_bands not in (None, library.bands.count):
        raise LibraryError(
            f"{library.path.name} has {library.bands}, {path.name} was fitted to {stored.n_bands} bands; "
            "name the right library, or embed again"
        )
    return library


def restore(path: Path, stored: ModelRecord) -> tuple[Settings, LatentSpace, LeftOut | None]:
    """Restore the settings, the latent space, and the errors of left-out materials from a model file."""
    try:
        held = _ADDED_SETTINGS | stored.settings
        kind = KINDS[_OLD_KINDS.get(str(held["kind"]), str(held["kind"]))]
        settings = kind(**{f.name: held[f.name] for f in fields(kind)})
        space = SPACES[settings.kind].from_arrays(stored.arrays, settings.covariance(), stored.n_bands or 0)
        expected = (len(stored.names), settings.latent_dim)
        if space.X.shape != expected:
            raise ValueError(f"dataset 'X' has shape {space.X.shape}, expected {expected}")
        left_out = LeftOut.from_arrays(stored.arrays, space)
    except UnknownNameError as error:
        raise ModelError(
            f"{path}: {error}; register your kernel before you load the model, as in "
            "manifold.registries.KERNELS['name'] = Class"
        ) from error
    except UsageError as error:
        raise ModelError(f"{path}: fitted with {error}; embed the library again") from error
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise damaged(path, error) from error
    return settings, space, left_out
