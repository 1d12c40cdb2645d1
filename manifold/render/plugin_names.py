"""Plugin names allowed in documents of other origin.

Mitsuba makes `plugins/TYPE.so` of a type and loads that library from wherever its file resolver finds it, the current
folder included. So types must be plain words that name Mitsuba's own plugins, which are found first
(`manifold.render.backend`), or plugins that this process has registered from Python.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from manifold.core.errors import FileFormatError
from manifold.render import backend

# Types of dictionaries; and our own plugin.
_KEYWORDS = frozenset({"scene", "rgb", "spectrum", "ref", "manifold"})


def require_plugins(types: Iterable[object], origin: str) -> None:
    """Check that every type is that of a plugin which may be loaded.

    FileFormatError names the document.
    """
    for name in types:
        if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
            raise FileFormatError(
                f"{origin}: type {_shown(name)}, expected the plain name of a Mitsuba plugin"
            )
        if name not in _KEYWORDS and name not in backend.own_plugins() and not backend.is_registered(name):
            raise FileFormatError(
                f"{origin}: type '{name}' is neither a plugin of Mitsuba nor registered in this process; register it "
                "from Python first"
            )


def types_of(content: Any) -> Iterator[object]:
    """Yield the types in a dictionary of Mitsuba, at any depth."""
    return (node["type"] for node in nodes_of(content) if isinstance(node, dict) and "type" in node)


def holds_none(content: Any) -> bool:
    """Return whether None is among plain values, at any depth, because it ends Mitsuba's process."""
    return any(node is None for node in nodes_of(content))


def nodes_of(content: Any) -> Iterator[Any]:
    """Yield plain values and the contents of dictionaries and lists among them, at any depth."""
    waiting = [content]
    while waiting:
        node = waiting.pop()
        yield node
        if isinstance(node, Mapping | list):
            waiting.extend(node.values() if isinstance(node, Mapping) else node)


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
