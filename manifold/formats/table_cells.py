"""Cells of workbooks and CSV files: their texts, the wavelengths that heads name, and where they stand."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from manifold.formats.readings import GLOSS_ANGLES_DEG

Cell = str | float | int | None
HEADER_ROWS = 60
"""A header stands at the top, below titles."""

NO_VALUE = ("", "-", "n/a", "---")
"""Cells that say, in lower case, that nothing was measured."""

_LEAST_NM, _MOST_NM = 200.0, 5000.0
_WAVELENGTH = re.compile(
    r"^\D{0,12}?((?P<nm>\d{3,4}([.,]\d+)?)\s*(nm|\(nm\)|\[nm\])?|(?P<um>\d{0,2}[.,]\d+)\s*[(\[]?(um|µm|μm|microns?)[)\]]?)"
    r"\s*(\(.*\)|\[.*\]|%)?$",
    re.IGNORECASE,
)
_GLOSS = re.compile(
    r"\W*((?P<before>\d+)\W*(deg(rees?)?)?\W*)?(gloss|glanz|GU)(\s*(units?|value))?"
    r"\W*((?P<behind>\d+)\W*(deg(rees?)?)?\W*)?(GU|units?)?\W*",
    re.IGNORECASE,
)
_USUAL_GLOSS_DEG = 60.0
_NAMES = (
    "samplename", "sample", "name", "dataname", "measurementname", "sampleid", "sampleno", "trialname", "trial",
    "batchname", "batch", "standardname", "standard", "materialname", "material", "colorname", "colourname", "id",
)  # fmt: skip  # heads of columns of names, the best first


@dataclass(frozen=True)
class Table:
    """Rows of cells, and where they stand in the file.

    Attributes:
        rows: the cells.
        where: row and column, or None for all columns, counted from 0, in words for errors.
        is_sheet: whether rows end at their last cell that is not empty, as those of workbooks do.
    """

    rows: Sequence[Sequence[Cell]]
    where: Callable[[int, int | None], str]
    is_sheet: bool = False


def plain_table(rows: Sequence[Sequence[Cell]], sheet: str | None = None) -> Table:
    """The table of a text file as it stands there, or of a workbook's sheet, by its title."""
    before = f"sheet '{sheet}', " if sheet is not None else ""

    def where(row: int, column: int | None) -> str:
        return f"{before}row {row + 1}" + ("" if column is None else f", column {column + 1}")

    return Table(rows, where, is_sheet=sheet is not None)


def turned(table: Table) -> Table:
    """Columns as rows."""
    width = max((len(row) for row in table.rows), default=0)
    if width * len(table.rows) > 5_000_000:
        return Table([], table.where)
    full = [[*row, *[None] * (width - len(row))] for row in table.rows]

    def where(row: int, column: int | None) -> str:
        return f"column {row + 1}" if column is None else table.where(column, row)

    return Table(list(zip(*full, strict=True)), where)


def text_of(cell: Cell) -> str:
    """What a cell says, without blanks around it."""
    if cell is None:
        return ""
    if isinstance(cell, float):
        return str(int(cell)) if cell.is_integer() and abs(cell) < 1e6 else repr(cell)
    return str(cell).strip()


def cell_at(row: Sequence[Cell], column: int) -> Cell:
    """A cell of a row that may end before it."""
    return row[column] if column < len(row) else None


def parse_wavelength(text: str) -> float | None:
    """The wavelength in nm that a column's head names, or None."""
    found = _WAVELENGTH.match(text)
    if found is None:
        return None
    value = float((found["nm"] or found["um"]).replace(",", "."))
    nm = value if found["nm"] else 1000.0 * value
    return nm if _LEAST_NM <= nm <= _MOST_NM else None


def gloss_angle(text: str) -> float | None:
    """The angle in degrees of the gloss that a column's head names, the usual one where it names none, or None."""
    found = _GLOSS.fullmatch(text)
    if found is None:
        return None
    angle = float(found["before"] or found["behind"] or _USUAL_GLOSS_DEG)
    return angle if angle in GLOSS_ANGLES_DEG else None


def plain_head(text: str) -> str:
    """Letters of a column's head, in lower case, without what stands in brackets."""
    return re.sub(r"[^a-z]", "", re.sub(r"\(.*?\)|\[.*?\]", "", text.lower()))


def all_cells(rows: Sequence[Sequence[Cell]], column: int, parse: Callable[[str], object]) -> bool:
    """Whether a column has cells and `parse` takes every one: returns neither None nor False."""
    cells = [text_of(row[column]) for row in rows if column < len(row) and text_of(row[column])]
    parsed = [parse(cell) for cell in cells]
    return bool(cells) and not any(found is None or found is False for found in parsed)


def name_column(heads: Sequence[str]) -> int | None:
    """Which column holds names of samples, by its plain head."""
    return next((heads.index(head) for head in _NAMES if head in heads), None)
