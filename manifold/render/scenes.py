"""The material ball: a sphere on a pedestal under the studio light, as a Mitsuba scene.

World: z points up, the camera looks along +y, lengths are in radii of the ball. The studio is an environment image,
scaled so that a white diffuser that lies on the floor has the radiance 1, and a diffuse material shows its
reflectance.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from manifold.colour.lights import FLOOR_REFLECTANCE, studio
from manifold.core.records import Array, Mask

PEDESTAL_REFLECTANCE = 0.42
BALL_CENTRE = (0.0, 0.0, 1.16)

_FLOOR_RADIUS = 60.0
_CAMERA, _TARGET, _FIELD_OF_VIEW_DEG = (0.0, -8.2, 3.5), (0.0, 0.0, 0.98), 21.0

# Half the outline of the pedestal: a disc with rounded edges and a bowl that the ball lies in.
_RADIUS, _HEIGHT, _ROUNDING, _BOWL_RADIUS, _BOWL_DEPTH = 1.02, 0.3, 0.07, 0.62, 0.06


def pedestal(n_azimuths: int = 160) -> tuple[Array, Array]:
    """Return the surface of revolution that the ball lies on: vertices (V, 3) and triangles (F, 3).

    Vertices are float32, triangles uint32 with their normals outwards.
    """
    corner = np.linspace(0.0, np.pi / 2, 12)
    bowl = np.linspace(0.0, 1.0, 24)
    outline = np.concatenate(
        [
            [(_RADIUS, 0.0)],
            np.stack(
                [
                    _RADIUS - _ROUNDING * (1 - np.cos(corner)),
                    _HEIGHT - _ROUNDING * (1 - np.sin(corner)),
                ],
                axis=1,
            ),
            # From the rim to the axis; level at both ends.
            np.stack(
                [
                    _BOWL_RADIUS * (1 - bowl),
                    _HEIGHT - 0.5 * _BOWL_DEPTH * (1 - np.cos(np.pi * bowl)),
                ],
                axis=1,
            )[:-1],
        ]
    )
    azimuth = 2 * np.pi * np.arange(n_azimuths) / n_azimuths
    rings = np.stack(
        [
            outline[:, None, 0] * np.cos(azimuth),
            outline[:, None, 0] * np.sin(azimuth),
            np.broadcast_to(outline[:, None, 1], (len(outline), n_azimuths)),
        ],
        axis=-1,
    )
    tip = np.array([[0.0, 0.0, _HEIGHT - _BOWL_DEPTH]])
    vertices = np.concatenate([rings.reshape(-1, 3), tip])
    ring, k = np.meshgrid(np.arange(len(outline) - 1), np.arange(n_azimuths), indexing="ij")
    a, b = ring * n_azimuths + k, ring * n_azimuths + (k + 1) % n_azimuths
    sides = np.stack([a, b, b + n_azimuths, a, b + n_azimuths, a + n_azimuths], axis=-1).reshape(-1, 3)
    last = (len(outline) - 1) * n_azimuths
    around = np.arange(n_azimuths)
    tips = np.full(n_azimuths, len(vertices) - 1)
    cap = np.stack([last + around, last + (around + 1) % n_azimuths, tips], axis=-1)
    return vertices.astype(np.float32), np.concatenate([sides, cap]).astype(np.uint32)


def material_ball(
    mi: Any,
    material: Mapping[str, Any] | Any,
    film: Mapping[str, Any],
    environment: Array | None = None,
) -> dict[str, Any]:
    """Return the scene, for `mi.load_dict` in the current variant, with a film of square shape.

    The environment is linear RGB radiance, float32, shape (H, W, 3), laid out as `studio` does; the default
    is `studio`.
    """
    transform = mi.ScalarTransform4f
    image = _studio() if environment is None else np.ascontiguousarray(environment, dtype=np.float32)
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 8},
        "sensor": {
            "type": "perspective",
            "fov": _FIELD_OF_VIEW_DEG,
            "to_world": transform().look_at(origin=_CAMERA, target=_TARGET, up=[0, 0, 1]),
            "film": dict(film),
            "sampler": {"type": "multijitter"},
        },
        "environment": {
            "type": "envmap",
            "bitmap": mi.Bitmap(image),
            # Mitsuba's environments have y up and begin behind -z.
            "to_world": transform().rotate([1, 0, 0], 90),
        },
        "floor": {
            "type": "disk",
            "to_world": transform().scale([_FLOOR_RADIUS, _FLOOR_RADIUS, 1]),
            "bsdf": _grey(FLOOR_REFLECTANCE),
        },
        "pedestal": mesh(mi, *pedestal(), bsdf=_grey(PEDESTAL_REFLECTANCE)),
        "ball": {"type": "sphere", "center": list(BALL_CENTRE), "radius": 1.0, "material": material},
    }


@cache
def _studio() -> Array:
    """Return the studio, computed once: it takes an eighth of the time of a small ball."""
    return studio()


def floating_ball(
    mi: Any,
    material: Mapping[str, Any] | Any,
    film: Mapping[str, Any],
    environment: Array,
    *,
    turn_deg: float = 0.0,
    elevation_deg: float = 0.0,
    distance: float = 1e3,
    margin: float = 0.0,
) -> dict[str, Any]:
    """Return the scene of a ball alone in an environment, its outline in the middle of the picture.

    `turn_deg` is the azimuth of what lies straight ahead, from the environment's first column to the right; the camera
    is `elevation_deg` above the ball, its distance and the margin around the outline are in radii of the ball.
    """
    transform = mi.ScalarTransform4f
    elevation = np.deg2rad(elevation_deg)
    distance = min(distance, 1e3)  # with single precision, and no farther than this matters
    camera = distance * np.array([0.0, -np.cos(elevation), np.sin(elevation)])
    half_width = (1.0 + margin) / np.sqrt(distance**2 - 1.0)
    return {
        "type": "scene",
        "integrator": {"type": "direct"},
        "sensor": {
            "type": "perspective",
            "fov": float(2.0 * np.rad2deg(np.arctan(half_width))),
            "to_world": transform().look_at(origin=camera.tolist(), target=[0, 0, 0], up=[0, 0, 1]),
            "near_clip": 0.5 * (distance - 1.0),
            "far_clip": 2.0 * (distance + 1.0),
            "film": dict(film),
            "sampler": {"type": "multijitter"},
        },
        "environment": {
            "type": "envmap",
            "bitmap": mi.Bitmap(np.ascontiguousarray(environment, dtype=np.float32)),
            "to_world": transform().rotate([0, 0, 1], turn_deg).rotate([1, 0, 0], 90),
        },
        "ball": {"type": "sphere", "material": material},
    }


def _grey(reflectance: float) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": {"type": "uniform", "value": reflectance}}


def mesh(mi: Any, vertices: Array, triangles: Array, **properties: Any) -> Any:
    """Return a mesh of vertices (V, 3) and triangles (T, 3), which has normals at its vertices.

    It is loaded from a PLY file: Mitsuba 3.10 changes the constructor and the attributes of meshes.
    """
    head = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(triangles), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, triangles
    with TemporaryDirectory() as folder:
        path = Path(folder) / "mesh.ply"
        path.write_bytes(head.encode() + np.asarray(vertices, dtype="<f4").tobytes() + faces.tobytes())
        return mi.load_dict({"type": "ply", "filename": str(path), **properties})


def ball_interior(size: int, margin: float = 0.0) -> Mask:
    """Return a mask of the pixels of a square picture that show the ball, bool, shape (size, size).

    A share `margin` of the ball's radius along its outline is left out.
    """
    centre = np.array(BALL_CENTRE) - np.array(_CAMERA)
    forward = np.array(_TARGET) - np.array(_CAMERA)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    t = (2 * (np.arange(size) + 0.5) / size - 1) * np.tan(np.deg2rad(_FIELD_OF_VIEW_DEG / 2))
    rays = forward + t[None, :, None] * right + t[:, None, None] * down
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    along = rays @ centre
    return np.asarray(centre @ centre - along**2 < (1.0 - margin) ** 2)
