"""Base class of results whose fields declare how they are shown in tables, reports and JSON."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import Field, dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Any, ClassVar, TypeVar

from manifold.core.records import plain

Column = Callable[[dict[str, Any]], Any]
Columns = dict[str, Column]
"""Columns of the table of a batch: functions of the JSON of a result, by title."""
_Getter = TypeVar("_Getter", bound=Callable[[Any], Any])
_ENTRY = "entry"


@dataclass(frozen=True)
class Entry:
    """Declares how a field or property of a result is shown.

    Attributes:
        row: label of the row in the printed table and the report; None for no row. Values that are None or empty have
            no row.
        words: text of the row: a format of the value, such as `{:.2f}`, or a function of the result; by default the
            value itself, or a number with three digits.
        unit: unit, which follows the formatted value.
        columns: columns in the table of a batch, by title: keys that lead from the value in JSON to the cell, or a
            function of the JSON of the result.
        is_detail: whether the row appears only in reports, and not in the terminal.
        json: whether JSON holds the value under the name of the field; or a function of the result whose value JSON
            holds.
    """

    row: str | None = None
    words: str | Callable[[Any], object] | None = None
    unit: str = ""
    columns: Mapping[str, tuple[str | int, ...] | Column] = field(default_factory=dict)
    is_detail: bool = False
    json: bool | Callable[[Any], object] = True

    def row_of(self, result: object, name: str) -> object:
        """Return the text of the row of a result's field; None for no row."""
        value = getattr(result, name)
        if value is None:
            return None
        if callable(self.words):
            return self.words(result)
        number = "{:.3g}" if isinstance(value, float) else None
        if (words := self.words or number) is not None:
            value = words.format(value)
        return f"{value} {self.unit}" if self.unit else value


def entry(**how: Any) -> Mapping[str, Entry]:
    """Return the metadata of a dataclass field that is shown; for arguments see `Entry`."""
    return MappingProxyType({_ENTRY: Entry(**how)})


def derived(**how: Any) -> Callable[[_Getter], _Getter]:
    """Declare how a property is shown, below `@property` or `@cached_property`; for arguments see `Entry`."""

    def declare(get: _Getter) -> _Getter:
        setattr(get, _ENTRY, Entry(**how))
        return get

    return declare


class Result:
    """Base class of results: dataclasses whose fields use `entry` and whose properties use `derived`.

    Entries keep the order of the class body; new entries of a subclass precede those of its base class.
    """

    entries: ClassVar[dict[str, Entry]] = {}

    def __init_subclass__(cls) -> None:
        """Collect the entries of the class body."""
        own = {name: shown for name, value in vars(cls).items() if (shown := _entry_of(value)) is not None}
        new = {name: shown for name, shown in own.items() if name not in cls.entries}
        cls.entries = new | cls.entries | own

    @property
    def rows(self) -> dict[str, object]:
        """Return the rows of the table, by label: texts, lists of texts, or tuples of sentences."""
        return self._rows_of(self.entries)

    @property
    def summary(self) -> dict[str, object]:
        """Return the rows without details."""
        return self._rows_of({name: shown for name, shown in self.entries.items() if not shown.is_detail})

    def _rows_of(self, entries: Mapping[str, Entry]) -> dict[str, object]:
        rows = {shown.row: shown.row_of(self, name) for name, shown in entries.items() if shown.row}
        return {label: words for label, words in rows.items() if words is not None and words not in ((), [])}

    def to_json(self) -> dict[str, Any]:
        """Return the fields that belong in JSON, as plain values."""
        return {
            name: plain(shown.json(self) if callable(shown.json) else getattr(self, name))
            for name, shown in self.entries.items()
            if shown.json
        }

    @classmethod
    def columns(cls) -> Columns:
        """Return the columns in the table of a batch; a cell is None if the JSON has no such value."""
        return {
            title: cell if callable(cell) else _cell_of(name, *cell)
            for name, shown in cls.entries.items()
            for title, cell in shown.columns.items()
        }


def placed(columns: Columns, others: Columns, *, before: str) -> Columns:
    """Return columns with other columns inserted before the column whose title is `before`."""
    titles = list(columns)
    first = titles[: titles.index(before)]
    return {title: columns[title] for title in first} | others | columns


def _entry_of(value: object) -> Entry | None:
    """Return the entry of a value in a class body: a dataclass field or a property."""
    if isinstance(value, Field):
        shown = value.metadata.get(_ENTRY)
        return shown if isinstance(shown, Entry) else None
    get = value.func if isinstance(value, cached_property) else getattr(value, "fget", None)
    return getattr(get, _ENTRY, None)


def _cell_of(*keys: str | int) -> Column:
    def cell(content: dict[str, Any]) -> Any:
        value: Any = content
        for key in keys:
            try:
                value = value[key]
            except (KeyError, IndexError, TypeError):  # no such value in this result
                return None
        return value

    return cell
