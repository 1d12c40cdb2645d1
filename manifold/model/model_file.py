"""Models as HDF5 files without pickles.

A file holds latents, a few settings, and what the kind of latent space needs beside them. The measured data stay in
the library, which is named by its place relative to the model and by the hash of its content.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from manifold import atomic
from manifold.errors import ManifoldError, ModelError
from manifold.library.identity import hash_arrays
from manifold.records import Array

FORMAT = "manifold-model"
FORMAT_VERSION = 2


@dataclass(frozen=True, eq=False)
class ModelRecord:
    """The content of a model file.

    Attributes:
        library: the library's place.
        library_hash: of its content when the model was fitted.
        names: of the materials.
        settings, statistics: plain values by name.
        arrays: of the latent space, by name.
    """

    library: Path
    library_hash: str
    names: tuple[str, ...]
    settings: dict[str, Any]
    statistics: dict[str, float]
    arrays: dict[str, Array]


def write_model(path: Path, record: ModelRecord) -> None:
    """Write a model, atomically.

    Raises:
        UsageError: the file cannot be written.
    """
    with atomic.replacing(path) as partial, h5py.File(partial, "w") as file:
        file.attrs["format"] = FORMAT
        file.attrs["format_version"] = FORMAT_VERSION
        # Relative to the model, so that a folder with both can be moved.
        file.attrs["library"] = os.path.relpath(record.library.resolve(), path.resolve().parent)
        file.attrs["library_hash"] = record.library_hash
        file.create_group("settings").attrs.update(record.settings)
        file.create_group("statistics").attrs.update(record.statistics)
        file.create_dataset("names", data=np.array(record.names, dtype=h5py.string_dtype()))
        space = file.create_group("space")
        for name, array in record.arrays.items():
            space.create_dataset(name, data=array)
        space.attrs["sha256"] = _digest(record.arrays)


def read_model(path: Path) -> ModelRecord:
    """Read a model.

    Raises:
        ModelError: no such file, no model of this package, another version, or damaged.
    """
    if not path.exists():
        raise ModelError(f"{path}: no such model; `manifold embed --model {path}` makes one")
    if not path.is_file() or not h5py.is_hdf5(path):
        what = "a folder" if path.is_dir() else "no HDF5 file, or cut off at its beginning"
        raise ModelError(f"{path}: {what}, expected a model; `manifold embed` makes one")
    try:
        with h5py.File(path, "r") as file:
            if file.attrs.get("format") != FORMAT:
                raise ModelError(f"{path}: an HDF5 file, but no manifold model; `manifold embed` makes one")
            version = int(file.attrs["format_version"])
            if version != FORMAT_VERSION:
                raise ModelError(
                    f"{path}: model format {version}, expected {FORMAT_VERSION}; embed again with this version"
                )
            arrays = {name: _finite(name, dataset[...]) for name, dataset in file["space"].items()}
            # Models written before there was a hash have none.
            if file["space"].attrs.get("sha256", _digest(arrays)) != _digest(arrays):
                raise ValueError("its arrays do not have the hash that they were written with")
            return ModelRecord(
                library=Path(os.path.normpath(path.resolve().parent / str(file.attrs["library"]))),
                library_hash=str(file.attrs["library_hash"]),
                names=tuple(file["names"].asstr()[...].tolist()),
                settings={name: _plain(value) for name, value in file["settings"].attrs.items()},
                statistics={name: float(value) for name, value in file["statistics"].attrs.items()},
                arrays=arrays,
            )
    except ManifoldError:
        raise
    except (OSError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise damaged(path, error) from error


def damaged(path: Path, error: Exception) -> ModelError:
    """What to raise where a model's content cannot be used."""
    reason = str(error).partition("\n")[0]
    return ModelError(f"{path}: not a readable model ({reason}); embed again")


def _digest(arrays: dict[str, Array]) -> str:
    """Hash of arrays as `read_model` gives them back."""
    return hash_arrays({name: np.asarray(arrays[name], dtype=np.float64) for name in sorted(arrays)})


def _plain(value: Any) -> Any:
    """A NumPy scalar or HDF5 string as a Python value."""
    return value.item() if isinstance(value, np.generic) else value


def _finite(name: str, array: Array) -> Array:
    array = np.asarray(array, dtype=np.float64)
    if not np.all(np.isfinite(array)):
        raise ValueError(f"dataset '{name}' has values that are not finite")
    return array
