"""Measured materials for tests: those of the built-in library, which are compact forms of RGL files."""

from __future__ import annotations

from functools import cache

from manifold.core.records import BsdfFile
from manifold.core.shipped import BUILT_IN
from manifold.library.store import Library


@cache
def real_materials() -> tuple[BsdfFile, ...]:
    """The 20 measured materials, by name."""
    library = Library(BUILT_IN)
    return tuple(library.read(name) for name in library.names)
