"""Workbooks `.xls` of the RT-300S (J&C): a column per measurement, with rows Azimuth, Incidence, Receive, RT.

Angles are in degrees. Light comes from azimuth 180; the receiver's plane has the azimuth 90 + Azimuth, and Receive is
the signed angle from the normal in this plane. RT is the reflected intensity relative to a perfect diffuser seen
along its normal, in one band.

Source: the processing of such files in ua-loft/bsdf-tools (University of Arizona): f = RT / (pi cos Receive).
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from manifold.core.defaults import GONIOMETER
from manifold.core.directions import from_spherical
from manifold.core.extras import require
from manifold.core.records import Array
from manifold.formats.quantities import LEAST_COSINE
from manifold.formats.readings import Readings, mean_of_repeats
from manifold.formats.text import ErrorContext, read_bytes
from manifold.formats.values import unnamed_band

_REMEDY = "export the measurement again, or save another workbook as .xlsx"
_LARGEST = 20_000_000  # bytes; ten thousand measurements have two million
_ROWS = ("Azimuth", "Incidence", "Receive", "RT")
_OBSCURED = np.cos(np.deg2rad(10.0))  # this near to the light the receiver stands in its way
_NOISE = -1.0  # least value of RT, which is at most 1 for a perfect diffuser


def sniff(head: bytes) -> bool:
    """Return whether a file is an old Office file, as these workbooks are; `read` checks its rows."""
    return head.startswith(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1")


def read(path: Path) -> list[Readings]:
    """Read the readings of all sheets, one record per specimen."""
    context = ErrorContext(path, _REMEDY)
    table = _table(path, context)
    azimuth, incidence, receive = np.deg2rad(table[:3])
    signal = table[3]
    if np.min(signal) < _NOISE:
        raise context.error(
            f"RT is {np.min(signal):g} to {np.max(signal):g}: counts of the detector, expected intensities relative "
            "to a perfect diffuser",
            remedy="calibrate the instrument before measuring",
        )
    notes = ["no blank measurement is subtracted"]
    wi, wo = from_spherical(incidence, np.pi), from_spherical(receive, 0.5 * np.pi + azimuth)
    is_reflected = (wo[:, 2] > LEAST_COSINE) & (wi[:, 2] > LEAST_COSINE)
    is_clear = np.einsum("pi,pi->p", wi, wo) < _OBSCURED
    for count, why in (
        (int((~is_reflected).sum()), "at or below the horizon"),
        (
            int((is_reflected & ~is_clear).sum()),
            "within 10 degrees of the light, which the receiver obscures,",
        ),
    ):
        if count:
            notes.append(f"{count} readings {why} are left out")
    kept = is_reflected & is_clear
    if not np.any(kept):
        raise context.error("no reading of reflected light, expected Incidence and Receive below 90 degrees")
    f = signal[kept] / (np.pi * wo[kept, 2])
    nm = unnamed_band(notes, context)
    wi, wo, values, scatter, repeats = mean_of_repeats(wi[kept], wo[kept], f[:, None])
    return [
        Readings(
            path.stem, "RT-300S", wi, wo, nm, values, notes=(*notes, *repeats), scatter=scatter,
            repeatability=GONIOMETER,
        )
    ]  # fmt: skip


def _table(path: Path, context: ErrorContext) -> Array:
    """Return Azimuth, Incidence, Receive and RT of all measurements, shape (4, P)."""
    xlrd = require("xlrd")

    data = read_bytes(path, _LARGEST)
    try:
        book = xlrd.open_workbook(file_contents=data, logfile=io.StringIO(), ragged_rows=True)
        sheets = [
            (
                sheet.name,
                {str(row[0]).strip(): row[1:] for k in range(sheet.nrows) if (row := sheet.row_values(k))},
            )
            for sheet in book.sheets()
        ]
    except Exception as error:  # xlrd raises whatever its parsers do
        reason = " ".join(str(error).split())[:80] or type(error).__name__
        raise context.error(f"not a readable .xls workbook ({reason})") from None
    tables = []
    for title, rows in sheets:
        if not rows:
            continue
        missing = [name for name in _ROWS if name not in rows]
        if missing:
            raise context.error(
                f"no row {missing[0]}, expected an RT-300S with {', '.join(_ROWS)}", f"sheet '{title}'"
            )
        columns = [rows[name] for name in _ROWS]
        if len({len(cells) for cells in columns}) > 1 or not columns[0]:
            raise context.error(f"rows {', '.join(_ROWS)} of different lengths", f"sheet '{title}'")
        tables.append(
            [
                [context.number(str(c), f"sheet '{title}', {n}") for c in cells]
                for n, cells in zip(_ROWS, columns, strict=True)
            ]
        )
    if not tables:
        raise context.error(f"an empty workbook, expected an RT-300S with rows {', '.join(_ROWS)}")
    return np.concatenate(tables, axis=1)
