"""What a long experiment has measured, kept in its library until the experiment is finished."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

from manifold import __version__
from manifold.library.store import Library
from manifold.records import Array


class KeptResults:
    """Results of an experiment on a library, with which an interrupted one is continued; without a library, none."""

    def __init__(self, library: Library | None, run: str) -> None:
        """Take the library, and in words all that the results depend on beside it and the version of the package."""
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
