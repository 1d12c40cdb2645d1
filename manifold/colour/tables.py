"""colour-science, imported on first use, and its tables as plain arrays."""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Iterable
from functools import lru_cache
from types import ModuleType

import numpy as np

from manifold.records import Array


@lru_cache(maxsize=1)
def colour_science() -> ModuleType:
    """The package colour-science, imported without its remarks on optional packages."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import colour
        import colour.quality
    return colour


def distribution(table: object) -> tuple[Array, Array]:
    """Wavelengths in nm and values of one of colour-science's distributions, as plain arrays."""
    return np.asarray(table.wavelengths, float), np.asarray(table.values, float)  # type: ignore[attr-defined]


def frozen(a: Array) -> Array:
    """The same array, read-only: cached arrays are shared."""
    a.setflags(write=False)
    return a


def near_names(name: str, known: Iterable[str]) -> str:
    """`did you mean ...?`, or the known names where none is near."""
    by_lower = {k.lower(): k for k in known}
    near = [by_lower[k] for k in difflib.get_close_matches(name.lower(), by_lower, n=5, cutoff=0.5)]
    if near:
        return f"did you mean {', '.join(near)}?"
    return f"known: {', '.join(sorted(by_lower.values()))}"
