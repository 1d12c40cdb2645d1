"""Synthetic twins of surfaces and of the workbooks that show them, by the table of responses or rendered."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
from helpers.lamp_scene import under_lamp
from PIL import Image
from scipy.ndimage import gaussian_filter

from manifold.formats import ma_t12
from manifold.formats.readings import Readings, geometry_ma_t12
from manifold.render import backend
from manifold.render.render import RenderSettings, render_scene, rgb_film
from manifold.surface import preview
from manifold.surface.lamp_pictures import SurfacePictures, in_plane
from manifold.surface.response import Response

ANGLES_DEG = np.array([60.0, 45.0, 30.0, 0.0, -30.0, -65.0, np.nan])
CAPTIONS = ("15as-45", "15as-30", "15as-15", "15as15", "15as45", "15as80", "15d")
SIZE = (220, 260)
CAMERA = in_plane(-15.0)
BORDER = 4  # pixels


def rough(rng, size=SIZE, pixels=2.0):
    """A smooth random field of standard deviation 1."""
    field = gaussian_filter(rng.standard_normal(size), pixels, mode="wrap")
    return field / field.std()


def truth(rng, size=SIZE):
    """Heights with slopes of 0.1, and their slopes."""
    height = rough(rng, size, 2.5)
    slope = np.stack([-np.gradient(height, axis=1), np.gradient(height, axis=0)], axis=-1)
    scale = 0.1 / slope.std()
    return scale * height, scale * slope


def photographed(rng, slope, *, noise=0.01):
    """Pictures of a surface that answers as the table says."""
    lamps = in_plane(ANGLES_DEG)
    colour = np.array([0.5, 0.3, 0.2])
    albedo = np.exp(0.15 * rough(rng, slope.shape[:2]))[..., None] * np.array([1.0, 1.0, 1.0])
    factors = Response.of(lamps, np.broadcast_to(colour, (7, 3))).factors
    bright = colour * albedo * np.exp(np.einsum("jk,hwk->jhw", factors[:, :2], slope))[..., None]
    values = bright * np.exp(noise * rng.standard_normal(bright.shape))
    return SurfacePictures("twin", values, lamps, CAMERA, CAPTIONS, values.mean(axis=(1, 2))), albedo


def lamps_around(count, angle_deg):
    """Return lamps (J, 3) at one angle from the normal, at equal distances."""
    azimuth, angle = 0.3 + np.arange(count) * 2.0 * np.pi / count, np.deg2rad(angle_deg)
    across = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    return np.column_stack([np.sin(angle) * across, np.full(count, np.cos(angle))])


def matte(rng, slope, lamps, *, noise=0.0, albedo=None, strengths=1.0):
    """Pictures of a Lambertian surface from above, without shadows of one point on another."""
    normal = np.concatenate([slope, np.ones((*slope.shape[:2], 1))], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    lit = np.maximum(np.einsum("hwk,jk->jhw", normal, lamps), 0.0)[..., None]
    values = lit * (np.array([0.5, 0.3, 0.2]) if albedo is None else albedo)
    values = values * np.broadcast_to(strengths, len(lamps))[:, None, None, None]
    values = np.maximum(values * np.exp(noise * rng.standard_normal(values.shape)), 1e-4)
    unknown = np.full((len(lamps), 3), np.nan)
    return SurfacePictures("matte", values, lamps, np.array([0.0, 0.0, 1.0]), ("",) * len(lamps), unknown)


def workbook(path, rng, *, shift_px=0, factor=None):
    """A workbook with readings and pictures of one sample, as the instrument's program writes it."""
    _, slope = truth(rng, (240, 320))
    pictures, _ = photographed(rng, slope, noise=0.0)
    wi, wo = geometry_ma_t12()
    nm = np.arange(400.0, 701.0, 10.0)
    readings = Readings("twin", "MA-T12", wi, wo, nm, np.full((12, 31), 0.35 / np.pi))
    images = {}
    for j, (caption, values) in enumerate(zip(CAPTIONS, pictures.values, strict=True)):
        grey = np.repeat(
            values[..., :1] / values[..., 0].mean() * 0.35 * (1.0 if factor is None else factor[j]),
            3,
            axis=-1,
        )
        grey[..., 0] = np.roll(grey[..., 0], -shift_px, axis=0)
        stream = io.BytesIO()
        Image.fromarray(np.round(255.0 * np.clip(grey, 0.0, 1.0)).astype(np.uint8)).save(stream, "PNG")
        images[caption] = stream.getvalue()
    ma_t12.write(
        path,
        replace(
            readings,
            texture={"values": [{"Name": "twin", "Geometry": "15d", "Graininess": 3.5}], "images": images},
        ),
    )
    return slope


def rendered(rng, bsdf, height, reflectance, *, flakes=None, samples=16, noise=0.005):
    """Pictures of a relief, as Mitsuba renders them in the instrument's geometry: with shadows and interreflections.

    Args:
        rng: of the noise.
        bsdf: makes Mitsuba's dictionary of a texture of reflectance.
        height: in pixels, shape (S, S).
        reflectance: linear sRGB, shape (S, S, 3).
        flakes: as drawn; None for none.
        samples: light paths per pixel.
        noise: standard deviation of ln N, of the camera.
    Returns:
        SurfacePictures without their border, which the sky lights from below.
    """
    mi = backend.mitsuba("rgb")
    size = len(height)

    texture = {
        "type": "bitmap",
        "bitmap": mi.Bitmap(reflectance.astype(np.float32)),
        "raw": True,
        "wrap_mode": "clamp",
    }
    material = bsdf(texture)
    if flakes is not None:
        material = preview.with_flakes(mi, material, flakes, (1.0, 1.0))
    relief = _mesh(mi, height, material)
    lamps = in_plane(ANGLES_DEG)
    settings = RenderSettings(size=size, samples=samples)
    scenes = [mi.load_dict(under_lamp(mi, relief, lamp, CAMERA, rgb_film(size), 3)) for lamp in lamps]
    values = np.stack([render_scene(mi, scene, settings) for scene in scenes])[
        :, BORDER:-BORDER, BORDER:-BORDER
    ]
    values = np.maximum(values * np.exp(noise * rng.standard_normal(values.shape)), 0.002)
    means = np.where(np.isnan(lamps[:, :1]), np.nan, values.mean(axis=(1, 2)))
    return SurfacePictures("rendered", values, lamps, CAMERA, CAPTIONS, means)


def _mesh(mi, height, material):
    """A relief over [-1, 1] squared, a vertex a pixel."""
    size = len(height)
    rows, columns = np.mgrid[:size, :size]
    at = (np.stack([columns, rows], axis=-1) + 0.5) / size
    vertices = np.stack([2.0 * at[..., 0] - 1.0, 1.0 - 2.0 * at[..., 1], 2.0 * height / size], axis=-1)
    down, right = np.gradient(height)
    first = (rows * size + columns)[:-1, :-1].ravel()
    lower = np.stack([first, first + size, first + size + 1], axis=-1)
    upper = np.stack([first, first + size + 1, first + 1], axis=-1)
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(material)
    mesh = mi.Mesh("relief", size**2, 2 * len(first), properties, True, True)
    parameters = mi.traverse(mesh)
    normals = np.stack([-right, down, np.ones_like(height)], axis=-1)
    for key, values in {
        "vertex_positions": vertices.astype(np.float32),
        "vertex_normals": (normals / np.linalg.norm(normals, axis=-1, keepdims=True)).astype(np.float32),
        "vertex_texcoords": at.astype(np.float32),
        "faces": np.concatenate([lower, upper]).astype(np.uint32),
    }.items():
        parameters[key] = values.ravel()
    parameters.update()
    return mesh
