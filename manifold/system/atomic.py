"""Atomic writing: a temporary file beside the target, renamed to it when it is whole."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from manifold.errors import ManifoldError, UsageError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside `path`, with its suffix, renamed to it when the block ends without an error.

    The target of a symbolic link is replaced, not the link; permissions are kept.

    Raises:
        UsageError: the folder does not exist, or the file cannot be written.
    """
    require_writable(path)
    target = Path(os.path.realpath(path))
    partial = target.with_name(f".manifold-{secrets.token_hex(8)}.{target.name[-128:]}")
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
    """Check before the work that a file can be written.

    Raises:
        UsageError: there is no such folder, it is not writable, or the path is no regular file.
    """
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


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8; bytes of file names that are none stand there as escapes. Raises: as `replacing`."""
    write_bytes(path, text.encode(errors="backslashreplace"))


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file. Raises: as `replacing`."""
    with replacing(path) as partial:
        partial.write_bytes(content)


def _cannot_write(path: Path, reason: str) -> UsageError:
    return UsageError(f"{path}: cannot write this file ({reason}); check the folder, or name another")
