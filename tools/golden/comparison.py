"""Two runs compared: which numbers moved, and by how much, which appeared, and which disappeared."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from typing import TypedDict

from golden.values import Numbers, Value

RELATIVE = 1e-6  # runs on one machine agree to 1e-9; libraries of other versions sum in another order
ABSOLUTE = 1e-9  # differences of numbers of about 1, such as an error of nothing
RENAMED: tuple[tuple[str, str], ...] = ()
"""Old names of the kept numbers and their new ones: a regular expression for STEP: NAME, and its replacement."""

_WORST = 4  # moved numbers that are shown
_KINDS = 6  # kinds of names that are shown


class Step(TypedDict, total=False):
    """What is kept of a step: its numbers, or the message of its failure."""

    numbers: Numbers
    failed: str


def compared(step: str, old: Step, new: Step) -> list[str]:
    """Lines about a step; none where nothing moved."""
    failures = old.get("failed"), new.get("failed")
    if any(failures):
        if failures[0] == failures[1]:
            return []
        return [f"failed: {failures[1]}" if failures[1] else f"no longer fails ({failures[0]})"]
    before, after = _renamed(step, old["numbers"]), new["numbers"]
    moved = sorted(
        ((change, name) for name in before.keys() & after.keys() if (change := _change(before[name], after[name]))),
        reverse=True,
    )  # fmt: skip
    lines = []
    if moved:
        texts = sum(isinstance(after[name], str) for _, name in moved)
        lines.append(
            f"moved {len(moved)} of {len(after)}"
            + (f", {texts} of them texts" if texts else "")
            + "".join(f", {sum(c > size for c, _ in moved)} by more than {size:g}" for size in (1e-4, 1e-2))
        )
        lines += [f"  {name}: {_pair(before[name], after[name])}" for _, name in moved[:_WORST]]
    gone, came = before.keys() - after.keys(), after.keys() - before.keys()
    if gone or came:
        same = _of_equal_value([before[n] for n in gone], [after[n] for n in came])
        lines.append(f"disappeared {len(gone)}, appeared {len(came)}; {same} of them with an equal value")
        lines += [
            f"  {sign} {kinds}" for sign, names in (("-", gone), ("+", came)) if (kinds := _kinds(names))
        ]
    return lines


def _renamed(step: str, numbers: Numbers) -> Numbers:
    made: Numbers = {}
    for name, value in numbers.items():
        full = f"{step}: {name}"
        for old, new in RENAMED:
            full = re.sub(old, new, full)
        made[full.removeprefix(f"{step}: ")] = value
    return made


def _change(old: Value, new: Value) -> float:
    """Relative change, 0 if within the tolerance; infinite of what is another text."""
    if old == new:
        return 0.0
    if isinstance(old, str) or isinstance(new, str):
        return float("inf")
    size = max(abs(old), abs(new))
    return abs(new - old) / size if abs(new - old) > RELATIVE * size + ABSOLUTE else 0.0


def _pair(old: Value, new: Value) -> str:
    if isinstance(old, str) or isinstance(new, str):
        return f"{old!r} -> {new!r}"
    share = abs(new - old) / max(abs(old), abs(new))
    return f"{old:.7g} -> {new:.7g} ({share:.1e})"


def _of_equal_value(gone: list[Value], came: list[Value]) -> int:
    """How many of what disappeared are there under another name, by their values."""

    def key(value: Value) -> str:
        return value if isinstance(value, str) else f"{value:.5g}"

    return sum((Counter(map(key, gone)) & Counter(map(key, came))).values())


def _kinds(names: Iterable[str]) -> str:
    """Names shown once per kind: numbers in them are left out."""
    counts = Counter(re.sub(r"\d+", "*", name) for name in names)
    shown = [f"{kind} x {n}" if n > 1 else kind for kind, n in counts.most_common(_KINDS)]
    return ", ".join(shown) + (f", and {len(counts) - _KINDS} more kinds" if len(counts) > _KINDS else "")
