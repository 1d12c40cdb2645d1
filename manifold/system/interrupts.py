"""Ctrl-C: known in whatever it was turned into, at a better moment, and never lost."""

from __future__ import annotations

import _thread
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_SOON = 0.05  # seconds: longer than a destructor takes


def is_interruption(error: BaseException | None) -> bool:
    """Whether Ctrl-C caused it: calls into compiled code, and imports of it, replace that by errors of their own."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


@contextmanager
def repeated_where_ignored() -> Iterator[None]:
    """A Ctrl-C in a destructor, where Python prints and ignores every exception, arrives again a moment later."""
    show = sys.unraisablehook

    def repeat(ignored: sys.UnraisableHookArgs) -> None:
        if issubclass(ignored.exc_type, KeyboardInterrupt):
            # Not a Thread, whose locks may be held where the destructor was called.
            _thread.start_new_thread(_interrupt_soon, (threading.get_ident(),))
        else:
            show(ignored)

    sys.unraisablehook = repeat
    try:
        yield
    finally:
        sys.unraisablehook = show


def _interrupt_soon(thread: int) -> None:
    time.sleep(_SOON)
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(thread, signal.SIGINT)  # also wakes it where it waits
    else:  # Windows
        _thread.interrupt_main()


@contextmanager
def deferred() -> Iterator[None]:
    """A Ctrl-C arrives when the block ends: for blocks that wait for threads, which cannot be interrupted.

    Where a wait is interrupted, Python 3.11 takes the thread for ended, so that waiting again would not help.
    """
    handler = signal.getsignal(signal.SIGINT)
    if not callable(handler) or threading.current_thread() is not threading.main_thread():
        yield  # none would be raised in the block
        return
    arrived: list[tuple[int, FrameType | None]] = []
    signal.signal(signal.SIGINT, lambda number, frame: arrived.append((number, frame)))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
        if arrived:
            handler(*arrived[0])
