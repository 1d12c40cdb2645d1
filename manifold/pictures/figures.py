"""Common functions of all figures: layout, names, contact sheets, saving."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import rc_context, rcParams
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import fontManager
from matplotlib.patches import Circle
from matplotlib.text import Annotation

from manifold.core import disk, picture_bytes
from manifold.core.errors import UsageError
from manifold.core.names import without_controls
from manifold.core.records import Array

LARGEST_DELTA_E = 10.0
"""Upper end of the colour scale of CIEDE2000 maps."""

_SUFFIXES = (".png", ".pdf", ".svg")
# Installed ones draw the characters that the default font lacks.
_FALLBACK_FONTS = (
    "Noto Sans CJK JP", "Noto Sans CJK SC", "WenQuanYi Zen Hei", "Hiragino Sans", "PingFang SC", "Yu Gothic",
    "Microsoft YaHei", "Malgun Gothic", "Noto Emoji", "Segoe UI Symbol", "Arial Unicode MS", "Unifont",
)  # fmt: skip
# Rings of places around a point, in dots.
_GAPS, _ANGLES = np.array([1.3, 2.5, 4.0, 6.0, 8.5, 12.0, 17.0, 24.0, 34.0]), 36
# Costs of a covered square pixel, where a dot's gap costs a text's height.
_COVERED_POINT, _COVERED_NAME = 4.0, 100.0
_DRAWN = 1.07  # text with an outline is drawn without hints, wider than measured
rcParams["font.family"] += [name for name in _FALLBACK_FONTS if name in fontManager.get_font_names()]


_DPI = 110


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure with a size in inches; it opens no window."""
    figure = Figure(figsize=(width, height), dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def fix_layout(figure: Figure) -> None:
    """Fix the layout of a figure, so that later drawing does not move points."""
    figure.draw_without_rendering()
    figure.set_layout_engine("none")


def place_names(
    figure: Figure, axes: Axes, names: Sequence[Annotation], dot: float, points: Array, zorder: float
) -> None:
    """Move names to positions near their points where they cover few other points (K, 2) and names.

    Names are centred, with offsets in pixels; a line connects a distant name with its point. `dot` is half the width
    of a point in pixels.
    """
    renderer = figure.canvas.get_renderer()
    frame = axes.get_window_extent(renderer).padded(-0.5 * dot).extents
    own = axes.transData.transform([name.xy for name in names])
    taken = np.hstack([points - dot, points + dot])  # left, bottom, right, top
    price = np.full(len(taken), _COVERED_POINT)
    angles = np.linspace(0.0, 2.0 * np.pi, _ANGLES, endpoint=False)
    around = np.tile(np.stack([np.cos(angles), np.sin(angles)], axis=1), (len(_GAPS), 1))
    gaps = np.repeat(dot * _GAPS, _ANGLES)
    for k, name in enumerate(names):
        extent = name.get_window_extent(renderer)
        half = 0.5 * np.array([_DRAWN * extent.width, extent.height])
        offsets = around * (gaps[:, None] + half)
        boxes = np.hstack([own[k] + offsets - half, own[k] + offsets + half])
        common = np.minimum(boxes[:, None, 2:], taken[:, 2:]) - np.maximum(boxes[:, None, :2], taken[:, :2])
        covered = np.prod(np.maximum(common, 0.0), axis=2) @ price
        outside = np.maximum(np.hstack([frame[:2] - boxes[:, :2], boxes[:, 2:] - frame[2:]]).max(axis=1), 0.0)
        nearest = np.clip(own[:, None], boxes[:, :2], boxes[:, 2:])  # points of the boxes, [K, places, 2]
        apart = np.linalg.norm(own[:, None] - nearest, axis=2)
        too_far = np.maximum(apart[k] - apart.min(axis=0), 0.0)  # nearer to other points than to its own
        cost = extent.height * (gaps + 4.0 * too_far) + covered + 1e4 * outside
        best = int(np.argmin(cost))
        name.set_position(tuple(offsets[best]))
        taken, price = np.vstack([taken, boxes[best]]), np.append(price, _COVERED_NAME)
        if apart[k, best] > 2.0 * dot:
            end = axes.transData.inverted().transform(nearest[k, best])
            axes.plot(*zip(name.xy, end, strict=True), color="0.4", linewidth=0.7, zorder=zorder)


def shortened(name: str, most: int = 40) -> str:
    """Return a name as a label, cut to `most` characters and protected from being read as a formula."""
    text = without_controls(name if len(name) <= most else name[: most - 1] + "…")
    return text.replace("$", r"\$")


_MOST_LINES = 3  # lines of a title


def in_lines(name: str, width: int = 40) -> str:
    """Return a name as a title, broken preferably after blanks, `_`, `-`, `/` or `.`, and cut after three lines."""
    lines = [""]
    for part in re.findall(r"[^\s_/.-]*[\s_/.-]*", name):
        while len(lines[-1]) + len(part.rstrip()) > width:
            if lines[-1]:
                lines.append("")
            else:
                lines[-1], part = part[:width], part[width:]
                lines.append("")
        lines[-1] += part
    kept = [line.strip() for line in lines[:_MOST_LINES]]
    if lines[_MOST_LINES:]:
        kept[-1] += "…"
    return "\n".join(shortened(line, width + 1) for line in kept)


def require_writable(path: Path) -> None:
    """Raise UsageError, before a figure is drawn, if `save` cannot write it."""
    if path.suffix.lower() not in _SUFFIXES:
        raise UsageError(f"{path}: no picture format '{path.suffix}'; expected one of {', '.join(_SUFFIXES)}")
    disk.require_writable(path)


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG or in the suffix's format, atomically; fonts in PDF are TrueType, as journals require."""
    require_writable(path)
    with disk.replacing(path) as partial, rc_context({"pdf.fonttype": 42}):
        figure.savefig(partial)


_WIDTH, _HEIGHT = 1.15, 1.6  # smallest size of a cell, in inches
_WIDE = 12.0  # inches; wider sheets have the smallest cells
_MOST_COLUMNS = 16
_LETTERS = 15  # letters in a line of a name


def contact_sheet(cells: Sequence[tuple[str, str, Sequence[Path]]], under: str | None) -> Figure:
    """Draw pictures in rows, each with a name and a text below it, or a grey circle if there is none.

    `under` is the heading that explains this text. If there are few pictures, they keep their own size.
    """
    beside = max((len(pictures) for *_, pictures in cells), default=1)
    columns = min(int(np.ceil(np.sqrt(1.5 * len(cells) / beside))), _MOST_COLUMNS // beside)
    rows = -(-len(cells) // columns)
    said = ["left measured, right predicted"] * (beside > 1)
    said += [] if under is None else [f"below the names: {under}"]
    drawn = next((picture for *_, pictures in cells for picture in pictures if picture.is_file()), None)
    pixels = 0 if drawn is None else picture_bytes.decode(drawn.read_bytes(), "RGBA").shape[1]
    scale = float(np.clip(pixels / (_DPI * _WIDTH), 1.0, max(_WIDE / (_WIDTH * beside * columns), 1.0)))
    figure = new_figure(_WIDTH * scale * beside * columns, _HEIGHT * scale * rows + 0.4 * bool(said))
    if said:
        figure.supxlabel("; ".join(said), fontsize=8, color="0.3")
    grid = figure.subplots(rows, columns * beside, squeeze=False).reshape(-1, beside)
    for axes in grid.ravel():
        axes.set_axis_off()
    for group, (name, text, pictures) in zip(grid, cells, strict=False):
        for axes, picture in zip(group, pictures, strict=False):
            if picture.is_file():
                axes.imshow(picture_bytes.decode(picture.read_bytes(), "RGBA"), interpolation="antialiased")
            else:
                axes.add_patch(Circle((0.5, 0.5), 0.5, fill=False, color="0.7", linestyle=":"))
                axes.set_aspect("equal")
        label = "\n".join(filter(None, (in_lines(name, _LETTERS * beside), text)))
        middle = 0.5 * len(pictures)
        group[0].text(middle, -0.03, label, transform=group[0].transAxes, ha="center", va="top", fontsize=7)
    return figure
