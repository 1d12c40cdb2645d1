"""Files of spectra: reflectances, lights and sensitivities of cameras, as columns of text.

Headings name the columns, their units and quantities (see `quantities`). Without headings, a file has the wavelength
in nm and one value. Also read: `.sed` (Spectral Evolution), `.spdx` (IES TM-27), `.sp` (Argyll, and PerkinElmer as
text).
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal, NamedTuple
from xml.etree import ElementTree

import numpy as np

from manifold.core import disk
from manifold.core.records import Array
from manifold.formats.column_heads import is_wavenumber, uncertainty_head, wavelength_unit
from manifold.formats.foreign import name_format
from manifold.formats.quantities import SpectrumKind, is_percent, spectrum_kinds
from manifold.formats.text import (
    CORRECT_CELL,
    ErrorContext,
    decode,
    find_separator,
    nanometres,
    number,
    split_cells,
)
from manifold.formats.values import LONGEST_NM, SHORTEST_NM, require_one_spectrum

Wanted = Literal["reflectance", "power", "sensitivity"]
_MICROMETRES = 100.0  # wavelengths without a unit are in micrometres below this, as in tables of readings
_DELETED = -1e30  # of USGS, whose mark is -1.23e34
_NUMBER_FIRST = re.compile(r'\s*"?[-+]?[.,]?\d')
_COUNTERS = {"chan", "channel", "band", "no", "nr", "index", "pixel", ""}  # columns that count
_PERCENT_OF_REFLECTANCE = re.compile(r"(refl\w*|\br)\W{0,3}(in\s+)?[(\[/]?\s*(%|per\s?cent)", re.IGNORECASE)
_WAVENUMBERS_ABOVE = re.compile(r"wavenumber|cm\s?\^?-1|1\s?/\s?cm|angstrom|\beV\b", re.IGNORECASE)
_CHANNELS = {"r": 0, "red": 0, "g": 1, "green": 1, "b": 2, "blue": 2}
_UNITS_LINE = re.compile(r"\s*([XY])[ _]?UNITS?\s*[:=,;\t ]\s*(\S.*)", re.IGNORECASE)
_WHOLE = "expected a text file of wavelengths and {}"
_HEADS = {
    "reflectance": "Wavelength (nm), Reflectance (%)",
    "power": "Wavelength (nm), Power",
    "sensitivity": "Wavelength (nm), red, green, blue",
}


class _Columns(NamedTuple):
    """The table of a file, with its headings.

    Attributes:
        heads: headings of all columns; empty if the file has none.
        values: shape (rows, columns), with NaN for cells that are no numbers.
        above: the text above the table.
    """

    heads: list[str]
    values: Array
    above: list[str]


def read_spectrum(path: Path, wanted: Wanted) -> tuple[Array, Array]:
    """Return wavelengths in nm, increasing, shape (B,), and values.

    Values are reflectances from 0 to 1 or powers, shape (B,), or sensitivities to red, green and blue, shape (B, 3).

    Raises:
        FileFormatError: the file is of another kind, its columns hold another quantity or several, wavelengths
            repeat, hold two spectra or are in another unit, or there are fewer than two.
        UsageError: the file cannot be read.
    """
    advice = _WHOLE.format(wanted)
    content = disk.read_bytes(path, advice=advice, most=disk.MOST_TEXT)
    context = ErrorContext(path, f"give it columns with headings such as '{_HEADS[wanted]}'")
    text = decode(content)
    if "\0" in text or text.startswith("##"):
        raise context.error(f"found {name_format(content[:4096])}, {advice}", remedy="export it as text")
    if "<iestm27" in text[:4000].lower():
        table = _spdx(text, context)
    elif re.match(r"\s*SPECT\s*\n", text):
        table = _argyll(text, context)
    elif re.match(r"PE\s", text):
        table = _perkin_elmer(text.split("\n"), wanted, context)
    else:
        table = _table(text.split("\n"), wanted, context)
    column, nm = _wavelengths(table, context)
    if wanted == "power" and any(is_wavenumber(head) for head in table.heads):
        raise context.error("power per wavenumber, expected power per wavelength", remedy="convert it")
    chosen = _chosen(table, [k for k in range(table.values.shape[1]) if k != column], wanted, context)
    kept = np.all(np.nan_to_num(table.values[:, chosen]) > _DELETED, axis=1)
    table, nm = table._replace(values=table.values[kept]), nm[kept]
    values = np.stack([_values(table, k, wanted, context) for k in chosen], axis=1)
    if len(nm) < 2:
        raise context.error(
            f"found {len(nm)} rows of wavelength and {wanted}, expected at least 2, such as 400;0.1"
        )
    require_one_spectrum(nm, context)
    order = np.argsort(nm)
    nm, values = nm[order], values[order]
    if not SHORTEST_NM <= nm[0] <= nm[-1] <= LONGEST_NM:
        said = f"as the heading '{table.heads[column][:40]}' says" if table.heads else "without a heading"
        raise context.error(
            f"wavelengths from {nm[0]:g} to {nm[-1]:g} nm, {said}, expected {SHORTEST_NM:g} to {LONGEST_NM:g} nm",
            remedy="correct the unit in the heading, such as Wavelength (um)",
        )
    return nm, values if wanted == "sensitivity" else values[:, 0]


def _table(lines: list[str], wanted: Wanted, context: ErrorContext) -> _Columns:
    """Return the table at the end of a text; the line above it may be its header, also as a comment."""
    data = [
        (k, line.strip())
        for k, line in enumerate(lines, start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    start = next((i for i, (_, line) in enumerate(data) if _is_row(line)), None)
    if start is None:
        raise context.error(f"found 0 rows of wavelength and {wanted}, expected at least 2, such as 400;0.1")
    separator = find_separator([line for _, line in data[start:]])
    rows = []
    width = len(_cells(data[start][1], separator))
    for k, line in data[start:]:
        cells = _cells(line, separator)
        values = [number(cell) for cell in cells]
        if len(cells) != width or width < 2 or None in values[:2]:
            raise context.error(
                f"line {k} is '{line[:40]}', expected a wavelength in nm and a {wanted}",
                remedy=CORRECT_CELL,
            )
        rows.append([np.nan if value is None else value for value in values])
    above = [line for line in lines[: data[start][0] - 1] if line.strip()]
    heads = _units_above(above, width)
    if above and not heads:
        is_comment = above[-1].lstrip().startswith("#")
        heads = _cells(above[-1].lstrip("# "), separator)
        if all(wavelength_unit(head) is None for head in heads) and (
            named := _named_above(above[:-1], width)
        ):
            return _Columns(named, np.array(rows), above)
        is_header = len(heads) == width and (
            not is_comment or any(wavelength_unit(head) is not None for head in heads)
        )
        if is_header and not is_comment and _NUMBER_FIRST.match(above[-1]):
            raise context.error(
                f"line {data[start][0] - 1} is '{above[-1].strip()[:40]}', expected a wavelength in nm and a {wanted}",
                remedy=CORRECT_CELL,
            )
        if not is_header and _WAVENUMBERS_ABOVE.search(above[-1]):
            raise context.error(
                f"found '{above[-1].strip()[:60]}' above {width} columns, expected a heading for each"
            )
        heads, above = (heads, above[:-1]) if is_header else ([], above)
    return _Columns(heads, np.array(rows), above)


def _units_above(above: list[str], width: int) -> list[str]:
    """Return the headings of two columns whose units are in lines above, as in JASCO files (`XUNITS`) and ECOSTRESS."""
    said = {found[1].upper(): found[2] for line in above if (found := _UNITS_LINE.match(line)) is not None}
    if not width == len(said) == 2:
        return []
    return [said["X"] if wavelength_unit(said["X"]) is not None else f"Wavelength ({said['X']})", said["Y"]]


def _named_above(above: list[str], width: int) -> list[str]:
    """Return the headings of columns that a line further above names, apart by several blanks, as in files of USGS."""
    lines = (re.split(r"\s{2,}|\t", line.strip()) for line in above)
    named = (heads for heads in lines if len(heads) == width > 2)
    return next((heads for heads in named if any(wavelength_unit(head) is not None for head in heads)), [])


def _cells(line: str, separator: str | None) -> list[str]:
    cells = split_cells(line, separator)
    while cells and not cells[-1]:  # trailing separators
        cells.pop()
    return cells


def _is_row(line: str) -> bool:
    """Return whether a line begins with two numbers."""
    cells = split_cells(line, find_separator([line]))[:2]
    return len(cells) == 2 and None not in map(number, cells)


def _wavelengths(table: _Columns, context: ErrorContext) -> tuple[int, Array]:
    """Return the column of wavelengths, and the wavelengths of its rows in nm."""
    units = {k: unit for k, head in enumerate(table.heads) if (unit := wavelength_unit(head)) is not None}
    if len(units) > 1:
        raise context.error(
            f"columns {', '.join(table.heads[k] for k in units)[:80]}, expected one of wavelengths"
        )
    if table.heads and not units:
        raise context.error(
            f"columns {', '.join(table.heads)[:80]}: expected one that is called Wavelength (nm) or Wavenumber (cm-1)"
        )
    column, unit = next(iter(units.items()), (0, ""))
    values = table.values[:, column]
    if not np.all(values > 0.0):
        raise context.error("found wavelengths of 0 or less, expected wavelengths in nm")
    nm = nanometres(values, unit or ("um" if values.max() < _MICROMETRES else "nm"))
    assert nm is not None  # `wavelength_unit` knows these units alone
    return column, nm


def _chosen(table: _Columns, columns: list[int], wanted: Wanted, context: ErrorContext) -> list[int]:
    """Return the columns that hold the wanted spectra: one, or those of red, green and blue."""
    count = 3 if wanted == "sensitivity" else 1
    if not table.heads:
        if len(columns) != count:
            raise context.error(
                f"{len(columns) + 1} columns without headings, expected {count + 1}, or headings that name them"
            )
        _require_kind(_said_above(table), " ".join(table.above), wanted, context)
        return columns
    heads = {k: table.heads[k] for k in columns if uncertainty_head(table.heads[k]) is None}
    if wanted == "sensitivity":
        return _in_channels(heads, context)
    kinds = {k: spectrum_kinds(head) for k, head in heads.items()}
    own = [k for k, kind in kinds.items() if kind and kind <= _suitable(wanted)]
    others = [k for k in heads if k not in own and _word(heads[k]) not in _COUNTERS]
    if not own and len(others) == 1 and not kinds[others[0]]:  # the name of a sample
        _require_kind(_said_above(table), " ".join(table.above), wanted, context)
        return others
    if len(own) != 1:
        raise context.error(f"columns {', '.join(heads.values())[:80]}: expected exactly one of {wanted}")
    return own


def _suitable(wanted: Wanted) -> set[SpectrumKind]:
    return {"reflectance", "log"} if wanted == "reflectance" else {wanted}


def _said_above(table: _Columns) -> set[SpectrumKind]:
    """Return the kinds of spectra that the line above the header or the values names."""
    return spectrum_kinds(table.above[-1]) if table.above else set()


def _require_kind(kinds: set[SpectrumKind], said: str, wanted: Wanted, context: ErrorContext) -> None:
    if kinds and not kinds & _suitable(wanted):
        raise context.error(f"found '{said.strip()[:60]}', expected {wanted}")


def _word(head: str) -> str:
    return "".join(filter(str.isalpha, head.lower()))


def _in_channels(heads: dict[int, str], context: ErrorContext) -> list[int]:
    """Return the columns of red, green and blue."""
    channel = {
        k: [_CHANNELS[word] for word in re.findall(r"[a-z]+", head.lower()) if word in _CHANNELS]
        for k, head in heads.items()
    }
    if sorted(c for own in channel.values() for c in own) != [0, 1, 2] or len(heads) != 3:
        raise context.error(
            f"columns {', '.join(heads.values())[:80]}: expected one each of red, green and blue"
        )
    return sorted(heads, key=lambda k: channel[k])


def _values(table: _Columns, column: int, wanted: Wanted, context: ErrorContext) -> Array:
    """Return the values of a column; reflectances as fractions."""
    values = table.values[:, column]
    if not np.all(np.isfinite(values)):
        row = int(np.argmin(np.isfinite(values)))
        raise context.error(
            f"no {wanted} in row {row + 1} of the table, expected one at every wavelength",
            remedy=CORRECT_CELL,
        )
    if wanted != "reflectance":
        return values
    head = table.heads[column] if table.heads else ""
    if "log" in spectrum_kinds(head):
        return np.asarray(10.0**-values)
    is_silent = not spectrum_kinds(head)
    said_above = is_silent and any(_PERCENT_OF_REFLECTANCE.search(line) for line in table.above[-1:])
    return values / 100.0 if is_percent(head) or said_above else values


def _spdx(text: str, context: ErrorContext) -> _Columns:
    """Read a spectrum of IES TM-27: XML with the elements `SpectralQuantity` and `SpectralData`."""
    if "<!doctype" in text.lower() or "<!ENTITY" in text:
        raise context.error("a document type with entities, expected plain XML of IES TM-27")
    try:
        root = ElementTree.fromstring(text.strip())
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise context.error(f"not a readable .spdx ({' '.join(str(error).split())[:80]})") from None
    spectra = root.findall("{*}SpectralDistribution")
    if len(spectra) != 1:
        raise context.error(f"{len(spectra)} spectra, expected one SpectralDistribution")
    quantity = spectra[0].findtext("{*}SpectralQuantity", "").strip()
    rows = [
        [
            context.number(item.get("wavelength", ""), "SpectralData"),
            context.number(item.text or "", "SpectralData"),
        ]
        for item in spectra[0].iterfind("{*}SpectralData")
    ]
    head = "power" if quantity.lower() == "relative" else quantity or "value"
    return _Columns(["Wavelength (nm)", head], np.array(rows).reshape(-1, 2), [])


def _argyll(text: str, context: ErrorContext) -> _Columns:
    """Read a spectrum of Argyll (CGATS of the type SPECT), one set; its `SPECTRAL_NORM` is the value of 100 %."""
    said = dict(re.findall(r'^(\w+)\s+"([^"]*)"', text, re.MULTILINE))
    fields = re.search(r"BEGIN_DATA_FORMAT\s+(.*?)\s+END_DATA_FORMAT", text, re.DOTALL)
    data = re.search(r"BEGIN_DATA\s+(.*?)\s+END_DATA\b", text, re.DOTALL)
    if fields is None or data is None:
        raise context.error("no BEGIN_DATA_FORMAT and BEGIN_DATA, expected a spectrum of Argyll")
    values = [context.number(cell, "BEGIN_DATA") for cell in data[1].split()]
    names = fields[1].split()
    nm = [context.number(name.rpartition("_")[2], "BEGIN_DATA_FORMAT") for name in names]
    if len(values) != len(names):
        raise context.error(f"{len(values)} values of {len(names)} bands, expected one set")
    norm = context.number(said.get("SPECTRAL_NORM", "1"), "SPECTRAL_NORM")
    if norm <= 0.0:
        raise context.error(f"SPECTRAL_NORM is {norm:g}, expected a value above 0")
    kind = said.get("MEAS_TYPE", "")
    kinds = {"REFLECTIVE": "reflectance", "TRANSMISSIVE": "transmittance"}
    head = kinds.get(kind, kind.lower().replace("ambient", "emission") or "value")
    return _Columns(["Wavelength (nm)", head], np.column_stack([nm, np.array(values) / norm]), [])


def _perkin_elmer(lines: list[str], wanted: Wanted, context: ErrorContext) -> _Columns:
    """Read a spectrum of PerkinElmer as text: below `#GR` the units of both columns, below `#DATA` the rows."""
    marks = [line.strip() for line in lines]
    if "#GR" not in marks or "#DATA" not in marks or marks.index("#GR") + 2 >= len(marks):
        raise context.error("no sections #GR and #DATA, expected a spectrum of PerkinElmer as text")
    heads = [marks[marks.index("#GR") + k] for k in (1, 2)]
    table = _table(lines[marks.index("#DATA") + 1 :], wanted, context)
    return _Columns(heads, table.values, [])
