"""Parses points on a map of materials: latents, names of materials, and steps of walks between two materials."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike

from manifold.core.errors import LatentError, UsageError
from manifold.core.names import counted
from manifold.core.records import Array

LARGEST_COORDINATE = 1e9  # latents are of order one; far larger ones overflow when squared


@dataclass(frozen=True, eq=False)
class Place:
    """A point on a map of materials, or a step of a walk.

    Attributes:
        latent: latent, shape (Q,); for a step of a walk, the point on the straight line, which is used if colours are
            given.
        walk: the two materials and t of `FROM:TO:T`, a step of the walk between them; None for a point.
        rotation_rad: azimuth by which an anisotropic specimen is turned relative to the materials of the map.
    """

    latent: Array
    walk: tuple[str, str, float] | None = None
    rotation_rad: float = 0.0

    def is_step(self, colours: Array | None) -> bool:
        """Return whether the prediction is a step of a walk, computed from its two materials and not from the latent.

        If colours are given, the prediction uses the latent, and the result is False.
        """
        return self.walk is not None and colours is None

    @property
    def walk_in_words(self) -> str:
        """Return a text that states the position on the walk."""
        return "" if self.walk is None else "between {} and {}, t = {:g}".format(*self.walk)


PlaceLike = Place | Array | Sequence[float] | str
"""A `Place`, a latent (Q,), or a text: the name of a material, `FROM:TO:T` for a step of the walk between two
materials, or coordinates separated by commas. A material called `0,0` takes precedence over these coordinates."""


def parse_walk(text: str, names: Collection[str]) -> tuple[str, str, float] | None:
    """Return the two materials and t of `FROM:TO:T`; None for a name or a text of another form.

    Names may contain colons; the text is split where both parts are names of materials.
    """
    *parts, last = text.split(":")
    ways = [(":".join(parts[:k]), ":".join(parts[k:])) for k in range(1, len(parts))]
    known = [way for way in ways if set(way) <= set(names)]
    try:
        t = float(last)
    except ValueError:
        t = np.nan
    if text in names or not ways or (not known and np.isnan(t)):
        return None
    if not 0.0 <= t <= 1.0:
        raise UsageError(f"'{text}': found '{last}' after two materials, expected a number from 0 to 1")
    if len(known) > 1:
        pairs = ", and ".join(f"from '{start}' to '{end}'" for start, end in known)
        raise UsageError(
            f"'{text}' is {pairs}; use `Manifold.interpolate` in Python, or names without colons"
        )
    return *(known or ways[-1:])[0], t


def require_between(t: float) -> None:
    """Raise UsageError unless t is one number and 0 <= t <= 1."""
    if not isinstance(t, Real) or not 0.0 <= t <= 1.0:
        found = f"{t:g}" if isinstance(t, Real) else f"a value of type {type(t).__name__}"
        raise UsageError(f"t = {found}, expected a number from 0 (the first material) to 1 (the second)")


def on_line(start: Array, end: Array, t: float) -> Array:
    """Return the latent at t, from 0 to 1, on the line between two latents (Q,); it is exact at both ends."""
    way = end - start
    return start + t * way if t < 0.5 else end - (1.0 - t) * way


def parse_coordinates(text: str) -> list[float] | None:
    """Return the numbers of a text such as `-0.3,1.2`; None for another text."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        return None


def is_place(text: str) -> bool:
    """Return whether a text has the form of coordinates or of `FROM:TO:T`, whether or not the materials exist."""
    return parse_coordinates(text) is not None or parse_walk(text, ()) is not None


def require_latent(x: ArrayLike, latent_dim: int) -> Array:
    """Return one latent as float64, shape (Q,), after checking it."""
    x = _numbers(x)
    if x.ndim > 1:
        raise LatentError(f"latents of shape {x.shape}, expected one, ({latent_dim},)")
    shown = f"latent {np.array2string(x, separator=', ')}"
    if x.shape != (latent_dim,):
        raise LatentError(f"{shown}: found {counted(x.size, 'coordinate')}, expected {latent_dim}")
    if not np.all(np.abs(x) <= LARGEST_COORDINATE):
        raise LatentError(f"{shown}: expected finite coordinates, of at most {LARGEST_COORDINATE:g}")
    return x


def require_latents(x: ArrayLike, latent_dim: int) -> Array:
    """Return one latent (Q,) or several latents (M, Q) as float64, after checking them."""
    x = _numbers(x)
    if x.ndim not in (1, 2) or x.shape[-1] != latent_dim or not np.all(np.isfinite(x)):
        raise LatentError(
            f"latents have shape {x.shape}, expected ({latent_dim},) or (M, {latent_dim}), finite"
        )
    return x


def _numbers(x: ArrayLike) -> Array:
    try:
        return np.asarray(x, dtype=np.float64)
    except (TypeError, ValueError):
        raise LatentError(f"latent {x!r:.60}: expected numbers") from None
