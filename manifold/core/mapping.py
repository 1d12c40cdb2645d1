"""Mappings T of BRDF values under which materials are combined: `T^-1(sum_i v_i T(f_i))`.

BRDF values span six decades, and highlights dominate sums over raw values; a mapping compresses the range. All
mappings follow the same rules:

- values keep their shape, a floating dtype is kept, and NaN (a masked cell) stays NaN both ways;
- an exact zero maps to a finite number and back to exactly zero;
- negative values (measurement noise) keep their sign under `identity` and `cube-root`, and are treated as zero
  under the logarithms, whose inverse is never negative;
- mappings call only functions of `xp` (NumPy or Dr.Jit), so that the Mitsuba plugin can also evaluate them.

`inverse(forward(f))` equals f only up to rounding. If a prediction must equal a measured value bit for bit, use that
value instead of mapping it back and forth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from manifold.core.records import Array


class ValueMapping(Protocol):
    """The interface of a mapping T and its inverse.

    Values are in 1/sr. `cosine_weight` is `cos(theta_i) cos(theta_o)`, which some mappings use; it broadcasts against
    the values, (..., 1) for values (..., B), and None means 1. `xp` is the array library that provides `exp`, `log`,
    `cbrt`, `sqrt` and `maximum`.
    """

    @property
    def name(self) -> str:
        """The mapping's name in `MAPPINGS`."""

    def forward(self, values: Any, cosine_weight: Any = None, xp: Any = np) -> Any:
        """Apply T to BRDF values, element by element."""

    def inverse(self, mapped: Any, cosine_weight: Any = None, xp: Any = np) -> Any:
        """Apply T^-1 to mapped values, with the same weight as in `forward`."""

    def slope(self, values: Array, cosine_weight: Array | None = None) -> Array:
        """Return the derivative of T^-1 at T(values), in NumPy."""


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
        epsilon: positive value in 1/sr; differences between values far below it have little weight.
    """

    epsilon: float = 1e-3
    name = "log"

    def forward(self, values: Any, cosine_weight: Any = None, xp: Any = np) -> Any:
        """Return the logarithm; negative values are treated as 0."""
        return _log1p(xp.maximum(values, 0.0) / self.epsilon, xp)

    def inverse(self, mapped: Any, cosine_weight: Any = None, xp: Any = np) -> Any:
        """Return `epsilon (e^t - 1)`; negative mapped values become 0."""
        return _expm1(xp.maximum(mapped, 0.0), xp) * self.epsilon

    def slope(self, values: Array, cosine_weight: Array | None = None) -> Array:
        """Return `f + epsilon`, also at 0, where the inverse is constant, so that a search can leave 0."""
        return values + self.epsilon


@dataclass(frozen=True)
class LogRelative:
    """`T(f) = ln((f w + epsilon) / epsilon)` with `w = max(cos(theta_i) cos(theta_o), floor)`.

    The cosines reduce the weight of grazing angles, where values are large but matter little. The publication also
    divides by the median material, which only shifts T and cancels in every combination whose weights sum to 1 and in
    every centred Gram matrix.

    Attributes:
        epsilon: positive value in 1/sr.
        floor: smallest cosine weight, positive.
    Source: Nielsen, Jensen & Ramamoorthi 2015, eq. 2.
    """

    epsilon: float = 1e-3
    floor: float = 1e-3
    name = "log-relative"

    def forward(self, values: Any, cosine_weight: Any = None, xp: Any = np) -> Any:
        """Return the logarithm of the weighted value; negative values are treated as 0."""
        return _log1p(xp.maximum(values, 0.0) * (self._weight(cosine_weight, xp) / self.epsilon), xp)

    def inverse(self, mapped: Any, cosine_weight: Any = None, xp: Any = np) -> Any:
        """Return the original values, at least 0."""
        return _expm1(xp.maximum(mapped, 0.0), xp) * self.epsilon / self._weight(cosine_weight, xp)

    def slope(self, values: Array, cosine_weight: Array | None = None) -> Array:
        """Return `f + epsilon / w`, also at 0, where the inverse is constant, so that a search can leave 0."""
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
