"""The result of `manifold info`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Table:
    """A table: its column heads, its rows."""

    columns: tuple[str, ...]
    rows: tuple[tuple[object, ...], ...]


@dataclass(frozen=True)
class Inspection:
    """What was found.

    Attributes:
        title: one line.
        rows: labels and values.
        tables: further tables, possibly none.
        document: the same for JSON.
        problems: what verification found, possibly nothing.
    """

    title: str
    rows: dict[str, object]
    document: dict[str, Any]
    tables: tuple[Table, ...] = ()
    problems: list[str] = field(default_factory=list)
