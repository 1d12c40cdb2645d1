"""Reports the progress of long work to a listener in a context variable, without passing callbacks.

Reports from inside `each` are ignored, because only the outer loop knows the total.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from typing import Protocol, TypeVar

Progress = Callable[[int, int, str], None]
"""A function of the amount done, the total, and the name of the last item."""

T = TypeVar("T")

_listener: ContextVar[Progress | None] = ContextVar("listener", default=None)


class Display(Protocol):
    """A function that opens a progress display with a title."""

    def __call__(self, title: str, *, in_bytes: bool) -> AbstractContextManager[Progress]:
        """Return a context manager, open during the work, that is called with its progress."""


_display: ContextVar[Display | None] = ContextVar("display", default=None)


def display_with(display: Display) -> None:
    """Set the display that `shown` opens; the command line calls this when it starts."""
    _display.set(display)


@contextmanager
def listen(listener: Progress | None) -> Iterator[None]:
    """Report progress inside the block to a function of (done, total, what), or to nobody if it is None.

    >>> with listen(lambda done, total, what: print(f"{done} of {total}: {what}")):
    ...     report(1, 2, "materials")
    1 of 2: materials
    """
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


@contextmanager
def shown(title: str, *, in_bytes: bool = False) -> Iterator[None]:
    """Show the progress of work inside the block, if there is a display and no listener yet."""
    display = _display.get()
    if display is None or _listener.get() is not None:
        yield
        return
    with display(title, in_bytes=in_bytes) as listener, listen(listener):
        yield


def report(done: int, total: int, what: str = "") -> None:
    """Report the amount done, the total, and the last item to the listener."""
    listener = _listener.get()
    if listener is not None:
        listener(done, total, what)


def each(items: Iterable[T], what: str | Callable[[T], str] = "") -> Iterator[T]:
    """Yield the items in order, and report after each how many are done; `what` is a text or a function of the item."""
    known, listener = list(items), _listener.get()
    for done, item in enumerate(known, start=1):
        _listener.set(None)
        try:
            yield item
        finally:
            _listener.set(listener)
        report(done, len(known), what if isinstance(what, str) else what(item))


class Stages:
    """Combines the progress of several stages to overall progress in hundredths.

    `shares` are the shares of the stages in the total time, in order; a stage called "" has stages of its own.
    """

    def __init__(self, shares: Mapping[str, float]) -> None:
        self._tell = _listener.get()
        self._shares, self._reached = dict(shares), 0

    def begin(self, stage: str) -> None:
        """Begin a stage, to which later progress belongs."""
        names = list(self._shares)
        total = sum(self._shares.values())
        before = sum(self._shares[name] for name in names[: names.index(stage)]) if stage in names else 0.0
        share, tell = self._shares[stage], self._tell
        if tell is None:
            return

        def within(done: int, of: int, what: str) -> None:
            # A stage of several loops begins anew with each of them.
            self._reached = max(self._reached, round(100 * (before + share * done / max(of, 1)) / total))
            tell(self._reached, 100, ": ".join(filter(None, (stage, what))))

        within(0, 1, "")
        _listener.set(within)
