"""Reads and writes the common parts of the `.bsdf` text formats of LightTools and Zemax."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from manifold.core.defaults import DARKEST
from manifold.core.records import Array, Indices
from manifold.formats.quantities import BRDF, quantity_in_prose
from manifold.formats.text import (
    ErrorContext,
    angle_unit,
    data_lines,
    is_length_unit,
    number_with_unit,
    read_lines,
    wavelength_nm,
)

_MOST_ANGLES = 20_000
_MOST_VALUES = 50_000_000
_REMEDY = "export the file again"
_MOST_BLOCKS = 100_000
_LISTS = ("samplerotation", "angleofincidence", "scatterazimuth", "scatterradial")
_NUMBERS = ("aoi", "poi", "wavelength")
# Of the larger of a TIS and its table's integral: few nodes in a highlight, or cut at the horizon, differ by less.
_APART = 0.5
_XYZ = {f"{word}{letter}": k for word in ("tris", "tristimulus") for k, letter in enumerate("xyz")}


@dataclass(frozen=True, eq=False)
class Block:
    """A table of values, and the keys before it.

    Attributes:
        values: azimuths x radials.
        words: the texts after other keys, by the key in plain form.
        numbers: `aoi`, `poi` and `wavelength`, if they are given.
        tristimulus: 0, 1 or 2 for X, Y or Z.
        tis: total integrated scatter (TIS) that the file states, as a fraction.
    """

    values: Array
    words: dict[str, str]
    numbers: dict[str, float]
    tristimulus: int | None
    tis: float


@dataclass
class BsdfText:
    """The content of a file: lists of angles, and blocks.

    Attributes:
        lists: angles in degrees by plain key, such as `scatterradial`.
        blocks: its tables, in their order.
    """

    context: ErrorContext
    comments: list[str]
    lists: dict[str, Array] = field(default_factory=dict)
    blocks: list[Block] = field(default_factory=list)

    def directions(self) -> tuple[Array, Array, Indices]:
        """Return the distinct directions of the tables, see `unique_directions`."""
        return unique_directions(self.lists["scatterazimuth"], self.lists["scatterradial"])

    def require_brdf(self, words: dict[str, str]) -> None:
        """Raise FileFormatError if the keys before a table say that its values are not a BRDF."""
        said = words.get("scattertype", "BRDF")
        if quantity_in_prose(said, "ScatterType", self.context) is not BRDF:
            raise self.context.error(f"ScatterType is '{said[:24]}', expected BRDF")


def unique_directions(azimuths: Array, radials: Array) -> tuple[Array, Array, Indices]:
    """Return azimuths (n,) and radial angles (n,) of a table's distinct directions in degrees, and their indices.

    Azimuth 360 is dropped if 0 is present. Radial angle 0 is one direction, which has the first azimuth.
    """
    keep = np.ones((azimuths.size, radials.size), dtype=bool)
    if azimuths.size > 1 and np.isclose(azimuths[-1] - azimuths[0], 360.0):
        keep[-1] = False
    keep[1:, np.isclose(radials, 0.0)] = False
    azimuth, radial = (a[keep] for a in np.meshgrid(azimuths, radials, indexing="ij"))
    return azimuth, radial, np.flatnonzero(keep)


def read_blocks(path: Path) -> BsdfText:
    """Read all tables of a file."""
    lines = read_lines(path)
    words = Words(data_lines(lines), ErrorContext(path, _REMEDY))
    comments = [line.strip() for line in lines if line.lstrip().startswith(("#", "!"))]
    text = BsdfText(words.context, comments)
    said: dict[str, str] = {}
    numbers: dict[str, float] = {}
    band: int | None = None
    while (word := words.next()) is not None:
        key = _plain(word)
        if key in _LISTS:
            text.lists[key] = words.angles(word)
        elif key in _NUMBERS:
            numbers[key] = words.with_unit(word)
        elif key in _XYZ or key == "monochrome":
            band = _XYZ.get(key)
        elif key == "tristimulusvalue":
            band = _XYZ.get(_plain(words.rest()))
        elif key == "tis":
            tis = words.number(word)
            missing = [name for name in _LISTS[2:] if name not in text.lists]
            if missing or len(text.blocks) == _MOST_BLOCKS:
                expected = f"{missing[0]} before it" if missing else f"at most {_MOST_BLOCKS}"
                raise text.context.error(f"a table, expected {expected}", words.line)
            values = words.table(*(text.lists[name] for name in _LISTS[2:]))
            text.blocks.append(Block(values, dict(said), dict(numbers), band, tis))
        elif re.match(r"[+-]?[\d.]", word):
            raise text.context.error(f"found '{word[:24]}', expected a key: a table is too long", words.line)
        elif key not in ("databegin", "dataend"):
            said[key] = words.rest()
    return text


class Words:
    """An iterator over the words of a file that knows the line of each word."""

    def __init__(self, lines: list[tuple[int, str]], context: ErrorContext) -> None:
        """Take lines with their numbers in the file."""
        self.context, self._lines = context, lines
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
        """Text such as `line 12` that names the line of the next word, for error messages."""
        last = self._lines[min(self._line, len(self._lines) - 1)][0] if self._lines else 1
        return f"line {last}"

    def next(self) -> str | None:
        """Return the next word, or None at the end."""
        while self._line < len(self._lines):
            words = self._words
            if self._word < len(words):
                self._word += 1
                return words[self._word - 1]
            self._line, self._word = self._line + 1, 0
        return None

    def rest(self) -> str:
        """Return the rest of the current line."""
        if self._line >= len(self._lines):
            return ""
        words = self._words[self._word :]
        self._line, self._word = self._line + 1, 0
        return " ".join(words)

    def number(self, what: str) -> float:
        """Return the next word as a finite number."""
        where = self.line
        word = self.next()
        if word is None:
            raise self.context.error(f"the file ends, expected {what}", where)
        return self.context.number(word, f"{where}, {what}")

    def with_unit(self, key: str) -> float:
        """Return the next word in degrees, or in nanometres if `key` is `Wavelength`; a unit may follow the number."""
        where, word = self.line, self.next() or ""
        rest = self._words[self._word :] if self._line < len(self._lines) and self.line == where else []
        measure = number_with_unit(word)
        if (
            measure is not None
            and not measure.unit
            and rest
            and (is_length_unit(rest[0]) or angle_unit(rest[0]))
        ):
            word += f" {self.next()}"
        is_wavelength = _plain(key) == "wavelength"
        measure = number_with_unit(word)
        value = wavelength_nm(word) if is_wavelength else measure.value if measure is not None else None
        is_other = (
            not is_wavelength
            and measure is not None
            and measure.unit
            and angle_unit(measure.unit) != "degrees"
        )
        if value is None or is_other:
            expected = "a wavelength such as 633 nm" if is_wavelength else "degrees"
            raise self.context.error(f"{key} is '{word[:24]}', expected {expected}", where)
        return value

    def numbers(self, count: int, what: str) -> Array:
        """Return the next `count` words as finite numbers, shape (count,)."""
        values: list[float] = []
        while len(values) < count:
            if self._line >= len(self._lines):
                raise self.context.error(
                    f"the file ends after {len(values)} of {count} {what}: it is truncated", self.line
                )
            number, words = self._lines[self._line][0], self._words
            taken = words[self._word : self._word + count - len(values)]
            if taken and taken[0][:1].isalpha():
                raise self.context.error(
                    f"{len(values)} {what}, expected {count} before '{taken[0][:24]}'", f"line {number}"
                )
            values += self.context.numbers(taken, number) if taken else []
            self._word += len(taken)
            if self._word >= len(words):
                self._line, self._word = self._line + 1, 0
        return np.array(values)

    def count(self, what: str) -> int:
        """Return the next word as a whole number of angles or bands, at least 1."""
        where = self.line
        return self.context.count(self.next() or "", f"{where}, {what}", _MOST_ANGLES)

    def increasing(self, count: int, what: str) -> Array:
        """Return the next `count` words as finite numbers that increase, shape (count,)."""
        where, values = self.line, self.numbers(count, what)
        if np.any(np.diff(values) <= 0.0):
            raise self.context.error(f"{what} do not increase, expected increasing ones", where)
        return values

    def angles(self, key: str) -> Array:
        """Return the increasing angles in degrees whose count and values follow a key."""
        return self.increasing(self.count(key), f"angles of {key}")

    def table(self, azimuths: Array, radials: Array) -> Array:
        """Return the next azimuths x radials values, in lines of any length."""
        shape = azimuths.size, radials.size
        if azimuths.size * radials.size > _MOST_VALUES:
            raise self.context.error(f"{shape[0]} x {shape[1]} values, expected at most {_MOST_VALUES}")
        return self.numbers(azimuths.size * radials.size, "values of a table").reshape(shape)


def _plain(word: str) -> str:
    """Return a key without case, colons and underscores."""
    return re.sub(r"[^a-z0-9]", "", word.lower())


def total_scatter(values: Array, azimuth: Array, radial: Array, cosine: Array) -> float:
    """Return the total scatter of a table (azimuths, radials), the scattered fraction of the incident light.

    Angles are in radians about the axis of the table; the cosines of theta_o broadcast. Tables with one azimuth, or
    over half a turn, are symmetric. The integral is by the trapezoidal rule.
    """
    rings = values * np.abs(np.sin(radial)) * np.maximum(cosine, 0.0)
    turn = 2.0 * np.pi if radial[0] >= 0.0 else np.pi
    mean = np.trapezoid(rings, azimuth, axis=0) / np.ptp(azimuth) if azimuth.size > 1 else rings[0]
    return float(turn * np.trapezoid(mean, radial))


def note_contradictions(text: BsdfText, tables: Iterable[tuple[Block, Array]], notes: list[str]) -> None:
    """Add a note if the stated total scatter (TIS) is far from its table's integral; cosines of theta_o broadcast."""
    azimuth, radial = (np.deg2rad(text.lists[name]) for name in _LISTS[2:])
    pairs = [(block.tis, total_scatter(block.values, azimuth, radial, cosine)) for block, cosine in tables]
    apart = [abs(said - found) / max(abs(said), abs(found), DARKEST) for said, found in pairs]
    if max(apart, default=0.0) > _APART:
        said, found = pairs[int(np.argmax(apart))]
        count = sum(a > _APART for a in apart)
        notes.append(
            f"{count} of {len(pairs)} tables contradict their TIS (one says {said:.3g}, its values integrate to "
            f"{found:.3g}): values are taken as f in 1/sr"
        )


def angle_line(angles: Array) -> str:
    """Return a line of angles in these files' format."""
    return " ".join(f"{angle:.6g}" for angle in angles)
