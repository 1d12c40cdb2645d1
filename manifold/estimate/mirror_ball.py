"""The light around a mirror ball, unwrapped from its photograph, and the spots in it that the camera clipped."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import label, map_coordinates

from manifold.colour.lights import directions
from manifold.estimate.circle import Circle
from manifold.estimate.lamps import Lamp
from manifold.estimate.photo_files import Photograph
from manifold.estimate.pixels import Camera
from manifold.records import Array

_HEIGHT = 256  # of the unwrapped picture
_RIM = 0.985  # of the radius: beyond, pixels mix the ball with what is beside it
_MOST_SPOTS = 4
_LEAST_SPOT = 0.1  # of the largest one's light: smaller ones stay as they are


def unwrapped(photograph: Photograph, circle: Circle, camera: Camera) -> Array:
    """The environment that a mirror ball shows a far camera, by latitude and longitude, shape (H, 2 H, 3).

    What lies straight behind the ball is taken from its rim.

    Args:
        photograph: linear; what was not seen of it is black.
        circle: outline of the mirror ball.
        camera: whose frame the ball is seen in.
    """
    world = directions(_HEIGHT)[..., [1, 0, 2]]  # from straight ahead to the right
    seen = world @ np.array(camera.axes).T  # in the camera's frame
    half = seen + np.array([0.0, 0.0, 1.0])
    half /= np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-9)
    across = half[..., :2]
    radius = np.linalg.norm(across, axis=-1, keepdims=True)
    across = across * np.minimum(1.0, _RIM / np.maximum(radius, 1e-9))
    rows = circle.y - across[..., 1] * circle.radius - 0.5
    columns = circle.x + across[..., 0] * circle.radius - 0.5
    values = np.nan_to_num(photograph.values)
    return np.stack(
        [map_coordinates(values[..., c], [rows, columns], order=1, mode="nearest") for c in range(3)], axis=-1
    )


def clipped_spots(photograph: Photograph, circle: Circle) -> tuple[Lamp, ...]:
    """Lamps where a mirror ball's photograph is clipped, as bright as the camera's largest value, the largest first.

    Their strength is `lamps.Lamp.colour` relative to a white diffuser that faces them; their true one is more.
    """
    rows, columns = np.indices(photograph.is_clipped.shape) + 0.5
    x, y = (columns - circle.x) / circle.radius, (circle.y - rows) / circle.radius
    marked, count = label(photograph.is_clipped & (np.hypot(x, y) < _RIM))
    lamps = []
    for k in range(1, count + 1):
        own = marked == k
        z = np.sqrt(np.maximum(1.0 - x[own] ** 2 - y[own] ** 2, 0.0))
        normal = np.stack([x[own], y[own], z], axis=1)
        towards = 2.0 * z[:, None] * normal - [0.0, 0.0, 1.0]
        # A pixel shows 4 times its area over the square of the radius, wherever on the ball it is.
        solid_angle = 4.0 * len(z) / circle.radius**2
        strength = solid_angle / np.pi * np.nan_to_num(photograph.values[own]).mean(axis=0)
        radius_deg = float(np.rad2deg(np.sqrt(solid_angle / np.pi)))
        lamp = Lamp.towards(towards.mean(axis=0))
        lamps.append(Lamp(lamp.direction, np.inf, strength, min(radius_deg, 30.0)))
    lamps.sort(key=lambda lamp: -float(lamp.colour.mean()))
    return tuple(
        one for one in lamps[:_MOST_SPOTS] if one.colour.mean() >= _LEAST_SPOT * lamps[0].colour.mean()
    )
