"""A scene of Mitsuba: a flat shape under a distant lamp, to hold surfaces to."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from manifold.core.records import Array
from manifold.render.render import rgb_film


def under_lamp(
    mi: Any,
    shape: Any,
    lamp: Array,
    camera: Array | None = None,
    film: Mapping[str, Any] | None = None,
    bounces: int = 1,
) -> dict[str, Any]:
    """Return a flat shape about the plane z = 0 under a distant lamp; a white diffuser in that plane has radiance 1.

    Args:
        mi: Mitsuba.
        shape: as a dictionary or an object; x runs from -1 to 1.
        lamp: unit vector towards it; NaN for diffuse light.
        camera: unit vector towards it; straight above if None. Its pictures show the plane without foreshortening.
        film: a dictionary; a square one of 320 pixels if None.
        bounces: of light on the shape; more than one for a relief, which lights itself.
    """
    camera = np.array([0.0, 0.0, 1.0]) if camera is None else camera
    view = mi.ScalarTransform4f().look_at((4.0 * camera).tolist(), [0, 0, 0], [0, 1, 0])
    light = {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}}
    if np.all(np.isfinite(lamp)):
        irradiance = {"type": "rgb", "value": float(np.pi / lamp[2])}
        light = {"type": "directional", "direction": (-lamp).tolist(), "irradiance": irradiance}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": bounces + 1},
        "sensor": {
            "type": "orthographic",
            "to_world": view @ mi.ScalarTransform4f().scale([1.0, float(camera[2]), 1.0]),
            "film": rgb_film(320) if film is None else dict(film),
        },
        "lamp": light,
        "shape": shape,
    }
