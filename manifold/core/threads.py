"""Distributes work among threads, and limits the threads of BLAS."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import ContextDecorator, contextmanager
from functools import lru_cache
from importlib import import_module
from typing import Any, TypeVar

from threadpoolctl import ThreadpoolController

from manifold.core.errors import UsageError

T = TypeVar("T")

VARIABLE = "MANIFOLD_NUM_THREADS"
_PER_THREAD = 4  # blocks of rows: some take longer than others

_mutex = threading.Lock()
_pool: tuple[int, ThreadPoolExecutor] | None = None  # with the number of its threads
_limit: int | None = None
_here = threading.local()  # `is_shared`: whether this thread runs a part of `share_out`


def _after_fork() -> None:
    global _mutex, _pool, _here
    _mutex, _pool, _here = threading.Lock(), None, threading.local()  # the parent's threads do not exist here


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def thread_count() -> int:
    """Return the number of threads: `MANIFOLD_NUM_THREADS`, or one per core that this process may use.

    Raises:
        UsageError: the variable is not a positive integer.
    """
    if _limit is not None:
        return _limit
    text = os.environ.get(VARIABLE, "")
    if not text:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if not text.isdecimal() or int(text) < 1:
        raise UsageError(f"{VARIABLE} is {text!r}, expected a number of threads, 1 or more")
    return int(text)


@contextmanager
def limit_threads(count: int) -> Iterator[None]:
    """Limit the number of threads to `count` inside the block, in the whole process."""
    global _limit
    before, _limit = _limit, count
    try:
        yield
    finally:
        _limit = before


def share_out(work: Callable[[T], object], parts: Sequence[T]) -> None:
    """Call `work` with each part, on `thread_count()` threads including the calling one.

    Nested calls stay on the thread of `work`. After an exception no further parts are begun, and it is raised when
    all threads have stopped.
    """
    count = min(thread_count(), len(parts))
    if count <= 1 or getattr(_here, "is_shared", False):
        for part in parts:
            work(part)
        return
    rest, turn = list(reversed(parts)), threading.Lock()

    def take() -> None:
        _here.is_shared = True
        try:
            while True:
                with turn:
                    if not rest:
                        return
                    part = rest.pop()
                work(part)
        except BaseException:
            rest.clear()
            raise
        finally:
            _here.is_shared = False

    pool = _threads(count - 1)
    others = [pool.submit(take) for _ in range(count - 1)]
    try:
        take()
    finally:
        wait([other for other in others if not other.cancel()])
    for other in others:
        if not other.cancelled():
            other.result()


def share_rows(work: Callable[[slice], object], count: int, least: int) -> None:
    """Call `work` with blocks of `count` rows, of at least `least` rows each, on `thread_count()` threads."""
    size = max(least, -(-count // (_PER_THREAD * thread_count())))
    share_out(work, [slice(start, start + size) for start in range(0, count, size)])


def _threads(count: int) -> ThreadPoolExecutor:
    """Return a pool of at least `count` threads, which is kept for later calls."""
    global _pool
    with _mutex:
        if _pool is None or _pool[0] < count:
            _pool = count, ThreadPoolExecutor(count, thread_name_prefix="manifold")
        return _pool[1]


@lru_cache(maxsize=1)
def _blas() -> ThreadpoolController:
    """Return the controller of this process's BLAS.

    Finding it reads the memory map, which takes longer than a block of a prediction.

    SciPy's is another than NumPy's, and what is loaded later would not be limited.
    """
    import_module("scipy.linalg")
    return ThreadpoolController()


class _OneBlasThread(ContextDecorator):
    """The limit of several users at once: set by the first, taken back by the last, since it is the process's."""

    def __init__(self) -> None:
        self._mutex, self._users = threading.Lock(), 0
        self._limit: Any = None

    def __enter__(self) -> None:
        with self._mutex:
            if self._users == 0:
                self._limit = _blas().limit(limits=1, user_api="blas")
            self._users += 1

    def __exit__(self, *_: object) -> None:
        with self._mutex:
            self._users -= 1
            if self._users == 0 and self._limit is not None:
                self._limit.restore_original_limits()


one_blas_thread = _OneBlasThread()
"""A context manager that limits BLAS to one thread; several threads may enter it, and it may be nested.

For 200 x 200 matrices, distributing the work costs ten times as much as the work itself.
"""
