"""BRDF look-up tables of ASAM OpenMATERIAL 3D, `.xompt`: JSON rows of wavelength, theta_i, theta_o, phi_o and BRDF.

Wavelengths are in metres, angles in radians, values in 1/sr. phi_o is relative to the azimuth of the light, so that
the mirror direction lies at pi.

Source: ASAM OpenMATERIAL 3D 1.0, material_brdf_schema.json.
"""

from __future__ import annotations

import json
import re
import uuid
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from manifold.core import disk
from manifold.core.defaults import GONIOMETER
from manifold.core.names import in_one_line
from manifold.core.records import Array
from manifold.formats.column_heads import RELATIVE
from manifold.formats.dense import DenseTable
from manifold.formats.geometries import by_band, directions, exceed_radians
from manifold.formats.readings import Readings
from manifold.formats.text import ErrorContext, decode, read_bytes

_REMEDY = "export the look-up table again"
_LARGEST = 60_000_000  # bytes: more than a million rows as this module writes them
_LONGEST_M = 1e-4  # longest wavelength; larger values are in nanometres or micrometres
_COLUMNS = ("wavelength", "theta_i", "theta_o", "phi_o", "BRDF")
_SCHEMA = "https://raw.githubusercontent.com/asam-ev/OpenMATERIAL-3D/refs/tags/v1.0.0/schemas/material_brdf_schema.json"


def sniff(head: bytes) -> bool:
    """Return whether a file's beginning is JSON that names OpenMATERIAL."""
    text = decode(head)
    return text.lstrip().startswith("{") and re.search(r"openmaterial", text, re.IGNORECASE) is not None


def read(path: Path) -> list[Readings]:
    """Return readings in all bands, with NaN where a pair of directions has no value."""
    context = ErrorContext(path, _REMEDY)
    try:
        content = json.loads(read_bytes(path, _LARGEST))
        rows = content["brdf"]["lookupTable"]
        name = content.get("metadata", {}).get("name") or path.stem
    except (ValueError, RecursionError) as error:
        raise context.error(f"no JSON ({' '.join(str(error).split())[:80]})") from None
    except (KeyError, TypeError, AttributeError):
        raise context.error("no brdf.lookupTable, expected a BRDF table of OpenMATERIAL 3D") from None
    table = _table(rows, context)
    table = table[np.lexsort(table[:, 3:0:-1].T)]  # by angles, as if no row were missing
    cells = by_band(table[:, 1:4], 1e9 * table[:, 0], context)
    if cells.repeated:
        raise context.error("two rows of the same wavelength and directions, expected one")
    notes: list[str] = []
    angles = dict(zip(("theta_i", "theta_o", RELATIVE), table[cells.first, 1:4].T, strict=True))
    if exceed_radians(angles):
        raise context.error("angles beyond a full turn, probably degrees, expected radians")
    kept, wi, wo = directions(angles, context, notes)
    values = cells.table(table[:, 4])[kept]
    return [
        Readings(
            str(name), "OpenMATERIAL 3D", wi, wo, cells.wavelengths_nm, values, notes=tuple(notes),
            repeatability=GONIOMETER,
        )
    ]  # fmt: skip


def _table(rows: Any, context: ErrorContext) -> Array:
    """Return the rows as numbers, shape (rows, 5), NaN for null values."""
    if not isinstance(rows, list) or not rows:
        raise context.error("an empty brdf.lookupTable, expected rows of five numbers")
    for k, row in enumerate(rows, start=1):
        if not isinstance(row, list) or len(row) != len(_COLUMNS):
            raise context.error(f"found '{str(row)[:40]}', expected {', '.join(_COLUMNS)}", f"row {k}")
        for column, cell in zip(_COLUMNS, row, strict=True):
            is_number = isinstance(cell, int | float) and not isinstance(cell, bool) and 0.0 <= cell < 1e300
            if not is_number and not (cell is None and column == "BRDF"):
                raise context.error(
                    f"{column} is {str(cell)[:24]}, expected a number of at least 0", f"row {k}"
                )
    table = np.array(rows, dtype=np.float64)
    outside = table[(table[:, 0] <= 0.0) | (table[:, 0] > _LONGEST_M), 0]
    if outside.size:
        raise context.error(f"a wavelength of {outside[0]:g}, expected metres, such as 5.5e-07")
    return table


def write(path: Path, table: DenseTable) -> None:
    """Write the look-up table of an isotropic sample with spectral bands.

    The table's axes are incident and outgoing angles, with the light at azimuth 180 degrees. The fields for the owner
    and the licence of the data are left empty.
    """
    theta_i, _, theta_o, phi_o = table.axes
    wavelengths = [float(f"{1e-9 * nm:.9g}") for nm in table.bands.wavelengths_nm or ()]
    azimuths = np.mod(phi_o - np.pi, 2.0 * np.pi)
    order = np.argsort(azimuths)
    angles = [[min(round(float(a), 6), 1.570796) for a in axis] for axis in (theta_i, theta_o)]
    exits = [round(float(azimuths[k]), 6) for k in order]
    values = np.maximum(table.values[:, 0, :, order], 0.0)  # azimuths first, as numpy has it
    lines = [
        f"[{wavelength!r},{i!r},{o!r},{phi!r},{values[p, t, s, b]:.7g}]"
        for b, wavelength in enumerate(wavelengths)
        for t, i in enumerate(angles[0])
        for s, o in enumerate(angles[1])
        for p, phi in enumerate(exits if o > 0.0 else exits[:1])
    ]
    metadata = {
        "name": in_one_line(table.name),
        "uuid": str(uuid.UUID(bytes=sha256(values.tobytes()).digest()[:16], version=5)),
        "materialVersion": "1.0.0", "openMaterial3dVersion": "1.0.0", "copyrights": ["not stated"],
        "license": "not stated", "authors": ["not stated"], "sources": in_one_line(table.instrument),
    }  # fmt: skip
    head = json.dumps({"$schema": _SCHEMA, "metadata": metadata}, indent=1)[:-2]
    rows = ",\n".join(lines)
    brdf = f'"brdf": {{"wavelengths": {json.dumps(wavelengths)}, "lookupTable": [\n{rows}\n]}}'
    disk.write_text(path, f"{head},\n {brdf}\n}}\n")
