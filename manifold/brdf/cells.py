"""Outgoing directions of the cells of an RGL file, for one incident direction."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from manifold.brdf.warp import Warp
from manifold.directions import HORIZON, from_spherical, u_to_phi, u_to_theta
from manifold.records import Array, BsdfFile, Mask


@dataclass(frozen=True, eq=False)
class Cells:
    """The R x C cells of an outgoing grid.

    Attributes:
        points: unit-square coordinates of their half vectors, shape (R, C, 2).
        wi: the incident direction, shape (3,).
        wo: outgoing directions, shape (R, C, 3).
        is_above: whether these are above the horizon, bool, shape (R, C).
    """

    points: Array
    wi: Array
    wo: Array
    is_above: Mask

    @classmethod
    def seen_from(
        cls, warp: Warp, phi_i: float, theta_i: float, shape: tuple[int, ...], *, is_isotropic: bool
    ) -> Cells:
        """The cells of a grid (R, C) under the warp of the visible normals.

        Args:
            warp: of `vndf`.
            phi_i, theta_i: of the incident direction in radians; on the horizon its limit is taken.
            shape: R and C.
            is_isotropic: whether azimuths of half vectors count from that of the incident direction.
        """
        rows, columns = (np.linspace(0.0, 1.0, n) for n in shape)
        points, _ = warp.sample(np.stack(np.meshgrid(columns, rows), axis=-1), phi_i, theta_i)
        turn = phi_i if is_isotropic else 0.0
        m = from_spherical(u_to_theta(points[..., 0]), u_to_phi(points[..., 1]) + turn)
        wi = from_spherical(min(theta_i, HORIZON), phi_i)
        cos_im = m @ wi
        wo = 2.0 * cos_im[..., None] * m - wi
        return cls(points, wi, wo, (cos_im > 0.0) & (wo[..., 2] > 0.0))


def cells_of(
    file: BsdfFile, slices: Iterable[Sequence[int]] | None = None
) -> Iterator[tuple[int, int, Cells]]:
    """The cells of a file's slices with their indices p of azimuth and t of elevation; of all slices by default."""
    warp = Warp.from_values(file.vndf, file.phi_i_rad, file.theta_i_rad)
    shape = file.spectra.shape
    for p, t in np.ndindex(shape[:2]) if slices is None else slices:
        phi_i, theta_i = float(file.phi_i_rad[p]), float(file.theta_i_rad[t])
        yield p, t, Cells.seen_from(warp, phi_i, theta_i, shape[3:], is_isotropic=file.is_isotropic)
