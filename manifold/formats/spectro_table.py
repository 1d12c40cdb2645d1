"""Tables of multi-angle spectrophotometers: rows of geometries, columns of wavelengths, or the other way round.

What workbooks and CSV files share: cells in, readings out. Values are reflectance factors R, f = R / pi.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from manifold.directions import from_spherical
from manifold.formats.geometry_names import geometry_directions, parse_aspecular, parse_geometry
from manifold.formats.readings import Readings, aspecular_pair
from manifold.formats.text import Place, number, plain_float
from manifold.records import Array

Cell = str | float | int | None
_HEADER_ROWS = 60  # a header stands at the top, below titles
_LEAST_NM, _MOST_NM = 200.0, 5000.0
_WAVELENGTH = re.compile(
    r"^\D{0,12}?(?P<nm>\d{3,4}([.,]\d+)?)\s*(nm|\(nm\)|\[nm\])?\s*(\(.*\)|\[.*\]|%)?$", re.IGNORECASE
)
_TITLE_IN_PERCENT = re.compile(r"\b(reflectance|unit)\w*\W{0,4}(in )?(%|per ?cent)|% ?reflect", re.IGNORECASE)
_ANGLES = (
    ("theta_i", ("thetai", "thetain", "incidenttheta", "intheta", "aoi", "incidence")),
    ("phi_i", ("phii", "phiin", "incidentphi", "inphi", "poi")),
    ("theta_o", ("thetao", "thetas", "thetar", "thetaout", "outgoingtheta", "theta")),
    ("phi_o", ("phio", "phis", "phir", "phiout", "outgoingphi", "phi")),
)
_NAMES = (
    "samplename", "sample", "name", "dataname", "measurementname", "sampleid", "sampleno", "trialname", "trial",
    "batchname", "batch", "standardname", "standard", "materialname", "material", "colorname", "colourname", "id",
)  # fmt: skip  # heads of columns of names, the best first
PERCENT_FROM = 2.0  # reflectance factors away from the mirror direction are below this, percentages above
PERCENT_ANYWHERE = 30.0  # 15 degrees from it, where these instruments see most, even chrome stays below this

TAKEN_AS_PERCENT = (
    "no unit given: values above 2 away from the mirror direction, or above 30, taken as percent"
)
"""Note of readings that `looks_like_percent`."""


@dataclass(frozen=True)
class _Header:
    """A table's header: where it stands, and what its columns are."""

    row: int
    bands: dict[int, float]  # column: nm; RGB channels are 0, 1, 2 with is_rgb
    is_rgb: bool
    geometry: int | None
    angles: dict[str, int]
    name: int | None
    unit: str  # `f`, `percent` or `unknown`
    is_aspecular: bool = False  # geometries are aspecular angles alone, as in 15, 25, 45


def read_table(
    rows: Sequence[Sequence[Cell]], place: Place, name: str, instrument: str, *, is_sheet: bool = False
) -> list[Readings]:
    """Readings of every sample of a table, in its order.

    Args:
        rows: cells; texts that are numbers count as numbers.
        place: of errors.
        name: of the sample where the table has no column of names.
        instrument: for the record.
        is_sheet: whether rows end at their last cell that is not empty, as those of workbooks do.
    Raises:
        FileFormatError: no header is found, or a cell is not what its column holds.
    """
    header = _find_header(rows)
    if header is None:
        turned = [list(column) for column in zip(*_rectangular(rows), strict=True)] if rows else []
        header = _find_header(turned)
        if header is None:
            raise place.error(
                "no table of reflectance found, expected columns of wavelengths beside a column of geometries "
                "such as 45as15, or of theta_i, phi_i, theta_o, phi_o"
            )
        rows = turned
    order = sorted(header.bands, key=header.bands.__getitem__)
    nm = [header.bands[column] for column in order]
    if any(b <= a for a, b in pairwise(nm)):
        raise place.error(
            "two columns of the same wavelength, expected different ones", f"row {header.row + 1}"
        )
    titles = [_text(cell) for row in rows[: header.row] for cell in row]
    if header.unit == "unknown" and any(map(_TITLE_IN_PERCENT.search, titles)):
        header = replace(header, unit="percent")
    samples: dict[str, list[tuple[Array, Array, list[float]]]] = {}
    last, percent = name, header.unit == "percent"
    for index in range(header.row + 1, len(rows)):
        row = rows[index]
        where = f"row {index + 1}"
        if not any(_text(cell) for cell in row):
            continue
        directions = _directions(row, header, place, where)
        if directions is None:
            if any(number(_text(row[c])) is not None for c in order if c < len(row)):
                raise place.error(f"values {_geometry_text(row, header)}, expected one such as 45as15", where)
            continue  # a footnote, a title
        if header.name is not None and header.name < len(row) and _text(row[header.name]):
            last = _text(row[header.name])
        if is_sheet:
            row = [*row, *[None] * (max(order) + 1 - len(row))]
        values = [_value(row, column, percent, place, f"{where}, column {column + 1}") for column in order]
        samples.setdefault(last, []).append((*directions, values))
    if not samples:
        raise place.error(
            "a header but no rows of readings, expected one per geometry", f"row {header.row + 1}"
        )
    return [_sample(key, instrument, found, header, nm, place) for key, found in samples.items()]


def _sample(
    name: str,
    instrument: str,
    rows: list[tuple[Array, Array, list[float]]],
    header: _Header,
    nm: list[float],
    place: Place,
) -> Readings:
    wi, wo = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
    values = np.array([row[2] for row in rows])
    if not np.any(np.isfinite(values)):
        raise place.error(f"sample '{name[:40]}' has no values, expected reflectance")
    notes = ["aspecular angles alone: the light is taken at 45 degrees"] if header.is_aspecular else []
    wi, wo, values, repeats = _mean_of_repeats(wi, wo, values)
    if repeats:
        notes.append(f"{repeats} rows repeat a geometry: their means are taken")
    if (
        header.is_rgb
        and header.unit != "f"
        and np.nanmax(values) > 1.0
        and np.all(np.nan_to_num(values) % 1.0 == 0.0)
    ):
        raise place.error(
            f"sample '{name[:40]}' has whole R, G, B up to {np.nanmax(values):g}: colours of a display, "
            "expected reflectance"
        )
    if header.unit != "f":
        percent = header.unit == "percent"
        if not percent and looks_like_percent(wi, wo, values):
            percent = True
            notes.append(TAKEN_AS_PERCENT)
        elif header.unit == "unknown" and not percent:
            notes.append("no unit given: taken as reflectance factors, 1 being the perfect diffuser")
        values = values / (100.0 * np.pi if percent else np.pi)
    if np.any(np.isnan(values)):
        notes.append(f"{int(np.isnan(values).sum())} empty cells are not measured")
    return Readings(
        name, instrument, wi, wo, None if header.is_rgb else np.array(nm), values, notes=tuple(notes)
    )


def looks_like_percent(wi: Array, wo: Array, values: Array) -> bool:
    """Whether values are too large for reflectance factors, away from the mirror direction or anywhere."""
    mirror = np.einsum("pi,pi->p", wi * [-1.0, -1.0, 1.0], wo)
    off = np.nan_to_num(values[mirror < np.cos(np.deg2rad(40.0))])
    return bool(np.max(off, initial=0.0) > PERCENT_FROM or np.max(np.nan_to_num(values)) > PERCENT_ANYWHERE)


def _mean_of_repeats(wi: Array, wo: Array, values: Array) -> tuple[Array, Array, Array, int]:
    """Readings with one row per direction pair, in order of first appearance, and how many rows went into others."""
    keys = np.round(np.hstack([wi, wo]), 9)
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    inverse = inverse.reshape(-1)
    if first.size == len(keys):
        return wi, wo, values, 0
    measured = np.isfinite(values)
    totals = np.zeros((first.size, values.shape[1]))
    counts = np.zeros_like(totals)
    np.add.at(totals, inverse, np.where(measured, values, 0.0))
    np.add.at(counts, inverse, measured)
    means = np.divide(totals, counts, out=np.full_like(totals, np.nan), where=counts > 0)
    order = np.argsort(first)
    return wi[first[order]], wo[first[order]], means[order], len(keys) - first.size


def _find_header(rows: Sequence[Sequence[Cell]]) -> _Header | None:
    for index, row in enumerate(rows[:_HEADER_ROWS]):
        header = _parse_header(index, row, rows[index + 1 : index + 4])
        if header is not None:
            return header
    return None


def _parse_header(index: int, row: Sequence[Cell], below: Sequence[Sequence[Cell]]) -> _Header | None:
    texts = [_text(cell) for cell in row]
    plain = [re.sub(r"[^a-z]", "", re.sub(r"\(.*?\)|\[.*?\]", "", text.lower())) for text in texts]
    angles = {name: k for name, spellings in _ANGLES for k, text in enumerate(plain) if text in spellings}
    has_angles = {"theta_i", "theta_o"} <= set(angles)
    geometry = _geometry_column(plain, below)
    if geometry is None and not has_angles:
        return None
    if geometry is not None and parse_geometry(texts[geometry]) is not None:
        return None  # a row of readings
    taken = {geometry, *angles.values()}
    bands = {
        k: nm for k, text in enumerate(texts) if k not in taken and (nm := parse_wavelength(text)) is not None
    }
    is_rgb = False
    if not bands:
        bands = {plain.index(c): float(k) for k, c in enumerate("rgb") if c in plain}
        is_rgb = len(bands) == 3
        if not is_rgb:
            return None
    name = next((plain.index(head) for head in _NAMES if head in plain), None)
    is_aspecular = geometry is not None and _all_cells(below, geometry, parse_aspecular)
    joined = " ".join(texts).lower()
    if "1/sr" in joined or "sr^-1" in joined or "sr-1" in joined or (has_angles and "brdf" in joined):
        unit = "f"
    elif (
        "%" in joined
        or "percent" in joined
        or any(_text(c).endswith("%") for cells in below for c in cells)
        or any(
            "%" in _text(cells[geometry]) for cells in below if geometry is not None and geometry < len(cells)
        )
    ):
        unit = "percent"
    else:
        unit = "f" if has_angles and geometry is None else "unknown"
    return _Header(index, bands, is_rgb, geometry, angles, name, unit, is_aspecular)


def _geometry_column(heads: list[str], below: Sequence[Sequence[Cell]]) -> int | None:
    """The column that is called so, or holds nothing but geometries in the next rows."""
    for k, head in enumerate(heads):
        is_angle = head.startswith(("angle", "aspecular", "wavelength")) or head in ("nm", "winkel")
        if (
            head.startswith("geometr")
            or _all_cells(below, k, parse_geometry)
            or (is_angle and _all_cells(below, k, parse_aspecular))
        ):
            return k
    return None


def _all_cells(rows: Sequence[Sequence[Cell]], column: int, parse: Callable[[str], object]) -> bool:
    """Whether a column has cells and `parse` understands every one."""
    cells = [_text(row[column]) for row in rows if column < len(row) and _text(row[column])]
    return bool(cells) and all(parse(cell) is not None for cell in cells)


def _geometry_text(row: Sequence[Cell], header: _Header) -> str:
    text = _text(row[header.geometry]) if header.geometry is not None and header.geometry < len(row) else ""
    return f"at geometry '{text[:24]}'" if text else "without a geometry"


def parse_wavelength(text: str) -> float | None:
    """The wavelength in nm that a column's head names, or None."""
    found = _WAVELENGTH.match(text)
    if found is None:
        return None
    nm = float(found["nm"].replace(",", "."))
    return nm if _LEAST_NM <= nm <= _MOST_NM else None


def _directions(row: Sequence[Cell], header: _Header, place: Place, where: str) -> tuple[Array, Array] | None:
    if header.geometry is not None and header.geometry < len(row):
        text = _text(row[header.geometry])
        if not text:
            return None
        aspecular = parse_aspecular(text) if header.is_aspecular else None
        found = geometry_directions(text) if aspecular is None else aspecular_pair(45.0, aspecular)
        if found is None and parse_geometry(text) is not None:
            raise place.error(
                f"geometry '{text[:24]}' lies below the horizon, expected one such as 45as15", where
            )
        if found is None and any(c.isdigit() for c in text) and "as" in text.lower():
            raise place.error(f"found geometry '{text[:24]}', expected one such as 45as15", where)
        return found
    if not header.angles:
        return None
    texts = {name: _text(row[k]) if k < len(row) else "" for name, k in header.angles.items()}
    if not any(texts.values()):
        return None
    angle = {name: np.deg2rad(place.number(text, f"{where}, {name}")) for name, text in texts.items()}
    for name in ("theta_i", "theta_o"):
        if abs(angle[name]) > 0.5 * np.pi + 1e-6:
            raise place.error(
                f"{name} is {np.rad2deg(angle[name]):g}, expected degrees from -90 to 90", where
            )
    wi = from_spherical(angle["theta_i"], angle.get("phi_i", np.pi))
    wo = from_spherical(angle["theta_o"], angle.get("phi_o", 0.0))
    wi[2], wo[2] = max(wi[2], 0.0), max(wo[2], 0.0)
    return wi, wo


def _value(row: Sequence[Cell], column: int, percent: bool, place: Place, where: str) -> float:
    if column >= len(row):
        raise place.error(f"the row ends after {len(row)} cells, expected a value", where)
    cell = row[column]
    value = plain_float(cell) if isinstance(cell, str) else float("nan")
    if abs(value) < 1e300:
        return value
    text = _text(cell)
    if percent:
        text = text.removesuffix("%").rstrip()
    if text.lower() in ("", "-", "n/a", "---"):
        return float("nan")
    return place.number(text, where)


def _text(cell: Cell) -> str:
    if cell is None:
        return ""
    if isinstance(cell, float):
        return repr(cell)
    return str(cell).strip()


def _rectangular(rows: Sequence[Sequence[Cell]]) -> list[list[Cell]]:
    width = max((len(row) for row in rows), default=0)
    if width * len(rows) > 5_000_000:
        return []
    return [[*row, *[None] * (width - len(row))] for row in rows]
