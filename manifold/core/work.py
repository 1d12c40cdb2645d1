"""Runs tasks in this process, or by an executor of local processes, of threads, or of a Dask cluster.

A task is a function of paths and small values that can be pickled. It writes files atomically and may run again. Its
result does not depend on where it runs; BLAS has one thread in every task, because its sums depend on the number.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from multiprocessing.connection import wait
from typing import TypeVar

from manifold.core import progress
from manifold.core.errors import ManifoldError, extension_of, in_words
from manifold.core.threads import VARIABLE, one_blas_thread

T = TypeVar("T")
R = TypeVar("R")


def run(
    function: Callable[[T], R], tasks: Sequence[T], workers: Executor | None = None
) -> Iterator[tuple[int, R | None, str | None]]:
    """Run tasks, and yield the index, result and failure of each as soon as it ends.

    After a failure, the others still run. If a task raises `ManifoldError` or `OSError`, its failure is the message
    and its result None. An interruption waits for running tasks. Without workers, or for a single task and local
    processes, the tasks run in this process, in order, and nothing is pickled.
    """
    if workers is None or (isinstance(workers, ProcessPoolExecutor) and len(tasks) == 1):
        yield from map(partial(_attempt, function), range(len(tasks)), tasks)
        return
    waiting = {workers.submit(_attempt, function, k, task) for k, task in enumerate(tasks)}
    try:
        for future in as_completed(set(waiting)):
            waiting.remove(future)  # results are not collected here
            yield future.result()
    except BrokenProcessPool:
        raise ManifoldError(
            "a worker process was killed (out of memory?); use fewer workers, and run again: finished files are kept"
        ) from None
    except KeyboardInterrupt:
        running = [future for future in waiting if not future.cancel()]
        yield from (future.result() for future in running)
        raise
    finally:
        for future in waiting:
            future.cancel()


def processes(count: int | None = None) -> AbstractContextManager[Executor | None]:
    """Return an executor of local processes for `run`, one per core if None.

    With one process, this process does the work.
    """
    cores = os.cpu_count() or 1
    count = count or cores
    if count == 1:
        return nullcontext()
    # Spawned, not forked: locks that threads held would stay locked. They start when there are tasks for them.
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(count, context, _begin, (max(cores // count, 1),))


def _attempt(function: Callable[[T], R], index: int, task: T) -> tuple[int, R | None, str | None]:
    """Run one task, in any process."""
    try:
        with one_blas_thread, progress.listen(None):  # how many tasks have ended is what is told
            return index, function(task), None
    except ManifoldError as error:
        return index, None, str(error)
    except OSError as error:
        return index, None, f"{error.filename or 'a file'}: {error.strerror or error}; check the path"
    except (Exception, SystemExit) as error:
        if extension_of(error) is None:
            raise
        return index, None, in_words(error)


def _begin(threads: int) -> None:
    """Leave Ctrl-C and the other cores to the other processes, and end with the one that started this."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    for variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS", VARIABLE):
        os.environ.setdefault(variable, str(threads))  # the first three are read when NumPy is loaded


def _end_with_parent() -> None:
    """End this process if its parent was killed; otherwise a pool's processes would wait for tasks for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
