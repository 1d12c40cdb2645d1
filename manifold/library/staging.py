"""Atomic writing of folders of a library: staged beside it, renamed into place when whole.

Beside a library `NAME` stand, only while somebody writes, the lock `.NAME.lock` and the staging folder
`.NAME.importing-*`; the next writer removes those that a killed process has left. Of a library that is a mount point,
which no rename from outside reaches, they stand in it.
"""

from __future__ import annotations

import glob
import os
import shutil
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from manifold.errors import LibraryError


@contextmanager
def writing(library: Path) -> Iterator[Path]:
    """Hold the library's write lock, and lend an empty staging folder.

    Args:
        library: resolved path of a library; it need not exist yet.
    Yields:
        An empty folder on the library's file system, removed at the end.
    Raises:
        LibraryError: another process holds the lock, or the folder cannot be written.
    """
    prefix = f".{library.name}.importing-"
    home = library if os.path.ismount(library) else library.parent
    lock_file = home / f".{library.name}.lock"
    lock = FileLock(lock_file)
    try:
        home.mkdir(parents=True, exist_ok=True)
        lock.acquire(timeout=0.1)
        for stale in home.glob(f"{glob.escape(prefix)}*"):
            shutil.rmtree(stale, ignore_errors=True)
        staging = Path(tempfile.mkdtemp(prefix=prefix, dir=home))
    except Timeout:
        raise LibraryError(
            f"{library.name}: another process is writing to it; import again when that is done"
        ) from None
    except OSError as error:
        raise LibraryError(
            f"{library.name}: cannot write in {home} ({error.strerror}); choose a writable folder"
        ) from error
    try:
        yield staging
    finally:
        shutil.rmtree(staging, ignore_errors=True)
        lock_file.unlink(missing_ok=True)
        lock.release()


def contents(library: Path) -> list[Path]:
    """What a folder holds, without lock and staging folder."""
    return [path for path in library.iterdir() if not path.name.startswith(f".{library.name}.")]


def supplant(staged: Path, target: Path) -> None:
    """Put a finished group in the place of another whose arrays have other names; at no moment there is neither.

    A killed process leaves one of them, and perhaps arrays of the other, which `keep_arrays` removes.
    """
    for path in staged.rglob("*"):
        if path.is_file():
            with path.open("rb") as written:
                os.fsync(written.fileno())
    arrays = [path for path in staged.iterdir() if path.is_dir()]
    for path in arrays:
        shutil.rmtree(target / path.name, ignore_errors=True)
        os.rename(path, target / path.name)
    os.replace(staged / "zarr.json", target / "zarr.json")
    keep_arrays(target, {path.name for path in arrays})


def keep_arrays(group: Path, names: Collection[str]) -> None:
    """Remove all other arrays of a group."""
    for path in group.iterdir():
        if path.is_dir() and path.name not in names:
            shutil.rmtree(path)


def publish(staged: Path, target: Path) -> None:
    """Rename a finished folder of the staging folder to its final name, in place of what is there."""
    if target.exists():
        os.rename(target, staged.with_name(f".{staged.name}"))
    os.rename(staged, target)
