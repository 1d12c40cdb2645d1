"""Common parts of the text formats `.bsdf` of LightTools and Zemax: words, lists with counts, and tables of blocks."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from manifold.formats.text import Place, read_lines
from manifold.records import Array

_MOST_ANGLES = 20_000
_MOST_VALUES = 50_000_000
_REMEDY = "export the file again"
_COMMENT = ("#", "!")
XYZ_TO_BAND = {"trisx": 0, "trisy": 1, "trisz": 2, "tristimulusx": 0, "tristimulusy": 1, "tristimulusz": 2}


class Words:
    """The words of a file in turn, comments left out, each with its line."""

    def __init__(self, path: Path) -> None:
        """Read the file. Raises: as `read_lines`."""
        self.place = Place(path, _REMEDY)
        numbered = [(k, line) for k, line in enumerate(read_lines(path), start=1) if line.strip()]
        self._lines = [(k, line) for k, line in numbered if not line.lstrip().startswith(_COMMENT)]
        self.comments = [line.strip() for _, line in numbered if line.lstrip().startswith(_COMMENT)]
        self._line, self._word = 0, 0
        self._split: tuple[int, list[str]] = (-1, [])

    @property
    def _words(self) -> list[str]:
        """The words of the line that was begun; lines are split one at a time, to save memory."""
        if self._split[0] != self._line:
            self._split = self._line, self._lines[self._line][1].replace("=", " ").replace('"', " ").split()
        return self._split[1]

    @property
    def line(self) -> str:
        """The line of the next word, for errors."""
        last = self._lines[min(self._line, len(self._lines) - 1)][0] if self._lines else 1
        return f"line {last}"

    def next(self) -> str | None:
        """The next word, or None at the end."""
        while self._line < len(self._lines):
            words = self._words
            if self._word < len(words):
                self._word += 1
                return words[self._word - 1]
            self._line, self._word = self._line + 1, 0
        return None

    def rest(self) -> str:
        """What is left of the line that was begun."""
        if self._line >= len(self._lines):
            return ""
        words = self._words[self._word :]
        self._line, self._word = self._line + 1, 0
        return " ".join(words)

    def number(self, what: str) -> float:
        """The next word as a finite number."""
        where = self.line
        word = self.next()
        if word is None:
            raise self.place.error(f"the file ends, expected {what}", where)
        return self.place.number(word, f"{where}, {what}")

    def numbers(self, count: int, what: str) -> Array:
        """The next `count` words as finite numbers, shape (count,)."""
        values: list[float] = []
        while len(values) < count:
            if self._line >= len(self._lines):
                raise self.place.error(
                    f"the file ends after {len(values)} of {count} {what}: it is truncated", self.line
                )
            number, words = self._lines[self._line][0], self._words
            taken = words[self._word : self._word + count - len(values)]
            if taken and taken[0][:1].isalpha():
                raise self.place.error(
                    f"{len(values)} {what}, expected {count} before '{taken[0][:24]}'", f"line {number}"
                )
            values += self.place.numbers(taken, number) if taken else []
            self._word += len(taken)
            if self._word >= len(words):
                self._line, self._word = self._line + 1, 0
        return np.array(values)

    def angles(self, key: str) -> Array:
        """A count and that many angles in degrees that increase, as they follow a key."""
        where = self.line
        count = self.place.count(self.next() or "", f"{where}, {key}", _MOST_ANGLES)
        values = self.numbers(count, f"angles of {key}")
        if np.any(np.diff(values) <= 0.0):
            raise self.place.error(f"{key} does not increase, expected ordered angles", where)
        return values

    def table(self, azimuths: Array, radials: Array, what: str) -> Array:
        """The next azimuths x radials values; the lines' own division does not matter."""
        if azimuths.size * radials.size > _MOST_VALUES:
            raise self.place.error(
                f"{azimuths.size} x {radials.size} values, expected at most {_MOST_VALUES}"
            )
        return self.numbers(azimuths.size * radials.size, what).reshape(azimuths.size, radials.size)


def plain(word: str) -> str:
    """A key without case, colons and underscores."""
    return re.sub(r"[^a-z0-9]", "", word.lower())


def grid_rows(azimuths: Array, radials: Array) -> Array:
    """Indices (n,) of an azimuths x radials table that are directions of their own.

    A full turn appears once; radial 0 is one direction, of which the first azimuth is taken.
    """
    last_is_first = azimuths.size > 1 and np.isclose(azimuths[-1] - azimuths[0], 360.0)
    keep = np.ones((azimuths.size, radials.size), dtype=bool)
    if last_is_first:
        keep[-1] = False
    keep[1:, np.isclose(radials, 0.0)] = False
    return np.flatnonzero(keep)


def angle_line(angles: Array) -> str:
    """Angles as such files write them."""
    return " ".join(f"{angle:.6g}" for angle in angles)
