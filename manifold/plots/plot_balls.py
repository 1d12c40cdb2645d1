"""Pictures made of rendered balls: the latent map, and walks between two materials."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.offsetbox import AnnotationBbox, OffsetImage
from matplotlib.patheffects import withStroke

from manifold.model import Manifold
from manifold.plots.figures import new_figure
from manifold.plots.plot_latents import draw_uncertainty, latent_axes, two_dimensions
from manifold.records import Array

_BALL_POINTS = 30.0  # diameter of a ball on the map
_ROOM = (1.7, 1.55)  # width and height that a ball and its name take, in diameters
_PUSHES = 400
_PULL = 0.02  # towards the true place, per push


def ball_map(
    model: Manifold, images: Sequence[Array], marked: Array | None = None, marked_image: Array | None = None
) -> Figure:
    """The first two latent dimensions: every material as a ball, over the uncertainty.

    Balls that would cover each other are moved apart, with a line to where they belong.

    Args:
        model: a fitted manifold.
        images: one ball per material, RGBA (H, W, 4), cropped to the ball.
        marked: a latent (Q,) to show as predicted.
        marked_image: the ball of that prediction.
    """
    figure = new_figure(12, 9)
    axes = figure.add_subplot()
    X = two_dimensions(model.X)
    names = [name.removeprefix("syn_").replace("_", " ") for name in model.names]
    shown = list(images)
    if marked is not None and marked_image is not None:
        X = np.vstack([X, two_dimensions(np.asarray(marked, dtype=float)[None])])
        names.append("predicted")
        shown.append(marked_image)
    if model.settings.latent_dim == 2:
        draw_uncertainty(figure, axes, model)
    else:
        axes.scatter(X[:, 0], X[:, 1], s=0)
        axes.margins(0.15)
    latent_axes(axes, model)
    figure.draw_without_rendering()  # the layout decides where pixels are
    point = figure.dpi / 72.0
    room = np.array(_ROOM) * _BALL_POINTS * point
    places = axes.transData.inverted().transform(
        spread(axes.transData.transform(X), room, np.array(axes.bbox.extents))
    )
    outline = [withStroke(linewidth=2.5, foreground="white")]
    for k, (place, true, name, image) in enumerate(zip(places, X, names, shown, strict=True)):
        is_marked = k >= len(images)
        axes.plot(*zip(true, place, strict=True), color="0.3", linewidth=0.7, zorder=2)
        axes.plot(*true, "o", color="0.2", markersize=2.5, zorder=2)
        ball = OffsetImage(
            image, zoom=_BALL_POINTS / image.shape[0], resample=True, interpolation="antialiased"
        )
        axes.add_artist(AnnotationBbox(ball, place, frameon=False, pad=0, zorder=3))
        axes.annotate(
            name, place, (0, -0.52 * _BALL_POINTS), textcoords="offset points", ha="center", va="top", zorder=4,
            fontsize=7.5, weight="bold" if is_marked else "normal", path_effects=outline,
        )  # fmt: skip
    return figure


def spread(points: Array, room: Array, frame: Array) -> Array:
    """Points (N, 2) pushed apart until boxes of size `room` (2,) around them hardly overlap, near where they were.

    All end up within a frame (left, bottom, right, top), a box's half away from its edge.
    """
    rng = np.random.default_rng(0)
    places = points + rng.normal(scale=1e-3, size=points.shape)
    for _ in range(_PUSHES):
        apart = (places[:, None] - places[None]) / room
        distance = np.max(np.abs(apart), axis=2)
        np.fill_diagonal(distance, np.inf)
        overlap = np.maximum(1.0 - distance, 0.0)
        length = np.maximum(np.linalg.norm(apart, axis=2), 1e-9)
        push = np.sum(0.5 * overlap[..., None] * apart / length[..., None], axis=1) * room
        places += push + _PULL * (points - places)
        places = np.clip(places, frame[:2] + 0.5 * room, frame[2:] - 0.5 * room)
    return places


def walk_strip(title: str, steps: Sequence[float], rows: Sequence[tuple[str, Sequence[Array]]]) -> Figure:
    """Balls side by side, a row per method, on the way from one material (t = 0) to another (t = 1).

    Args:
        title: above all.
        steps: t of every column.
        rows: name of the method, and one ball per step, RGBA (H, W, 4).
    """
    figure = new_figure(1.25 * len(steps) + 1.1, 1.35 * len(rows) + 0.9)
    figure.suptitle(title, fontsize=12)
    grid = figure.subplots(len(rows), len(steps), squeeze=False)
    for row, (name, images) in enumerate(rows):
        for axes, image in zip(grid[row], images, strict=True):
            _show(axes, image)
        grid[row, 0].set_ylabel(name, fontsize=11)
    for axes, t in zip(grid[-1], steps, strict=True):
        axes.set_xlabel(f"t = {t:.2g}", fontsize=9)
    return figure


def _show(axes: Axes, image: Array) -> None:
    axes.imshow(image, interpolation="antialiased")
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)
