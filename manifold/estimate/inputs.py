"""Finds the inputs of commands for many materials: files, folders, patterns such as `*.xlsx`, libraries, and samples.

A sample is a specimen that one or several instruments have measured, in one or several files.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from manifold.core import disk, progress, shipped
from manifold.core.directions import SAME_RAD
from manifold.core.disk import matching
from manifold.core.errors import FileFormatError, ManifoldError, UsageError
from manifold.estimate.sources import FileSource, LibrarySource, MaterialSource, PlaceSource
from manifold.formats import registry
from manifold.formats.readings import Readings
from manifold.formats.recognition import counts_as_readings, is_library, is_rendered, is_rgl
from manifold.formats.text import decode, number
from manifold.io_rgl import material_name
from manifold.library.identity import alike, file_sha256, require_material_name
from manifold.library.importing import find_files
from manifold.library.store import Library
from manifold.model.colours import ColourChoice
from manifold.registries import FIT_SUFFIX


@dataclass(frozen=True)
class Sample:
    """One specimen that one or several instruments have measured.

    Attributes:
        name: name of the output.
        parts: files, each with the specimen's name in it; None in a file with a single specimen.
        note: why its readings were merged or kept apart; None if there was nothing to decide.
    """

    name: str
    parts: tuple[tuple[Path, str | None], ...]
    note: str | None = None

    def __str__(self) -> str:
        return " and ".join(str(path) for path, _ in self.parts)

    def made_of(self) -> dict[str, Any]:
        """Return all that the content depends on, as plain values."""
        return {"parts": [[file_sha256(path), name] for path, name in self.parts], "note": self.note}


def safe_name(name: str) -> str:
    """Return a valid file name for a sample's name."""
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in name).strip(".") or "sample"


def find_samples(sources: Iterable[Path]) -> list[Sample]:
    """Return the samples in instruments' files and folders; readings of one sample by several instruments are merged.

    Readings with one sample name from different instruments are joined. If one instrument read a name twice, they may
    be two samples, and stay apart, named after their files.
    """
    groups: dict[str, list[_Part]] = {}
    given = [path for source in sources for path in matching(str(source))]
    paths = find_files(given, counts_as_readings, "readings file")
    for path in progress.each(paths, str):
        try:
            records = registry.read_all(path)
        except ManifoldError:  # raised again where it is completed
            groups[str(path)] = [_Part(path, None, path.name, "", 0, None)]
            continue
        for record in records:
            sample = record.name if len(records) > 1 else None
            part = _Part(
                path,
                sample,
                record.name.strip(),
                record.instrument,
                record.bands.count,
                _only_incidence_deg(record),
            )
            groups.setdefault(alike(part.name), []).append(part)
    samples = [sample for parts in groups.values() for sample in _in_samples(parts)]
    lone = [parts[0] for parts in groups.values() if len(parts) == 1]
    incidences = {part.incidence_deg for part in lone}
    is_apart = len(samples) == len(lone) == len(incidences) > 1 and None not in incidences
    if is_apart and len({part.instrument for part in lone}) == 1:
        note = f"{len(lone)} files have one incidence each, all different: --merge if they are of one sample"
        return [replace(sample, note=note) for sample in samples]
    return samples


class _Part(NamedTuple):
    """One file's part of a sample; `sample` is its name if the file has several."""

    path: Path
    sample: str | None
    name: str
    instrument: str
    bands: int
    incidence_deg: float | None


def _only_incidence_deg(record: registry.Record) -> float | None:
    """Return the incidence of readings that have one, in degrees; None for others."""
    if not isinstance(record, Readings) or len(record) == 1 or np.ptp(record.wi, axis=0).max() > SAME_RAD:
        return None
    return round(float(np.rad2deg(np.arccos(min(record.wi[0, 2], 1.0)))), 1)


def _in_samples(parts: list[_Part]) -> list[Sample]:
    """Return the samples of files in which the names agree."""
    name = parts[0].name
    if len(parts) == 1:
        return [Sample(safe_name(name), (parts[0][:2],))]
    files = ", ".join(part.path.name for part in parts)
    if len({part.instrument for part in parts}) == len(parts):
        spectral_first = sorted(parts, key=lambda part: -part.bands)  # others are corrected by it
        note = f"put together from {files}, in which the sample is named {name}"
        return [Sample(safe_name(name), tuple(part[:2] for part in spectral_first), note)]
    note = (
        f"{files} hold readings of {name} by one instrument: completed separately; use --merge if they are of one "
        "sample"
    )
    return [
        Sample(safe_name("_".join(filter(None, (part.path.stem, part.sample)))), (part[:2],), note)
        for part in parts
    ]


@dataclass(frozen=True)
class Input:
    """One input of a command: a material, or one of the samples of a file.

    Attributes:
        name: name of the output.
        sample: name of the sample, in a file with several; None otherwise.
        line: line of the table that names the input; None without a table.
    """

    name: str
    source: MaterialSource
    sample: str | None = None
    line: int | None = None

    def __str__(self) -> str:
        if self.line is not None:
            return f"line {self.line}"
        return str(self.source) if self.sample is None else f"{self.source}: {self.sample}"

    def made_of(self) -> dict[str, Any]:
        """Return all that the content depends on, as plain values."""
        source = self.source
        if isinstance(source, FileSource):
            return {"file": file_sha256(source.path), "sample": self.sample}
        if isinstance(source, LibrarySource):
            return {"material": Library(source.library).attributes(source.name).content_sha256}
        from manifold.model.manifold import load_model

        loaded = load_model(source.model, source.library)
        place, colour = loaded.place(source.place), source.colour.made_of()
        file = shipped.model_file(source.model)
        model = _sha256(file, file.stat().st_mtime_ns)
        hashes = {"model": model, "library": loaded.library.content_hash}
        return hashes | {"latent": place.latent.tolist(), "path": place.walk, "colour": colour}


@lru_cache
def _sha256(path: Path, changed_ns: int) -> str:
    """Return the hash of a model, cached because many points may share it."""
    return file_sha256(path)


def is_many(sources: Sequence[MaterialSource]) -> bool:
    """Return whether sources may hold more than one material: several sources, a folder, or a library."""
    return len(sources) > 1 or any(isinstance(one, FileSource) and _is_several(one.path) for one in sources)


def _is_several(path: Path) -> bool:
    return path.is_dir() or is_library(path)


def find_inputs(
    sources: Iterable[MaterialSource], is_wanted: Callable[[Path], bool] = is_rgl, *, samples: bool = False
) -> list[Input]:
    """List the materials of sources without reading them.

    Folders are searched recursively for the wanted files; with `samples`, every sample of a file is listed.
    """
    inputs: list[Input] = []
    for source in sources:
        if isinstance(source, PlaceSource):
            inputs.append(Input(str(source).replace(":", "_"), source))
        elif isinstance(source, LibrarySource):
            inputs.append(Input(source.name, source))
        elif is_library(source.path):
            names = Library(source.path).names
            inputs += [Input(name, LibrarySource(source.path, name)) for name in names]
        else:
            for path in find_files([source.path], is_wanted, "suitable file"):
                inputs += _samples_of(path) if samples and not is_rendered(path) else [_of_file(path)]
    return list(dict.fromkeys(inputs))


def _of_file(path: Path) -> Input:
    is_known = is_rendered(path)
    name = material_name(Path(path.name.removesuffix(FIT_SUFFIX))) if is_known else safe_name(path.stem)
    return Input(name, FileSource(path))


def _samples_of(path: Path) -> list[Input]:
    try:
        names = [record.name for record in registry.read_all(path)]
    except ManifoldError:  # raised again where its values are read; its name is no other file's
        return [Input(safe_name(path.name), FileSource(path))]
    several = [Input(safe_name(name), FileSource(path), name) for name in names]
    return several if len(several) > 1 else [_of_file(path)]


def require_apart(sources: Iterable[Path], folder: Path) -> None:
    """Raise UsageError if an output folder is also a source, or the folder of a source."""
    for source in sources:
        read = source if source.is_dir() else source.parent
        if read.exists() and folder.exists() and read.samefile(folder):
            raise UsageError(f"{folder}: is the input folder; choose another output folder")


def files_of(source: object) -> list[Path]:
    """Return the files from which a source is read."""
    if isinstance(source, Sample):
        return [path for path, _ in source.parts]
    if isinstance(source, Input) and isinstance(source.source, FileSource):
        return [source.source.path]
    return []


MOST_POINTS = 100_000
_COLOURS = ("like", "srgb", "reflectance")
_SEPARATOR_LINE = re.compile(r"sep=.?", re.IGNORECASE)  # a first line for Excel
_EXPECTED = (
    "expected a header of x,y,... or latent or material, and optionally name, like, srgb, reflectance; "
    "the first lines could be: x,y,name and -0.3,1.2,between"
)


def read_points(path: Path, model: Path, library: Path | None = None) -> tuple[list[Input], list[str]]:
    """Read a table of points on a map; return the points, and the errors of invalid rows, which do not stop the others.

    The point is in the columns `x`, `y`, `z` or `x1`, `x2`, ... (coordinates), `latent` (all coordinates in one
    cell), or `material` (a name). `name` names the output; without it, outputs are numbered. At most one of `like`,
    `srgb` and `reflectance` gives a colour; paths are relative to the folder of the table. Columns are separated by
    comma, semicolon or tab; Excel's line `sep=;` may come first. If `locate` or
    `predict` wrote the table, its latents and names are read.
    """
    advice = "name a CSV file of points"
    text = decode(disk.read_bytes(path, advice=advice, most=disk.MOST_TEXT))
    head = text.partition("\n")[0]
    separator = next((s for s in (";", "\t") if s in head), ",")
    reader = csv.reader(io.StringIO(text), delimiter=separator, skipinitialspace=True)
    places: list[Input] = []
    failures: list[str] = []
    columns: list[str] | None = None
    lines: dict[str, int] = {}  # lines of names
    try:
        for cells in reader:
            cells = [cell.strip() for cell in cells]
            if not any(cells) or (columns is None and _SEPARATOR_LINE.fullmatch(cells[0])):
                continue
            if columns is None:
                columns = _columns(path, cells)
                continue
            count = len(places) + len(failures) + 1
            if count > MOST_POINTS:
                raise FileFormatError(f"{path}: more than {MOST_POINTS} rows; make several tables of it")
            try:
                row = _row(columns, cells)
                if "failed" in row and not any(_axis(column) is not None for column in row):
                    raise UsageError(f"has no latent, since it failed: {row['failed'][:200]}")
                source = PlaceSource(model, _place(row), library, _colour(row, path.parent))
                name = _name(row, count, reader.line_num, lines)
                places.append(Input(name, source, line=reader.line_num))
            except UsageError as error:
                failures.append(f"line {reader.line_num}: {error}")
    except csv.Error as error:
        raise FileFormatError(f"{path}, line {reader.line_num}: not a table ({error}); {_EXPECTED}") from None
    if not places and not failures:
        raise UsageError(f"{path}: no row of points; {_EXPECTED}")
    return places, failures


def _columns(path: Path, cells: list[str]) -> list[str]:
    columns = [cell.lower() for cell in cells]
    while not columns[-1]:  # columns that spreadsheets leave behind
        columns.pop()
    known = {"latent", "material", "name", *_COLOURS}
    if (
        columns[:2] == ["name", "file"] and columns[-1] == "failed" and "x1" in columns
    ):  # of `locate` or `predict`
        read = ("name", "failed")
        return [column if column in read or _axis(column) is not None else "" for column in columns]
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
    """Return the index of the coordinate in a column, from 0."""
    if column in ("x", "y", "z"):
        return "xyz".index(column)
    found = re.fullmatch(r"x([1-9]\d?)", column)
    return None if found is None else int(found[1]) - 1


def _row(columns: list[str], cells: list[str]) -> dict[str, str]:
    """Return the cells that are filled, by column."""
    if any(cells[len(columns) :]):
        raise UsageError(
            f"found {len(cells)} cells, expected {len(columns)}; put cells with commas in quotes"
        )
    return {column: cell for column, cell in zip(columns, cells, strict=False) if cell and column}


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
            raise UsageError(
                "found gaps among the coordinates, expected columns x1, x2, ... or x, y, z, one for each axis"
            )
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
