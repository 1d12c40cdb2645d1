"""Names that a user may have meant."""

from __future__ import annotations

import difflib
from collections.abc import Sequence

_SHOWN = 5


def names_like(names: Sequence[str], name: str, among: str = "it holds") -> str:
    """Similar names for an error message: those that contain a name, or are close matches; else the first few.

    Args:
        names: that are known.
        name: that is not.
        among: what stands before the first few.
    """
    within = [known for known in names if name and name.lower() in known.lower()]
    near = (within or difflib.get_close_matches(name, names))[:_SHOWN]
    if near:
        return f"near are {', '.join(near)}"
    more = len(names) - _SHOWN
    return f"{among} {', '.join(names[:_SHOWN])}" + f" and {more} more" * (more > 0)
