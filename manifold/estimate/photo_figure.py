"""Photographs beside what was found in them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from manifold.colour.conversion import encode_srgb
from manifold.plots.figures import new_figure
from manifold.records import Array

_LARGEST_ERROR = 10.0  # CIEDE2000 of the brightest colour


def residual_figure(
    names: Sequence[str], seen: Sequence[Array], predicted: Sequence[Array], errors: Sequence[Array]
) -> Figure:
    """A row for every photograph: as it was taken, as it is predicted, and the difference.

    Args:
        names: of the photographs.
        seen, predicted: linear sRGB, shape (H, W, 3).
        errors: CIEDE2000, NaN where nothing was compared, shape (H, W).
    """
    figure = new_figure(9.0, 3.1 * len(names))
    axes = figure.subplots(len(names), 3, squeeze=False)
    for row, name, photograph, prediction, error in zip(axes, names, seen, predicted, errors, strict=True):
        for axis, picture in zip(row[:2], (photograph, prediction), strict=True):
            axis.imshow(encode_srgb(np.nan_to_num(picture)), interpolation="nearest")
        shown = row[2].imshow(error, cmap="magma", vmin=0.0, vmax=_LARGEST_ERROR, interpolation="nearest")
        figure.colorbar(shown, ax=row[2], shrink=0.8, extend="max")
        titles = name, "predicted", f"CIEDE2000, mean {np.nanmean(error):.1f}"
        for axis, title in zip(row, titles, strict=True):
            axis.set_title(title, fontsize=9)
            axis.set_axis_off()
    return figure
