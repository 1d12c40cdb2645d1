"""Slow, constant results, cached in the user's cache folder."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from manifold.errors import UsageError
from manifold.system import atomic, small_files


def cache_folder() -> Path:
    """The user's cache folder of this package; it need not exist."""
    root = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(os.path.expanduser(root)) / "manifold"  # which leaves the unknown home of a user as it is


def remembered(name: str, key: str, compute: Callable[[], Any]) -> Any:
    """Plain values, as JSON holds them: those kept in a file under this key, or else computed, and kept.

    A file that is damaged, or of another key, is replaced; one that cannot be written, and a pipe, cost time only.

    Args:
        name: of the file in the cache folder.
        key: what the values depend on.
        compute: makes them.
    """
    path = cache_folder() / name
    try:
        digest, text = small_files.read_text(path, advice="").split("\n", 1)
        if digest == _digest(key, text):
            return json.loads(text)
    except (UsageError, ValueError):
        pass
    values = compute()
    text = json.dumps(values)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_file() or not path.exists():
            atomic.write_text(path, f"{_digest(key, text)}\n{text}")
    except (OSError, UsageError):
        pass
    return values


def _digest(key: str, text: str) -> str:
    return hashlib.sha256(f"{key}\n{text}".encode()).hexdigest()
