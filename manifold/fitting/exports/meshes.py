"""The ball and the plane that exported scenes show a material on; y points up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from manifold.records import Array

_COLUMNS, _ROWS = 64, 32


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles.

    Attributes:
        name: of the mesh.
        positions, normals: float32, shape (V, 3).
        tangents: along which anisotropic materials are rougher, with the sign of the bitangent, float32 (V, 4).
        triangles: indices, counterclockwise from outside, uint16 (F, 3).
    """

    name: str
    positions: Array
    normals: Array
    tangents: Array
    triangles: Array


def ball() -> Mesh:
    """A unit sphere around the origin by longitude and latitude."""
    theta = np.linspace(0.0, np.pi, _ROWS + 1)[:, None]
    phi = np.linspace(0.0, 2.0 * np.pi, _COLUMNS + 1)[None]
    normals = np.stack(
        [np.sin(theta) * np.sin(phi), np.cos(theta) + 0.0 * phi, np.sin(theta) * np.cos(phi)], axis=-1
    ).reshape(-1, 3)
    zero, one = np.zeros_like(theta * phi), np.ones_like(theta * phi)
    tangents = np.stack([np.cos(phi) * one, zero, -np.sin(phi) * one, one], axis=-1).reshape(-1, 4)
    row, column = (a.ravel() for a in np.meshgrid(np.arange(_ROWS), np.arange(_COLUMNS), indexing="ij"))
    a = row * (_COLUMNS + 1) + column
    b, c, d = a + _COLUMNS + 1, a + _COLUMNS + 2, a + 1
    upper = np.stack([a, b, d], axis=1)[row > 0]  # at the poles one triangle has no area
    lower = np.stack([d, b, c], axis=1)[row < _ROWS - 1]
    return _mesh("ball", normals, normals, tangents, np.concatenate([upper, lower]))


def plane() -> Mesh:
    """A square of side 2 that faces up."""
    positions = np.array([[-1.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 0.0, -1.0], [-1.0, 0.0, -1.0]])
    normals = np.tile([0.0, 1.0, 0.0], (4, 1))
    tangents = np.tile([1.0, 0.0, 0.0, 1.0], (4, 1))
    return _mesh("plane", positions, normals, tangents, np.array([[0, 1, 2], [0, 2, 3]]))


def _mesh(name: str, positions: Array, normals: Array, tangents: Array, triangles: Array) -> Mesh:
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return Mesh(
        name, positions.astype("<f4"), normals.astype("<f4"), tangents.astype("<f4"), triangles.astype("<u2")
    )
