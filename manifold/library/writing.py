"""Creation of a library, and writing of a material into a staging folder."""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

from manifold.errors import LibraryError
from manifold.library import staging, visible_normals
from manifold.library.compact import Compact
from manifold.library.identity import describe, present_arrays
from manifold.library.schema import (
    COEFFICIENTS,
    FIELDS,
    TABLES,
    VISIBLE_NORMALS,
    VNDF_DIFFERENCE,
    StoredArray,
    root_attributes,
    stored,
)
from manifold.library.zarr_arrays import pack, write_array, write_group
from manifold.records import Bands, BsdfFile


def make_store(folder: Path, bands: Bands, staged: Path) -> None:
    """Make an empty library; the caller holds its write lock and lends a staging folder.

    Raises:
        LibraryError: something is there already.
    """
    if folder.exists() and (not folder.is_dir() or staging.contents(folder)):
        raise LibraryError(f"{folder}: exists already; choose a path where there is nothing yet")
    root = staged / "library"
    write_group(root, root_attributes(bands))
    write_group(root / "materials", {})
    write_group(root / "cache", {})
    if os.path.ismount(folder):  # which cannot be replaced
        for path in sorted(root.iterdir()):  # zarr.json, which makes it a library, comes last
            os.rename(path, folder / path.name)
    else:
        staging.publish(root, folder)


def write_material(
    folder: Path, file: BsdfFile, source_file: str, sha256: str, compact: Compact | None = None
) -> None:
    """Write a material's group into a folder that does not exist yet (it is published by a rename).

    Args:
        folder: the group's folder.
        file: what to store.
        source_file: name of the imported file.
        sha256: of the imported file, in hexadecimal.
        compact: the form in which it is stored; by default as it is.
    """
    attributes: dict[str, Any] = {"jacobian": bool(file.jacobian)}
    if compact is not None:
        info = describe(file, source_file, sha256, (compact.arrays, compact.accuracy))
        tables, layout = pack(compact.tables)
        write_group(folder, asdict(info) | attributes | {TABLES: layout})
        axes = ("component", "phi_i", "theta_i", "row", "column")
        write_array(folder / COEFFICIENTS, StoredArray(compact.coefficients, dims=axes, is_compressed=True))
        write_array(folder / TABLES, StoredArray(tables, is_compressed=True))
        return
    info = describe(file, source_file, sha256)
    difference, slices = visible_normals.encode(file)
    write_group(folder, asdict(info) | attributes | {VISIBLE_NORMALS: slices.to_json()})
    chunks, dims = (1, *difference.shape[1:]), FIELDS["vndf"][1]
    write_array(folder / VNDF_DIFFERENCE, StoredArray(difference, chunks, None, dims, is_compressed=True))
    for name, array in present_arrays(file).items():
        if name == "vndf":
            continue
        write_array(folder / FIELDS[name][0], stored(name, array, file.bands))
    if file.extra:
        write_group(folder / "extra", {})
        for number, (name, array) in enumerate(file.extra.items()):
            write_array(folder / "extra" / str(number), StoredArray(array, attributes={"field": name}))
