"""Directions of tables by their angles: transmission left out, and what stands for the azimuths that are missing."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from manifold.directions import from_spherical
from manifold.formats.column_heads import RELATIVE
from manifold.formats.text import ErrorContext
from manifold.records import Array

_ROUNDING = 0.01  # radians


def exceed_radians(angles: Mapping[str, Array]) -> bool:
    """Whether angles are too large for radians: elevations beyond pi, azimuths beyond a full turn."""
    return any(
        float(np.max(np.abs(values), initial=0.0))
        > (np.pi if name.startswith("theta") else 2.0 * np.pi) + _ROUNDING
        for name, values in angles.items()
    )


def directions(
    angles: Mapping[str, Array], context: ErrorContext, notes: list[str]
) -> tuple[Array, Array, Array]:
    """Which rows are reflected light, bool (P,), and their wi and wo, (Q, 3).

    Args:
        angles: by `angle_name`, in radians, each (P,); theta_i and theta_o at least.
        context: names the file in errors.
        notes: what was assumed is added.
    """
    keep = np.ones(len(angles["theta_i"]), dtype=bool)
    for key in ("theta_i", "theta_o"):
        worst = float(np.max(np.abs(angles[key])))
        if worst > np.pi + 1e-6:
            raise context.error(f"{key} reaches {np.rad2deg(worst):.4g} degrees, expected at most 90")
        keep &= np.abs(angles[key]) <= 0.5 * np.pi + 1e-4
    if not np.all(keep):
        notes.append(f"{int((~keep).sum())} rows of transmitted light (beyond 90 degrees) are left out")
    if not np.any(keep):
        raise context.error("no rows of reflected light, expected theta below 90 degrees")
    phi_i, phi_o = angles.get("phi_i"), angles.get("phi_o")
    if RELATIVE in angles:
        if phi_i is not None or phi_o is not None:
            raise context.error("dphi beside phi_i or phi_o, expected either the difference or both azimuths")
        phi_i, phi_o = np.zeros(len(keep)), angles[RELATIVE]
        notes.append("differences of azimuths: the mirror direction is taken at 180 degrees")
    elif phi_i is None:
        phi_i = np.full(len(keep), np.pi)
        notes.append("no phi_i: the mirror direction is taken at phi_s = 0")
    elif phi_o is None:
        raise context.error("phi_i without phi_o, expected both azimuths")
    if phi_o is None:
        phi_o = np.zeros(len(keep))
    wi, wo = (
        from_spherical(angles["theta_i"][keep], phi_i[keep]),
        from_spherical(angles["theta_o"][keep], phi_o[keep]),
    )
    wi[:, 2], wo[:, 2] = np.maximum(wi[:, 2], 0.0), np.maximum(wo[:, 2], 0.0)  # rounding at the horizon
    return keep, wi, wo
