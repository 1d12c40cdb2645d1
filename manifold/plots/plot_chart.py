"""The chart of speed against accuracy: three errors against three costs, with named Pareto fronts."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import LogFormatterSciNotation, LogLocator, NullFormatter, NullLocator

from manifold.experiments.chart.experiment import COSTS, ERRORS, Chart, ChartRow, cost_of
from manifold.experiments.chart.fits import FAMILY
from manifold.experiments.chart.registry import AS_PUBLISHED, BLENDS, NONNEGATIVE, PUBLISHED
from manifold.plots.figures import Box, cheapest_place, new_figure, outside, overlap
from manifold.records import Array

_ERRORS = ("delta_e", "cube_root_error", "relative_error")
_COSTS = {
    "predict": "time to predict a material (reference times)",
    "bytes": "bytes kept",
    "fit": "time to fit the library (reference times)",
}


@dataclass(frozen=True)
class _Look:
    """Colour and marker of a family: colours of Okabe and Ito, distinguishable with any colour vision."""

    marker: str
    colour: str


LOOKS = {
    "one or two materials": _Look("D", "#cc79a7"),
    "PCA": _Look("o", "#0072b2"),
    "GPLVM, whole materials": _Look("s", "#e69f00"),
    "GPLVM, monochrome samples": _Look("^", "#009e73"),
    BLENDS: _Look("P", "#000000"),
    NONNEGATIVE: _Look("v", "#56b4e9"),
    AS_PUBLISHED: _Look("*", "#d55e00"),
    FAMILY: _Look("x", "#555555"),
}
_FRONT_POINTS, _OTHER_POINTS, _PUBLISHED_POINTS = 8.5, 5.0, 15.0
_LABEL = 8.8
_LEAST_ERROR = 1e-4  # smaller ones are drawn here
_DRAWN = 1.07  # text with an outline is drawn without hints, wider than measured


def chart(made: Chart) -> Figure:
    """Errors against costs. Filled and joined: on the front; pale and small: dominated; crosses saw the material."""
    figure = new_figure(15.0, 12.4)
    kind = "RGB" if made.n_bands == 3 else f"{made.n_bands} bands"
    figure.suptitle(
        f"Speed against accuracy: {made.n_materials} materials, {kind}, each left out once; below and left is better",
        fontsize=12.5,
    )
    grid = figure.subplots(len(COSTS), len(_ERRORS), sharex="row", sharey="col", squeeze=False)
    for axis_row, cost in zip(grid, COSTS, strict=True):
        for axes, error in zip(axis_row, _ERRORS, strict=True):
            _points(axes, made, error, cost)
            axes.set_xlabel(_COSTS[cost])
        costs = [cost_of(row, cost) for row in _with(made, cost)]
        _widen(axis_row[0], costs)
        if costs and max(costs) < 30.0 * min(costs):
            _number_ticks(axis_row[0].xaxis, axis_row[0].get_xlim())
    for axes, error in zip(grid[0], _ERRORS, strict=True):
        axes.set_title(f"{ERRORS[error]}, median", fontsize=11)
        _error_ticks(axes, [_error_of(row, error) for row in made.rows])
    figure.legend(handles=_legend(made), loc="outside lower center", ncols=3, fontsize=9.5, frameon=False)
    figure.draw_without_rendering()  # fixes the layout, so that points have their final pixels
    figure.set_layout_engine("none")
    for axis_row, cost in zip(grid, COSTS, strict=True):
        for axes, error in zip(axis_row, _ERRORS, strict=True):
            _name(figure, axes, made, error, cost)
    return figure


def _points(axes: Axes, made: Chart, error: str, cost: str) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.margins(0.09, 0.09)
    axes.grid(True, color="0.92", linewidth=0.8)
    axes.set_axisbelow(True)
    front = made.front(error, cost)
    on = {row.key for row in front}
    if front:
        x, y = _stairs([(cost_of(row, cost), _error_of(row, error)) for row in front])
        axes.plot(x, y, color="0.25", linewidth=1.3, zorder=2, label="front")
    for row in _with(made, cost):
        look = LOOKS[row.family]
        size = (
            _PUBLISHED_POINTS if row.key == PUBLISHED else _FRONT_POINTS if row.key in on else _OTHER_POINTS
        )
        is_plain = row.key in on or row.key == PUBLISHED
        is_cross = look.marker == "x"
        axes.plot(
            cost_of(row, cost), _error_of(row, error), look.marker, markersize=size, color=look.colour,
            markerfacecolor=look.colour if is_plain else "white",
            markeredgecolor="black" if is_plain and not is_cross else look.colour,
            alpha=1.0 if is_plain or is_cross else 0.6, zorder=4 if is_plain else 3, gid=row.key,
        )  # fmt: skip


def _error_of(row: ChartRow, error: str) -> float:
    """An error as it is drawn: copies of a material are found without one, and logarithms have no zero."""
    return max(float(getattr(row, error)), _LEAST_ERROR)


def _with(made: Chart, cost: str) -> list[ChartRow]:
    """The settings whose cost is known."""
    return [row for row in made.rows if np.isfinite(cost_of(row, cost))]


def _stairs(corners: Sequence[tuple[float, float]]) -> tuple[Array, Array]:
    """The edge of what a front dominates, from the cheapest to the dearest corner; within tolerance it may rise."""
    x, y = np.array(corners).T
    return np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1]


def _widen(axes: Axes, costs: Sequence[float]) -> None:
    """Room for the numbers of an axis whose costs hardly differ."""
    if costs and max(costs) < 2.0 * min(costs):
        middle = float(np.sqrt(min(costs) * max(costs)))
        axes.set_xlim(0.5 * middle, 2.0 * middle)


def _error_ticks(axes: Axes, values: Sequence[float]) -> None:
    """Numbers where the errors span less than three decades."""
    if max(values) / min(values) < 1e3:
        _number_ticks(axes.yaxis, values)
    else:
        axes.yaxis.set_major_formatter(LogFormatterSciNotation())
        axes.yaxis.set_minor_formatter(NullFormatter())


def _number_ticks(axis: Axis, values: Sequence[float]) -> None:
    """Numbers at 1, 2 and 5, and between them where the values span less than a decade."""
    is_short = max(values) < 10.0 * min(values)
    axis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0, 7.0) if is_short else (1.0, 2.0, 5.0)))
    axis.set_major_formatter(lambda value, _: f"{value:g}" if value < 1e5 else f"{value / 1e6:g}M")
    axis.set_minor_locator(NullLocator())


def _legend(made: Chart) -> list[Line2D]:
    present = {row.family for row in made.rows}
    handles = [
        Line2D([], [], linestyle="", marker=look.marker, color=look.colour, markersize=8, label=family)
        for family, look in LOOKS.items()
        if family in present
    ]
    return [
        *handles,
        Line2D([], [], color="0.25", marker="s", markerfacecolor="0.6", label="Pareto front, named"),
        Line2D([], [], color="0.6", linestyle="", marker="s", markerfacecolor="white", label="on no front"),
    ]


def _name(figure: Figure, axes: Axes, made: Chart, error: str, cost: str) -> None:
    """Write the names of the front, of the published setting, and of fits, where they cover least."""

    def at(row: ChartRow) -> tuple[float, float]:
        return cost_of(row, cost), _error_of(row, error)

    on = made.fronts[error][cost]
    dot = 0.55 * _FRONT_POINTS * figure.dpi / 72.0
    taken = [
        (x - dot, y - dot, x + dot, y + dot)
        for x, y in axes.transData.transform([*map(at, _with(made, cost))])
    ]
    taken += _along(axes, [at(row) for row in made.front(error, cost)], 0.3 * dot)
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    frame = axes.get_window_extent(renderer).padded(-0.5 * dot)
    named = [row for row in _with(made, cost) if row.key in on or row.key == PUBLISHED or not row.is_held_out]
    groups: list[list[ChartRow]] = []
    for row in named:  # those that are drawn on each other share a name
        pixel = axes.transData.transform(at(row))
        near = [
            group
            for group in groups
            if group[0].family == row.family
            and np.hypot(*(axes.transData.transform(at(group[0])) - pixel)) < 1.5 * dot
        ]
        if near:
            near[0].append(row)
        else:
            groups.append([row])
    for group in groups:
        place = at(group[0])
        pixel = axes.transData.transform(place)
        text = axes.annotate(
            _title(group), place, xytext=(0, 0), textcoords="offset pixels", fontsize=_LABEL, ha="center",
            va="center", style="normal" if group[0].is_held_out else "italic",
            color="black" if group[0].is_held_out else "0.35",
            path_effects=[withStroke(linewidth=2.5, foreground="white", alpha=0.85)], zorder=6,
        )  # fmt: skip
        extent = text.get_window_extent(renderer)
        rivals = axes.transData.transform([at(row) for row in named if row not in group] or [place])
        offset, box = _place(pixel, rivals, _DRAWN * extent.width, extent.height, dot, taken, frame.extents)
        text.set_position(offset)
        taken.append(box)
        edge = np.clip(pixel, box[:2], box[2:])
        if np.hypot(*(edge - pixel)) > 2.0 * dot:
            end = axes.transData.inverted().transform(edge)
            axes.plot(*zip(place, end, strict=True), color="0.4", linewidth=0.7, zorder=2.5)


def _along(axes: Axes, corners: Sequence[tuple[float, float]], half: float) -> list[Box]:
    """Small boxes along the line of a front, in pixels."""
    if not corners:
        return []
    ends = axes.transData.transform(np.column_stack(_stairs(corners)))
    steps = [
        np.linspace(a, b, max(int(np.hypot(*(b - a)) / (2.0 * half)), 2)) for a, b in itertools.pairwise(ends)
    ]
    return [(x - half, y - half, x + half, y + half) for step in steps for x, y in step]


def _title(group: Sequence[ChartRow]) -> str:
    """One name for settings that are drawn on each other: the first, simplest one's; fits by their methods."""
    first = group[0]
    if not first.is_held_out:
        return "fit: " + ", ".join(row.title.split(", ")[-1] for row in group)
    return first.title + (f" (+{len(group) - 1})" if len(group) > 1 else "")


def _place(
    point: Array, rivals: Array, width: float, height: float, dot: float, taken: Sequence[Box], frame: Box
) -> tuple[tuple[float, float], Box]:
    """Offset in pixels of the centre of a name, and its box: near its point, inside the frame, over little.

    It should be no nearer to other points that have names, `rivals` (K, 2), than to its own.
    """

    def cost(gap: float, box: Box) -> float:
        covered = sum(overlap(box, other) for other in taken)
        own, theirs = _distances(box, point[None])[0], _distances(box, rivals).min()
        near = 4.0 * height * max(own - theirs, 0.0)
        return gap * height + 4.0 * covered + 1e4 * outside(box, frame) + near

    return cheapest_place(point, width, height, dot * np.array([1.3, 2.5, 4.0, 6.0, 8.5, 12.0]), 24, cost)


def _distances(box: Box, points: Array) -> Array:
    """From a box to points (K, 2), shape (K,)."""
    return np.linalg.norm(points - np.clip(points, box[:2], box[2:]), axis=1)
