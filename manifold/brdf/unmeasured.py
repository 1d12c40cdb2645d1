"""Unmeasured cells of files: empty cells above the horizon, filled before materials are combined.

A file marks cells that were not measured by zeros in all bands, or in `valid`. Below the horizon zero is the right
value; above it, a prediction would show the empty cells of all its materials as dark spots, magnified where weights are
large. Files are not changed: a prediction at a training latent is the file, unmeasured cells included.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import convolve

from manifold.brdf.cells import cells_of
from manifold.records import Array, BsdfFile, Mask

# Of outgoing directions: cells nearer to the horizon may well be dark.
_LEAST_COSINE = np.sin(np.deg2rad(2.0))
_STEEPEST = np.deg2rad(85.0)  # incident elevations beyond it are extrapolated, not measured
_NEIGHBOURS = np.array([[1.0, 2.0, 1.0], [2.0, 0.0, 2.0], [1.0, 2.0, 1.0]])


def unmeasured_cells(file: BsdfFile) -> Mask:
    """Cells above the horizon that are zero in all bands or marked as not measured, bool, shape (P, T, H, W)."""
    unmeasured: Mask = np.all(file.spectra == 0, axis=2) | np.logical_not(file.measured_mask)
    suspects = np.any(unmeasured, axis=(2, 3)) & (file.theta_i_rad < _STEEPEST)[None, :]
    if not np.any(suspects):
        return np.zeros_like(unmeasured)
    for p, t, cells in cells_of(file, np.argwhere(suspects)):
        unmeasured[p, t] &= cells.is_above & (cells.wo[..., 2] > _LEAST_COSINE)
    unmeasured[~suspects] = False
    return unmeasured


def find_rim(file: BsdfFile) -> Mask:
    """Cells with directions above the horizon, too close to it to be measured, bool, shape (P, T, H, W)."""
    rim = np.zeros_like(file.measured_mask)
    for p, t, cells in cells_of(file):
        rim[p, t] = cells.is_above & (cells.wo[..., 2] <= _LEAST_COSINE)
    return rim


def unmeasured_share(file: BsdfFile, cells: Mask) -> float:
    """Unmeasured cells (P, T, H, W) as a share of the cells that should hold something."""
    expected = np.any(file.spectra != 0, axis=2) | cells
    return float(np.sum(cells) / max(int(np.sum(expected)), 1))


def blank_unmeasured(file: BsdfFile) -> BsdfFile:
    """The same file with NaN in its unmeasured cells, and so wherever a value would be interpolated from one."""
    cells = unmeasured_cells(file)
    return replace(file, spectra=np.where(cells[:, :, None], np.float32(np.nan), file.spectra))


def fill_unmeasured(file: BsdfFile, cells: Mask | None = None, *, copy: bool = True) -> BsdfFile:
    """The same file with its unmeasured cells filled from their rims inwards; the file itself where it has none.

    Every pass gives the cells that touch known ones the mean of those, nearer ones counting double. A slice
    without any known cell stays as it is.

    Args:
        file: any file.
        cells: its `unmeasured_cells`, if they are known already.
        copy: leave the file as it is; otherwise its spectra, which must be writeable, are filled.
    """
    cells = unmeasured_cells(file) if cells is None else cells
    if not np.any(cells):
        return file
    # bands stay next to each other, as evaluation wants them
    spectra = file.spectra.copy(order="K") if copy else file.spectra
    for p, t in np.argwhere(np.any(cells, axis=(2, 3))):
        _fill(spectra[p, t], cells[p, t], np.any(spectra[p, t] != 0, axis=0) & ~cells[p, t])
    return replace(file, spectra=spectra)


def _fill(values: Array, unmeasured: Mask, known: Mask) -> None:
    """Fill the unmeasured cells (H, W) of values (B, H, W) in place, from the cells that are known (H, W)."""
    unmeasured = unmeasured.copy()
    while np.any(unmeasured):
        weight = convolve(known.astype(float), _NEIGHBOURS, mode="constant")
        rim = unmeasured & (weight > 0)
        if not np.any(rim):
            return
        rows, columns = np.nonzero(rim)
        sums, around = np.zeros((values.shape[0], len(rows))), np.pad(known, 1)
        for (i, j), near in np.ndenumerate(_NEIGHBOURS):
            row, column = (
                np.clip(k, 1, n) - 1 for k, n in zip((rows + i, columns + j), known.shape, strict=True)
            )
            sums += near * around[rows + i, columns + j] * values[:, row, column]
        values[:, rows, columns] = sums / weight[rim]
        known = known | rim
        unmeasured &= ~rim
