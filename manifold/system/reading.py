"""Reading of small files: regular files only, of bounded size; and the files that patterns match."""

from __future__ import annotations

import json
import os
from glob import glob, has_magic
from pathlib import Path
from typing import Any

from manifold.errors import FileFormatError, MissingFileError, UsageError

MOST_TEXT = 16 << 20
"""Bytes of a text: scenes, fits and spectra have kilobytes."""


def read_bytes(path: Path, *, advice: str, most: int) -> bytes:
    """The content of a regular file of at most `most` bytes.

    Args:
        path: the file.
        advice: what to do where it cannot be read, for the error.
        most: bytes.
    Raises:
        MissingFileError: there is no such file.
        UsageError: it is no regular file, too large, or cannot be read.
    """
    if not os.path.isfile(path):  # a pipe would block, and a device need not end
        if os.path.exists(path):
            raise UsageError(f"{path}: not a regular file; {advice}")
        raise MissingFileError(f"{path}: no such file; {advice}")
    try:
        with path.open("rb") as stream:
            content = stream.read(most + 1)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror}); {advice}") from error
    if len(content) > most:
        raise UsageError(f"{path}: more than {most} bytes; {advice}")
    return content


def read_text(path: Path, *, advice: str) -> str:
    """A text in UTF-8, with or without a byte order mark.

    Raises:
        UsageError: as `read_bytes`, or the file is not UTF-8.
    """
    try:
        return read_bytes(path, advice=advice, most=MOST_TEXT).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UsageError(f"{path}: not a text in UTF-8; {advice}") from error


def read_json(path: Path, expected: str, most: int = MOST_TEXT) -> Any:
    """The content of a JSON file.

    Args:
        path: the file.
        expected: what it should be, in words.
        most: bytes.
    Raises:
        UsageError: as `read_bytes`.
        FileFormatError: it is not JSON.
    """
    content = read_bytes(path, advice=f"name {expected}", most=most)
    try:
        return json.loads(content, parse_constant=refuse_constant)
    except RecursionError as error:
        raise FileFormatError(f"{path}: nested too deeply, expected {expected}; name another file") from error
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{path}: not a text, expected {expected}; name another file") from error
    except ValueError as error:  # not JSON, or a number of thousands of digits
        raise FileFormatError(f"{path}: {error}, expected {expected}; name another file") from error


def refuse_constant(name: str) -> None:
    """Refuse NaN and infinities. Raises: ValueError, always."""
    raise ValueError(f"{name} is not a number of JSON")


def begins_with(path: Path, *magic: bytes) -> bool:
    """Whether a path is a regular file that begins with one of these."""
    if not os.path.isfile(path) or not os.access(path, os.R_OK):
        return False
    with path.open("rb") as stream:
        return stream.read(max(map(len, magic))).startswith(magic)


def matching(text: str) -> list[str]:
    """The paths that a pattern such as `*.bsdf` matches, sorted; the text itself where there are none."""
    found = [] if os.path.exists(text) or not has_magic(text) else sorted(glob(text, recursive=True))
    return found or [text]
