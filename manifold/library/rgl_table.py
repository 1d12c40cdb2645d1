"""The table of the files of the RGL material database.

Source: Dupuy & Jakob 2018, An Adaptive Parameterization for Efficient Material Acquisition and Rendering,
DOI 10.1145/3272127.3275059 (CC0 1.0). Sizes and checksums: `manifold/library/rgl_isotropic.tsv`.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from types import MappingProxyType

from manifold.errors import UnknownNameError
from manifold.system.names import names_like


@dataclass(frozen=True)
class Entry:
    """A file's entry in the table of the database.

    Attributes:
        name: of the material.
        size_bytes: of the file, or None.
        sha256: of the file in hexadecimal, or None.
        is_isotropic: whether one incident azimuth was measured.
    """

    name: str
    size_bytes: int | None
    sha256: str | None
    is_isotropic: bool = True


@cache
def rgl_table() -> Mapping[str, Entry]:
    """The database's spectral files by name: 51 isotropic ones, and 11 anisotropic ones without checksums."""
    data = resources.files("manifold.library")
    with (data / "rgl_isotropic.tsv").open(encoding="utf-8") as lines:
        rows = list(csv.DictReader(lines, delimiter="\t"))
    entries = [Entry(row["material"], int(row["size_bytes"]), row["sha256"]) for row in rows]
    names = (data / "rgl_anisotropic.txt").read_text(encoding="utf-8").split()
    entries += [Entry(name, None, None, is_isotropic=False) for name in names]
    return MappingProxyType({entry.name: entry for entry in entries})


def select(names: Sequence[str] | None, table: Mapping[str, Entry], anisotropic: bool) -> list[Entry]:
    """The entries of some names, or all isotropic ones, and with `anisotropic` those too.

    Raises:
        UsageError: an unknown name.
    """
    if names is None:
        return [entry for entry in table.values() if entry.is_isotropic or anisotropic]
    for name in names:
        if name not in table:
            raise UnknownNameError(f"{name}: no such material in the RGL database; {names_like(table, name)}")
    return [table[name] for name in dict.fromkeys(names)]
