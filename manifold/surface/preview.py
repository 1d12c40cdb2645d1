"""Renders previews of a surface, a plane under a moving lamp and a ball in the studio, and makes Mitsuba materials."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates

from manifold.brdf.interface import EvaluableBRDF
from manifold.colour import ball_colours
from manifold.colour.conversion import to_srgb
from manifold.core.directions import normalize
from manifold.core.records import Array, Mask
from manifold.surface import bsdf
from manifold.surface.lamp_pictures import in_plane
from manifold.surface.response import shaded
from manifold.surface.sparkle import DrawnFlakes
from manifold.surface.tiling import Textures

_LAMPS_DEG = np.array([60.0, 20.0, -50.0])  # from the normal, in the plane of the instrument's lamps
_SIZE, _FINER = 320, 2  # pixels of a side, and samples across each
_STEEPEST, _SLOPES = 2.5, 301  # range of slopes under a lamp, and nodes across it
_BALL_PIXELS = 40
_BLOCK = 128  # pixels of the ball that are evaluated at once
_BALL_RADIUS, _EDGE, _GROUND = 0.9, 0.98, 0.05  # of half a side; of the ball; linear sRGB around it


def strip(brdf: EvaluableBRDF, textures: Textures, flakes: DrawnFlakes | None = None) -> Array:
    """Render a plane under three lamps and a ball in the studio, side by side in linear sRGB, shape (S, 4 S, 3).

    The camera is far away, so that the radiance of a facet depends only on its normal; tables of it are
    interpolated.

    Args:
        brdf: mean BRDF, isotropic.
        textures: textures of the surface.
        flakes: drawn flakes, or None.
    """
    fine = (np.arange(_FINER * _SIZE) + 0.5) / (_FINER * _SIZE)
    above = np.array([0.0, 0.0, 1.0])
    columns, rows = np.meshgrid(fine, fine)

    def of_plane(facets: EvaluableBRDF, slope: Array, where: Mask, lamp: Array) -> Array:
        across = np.linspace(-_STEEPEST, _STEEPEST, _SLOPES)
        grid = np.stack(np.meshgrid(across, across), axis=-1)
        at = (np.clip(slope[where] / _STEEPEST, -1.0, 1.0) + 1.0) * 0.5 * (_SLOPES - 1)
        return _interpolated(shaded(facets, grid, lamp, above), at)

    made = [
        _drawn(brdf, textures, flakes, rows, columns, partial(of_plane, lamp=lamp))
        for lamp in in_plane(_LAMPS_DEG)
    ]
    x, y = (2.0 * columns - 1.0) / _BALL_RADIUS, (1.0 - 2.0 * rows) / _BALL_RADIUS
    inside = x**2 + y**2 < 1.0
    x, y = x[inside], y[inside]
    z = np.sqrt(1.0 - x**2 - y**2)
    ring = np.sqrt(1.0 - y**2)
    right = np.stack([z / ring, 0.0 * x, -x / ring], axis=-1)
    up = np.stack([-x * y / ring, ring, -y * z / ring], axis=-1)

    def of_ball(facets: EvaluableBRDF, slope: Array, where: Mask) -> Array:
        normal = np.stack([x, y, z], axis=-1) + slope[..., :1] * right + slope[..., 1:] * up
        normal = normalize(normal[where])
        at = np.clip(normal[:, :2] * [1.0, -1.0], -_EDGE, _EDGE)
        return _interpolated(_lit_ball(facets), (0.5 + 0.5 * at) * _BALL_PIXELS - 0.5)

    ball = np.full((*inside.shape, 3), _GROUND)
    ball[inside] = _drawn(
        brdf, textures, flakes, np.arccos(y) / np.pi, 0.5 + np.arctan2(x, z) / np.pi, of_ball
    )
    coarser = [each.reshape(_SIZE, _FINER, _SIZE, _FINER, 3).mean(axis=(1, 3)) for each in (*made, ball)]
    return np.concatenate(coarser, axis=1)


def _drawn(
    brdf: EvaluableBRDF, textures: Textures, flakes: DrawnFlakes | None, rows: Array, columns: Array,
    lit: Callable[[EvaluableBRDF, Array, Mask], Array],
) -> Array:  # fmt: skip
    """Return the radiance (..., 3) at points of the textures, whose rows and columns run from 0 to 1.

    `lit` returns the radiance of facets from a BRDF, the slopes of all points, and a mask of the points to compute.
    """
    size = len(textures.albedo)
    at = tuple(np.minimum((each * size).astype(int), size - 1) for each in (rows, columns))
    everywhere = np.ones(rows.shape, dtype=bool)
    radiance = textures.albedo[at] * lit(brdf, textures.slope[at], everywhere).reshape(*rows.shape, 3)
    if flakes is not None:
        slope, covered = flakes.normal[at][..., :2] / flakes.normal[at][..., 2:], flakes.mask[at]
        radiance[covered] += flakes.share * (lit(flakes.facet, slope, covered) - radiance[covered])
    return radiance


def _lit_ball(brdf: EvaluableBRDF) -> Array:
    """Render a distant ball in the studio light: linear sRGB, top row first, padded with its edge."""
    ball = ball_colours.ball(_BALL_PIXELS, *ball_colours.DRAWN)
    column, row = ((0.5 + 0.5 * ball.places * [1.0, -1.0]) * _BALL_PIXELS).astype(int).T
    image, inside = np.zeros((_BALL_PIXELS, _BALL_PIXELS, 3)), np.zeros((_BALL_PIXELS, _BALL_PIXELS), bool)
    for first in range(0, len(row), _BLOCK):
        pixels = slice(first, first + _BLOCK)
        part = ball.of_pixels(pixels)
        image[row[pixels], column[pixels]] = to_srgb(part.of(brdf.eval(part.wi, part.wo)), brdf.bands)
    inside[row, column] = True
    nearest = distance_transform_edt(~inside, return_distances=False, return_indices=True)
    return np.asarray(image[tuple(nearest)])


def _interpolated(table: Array, at: Array) -> Array:
    """Return bilinear values of a table (R, C, 3) at columns and rows (..., 2)."""
    where = np.moveaxis(at, -1, 0)[::-1]
    channels = np.moveaxis(table, -1, 0)
    return np.stack([map_coordinates(each, where, order=1, mode="nearest") for each in channels], axis=-1)


def material_of(
    mi: Any, mean: Path, normal: Array, changes: Array, flakes: DrawnFlakes | None = None,
    repeats: tuple[float, float] = (1.0, -1.0),
) -> dict[str, Any]:  # fmt: skip
    """Return the surface as a Mitsuba dictionary.

    Args:
        mi: Mitsuba.
        mean: path of the file of the mean BRDF.
        normal: unit normals, shape (S, S, 3).
        changes: factors of the colours, see `spectral_changes`, shape (S, S, 3).
        flakes: drawn flakes, or None.
        repeats: repetitions of the textures along u and v; v is negative for rectangles, whose v runs upwards.
    """
    nested = {"type": "measured", "filename": str(mean)}
    changed = {"type": bsdf.NAME, "changes": _bitmap(mi, changes, repeats), "nested": nested}
    material = {"type": "normalmap", "normalmap": _bitmap(mi, 0.5 + 0.5 * normal, repeats), "bsdf": changed}
    return material if flakes is None else with_flakes(mi, material, flakes, repeats)


def with_flakes(
    mi: Any, material: Mapping[str, Any], flakes: DrawnFlakes, repeats: tuple[float, float]
) -> dict[str, Any]:
    """Return a material with flakes as a Mitsuba dictionary; for `repeats` see `material_of`."""
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
