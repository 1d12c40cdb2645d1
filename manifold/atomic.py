"""Files that appear under their name only when they are whole."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from manifold.errors import UsageError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside `path`, with its suffix, renamed to it when the block ends without an error.

    Raises:
        UsageError: the folder does not exist, or the file cannot be written.
    """
    require_writable(path)
    partial = path.with_name(f".{os.getpid()}.{path.name}")
    try:
        yield partial
        os.replace(partial, path)
    except OSError as error:
        # By number: h5py puts a paragraph where others put the reason.
        raise _cannot_write(path, os.strerror(error.errno) if error.errno else str(error)) from error
    finally:
        with suppress(OSError):  # what could not be made need not be removed
            partial.unlink()


def require_writable(path: Path) -> None:
    """Raise what `replacing` would, as far as it can be known before the work.

    Raises:
        UsageError: there is no such folder, it cannot be written, or the path is a folder itself.
    """
    try:
        is_folder = path.is_dir()
    except OSError as error:  # a name that is too long, a folder that may not be searched
        raise _cannot_write(path, os.strerror(error.errno) if error.errno else str(error)) from error
    if is_folder:
        raise _cannot_write(path, os.strerror(errno.EISDIR))
    if not path.parent.is_dir():
        raise _cannot_write(path, os.strerror(errno.ENOTDIR if path.parent.exists() else errno.ENOENT))
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise _cannot_write(path, "its folder is not writable")


def _cannot_write(path: Path, reason: str) -> UsageError:
    return UsageError(f"{path}: cannot write this file ({reason}); check the folder, or name another")


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8. Raises: as `replacing`."""
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")
