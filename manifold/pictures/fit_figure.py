"""One figure per fit: the material beside the fit, their difference, and slices of both."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from manifold.core.records import Array, Mask
from manifold.pictures.figures import LARGEST_DELTA_E, in_lines, new_figure
from manifold.pictures.slice_figures import INCIDENCES_DEG, ShownBRDF, draw_slices


def fit_picture(
    title: str,
    balls: Sequence[Array],
    delta_e: Array,
    flip: Array,
    inside: Mask,
    sources: Sequence[ShownBRDF],
    light: str,
) -> Figure:
    """Draw the check of a fit: display pictures (H, W, 3), slices of material and fit, and maps of their difference.

    `light` is the light's name, CIEDE2000 and FLIP are (H, W). The means in the titles are over the pixels
    `inside` the ball, (H, W).
    """
    figure = new_figure(11, 9.6)
    figure.suptitle(in_lines(title, 100), fontsize=12)
    parts: Any = figure.subfigures(2, 1, height_ratios=(1.0, 2.15))
    upper, lower = parts
    axes = upper.subplots(1, 4)
    for axis, picture, source in zip(axes, balls, sources, strict=False):
        axis.imshow(np.clip(picture, 0.0, 1.0), interpolation="antialiased")
        axis.set_title(in_lines(source.label, 32), fontsize=10)
    maps = (
        (delta_e, LARGEST_DELTA_E, f"CIEDE2000 ({light}), mean {delta_e[inside].mean():.2f}"),
        (flip, 1.0, f"FLIP, mean {flip[inside].mean():.3f}"),
    )
    for axis, (values, largest, name) in zip(axes[2:], maps, strict=True):
        shown = axis.imshow(
            np.where(inside, values, 0.0), cmap="magma", vmin=0.0, vmax=largest, interpolation="nearest"
        )
        axis.set_title(name, fontsize=10)
        upper.colorbar(shown, ax=axis, fraction=0.046).ax.tick_params(labelsize=8)
    for axis in axes:
        axis.set_axis_off()
    grid = lower.subplots(3, len(INCIDENCES_DEG), sharex=True, sharey="row", squeeze=False)
    draw_slices(lower, grid, sources)
    return figure
