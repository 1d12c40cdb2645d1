"""Converts a BRDF to a labelled array of xarray."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from manifold.brdf.interface import BRDF
from manifold.core.directions import from_spherical
from manifold.core.errors import ShapeError
from manifold.core.extras import require

if TYPE_CHECKING:
    from xarray import DataArray


def to_xarray(
    brdf: BRDF, theta_i_deg: ArrayLike, theta_o_deg: ArrayLike, phi_deg: ArrayLike = 180.0
) -> DataArray:
    """Return the values of a BRDF on a grid of angles as a labelled array.

    Args:
        brdf: any BRDF; an anisotropic BRDF is lit from azimuth 0.
        theta_i_deg, theta_o_deg: polar angles in degrees, 0 to 90, numbers or shape (I,) and (O,).
        phi_deg: azimuth of the outgoing direction from the incident one in degrees, a number or shape (P,); 180 is
            the side of the mirror direction.

    Returns:
        f in 1/sr, with the dimensions `theta_i`, `theta_o`, `phi` (in degrees) and `band` (in nm, or R, G, B).

    Raises:
        MissingPackageError: xarray is not installed.
        ShapeError: angles have more than one dimension, or polar angles are outside 0 to 90 degrees.
    """
    xarray = require("xarray")
    theta_i, theta_o, phi = angles = [
        np.atleast_1d(np.asarray(a, float)) for a in (theta_i_deg, theta_o_deg, phi_deg)
    ]
    if any(a.ndim != 1 for a in angles):
        raise ShapeError(
            f"angles of shapes {[a.shape for a in angles]}, expected scalars or one-dimensional arrays"
        )
    if not all(np.all((a >= 0.0) & (a <= 90.0)) for a in (theta_i, theta_o)):
        raise ShapeError("polar angles outside 0 to 90 degrees, expected angles from the normal")
    i, o, p = (np.deg2rad(a) for a in np.meshgrid(*angles, indexing="ij"))
    bands = brdf.bands
    labels = list("RGB") if bands.wavelengths_nm is None else np.array(bands.wavelengths_nm)
    return xarray.DataArray(
        brdf.eval(from_spherical(i, 0.0), from_spherical(o, p)),
        {"theta_i": theta_i, "theta_o": theta_o, "phi": phi, "band": labels},
        ("theta_i", "theta_o", "phi", "band"),
        "brdf",
        {"units": "1/sr", "angles": "degrees", "bands": str(bands)},
    )
