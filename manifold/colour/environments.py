"""Environments made here: the studio, an overcast and a sunny sky, one lamp, and a room with a window."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from manifold.colour import studio
from manifold.directions import from_spherical
from manifold.records import Array

_SUN = (-128.0, 46.0)  # azimuth from straight ahead to the right, elevation, in degrees
_SUN_RADIUS_DEG, _SUN_EDGE_DEG, _SUN_RADIANCE = 4.5, 3.0, 50.0  # behind thin haze
_LAMP, _DARK = (
    (-140.0, 45.0),
    0.0015,
)  # azimuth and elevation; radiance of the dark room, relative to the lamp's


def environment(name: str, height: int = 128) -> Array:
    """One of `ENVIRONMENTS`, with the light of its floor from below.

    Args:
        name: which.
        height: rows; there are twice as many columns.
    Returns:
        Linear sRGB radiance, float32, laid out as `studio.studio` does, shape (height, 2 height, 3): a white diffuser
        that lies on the floor has the mean radiance 1.
    """
    make, floor = ENVIRONMENTS[name]
    image = studio.exposed(make(height))
    image[height // 2 :] = floor
    return image


def _sky(height: int) -> Array:
    direction = studio.directions(height)
    up = np.maximum(direction[..., 2:], 0.0)
    sky = (1 - np.sqrt(up)) * [0.85, 0.92, 1.0] + np.sqrt(up) * [0.22, 0.42, 0.85]
    sun = from_spherical(np.pi / 2 - np.deg2rad(_SUN[1]), np.deg2rad(_SUN[0]))
    away = np.rad2deg(np.arccos(np.clip(direction @ sun, -1.0, 1.0)))[..., None]
    t = np.clip(0.5 + (_SUN_RADIUS_DEG - away) / _SUN_EDGE_DEG, 0.0, 1.0)
    return sky + [1.0, 0.92, 0.78] * (_SUN_RADIANCE * t * t * (3.0 - 2.0 * t) + 2.5 * np.exp(-away / 12.0))


def _overcast(height: int) -> Array:
    """CIE standard overcast sky (ISO 15469:2004, type 16): three times as bright at the zenith as at the horizon."""
    up = np.maximum(studio.directions(height)[..., 2:], 0.0)
    return np.repeat(1.0 + 2.0 * up, 3, axis=-1)


def _one_lamp(height: int) -> Array:
    lamp = studio.soft_box(studio.directions(height), *_LAMP, 6.0, 6.0)
    return np.repeat(lamp[..., None] + _DARK, 3, axis=-1)


def _room(height: int) -> Array:
    direction = studio.directions(height)
    up = np.maximum(direction[..., 2:], 0.0)
    walls = 0.16 * np.array([1.0, 0.93, 0.85]) * (1.0 + 1.2 * up)
    panes = np.zeros(direction.shape[:2])
    for azimuth in (-126.0, -105.0):
        for elevation in (20.0, 43.0):
            panes += studio.soft_box(direction, azimuth, elevation, 8.0, 9.0)
    lamp = studio.soft_box(direction, 62.0, 38.0, 5.0, 5.0)
    return walls + 14.0 * panes[..., None] * [0.86, 0.95, 1.1] + 16.0 * lamp[..., None] * [1.0, 0.72, 0.42]


_GREY = (studio.FLOOR_REFLECTANCE,) * 3
ENVIRONMENTS: dict[str, tuple[Callable[[int], Array], tuple[float, float, float]]] = {
    "studio": (studio.studio, _GREY),
    "overcast": (_overcast, _GREY),
    "sky": (_sky, (0.2, 0.19, 0.16)),
    "one-lamp": (_one_lamp, (0.03, 0.03, 0.03)),
    "room": (_room, (0.26, 0.2, 0.15)),
}
"""What makes each, and the radiance of its floor."""
