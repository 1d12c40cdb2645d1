"""Formats of instruments, recognised by their content.

A format is a module with `sniff(head) -> bool` and `read(path) -> list of records`; `registries.FORMATS` names them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from manifold.core import disk
from manifold.core.errors import FileFormatError, ManifoldError, UnknownNameError, UsageError
from manifold.core.names import first_few, names_like, printable
from manifold.formats.dense import DenseTable
from manifold.formats.doubts import with_doubts
from manifold.formats.foreign import MUELLER, name_format
from manifold.formats.light_side import without_hidden
from manifold.formats.readings import Readings
from manifold.formats.tables import HEADERS
from manifold.formats.tensor_file import holds_tensors
from manifold.formats.values import LONGEST_NM, SHORTEST_NM
from manifold.registries import FORMATS

Record = Readings | DenseTable
_SNIFFED = 16384
_SHOWN = 8  # names of samples in a message
_LARGEST_VALUE = 1e9  # largest f in 1/sr; measured mirror directions reach 1e5


class Format(NamedTuple):
    """A format of instrument files, and the functions that recognise and read it.

    Attributes:
        sniff: return whether the first bytes of a file belong to the format.
        read: return all specimens of a file.
        package: the package that adds the format; empty for built-in ones.
    """

    name: str
    sniff: Callable[[bytes], bool]
    read: Callable[[Path], Sequence[Record]]
    package: str = ""


def identify(path: Path | str) -> Format | None:
    """Return the format of a file by its content, or None; RGL files are read by `manifold.io_rgl`.

    Formats of other packages are tried first, because a user who installs one has such files.
    """
    head = _head(Path(path))
    if holds_tensors(head):
        return None
    for name in [*FORMATS.packages, *FORMATS]:
        if name in FORMATS and (known := FORMATS.get(name)) is not None:
            package = FORMATS.packages.get(name, "")
            try:
                is_of_it = known.sniff(head)
                if not isinstance(is_of_it, bool | np.bool_):
                    raise TypeError(f"sniff returned {type(is_of_it).__name__}, expected bool")
            except (Exception, SystemExit) as error:
                if not package:
                    raise
                FORMATS.leave_out(name, error)
                continue
            if is_of_it:
                return Format(name, known.sniff, known.read, package)
    return None


def _head(path: Path) -> bytes:
    advice = "check the path"
    disk.require_regular(path, advice)
    try:
        with path.open("rb") as stream:
            return stream.read(_SNIFFED)
    except OSError as error:
        raise disk.cannot_read(path, error, advice) from error


def unknown(path: Path) -> FileFormatError:
    """Return the error for a file of an unknown format."""
    head = _head(path)
    name = printable(path.name, 255)
    if holds_tensors(head) and name_format(head) != MUELLER:
        return FileFormatError(
            f"{name}: found an RGL file, a whole BRDF, expected readings or a table; read it with manifold.read_bsdf, "
            "or write it as a table with `manifold convert`"
        )
    what = name_format(head) if head else "an empty file"
    return FileFormatError(
        f"{name}: found {what}, expected an RGL file or one of: {FORMATS}, which has a header such as {HEADERS}"
    )


def read_all(path: Path | str) -> list[Record]:
    """Read all specimens of an instrument's file, in the order of the file.

    Raises:
        FileFormatError: the format is unknown, or the file violates it.
        UsageError: the file is missing, no regular file, or cannot be read.
    """
    path = Path(path)
    known = identify(path)
    if known is None:
        raise unknown(path)
    records = _read_by(known, path)
    for record in records:
        largest = float(np.max(np.abs(np.nan_to_num(record.values)), initial=0.0))
        if largest > _LARGEST_VALUE:
            raise FileFormatError(
                f"{printable(path.name, 255)}: a value of {largest:.3g}, expected f in 1/sr or reflectance factors; "
                "the file is damaged or in other units"
            )
        nm = record.wavelengths_nm
        if nm is not None and not SHORTEST_NM <= nm[0] <= nm[-1] <= LONGEST_NM:
            raise FileFormatError(
                f"{printable(path.name, 255)}: bands of {nm[0]:g} to {nm[-1]:g} nm, expected {SHORTEST_NM:g} to "
                f"{LONGEST_NM:g}; give wavelengths in nanometres"
            )
    return [with_doubts(without_hidden(record)) for record in records]


def _read_by(known: Format, path: Path) -> list[Record]:
    """Read the specimens of a file; any exception of another package's reader becomes a FileFormatError."""
    if not known.package:
        return list(known.read(path))
    try:
        records = list(known.read(path))
    except ManifoldError:
        raise
    except (Exception, SystemExit) as error:
        raise FileFormatError(
            f"{printable(path.name, 255)}: the reader of {known.name} in the package {known.package} failed "
            f"({type(error).__name__}: {error})"
        ) from error
    if not records or not all(isinstance(record, Readings | DenseTable) for record in records):
        raise FileFormatError(
            f"{printable(path.name, 255)}: the reader of {known.name} in the package {known.package} returned "
            f"{[type(record).__name__ for record in records[:3]]}, expected records of class Readings or DenseTable"
        )
    return records


def read(
    path: Path | str, sample: str | None = None, *, is_only: bool = True, unit: str | None = None
) -> Record:
    """Read one specimen of an instrument's file; a file with a single one needs no name.

    With `is_only`, a given name must be that of a specimen even if the file has only one. `unit`, one of
    `readings.UNITS`, is the unit of a table that states none.
    """
    found = read_all(path)
    if unit is not None:
        found = [_in_unit(record, unit, Path(path)) for record in found]
    names = [record.name for record in found]
    if len(found) == 1 and (sample is None or not is_only):
        return found[0]
    if sample is None:
        raise UsageError(f"{path}: holds {len(names)} samples ({first_few(names, _SHOWN)}); name one of them")
    if sample not in names:
        raise UnknownNameError(f"{path}: no sample '{sample}'; {names_like(names, sample)}")
    return found[names.index(sample)]


def _in_unit(record: Record, unit: str, path: Path) -> Readings:
    if not isinstance(record, Readings):
        raise UsageError(f"{path}: a dense table states its unit; leave --unit {unit} out")
    return record.in_unit(unit)


def read_readings(
    path: Path | str, sample: str | None = None, limit: int | None = None, *, is_only: bool = True,
    unit: str | None = None,
) -> Readings:  # fmt: skip
    """Read one specimen as readings; a dense table gives at most `limit` of its measured nodes.

    With `is_only`, a given name must be that of a specimen even if the file has only one. `unit`, one of
    `readings.UNITS`, is the unit of a table that states none.

    Raises:
        UsageError: there are several specimens and no name is given, none has the given name, or the file cannot be
            read.
        FileFormatError: the file is of no known format, or damaged.
    """
    return as_readings(read(path, sample, is_only=is_only, unit=unit), limit)


def as_readings(record: Record, limit: int | None) -> Readings:
    """Return the readings of a record; a dense table gives at most `limit` of its measured nodes."""
    return record.readings(limit) if isinstance(record, DenseTable) else record


def merge(records: Sequence[Record]) -> Record:
    """Merge several files of one specimen into one record, such as pab-opto's files per incidence."""
    if len(records) == 1:
        return records[0]
    readings = [r for r in records if isinstance(r, Readings)]
    if len(readings) != len(records):
        raise UsageError(
            f"{len(records)} files, {len(records) - len(readings)} of them dense tables; give one of these"
        )
    first = readings[0]
    for part in readings[1:]:
        if part.bands != first.bands:
            raise FileFormatError(f"{part.name}: {part.bands}, expected {first.bands} as in {first.name}")
        if part.bands.is_rgb and part.viewing != first.viewing:
            raise FileFormatError(
                f"{part.name}: colours under {part.viewing}, expected {first.viewing} as in {first.name}"
            )
    wi, wo, values, weights, scatter = (
        np.concatenate([getattr(part, key) for part in readings])
        for key in ("wi", "wo", "values", "weights", "scatter")
    )
    return replace(
        first,
        wi=wi,
        wo=wo,
        values=values,
        weights=weights,
        scatter=scatter,
        notes=tuple(dict.fromkeys(note for part in readings for note in part.notes)),
        gloss={angle: units for part in reversed(readings) for angle, units in part.gloss.items()},
        texture={key: value for part in reversed(readings) for key, value in part.texture.items()},
        colour_error=max(part.colour_error for part in readings),
        repeatability=max(part.repeatability for part in readings),
    )
