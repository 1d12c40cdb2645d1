"""Tables of latents, one per row: CSV with a header of coordinates or material, name, and colour."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path

from manifold import disk
from manifold.errors import FileFormatError, UsageError
from manifold.estimate.inputs import Input
from manifold.estimate.sources import PlaceSource
from manifold.formats.text import decode, number
from manifold.library.identity import alike, require_material_name
from manifold.model.colours import ColourChoice

MOST_POINTS = 100_000
_COLOURS = ("like", "srgb", "reflectance")
_SEPARATOR_LINE = re.compile(r"sep=.?", re.IGNORECASE)  # which Excel reads: first, and alone
_EXPECTED = (
    "expected a header of x,y,... or latent or material, and maybe name, like, srgb, reflectance; "
    "the first lines could be: x,y,name and -0.3,1.2,between"
)


def read_points(path: Path, model: Path, library: Path | None = None) -> tuple[list[Input], list[str]]:
    """Read a table of places on the map of a model, and what is wrong with rows that are none, which stop no others.

    Columns are `x`, `y`, `z` or `x1`, `x2`, ... for coordinates, `latent` for all of them in one cell, or `material`
    (also for names that read as coordinates); then `name`, without which rows are numbered, and at most one of `like`,
    `srgb` and `reflectance`, a path from the folder of the table. Separators are comma, semicolon or tab; Excel's line
    `sep=;` may come first.
    """
    advice = "name a CSV file of points"
    text = decode(disk.read_bytes(path, advice=advice, most=disk.MOST_TEXT))
    head = text.partition("\n")[0]
    separator = next((s for s in (";", "\t") if s in head), ",")
    reader = csv.reader(io.StringIO(text), delimiter=separator, skipinitialspace=True)
    found: list[Input] = []
    failures: list[str] = []
    columns: list[str] | None = None
    lines: dict[str, int] = {}  # of names
    try:
        for cells in reader:
            cells = [cell.strip() for cell in cells]
            if not any(cells) or (columns is None and _SEPARATOR_LINE.fullmatch(cells[0])):
                continue
            if columns is None:
                columns = _columns(path, cells)
                continue
            count = len(found) + len(failures) + 1
            if count > MOST_POINTS:
                raise FileFormatError(f"{path}: more than {MOST_POINTS} rows; make several tables of it")
            try:
                row = _row(columns, cells)
                source = PlaceSource(model, _place(row), library, _colour(row, path.parent))
                name = _name(row, count, reader.line_num, lines)
                found.append(Input(name, source, line=reader.line_num))
            except UsageError as error:
                failures.append(f"line {reader.line_num}: {error}")
    except csv.Error as error:
        raise FileFormatError(f"{path}, line {reader.line_num}: not a table ({error}); {_EXPECTED}") from None
    if not found and not failures:
        raise UsageError(f"{path}: no row of points; {_EXPECTED}")
    return found, failures


def _columns(path: Path, cells: list[str]) -> list[str]:
    columns = [cell.lower() for cell in cells]
    while not columns[-1]:  # columns that spreadsheets leave behind
        columns.pop()
    known = {"latent", "material", "name", *_COLOURS}
    for column in columns:
        if column not in known and _axis(column) is None:
            raise FileFormatError(f"{path}: found the column '{column[:40]}'; {_EXPECTED}")
        if columns.count(column) > 1:
            raise FileFormatError(f"{path}: found the column '{column}' twice; {_EXPECTED}")
    axes = sorted(k for k in map(_axis, columns) if k is not None)
    if axes != list(range(len(axes))) or not (axes or {"latent", "material"} & set(columns)):
        raise FileFormatError(f"{path}: found the columns {', '.join(columns)[:80]}; {_EXPECTED}")
    return columns


def _axis(column: str) -> int | None:
    """Index of the coordinate in a column, from 0."""
    if column in ("x", "y", "z"):
        return "xyz".index(column)
    found = re.fullmatch(r"x([1-9]\d?)", column)
    return None if found is None else int(found[1]) - 1


def _row(columns: list[str], cells: list[str]) -> dict[str, str]:
    """The cells that are filled, by column."""
    if any(cells[len(columns) :]):
        raise UsageError(
            f"found {len(cells)} cells, expected {len(columns)}; put cells with commas in quotes"
        )
    return {column: cell for column, cell in zip(columns, cells, strict=False) if cell}


def _colour(row: dict[str, str], folder: Path) -> ColourChoice:
    reflectance = folder / row["reflectance"] if "reflectance" in row else None
    return ColourChoice(row.get("like"), reflectance, row.get("srgb"))


def _name(row: dict[str, str], count: int, line: int, lines: dict[str, int]) -> str:
    name = row.get("name") or f"point-{count:04d}"
    require_material_name(name)
    first = lines.setdefault(alike(name), line)
    if first != line:
        raise UsageError(f"found the name '{name}' of line {first}; name every row differently")
    return name


def _place(row: dict[str, str]) -> tuple[float, ...] | str:
    axes = sorted((k, column) for column in row if (k := _axis(column)) is not None)
    given = [column for column in ("latent", "material") if column in row] + ["coordinates"] * bool(axes)
    if len(given) != 1:
        raise UsageError(
            f"found {' and '.join(given) or 'no latent'}, expected coordinates, a latent or a material"
        )
    if axes:
        if [k for k, _ in axes] != list(range(len(axes))):
            raise UsageError("found coordinates with gaps, expected all of them")
        return tuple(_coordinate(row[column], column) for _, column in axes)
    if "material" in row:
        return row["material"]
    between = r"[;\s]+" if ";" in row["latent"] else r"[,\s]+"  # beside semicolons, commas are decimal ones
    words = [word for word in re.split(between, row["latent"]) if word]
    coordinates = tuple(value for word in words if (value := number(word)) is not None)
    return coordinates if len(coordinates) == len(words) else row["latent"]


def _coordinate(text: str, column: str) -> float:
    value = number(text)
    if value is None:
        raise UsageError(f"found '{text[:40]}' in column {column}, expected a finite number")
    return value
