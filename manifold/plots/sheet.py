"""Contact sheets: the balls of many materials, each over its name."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.patches import Circle

from manifold.plots.figures import in_lines, new_figure

_WIDTH, _HEIGHT = 1.15, 1.6  # of a cell, in inches
_MOST_COLUMNS = 16
_LETTERS = 15  # of a line of a name


def contact_sheet(cells: Sequence[tuple[str, str, Path]], under: str | None = None) -> Figure:
    """Pictures side by side, from left to right and top to bottom; a grey circle where there is none.

    Args:
        cells: name, text below it, and picture of each.
        under: what the text below the names is.
    """
    columns = min(int(np.ceil(np.sqrt(1.5 * len(cells)))), _MOST_COLUMNS)
    rows = -(-len(cells) // columns)
    figure = new_figure(_WIDTH * columns, _HEIGHT * rows + 0.4 * (under is not None))
    if under is not None:
        figure.supxlabel(f"below the names: {under}", fontsize=8, color="0.3")
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in grid:
        axes.set_axis_off()
    for axes, (name, text, picture) in zip(grid, cells, strict=False):
        if picture.is_file():
            axes.imshow(imread(picture), interpolation="antialiased")
        else:
            axes.add_patch(Circle((0.5, 0.5), 0.5, fill=False, color="0.7", linestyle=":"))
            axes.set_aspect("equal")
        label = "\n".join(filter(None, (in_lines(name, _LETTERS), text)))
        axes.text(0.5, -0.03, label, transform=axes.transAxes, ha="center", va="top", fontsize=7)
    return figure
