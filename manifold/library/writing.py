"""Creation of a library, and writing of a material into a staging folder."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from manifold.errors import LibraryError
from manifold.library import staging
from manifold.library.identity import describe, present_arrays
from manifold.library.schema import FIELDS, StoredArray, bands_of, root_attributes, stored
from manifold.library.zarr_reading import attributes_of, open_group
from manifold.library.zarr_writing import write_array, write_group
from manifold.records import Bands, BsdfFile


def make_store(folder: Path, bands: Bands, staged: Path) -> None:
    """Make an empty library; the caller holds its write lock and lends a staging folder.

    Raises:
        LibraryError: something is there already.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise LibraryError(f"{folder}: exists already; choose a path where there is nothing yet")
    root = staged / "library"
    write_group(root, root_attributes(bands))
    write_group(root / "materials", {})
    write_group(root / "cache", {})
    staging.publish(root, folder)


def write_material(folder: Path, file: BsdfFile, source_file: str, sha256: str) -> None:
    """Write a material's group into a folder that does not exist yet (it is published by a rename).

    Args:
        folder: the group's folder.
        file: what to store.
        source_file: name of the imported file.
        sha256: of the imported file, in hexadecimal.
    """
    info = describe(file, source_file, sha256)
    write_group(folder, asdict(info) | {"jacobian": bool(file.jacobian)})
    for name, array in present_arrays(file).items():
        write_array(folder / FIELDS[name][0], stored(name, array, file.bands))
    if file.extra:
        write_group(folder / "extra", {})
        for number, (name, array) in enumerate(file.extra.items()):
            write_array(folder / "extra" / str(number), StoredArray(array, attributes={"field": name}))


def read_bands(folder: Path, shown: Path | str) -> Bands:
    """The bands of the library in a folder.

    Args:
        folder: the library.
        shown: its path as the user gave it, for errors.
    Raises:
        LibraryError: it is no library of this package and version.
    """
    try:
        attributes = attributes_of(open_group(folder))
    except Exception as error:  # No zarr.json, no JSON, zarr version 2, no permission, ...
        found = f"its zarr.json cannot be used ({first_line(error)})"
        if isinstance(error.__cause__, FileNotFoundError):
            found = "a folder without zarr.json"
        raise LibraryError(
            f"{shown}: not a library: {found}, expected a folder made by `manifold import`; name another path"
        ) from error
    return bands_of(attributes, shown)


def first_line(error: Exception) -> str:
    """The first line of an error of zarr; its type, if it has no message."""
    return str(error).splitlines()[0] if str(error) else type(error).__name__
