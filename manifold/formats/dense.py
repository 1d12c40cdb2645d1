"""Dense tables: values of a BRDF at all combinations of its angles, as in MERL and UTIA files."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from manifold.core.defaults import GONIOMETER
from manifold.core.directions import from_rusinkiewicz, from_spherical
from manifold.core.records import Array, Bands, Indices, Mask
from manifold.formats.readings import Readings


@dataclass(frozen=True, eq=False)
class DenseTable:
    """A BRDF tabulated at all combinations of its angles.

    Attributes:
        instrument: name of the instrument, or the format.
        coordinates: `half-difference` (theta_h, theta_d, phi_d; isotropic; Rusinkiewicz 1998) or `incident-outgoing`
            (theta_i, phi_i, theta_o, phi_o).
        axes: the nodes of each angle in radians, increasing.
        wavelengths_nm: band centres in nm, increasing, shape (B,); None for linear sRGB.
        values: f in 1/sr, one axis per angle and the bands last; NaN marks unmeasured values.
        notes: ambiguities of the file, and how they were read.
    """

    name: str
    instrument: str
    coordinates: Literal["half-difference", "incident-outgoing"]
    axes: tuple[Array, ...]
    wavelengths_nm: Array | None
    values: Array
    notes: tuple[str, ...] = ()

    @cached_property
    def bands(self) -> Bands:
        """The spectral bands."""
        return Bands.from_array(self.wavelengths_nm)

    @property
    def is_isotropic(self) -> bool:
        """Return whether the table has no azimuth of incidence."""
        return self.coordinates == "half-difference" or self.axes[1].size == 1

    @property
    def measured(self) -> Mask:
        """Return a mask of the nodes measured in all bands, bool, the shape of `values` without its last axis."""
        return np.asarray(np.isfinite(self.values).all(axis=-1))

    def directions(self, index: Indices | None = None) -> tuple[Array, Array]:
        """Return wi and wo, (n, 3) each, of the nodes with flat indices (n,), by default of all nodes."""
        shape = self.values.shape[:-1]
        index = np.arange(math.prod(shape), dtype=np.intp) if index is None else index
        angles = [nodes[k] for nodes, k in zip(self.axes, np.unravel_index(index, shape), strict=True)]
        if self.coordinates == "half-difference":
            return from_rusinkiewicz(*angles)
        return from_spherical(angles[0], angles[1]), from_spherical(angles[2], angles[3])

    def readings(self, limit: int | None = None) -> Readings:
        """Return the measured nodes above the horizon as readings; at most `limit` of them, drawn at random."""
        index = np.flatnonzero(np.isfinite(self.values).any(axis=-1).reshape(-1))
        if limit is not None and index.size > 2 * limit:  # about half a MERL table lies below the horizon
            index = np.sort(np.random.default_rng(0).choice(index, min(index.size, 8 * limit), replace=False))
        wi, wo = self.directions(index)
        above = np.flatnonzero((wi[:, 2] > 1e-9) & (wo[:, 2] > 1e-9))
        if limit is not None and above.size > limit:
            above = above[np.linspace(0, above.size - 1, limit).astype(int)]
        rows = self.values.reshape(-1, self.values.shape[-1])[index[above]]
        notes = self.notes
        if limit is not None and above.size == limit:
            notes += (
                f"a dense table, of whose {int(np.isfinite(self.values).any(axis=-1).sum())} nodes {limit} are taken: "
                "`manifold convert` keeps them all",
            )
        return Readings(
            self.name,
            self.instrument,
            wi[above],
            wo[above],
            self.wavelengths_nm,
            rows,
            notes=notes,
            repeatability=GONIOMETER,
        )
