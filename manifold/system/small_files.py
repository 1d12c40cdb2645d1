"""Reading of small files of other origin: regular files only, of bounded size."""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path
from typing import Any

from manifold.errors import FileFormatError, UsageError

MOST_TEXT = 16 << 20
"""Bytes of a text: scenes, fits and spectra of people have kilobytes."""


def read_bytes(path: Path, *, advice: str, most: int) -> bytes:
    """The content of a regular file of at most `most` bytes.

    A pipe would block, and a device need not end, so neither is opened for longer than it takes to see what it is.

    Args:
        path: the file.
        advice: what to do where it cannot be read, for the error.
        most: bytes.
    Raises:
        UsageError: there is no such file, it is no regular one, too large, or cannot be read.
    """
    try:
        with open(os.open(path, os.O_RDONLY | os.O_CLOEXEC | getattr(os, "O_NONBLOCK", 0)), "rb") as stream:
            status = os.fstat(stream.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise _cannot_read(path, "not a regular file", advice)
            if status.st_size > most:
                raise _cannot_read(path, f"{status.st_size} bytes, expected at most {most}", advice)
            content = stream.read(most + 1)  # of /proc, sizes are 0; and files grow
    except FileNotFoundError as error:
        raise UsageError(f"{path}: no such file; {advice}") from error
    except (OSError, ValueError) as error:  # also names with null bytes
        raise _cannot_read(path, getattr(error, "strerror", None) or str(error), advice) from error
    if len(content) > most:
        raise _cannot_read(path, f"more than {most} bytes", advice)
    return content


def read_text(path: Path, *, advice: str) -> str:
    """A text in UTF-8. Raises: as `read_bytes`, or it is none."""
    try:
        return read_bytes(path, advice=advice, most=MOST_TEXT).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise _cannot_read(path, "no text in UTF-8", advice) from error


def read_json(path: Path, expected: str, most: int = MOST_TEXT) -> Any:
    """The content of a JSON file.

    Args:
        path: the file.
        expected: what it should be, in words.
        most: bytes.
    Raises:
        UsageError: as `read_bytes`.
        FileFormatError: it is no JSON.
    """
    try:
        text = read_bytes(path, advice=f"name {expected}", most=most).decode()
        return json.loads(text, parse_constant=refuse_constant)
    except RecursionError as error:
        raise FileFormatError(f"{path}: nested too deeply for {expected}; name another file") from error
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{path}: found no text, expected {expected}; name another file") from error
    except ValueError as error:  # no JSON, or a number of thousands of digits
        raise FileFormatError(f"{path}: {error}, expected {expected}; name another file") from error


def refuse_constant(name: str) -> None:
    """Refuse NaN and infinities. Raises: ValueError, always."""
    raise ValueError(f"{name} is not a number of JSON")


def begins_with(path: Path, *magic: bytes) -> bool:
    """Whether a path is a regular file that begins with one of these; not where it cannot be read."""
    if not path.is_file():  # reading a pipe or a device may never end
        return False
    try:
        with path.open("rb") as stream:
            return stream.read(max(map(len, magic))).startswith(magic)
    except OSError:
        return False  # whoever reads it next says why


def _cannot_read(path: Path, reason: str, advice: str) -> UsageError:
    return UsageError(f"{path}: cannot be read ({reason}); {advice}")
