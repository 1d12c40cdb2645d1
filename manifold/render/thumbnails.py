"""Renders small pictures of materials, cropped to the ball, for maps, walks and sheets; measured ones are cached."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import numpy as np

from manifold.brdf.interface import BRDF
from manifold.core import progress
from manifold.core.records import Array, BsdfFile
from manifold.model.manifold import Manifold
from manifold.render import backend, images, scenes
from manifold.render.ball import read_material, render_material
from manifold.render.render import RenderSettings

SIZE, SAMPLES = 96, 48
_OUTLINE = 4  # samples per pixel and axis of the ball's edge
_VERSION = "thumbnail-2"  # raise where scene, size or tone mapping change


@backend.variant_kept()
def of_materials(model: Manifold) -> list[Array]:
    """Return the materials of `model.pictured` as balls, RGBA in [0, 1], (H, W, 4); cached in the library."""
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
    """Render a material as a ball under the studio's light, RGBA in [0, 1], (H, W, 4), transparent around it."""
    return _drawn(partial(render_material, material))


def of_file(path: Path) -> Array:
    """Render a measured file, or the JSON of a fit, as a ball: RGBA in [0, 1], (H, W, 4)."""
    return _drawn(read_material(path).render)


def _drawn(render: Callable[[RenderSettings], Array]) -> Array:
    """Return a ball, transparent around it, that is equal in every run.

    With several threads, pixels that two of them share would differ by rounding.
    """
    backend.imported()
    with backend.one_thread():
        return _cut_out(render(_settings()))


def write(path: Path, image: Array) -> None:
    """Write a ball (H, W, 4) as PNG, transparent around it."""
    images.write_display(path, image)


def _settings() -> RenderSettings:
    opacity, (left, top) = _ball()
    height, width = opacity.shape
    return RenderSettings(size=SIZE, samples=SAMPLES, window=(left, top, width, height))


@cache
def _ball() -> tuple[Array, tuple[int, int]]:
    """Return the opacity of the ball in the smallest window that shows all of it (H, W), and its left and top."""
    fine = scenes.ball_interior(_OUTLINE * SIZE).astype(np.float64)
    opacity = fine.reshape(SIZE, _OUTLINE, SIZE, _OUTLINE).mean(axis=(1, 3))
    inside = np.argwhere(opacity > 0)
    (top, left), (bottom, right) = inside.min(axis=0), inside.max(axis=0) + 1
    return opacity[top:bottom, left:right], (int(left), int(top))


def _cut_out(linear: Array) -> Array:
    return np.dstack([images.tone_map(linear), _ball()[0]])
