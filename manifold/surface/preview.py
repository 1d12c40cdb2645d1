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
from manifold.surface.sparkle import DrawnFlakes

_LAMPS_DEG = np.array([60.0, 20.0, -50.0])  # from the normal, in the plane of the instrument's lamps
_SIZE, _SAMPLES = 320, 16


def strip(mean: Path, normal: Array, changes: Array, flakes: DrawnFlakes | None = None) -> Array:
    """A plane under three lamps, then a ball in the studio, side by side in linear sRGB, shape (S, 4 S, 3).

    Args:
        mean: an RGL file of linear sRGB or a spectrum.
        normal: unit normals, shape (H, W, 3).
        changes: of `spectral_changes`, shape (H, W, 3).
        flakes: between the rest; None for none.
    """
    from manifold.io_rgl import read_bsdf

    mi = backend.mitsuba("rgb" if read_bsdf(mean).bands.is_rgb else "spectral")
    bsdf.register()
    settings = RenderSettings(size=_SIZE, samples=_SAMPLES)
    material = material_of(mi, mean, normal, changes, flakes)
    plane = {"type": "rectangle", "material": material}
    planes = [mi.load_dict(under_lamp(mi, plane, lamp)) for lamp in in_plane(_LAMPS_DEG)]
    ball = material_of(mi, mean, normal, changes, flakes, repeats=(2.0, 1.0))
    shown = mi.load_dict(scenes.material_ball(mi, ball, rgb_film(_SIZE)))
    return np.concatenate([render_scene(mi, scene, settings) for scene in (*planes, shown)], axis=1)


def material_of(
    mi: Any, mean: Path, normal: Array, changes: Array, flakes: DrawnFlakes | None = None,
    repeats: tuple[float, float] = (1.0, -1.0),
) -> dict[str, Any]:  # fmt: skip
    """The surface as a dictionary of Mitsuba's.

    Args:
        mi: Mitsuba.
        mean, normal, changes, flakes: as of `strip`.
        repeats: of the textures along u and v; v is negative for rectangles, whose v runs upwards.
    """
    nested = {"type": "measured", "filename": str(mean)}
    changed = {"type": bsdf.NAME, "changes": _bitmap(mi, changes, repeats), "nested": nested}
    material = {"type": "normalmap", "normalmap": _bitmap(mi, 0.5 + 0.5 * normal, repeats), "bsdf": changed}
    return material if flakes is None else with_flakes(mi, material, flakes, repeats)


def with_flakes(
    mi: Any, material: Mapping[str, Any], flakes: DrawnFlakes, repeats: tuple[float, float]
) -> dict[str, Any]:
    """A material with flakes between, as a dictionary of Mitsuba's; `repeats` as of `material_of`."""
    facet = {
        "type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": flakes.flakes.roughness,
        "specular_reflectance": {"type": "uniform", "value": flakes.flakes.reflectance / flakes.share},
    }  # fmt: skip
    normals = _bitmap(mi, 0.5 + 0.5 * flakes.normal, repeats, "nearest")
    return {
        "type": "blendbsdf",
        "weight": _bitmap(mi, flakes.share * flakes.mask[..., None], repeats, "nearest"),
        "between": dict(material),
        "flakes": {"type": "normalmap", "normalmap": normals, "facet": facet},
    }


def _bitmap(
    mi: Any, values: Array, repeats: tuple[float, float], filter_type: str = "bilinear"
) -> Mapping[str, Any]:
    picture = mi.Bitmap(np.ascontiguousarray(values, dtype=np.float32))
    to_uv = mi.ScalarTransform4f().scale([*repeats, 1.0])
    return {"type": "bitmap", "bitmap": picture, "raw": True, "filter_type": filter_type, "to_uv": to_uv}


def under_lamp(
    mi: Any,
    shape: Any,
    lamp: Array,
    camera: Array | None = None,
    film: Mapping[str, Any] | None = None,
    bounces: int = 1,
) -> dict[str, Any]:
    """A flat shape about the plane z = 0 under a distant lamp; a white diffuser in that plane has radiance 1.

    Args:
        mi: Mitsuba.
        shape: as a dictionary or an object; x runs from -1 to 1.
        lamp: unit vector towards it; NaN for diffuse light.
        camera: unit vector towards it; straight above if None. Its pictures show the plane without foreshortening.
        film: a dictionary; a square one if None.
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
            "film": rgb_film(_SIZE) if film is None else dict(film),
        },
        "lamp": light,
        "shape": shape,
    }
