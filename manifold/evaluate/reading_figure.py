"""Errors of completed materials against the number of readings."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle

from matplotlib.figure import Figure

from manifold.evaluate.reading_curve import Curve
from manifold.plots.figures import new_figure

_CROWDED = (10, 16)  # counts whose labels would touch their neighbours'
_LABELS = {"ball": "ball, mean CIEDE2000", "cube_root": "cube-root error", "linear": "linear error"}
# Okabe & Ito, and markers that tell them apart without colour.
_STYLES = (
    ("#000000", "o"),
    ("#d55e00", "s"),
    ("#e69f00", "D"),
    ("#0072b2", "^"),
    ("#009e73", "v"),
    ("#cc79a7", "*"),
    ("#56b4e9", "P"),
)


def readings_chart(curves: Sequence[Curve]) -> Figure:
    """Three panels: medians as lines, 90th percentiles dotted; one colour per method."""
    figure = new_figure(12.0, 4.4)
    panels = figure.subplots(1, 3)
    for axes, (kind, label) in zip(panels, _LABELS.items(), strict=True):
        for curve, (colour, marker) in zip(curves, cycle(_STYLES), strict=False):
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
