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
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

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
        dims: names of the axes.
        attributes: of the array.
        is_compressed: by zstd, losslessly.
    """

    values: AnyArray
    chunks: tuple[int, ...] | None = None
    shards: tuple[int, ...] | None = None
    dims: tuple[str, ...] | None = None
    attributes: dict[str, Any] = field(default_factory=dict)
    is_compressed: bool = False


def stored(name: str, values: Array, bands: Bands) -> StoredArray:
    """A field of `BsdfFile`, by its name there, as the store holds it."""
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
    """Attributes of a new library."""
    wavelengths = "RGB" if bands.wavelengths_nm is None else list(bands.wavelengths_nm)
    return {"schema": SCHEMA, "schema_version": SCHEMA_VERSION, "bands": wavelengths}
