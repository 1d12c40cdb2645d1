"""Tables of FRED: a line `theta phi` per incidence, then lines `theta phi value`, in degrees from the normal.

The lines of incidence name the mirror direction. Azimuths count from the sample's x axis, so that the mirror direction
of an incidence lies at its own azimuth. Values are the BRDF in 1/sr, one band without a wavelength.

Source: Photon Engineering, FRED help, "Tabulated BSDF" and "SetTabulatedScatter".
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from manifold.core import disk
from manifold.core.defaults import GONIOMETER
from manifold.formats.dense import DenseTable
from manifold.formats.geometries import directions
from manifold.formats.readings import Readings
from manifold.formats.text import ErrorContext, data_lines, decode, read_lines
from manifold.formats.values import unnamed_band

_TYPE, _FORMAT = "type bsdf_data", "format angles=deg bsdf=value scale=1"
_REMEDY = f"write it with the lines '{_TYPE}' and '{_FORMAT}'"


def sniff(head: bytes) -> bool:
    """Return whether a file has the beginning of such a table."""
    return re.match(r"\s*type\s+bsdf_data\b", decode(head), re.IGNORECASE) is not None


def read(path: Path) -> list[Readings]:
    """Read the reflected light at all incidences, as one record."""
    context = ErrorContext(path, _REMEDY)
    lines = data_lines(read_lines(path), marks=())
    context.require_rows(lines)
    said = " ".join(lines[1][1].lower().split()) if len(lines) > 1 else "no line"
    if said != _FORMAT:
        raise context.error(f"found '{said[:60]}', expected '{_FORMAT}'", "line 2")
    rows: list[list[float]] = []
    incidence: list[float] = []
    begins = 0  # first row of the incidence
    for number, line in lines[2:]:
        cells = context.numbers(line.split(), number)
        if len(cells) == 3 and incidence:
            rows.append([*incidence, *cells])
        elif len(cells) == 2 and (not incidence or len(rows) > begins):
            incidence, begins = cells, len(rows)
        else:
            expected = "theta phi value" if incidence else "theta phi of an incidence"
            raise context.error(f"{len(cells)} numbers, expected {expected}", f"line {number}")
    if not rows or begins == len(rows):
        raise context.error("the file ends without values of an incidence: it is cut off")
    theta_i, phi_m, theta_o, phi_o, values = np.array(rows).T
    angles = {"theta_i": theta_i, "phi_i": phi_m + 180.0, "theta_o": theta_o, "phi_o": phi_o}
    notes: list[str] = []
    kept, wi, wo = directions({key: np.deg2rad(a) for key, a in angles.items()}, context, notes)
    nm = unnamed_band(notes, context)
    values = values[kept, None]
    return [
        Readings(path.stem, "FRED table", wi, wo, nm, values, notes=tuple(notes), repeatability=GONIOMETER)
    ]


def write(path: Path, table: DenseTable) -> None:
    """Write a table of incident and outgoing angles in one band.

    The mirror direction of an isotropic sample is written at azimuth 0; anisotropic samples keep their own azimuths.
    """
    theta_i, phi_i, theta_o, phi_o = (np.rad2deg(axis) for axis in table.axes)
    shift = 180.0 - phi_i[0] if phi_i.size == 1 else 0.0
    lines = [_TYPE, _FORMAT]
    for incidence, of_incidence in zip(theta_i, np.maximum(table.values[..., 0], 0.0), strict=True):
        for azimuth, block in zip(np.mod(phi_i + shift - 180.0, 360.0), of_incidence, strict=True):
            lines.append(f"{incidence:.6g}\t{azimuth:.6g}")
            for theta, row in zip(theta_o, block, strict=True):
                azimuths = phi_o + shift if theta > 0.0 else phi_o[:1] + shift
                lines += [f"{theta:.6g}\t{phi:.6g}\t{v:.7g}" for phi, v in zip(azimuths, row, strict=False)]
    disk.write_text(path, "\n".join(lines) + "\n")
