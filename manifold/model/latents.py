"""Validation of latent coordinates given by users."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from manifold.errors import LatentError, UsageError
from manifold.records import Array

Place = Array | Sequence[float] | str
"""A latent (Q,); or as text: the name of a material that lies there, `FROM:TO:T` on the path between two materials, or
coordinates with commas between. A name is what it is: a material called `0,0` comes before the coordinates."""

LARGEST_COORDINATE = 1e9  # latents are of order one; far larger ones overflow when squared


class OnPath(NamedTuple):
    """A place on the path from one material (t = 0) to another (t = 1)."""

    start: str
    end: str
    t: float


def on_path(text: str, names: Collection[str]) -> OnPath | None:
    """What `FROM:TO:T` says; None where the text is a name itself, or no such thing.

    Names may hold colons: of the ways to split the text, it is the one that gives two materials.

    Raises:
        UsageError: T is not from 0 to 1, or there are several such ways.
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
    return OnPath(*(known or ways[-1:])[0], t)


def require_between(t: float) -> None:
    """Raise UsageError where t is no place between two materials: from 0 to 1."""
    if not 0.0 <= t <= 1.0:
        raise UsageError(f"t = {t:g}, expected a number from 0 (the first material) to 1 (the second)")


def coordinates_of(text: str) -> list[float] | None:
    """The numbers of `-0.3,1.2`; None where the text is something else."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        return None


def require_latent(x: Array | Sequence[float], latent_dim: int) -> Array:
    """One latent as float64 (Q,).

    Raises:
        LatentError: it has not so many finite coordinates, or far larger ones than materials have.
    """
    x = _numbers(x)
    if x.ndim > 1:
        raise LatentError(
            f"latents of shape {x.shape}, expected one, ({latent_dim},); call once for each of several"
        )
    if x.shape != (latent_dim,):
        raise LatentError(
            f"latent {np.array2string(x, separator=', ')}: found {x.size} coordinates, expected {latent_dim}; "
            "give as many as the model has dimensions"
        )
    if not np.all(np.isfinite(x)):
        raise LatentError(f"latent {np.array2string(x, separator=', ')}: expected finite coordinates")
    if np.any(np.abs(x) > LARGEST_COORDINATE):
        raise LatentError(
            f"latent {np.array2string(x, separator=', ')}: expected coordinates up to {LARGEST_COORDINATE:g}; "
            "the materials lie within a few units of zero"
        )
    return x


def require_latents(x: ArrayLike, latent_dim: int) -> Array:
    """One latent (Q,) or several (M, Q) as float64.

    Raises:
        LatentError: they have another shape, or are not finite.
    """
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
