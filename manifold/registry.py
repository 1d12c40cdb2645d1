"""What a user chooses by its name: formats, targets, mappings, kernels, methods, lights."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Generic, TypeVar

from manifold.errors import UnknownNameError
from manifold.names import names_like

T = TypeVar("T")
_ALL_NAMED = 16  # names up to which a message lists all


class Registry(dict[str, T], Generic[T]):
    """A dictionary by name, in the order in which help texts list it; a name that is not there is a `UsageError`.

    Args:
        what: an entry is, in the singular.
        entries: names and entries.
    """

    def __init__(self, what: str, entries: Iterable[tuple[str, T]]) -> None:
        super().__init__(entries)
        self.what = what

    def __missing__(self, name: str) -> T:
        known = f"expected one of {', '.join(self)}"
        if len(self) > _ALL_NAMED:
            known = names_like(self, name, "there are")
        raise UnknownNameError(f"no {self.what} is called '{name}'; {known}")

    def __str__(self) -> str:
        *names, last = self
        return f"{', '.join(names)} or {last}" if names else last
