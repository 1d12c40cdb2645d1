"""Finds and fills the cells of a file that were not measured although they are above the horizon.

A file marks such cells by zeros in all bands or in the field `valid`. Below the horizon zero is the right value.
Above it, a prediction would show the empty cells of all its materials as dark spots, so they are filled before
materials are combined. The files themselves are not changed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from manifold.brdf.warp import Warp
from manifold.core.directions import HORIZON, from_spherical, u_to_phi, u_to_theta
from manifold.core.records import Array, BsdfFile, Mask


@dataclass(frozen=True, eq=False)
class Cells:
    """The cells (R, C) of an outgoing grid at one incident direction.

    Attributes:
        points: coordinates of the half vectors in the unit square, shape (R, C, 2).
        wi: the incident direction, shape (3,).
        wo: outgoing directions, shape (R, C, 3).
        is_above: whether the outgoing directions are above the horizon, bool, shape (R, C).
        density: the warp's density at the points, per unit of square area, shape (R, C).
    """

    points: Array
    wi: Array
    wo: Array
    is_above: Mask
    density: Array

    @classmethod
    def seen_from(
        cls, warp: Warp, phi_i: float, theta_i: float, shape: tuple[int, ...], *, is_isotropic: bool
    ) -> Cells:
        """Return the cells of a grid (R, C) under the warp of the visible normals, at an incident direction in radians.

        On the horizon the limit of the warp is used. In an isotropic file, the azimuths of half vectors are relative
        to the azimuth of the incident direction.
        """
        rows, columns = (np.linspace(0.0, 1.0, n) for n in shape)
        points, density = warp.sample(np.stack(np.meshgrid(columns, rows), axis=-1), phi_i, theta_i)
        turn = phi_i if is_isotropic else 0.0
        m = from_spherical(u_to_theta(points[..., 0]), u_to_phi(points[..., 1]) + turn)
        wi = from_spherical(min(theta_i, HORIZON), phi_i)
        cos_im = m @ wi
        wo = 2.0 * cos_im[..., None] * m - wi
        return cls(points, wi, wo, (cos_im > 0.0) & (wo[..., 2] > 0.0), density)


def cells_of(
    file: BsdfFile, slices: Iterable[Sequence[int]] | None = None
) -> Iterator[tuple[int, int, Cells]]:
    """Yield `(p, t, cells)` for the slices of a file.

    `p` and `t` are indices of the incident azimuth and polar angle, and `cells` are those of the outgoing grid.
    `slices` selects pairs (p, t); None yields all.
    """
    warp = Warp(file.vndf, file.phi_i_rad, file.theta_i_rad)
    shape = file.spectra.shape
    for p, t in np.ndindex(shape[:2]) if slices is None else slices:
        phi_i, theta_i = float(file.phi_i_rad[p]), float(file.theta_i_rad[t])
        yield p, t, Cells.seen_from(warp, phi_i, theta_i, shape[3:], is_isotropic=file.is_isotropic)


# Least cosine of outgoing directions: cells nearer to the horizon may well be dark.
LEAST_COSINE = float(np.sin(np.deg2rad(2.0)))
"""Least cosine with the normal at which files hold measured values."""

STEEPEST = float(np.deg2rad(85.0))
"""Angle of incidence in radians beyond which files extrapolate."""

# Weights of measured neighbours in the mean that fills a cell: those beside it count twice as much as diagonal ones.
_NEIGHBOURS = np.array([[1.0, 2.0, 1.0], [2.0, 0.0, 2.0], [1.0, 2.0, 1.0]])


def unmeasured_cells(file: BsdfFile) -> Mask:
    """Return a mask of the cells above the horizon that are zero in all bands or not measured, shape (P, T, H, W)."""
    unmeasured: Mask = np.all(file.spectra == 0, axis=2) | np.logical_not(file.measured_mask)
    suspects = np.any(unmeasured, axis=(2, 3)) & (file.theta_i_rad < STEEPEST)[None, :]
    if not np.any(suspects):
        return np.zeros_like(unmeasured)
    for p, t, cells in cells_of(file, np.argwhere(suspects)):
        unmeasured[p, t] &= cells.is_above & (cells.wo[..., 2] > LEAST_COSINE)
    unmeasured[~suspects] = False
    return unmeasured


def find_rim(file: BsdfFile) -> Mask:
    """Return a mask of the cells that are too close above the horizon to be measured, bool, shape (P, T, H, W)."""
    rim = np.zeros_like(file.measured_mask)
    for p, t, cells in cells_of(file):
        rim[p, t] = cells.is_above & (cells.wo[..., 2] <= LEAST_COSINE)
    return rim


def unmeasured_share(file: BsdfFile, cells: Mask) -> float:
    """Return the share of unmeasured cells (P, T, H, W) among the cells above the horizon."""
    expected = np.any(file.spectra != 0, axis=2) | cells
    return float(np.sum(cells) / max(int(np.sum(expected)), 1))


def blank_unmeasured(file: BsdfFile) -> BsdfFile:
    """Return the file with NaN in its unmeasured cells; every value interpolated from such a cell becomes NaN."""
    cells = unmeasured_cells(file)
    return replace(file, spectra=np.where(cells[:, :, None], np.float32(np.nan), file.spectra))


def fill_unmeasured(file: BsdfFile, cells: Mask | None = None, *, copy: bool = True) -> BsdfFile:
    """Return the file with its unmeasured cells filled from their rims inwards.

    If `cells` is None, the cells are found first. A file without such cells is returned unchanged. Without `copy`,
    the file's own spectra, which must be writeable, are filled.

    In every pass, an empty cell beside filled cells gets the mean of its filled neighbours; direct neighbours count
    double, diagonal ones once. A slice without any measured cell stays unchanged.
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
        weight = scipy.ndimage.convolve(known.astype(float), _NEIGHBOURS, mode="constant")
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
