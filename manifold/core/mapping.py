"""Mappings T of BRDF values under which materials are combined: `T^-1(sum_i v_i T(f_i))`.

BRDF values span six decades, and a sum over raw values sees only the highlights; a mapping compresses them.
All mappings follow the same rules:

- values keep their shape, a floating dtype is kept, and NaN (a masked cell) stays NaN both ways;
- an exact zero maps to a finite number and back to exactly zero;
- negative values (measurement noise) keep their sign under `identity` and `cube-root`, and count as zero
  under the logarithms, whose inverse is never negative.

`inverse(forward(f))` is f only to rounding. Where a prediction has to be a measured value bit for bit, take
that value instead of mapping it back and forth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from manifold.core.errors import ShapeError
from manifold.core.records import Array


class ValueMapping(Protocol):
    """The interface of a mapping T and its inverse."""

    @property
    def name(self) -> str:
        """The name under which `MAPPINGS` has it."""

    def forward(self, values: Array, cosine_weight: Array | None = None) -> Array:
        """Apply T to BRDF values in 1/sr.

        Args:
            values: shape (..., B), bands last.
            cosine_weight: `cos(theta_i) cos(theta_o)` per direction pair, shape (...), for the mappings that
                weight by it; None is a weight of 1.

        Returns:
            Mapped values, shape (..., B).
        """

    def inverse(self, mapped: Array, cosine_weight: Array | None = None) -> Array:
        """Apply T^-1 to mapped values (..., B), back to 1/sr, with the weight that `forward` had."""

    def slope(self, values: Array, cosine_weight: Array | None = None) -> Array:
        """Return the derivative of T^-1 at the mapped values that give these values (..., B)."""


def _as_floating(values: Array) -> Array:
    values = np.asarray(values)
    return values if np.issubdtype(values.dtype, np.floating) else values.astype(np.float64)


@dataclass(frozen=True)
class Identity:
    """`T(f) = f`: the mapping of Hikichi & Iwasaki. Highlights dominate every distance."""

    name = "identity"

    def forward(self, values: Array, cosine_weight: Array | None = None) -> Array:
        """Return the values unchanged."""
        return _as_floating(values)

    def inverse(self, mapped: Array, cosine_weight: Array | None = None) -> Array:
        """Return the values unchanged."""
        return _as_floating(mapped)

    def slope(self, values: Array, cosine_weight: Array | None = None) -> Array:
        """Return ones."""
        return np.ones_like(_as_floating(values))


@dataclass(frozen=True)
class CubeRoot:
    """`T(f) = f^(1/3)`, signed: close to perceived lightness, and exact at zero.

    >>> CubeRoot().forward(np.array([0.008, 1.0]))
    array([0.2, 1. ])
    """

    name = "cube-root"

    def forward(self, values: Array, cosine_weight: Array | None = None) -> Array:
        """Return the signed cube root."""
        return np.cbrt(_as_floating(values))

    def inverse(self, mapped: Array, cosine_weight: Array | None = None) -> Array:
        """Return the cube."""
        mapped = _as_floating(mapped)
        return mapped * mapped * mapped

    def slope(self, values: Array, cosine_weight: Array | None = None) -> Array:
        """Return `3 f^(2/3)`."""
        root = np.cbrt(_as_floating(values))
        return 3.0 * root * root


@dataclass(frozen=True)
class Log:
    """`T(f) = ln((f + epsilon) / epsilon)`, which is 0 at 0.

    Attributes:
        epsilon: in 1/sr, positive; differences between values far below it do not count.
    """

    epsilon: float = 1e-3
    name = "log"

    def forward(self, values: Array, cosine_weight: Array | None = None) -> Array:
        """Return the logarithm; negative values count as 0."""
        return np.log1p(np.maximum(_as_floating(values), 0.0) / self.epsilon)

    def inverse(self, mapped: Array, cosine_weight: Array | None = None) -> Array:
        """Return the exponential, at least 0."""
        return np.expm1(np.maximum(_as_floating(mapped), 0.0)) * self.epsilon

    def slope(self, values: Array, cosine_weight: Array | None = None) -> Array:
        """Return `f + epsilon`, also at 0, where the inverse stops, so that a search can leave 0."""
        return _as_floating(values) + self.epsilon


@dataclass(frozen=True)
class LogRelative:
    """`T(f) = ln((f w + epsilon) / epsilon)` with `w = max(cos(theta_i) cos(theta_o), floor)`.

    The cosines tame grazing angles, where values are large and count for little. The publication divides by the median
    material besides, which only shifts T: it cancels in every combination whose weights sum to 1 and in every centred
    Gram matrix.

    Attributes:
        epsilon: in 1/sr, positive.
        floor: least cosine weight, positive.
    Source: Nielsen, Jensen & Ramamoorthi 2015, eq. 2.
    """

    epsilon: float = 1e-3
    floor: float = 1e-3
    name = "log-relative"

    def forward(self, values: Array, cosine_weight: Array | None = None) -> Array:
        """Return the logarithm of the weighted value; negative values count as 0."""
        values = _as_floating(values)
        return np.log1p(np.maximum(values, 0.0) * (self._weight(values, cosine_weight) / self.epsilon))

    def inverse(self, mapped: Array, cosine_weight: Array | None = None) -> Array:
        """Return the original values, at least 0."""
        mapped = _as_floating(mapped)
        return np.expm1(np.maximum(mapped, 0.0)) * self.epsilon / self._weight(mapped, cosine_weight)

    def slope(self, values: Array, cosine_weight: Array | None = None) -> Array:
        """Return `f + epsilon / w`, also at 0, where the inverse stops, so that a search can leave 0."""
        values = _as_floating(values)
        return values + self.epsilon / self._weight(values, cosine_weight)

    def _weight(self, like: Array, cosine_weight: Array | None) -> Array | float:
        if cosine_weight is None:
            return 1.0
        weight = np.asarray(cosine_weight, dtype=like.dtype)
        if weight.shape != like.shape[:-1]:
            raise ShapeError(
                f"cosine_weight has shape {weight.shape}, expected {like.shape[:-1]}, one per direction pair"
            )
        return np.maximum(weight, self.floor)[..., None]


IDENTITY, CUBE_ROOT, LOG, LOG_RELATIVE = Identity(), CubeRoot(), Log(), LogRelative()
"""The mappings of `MAPPINGS`, with their default parameters."""
