"""Renders of a surface: a plane under a moving lamp, and a ball in the studio, by Mitsuba."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from manifold.records import Array
from manifold.render import backend, scenes
from manifold.render.render import RenderSettings, render_scene, rgb_film
from manifold.surface import bsdf
from manifold.surface.lamp_pictures import in_plane

_LAMPS_DEG = np.array([60.0, 20.0, -50.0])  # from the normal, in the plane of the instrument's lamps
_SIZE, _SAMPLES = 320, 32


def strip(mean: Path, normal: Array, changes: Array) -> Array:
    """A plane under three lamps, then a ball in the studio, side by side in linear sRGB, shape (S, 4 S, 3).

    Args:
        mean: an RGL file of linear sRGB or a spectrum.
        normal: unit normals, shape (H, W, 3).
        changes: of `spectra.spectral_changes`, shape (H, W, 3).
    """
    from manifold.io_rgl import read_bsdf

    mi = backend.mitsuba("rgb" if read_bsdf(mean).bands.is_rgb else "spectral")
    bsdf.register()
    settings = RenderSettings(size=_SIZE, samples=_SAMPLES)
    material = material_of(mi, mean, normal, changes)
    plane = {"type": "rectangle", "material": material}
    planes = [mi.load_dict(under_lamp(mi, plane, lamp)) for lamp in in_plane(_LAMPS_DEG)]
    ball = material_of(mi, mean, normal, changes, repeats=(2.0, 1.0))
    shown = mi.load_dict(scenes.material_ball(mi, ball, rgb_film(_SIZE)))
    return np.concatenate([render_scene(mi, scene, settings) for scene in (*planes, shown)], axis=1)


def material_of(
    mi: Any, mean: Path, normal: Array, changes: Array, repeats: tuple[float, float] = (1.0, -1.0)
) -> dict[str, Any]:
    """The surface as a dictionary of Mitsuba's.

    Args:
        mi: Mitsuba.
        mean, normal, changes: as of `strip`.
        repeats: of the textures along u and v; v is negative for rectangles, whose v runs upwards.
    """
    to_uv = mi.ScalarTransform4f().scale([*repeats, 1.0])

    def bitmap(values: Array) -> Mapping[str, Any]:
        picture = mi.Bitmap(np.ascontiguousarray(values, dtype=np.float32))
        return {"type": "bitmap", "bitmap": picture, "raw": True, "to_uv": to_uv}

    nested = {"type": "measured", "filename": str(mean)}
    return {
        "type": "normalmap",
        "normalmap": bitmap(0.5 + 0.5 * normal),
        "bsdf": {"type": bsdf.NAME, "changes": bitmap(changes), "nested": nested},
    }


def under_lamp(
    mi: Any, shape: Any, lamp: Array, camera: Array | None = None, film: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """A flat shape about the plane z = 0 under a distant lamp; a white diffuser in that plane has radiance 1.

    Args:
        mi: Mitsuba.
        shape: as a dictionary or an object; x runs from -1 to 1.
        lamp: unit vector towards it; NaN for diffuse light.
        camera: unit vector towards it; straight above if None. Its pictures show the plane without foreshortening.
        film: a dictionary; a square one if None.
    """
    camera = np.array([0.0, 0.0, 1.0]) if camera is None else camera
    view = mi.ScalarTransform4f().look_at((4.0 * camera).tolist(), [0, 0, 0], [0, 1, 0])
    light = {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}}
    if np.all(np.isfinite(lamp)):
        irradiance = {"type": "rgb", "value": float(np.pi / lamp[2])}
        light = {"type": "directional", "direction": (-lamp).tolist(), "irradiance": irradiance}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 4},
        "sensor": {
            "type": "orthographic",
            "to_world": view @ mi.ScalarTransform4f().scale([1.0, float(camera[2]), 1.0]),
            "film": rgb_film(_SIZE) if film is None else dict(film),
        },
        "lamp": light,
        "shape": shape,
    }
