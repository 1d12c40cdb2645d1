"""Slow, constant results in the user's cache folder."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from platformdirs import user_cache_path

from manifold.errors import UsageError
from manifold.system import atomic


def cached(name: str, key: str, compute: Callable[[], Any]) -> Any:
    """Plain values, as JSON holds them: from a file of the user's cache folder, or else computed and stored there.

    Args:
        name: of the file.
        key: what the values depend on; a file with another key, or a damaged one, is replaced.
        compute: makes the values.
    """
    path = user_cache_path("manifold") / name
    with suppress(OSError, ValueError):
        content = json.loads(path.read_bytes())
        if isinstance(content, dict) and content.get("key") == key:
            return content["values"]
    values = compute()
    with suppress(OSError, UsageError):  # a folder that cannot be written costs time only
        path.parent.mkdir(parents=True, exist_ok=True)
        atomic.write_text(path, json.dumps({"key": key, "values": values}))
    return values
