"""A pack of exports: an index page of balls, what was measured beside what is exported, with the differences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from manifold import __version__, disk
from manifold.brdf.measured import EvaluableBRDF
from manifold.brdf.notebook import ball_image, sun_image
from manifold.colour.panel import JUDGED
from manifold.render import images

INDEX = "index.html"
BALLS = "balls"
"""The folder of the pictures of balls."""

_SIZE, _SUN_DEG = 64, 45.0
_RINGS, _SPOKES = 32, 32  # of a ball in the studio: fewer leave streaks on matt materials

_HEAD = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>{title}</title>
<style>
body {{ font: 15px/1.4 system-ui, sans-serif; margin: 2em auto; max-width: 70em; padding: 0 1em }}
body {{ color: #222; background: #eee }}
main {{ display: grid; grid-template-columns: repeat(auto-fill, minmax(18em, 1fr)); gap: 1em }}
figure {{ margin: 0; padding: .8em; background: #fff; border-radius: 6px }}
img {{ width: 100%; height: auto }}
figcaption {{ font-size: 13px }} figcaption b {{ font-size: 15px }}
</style></head><body>
<h1>{title}</h1>
<p>Each picture: measured, exported; measured, exported. Left in the studio, right under a sun {sun:.0f} degrees beside
the view. CIEDE2000 of the ball between the two, in the mean of {lights} lights that the fit did not see, and in the
worst. Made by manifold {version}.</p>
<main>
"""


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
    page = [_HEAD.format(title=escape(title), sun=_SUN_DEG, lights=len(JUDGED), version=__version__)]
    for name, file, content in made:
        ball, label = content["ball"], escape(name)
        page.append(
            f'<figure><img src="{BALLS}/{label}.png" alt="balls of {label}" width="{4 * _SIZE}" height="{_SIZE}" '
            f'loading="lazy"><figcaption><b><a href="{escape(file.name)}">{label}</a></b><br>'
            f"{ball['unseen_light']:.1f}, in {escape(ball['worst_light'])} {ball['worst']:.1f}</figcaption></figure>\n"
        )
    page.append("</main></body></html>\n")
    path = folder / INDEX
    disk.write_text(path, "".join(page))
    return path
