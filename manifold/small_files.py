"""Small files that other people wrote: regular files only, of bounded size, read once and whole."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from manifold.errors import UsageError

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


def read_text(path: Path, *, advice: str, most: int = MOST_TEXT) -> str:
    """A text in UTF-8. Raises: as `read_bytes`, or it is none."""
    try:
        return read_bytes(path, advice=advice, most=most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise _cannot_read(path, "no text in UTF-8", advice) from error


def _cannot_read(path: Path, reason: str, advice: str) -> UsageError:
    return UsageError(f"{path}: cannot be read ({reason}); {advice}")
