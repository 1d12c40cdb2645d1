"""Mappings T of BRDF values under which materials are combined: `T^-1(sum_i v_i T(f_i))`.

BRDF values span six decades, and a sum over raw values sees only the highlights; a mapping compresses them.
All mappings follow the same rules:

- values keep their shape, a floating dtype is kept, and NaN (a masked cell) stays NaN both ways;
- an exact zero maps to a finite number and back to exactly zero;
- negative values (measurement noise) keep their sign under `identity` and `cube-root`, and count as zero
  under the logarithms, whose inverse is never negative;
- they compute with the functions of `xp`, NumPy or Dr.Jit, so that the Mitsuba plugin evaluates them too.

`inverse(forward(f))` is f only to rounding. Where a prediction has to be a measured value bit for bit, take
that value instead of mapping it back and forth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from manifold.core.records import Array


class ValueMapping(Protocol):
    """The interface of a mapping T and its inverse.

    Values are in 1/sr. Weights are `cos(theta_i) cos(theta_o)`, for the mappings that weight by them, and broadcast
    against the values: (..., 1) for values (..., B). None is a weight of 1. `xp` is the array library, with `exp`,
    `log`, `cbrt`, `sqrt` and `maximum`.
    """

    @property
    def name(self) -> str:
        """The name under which `MAPPINGS` has it."""

    def forward(self, values: Any, cosine_weight: Any = None, xp: Any = np) -> Any:
        """Apply T to BRDF values, element by element."""

    def inverse(self, mapped: Any, cosine_weight: Any = None, xp: Any = np) -> Any:
        """Apply T^-1 to mapped values, with the weight that `forward` had."""

    def slope(self, values: Array, cosine_weight: Array | None = None) -> Array:
        """Return the derivative of T^-1 at the mapped values that give these values, in NumPy."""


@dataclass(frozen=True)
class Identity:
    """`T(f) = f`: the mapping of Hikichi & Iwasaki. Highlights dominate every distance."""

    name = "identity"

    def forward(self, values: Any, cosine_weight: Any = None, xp: Any = np) -> Any:
        """Return the values unchanged."""
        return values

    def inverse(self, mapped: Any, cosine_weight: Any = None, xp: Any = np) -> Any:
        """Return the values unchanged."""
        return mapped

    def slope(self, values: Array, cosine_weight: Array | None = None) -> Array:
        """Return the derivative of the mapping, 1."""
        return np.ones_like(values)


@dataclass(frozen=True)
class CubeRoot:
    """`T(f) = f^(1/3)`, signed: close to perceived lightness, and exact at zero.

    >>> CubeRoot().forward(np.array([0.008, 1.0]))
    array([0.2, 1. ])
    """

    name = "cube-root"

    def forward(self, values: Any, cosine_weight: Any = None, xp: Any = np) -> Any:
        """Return the signed cube root."""
        return xp.cbrt(values)

    def inverse(self, mapped: Any, cosine_weight: Any = None, xp: Any = np) -> Any:
        """Return the cube."""
        return mapped * mapped * mapped

    def slope(self, values: Array, cosine_weight: Array | None = None) -> Array:
        """Return `3 f^(2/3)`."""
        root = np.cbrt(values)
        return 3.0 * root * root


@dataclass(frozen=True)
class Log:
    """`T(f) = ln((f + epsilon) / epsilon)`, which is 0 at 0.

    Attributes:
        epsilon: in 1/sr, positive; differences between values far below it do not count.
    """

    epsilon: float = 1e-3
    name = "log"

    def forward(self, values: Any, cosine_weight: Any = None, xp: Any = np) -> Any:
        """Return the logarithm; negative values count as 0."""
        return _log1p(xp.maximum(values, 0.0) / self.epsilon, xp)

    def inverse(self, mapped: Any, cosine_weight: Any = None, xp: Any = np) -> Any:
        """Return the exponential, at least 0."""
        return _expm1(xp.maximum(mapped, 0.0), xp) * self.epsilon

    def slope(self, values: Array, cosine_weight: Array | None = None) -> Array:
        """Return `f + epsilon`, also at 0, where the inverse stops, so that a search can leave 0."""
        return values + self.epsilon


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

    def forward(self, values: Any, cosine_weight: Any = None, xp: Any = np) -> Any:
        """Return the logarithm of the weighted value; negative values count as 0."""
        return _log1p(xp.maximum(values, 0.0) * (self._weight(cosine_weight, xp) / self.epsilon), xp)

    def inverse(self, mapped: Any, cosine_weight: Any = None, xp: Any = np) -> Any:
        """Return the original values, at least 0."""
        return _expm1(xp.maximum(mapped, 0.0), xp) * self.epsilon / self._weight(cosine_weight, xp)

    def slope(self, values: Array, cosine_weight: Array | None = None) -> Array:
        """Return `f + epsilon / w`, also at 0, where the inverse stops, so that a search can leave 0."""
        return values + self.epsilon / self._weight(cosine_weight, np)

    def _weight(self, cosine_weight: Any, xp: Any) -> Any:
        return 1.0 if cosine_weight is None else xp.maximum(cosine_weight, self.floor)


def _log1p(x: Any, xp: Any) -> Any:
    """Return log(1 + x); Dr.Jit has no function for it."""
    return np.log1p(x) if xp is np else xp.log(1.0 + x)


def _expm1(x: Any, xp: Any) -> Any:
    """Return exp(x) - 1, likewise."""
    return np.expm1(x) if xp is np else xp.exp(x) - 1.0


IDENTITY, CUBE_ROOT, LOG, LOG_RELATIVE = Identity(), CubeRoot(), Log(), LogRelative()
"""The mappings of `MAPPINGS`, with their default parameters."""
