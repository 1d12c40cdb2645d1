"""Tables of colour-science as plain arrays; the package is imported on first use, and its tables cached."""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from importlib import metadata
from types import ModuleType
from typing import Any

import numpy as np
from platformdirs import user_cache_path

from manifold.core import disk
from manifold.core.errors import UsageError
from manifold.core.records import Array


def cached(name: str, key: str, compute: Callable[[], Any]) -> Any:
    """Return JSON values from a file in the user's cache folder; if it is missing, compute and store them.

    A file that is damaged or has another key is replaced. The key must name everything that the values depend on.
    """
    path = user_cache_path("manifold") / name
    with suppress(OSError, ValueError):
        content = json.loads(path.read_bytes())
        if isinstance(content, dict) and content.get("key") == key:
            return content["values"]
    values = compute()
    with suppress(OSError, UsageError):  # a folder that cannot be written costs time only
        path.parent.mkdir(parents=True, exist_ok=True)
        disk.write_text(path, json.dumps({"key": key, "values": values}))
    return values


OBSERVER = "CIE 1931 2 Degree Standard Observer"
"""The colour-matching functions behind XYZ and sRGB, by their name in colour-science."""


@lru_cache(maxsize=1)
def colour_science() -> ModuleType:
    """Import colour-science without its warnings about optional packages and its changes to NumPy's printing."""
    with warnings.catch_warnings(), np.printoptions():
        warnings.simplefilter("ignore")
        import colour
        import colour.quality
    # Without Matplotlib it leaves mocks behind, which later imports would take for the package.
    mocks = [name for name, module in sys.modules.items() if type(module).__name__ == "MagicMock"]
    for name in mocks:
        if name.partition(".")[0] == "matplotlib":
            del sys.modules[name]
    return colour


@dataclass(frozen=True, eq=False)
class StandardTables:
    """The data of colour-science that nearly every command needs.

    Attributes:
        illuminants: wavelengths in nm and relative power, shape (K,) each, by name.
        observer: wavelengths in nm, shape (K,), and colour-matching functions, shape (K, 3).
        bradford: from XYZ to the cone responses that adaptation scales, shape (3, 3).
    """

    illuminants: Mapping[str, tuple[Array, Array]]
    observer: tuple[Array, Array]
    bradford: Array


@lru_cache(maxsize=1)
def standard_tables() -> StandardTables:
    """Return illuminants, observer and matrices, cached per version of colour-science, which is slow to import."""
    names = ("illuminants", "observer", "bradford")
    key = f"{', '.join(names)} of colour-science {metadata.version('colour-science')}"
    values = cached("colour-science.json", key, _standard_values)
    illuminants, observer, bradford = (values[name] for name in names)
    return StandardTables(
        {name: _pair(*table) for name, table in illuminants.items()},
        _pair(*observer),
        frozen(np.array(bradford)),
    )


def _standard_values() -> dict[str, Any]:
    colour = colour_science()
    tables = {name: distribution(table) for name, table in colour.SDS_ILLUMINANTS.items()}
    return {
        "illuminants": {name: [a.tolist() for a in table] for name, table in tables.items()},
        "observer": [a.tolist() for a in distribution(colour.MSDS_CMFS[OBSERVER])],
        "bradford": colour.adaptation.CHROMATIC_ADAPTATION_TRANSFORMS["Bradford"].tolist(),
    }


@lru_cache(maxsize=1)
def wide_observer() -> tuple[Array, Array]:
    """Return wavelengths in nm, shape (K,), and colour-matching functions (K, 3) of the 10 degree observer."""
    return distribution(colour_science().MSDS_CMFS["CIE 1964 10 Degree Standard Observer"])


def _pair(first: list[Any], second: list[Any]) -> tuple[Array, Array]:
    return frozen(np.array(first, dtype=np.float64)), frozen(np.array(second, dtype=np.float64))


def distribution(table: Any) -> tuple[Array, Array]:
    """Return the wavelengths in nm and values of one of colour-science's distributions, as plain arrays."""
    return np.asarray(table.wavelengths, np.float64), np.asarray(table.values, np.float64)


def frozen(a: Array) -> Array:
    """Make an array read-only, because cached arrays are shared."""
    a.setflags(write=False)
    return a
