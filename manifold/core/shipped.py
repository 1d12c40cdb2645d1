"""The built-in library and model, with which commands work if the user has no files.

The name `built-in` stands for them wherever a path of a library or model is accepted. Scenes and JSON use
`built-in@HASH`, which raises an error in a version of the package with another library or model. `tools/built_in.py`
makes them.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from functools import cache
from pathlib import Path, PurePath
from typing import Any

from manifold.core.errors import UsageError
from manifold.core.stores import address_of

BUILT_IN = Path("built-in")

_DATA = Path(__file__).parents[1] / "data"
LIBRARY_FILE, MODEL_FILE, ABOUT_FILE = (_DATA / f"built_in.{suffix}" for suffix in ("zip", "h5", "json"))
_HASH_LENGTH = 12


def is_built_in(path: PurePath | str) -> bool:
    """Return whether a path names the built-in library or model, of this version or another."""
    return str(path).partition("@")[0] == str(BUILT_IN)


@cache
def about() -> dict[str, Any]:
    """Return source, licence, citation and checksums of the built-in library and model."""
    return json.loads(ABOUT_FILE.read_bytes())


@cache
def content_hash() -> str:
    """Return the hash of the built-in library and model that JSON and scenes contain."""
    sums = json.dumps(about()["sha256"], sort_keys=True)
    return hashlib.sha256(sums.encode()).hexdigest()[:_HASH_LENGTH]


def named(path: PurePath | str) -> str:
    """Return a path as text for JSON and scenes; for `built-in`, with the hash of its content."""
    if is_built_in(path):
        return f"{BUILT_IN}@{content_hash()}"
    return address_of(path) or str(path)


def require_same(path: PurePath | str) -> None:
    """Raise UsageError if a path names the built-in library or model of another version."""
    expected = str(path).partition("@")[2]
    if expected and expected != content_hash():
        raise UsageError(
            f"{path}: belongs to another version of manifold; this version contains {named(BUILT_IN)}: name "
            f"{BUILT_IN} to use that"
        )


def is_elsewhere(path: PurePath | str) -> bool:
    """Return whether a path names the built-in library or model, or an address, instead of a file or folder."""
    return is_built_in(path) or address_of(path) is not None


def resolved(path: PurePath | str) -> Path:
    """Return the absolute path of a library or model; `built-in` and addresses stay as they are."""
    return Path(path) if is_elsewhere(path) else Path(path).expanduser().resolve()


def exists(path: Path) -> bool:
    """Return whether a path names the built-in library or model, an address, or an existing file or folder."""
    return is_elsewhere(path) or path.exists()


def model_file(path: Path) -> Path:
    """Return the file of a model. Raises UsageError for the built-in model of another version."""
    return _own_file(path, MODEL_FILE) if is_built_in(path) else path


def library_file(path: PurePath | str) -> Path:
    """Return the zip file of the built-in library. Raises UsageError for the library of another version."""
    return _own_file(path, LIBRARY_FILE)


_tell: Callable[[], object] = bool


def tell_with(function: Callable[[], object]) -> None:
    """Register a function that is called once, when the built-in library or model is opened next."""
    global _tell
    _tell = function


def _own_file(path: PurePath | str, file: Path) -> Path:
    require_same(path)
    tell = _tell
    tell_with(bool)
    tell()
    return file
