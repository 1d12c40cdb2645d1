"""A pack of exports: an index page of balls, what was measured beside what is exported, with the differences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from manifold.brdf.measured import EvaluableBRDF
from manifold.brdf.notebook import ball_image, sun_image
from manifold.colour.panel import JUDGED
from manifold.plots import html_page
from manifold.render import images

INDEX = "index.html"
BALLS = "balls"
"""The folder of the pictures of balls."""

_SIZE, _SUN_DEG = 64, 45.0
_RINGS, _SPOKES = 32, 32  # of a ball in the studio: fewer leave streaks on matt materials


def write_balls(path: Path, material: EvaluableBRDF, exported: EvaluableBRDF) -> None:
    """Draw four balls side by side: the material and its export in the studio, then both under a sun."""
    parts = []
    draws = (
        partial(ball_image, size=_SIZE, rings=_RINGS, spokes=_SPOKES),
        partial(sun_image, size=_SIZE, degrees=_SUN_DEG),
    )
    for draw in draws:
        for brdf in (material, exported):
            shown, inside = draw(brdf)
            parts.append(np.where(inside[..., None], shown, 0.12))
    path.parent.mkdir(parents=True, exist_ok=True)
    images.write_display(path, np.concatenate(parts, axis=1))


def write_index(folder: Path, title: str, made: Sequence[tuple[str, Path, Mapping[str, Any]]]) -> Path:
    """The page of a folder of exports.

    Args:
        folder: where the files and their balls are.
        title: of the page.
        made: name, file and content of every export.
    """
    cards = []
    for name, file, content in made:
        errors = content["errors"]
        words = f"{errors['ball']:.1f}, in {errors['worst_light']} {errors['worst']:.1f}"
        cards.append(html_page.card(f"{BALLS}/{name}.png", f"balls of {name}", file.name, name, words))
    intro = (
        "Each picture: measured, exported; measured, exported. Left in the studio, right under a sun "
        f"{_SUN_DEG:.0f} degrees beside the view. CIEDE2000 of the ball between the two, in the mean of {len(JUDGED)} "
        "lights that the fit did not see, and in the worst."
    )
    path = folder / INDEX
    html_page.write(path, title, intro, f"<main>{''.join(cards)}</main>")
    return path
