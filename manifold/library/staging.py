"""Atomic writing of a folder, safe against readers and SIGKILL: lock, stage, rename.

Beside a library `NAME` stand, only while somebody writes: the lock `.NAME.lock`, the staging folder
`.NAME.importing-*` and, while a material is replaced, `.NAME.replacing`. What a killed process left is
put right by the next writer: whoever holds the lock knows that every such folder is stale.
"""

from __future__ import annotations

import os
import queue
import shutil
import socket
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Self

from filelock import FileLock, Timeout

from manifold.errors import LibraryError
from manifold.system import atomic, interrupts

_NO_FOLLOW = getattr(os, "O_NOFOLLOW", 0)  # of a link that somebody put there


@contextmanager
def writing(library: Path) -> Iterator[Path]:
    """Hold the library's write lock, recover from killed writers, and lend an empty staging folder.

    Args:
        library: resolved path of a library; it need not exist yet.
    Yields:
        An empty folder on the library's file system, removed at the end.
    Raises:
        LibraryError: another process holds the lock, or the folder cannot be written.
    """
    with _write_lock(library):
        prefix = f".{library.name}.importing-"
        try:
            _recover(library)
            for stale in library.parent.glob(f".{_glob_literal(library.name)}.importing-*"):
                shutil.rmtree(stale, ignore_errors=True)
            staging = Path(tempfile.mkdtemp(prefix=prefix, dir=library.parent))
        except OSError as error:
            raise _cannot_write(library, error) from error
        try:
            yield staging
        finally:
            shutil.rmtree(staging, ignore_errors=True)


def publish(staged: Path, target: Path) -> None:
    """Make a finished folder visible under its final name, in one step, once it is on the disk."""
    atomic.sync_trees([staged])
    os.rename(staged, target)
    atomic.sync_folder(target.parent)


class Publisher:
    """Publishes finished folders of a library in the background, in groups: whatever was finished meanwhile.

    Waiting for the disk costs less for a group than for each of it, and the next ones are written meanwhile.
    Leaving its context waits for the last ones and raises what went wrong.
    """

    def __init__(self, library: Path) -> None:
        self._library = library
        self._finished: queue.SimpleQueue[tuple[Path, Path, Callable[[], None]]] = queue.SimpleQueue()
        self._thread = ThreadPoolExecutor(1)
        self._groups: list[Future[None]] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        with interrupts.deferred():
            self._thread.shutdown()
        for group in self._groups:
            group.result()

    def add(self, staged: Path, target: Path, done: Callable[[], None]) -> None:
        """Publish a folder in place of `target`, if that exists, and call `done`.

        A replaced folder is brought back by `recover` if the process is killed while it is exchanged.
        """
        self._finished.put((staged, target, done))
        self._groups.append(self._thread.submit(self._publish))

    def _publish(self) -> None:
        group = []
        with suppress(queue.Empty):
            while True:
                group.append(self._finished.get_nowait())
        atomic.sync_trees(staged for staged, _, _ in group)
        for staged, target, _ in group:
            if target.exists():
                self._exchange(staged, target)
            else:
                os.rename(staged, target)
        for folder in {target.parent for _, target, _ in group}:
            atomic.sync_folder(folder)
        for _, _, done in group:
            done()

    def _exchange(self, staged: Path, target: Path) -> None:
        aside = _replacing(self._library)
        aside.mkdir(exist_ok=True)
        os.rename(target, aside / target.name)
        os.rename(staged, target)
        # The new one's old place is in the staging folder, which is swept anyway.
        os.rename(aside / target.name, staged)
        aside.rmdir()


def is_replacing(library: Path, name: str) -> bool:
    """Whether a folder of that name is being exchanged at this moment, and may be missing."""
    return (_replacing(library) / name).exists()


def recover(library: Path) -> None:
    """Bring back a material whose replacement was cut short; does nothing where it cannot or need not.

    A running import is left alone: it holds the lock, and its own replacement ends within microseconds.
    """
    if _replacing(library).is_dir():
        with suppress(LibraryError, OSError), _write_lock(library):
            _recover(library)


def _recover(library: Path) -> None:
    aside = _replacing(library)
    if not aside.is_dir():
        return
    for old in aside.iterdir():
        target = library / "materials" / old.name
        if not target.exists():
            os.rename(old, target)
    shutil.rmtree(aside, ignore_errors=True)


def _replacing(library: Path) -> Path:
    return library.parent / f".{library.name}.replacing"


def _glob_literal(text: str) -> str:
    return "".join(f"[{character}]" if character in "*?[" else character for character in text)


@contextmanager
def _write_lock(library: Path) -> Iterator[None]:
    """One writer per library. The kernel drops the lock when its holder dies, however it dies."""
    path = library.parent / f".{library.name}.lock"
    # A moment's patience: who opens the file just before its holder unlinks it has to open the new one.
    lock = FileLock(path, timeout=0.1, poll_interval=0.02)
    try:
        lock.acquire()
    except Timeout:
        raise LibraryError(
            f"{library.name}: {_holder(path)} is writing to it; import again when that is done"
        ) from None
    except OSError as error:
        raise _cannot_write(library, error) from error
    try:
        with (
            suppress(OSError),
            open(os.open(path, os.O_WRONLY | os.O_TRUNC | _NO_FOLLOW), "w", encoding="utf-8") as stream,
        ):
            stream.write(f"process {os.getpid()} on {socket.gethostname()}")
        yield
    finally:
        with suppress(
            OSError
        ):  # Unlinked while still held: whoever waits for it sees that and makes a new one.
            path.unlink()
        lock.release()


def _holder(path: Path) -> str:
    with suppress(OSError):
        return path.read_text(encoding="utf-8", errors="replace") or "another process"
    return "another process"


def _cannot_write(library: Path, error: OSError) -> LibraryError:
    reason = error.strerror or str(error)
    return LibraryError(
        f"{library.name}: cannot write in {library.parent} ({reason}); choose a library in a writable folder"
    )
