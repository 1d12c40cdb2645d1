"""Common functions of all figures: no window, atomic saving."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.mathtext import MathTextParser
from matplotlib.text import Text

from manifold.errors import UsageError
from manifold.plots.glyphs import drawable
from manifold.system import atomic

Box = tuple[float, float, float, float]
"""Left, bottom, right, top."""

_SUFFIXES = (".png", ".pdf", ".svg")


def overlap(a: Box, b: Box) -> float:
    """Common area of two boxes."""
    return max(min(a[2], b[2]) - max(a[0], b[0]), 0.0) * max(min(a[3], b[3]) - max(a[1], b[1]), 0.0)


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
    """Let a text be drawn as it is: names may hold dollars, and characters that the font lacks."""
    words = text.get_text()
    if "$" in words and not _is_formula(words):
        text.set_parse_math(False)
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
