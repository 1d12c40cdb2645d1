"""Atomic writing of files, synchronised to disk."""

from __future__ import annotations

import errno
import os
import re
import secrets
import shutil
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from manifold.errors import UsageError

try:
    import fcntl
except ImportError:  # Windows: temporary files of killed processes stay there
    fcntl = None  # type: ignore[assignment]

_TEMPORARY = re.compile(r"\.manifold-[0-9a-f]{16}\..*")
_swept: set[Path] = set()


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside `path`, with its suffix, renamed to it when the block ends without an error.

    What a link names is replaced, not the link; permissions are kept. What is no file (a pipe, a terminal) is
    written to. What a killed process left in the folder is removed.

    Raises:
        UsageError: the folder does not exist, or the file cannot be written.
    """
    require_writable(path)
    try:
        if _is_stream(path):
            from manifold.system import temporary  # which locks as this module does

            with temporary.folder() as folder:
                partial = folder / path.name
                yield partial
                with partial.open("rb") as made, path.open("ab") as stream:
                    shutil.copyfileobj(made, stream)
            return
        target = Path(os.path.realpath(path))
        _sweep(target.parent)
        with _temporary(target) as (partial, descriptor):
            yield partial
            os.fsync(descriptor)
            os.replace(partial, target)
        sync_folder(target.parent)
    except OSError as error:
        raise _cannot_write(path, os.strerror(error.errno) if error.errno else str(error)) from error


def require_writable(path: Path) -> None:
    """Raise what `replacing` would, as far as it can be known before the work.

    Raises:
        UsageError: there is no such folder, it cannot be written, or the path is a folder itself.
    """
    try:
        mode = os.stat(path).st_mode
    except FileNotFoundError:
        mode = 0
    except (
        OSError,
        ValueError,
    ) as error:  # a name that is too long or no name, a folder that may not be searched
        number = getattr(error, "errno", None)
        if number != errno.ENOTDIR:
            raise _cannot_write(path, os.strerror(number) if number else str(error)) from error
        mode = 0
    if stat.S_ISDIR(mode):
        raise _cannot_write(path, os.strerror(errno.EISDIR))
    if stat.S_ISBLK(mode) or stat.S_ISSOCK(mode):
        raise _cannot_write(path, "a block device" if stat.S_ISBLK(mode) else "a socket")
    if mode and _is_stream(path):
        if not os.access(path, os.W_OK):
            raise _cannot_write(path, os.strerror(errno.EACCES))
        return
    folder = Path(os.path.realpath(path)).parent
    if not folder.is_dir():
        raise _cannot_write(path, os.strerror(errno.ENOTDIR if folder.exists() else errno.ENOENT))
    if not os.access(folder, os.W_OK | os.X_OK):
        raise _cannot_write(path, "its folder is not writable")


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8; bytes of file names that are none stand there as escapes. Raises: as `replacing`."""
    write_bytes(path, text.encode(errors="backslashreplace"))


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file. Raises: as `replacing`."""
    with replacing(path) as partial:
        partial.write_bytes(content)


def sync_trees(folders: Iterable[Path]) -> None:
    """Wait until all files in some folders, at every depth, are on the disk.

    All are begun before the first is waited for: a journal is then written once for many.

    Raises:
        OSError: one cannot be: the disk is full, or broken.
    """
    trees = [(root, names) for folder in folders for root, _, names in os.walk(folder)]
    files = [os.path.join(root, name) for root, names in trees for name in names]
    for path in files:
        _begin_sync(path)
    for path in files:
        _sync(path)
    for root, _ in trees:
        sync_folder(root)


def _is_stream(path: Path) -> bool:
    """Whether a path leads to what is no file: then there is nothing to replace."""
    try:
        mode = os.stat(path).st_mode
    except FileNotFoundError:
        return False
    # /dev/stdout may be a file, which whoever opened it goes on writing to.
    return not stat.S_ISREG(mode) or str(path.absolute()).startswith(("/dev/std", "/dev/fd/", "/proc/"))


@contextmanager
def _temporary(target: Path) -> Iterator[tuple[Path, int]]:
    """A new empty file beside a target, with the permissions of what is there; its path and descriptor.

    It is locked as long as it is used, which tells it from those of processes that were killed.
    """
    partial, descriptor = _make(target)
    try:
        with suppress(OSError):  # no file there yet, or another user's
            old = os.stat(target)
            os.fchmod(descriptor, old.st_mode & 0o777)
            os.fchown(descriptor, old.st_uid, old.st_gid)
        yield partial, descriptor
    finally:
        with suppress(OSError):  # it was renamed, or could not be made
            partial.unlink()
        os.close(descriptor)


def _make(target: Path) -> tuple[Path, int]:
    while True:
        partial = target.with_name(f".manifold-{secrets.token_hex(8)}.{target.name[-128:]}")
        descriptor = os.open(partial, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        try_lock(descriptor)
        with suppress(OSError):
            if os.path.samestat(os.stat(partial), os.fstat(descriptor)):
                return partial, descriptor
        os.close(descriptor)  # swept between its making and its lock


def try_lock(descriptor: int) -> bool:
    """Lock an open file or folder until this process closes it or ends, however it ends; whether that was possible."""
    if fcntl is None:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _sweep(folder: Path) -> None:
    """Remove what killed processes left in a folder, the first time that this process writes there."""
    if folder in _swept:
        return
    _swept.add(folder)
    for entry in os.scandir(folder):
        if _TEMPORARY.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):
            with suppress(OSError):
                descriptor = os.open(entry.path, os.O_RDWR | getattr(os, "O_NOFOLLOW", 0) | os.O_CLOEXEC)
                try:
                    if try_lock(descriptor):
                        os.unlink(entry.path)
                finally:
                    os.close(descriptor)


def sync_folder(folder: Path | str) -> None:
    """Wait until the names in a folder are on the disk, where that is possible."""
    with suppress(OSError):  # not every file system can
        _sync(folder)


def _begin_sync(path: str) -> None:
    """Ask for a file to be written, without waiting, where the system can be asked."""
    if hasattr(os, "posix_fadvise"):  # not on macOS; pages that are not yet written are not dropped
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        try:
            os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)
        finally:
            os.close(descriptor)


def _sync(path: Path | str) -> None:
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _cannot_write(path: Path, reason: str) -> UsageError:
    return UsageError(f"{path}: cannot write this file ({reason}); check the folder, or name another")
