"""Direction pairs: grids of them, and their coordinates in RGL files, which are computed once for many materials."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import DTypeLike

from manifold.core.compiled import loops
from manifold.core.directions import from_rusinkiewicz, require_directions, require_vectors, rotate_z
from manifold.core.errors import ShapeError, UsageError
from manifold.core.records import Array, Indices, Mask
from manifold.registries import NAMED_GRIDS

LEVEL = 1e-9
"""Largest cosine of a direction that is treated as being on the horizon; a right angle rounds to 6e-17."""

GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
"""The golden section; its multiples spread evenly over a turn."""

Symmetry = tuple[bool, int, float]
"""The arguments of `Pairs.located`: whether isotropic, how often azimuths repeat, and the rotation in radians."""


def flat_samples(wi: Array, u: Array) -> tuple[Array, Array, tuple[int, ...]]:
    """Return directions (..., 3) and variates (..., 2) as contiguous (K, 3) and (K, 2), and their broadcast shape."""
    wi, u = require_directions(wi, "wi"), np.asarray(require_vectors(u, "u", 2), dtype=np.float64)
    if not np.all((u >= 0.0) & (u <= 1.0)):
        raise ShapeError("u has values outside [0, 1], expected uniform variates")
    try:
        shape = np.broadcast_shapes(wi.shape[:-1], u.shape[:-1])
    except ValueError as error:
        raise ShapeError(f"wi has shape {wi.shape} and u {u.shape}; they do not broadcast") from error
    flat_wi, flat_u = (np.ascontiguousarray(np.broadcast_to(a, (*shape, a.shape[-1]))) for a in (wi, u))
    return flat_wi.reshape(-1, 3), flat_u.reshape(-1, 2), shape


def value_type(*vectors: Array) -> DTypeLike:
    """Return the type of values at directions: single precision if all directions have it, otherwise double."""
    return np.float32 if all(np.asarray(each).dtype == np.float32 for each in vectors) else np.float64


def as_rows(vectors: Array, others: Array, name: str, width: int = 3) -> tuple[Array, Array, tuple[int, ...]]:
    """Return directions (..., 3) and others (..., width) as contiguous rows, and their broadcast shape.

    The rows are (K, width), or one row for all pairs, in single precision if both arrays are, otherwise in double.
    The compiled loops check the values, because checks in NumPy would take as long as evaluating an RGB file.
    """
    vectors, others = require_vectors(vectors, "wi"), require_vectors(others, name, width)
    dtype = value_type(vectors, others)
    try:
        shape = np.broadcast_shapes(vectors.shape[:-1], others.shape[:-1])
    except ValueError as error:
        raise ShapeError(
            f"wi has shape {vectors.shape} and {name} {others.shape}; they do not broadcast"
        ) from error
    flat: list[Array] = [
        np.ascontiguousarray(w if w.ndim == 1 else np.broadcast_to(w, (*shape, w.shape[-1])), dtype)
        for w in (vectors, others)
    ]
    return flat[0].reshape(-1, 3), flat[1].reshape(-1, width), shape


def results(
    shape: tuple[int, ...], out: Array | None, dtype: DTypeLike, inputs: tuple[Array, Array]
) -> Array:
    """Return the array for results of a shape: `out`, if given, which must fit, or a new array of a type.

    `inputs` are the arrays that are read while results are written.
    """
    if out is None:
        return np.empty(shape, dtype)
    if not isinstance(out, np.ndarray):
        raise ShapeError(f"out is a {type(out).__name__}, expected an array {shape} of float32 or float64")
    if out.shape != shape or out.dtype not in (np.float32, np.float64) or not out.flags.carray:
        raise ShapeError(
            f"out is {out.dtype} {out.shape}, expected contiguous float32 or float64 {shape}, which can be written"
        )
    if any(np.may_share_memory(out, each) for each in inputs):
        raise ShapeError("out overlaps the directions, expected an array with memory of its own")
    return out


def cosine_weight(wi: Array, wo: Array) -> Array:
    """Return `cos(theta_i) cos(theta_o)`, 0 below the horizon, shape (...)."""
    return np.maximum(wi[..., 2], 0.0) * np.maximum(wo[..., 2], 0.0)


class Pairs:
    """K pairs of directions, checked and flat.

    Attributes:
        wi, wo: contiguous unit vectors, shape (K, 3).
        shape: broadcast shape of the pairs, without the axis of the vectors.
    """

    def __init__(self, wi: Array, wo: Array) -> None:
        """Broadcast two arrays of unit vectors (..., 3) against each other."""
        wi, wo = require_directions(wi, "wi"), require_directions(wo, "wo")
        try:
            wi, wo = np.broadcast_arrays(wi, wo)
        except ValueError as error:
            raise ShapeError(f"wi has shape {wi.shape} and wo {wo.shape}; they do not broadcast") from error
        flat = [np.ascontiguousarray(w).reshape(-1, 3) for w in (wi, wo)]
        self.wi, self.wo, self.shape = flat[0], flat[1], wi.shape[:-1]
        self._located: dict[Symmetry, Array] = {}

    def __len__(self) -> int:
        return len(self.wi)

    def blocks(self, size: int) -> Iterator[tuple[slice, Pairs]]:
        """Yield the pairs in blocks of at most `size`, each with its slice."""
        for start in range(0, len(self), size):
            rows = slice(start, start + size)
            yield rows, self[rows]

    def __getitem__(self, rows: slice | Indices | Mask) -> Pairs:
        """Return some of the pairs."""
        part = Pairs.__new__(Pairs)
        part.wi, part.wo, part._located = self.wi[rows], self.wo[rows], {}
        part.shape = part.wi.shape[:1]
        return part

    def __add__(self, others: Pairs) -> Pairs:
        """Return these pairs, followed by others."""
        return Pairs(np.concatenate([self.wi, others.wi]), np.concatenate([self.wo, others.wo]))

    @cached_property
    def cosines(self) -> Array:
        """cos(theta_i) cos(theta_o), shape (K,)."""
        return cosine_weight(self.wi, self.wo)

    def results(self, count: int, out: Array | None, dtype: DTypeLike) -> Array:
        """Return the array for `count` values per pair, shape (..., count): `out`, if given, or a new array."""
        return results((*self.shape, count), out, dtype, (self.wi, self.wo))

    def turned(self, angle_rad: float) -> tuple[Array, Array]:
        """Rotate both directions about the normal; return two arrays (K, 3)."""
        if angle_rad == 0.0:
            return self.wi, self.wo
        return rotate_z(self.wi, angle_rad), rotate_z(self.wo, angle_rad)

    def located(self, isotropic: bool, reduction: int, rotation_rad: float = 0.0) -> Array:
        """Return `theta_i, phi_i, u_x, u_y` of the half vector and cos(theta_o), shape (K, 5).

        For a pair below the horizon, only the cosine 0 is defined. For isotropic materials, u_y is relative to the
        incident azimuth. A file with `reduction` 2 or 4 holds half or a quarter of the azimuths. `rotation_rad` is
        the azimuth by which the specimen was turned. The result is cached, because it takes as long as looking up
        fifty bands, and most materials have the same symmetry.
        """
        key = (isotropic, reduction, rotation_rad)
        if key not in self._located:
            out = np.empty((len(self), 5))
            loops.locate_pairs(*self.turned(rotation_rad), isotropic, reduction, out)
            self._located[key] = out
        return self._located[key]


@dataclass(frozen=True)
class RusinkiewiczGrid:
    """A grid of direction pairs over theta_h and theta_d in [0, 90) and phi_d in [0, 180) degrees.

    Half vectors have azimuth 0, which is enough for isotropic materials; anisotropic materials need `is_turned`.

    Attributes:
        n_theta_h, n_theta_d, n_phi_d: nodes per angle; phi_d runs fastest.
        squared_theta_h: whether theta_h is spaced by squares, dense around the mirror direction, as in MERL files.
        offset: position of a node in its cell, from 0 (lower edge) to below 1; 0.5 is the centre.
        is_turned: whether each pair is turned about the normal by a multiple of the golden section of a turn, so that
            the same number of half vectors covers all azimuths at every theta_h.
    """

    n_theta_h: int = 45
    n_theta_d: int = 23
    n_phi_d: int = 12
    squared_theta_h: bool = True
    offset: float = 0.5
    is_turned: bool = False

    def __post_init__(self) -> None:
        if min(self.n_theta_h, self.n_theta_d, self.n_phi_d) < 1 or not 0.0 <= self.offset < 1.0:
            raise UsageError(f"{self}: expected at least one node per angle and an offset in [0, 1)")

    @classmethod
    def named(cls, name: str) -> RusinkiewiczGrid:
        """Return a grid by its name.

        `default` is 45 x 23 x 12, for left-out errors; `hikichi` is 90 x 90 x 180 (Hikichi & Iwasaki, eq.
        22).
        """
        return NAMED_GRIDS[name]

    def suited_to(self, is_isotropic: bool) -> RusinkiewiczGrid:
        """Return this grid, turned (`is_turned`) unless all compared materials are isotropic."""
        return self if is_isotropic else replace(self, is_turned=True)

    @property
    def n_pairs(self) -> int:
        """Number of direction pairs, including those below the horizon."""
        return self.n_theta_h * self.n_theta_d * self.n_phi_d

    def angles(self, start: int = 0, stop: int | None = None) -> tuple[Array, Array, Array]:
        """Return `theta_h, theta_d, phi_d` in radians of pairs start to stop, each of shape (stop - start,)."""
        index = np.arange(start, self.n_pairs if stop is None else min(stop, self.n_pairs))
        h, d, p = np.unravel_index(index, (self.n_theta_h, self.n_theta_d, self.n_phi_d))
        fraction_h = (h + self.offset) / self.n_theta_h
        theta_h = (fraction_h**2 if self.squared_theta_h else fraction_h) * (0.5 * np.pi)
        theta_d = (d + self.offset) / self.n_theta_d * (0.5 * np.pi)
        return theta_h, theta_d, (p + self.offset) / self.n_phi_d * np.pi

    def directions(self, start: int = 0, stop: int | None = None) -> tuple[Array, Array, Mask]:
        """Return pairs start to stop: wi (M, 3), wo (M, 3), and a mask of those above the horizon, bool (M,)."""
        wi, wo = from_rusinkiewicz(*self.angles(start, stop))
        above = (wi[:, 2] > 0.0) & (wo[:, 2] > 0.0)
        if self.is_turned:
            azimuth = 2.0 * np.pi * ((GOLDEN * np.arange(start, start + len(wi))) % 1.0)
            wi, wo = rotate_z(wi, azimuth), rotate_z(wo, azimuth)
        return wi, wo, above

    def pairs(self, stride: int = 1) -> Pairs:
        """Return every `stride`-th pair above the horizon."""
        wi, wo, above = self.directions()
        return Pairs(wi[above][::stride], wo[above][::stride])

    def blocks(self, size: int = 65536) -> Iterator[tuple[Array, Array, Mask]]:
        """Yield `directions` in blocks of at most `size` pairs: the whole 1,458,000-pair grid in bounded memory."""
        for start in range(0, self.n_pairs, size):
            yield self.directions(start, start + size)


DEFAULT = RusinkiewiczGrid()
HIKICHI = RusinkiewiczGrid(90, 90, 180, squared_theta_h=False, offset=0.0)
"""The grid of Hikichi & Iwasaki, see `NAMED_GRIDS`."""
