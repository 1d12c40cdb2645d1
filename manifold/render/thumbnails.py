"""Small renders of materials for maps and walks: the ball alone, cropped from its scene; measured ones are cached."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from manifold import progress
from manifold.brdf.measured import BRDF
from manifold.model.manifold import Manifold
from manifold.records import Array, BsdfFile
from manifold.render import images, scenes
from manifold.render.ball import read_material, render_material
from manifold.render.render import RenderSettings

SIZE, SAMPLES = 96, 64
_OUTLINE = 4  # samples per pixel and axis of the ball's edge
_VERSION = "thumbnail-1"  # raise where scene, size or tone mapping change


def of_materials(model: Manifold) -> list[Array]:
    """The materials of `model.pictured` as balls, RGBA in [0, 1], (SIZE, SIZE, 4); cached in the library."""
    names = tuple(model.names[k] for k in model.pictured)
    key = hashlib.sha256(
        f"{_VERSION} {model.library.content_hash} {SIZE} {SAMPLES} {names}".encode()
    ).hexdigest()
    cached = model.library.cache_get(key)
    if cached is not None:
        return list(cached["images"].astype(np.float64))
    images = [of_material(model.library.read(name)) for name in progress.each(names, str)]
    model.library.cache_put(key, {"images": np.stack(images).astype(np.float32)})
    return images


def of_material(material: BRDF | BsdfFile) -> Array:
    """A material as a ball under the studio's light, RGBA in [0, 1], (SIZE, SIZE, 4)."""
    return _cut_out(render_material(material, RenderSettings(size=SIZE, samples=SAMPLES)))


def of_file(path: Path) -> Array:
    """The same of a measured file, or of the JSON of a fit."""
    return _cut_out(read_material(path).render(RenderSettings(size=SIZE, samples=SAMPLES)))


def write(path: Path, image: Array) -> None:
    """Write a ball (SIZE, SIZE, 4) as PNG, transparent around it."""
    images.write_display(path, cropped(image))


def _cut_out(linear: Array) -> Array:
    fine = scenes.ball_interior(_OUTLINE * SIZE).astype(np.float64)
    alpha = fine.reshape(SIZE, _OUTLINE, SIZE, _OUTLINE).mean(axis=(1, 3))
    return np.dstack([images.tone_map(linear), alpha])


def cropped(image: Array) -> Array:
    """The square around the ball of a thumbnail (SIZE, SIZE, 4)."""
    inside = np.argwhere(image[..., 3] > 0)
    (top, left), (bottom, right) = inside.min(axis=0), inside.max(axis=0) + 1
    return image[top:bottom, left:right]
