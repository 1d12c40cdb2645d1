"""Stores measured materials as flat tables from which vectorised evaluations gather packets.

All data of a look-up are adjacent: the four corners of a grid cell and, for warps, their cumulative sums. Every value
is stored four times, but a few wide reads replace many scattered reads, which would dominate the cost.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from manifold.brdf.warp import cumulative_sums
from manifold.core.errors import UsageError
from manifold.core.records import AnyArray, Array, BsdfFile

WARP_VALUES = 8
"""Number of values per cell of a warp: densities at four corners, sums before the cell in both rows, sums of both rows.

A packet of 64 bytes holds these values for one polar angle, then for the next."""

MOST_BANDS_AT_ONCE = 8
"""Largest number of bands that are read together; of more bands, only those of the needed wavelengths are read."""

SPECTRUM_PACKET = 8
"""Number of values per cell and band of spectra: four corners at one polar angle, then at the next."""

META = 32
"""Number of integers per material, a power of two so that they are read at once; see `PackedTables.meta`."""

ISOTROPIC = 0
"""Value of the symmetry for isotropic materials, whose half vectors are relative to the incident azimuth."""


@dataclass(frozen=True, eq=False)
class PackedTables:
    """N materials, one after the other in flat arrays.

    Attributes:
        meta: start and size of the parts of each material, uint32, shape (N * META,): vndf cell, its marginal, rows
            and columns; luminance cell, its marginal, rows and columns; ndf cell, rows and columns; sigma cell, rows
            and columns; spectra cell; numbers of polar angles and azimuths of incidence; `ISOTROPIC`, or how often
            azimuths repeat in a turn; and the bits, as float32, of the azimuth by which the specimen was turned.
        theta_nodes: angles of incidence in radians, padded by repeating the last, float32, shape (N * T,).
        n_theta: T, the largest number of angles of incidence of a material.
        phi_nodes: incident azimuths in radians, padded in the same way, float32, shape (N * P,).
        n_phi: P, the largest number of incident azimuths of a material.
        warps: cells of vndf and luminance per azimuth and two neighbouring polar angles, float32, shape (cells * 16,).
        marginals: cumulative sums of the rows of these warps, float32.
        grids: cells of ndf and sigma, four corners each, float32, shape (cells * 4,).
        spectra: for each azimuth, pair of neighbouring polar angles, cell and band, the four corners at both
            polar angles, shape (pairs * cells * bands * 8,). They are float32 for few bands and float16 for many, for
            which memory traffic dominates; float16 values are scaled by a power of two, and `ndf` by its inverse.
        n_bands: number of bands per cell in `spectra`, padded with zeros.
        most_nodes: largest number of nodes along an axis of a warp.
    """

    meta: NDArray[np.uint32]
    theta_nodes: NDArray[np.float32]
    n_theta: int
    phi_nodes: NDArray[np.float32]
    n_phi: int
    warps: NDArray[np.float32]
    marginals: NDArray[np.float32]
    grids: NDArray[np.float32]
    spectra: AnyArray
    n_bands: int
    most_nodes: int

    @property
    def bytes(self) -> int:
        """Size of the tables in bytes."""
        arrays = (
            self.meta, self.theta_nodes, self.phi_nodes, self.warps, self.marginals, self.grids, self.spectra,
        )  # fmt: skip
        return sum(array.nbytes for array in arrays)


def pack(files: Sequence[BsdfFile], bands: Sequence[int] | None = None) -> PackedTables:
    """Pack N materials with the same bands; `bands` selects some of the bands by index."""
    kept = list(range(files[0].bands.count)) if bands is None else list(bands)
    n_bands = len(kept) if len(kept) > MOST_BANDS_AT_ONCE else int(2 ** np.ceil(np.log2(len(kept))))
    n_theta, n_phi = (
        max(len(getattr(file, axis)) for file in files) for axis in ("theta_i_rad", "phi_i_rad")
    )
    is_half = len(kept) > MOST_BANDS_AT_ONCE
    warps, marginals, grids = _Store(2 * WARP_VALUES), _Store(1), _Store(4)
    spectra = _Store(SPECTRUM_PACKET * n_bands, np.float16 if is_half else np.float32)
    meta = np.zeros((len(files), META), dtype=np.uint32)
    theta_nodes, phi_nodes = [], []
    most_nodes = 2
    for k, file in enumerate(files):
        row = []
        density = np.maximum(file.luminance, 0.0)
        density[density.sum(axis=(2, 3)) <= 0] = 1.0
        for values in (file.vndf, density):
            data, conditional, marginal = cumulative_sums(values)
            row += [
                warps.add(_warp_cells(data, conditional, values.shape[:2])),
                marginals.add(marginal),
                *values.shape[2:],
            ]
            most_nodes = max(most_nodes, *values.shape[2:])
        # The factor ndf / (4 sigma) is 1 where a file holds final values.
        one = np.ones((2, 2))
        ndf, sigma = (file.ndf, 4.0 * file.sigma) if file.jacobian else (one, one)
        unit = _unit(file.spectra) if is_half else 1.0
        for grid in (unit * ndf, sigma):
            row += [grids.add(_corners(grid)), *grid.shape]
        cells = _corners(file.spectra[:, :, kept]) / np.float32(unit)  # [P, T, B, H - 1, W - 1, 4]
        cells = np.moveaxis(cells, 2, 4)
        pairs = _neighbours(cells)  # [P, T - 1, H - 1, W - 1, B, 2, 4]
        row += [spectra.add(np.pad(pairs, ((0, 0),) * 4 + ((0, n_bands - len(kept)),) + ((0, 0),) * 2))]
        row += [
            len(file.theta_i_rad),
            len(file.phi_i_rad),
            ISOTROPIC if file.is_isotropic else file.azimuth_repeats,
            int(np.float32(file.rotation_rad).view(np.uint32)),
        ]
        if file.spectra.shape[3:] != file.luminance.shape[2:]:
            raise UsageError(f"material {file.name}: luminance and spectra have grids of different sizes")
        meta[k, : len(row)] = row
        theta_nodes.append(np.pad(file.theta_i_rad, (0, n_theta - len(file.theta_i_rad)), mode="edge"))
        phi_nodes.append(np.pad(file.phi_i_rad, (0, n_phi - len(file.phi_i_rad)), mode="edge"))
    return PackedTables(
        meta=meta.ravel(),
        theta_nodes=np.concatenate(theta_nodes),
        n_theta=n_theta,
        phi_nodes=np.concatenate(phi_nodes),
        n_phi=n_phi,
        warps=warps.joined(),
        marginals=marginals.joined(),
        grids=grids.joined(),
        spectra=spectra.joined(),
        n_bands=n_bands,
        most_nodes=most_nodes,
    )


class _Store:
    """Blocks of packets, one after the other."""

    def __init__(self, packet: int, dtype: type = np.float32) -> None:
        self._packet, self._dtype, self._length = packet, dtype, 0
        self._blocks: list[AnyArray] = []

    def add(self, block: Array) -> int:
        """Append a block, and return the index of its first packet."""
        start = self._length
        self._blocks.append(np.ascontiguousarray(block, dtype=self._dtype).ravel())
        self._length += self._blocks[-1].size // self._packet
        return start

    def joined(self) -> AnyArray:
        """Return all blocks, shape (packets * size,)."""
        joined = np.concatenate(self._blocks)
        self._blocks.clear()
        if joined.size > np.iinfo(np.uint32).max:
            raise UsageError(
                "too many materials for 32-bit indices; raise the tolerance to leave out small weights"
            )
        return joined


def _unit(values: Array) -> float:
    """Return the power of two in which the largest value lies between 2^14 and 2^15, near the end of float16."""
    largest = float(np.abs(values).max())
    return 2.0 ** (np.floor(np.log2(largest)) - 14) if largest > 0 else 1.0


def _corners(grid: Array) -> Array:
    """Return the corners of all cells of node values (..., R, C), shape (..., R - 1, C - 1, 4): row by row."""
    return np.stack([grid[..., :-1, :-1], grid[..., :-1, 1:], grid[..., 1:, :-1], grid[..., 1:, 1:]], axis=-1)


def _neighbours(slices: Array) -> Array:
    """Return each of T polar angles (P, T, ..., K) with the next, shape (P, T - 1, ..., 2, K).

    A single polar angle is returned with itself.
    """
    upper = slices[:, 1:] if slices.shape[1] > 1 else slices
    return np.stack([slices[:, : upper.shape[1]], upper], axis=-2)


def _warp_cells(data: Array, conditional: Array, of_incidence: tuple[int, ...]) -> Array:
    """Return all cells of a warp of P x T incidences, shape (P, T - 1, R - 1, C - 1, 2, 8)."""
    before = np.stack([conditional[:, :-1, :-1], conditional[:, 1:, :-1]], axis=-1)
    totals = conditional[:, :, -1]
    rows = np.stack([totals[:, :-1], totals[:, 1:]], axis=-1)[:, :, None, :]
    cells = np.concatenate([_corners(data), before, np.broadcast_to(rows, before.shape)], axis=-1)
    return _neighbours(cells.reshape(*of_incidence, *cells.shape[1:]))
