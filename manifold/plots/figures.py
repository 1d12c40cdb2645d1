"""Common functions of all figures: no window, atomic saving."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.mathtext import MathTextParser
from matplotlib.text import Text

from manifold.errors import UsageError
from manifold.plots.glyphs import drawable
from manifold.records import Array
from manifold.system import atomic
from manifold.system.names import without_controls

Box = tuple[float, float, float, float]
"""Left, bottom, right, top."""

_SUFFIXES = (".png", ".pdf", ".svg")


def overlap(a: Box, b: Box) -> float:
    """Common area of two boxes."""
    return max(min(a[2], b[2]) - max(a[0], b[0]), 0.0) * max(min(a[3], b[3]) - max(a[1], b[1]), 0.0)


def cheapest_place(
    point: Array, width: float, height: float, gaps: Iterable[float], n_angles: int,
    cost: Callable[[float, Box], float],
) -> tuple[tuple[float, float], Box]:  # fmt: skip
    """The position of a label around its point of least cost: offset of its centre, and its box, in pixels.

    Args:
        point: (2,).
        width, height: of the label.
        gaps: between the point and the label, one ring of places each.
        n_angles: places on a ring.
        cost: of a gap and the label's box.
    """
    best: tuple[float, tuple[float, float], Box] | None = None
    for gap in gaps:
        for angle in np.linspace(0.0, 2.0 * np.pi, n_angles, endpoint=False):
            dx, dy = np.cos(angle) * (gap + 0.5 * width), np.sin(angle) * (gap + 0.5 * height)
            x, y = point[0] + dx, point[1] + dy
            box = (x - 0.5 * width, y - 0.5 * height, x + 0.5 * width, y + 0.5 * height)
            total = cost(gap, box)
            if best is None or total < best[0]:
                best = (total, (dx, dy), box)
    assert best is not None
    return best[1], best[2]


def outside(box: Box, frame: Box) -> float:
    """Distance by which a box exceeds a frame."""
    return max(frame[0] - box[0], box[2] - frame[2], frame[1] - box[1], box[3] - frame[3], 0.0)


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of that many inches, drawn without a window."""
    figure = Figure(figsize=(width, height), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def shortened(name: str, most: int = 40) -> str:
    """A name of at most so many letters; a longer one loses its end."""
    return name if len(name) <= most else name[: most - 1] + "…"


def require_writable(path: Path) -> None:
    """Raise what `save` would, as far as it can be known before the work.

    Raises:
        UsageError: the suffix is unknown, or the folder cannot be written.
    """
    if path.suffix.lower() not in _SUFFIXES:
        raise UsageError(f"{path}: no picture format '{path.suffix}'; expected one of {', '.join(_SUFFIXES)}")
    atomic.require_writable(path)


def _is_formula(text: str) -> bool:
    """Whether matplotlib can read a label with dollars in it: names of materials may hold some too."""
    try:
        _formulas().parse(text)
    except ValueError:
        return False
    return True


@cache
def _formulas() -> MathTextParser:
    return MathTextParser("agg")


def make_drawable(text: Text) -> None:
    """Let a text be drawn as it is: names may hold dollars, control characters, and others that the font lacks."""
    words = without_controls(text.get_text())
    if "$" in words and not _is_formula(words):
        text.set_parse_math(False)
    text.set_text(words)
    if not words.isascii():
        words, families = drawable(words, text.get_fontfamily())
        text.set_text(words)
        text.set_fontfamily(families)


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG (or what the suffix says), atomically.

    Raises:
        UsageError: the file cannot be written, or the suffix is unknown.
    """
    require_writable(path)
    for text in figure.findobj(Text):
        make_drawable(text)
    with atomic.replacing(path) as partial:
        figure.savefig(partial)
