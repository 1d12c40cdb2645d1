"""Results of methods: their errors, stored in the library until all are measured, and as plain values."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np

from manifold import __version__
from manifold.library.store import Library
from manifold.metrics import Errors
from manifold.records import Array


@dataclass(frozen=True, kw_only=True)
class Result:
    """A method that was measured on materials.

    Attributes:
        key, title, is_held_out: as in `Method`.
        errors: of every material, each (N,).
    """

    key: str
    title: str
    is_held_out: bool = True
    errors: Errors[Array]

    @cached_property
    def median(self) -> Errors[float]:
        """Over materials."""
        return self.errors.median

    @cached_property
    def p90(self) -> Errors[float]:
        """90th percentile over materials."""
        return self.errors.p90

    def to_json(self) -> dict[str, Any]:
        """Plain values; errors also as medians and 90th percentiles."""
        return {field.name: getattr(self, field.name) for field in fields(self)} | self.errors.of_each


class KeptResults:
    """What a long experiment has measured, with which an interrupted one is continued; without a library, nothing.

    Args:
        library: where it is stored.
        run: in words, all that the results depend on beside the library and the version of the package.
    """

    def __init__(self, library: Library | None, run: str) -> None:
        self._library = library
        content = "" if library is None else library.content_hash
        self._key = hashlib.sha256(f"{run} {__version__} {content}".encode()).hexdigest()

    def get(self) -> dict[str, Array]:
        """What an interrupted experiment has kept; empty if nothing."""
        return {} if self._library is None else self._library.cache_get(self._key) or {}

    def put(self, arrays: Mapping[str, Array]) -> None:
        """Keep results in place of earlier ones."""
        if self._library is not None:
            self._library.cache_put(self._key, arrays)

    def finish(self) -> None:
        """Forget the results: the next experiment begins again."""
        self.put({})


def finite(value: Any) -> Any:
    """Plain values, in which numbers that are not finite become None."""
    if isinstance(value, dict):
        return {key: finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [finite(one) for one in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
