"""Results that declare at each field how it is shown."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pytest

from manifold.core.records import plain
from manifold.core.results import Result, derived, entry, placed


@dataclass(frozen=True)
class Measured(Result):
    """A result with one member of each kind."""

    hidden: float

    @property
    @derived(row="first", words="{:.1%}")
    def share(self) -> float:
        return 0.25

    gloss: dict[str, float] = field(metadata=entry(columns={"gloss 60": ("60",), "gloss 20": ("20",)}))
    width: float = field(default=2.0, metadata=entry(json=lambda made: f"{made.width:g} mm"))

    @cached_property
    @derived(row="sum", words=lambda made: f"{made.hidden:g} beside {made.share:g}", json=False)
    def total(self) -> float:
        return self.hidden + self.share

    height: float | None = field(
        default=None, metadata=entry(row="height", unit="mm", columns={"height": ()})
    )
    notes: tuple[str, ...] = field(
        default=(), metadata=entry(row="notes", columns={"count": lambda content: len(content["notes"])})
    )


@dataclass(frozen=True)
class Placed(Measured):
    """A result with a member more."""

    nearest: str = field(default="", metadata=entry(row="nearest"))


MADE = Measured(2.0, {"60": 40.0}, height=1.23456)


def test_rows_keep_the_order_of_the_class_body_and_omit_missing_values() -> None:
    assert MADE.rows == {"first": "25.0%", "sum": "2 beside 0.25", "height": "1.23 mm"}
    assert list(MADE.rows) == ["first", "sum", "height"]
    assert list(Measured(2.0, {}).rows) == ["first", "sum"]


def test_json_holds_what_has_an_entry() -> None:
    assert MADE.to_json() == {
        "share": 0.25,
        "gloss": {"60": 40.0},
        "width": "2 mm",
        "height": 1.23456,
        "notes": [],
    }


@pytest.mark.parametrize(
    ("title", "cell"), [("gloss 60", 40.0), ("gloss 20", None), ("height", 1.23456), ("count", 0)]
)
def test_columns_take_cells_from_the_json(title: str, cell: float | None) -> None:
    assert Measured.columns()[title](MADE.to_json()) == cell


def test_columns_of_a_content_without_the_field_are_empty() -> None:
    assert Measured.columns()["gloss 60"]({"gloss": None}) is None


def test_entries_of_a_subclass_precede_those_of_its_base() -> None:
    assert list(Placed(2.0, {}, nearest="gold").rows) == ["nearest", "first", "sum"]
    assert "nearest" not in Measured.entries


def test_columns_are_placed_before_a_title() -> None:
    columns = placed(Measured.columns(), {"L": lambda content: content["lab"][0]}, before="gloss 20")
    assert list(columns) == ["gloss 60", "L", "gloss 20", "height", "count"]


def test_numbers_and_texts_of_subclasses_become_plain_ones():
    """JSON encoders of other programs know only the types themselves."""

    class Note(str):
        __slots__ = ()

    assert [type(plain(value)) for value in (np.float64(2.5), np.float32(2.5), Note("a"))] == [
        float,
        float,
        str,
    ]
