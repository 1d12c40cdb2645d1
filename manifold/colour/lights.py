"""Lights around a material: the studio, and other environments."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from manifold.core.directions import from_spherical
from manifold.core.errors import UsageError
from manifold.core.records import Array
from manifold.registries import Registry

FLOOR_REFLECTANCE = 0.22

# Soft boxes: azimuth from straight ahead to the right, elevation, half width, half height (degrees), radiance.
_SOFT_BOXES = (
    (-128.0, 48.0, 17.0, 15.0, 16.0),  # key, behind the camera to the left
    (98.0, 32.0, 5.0, 26.0, 7.0),  # strip to the right
    (-38.0, 24.0, 22.0, 5.0, 6.0),  # rim, behind the ball
)
_MOST_OFF = 0.05  # share of its width by which an environment may be too narrow or too wide
_EDGE_DEG = 2.0  # angle over which a soft box fades out
_ZENITH, _HORIZON = 0.9, 0.28


def studio(height: int = 256) -> Array:
    """Return the studio, the default environment: a dim dome and three soft boxes, without colour.

    The result is radiance, float32, shape (height, 2 height, 3). Row 0 is the zenith; column 0 is straight ahead, and
    columns continue to the right.
    """
    direction = directions(height)
    elevation = np.maximum(direction[..., 2], 0.0)
    radiance = _HORIZON + (_ZENITH - _HORIZON) * np.sqrt(elevation)
    for *where, power in _SOFT_BOXES:
        radiance += power * soft_box(direction, *where)
    return exposed(np.repeat(radiance[..., None], 3, axis=2))


def directions(height: int) -> Array:
    """Return the world directions of the pixels of an environment of `height` rows, shape (height, 2 height, 3)."""
    theta = np.pi * (np.arange(height) + 0.5) / height
    azimuth = 2 * np.pi * (np.arange(2 * height) + 0.5) / (2 * height)
    return from_spherical(theta[:, None], azimuth[None, :])


def soft_box(
    direction: Array, azimuth: float, elevation: float, half_width: float, half_height: float
) -> Array:
    """Return 1 for directions (..., 3) within a box, 0 outside, with smooth edges.

    The position and size of the box are in degrees.
    """
    forward = from_spherical(np.pi / 2 - np.deg2rad(elevation), np.deg2rad(azimuth))
    right = from_spherical(np.pi / 2, np.deg2rad(azimuth) + np.pi / 2)
    up = np.cross(forward, right)
    ahead = direction @ forward
    behind = np.where(ahead > 0, 0.0, np.pi)
    x = np.arctan2(direction @ right, np.abs(ahead)) + behind
    y = np.arcsin(np.clip(direction @ up, -1, 1))
    return _plateau(np.rad2deg(x), half_width) * _plateau(np.rad2deg(y), half_height)


def exposed(environment: Array) -> Array:
    """Scale an environment (H, W, 3), so that a white diffuser on the floor has the mean radiance 1.

    The environment has the layout of `studio`.
    """
    require_light(environment)
    theta = np.pi * (np.arange(len(environment)) + 0.5) / len(environment)
    cosine = np.maximum(np.cos(theta), 0.0) * np.sin(theta)
    total = np.sum(environment.mean(axis=(1, 2)) * cosine) / np.sum(cosine)
    if not total > 0.0:
        raise UsageError("the environment is black above the horizon, expected light from there")
    return np.asarray(environment / total, dtype=np.float32)


def require_light(environment: Array) -> None:
    """Raise UsageError unless an environment (H, W, 3) is twice as wide as high, finite, and 0 or more, not all 0."""
    H, W = environment.shape[:2]
    if abs(W - 2 * H) > _MOST_OFF * W:
        raise UsageError(
            f"an environment of {W} x {H} pixels, expected twice as wide as high: latitude by longitude"
        )
    if not np.isfinite(environment).all():
        raise UsageError(
            "the environment has transparent pixels or values that are not finite, expected finite radiance"
        )
    if (least := float(environment.min())) < 0.0:
        raise UsageError(
            f"an environment with negative light, down to {least:.3g}, expected 0 or more; set "
            f"{np.count_nonzero(environment < 0.0)} values to 0"
        )
    if not environment.max() > 0.0:
        raise UsageError("the environment is black, expected radiance above 0")


def _plateau(angle_deg: Array, half_width: float) -> Array:
    """Return 1 within the half width, 0 beyond its edge, smooth between."""
    t = np.clip((half_width + _EDGE_DEG - np.abs(angle_deg)) / _EDGE_DEG, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


_SUN = (-128.0, 46.0)  # azimuth from straight ahead to the right, elevation, in degrees
_SUN_RADIUS_DEG, _SUN_EDGE_DEG, _SUN_RADIANCE = 4.5, 3.0, 50.0  # behind thin haze
# Azimuth and elevation; radiance of the dark room, relative to the lamp's.
_LAMP, _DARK = (-140.0, 45.0), 0.0015


def environment(name: str, height: int = 128) -> Array:
    """Return one of `ENVIRONMENTS`, with its floor's light from below, as linear sRGB radiance.

    The result is float32, shape (height, 2 height, 3), in the layout of `studio`. A white diffuser on the floor has
    the mean radiance 1.
    """
    make, floor = ENVIRONMENTS[name]
    image = exposed(make(height))
    image[height // 2 :] = floor
    return image


def _sky(height: int) -> Array:
    direction = directions(height)
    up = np.maximum(direction[..., 2:], 0.0)
    sky = (1 - np.sqrt(up)) * [0.85, 0.92, 1.0] + np.sqrt(up) * [0.22, 0.42, 0.85]
    sun = from_spherical(np.pi / 2 - np.deg2rad(_SUN[1]), np.deg2rad(_SUN[0]))
    away = np.rad2deg(np.arccos(np.clip(direction @ sun, -1.0, 1.0)))[..., None]
    t = np.clip(0.5 + (_SUN_RADIUS_DEG - away) / _SUN_EDGE_DEG, 0.0, 1.0)
    return sky + [1.0, 0.92, 0.78] * (_SUN_RADIANCE * t * t * (3.0 - 2.0 * t) + 2.5 * np.exp(-away / 12.0))


def _overcast(height: int) -> Array:
    """Return the CIE standard overcast sky (ISO 15469:2004, type 16).

    It is three times brighter at the zenith than at the horizon.
    """
    up = np.maximum(directions(height)[..., 2:], 0.0)
    return np.repeat(1.0 + 2.0 * up, 3, axis=-1)


def _one_lamp(height: int) -> Array:
    lamp = soft_box(directions(height), *_LAMP, 6.0, 6.0)
    return np.repeat(lamp[..., None] + _DARK, 3, axis=-1)


def _room(height: int) -> Array:
    direction = directions(height)
    up = np.maximum(direction[..., 2:], 0.0)
    walls = 0.16 * np.array([1.0, 0.93, 0.85]) * (1.0 + 1.2 * up)
    panes = np.zeros(direction.shape[:2])
    for azimuth in (-126.0, -105.0):
        for elevation in (20.0, 43.0):
            panes += soft_box(direction, azimuth, elevation, 8.0, 9.0)
    lamp = soft_box(direction, 62.0, 38.0, 5.0, 5.0)
    return walls + 14.0 * panes[..., None] * [0.86, 0.95, 1.1] + 16.0 * lamp[..., None] * [1.0, 0.72, 0.42]


_GREY = (FLOOR_REFLECTANCE,) * 3
ENVIRONMENTS: Registry[tuple[Callable[[int], Array], tuple[float, float, float]]] = Registry(
    "light",
    {
        "studio": (studio, _GREY),
        "overcast": (_overcast, _GREY),
        "sky": (_sky, (0.2, 0.19, 0.16)),
        "one-lamp": (_one_lamp, (0.03, 0.03, 0.03)),
        "room": (_room, (0.26, 0.2, 0.15)),
    }.items(),
)
"""The function that makes each environment, and the radiance of its floor."""
