"""Patches of several GGX microsurfaces side by side: lobes with a sharp core and long tails."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from manifold.analytic.base import choose_lobe
from manifold.analytic.ggx import GGX, AlbedoTable
from manifold.errors import UsageError
from manifold.records import Array


@dataclass(frozen=True, eq=False)
class GGXMixture:
    """Isotropic GGX microsurfaces, each on its share of the area; it stands in for a `GGX`.

    Attributes:
        parts: pairs (share of the area, roughness alpha), shares with sum 1.
    Raises:
        UsageError: there are no parts, or their shares do not sum to 1.
    """

    parts: Sequence[tuple[float, float]]

    def __post_init__(self) -> None:
        shares = [share for share, _ in self.parts]
        if not all(share >= 0.0 for share in shares) or abs(sum(shares) - 1.0) > 1e-6:
            raise UsageError(f"shares are {shares}, expected numbers >= 0 with the sum 1")

    @property
    def is_isotropic(self) -> bool:
        return True

    @cached_property
    def _surfaces(self) -> tuple[tuple[float, GGX], ...]:
        return tuple((share, GGX.isotropic(alpha)) for share, alpha in self.parts)

    def reflection_factor(self, wi: Array, wo: Array) -> Array:
        """D G2 / (4 cos_i cos_o) in 1/sr, shape (...), as `GGX.reflection_factor`."""
        return sum(share * ggx.reflection_factor(wi, wo) for share, ggx in self._surfaces)  # type: ignore[return-value]

    def sample_visible_normal(self, wi: Array, u: Array) -> Array:
        """Normals (n, 3), as `GGX.sample_visible_normal`."""
        part, u = choose_lobe(np.array([share for share, _ in self.parts]), u)
        normals = np.empty_like(wi)
        for k, (_, ggx) in enumerate(self._surfaces):
            normals[part == k] = ggx.sample_visible_normal(wi[part == k], u[part == k])
        return normals

    def pdf_reflection(self, wi: Array, wo: Array) -> Array:
        """Density in 1/sr of mirrored visible normals, shape (...)."""
        return sum(share * ggx.pdf_reflection(wi, wo) for share, ggx in self._surfaces)  # type: ignore[return-value]

    def albedo_table(self, reflectance: Array) -> MixedAlbedo:
        """Directional albedo of single scattering, as `GGX.albedo_table`."""
        return MixedAlbedo([(share, ggx.albedo_table(reflectance)) for share, ggx in self._surfaces])


@dataclass(frozen=True, eq=False)
class MixedAlbedo:
    """The mean of tables of directional albedo, which it stands in for.

    Attributes:
        parts: pairs (share, table).
    """

    parts: Sequence[tuple[float, AlbedoTable]]

    def __call__(self, w: Array) -> Array:
        """Albedo of directions (n, 3) above the horizon, shape (n, B)."""
        return sum(share * table(w) for share, table in self.parts)  # type: ignore[return-value]

    @cached_property
    def hemispherical(self) -> Array:
        """Albedo under uniform illumination, shape (B,)."""
        return sum(share * table.hemispherical for share, table in self.parts)  # type: ignore[return-value]
