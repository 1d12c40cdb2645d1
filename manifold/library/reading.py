"""Reading of a material from its group, whatever form it is stored in."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from manifold.library import compact, visible_normals
from manifold.library.identity import MaterialInfo, content_sha256
from manifold.library.schema import COEFFICIENTS, FIELDS, TABLES, VISIBLE_NORMALS, VNDF_DIFFERENCE
from manifold.library.zarr_arrays import read_array, read_extra, unpack
from manifold.records import AnyArray, BsdfFile

if TYPE_CHECKING:
    import zarr


def read_material(group: zarr.Group, info: MaterialInfo, *, is_rgb: bool) -> tuple[BsdfFile, str]:
    """A material, and the hash of what was read.

    Args:
        group: of the material.
        info: of it.
        is_rgb: whether it has no wavelengths.
    """
    hashed: dict[str, AnyArray] | None = None
    if info.accuracy is None:
        fields = _as_imported(group, is_rgb=is_rgb)
    else:
        stored = compact.Compact(
            read_array(group, COEFFICIENTS),
            unpack(read_array(group, TABLES), group.attrs[TABLES]),
            info.accuracy,
        )
        hashed, fields = stored.arrays, stored.decode()
    file = BsdfFile(
        name=info.name,
        description=info.description,
        version=info.pipeline_version,
        jacobian=bool(group.attrs["jacobian"]),
        rotation_rad=info.rotation_rad,
        **{"wavelengths_nm": None, **fields},
    )
    return file, content_sha256(file, info.source_file, info.sha256, hashed)


def _as_imported(group: zarr.Group, *, is_rgb: bool) -> dict[str, Any]:
    """The fields of `BsdfFile` that hold arrays."""
    fields: dict[str, Any] = {
        field: read_array(group, stored)
        for field, (stored, _, _) in FIELDS.items()
        if field != "vndf" and not (field == "wavelengths_nm" and is_rgb)
    }
    if VISIBLE_NORMALS in group.attrs:
        slices = visible_normals.Slices.from_json(group.attrs[VISIBLE_NORMALS])
        difference = read_array(group, VNDF_DIFFERENCE)
        fields["vndf"] = visible_normals.decode(difference, slices, fields["ndf"], fields["phi_i_rad"])
    else:
        fields["vndf"] = read_array(group, "vndf")
    return fields | {
        "spectra": np.moveaxis(fields["spectra"], -1, 2),
        "extra": MappingProxyType(read_extra(group)),
    }
