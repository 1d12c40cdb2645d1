"""Overall progress of work with several stages."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext
from typing import TypeVar

Progress = Callable[[int, int, str], None]
"""Called with how much is done, of how much in all, and the name of what was done last."""

PROGRESS_VARIABLE = "MANIFOLD_PROGRESS"
"""Names the file descriptor into which a program that runs a command wants its progress, as JSON lines."""

Stage = Callable[[str], AbstractContextManager[Progress | None]]
"""Opens one stage of a long command by its title and gives the progress callback for it, or None."""

T = TypeVar("T")


def no_stage(title: str) -> AbstractContextManager[None]:
    """A stage without a progress display."""
    return nullcontext()


class Stages:
    """Overall progress, in hundredths, from the progress of single stages.

    Args:
        on_progress: called with (hundredths, 100, stage); may be None.
        shares: of each stage in the time of the whole, in the order in which they follow each other; one called "" has
            stages of its own.
    """

    def __init__(self, on_progress: Progress | None, shares: Mapping[str, float]) -> None:
        self._tell = on_progress
        self._shares = dict(shares)

    def begin(self, stage: str) -> Progress | None:
        """Say that a stage begins; what takes its own progress.

        Raises:
            KeyError: there is no such stage.
        """
        names = list(self._shares)
        total = sum(self._shares.values())
        before = sum(self._shares[name] for name in names[: names.index(stage)]) if stage in names else 0.0
        share, tell = self._shares[stage], self._tell
        if tell is None:
            return None

        def within(done: int, of: int, what: str) -> None:
            tell(
                round(100 * (before + share * done / max(of, 1)) / total),
                100,
                ": ".join(filter(None, (stage, what))),
            )

        within(0, 1, "")
        return within


def with_progress(
    items: Iterable[T], on_progress: Progress | None, what: str | Callable[[T], str] = ""
) -> Iterator[T]:
    """The items in order, reporting after each how many are done.

    Args:
        items: what is iterated over; listed first, for their number.
        on_progress: called with (done, total, what); may be None.
        what: the text of the report, or a function of the item that was done.
    """
    known = list(items)
    for done, item in enumerate(known, start=1):
        yield item
        if on_progress is not None:
            on_progress(done, len(known), what if isinstance(what, str) else what(item))
