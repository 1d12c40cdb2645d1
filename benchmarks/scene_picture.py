"""A vase in a room with two lamps: measured, predicted from the other materials, and the difference of both.

    python benchmarks/scene_picture.py FOLDER docs/images/scene.png NAME ...

FOLDER holds `.bsdf` files in RGB. Each material NAME is located on the map of all others, which predicts it. Mitsuba
renders both files with the same seed. Shown in docs/explanation/accuracy.md.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from left_out import Given, predict

import manifold as mf
from manifold.brdf import goniometer
from manifold.colour.lights import environment
from manifold.core.records import Array
from manifold.model import brdf_errors
from manifold.model.prediction import ClippedBRDF
from manifold.render import backend, images, scenes
from manifold.render.render import RenderSettings, render_scene, rgb_film

SIZE, SAMPLES = 220, 800
LARGEST = 15.0  # CIEDE2000 at the end of the colour bar
HEIGHT = 2.3  # of the vase
LAMPS = {  # centre, radius, radiance
    "lamp on the left": ((-3.2, -2.6, 3.6), 0.35, (26.0, 22.0, 17.0)),
    "lamp on the right": ((3.4, 0.6, 2.6), 0.3, (11.0, 14.0, 19.0)),
}


def vase(n_heights: int = 160, n_azimuths: int = 240) -> tuple[Array, Array]:
    """Return a surface of revolution with a belly, a neck and a lip: vertices (V, 3) and triangles (T, 3)."""
    z = np.linspace(0.0, 1.0, n_heights)
    radius = np.interp(z, [0.0, 1.0], [0.42, 0.46]) + 0.5 * np.sin(np.pi * z**0.9) ** 2 * (1.0 - 0.55 * z)
    radius += 0.16 * np.maximum(z - 0.82, 0.0) / 0.18 - 0.2 * np.exp(-(((z - 0.8) / 0.12) ** 2))
    azimuth = 2.0 * np.pi * np.arange(n_azimuths) / n_azimuths
    rings = np.stack(
        [
            radius[:, None] * np.cos(azimuth),
            radius[:, None] * np.sin(azimuth),
            np.broadcast_to(HEIGHT * z[:, None], (n_heights, n_azimuths)),
        ],
        axis=-1,
    )
    ring, k = np.meshgrid(np.arange(n_heights - 1), np.arange(n_azimuths), indexing="ij")
    a, b = ring * n_azimuths + k, ring * n_azimuths + (k + 1) % n_azimuths
    sides = np.stack([a, b, b + n_azimuths, a, b + n_azimuths, a + n_azimuths], axis=-1)
    return rings.reshape(-1, 3).astype(np.float32), sides.reshape(-1, 3).astype(np.uint32)


def sensor(mi: Any) -> dict[str, Any]:
    """Return the camera, slightly above the vase."""
    return {
        "type": "perspective",
        "fov": 25.0,
        "to_world": mi.ScalarTransform4f().look_at([0.0, -7.0, 2.6], [0.0, 0.0, 1.1], [0, 0, 1]),
        "film": rgb_film(SIZE),
        "sampler": {"type": "multijitter"},
    }


def scene(mi: Any, file: Path) -> dict[str, Any]:
    """Return the scene with a material on the vase."""
    turn = mi.ScalarTransform4f()
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.3}}
    lamps = {
        name: {
            "type": "sphere",
            "center": list(centre),
            "radius": radius,
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": list(radiance)}},
        }
        for name, (centre, radius, radiance) in LAMPS.items()
    }
    material = {"type": "twosided", "material": {"type": "measured", "filename": str(file)}}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 6},
        "sensor": sensor(mi),
        "room": {
            "type": "envmap",
            "bitmap": mi.Bitmap(environment("room", 256)),
            "scale": 0.6,
            "to_world": turn.rotate([1, 0, 0], 90),
        },
        "floor": {"type": "disk", "to_world": turn.scale([60.0, 60.0, 1.0]), "bsdf": grey},
        "vase": scenes.mesh(mi, *vase(), bsdf=material),
        **lamps,
    }


def coverage(mi: Any) -> Array:
    """Return whether pixels show the vase, shape (SIZE, SIZE)."""
    glowing = scenes.mesh(
        mi, *vase(), emitter={"type": "area", "radiance": {"type": "rgb", "value": 1.0}}, flip_normals=False
    )
    alone = {"type": "scene", "integrator": {"type": "direct"}, "sensor": sensor(mi), "vase": glowing}
    return np.array(mi.render(mi.load_dict(alone), spp=16)).max(axis=-1) > 0.99


def main() -> None:
    """Draw a row for each material."""
    given = Given.parse(__doc__)
    mi = backend.mitsuba("rgb")
    settings = RenderSettings(SIZE, SAMPLES)
    count = len(given.names)
    figure, axes = plt.subplots(count, 3, figsize=(9.6, 3.1 * count), squeeze=False, layout="constrained")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        mf.import_files(folder / "library.zarr", list(given.paths.values()))
        shows_vase = coverage(mi)
        for row, name in zip(axes, given.names, strict=True):
            measured = mf.MeasuredBRDF(mf.read_bsdf(given.paths[name]))
            _, predicted = predict(folder / "library.zarr", measured, name)
            file = folder / f"{name}_rgb.bsdf"
            mf.write_bsdf(file, goniometer.measure(ClippedBRDF(predicted), name))
            pictures = [
                images.tone_map(render_scene(mi, mi.load_dict(scene(mi, each)), settings))
                for each in (given.paths[name], file)
            ]
            difference = images.ciede2000_map(*pictures)
            off, ball = difference[shows_vase].mean(), brdf_errors(measured, predicted).ball
            flip = images.flip_map(*pictures)[shows_vase].mean()
            print(f"{name}: {off:.2f} and FLIP {flip:.3f} on the vase, {ball:.2f} on the ball", flush=True)
            for axis, picture in zip(row, pictures, strict=False):
                axis.imshow(np.clip(picture, 0.0, 1.0))
            shown = row[2].imshow(difference, cmap="magma", vmin=0.0, vmax=LARGEST)
            row[0].set_ylabel(name.replace("_", " "))
            row[1].set_xlabel(f"ball error {ball:.1f}")
            row[2].set_xlabel(f"CIEDE2000 {off:.1f}, FLIP {flip:.3f}")
    for axis in axes.flat:
        axis.set_xticks([])
        axis.set_yticks([])
    for axis, title in zip(axes[0], ("measured", "predicted", "difference"), strict=True):
        axis.set_title(title)
    figure.colorbar(shown, ax=axes[:, 2], label="CIEDE2000", extend="max", shrink=0.8)
    figure.savefig(given.output, dpi=74)


if __name__ == "__main__":
    main()
