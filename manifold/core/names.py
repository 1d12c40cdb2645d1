"""Formats parts of messages: similar names, names on one line, lists and counts."""

from __future__ import annotations

import difflib
import unicodedata
from collections.abc import Iterable, Sequence
from typing import SupportsFloat

_SHOWN = 5
_LEAST_PART = 3  # letters of a part of a name


def names_like(names: Iterable[str], name: str, among: str = "it holds") -> str:
    """Return a text with names similar to an unknown name, or with the first few names if none is similar.

    Similar names contain the name or are close matches, ignoring case. For names of one or two letters, containing it
    is not enough. `among` is the text before the first few names.
    """
    known, name = list(dict.fromkeys(names)), str(name).lower()  # Python users may pass an index
    within = [k for k in known if len(name) >= _LEAST_PART and name in k.lower()]
    close = difflib.get_close_matches(name, [k.lower() for k in known])
    near = within or [k for match in dict.fromkeys(close) for k in known if k.lower() == match]
    if near:
        return f"did you mean {', '.join(near[:_SHOWN])}?"
    return f"{among} {first_few(known)}"


def first_few(words: Sequence[str], most: int = _SHOWN, between: str = ", ", hint: str = "") -> str:
    """Return the first few words and the number of the others, followed by a hint."""
    more = len(words) - most
    return between.join(words[:most]) + (f"{between.rstrip(', ')} and {more} more{hint}" if more > 0 else "")


def printable(text: str, limit: int | None = None, *, keep: str = "") -> str:
    """Return a text on one line, with escapes for unprintable characters, cut at a limit of characters.

    Characters in `keep`, such as line breaks, stay as they are.
    """
    shown = text if limit is None else text[: limit + 1]
    shown = "".join(
        c if c.isprintable() or c in keep or unicodedata.category(c) == "Zs" else ascii(c)[1:-1]
        for c in shown
    )
    return shown if limit is None or len(shown) <= limit else f"{shown[: limit - 3]}..."


def without_controls(text: str) -> str:
    """Replace control characters other than line breaks by question marks, because programs obey or refuse them."""
    return "".join("?" if c != "\n" and unicodedata.category(c) == "Cc" else c for c in text)


def in_one_line(name: str) -> str:
    """Return a name in a form that fits on one line of a text file."""
    return without_controls(" ".join(name.split()))


def in_words(count: int) -> str:
    """Return a count as a word, or in digits from ten on."""
    words = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")
    return words[count] if count < len(words) else str(count)


def counted(count: int, what: str) -> str:
    """Return a count with its noun: `1 material`, `2 materials`."""
    return f"{count} {what}{'s' * (count != 1)}"


def exceeds(value: float, most: float, digits: int) -> bool:
    """Return whether a value exceeds a limit once it is rounded to the number of decimal digits that are printed.

    >>> exceeds(1.04, 1.0, 1), exceeds(1.06, 1.0, 1)
    (False, True)
    """
    return round(value, digits) > most


def percent(share: SupportsFloat, digits: int = 0) -> str:
    """Return a share as a text in per cent, with a number of decimal digits.

    >>> percent(0.045, 1)
    '4.5 %'
    """
    return f"{100.0 * float(share):.{digits}f} %"
