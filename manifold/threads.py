"""Thread control: compiled parallel kernels, and the threads of BLAS."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from functools import lru_cache, wraps
from importlib import import_module
from typing import Any, ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

P = ParamSpec("P")
R = TypeVar("R")

_turn = threading.Lock()
_has_threads = False  # whether a kernel has run, and Numba's threads with it
_has_lost_threads = False  # whether this process is a fork of one that had them


def _after_fork() -> None:
    global _turn, _has_lost_threads
    _turn = threading.Lock()  # the old one may be held by a thread that is not here
    _has_lost_threads = _has_lost_threads or _has_threads


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


@lru_cache
def _in_one_thread(kernel: Any) -> Any:
    if not hasattr(kernel, "py_func"):
        return kernel
    from numba import njit

    return njit(kernel.py_func)


def serialised(kernel: Callable[P, R]) -> Callable[P, R]:
    """A kernel that is parallel in itself, entered by one thread at a time.

    Where neither OpenMP nor TBB is installed, Numba runs such kernels on a pool of its own, which ends the process
    when two threads enter it. With one of them it would start more threads than there are cores. In a fork of a
    process that had these threads they are gone, and Numba ends it or waits for ever: there kernels have one thread.
    """

    @wraps(kernel)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        global _has_threads
        with _turn:
            _has_threads = True
            return (_in_one_thread(kernel) if _has_lost_threads else kernel)(*args, **kwargs)

    return call


@lru_cache(maxsize=1)
def _blas() -> ThreadpoolController:
    """The BLAS of this process: to find it reads the memory map, which takes longer than a block of a prediction.

    SciPy's is another than NumPy's, and what is loaded later would not be limited.
    """
    import_module("scipy.linalg")
    return ThreadpoolController()


class _OneBlasThread:
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
"""A context in which BLAS keeps to one thread; threads may enter it at the same time, and it may be nested.

Sharing out 200 x 200 entries costs ten times the work itself, and every level of threads above it once more.
"""
