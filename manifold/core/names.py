"""Words of messages: similar names, names on one line, lists, counts."""

from __future__ import annotations

import difflib
import unicodedata
from collections.abc import Iterable, Sequence
from typing import SupportsFloat

_SHOWN = 5
_LEAST_PART = 3  # letters of a part of a name


def names_like(names: Iterable[str], name: str, among: str = "it holds") -> str:
    """Return similar names for an error message: those that contain a name or are close matches, else the first few.

    Upper and lower case do not matter; a name of one or two letters is in too many others. `among` stands before the
    first few.
    """
    known, name = list(dict.fromkeys(names)), name.lower()
    within = [k for k in known if len(name) >= _LEAST_PART and name in k.lower()]
    close = difflib.get_close_matches(name, [k.lower() for k in known])
    near = within or [k for match in dict.fromkeys(close) for k in known if k.lower() == match]
    if near:
        return f"did you mean {', '.join(near[:_SHOWN])}?"
    return f"{among} {first_few(known)}"


def first_few(words: Sequence[str], most: int = _SHOWN, between: str = ", ", hint: str = "") -> str:
    """Return the first few words and the number of the others, with a hint behind that number."""
    more = len(words) - most
    return between.join(words[:most]) + (f"{between.rstrip(', ')} and {more} more{hint}" if more > 0 else "")


def printable(text: str, limit: int | None = None, *, keep: str = "") -> str:
    """Return a text on one line, with escapes for unprintable characters, cut at a limit of characters.

    Characters to keep, such as line breaks, stay as they are.
    """
    shown = text if limit is None else text[: limit + 1]
    shown = "".join(
        c if c.isprintable() or c in keep or unicodedata.category(c) == "Zs" else ascii(c)[1:-1]
        for c in shown
    )
    return shown if limit is None or len(shown) <= limit else f"{shown[: limit - 3]}..."


def without_controls(text: str) -> str:
    """Replace control characters other than line breaks by question marks, for readers that obey or refuse them."""
    return "".join("?" if c != "\n" and unicodedata.category(c) == "Cc" else c for c in text)


def in_one_line(name: str) -> str:
    """Return a name for a line of a text file."""
    return without_controls(" ".join(name.split()))


def in_words(count: int) -> str:
    """Return a count as a word, from ten on in digits."""
    words = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")
    return words[count] if count < len(words) else str(count)


def counted(count: int, what: str) -> str:
    """Return a count with its noun: `1 material`, `2 materials`."""
    return f"{count} {what}{'s' * (count != 1)}"


def percent(share: SupportsFloat, digits: int = 0) -> str:
    """Return a share in per cent, with a number of decimal digits.

    >>> percent(0.045, 1)
    '4.5 %'
    """
    return f"{100.0 * float(share):.{digits}f} %"
