"""Draws the failure modes: error against severity, one panel per mode, one line per method."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter

from manifold.pictures.figures import new_figure
from manifold.study.stability.catalogue import FALSE_ALARM, conclusion, short
from manifold.study.stability.trials import FINE, REFUSED, WARNED, WRONG, Mode, Row, Stability

_COLUMNS = 4
_PANEL = (3.5, 2.75)  # inches
# Okabe and Ito, which all kinds of colour vision tell apart.
_COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9")
_DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)))
_MARKERS = {FINE: "o", WARNED: "^", REFUSED: "X", WRONG: "P"}
_DEFECT_COLOUR = "#d55e00"
_LEAST = 1e-3  # share of the limit: smaller errors are drawn here


def panels(made: Stability, modes: Sequence[Mode]) -> Figure:
    """Draw a panel per mode: the error divided by its limit, against severity. Above 1, a message is required."""
    shown = [mode for mode in modes if any(row.mode == mode.key for row in made.rows)]
    columns = min(_COLUMNS, len(shown))
    n_rows = -(-len(shown) // columns)
    figure = new_figure(max(_PANEL[0] * columns, 7.0), _PANEL[1] * n_rows + 1.3)
    grid = figure.subplots(n_rows, columns, squeeze=False)
    for axes, mode in zip(grid.flat, shown, strict=False):
        _panel(axes, mode, [row for row in made.rows if row.mode == mode.key])
    for axes in grid.flat[len(shown) :]:
        axes.set_visible(False)
    figure.suptitle(
        "\n".join(textwrap.wrap(conclusion(made), 28 * max(columns, 2), break_on_hyphens=False)),
        fontsize=10.5,
    )
    figure.supylabel("error over its limit", fontsize=11)
    ncols = 6 if columns > 1 else 3
    figure.legend(handles=_key(made), loc="outside lower center", ncols=ncols, fontsize=10, frameon=False)
    return figure


def _panel(axes: Axes, mode: Mode, rows: Sequence[Row]) -> None:
    places = np.arange(len(mode.severities))  # equal steps: many severities are no numbers to scale
    for k, row in enumerate(rows):
        colour, dash = _COLOURS[k % len(_COLOURS)], _DASHES[k % len(_DASHES)]
        heights = np.array([_height(one.error, row.limit) for one in row.results])
        shift = 0.06 * (k - 0.5 * (len(rows) - 1))  # lines that coincide stay apart
        axes.plot(places + shift, heights, color=colour, linestyle=dash, linewidth=1.4, label=row.method)
        for place, height, one in zip(places + shift, heights, row.results, strict=True):
            at = height if np.isfinite(height) else 1.0  # what was refused has no error
            is_false_alarm = row.is_false_alarm and one is row.results[0]
            is_defect, is_warned = one.outcome == WRONG or is_false_alarm, one.outcome == WARNED
            axes.plot(
                place, at, _MARKERS[one.outcome], color=_DEFECT_COLOUR if is_defect else colour,
                markersize=10 if is_defect else 6.5,
                markeredgecolor=_DEFECT_COLOUR if is_false_alarm else colour if is_warned else "black",
                markeredgewidth=1.5 if is_warned else 0.6, markerfacecolor="white" if is_warned else None, zorder=3,
            )  # fmt: skip
    axes.axhline(1.0, color="black", linewidth=1.0)
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    room = 3.0 * 2.0 ** len(rows)  # above the lines, for the legend
    axes.set_ylim(min(low, 0.09), max(11.0, high * room))  # a decade each way, at least
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_xlim(-0.4, len(places) - 0.6)
    axes.set_xticks(places, [f"{s:.3g}" for s in mode.severities], fontsize=8)
    axes.tick_params(axis="y", labelsize=8)
    axes.set_title(f"{mode.key}\nlimit {mode.limit.value:g}", fontsize=9.5)
    axes.set_xlabel(short(mode.severity, 46), fontsize=8.5)
    axes.grid(axis="y", color="0.9", linewidth=0.6)
    axes.legend(
        fontsize=7, loc="upper left", framealpha=0.7, handlelength=2.6, borderpad=0.3, labelspacing=0.2
    )


def _height(error: float | None, limit: float) -> float:
    """Return the error over its limit, within the drawn range; NaN without an error.

    A limit of 0 gives the lowest or the highest value.
    """
    if error is None:
        return float("nan")
    if limit == 0.0:
        return _LEAST if error == 0.0 else 1.0 / _LEAST
    return float(np.clip(error / limit, _LEAST, 1.0 / _LEAST)) if np.isfinite(error) else 1.0 / _LEAST


def _key(made: Stability) -> list[Line2D]:
    """Return a legend of the markers, with the number of trials of each."""
    outcomes = [one.outcome for row in made.rows for one in row.results]
    handles = [
        _handle(
            marker, "black", "white" if outcome == WARNED else _DEFECT_COLOUR if outcome == WRONG else "0.6",
            f"{outcome} ({outcomes.count(outcome)})",
        )
        for outcome, marker in _MARKERS.items()
    ]  # fmt: skip
    false_alarm = _handle(
        _MARKERS[WARNED], _DEFECT_COLOUR, "white", f"{FALSE_ALARM} ({len(made.false_alarms)})"
    )
    return [*handles, false_alarm, Line2D([], [], color="black", linewidth=1.0, label="limit")]


def _handle(marker: str, edge: str, face: str, label: str) -> Line2D:
    return Line2D(
        [], [], linestyle="none", marker=marker, markersize=8, markeredgecolor=edge, markerfacecolor=face, label=label
    )  # fmt: skip
