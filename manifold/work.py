"""Who runs many tasks: this process, local processes or threads. The only place where a pool of processes is opened.

A task is a function of paths and small values that can be pickled. It writes a file by renaming and may run again. Its
result does not depend on who runs it: BLAS, whose sums depend on its threads, has one in every task.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import wait
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from manifold import progress
from manifold.errors import ManifoldError
from manifold.threads import one_blas_thread

T = TypeVar("T")
R = TypeVar("R")


class Finished(NamedTuple, Generic[R]):
    """A task that ended.

    Attributes:
        task: its index.
        value: what its function returned; None where it failed.
        failure: why it did, else None.
    """

    task: int
    value: R | None
    failure: str | None = None


class Workers(Protocol):
    """What runs tasks."""

    def run(
        self, function: Callable[[T], R], tasks: Sequence[T], begin: Callable[[], object] | None = None
    ) -> Iterator[Finished[R]]:
        """Run tasks, and give each as soon as it ends; one that fails does not stop the others.

        Args:
            function: of a task; what it raises of `ManifoldError` and `OSError` is a failure of its task alone.
            tasks: what it is called with.
            begin: called first in every new process.
        Raises:
            ManifoldError: a worker was lost.
        """


@dataclass(frozen=True)
class Processes:
    """Local processes. One alone is this process, in which tasks run in order, and nothing is pickled.

    An interruption waits for the tasks that are running.

    Attributes:
        count: how many, never more than tasks; one per core if None.
    """

    count: int | None = None

    def run(
        self, function: Callable[[T], R], tasks: Sequence[T], begin: Callable[[], object] | None = None
    ) -> Iterator[Finished[R]]:
        """Run tasks, see `Workers`."""
        n = min(self.count or os.cpu_count() or 1, len(tasks))
        if n <= 1:
            yield from map(partial(attempt, function), range(len(tasks)), tasks)
            return
        # Spawned, not forked: threads of compiled code do not survive a fork.
        context = multiprocessing.get_context("spawn")
        threads = max((os.cpu_count() or 1) // n, 1)
        try:
            with ProcessPoolExecutor(n, context, _begin, (threads, pickle.dumps(begin))) as pool:
                yield from _run_in(pool, function, tasks)
        except BrokenProcessPool:
            raise ManifoldError(
                "a process was killed (out of memory?); use fewer, and run again: finished files are kept"
            ) from None


@dataclass(frozen=True)
class Threads:
    """Threads of this process, for tasks that wait for files, or release the interpreter's lock.

    Attributes:
        count: how many.
    """

    count: int = min(8, os.cpu_count() or 1)

    def run(
        self, function: Callable[[T], R], tasks: Sequence[T], begin: Callable[[], object] | None = None
    ) -> Iterator[Finished[R]]:
        """Run tasks, see `Workers`."""
        with ThreadPoolExecutor(self.count) as pool:
            yield from _run_in(pool, function, tasks)


HERE = Processes(1)
"""This process alone."""
THREADS = Threads()
"""Threads of this process, at most eight."""


def attempt(function: Callable[[T], R], index: int, task: T) -> Finished[R]:
    """Run one task, in any process."""
    try:
        with one_blas_thread, progress.listen(None):  # how many tasks have ended is what is told
            return Finished(index, function(task))
    except ManifoldError as error:
        return Finished(index, None, str(error))
    except OSError as error:
        return Finished(
            index, None, f"{error.filename or 'a file'}: {error.strerror or error}; check the path"
        )


def _run_in(pool: Executor, function: Callable[[T], R], tasks: Sequence[T]) -> Iterator[Finished[R]]:
    waiting: set[Future[Finished[R]]] = {
        pool.submit(attempt, function, k, task) for k, task in enumerate(tasks)
    }
    try:
        for future in as_completed(set(waiting)):
            waiting.remove(future)  # results are not collected here
            yield future.result()
    except KeyboardInterrupt:
        pool.shutdown(cancel_futures=True)
        yield from (future.result() for future in waiting if not future.cancelled())
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _begin(threads: int, pickled: bytes) -> None:
    """Leave Ctrl-C and the other cores to the other processes, and end with the one that started this."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    for variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(variable, str(threads))  # read when NumPy and Numba are loaded
    begin: Any = pickle.loads(pickled)  # which may load them
    if begin is not None:
        begin()


def _end_with_parent() -> None:
    """A pool's processes would wait for ever for tasks of one that was killed."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
