"""Draws balls of a material beside its exports, with their errors, computed by quadrature."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from manifold.brdf.interface import EvaluableBRDF
from manifold.brdf.notebook import ball_image, sun_image
from manifold.colour.panel import SUN_DEG
from manifold.core.records import Array, Mask
from manifold.pictures import figures

_PIXELS = 112
_MARGIN = 0.05  # around a ball, in its diameters
_INCHES = 1.6  # a side of a ball


class SheetColumn(NamedTuple):
    """One column of the sheet: a material or one of its exports, and the text below its balls."""

    label: str
    brdf: EvaluableBRDF
    words: str = ""


def framed(shown: Array, inside: Mask) -> tuple[Array, Mask]:
    """Return a ball's display values (H, H, 3) with a smooth edge and a margin, both on white, and the padded mask."""
    size = len(shown)
    across = np.arange(size) + 0.5 - 0.5 * size
    cover = np.clip(0.5 * size - np.hypot(across, across[:, None]), 0.0, 1.0)
    pad = round(_MARGIN * size)
    image = np.pad(
        1.0 + cover[..., None] * (shown - 1.0), ((pad, pad), (pad, pad), (0, 0)), constant_values=1.0
    )
    return image, np.pad(inside, pad)


def draw(title: str, columns: Sequence[SheetColumn], path: Path) -> None:
    """Draw a column of two balls for each BRDF: in the studio, and under a sun beside the view."""
    lights: dict[str, Callable[[EvaluableBRDF], tuple[Array, Mask]]] = {
        "studio": partial(ball_image, size=_PIXELS),
        f"sun {SUN_DEG:.0f} degrees from the view": partial(sun_image, size=_PIXELS, degrees=SUN_DEG),
    }
    figure = figures.new_figure(_INCHES * len(columns) + 0.3, _INCHES * len(lights) + 0.9)
    figure.suptitle(figures.in_lines(title, 24 * len(columns)), fontsize=9)
    axes = figure.subplots(len(lights), len(columns), squeeze=False)
    for row, (light, picture) in zip(axes, lights.items(), strict=True):
        for axis, column in zip(row, columns, strict=True):
            axis.imshow(np.clip(framed(*picture(column.brdf))[0], 0.0, 1.0), interpolation="bilinear")
            axis.set(xticks=[], yticks=[])
            axis.spines[:].set_visible(False)
        row[0].set_ylabel(light, fontsize=7)
    for top, bottom, column in zip(axes[0], axes[-1], columns, strict=True):
        top.set_title(figures.in_lines(column.label, 20), fontsize=8)
        bottom.set_xlabel(column.words, fontsize=7)
    figures.save(figure, path)
