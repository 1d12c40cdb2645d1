"""Draws two pictures side by side with maps of their difference."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from manifold.core.records import Array, Mask
from manifold.pictures.figures import LARGEST_DELTA_E, in_lines, new_figure


def comparison(
    display_a: Array,
    display_b: Array,
    delta_e: Array,
    flip: Array,
    titles: tuple[str, str],
    light: str,
    within: Mask | None = None,
) -> Figure:
    """Draw two display pictures (H, W, 3) above their CIEDE2000 and FLIP maps (H, W); `light` names the light.

    Means are taken over the pixels of the mask `within`, usually the ball, so that they describe only the materials.
    """
    height, width = delta_e.shape
    figure = new_figure(8.6, 0.6 + 8.0 * height / width)
    axes = figure.subplots(2, 2)
    for axis, picture, title in zip(axes[0], (display_a, display_b), titles, strict=True):
        axis.imshow(np.clip(picture, 0.0, 1.0), interpolation="nearest")
        axis.set_title(in_lines(title, 44), fontsize=10)
    scale = min(LARGEST_DELTA_E, max(1.0, float(delta_e.max())))
    where = "picture" if within is None else "ball"
    means = [float(np.mean(values if within is None else values[within])) for values in (delta_e, flip)]
    maps = (
        (delta_e, scale, f"CIEDE2000 ({light}), mean over the {where} {means[0]:.2f}"),
        (flip, max(0.05, min(1.0, float(flip.max()))), f"FLIP, mean over the {where} {means[1]:.3f}"),
    )
    for axis, (values, largest, title) in zip(axes[1], maps, strict=True):
        shown = axis.imshow(values, cmap="magma", vmin=0.0, vmax=largest, interpolation="nearest")
        axis.set_title(title, fontsize=10)
        bar = figure.colorbar(
            shown, ax=axis, fraction=0.046, extend="max" if values.max() > largest else "neither"
        )
        bar.ax.tick_params(labelsize=8)
    for axis in axes.flat:
        axis.set_axis_off()
    return figure
