"""Holes of measured files: cells above the horizon that hold nothing, closed before materials are combined.

A file marks what it could not measure by zeros in all bands, or in `valid`. Below the horizon that is right; above it,
a prediction would show the holes of all its materials as dark spots, magnified where weights are large. What a file
*is* stays as it is: a prediction at a training latent is the file, holes included.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.ndimage import convolve

from manifold.brdf.cells import Cells
from manifold.brdf.warp import Warp
from manifold.records import Array, BsdfFile

_LEAST_COSINE = np.sin(
    np.deg2rad(2.0)
)  # of outgoing directions: cells nearer to the horizon may well be dark
_STEEPEST = np.deg2rad(85.0)  # incident elevations beyond it are extrapolated, not measured
_NEIGHBOURS = np.array([[1.0, 2.0, 1.0], [2.0, 0.0, 2.0], [1.0, 2.0, 1.0]])


def find_holes(file: BsdfFile) -> Array:
    """Cells above the horizon that are zero in all bands or marked as not measured, bool, shape (P, T, H, W)."""
    holes = np.all(file.spectra == 0, axis=2) | ~file.measured_mask
    suspects = np.any(holes, axis=(2, 3)) & (file.theta_i_rad < _STEEPEST)[None, :]
    if not np.any(suspects):
        return np.zeros_like(holes)
    for p, t, cosines in _outgoing_cosines(file, np.argwhere(suspects)):
        holes[p, t] &= cosines > _LEAST_COSINE
    holes[~suspects] = False
    return holes


def find_rim(file: BsdfFile) -> Array:
    """Cells whose outgoing direction is above the horizon but too near to be measured, bool, shape (P, T, H, W)."""
    rim = np.zeros_like(file.measured_mask)
    for p, t, cosines in _outgoing_cosines(file, np.argwhere(np.ones(rim.shape[:2]))):
        rim[p, t] = (cosines > 0) & (cosines <= _LEAST_COSINE)
    return rim


def _outgoing_cosines(file: BsdfFile, slices: Array) -> Iterator[tuple[int, int, Array]]:
    """Of slices (n, 2) of azimuth and elevation: their indices, and cos(theta_o) of their cells (H, W); -1 below."""
    warp = Warp.from_values(file.vndf, file.phi_i_rad, file.theta_i_rad)
    for p, t in slices:
        cells = Cells.seen_from(
            warp, float(file.phi_i_rad[p]), float(file.theta_i_rad[t]), file.spectra.shape[3:],
            is_isotropic=file.is_isotropic,
        )  # fmt: skip
        yield int(p), int(t), np.where(cells.is_above, cells.wo[..., 2], -1.0)


def share_of_holes(file: BsdfFile, holes: Array) -> float:
    """Holes (P, T, H, W) as a share of the cells that should hold something."""
    expected = np.any(file.spectra != 0, axis=2) | holes
    return float(np.sum(holes) / max(int(np.sum(expected)), 1))


def close_holes(file: BsdfFile, holes: Array | None = None) -> BsdfFile:
    """The same file with its holes filled from their rims inwards; the file itself where it has none.

    Every pass gives the cells that touch known ones the mean of those, nearer ones counting double. A slice
    without any known cell stays as it is.

    Args:
        file: with holes.
        holes: what `find_holes` found, if that was asked already.
    """
    holes = find_holes(file) if holes is None else holes
    if not np.any(holes):
        return file
    spectra = file.spectra.copy()
    for p, t in np.argwhere(np.any(holes, axis=(2, 3))):
        _fill(spectra[p, t], holes[p, t], np.any(spectra[p, t] != 0, axis=0) & ~holes[p, t])
    return replace(file, spectra=spectra)


def _fill(values: Array, holes: Array, known: Array) -> None:
    """Fill the holes (H, W) of values (B, H, W) in place, from the cells that are known (H, W)."""
    holes = holes.copy()
    while np.any(holes):
        weight = convolve(known.astype(float), _NEIGHBOURS, mode="constant")
        rim = holes & (weight > 0)
        if not np.any(rim):
            return
        for row, column in np.argwhere(rim):
            i, j = slice(max(row - 1, 0), row + 2), slice(max(column - 1, 0), column + 2)
            near = _NEIGHBOURS[_cut(row, values.shape[1]), _cut(column, values.shape[2])] * known[i, j]
            values[:, row, column] = np.tensordot(values[:, i, j], near, axes=2) / near.sum()
        known = known | rim
        holes &= ~rim


def _cut(index: int, size: int) -> slice:
    """The part of a 3-cell neighbourhood that lies on an axis of that size."""
    return slice(1 if index == 0 else 0, 2 if index == size - 1 else 3)
