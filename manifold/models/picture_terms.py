"""Radiance averaged over groups of direction pairs, and its colours.

A pixel averages radiance, and lightness is the cube root of the average: errors of cube roots per direction pair ignore
what accumulates over a pixel, and errors per band ignore tints of nearly neutral colours.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from manifold.directions import half_vector
from manifold.records import Array

_ELEVATIONS = 12
_THETA_H_DEG = (10.0, 40.0)  # between highlight, surround, and the rest
_LEAST_XYZ = 1e-4  # of white: smaller values look black
_DARK_XYZ = 2e-3  # of white: the slopes of smaller values are those of this one


def picture_rows(wi: Array, wo: Array) -> csr_matrix:
    """Averages over groups of direction pairs: elevation of one of the directions x highlight, surround, rest.

    Pairs count by their cosines times the solid angles of a grid even in sqrt(theta_h) and in theta_d. Every pair is in
    two groups, one for either direction.

    Args:
        wi, wo: unit vectors above the horizon (P, 3).
    Returns:
        Shape (K, P), rows sum to 1.
    """
    h = half_vector(wi, wo)
    theta_h = np.arccos(np.clip(h[:, 2], -1.0, 1.0))
    theta_d = np.arccos(np.clip(np.sum(wi * h, axis=1), 0.0, 1.0))
    measure = np.sin(theta_h) * np.sqrt(theta_h) * np.sin(theta_d) * np.cos(theta_d) * wi[:, 2] * wo[:, 2]
    ring = np.searchsorted(np.deg2rad(_THETA_H_DEG), theta_h)
    per_direction = _ELEVATIONS * (len(_THETA_H_DEG) + 1)
    groups = []
    for k, w in enumerate((wi, wo)):
        share = np.arccos(np.clip(w[:, 2], 0.0, 1.0)) / (0.5 * np.pi)
        elevation = np.minimum((share * _ELEVATIONS).astype(int), _ELEVATIONS - 1)
        groups.append(k * per_direction + elevation * (len(_THETA_H_DEG) + 1) + ring)
    _, row = np.unique(np.concatenate(groups), return_inverse=True)
    measure = np.tile(measure, 2)
    share = measure / np.bincount(row, measure)[row]
    return csr_matrix((share, (row, np.tile(np.arange(len(wi)), 2))))


def lab_slopes(means: Array, to_xyz: Array) -> Array:
    """Change of `L*`, `a* / S_C`, `b* / S_C` per change of averages of f, in hundredths: shape (K, 3, B).

    Args:
        means: averages of a material's f in 1/sr over groups, shape (K, B): where CIELAB is linearised.
        to_xyz: XYZ of f = 1 / pi in each band alone, shape (3, B); all together are white.
    Source: CIE 15:2004 (CIELAB); CIE 116:1995 (CIE94), S_C = 1 + 0.045 C*.
    """
    white = to_xyz.sum(axis=1)
    xyz = np.maximum(np.pi * means @ to_xyz.T / white, _LEAST_XYZ)
    x, y, z = np.cbrt(xyz).T
    S_C = 1.0 + 0.045 * np.hypot(500.0 * (x - y), 200.0 * (y - z))
    root = 3.0 * np.maximum(xyz, _DARK_XYZ) ** (2.0 / 3.0)
    slope = (np.pi * to_xyz / white[:, None]) / root[:, :, None]  # of cube roots, [K, 3, B]
    dx, dy, dz = np.moveaxis(slope, 1, 0)
    S_C = S_C[:, None]
    return np.stack([116.0 * dy, 500.0 * (dx - dy) / S_C, 200.0 * (dy - dz) / S_C], axis=1) / 100.0
