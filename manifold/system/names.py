"""Names that a user may have meant, and names in files of other programs."""

from __future__ import annotations

import difflib
import unicodedata
from collections.abc import Iterable

_SHOWN = 5


def names_like(names: Iterable[str], name: str, among: str = "it holds") -> str:
    """Similar names for an error message: those that contain a name, or are close matches; else the first few.

    Args:
        names: that are known.
        name: that is not; upper and lower case do not matter.
        among: what stands before the first few.
    """
    known, name = list(dict.fromkeys(names)), name.lower()
    within = [k for k in known if name and name in k.lower()]
    close = difflib.get_close_matches(name, [k.lower() for k in known])
    near = within or [k for match in dict.fromkeys(close) for k in known if k.lower() == match]
    if near:
        return f"did you mean {', '.join(near[:_SHOWN])}?"
    more = len(known) - _SHOWN
    return f"{among} {', '.join(known[:_SHOWN])}" + f" and {more} more" * (more > 0)


def without_controls(text: str) -> str:
    """Question marks for control characters but line breaks: readers of files obey or refuse them."""
    return "".join("?" if c != "\n" and unicodedata.category(c) == "Cc" else c for c in text)


def in_one_line(name: str) -> str:
    """A name for a line of a text file."""
    return without_controls(" ".join(name.split()))
