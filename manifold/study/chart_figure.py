"""Draws charts of errors against three costs, with Pareto fronts, and against the number of readings."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import LogFormatterSciNotation, LogLocator, NullFormatter, NullLocator

from manifold.core.judged_lights import BALL
from manifold.core.records import Array
from manifold.evaluate.held_out import ChartRow
from manifold.evaluate.methods import AFTER_PUBLISHED, BLENDS, NONNEGATIVE, PUBLISHED
from manifold.evaluate.readings import Curve
from manifold.evaluate.seen_fits import FAMILY
from manifold.pictures.figures import fix_layout, new_figure, place_names
from manifold.study.chart import COSTS, ERRORS, Chart, conclusion, cost_of

_ERRORS = ("ball", "cube_root", "linear")
_COSTS = {
    "predict": "time to predict a material (reference times)",
    "bytes": "bytes kept",
    "fit": "time to fit the library (reference times)",
}


@dataclass(frozen=True)
class _Style:
    """Colour and marker of a family: colours of Okabe and Ito, distinguishable with any colour vision."""

    marker: str
    colour: str


STYLES = {
    "one or two materials": _Style("D", "#cc79a7"),
    "PCA": _Style("o", "#0072b2"),
    "GPLVM, whole materials": _Style("s", "#e69f00"),
    BLENDS: _Style("P", "#000000"),
    NONNEGATIVE: _Style("v", "#56b4e9"),
    AFTER_PUBLISHED: _Style("*", "#d55e00"),
    FAMILY: _Style("x", "#555555"),
}
_FRONT_POINTS, _OTHER_POINTS, _PUBLISHED_POINTS = 8.5, 5.0, 15.0
_LABEL = 8.8
_LEAST_ERROR = 1e-4  # smaller ones are drawn here


def chart(measured: Chart) -> Figure:
    """Draw errors against costs; settings on the front are filled and joined, dominated ones pale, fits as crosses."""
    figure = new_figure(15.0, 12.4)
    kind = "RGB" if measured.n_bands == 3 else f"{measured.n_bands} bands"
    figure.suptitle(
        "\n".join([*textwrap.wrap(conclusion(measured), 140, break_on_hyphens=False), ""])
        + f"Speed against accuracy: {measured.n_materials} materials, {kind}, each left out once; below and left is "
        "better",
        fontsize=12.5,
    )
    grid = figure.subplots(len(COSTS), len(_ERRORS), sharex="row", sharey="col", squeeze=False)
    for axis_row, cost in zip(grid, COSTS, strict=True):
        for axes, error in zip(axis_row, _ERRORS, strict=True):
            _points(axes, measured, error, cost)
            axes.set_xlabel(_COSTS[cost])
        costs = [cost_of(row, cost) for row in _with(measured, cost)]
        _widen(axis_row[0], costs)
        if costs and max(costs) < 30.0 * min(costs):
            _number_ticks(axis_row[0].xaxis, axis_row[0].get_xlim())
    for axes, error in zip(grid[0], _ERRORS, strict=True):
        axes.set_title(f"{ERRORS[error]}, median", fontsize=11)
        _error_ticks(axes, [_error_of(row, error) for row in measured.rows])
    figure.legend(handles=_legend(measured), loc="outside lower center", ncols=3, fontsize=9.5, frameon=False)
    fix_layout(figure)
    for axis_row, cost in zip(grid, COSTS, strict=True):
        for axes, error in zip(axis_row, _ERRORS, strict=True):
            _name(figure, axes, measured, error, cost)
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
        style = STYLES[row.family]
        size = (
            _PUBLISHED_POINTS if row.key == PUBLISHED else _FRONT_POINTS if row.key in on else _OTHER_POINTS
        )
        is_plain = row.key in on or row.key == PUBLISHED
        is_cross = style.marker == "x"
        axes.plot(
            cost_of(row, cost), _error_of(row, error), style.marker, markersize=size, color=style.colour,
            markerfacecolor=style.colour if is_plain else "white",
            markeredgecolor="black" if is_plain and not is_cross else style.colour,
            alpha=1.0 if is_plain or is_cross else 0.6, zorder=4 if is_plain else 3, gid=row.key,
        )  # fmt: skip


def _error_of(row: ChartRow, error: str) -> float:
    """Return an error, at least the smallest that the logarithmic axis shows; copies have an error of 0."""
    return max(float(getattr(row.median, error)), _LEAST_ERROR)


def _with(made: Chart, cost: str) -> list[ChartRow]:
    """Return the settings whose cost is known."""
    return [row for row in made.rows if np.isfinite(cost_of(row, cost))]


def _stairs(corners: Sequence[tuple[float, float]]) -> tuple[Array, Array]:
    """Return the boundary of the region that a front dominates, from the cheapest to the dearest corner."""
    x, y = np.array(corners).T
    return np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1]


def _widen(axes: Axes, costs: Sequence[float]) -> None:
    """Widen an axis whose costs hardly differ, so that its numbers have room."""
    if costs and max(costs) < 2.0 * min(costs):
        middle = float(np.sqrt(min(costs) * max(costs)))
        axes.set_xlim(0.5 * middle, 2.0 * middle)


def _error_ticks(axes: Axes, values: Sequence[float]) -> None:
    """Set numbers on the axis if the errors span less than three decades."""
    if max(values) / min(values) < 1e3:
        _number_ticks(axes.yaxis, values)
    else:
        axes.yaxis.set_major_formatter(LogFormatterSciNotation())
        axes.yaxis.set_minor_formatter(NullFormatter())


def _number_ticks(axis: Axis, values: Sequence[float]) -> None:
    """Set numbers at 1, 2 and 5, and between them if the values span less than a decade."""
    is_short = max(values) < 10.0 * min(values)
    axis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0, 7.0) if is_short else (1.0, 2.0, 5.0)))
    axis.set_major_formatter(lambda value, _: f"{value:g}" if value < 1e5 else f"{value / 1e6:g}M")
    axis.set_minor_locator(NullLocator())


def _legend(made: Chart) -> list[Line2D]:
    present = {row.family for row in made.rows}
    handles = [
        Line2D([], [], linestyle="", marker=style.marker, color=style.colour, markersize=8, label=family)
        for family, style in STYLES.items()
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
    pixels = axes.transData.transform([*map(at, _with(made, cost))])
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
    names = [
        axes.annotate(
            _title(group), at(group[0]), xytext=(0, 0), textcoords="offset pixels", fontsize=_LABEL, ha="center",
            va="center", style="normal" if group[0].is_held_out else "italic",
            color="black" if group[0].is_held_out else "0.35",
            path_effects=[withStroke(linewidth=2.5, foreground="white", alpha=0.85)], zorder=6,
        )
        for group in groups
    ]  # fmt: skip
    if front := made.front(error, cost):  # its line is not to be covered either
        ends = axes.transData.transform(np.column_stack(_stairs([at(row) for row in front])))
        lengths = np.linalg.norm(np.diff(ends, axis=0), axis=1)
        along = zip(ends[:-1], ends[1:], lengths, strict=True)
        pixels = np.vstack([pixels, *(np.linspace(a, b, int(n / dot) + 2) for a, b, n in along)])
    place_names(figure, axes, names, dot, pixels, zorder=2.5)


def _title(group: Sequence[ChartRow]) -> str:
    """Return one name for settings that are drawn on each other: the first, simplest one's; fits by their methods."""
    first = group[0]
    if not first.is_held_out:
        return "fit: " + ", ".join(row.title.split(", ")[-1] for row in group)
    return first.title + (f" (+{len(group) - 1})" if len(group) > 1 else "")


# -- against the number of readings -------------------------------------------------------------------------

_CROWDED = (10, 16)  # counts whose labels would touch their neighbours'
_READING_LABELS = {"ball": BALL, "cube_root": "cube-root error", "linear": "linear error"}
# Okabe & Ito, and markers that tell them apart without colour.
_READING_STYLES = (
    ("#000000", "o"),
    ("#d55e00", "s"),
    ("#e69f00", "D"),
    ("#0072b2", "^"),
    ("#009e73", "v"),
    ("#cc79a7", "*"),
    ("#56b4e9", "P"),
)


def readings_chart(curves: Sequence[Curve]) -> Figure:
    """Draw three panels: medians as lines, 90th percentiles dotted; one colour per method."""
    figure = new_figure(12.0, 4.4)
    panels = figure.subplots(1, 3)
    for axes, (kind, label) in zip(panels, _READING_LABELS.items(), strict=True):
        for curve, (colour, marker) in zip(curves, cycle(_READING_STYLES), strict=False):
            counts, *both = zip(*curve.summary, strict=True)
            median, high = ([getattr(errors, kind) for errors in each] for each in both)
            line, size = ("-", 5.0) if len(counts) > 1 else ("", 9.0)
            axes.plot(counts, median, line, color=colour, marker=marker, markersize=size, label=curve.title)
            axes.plot(counts, high, ":", color=colour, marker=marker, markersize=0.5 * size, linewidth=1.0)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xticks(curves[0].counts, ["" if n in _CROWDED else str(n) for n in curves[0].counts])
        axes.minorticks_off()
        axes.set_xlabel("readings")
        axes.set_title(label, fontsize=11)
        axes.grid(alpha=0.3)
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=9, frameon=False,
        title="lines: median of left-out materials; dotted: 90th percentile", title_fontsize=9,
    )  # fmt: skip
    return figure
