"""Reads files with size limits and clear errors, and writes them under a temporary name that is renamed."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from glob import glob, has_magic
from pathlib import Path
from typing import Any

from manifold.core.errors import FileAccessError, FileFormatError, ManifoldError, MissingFileError, UsageError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`, and rename it to `path` when the block ends without an error.

    For a symbolic link, its target is replaced; permissions are kept.
    """
    require_writable(path)
    target = Path(os.path.realpath(path))
    partial = target.with_name(f".manifold-{os.urandom(8).hex()}.{target.name[-128:]}")
    try:
        yield partial
        if target.exists():
            shutil.copymode(target, partial)
        with partial.open("rb") as written:
            os.fsync(written.fileno())
        os.replace(partial, target)
    except ManifoldError:  # of what writes the file; some are OSErrors
        raise
    except OSError as error:
        raise _cannot_write(path, os.strerror(error.errno) if error.errno else str(error)) from error
    finally:
        partial.unlink(missing_ok=True)


def require_writable(path: Path) -> None:
    """Raise UsageError unless a file can be written; call it before the work."""
    target = os.path.realpath(path)
    folder = os.path.dirname(target)
    if os.path.isdir(target):
        raise _cannot_write(path, os.strerror(errno.EISDIR))
    if os.path.exists(target) and not os.path.isfile(target):
        raise _cannot_write(path, "not a regular file")
    if not os.path.isdir(folder):
        raise _cannot_write(path, os.strerror(errno.ENOTDIR if os.path.exists(folder) else errno.ENOENT))
    if not os.access(folder, os.W_OK | os.X_OK):
        raise _cannot_write(path, "its folder is not writable")
    try:
        with tempfile.TemporaryFile(dir=folder):  # `access` says yes of /proc
            pass
    except OSError as error:
        raise _cannot_write(path, str(error.strerror)) from error


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, atomically; bytes of file names that are not valid UTF-8 are escaped."""
    write_bytes(path, text.encode(errors="backslashreplace"))


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file, atomically."""
    with replacing(path) as partial:
        partial.write_bytes(content)


def _cannot_write(path: Path, reason: str) -> FileAccessError:
    return FileAccessError(f"{path}: cannot write this file ({reason}); check the folder, or name another")


def require_lockable(path: Path) -> None:
    """Raise UsageError if a lock is not a regular file, because opening a pipe would block."""
    if os.path.lexists(path) and not os.path.isfile(path):
        raise UsageError(f"{path}: not a regular file, expected a lock; remove it")


MOST_TEXT = 16 << 20
"""Largest size of a text file in bytes; scenes, fits and spectra have kilobytes."""


def require_regular(path: Path, advice: str) -> None:
    """Raise unless a path is a regular file, because a pipe would block, and a device need not end."""
    if not os.path.isfile(path):
        if os.path.exists(path):
            raise FileAccessError(f"{path}: not a regular file; {advice}")
        raise MissingFileError(f"{path}: no such file; {advice}")


def cannot_read(path: Path, error: OSError, advice: str) -> FileAccessError:
    """Return the error of a file that exists and cannot be read."""
    return FileAccessError(f"{path}: cannot be read ({error.strerror or error}); {advice}")


def read_bytes(path: Path, *, advice: str, most: int) -> bytes:
    """Return the content of a regular file of at most `most` bytes; `advice` ends the error message."""
    require_regular(path, advice)
    try:
        with path.open("rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            content = stream.read(min(size, most) + 1)  # which allocates as much before it reads
    except OSError as error:
        raise cannot_read(path, error, advice) from error
    if len(content) > most:
        raise UsageError(f"{path}: more than {most} bytes; {advice}")
    return content


def read_text(path: Path, *, advice: str) -> str:
    """Return the text of a UTF-8 file, with or without a byte order mark."""
    try:
        return read_bytes(path, advice=advice, most=MOST_TEXT).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UsageError(f"{path}: not a text file in UTF-8; {advice}") from error


def read_json(path: Path, expected: str) -> Any:
    """Return the content of a JSON file; `expected` describes it in the error message."""
    import json  # helps need none

    content = read_bytes(path, advice=f"name {expected}", most=MOST_TEXT)
    try:
        return json.loads(content, parse_constant=refuse_constant)
    except RecursionError as error:
        raise FileFormatError(f"{path}: nested too deeply, expected {expected}; name another file") from error
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{path}: not a text file, expected {expected}; name another file") from error
    except ValueError as error:  # not JSON, or a number of thousands of digits
        raise FileFormatError(f"{path}: {error}, expected {expected}; name another file") from error


def refuse_constant(name: str) -> None:
    """Refuse NaN and infinities by a ValueError."""
    raise ValueError(f"{name} is not a valid number in JSON")


def begins_with(path: Path, *magic: bytes) -> bool:
    """Return whether a path is a regular file that begins with one of these byte strings."""
    if not os.path.isfile(path) or not os.access(path, os.R_OK):
        return False
    with path.open("rb") as stream:
        return stream.read(max(map(len, magic))).startswith(magic)


def matching(text: str) -> list[str]:
    """Return the sorted paths that a pattern such as `*.bsdf` matches, or the text itself if there are none."""
    found = [] if os.path.exists(text) or not has_magic(text) else sorted(glob(text, recursive=True))
    return found or [text]
