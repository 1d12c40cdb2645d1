"""Tables like those of ASTM E1392: `KEY value` lines, a line `VARS theta_i,phi_i,theta_s,phi_s,...`, then rows.

Angles are in radians, measured from the normal; values are the BRDF in 1/sr. Goniometers such as the Mini-Diff V2
(Light Tec, Synopsys) write such files.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from manifold.core import disk
from manifold.core.defaults import GONIOMETER, MINI_DIFF_SEES_DEG
from manifold.core.errors import ShapeError
from manifold.core.names import in_one_line
from manifold.core.records import Array
from manifold.formats.column_heads import (
    angle_names,
    angle_unit,
    is_percent,
    quantity,
    uncertainty_head,
    value_head,
    wavelength,
)
from manifold.formats.csv_table import angles_deg, band_heads
from manifold.formats.geometries import directions, exceed_radians
from manifold.formats.quantities import BRDF, FACTORS, I_OVER_F, Quantity, quantity_in_prose
from manifold.formats.readings import Assumption, Readings
from manifold.formats.text import (
    MOST_ROWS,
    ErrorContext,
    data_lines,
    decode,
    find_separator,
    read_lines,
    split_cells,
    wavelength_nm,
)
from manifold.formats.values import (
    TAKEN_AS_BRDF,
    as_brdf,
    assumed_unit,
    bands_of,
    named_wavelength,
    relative_uncertainties,
    weights_of,
)

_REMEDY = "export the table again"
_STEEP_INCIDENCE, _STEEP_WEIGHT = np.deg2rad(50.0), 0.5  # its incidence of 60 degrees is less reliable


@dataclass(frozen=True)
class _Columns:
    """The columns of the rows, in order: names of angles, headings of bands, and of uncertainties.

    Attributes:
        kind: the quantity of the values; None if the file names none.
        white: the value of the perfect diffuser, if the values are reflectance factors.
    """

    names: list[str]
    bands: list[str]
    uncertain: list[str]
    is_degrees: bool | None
    kind: Quantity | None
    white: float


def sniff(head: bytes) -> bool:
    """Return whether a file's beginning has a `VARS` line, or the header of one."""
    text = decode(head)
    return re.search(r"^\s*(VARS?|NUM_POINTS|LAB_NAME)\b", text, re.MULTILINE | re.IGNORECASE) is not None


def read(path: Path) -> list[Readings]:
    """Return the readings of the table, as one record."""
    context = ErrorContext(path, _REMEDY)
    lines = read_lines(path)
    start = next((k for k, line in enumerate(lines) if re.match(r"\s*VARS?\b", line, re.IGNORECASE)), None)
    if start is None:
        raise context.error("no line VARS found, expected one that names the columns")
    header = _header(lines[:start])
    measured = header.get("MEAS_NAME", "")
    heads = re.sub(r"(?i)^\s*VARS?\b[\s:=]*", "", lines[start])
    columns = _columns(heads, measured, context, f"line {start + 1}")
    is_mini_diff = re.search(r"mini[\s_-]*diff", " ".join(header.values()), re.IGNORECASE) is not None
    columns = _wavelength_of_header(columns, header, lines[:start], context)
    table, notes, columns = _rows(lines, start + 1, columns, context)
    announced = header.get("NUM_POINTS")
    if announced is not None:
        expected = context.count(announced, "NUM_POINTS", MOST_ROWS)
        if len(table) < expected:
            raise context.error(f"{len(table)} rows, expected {expected} (NUM_POINTS): the file is truncated")
        if len(table) > expected:
            notes.append(f"NUM_POINTS is {expected}, but the file has {len(table)} rows: all are used")
    name = header.get("SAMPLE_NAME") or path.stem
    instrument = header.get("SYSTEM_NAME") or "goniometer (ASTM table)"
    return [_readings(table, columns, name, instrument, is_mini_diff, notes, context)]


def _header(lines: list[str]) -> dict[str, str]:
    """Return the header's keys in upper case, and its values without quotes."""
    header = {}
    for line in lines:
        key, _, value = line.strip().replace("\t", " ").partition(" ")
        if key:
            header[key.upper().rstrip(":=")] = value.strip().lstrip(":=").strip().strip('"').strip()
    return header


def _columns(text: str, measured: str, context: ErrorContext, where: str) -> _Columns:
    """Return the columns that the line VARS names; `measured` is the MEAS_NAME, which names the quantity."""
    heads = split_cells(text, find_separator([text]))
    names, bands, uncertain = list[str](), list[str](), list[str]()
    for angle, head in zip(angle_names(heads), heads, strict=True):
        if angle is not None and angle in names:
            raise context.error(f"{angle} appears twice, expected each angle once", where)
        if angle is None:
            (bands if uncertainty_head(head) is None else uncertain).append(head)
        names.append(angle or head)
    if not bands:
        bands, uncertain = uncertain, bands
    missing = [name for name in ("theta_i", "theta_o") if name not in names]
    if missing or not bands:
        raise context.error(
            f"columns {', '.join(heads[:8])}, expected theta_i, phi_i, theta_s, phi_s and bands such as 465nm",
            where,
        )
    if len(bands) == 1 and value_head(re.sub(r"_\d$", "", bands[0])) is None:  # BRDF_1 is no wavelength
        raise context.error(
            f"column {bands[0][:24]}, expected values with a heading such as 465nm or BRDF", where
        )
    unit = angle_unit([head for head in heads if head not in (*bands, *uncertain)], context, where)
    # Goniometers call the measurement "Reflectance" where it is no transmission, whatever the values are.
    is_side = re.fullmatch(r"refl(ectance|ection|ected)\W*", measured.strip(), re.IGNORECASE) is not None
    kind = None if is_side else quantity_in_prose(measured, "MEAS_NAME", context)
    of_heads = quantity(bands, context, where)
    if kind is not None and of_heads is not None and kind != of_heads:
        raise context.error(
            f"MEAS_NAME names {kind.title}, VARS {of_heads.title}, expected one quantity", where
        )
    percent = is_percent([*bands, measured])
    kind = kind or of_heads or (FACTORS if percent else None)
    if percent and kind not in (FACTORS, I_OVER_F):
        raise context.error(f"percent of {(kind or BRDF).title}, expected reflectance factors", where)
    is_degrees = None if unit is None else unit == "degrees"
    return _Columns(names, bands, uncertain, is_degrees, kind, 100.0 if percent else 1.0)


def _wavelength_of_header(
    columns: _Columns, header: dict[str, str], lines: list[str], context: ErrorContext
) -> _Columns:
    """Return the columns, with the header's wavelength for a single band."""
    if len(columns.bands) != 1 or wavelength(columns.bands[0]):
        return columns
    nm = wavelength_nm(header.get("WAVELENGTH", "")) or named_wavelength(lines, context)
    if nm is None:
        return columns
    band = f"{nm:g}nm"
    names = [band if name in columns.bands else name for name in columns.names]
    return replace(columns, names=names, bands=[band])


def _rows(
    lines: list[str], start: int, columns: _Columns, context: ErrorContext
) -> tuple[Array, list[str], _Columns]:
    """Return the table of numbers, the notes, and the columns that `VARS` omits."""
    numbered = data_lines(lines[start:], start + 1)
    while numbered and re.fullmatch(r"\s*(END|EOF|DATA_?END)\s*", numbered[-1][1], re.IGNORECASE):
        numbered.pop()
    if numbered and re.fullmatch(r"\s*(DATA|BEGIN|DATA_?BEGIN)\s*", numbered[0][1], re.IGNORECASE):
        numbered = numbered[1:]
    if not numbered:
        raise context.error("no rows below VARS, expected one per direction pair")
    separator = find_separator([line for _, line in numbered[:20]])
    width = len(split_cells(numbered[0][1], separator))
    notes: list[str] = []
    if width == len(columns.names) + 1 and "phi_o" not in columns.names:
        after = columns.names.index("theta_o") + 1
        columns = replace(columns, names=[*columns.names[:after], "phi_o", *columns.names[after:]])
        notes.append(
            f"VARS names {width - 1} columns, rows have {width}: the one after theta_s is taken as phi_s"
        )
    if width != len(columns.names):
        raise context.error(
            f"{width} cells, expected {len(columns.names)} as VARS says", f"line {numbered[0][0]}"
        )
    return context.table(numbered, separator, width), notes, columns


def _readings(
    table: Array,
    columns: _Columns,
    name: str,
    instrument: str,
    is_mini_diff: bool,
    notes: list[str],
    context: ErrorContext,
) -> Readings:
    others = (*columns.bands, *columns.uncertain)
    angle = {name: table[:, k] for k, name in enumerate(columns.names) if name not in others}
    is_degrees = columns.is_degrees
    if is_degrees is None:
        is_degrees = exceed_radians(angle)
        if is_degrees:
            notes.append(Assumption("angles beyond pi: taken as degrees"))
    if is_degrees:
        angle = {key: np.deg2rad(values) for key, values in angle.items()}
    if is_mini_diff:
        padded = (np.abs(angle["theta_o"]) > np.deg2rad(MINI_DIFF_SEES_DEG) + 1e-4) & (
            np.abs(angle["theta_o"]) < 0.5 * np.pi + 1e-4
        )
        table, angle = table[~padded], {key: values[~padded] for key, values in angle.items()}
        if np.any(padded):
            notes.append(f"{int(padded.sum())} rows beyond 75 degrees are padding of the Mini-Diff, not data")
    keep, wi, wo = directions(angle, context, notes)
    first = [k for k, head in enumerate(columns.names) if head in columns.bands]
    raw, kind, white = table[keep][:, first], columns.kind, columns.white
    assumed = None if kind is not None else assumed_unit([(wi, wo, raw)], context)
    if assumed is not None:
        kind, white = assumed.quantity, assumed.white
        if assumed.note != TAKEN_AS_BRDF:  # which the standard means
            notes.append(assumed.note)
    values = as_brdf(raw, kind or BRDF, wi, wo, notes, white)
    uncertain = {head: table[keep][:, columns.names.index(head)] for head in columns.uncertain}
    said = weights_of(
        relative_uncertainties(uncertain, columns.bands, raw, kind or BRDF, white, notes, context)
    )
    nm, values = bands_of(columns.bands, values, notes, context)
    weighed: dict[str, Any] = {"weights": np.ones(len(wi)), "repeatability": GONIOMETER}
    if said is not None:
        notes.append(said.note)
        weighed = said.readings
    if is_mini_diff:
        weighed["weights"][np.abs(angle["theta_i"][keep]) > _STEEP_INCIDENCE] = _STEEP_WEIGHT
    if np.any(values < 0):
        count = int((values < 0).sum())
        are = "value is" if count == 1 else "values are"
        notes.append(f"{count} {are} negative, down to {np.nanmin(values):.3g}; they are kept as noise")
    return Readings(
        name, instrument, wi, wo, nm, values, notes=tuple(notes),
        assumed_unit=None if assumed is None else assumed.unit, **weighed,
    )  # fmt: skip


def write(path: Path, readings: Readings) -> None:
    """Write readings as a table in radians, with azimuths from 0 to 2 pi, in the order of the readings."""
    if not np.all(readings.measured):
        raise ShapeError(f"{readings.name}: some values are missing, expected all; select other pairs")
    lines = [
        f"SAMPLE_NAME {_quoted(readings.name)}", f"SYSTEM_NAME {_quoted(readings.instrument)}", 'MEAS_NAME "BRDF"',
        f"NUM_POINTS {len(readings)}", "VARS theta_i,phi_i,theta_s,phi_s," + ",".join(band_heads(readings)),
    ]  # fmt: skip
    table = np.hstack([np.deg2rad(angles_deg(readings)), readings.values])
    lines += [",".join(f"{value:.9g}" for value in row) for row in table]
    disk.write_text(path, "\n".join(lines) + "\n")


def _quoted(name: str) -> str:
    return '"' + in_one_line(name).replace('"', "'") + '"'
