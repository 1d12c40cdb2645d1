"""Textured materials as engines draw them on a plane under suns, beside Mitsuba's renders of the same surfaces.

A surface is a measured file with colours and slopes at random: `textured`. A pixel of a picture is a texel.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from helpers.lamp_scene import under_lamp
from surface import surface_twins

from engines.balls import Light, Scene
from manifold.brdf.interface import EvaluableBRDF
from manifold.colour.conversion import encode_srgb, srgb_to_xyz
from manifold.colour.difference import delta_e_2000
from manifold.core.records import Array
from manifold.fit import exporting
from manifold.fit.exports.document import TextureFiles
from manifold.fit.exports.targets import Target
from manifold.render import backend, images
from manifold.render.render import RenderSettings, render_scene, rgb_film
from manifold.surface import bsdf, preview
from manifold.surface.lamp_pictures import in_plane
from manifold.surface.response import shaded

SIZE = 192  # pixels of a side, and texels
LAMPS = {f"sun {angle}": in_plane(angle) for angle in (60.0, 20.0, -50.0)}
"""Unit vectors towards the suns, z up, the plane's normal; rows of pictures run against y."""

PLANE = Scene(
    "plane", np.array([0.0, 0.0, 1.0]), SIZE, {name: Light(lamp) for name, lamp in LAMPS.items()}, 1
)

_SAMPLES = 16
_BLOCK = 2  # pixels of a side, whose means are compared: engines filter textures differently

Pictures = Mapping[str, Array]
"""Linear sRGB (SIZE, SIZE, 3) by sun, rows from above; a white diffuser that lies flat is 1."""


def textured() -> tuple[Array, Array]:
    """Colours relative to the mean, of mean 1, and unit normals, (SIZE, SIZE, 3) each; both repeat."""
    rng = np.random.default_rng(0)
    shades, hues = (surface_twins.rough(rng, (SIZE, SIZE), 3.0)[..., None] for _ in range(2))
    albedo = np.exp(0.15 * shades + 0.1 * hues * [1.0, 0.0, -1.0])
    height = surface_twins.rough(rng, (SIZE, SIZE), 3.0)
    slope = np.stack(
        [
            0.5 * (np.roll(height, 1, axis) - np.roll(height, -1, axis)) * sign
            for axis, sign in ((1, 1), (0, -1))
        ],
        axis=-1,
    )
    normal = np.concatenate([0.15 * slope / slope.std(), np.ones((SIZE, SIZE, 1))], axis=-1)
    return albedo / albedo.mean(axis=(0, 1)), normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def mitsuba(mean: Path) -> Pictures:
    """Mitsuba's renders of the measured file with the textures."""
    mi = backend.mitsuba("rgb")
    bsdf.register()
    albedo, normal = textured()
    plane = {"type": "rectangle", "material": preview.material_of(mi, mean, normal, albedo)}
    settings = RenderSettings(SIZE, _SAMPLES)
    return {
        name: render_scene(mi, mi.load_dict(under_lamp(mi, plane, lamp, film=rgb_film(SIZE))), settings)
        for name, lamp in LAMPS.items()
    }


def write(subject: exporting.Subject, target: Target, path: Path) -> dict[str, object]:
    """Export a material with the textures beside its file; what the export says."""
    albedo, normal = textured()
    normals = path.with_suffix(".normal.png")
    images.write_display(normals, 0.5 + 0.5 * normal)

    def textures(values: Mapping[str, Any]) -> TextureFiles:
        colours = path.with_suffix(".base.png")
        base = np.asarray(values[target.base_colour])
        images.write_display(colours, encode_srgb(np.clip(base * albedo, 0.0, 1.0)))
        return TextureFiles(colours, normals)

    return dict(exporting.export(subject, target, path, textures=textures).content or {})


def exposed(drawn: Pictures, white: Pictures) -> Pictures:
    """Pictures relative to that of a white diffuser under the same sun."""
    return {name: picture / white[name].mean() for name, picture in drawn.items()}


def differences(drawn: Pictures, true: Pictures, model: EvaluableBRDF) -> dict[str, dict[str, float]]:
    """How far drawn pictures are from the true ones, by sun.

    CIEDE2000 of the means, and in the median of blocks of pixels; ratio and correlation of shades, which tell whether
    normals lean as they should; CIEDE2000 of the mean from that of the exported model on the same slopes.
    """
    found = {}
    normal = textured()[1]
    for name, lamp in LAMPS.items():
        said = shaded(model, normal[..., :2] / normal[..., 2:], lamp, PLANE.view).mean(axis=(0, 1))
        made, known = (_blocks(each[name]) for each in (drawn, true))
        shades = [np.log(np.maximum(each.mean(axis=-1), 1e-4)).ravel() for each in (made, known)]
        found[name] = {
            "mean_from_model": float(_ciede2000(made.mean(axis=(0, 1)), said)),
            "mean": float(_ciede2000(made.mean(axis=(0, 1)), known.mean(axis=(0, 1)))),
            "block": float(np.median(_ciede2000(made, known))),
            "contrast": float(shades[0].std() / shades[1].std()),
            "correlation": float(np.corrcoef(*shades)[0, 1]),
        }
    return found


def summary(
    rows: Mapping[str, Mapping[str, Mapping[str, Mapping[str, float]]]],
) -> dict[str, dict[str, float]]:
    """Medians over materials and suns, and the least correlation, of every row."""
    found = {}
    for name, made in rows.items():
        each = [errors for suns in made.values() for errors in suns.values()]
        found[name] = {key: float(np.median([one[key] for one in each])) for key in each[0]}
        found[name]["least_correlation"] = min(one["correlation"] for one in each)
    return found


def _blocks(picture: Array) -> Array:
    side = SIZE // _BLOCK
    return np.asarray(picture.reshape(side, _BLOCK, side, _BLOCK, 3).mean(axis=(1, 3)))


def _ciede2000(made: Array, known: Array) -> Array:
    xyz, xyz_star = (srgb_to_xyz(np.clip(each, 0.0, 1.0)) for each in (made, known))
    return delta_e_2000(xyz, xyz_star, srgb_to_xyz(np.ones(3)))


def write_sheet(path: Path, rows: Mapping[str, Pictures]) -> None:
    """Draw a row of pictures for each source, a column for each sun."""
    path.parent.mkdir(parents=True, exist_ok=True)
    shown = [np.concatenate([pictures[name] for name in LAMPS], axis=1) for pictures in rows.values()]
    images.write_display(path, encode_srgb(np.clip(np.concatenate(shown), 0.0, 1.0)))
