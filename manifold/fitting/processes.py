"""Work in several processes, which ends when interrupted and reports a killed process."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from typing import Any, TypeVar

R = TypeVar("R")


def in_processes(
    function: Callable[..., R],
    calls: Iterable[tuple[Any, ...]],
    n: int,
    *,
    initializer: Callable[[], None] | None = None,
) -> Generator[R, None, None]:
    """Results of a function for several arguments in n processes, in the order of completion.

    Processes are spawned, not forked: Dr.Jit's threads do not survive a fork. A Ctrl-C is the parent's alone to answer;
    whatever ends the loop early, the processes are ended at once. Where one of them is killed, what is not finished is
    missing from the results.

    Args:
        function: of a module, as are its arguments' and results' classes.
        calls: its arguments.
        n: number of processes, at most.
        initializer: called first in each process.
    Raises:
        Whatever `function` raises.
    """
    before = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(n, multiprocessing.get_context("spawn"), _begin, (initializer,))
    with pool:
        try:
            futures: list[Future[R]] = []
            # Making the pool has started Python's resource tracker, which would let interrupts in again.
            with _interrupts_held_back(), suppress(BrokenProcessPool):
                for call in calls:
                    futures.append(pool.submit(function, *call))
            for future in as_completed(futures):
                if not isinstance(future.exception(), BrokenProcessPool):
                    yield future.result()
        except BaseException:
            for process in set(multiprocessing.active_children()) - before:
                process.terminate()
            pool.shutdown(cancel_futures=True)  # waits: its thread must not end beside the interpreter
            raise


@contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """A Ctrl-C arrives when the block ends; processes that are started inside never see one.

    The mask is what they inherit; a handler of their own would come too late, after their imports.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    held = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, held)


def _begin(initializer: Callable[[], None] | None) -> None:
    threading.Thread(target=_end_with_the_parent, daemon=True).start()
    if initializer is not None:
        initializer()


def _end_with_the_parent() -> None:
    """No process goes on for a parent that is gone."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
