"""Draws a budget: both renderings of the scene, and the cost of every representation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter

from manifold.core.records import Array
from manifold.pictures.figures import in_lines, new_figure

_LEAST, _MOST_DELTA_E = 0.02, 40.0  # ends of the axis of differences
_BLUE, _ORANGE, _GREY = "#0072b2", "#d55e00", "#7f7f7f"  # distinguishable for colour-blind readers
_UNITS = ((1e6, "MB"), (1e3, "kB"), (1.0, "B"))


def budget_figure(
    whole: Array, chosen: Array, delta_e: Array, materials: Sequence[Mapping[str, Any]], tolerance: float
) -> Figure:
    """Draw renderings (H, W, 3) of the scene with the whole and the chosen files, and their CIEDE2000 (H, W).

    One row per material below shows the costs of its representations, from the plain values of `Chosen`, and the
    tolerance in CIEDE2000.
    """
    height = 8.6 / 3.0 * delta_e.shape[0] / delta_e.shape[1]
    figure = new_figure(8.6, height + 0.5 + 2.7 * len(materials))
    parts = figure.subfigures(2, 1, height_ratios=(height + 0.5, 2.7 * len(materials)), squeeze=False)
    above, below = parts[:, 0]
    left, middle, right = above.subplots(1, 3)
    total = sum(one["size"] for one in materials)
    for axis, picture, title in (
        (left, whole, f"whole files, {_bytes(sum(one['full_size'] for one in materials))}"),
        (middle, chosen, f"chosen, {_bytes(total)}"),
    ):
        axis.imshow(np.clip(picture, 0.0, 1.0), interpolation="nearest")
        axis.set_title(title, fontsize=10)
    shown = right.imshow(
        delta_e, cmap="magma", vmin=0.0, vmax=max(2.0 * tolerance, 1.0), interpolation="nearest"
    )
    right.set_title(f"CIEDE2000 in the scene's light, mean {delta_e.mean():.2f} with noise", fontsize=10)
    above.colorbar(shown, ax=right, fraction=0.046, extend="max").ax.tick_params(labelsize=8)
    for axis in (left, middle, right):
        axis.set_axis_off()
    for axis, material in zip(np.atleast_1d(below.subplots(len(materials), 1)), materials, strict=True):
        _costs(axis, material, tolerance)
    return figure


def _costs(axis: Axes, material: Mapping[str, Any], tolerance: float) -> None:
    candidates = material["candidates"]
    sizes = np.array([one["bytes"] for one in candidates], float)
    predicted = np.array([one["predicted"] for one in candidates])
    axis.axhspan(_LEAST, tolerance, color=_BLUE, alpha=0.08, lw=0)
    axis.axhline(tolerance, color=_BLUE, lw=1, label=f"tolerance {tolerance:g}")
    axis.plot(sizes, _inside(predicted), "o", mfc="none", color=_GREY, ms=5, label="predicted")
    rendered = [one for one in candidates if one["verified"] is not None]
    found = _inside(np.array([one["verified"]["delta_e"] for one in rendered]))
    axis.plot([one["bytes"] for one in rendered], found, "o", color=_BLUE, ms=6, label="rendered")
    (k,) = (i for i, one in enumerate(rendered) if one["name"] == material["representation"])
    axis.plot(rendered[k]["bytes"], found[k], "*", color=_ORANGE, ms=15, label="chosen")
    axis.annotate(
        f"{material['representation']}, {_bytes(rendered[k]['bytes'])}",
        (rendered[k]["bytes"], found[k]), xytext=(8, -18 if found[k] > 5.0 * _LEAST else 10),
        textcoords="offset points", fontsize=9, path_effects=[withStroke(linewidth=2.5, foreground="white")],
        ha="left" if rendered[k]["bytes"] < np.sqrt(sizes.min() * sizes.max()) else "right",
    )  # fmt: skip
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_ylim(_LEAST, _MOST_DELTA_E)
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: _bytes(value)))
    axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_title(in_lines(material["material"]), fontsize=10)
    axis.set_xlabel("size")
    axis.set_ylabel("CIEDE2000 in the scene's light")
    axis.grid(alpha=0.25)
    axis.legend(fontsize=8, loc="upper right", framealpha=0.9)


def _inside(values: Array) -> Array:
    return np.clip(values, _LEAST * 1.3, _MOST_DELTA_E / 1.3)


def _bytes(value: float) -> str:
    unit, name = next((u, n) for u, n in _UNITS if value >= u or u == 1.0)
    return f"{value / unit:.3g} {name}"
