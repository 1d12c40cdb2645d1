"""Checks the names of plugins in documents from elsewhere.

For a type, Mitsuba loads the library `plugins/TYPE.so` from any folder of its file resolver, including the current
folder. Therefore types must be plain words that name Mitsuba's own plugins, which are found first
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
    """Raise FileFormatError, which names the document, unless every type names a plugin that may be loaded."""
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
    """Yield the types of all plugins in a Mitsuba dictionary, recursively."""
    return (node["type"] for node in nodes_of(content) if isinstance(node, dict) and "type" in node)


def holds_none(content: Any) -> bool:
    """Return whether plain values contain None at any depth, which would crash Mitsuba."""
    return any(node is None for node in nodes_of(content))


def nodes_of(content: Any) -> Iterator[Any]:
    """Yield a plain value and, recursively, all values in its dictionaries and lists."""
    waiting = [content]
    while waiting:
        node = waiting.pop()
        yield node
        if isinstance(node, Mapping | list):
            waiting.extend(node.values() if isinstance(node, Mapping) else node)


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
