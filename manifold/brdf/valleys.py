"""Valleys in highlights: in-plane minima near the mirror direction, which measured materials hardly have."""

from __future__ import annotations

import numpy as np

from manifold.directions import from_spherical
from manifold.records import Array

INCIDENCES_DEG = (25.0, 40.0, 50.0, 65.0)
REACH_DEG = 20.0
"""How far from the mirror direction profiles go."""


def profile_pairs() -> tuple[Array, Array]:
    """Directions wi (I, 1, 3) and wo (I, D, 3): in the plane of incidence, around the mirror direction."""
    offset = np.arange(-REACH_DEG, REACH_DEG + 1.0)
    incidence = np.array(INCIDENCES_DEG)
    outgoing = np.deg2rad(np.minimum(incidence[:, None] + offset, 85.0))
    wo = np.stack([-np.sin(outgoing), np.zeros_like(outgoing), np.cos(outgoing)], axis=2)
    return from_spherical(np.deg2rad(incidence), np.zeros(len(incidence)))[:, None], wo


def valley_depth(f: Array) -> Array:
    """How far profiles f (..., D) fall below the lower of the highest values on both sides, as a share of it, (...)."""
    left = np.maximum.accumulate(f, axis=-1)
    right = np.maximum.accumulate(f[..., ::-1], axis=-1)[..., ::-1]
    sides = np.minimum(left, right)
    return np.max(1.0 - f / np.maximum(sides, 1e-9), axis=-1)
