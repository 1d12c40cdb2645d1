"""Text files of pab-opto goniophotometers: one file per incidence, rows `theta phi value` in degrees.

Comments give the incidence (`#incident_angle theta phi`, or `#intheta` and `#inphi`) and the quantity
(`#format: theta phi DSF` or `BSDF`, with DSF = BSDF cos(theta_o)).
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from manifold.core.defaults import GONIOMETER
from manifold.core.directions import from_spherical
from manifold.core.records import Array
from manifold.formats.quantities import LEAST_COSINE, quantity_in_prose
from manifold.formats.readings import Assumption, Readings
from manifold.formats.text import (
    NUMBER,
    ErrorContext,
    angle_unit,
    data_lines,
    decode,
    find_separator,
    number_with_unit,
    read_lines,
    split_cells,
    wavelength_nm,
)
from manifold.formats.values import as_brdf, converted, unnamed_band

_REMEDY = "export the measurement again"
_ANGLE = re.compile(rf"{NUMBER}\s*(?:[^\W\d]+|[°º])?")


def sniff(head: bytes) -> bool:
    """Return whether a file begins with the comments of these files."""
    text = decode(head).lower()
    return (
        re.search(r"^\s*#\s*(incident_angle|intheta|inphi|format\s*:\s*theta)", text, re.MULTILINE)
        is not None
    )


def read(path: Path) -> list[Readings]:
    """Read the readings of one incidence."""
    context = ErrorContext(path, _REMEDY)
    lines = read_lines(path)
    header = _header(lines)
    theta_i, phi_i = _incidence(header, context)
    words = re.fullmatch(r"theta\W+phi\W+(.*)", header.get("format", "theta phi BSDF"), re.IGNORECASE)
    kind = None if words is None else quantity_in_prose(words[1], "format", context)
    if kind is None:
        raise context.error(f"format '{header['format'][:40]}', expected theta phi DSF or theta phi BSDF")
    table = _rows(lines, context)
    notes: list[str] = []
    if "format" not in header:
        notes.append(Assumption("no line #format: values are taken as BSDF in 1/sr"))
    theta, phi = np.deg2rad(table[:, 0]), np.deg2rad(table[:, 1])
    values = table[:, 2:]
    if theta_i > 90.0:  # lit from behind: the sample is turned over
        theta_i, phi_i, theta, phi = 180.0 - theta_i, -phi_i, np.pi - theta, -phi
        notes.append("incidence beyond 90 degrees: the sample is turned over")
    above = np.cos(theta) > LEAST_COSINE
    if not np.all(above):
        notes.append(f"{int((~above).sum())} rows at or below the horizon are left out")
    if not np.any(above):
        raise context.error("only transmitted light, expected rows on the side of incidence")
    theta, phi, values = theta[above], phi[above], values[above]
    wi = np.tile(from_spherical(np.deg2rad(theta_i), np.deg2rad(phi_i)), (len(values), 1))
    wo = from_spherical(theta, phi)
    values = as_brdf(values, kind, wi, wo, notes)
    nm: Array | None = None
    if values.shape[1] == 3 and "xyz" in header.get("colorimetry", "xyz").lower():
        values = converted(values, notes)
    elif values.shape[1] == 1:
        comments = [line for line in lines if line.lstrip().startswith("#")]
        named = wavelength_nm(header.get("wavelength", ""))
        nm = unnamed_band(notes, context, comments) if named is None else np.array([named])
    else:
        raise context.error(f"rows of {values.shape[1]} values, expected 1, or 3 of CIE XYZ")
    name = header.get("sample_name") or path.stem
    return [Readings(name, "pab-opto", wi, wo, nm, values, notes=tuple(notes), repeatability=GONIOMETER)]


def _header(lines: list[str]) -> dict[str, str]:
    header: dict[str, str] = {}
    for line in lines:
        if line.lstrip().startswith("#"):
            key, value = re.match(r"#+\s*([\w-]*)\s*[:=]?\s*(.*)", line.strip()).groups()  # type: ignore[union-attr]
            header.setdefault(key.lower(), value.strip().strip('"'))
    return header


def _incidence(header: dict[str, str], context: ErrorContext) -> tuple[float, float]:
    """Return theta and phi of incidence in degrees."""
    texts = re.findall(_ANGLE, header.get("incident_angle", ""))
    if len(texts) < 2 and "intheta" in header:
        texts = [header["intheta"], header.get("inphi", "0")]
    values = [number_with_unit(text) for text in texts[:2]]
    angles = [m.value for m in values if m is not None and (not m.unit or angle_unit(m.unit) == "degrees")]
    if len(angles) < 2:
        raise context.error("no incidence found, expected a line '#incident_angle theta phi' in degrees")
    theta, phi = angles
    if not 0.0 <= theta <= 180.0:
        raise context.error(f"incident theta is {theta:g}, expected 0 to 180 degrees")
    return theta, phi


def _rows(lines: list[str], context: ErrorContext) -> Array:
    rows = data_lines(lines, marks=("#",))
    context.require_rows(rows)
    separator = find_separator([line for _, line in rows[:20]])
    width = len(split_cells(rows[0][1], separator))
    if width < 3:
        raise context.error(f"{width} cells, expected theta, phi and a value", f"line {rows[0][0]}")
    table = context.table(rows, separator, width)
    if np.any(table[:, 0] < 0.0) or np.any(table[:, 0] > 180.0):
        raise context.error("a theta outside 0 to 180 degrees, expected degrees from the normal")
    return table
