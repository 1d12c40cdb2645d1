"""Draws figures of rendered balls: the latent map, and walks between two materials."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.offsetbox import AnnotationBbox, OffsetImage
from matplotlib.patheffects import withStroke

from manifold.core.records import Array
from manifold.model.manifold import Manifold
from manifold.pictures.figures import fix_layout, in_lines, new_figure
from manifold.pictures.map_figure import (
    MARK,
    draw_expected_error,
    draw_points,
    latent_axes,
    material_labels,
    two_dimensions,
)

_BALL_POINTS = 30.0  # diameter of a ball on the map
_LINE = 13  # letters of a name before it is broken
_STEPS = 400
_ATTRACTION = 0.02  # towards the true place, per step; falling to 0, so that the last steps only separate
_GAP = 1.06  # distance of boxes, in their sizes


def ball_map(
    model: Manifold, images: Sequence[Array], marked: Array | None = None, marked_image: Array | None = None
) -> Figure:
    """Draw the map with rendered balls of the materials `model.pictured`, over the expected error.

    `images` are RGBA (H, W, 4), cropped to the ball. Overlapping balls are moved apart, with a line to their latents.
    Other materials are drawn as points in their colours. The latent `marked` (Q,), if given, is shown with the ball
    of its prediction. Only the first two latent dimensions are drawn.
    """
    figure = new_figure(12, 9)
    axes = figure.add_subplot()
    X = two_dimensions(model.X[model.pictured])
    names = [in_lines(name, _LINE) for name in material_labels(model)]
    draw_points(axes, model)
    shown = list(images)
    if marked is not None and marked_image is not None:
        X = np.vstack([X, two_dimensions(np.asarray(marked, dtype=float)[None])])
        names.append("predicted")
        shown.append(marked_image)
    if model.settings.latent_dim == 2:
        draw_expected_error(figure, axes, model)
    else:
        axes.scatter(X[:, 0], X[:, 1], s=0)
        axes.margins(0.15)
    latent_axes(axes, model)
    fix_layout(figure)
    axes.autoscale(enable=False)
    point = figure.dpi / 72.0
    outline = [withStroke(linewidth=2.5, foreground="white")]
    style: dict[str, Any] = {"fontsize": 7.5, "linespacing": 1.05, "ha": "center", "va": "top"}
    labels = [
        axes.annotate(
            name, (0, 0), (0, -0.52 * _BALL_POINTS), textcoords="offset points", zorder=6,
            weight="bold" if k >= len(images) else "normal", path_effects=outline, **style,
        )
        for k, name in enumerate(names)
    ]  # fmt: skip
    ball_pixels = _BALL_POINTS * point
    text = np.array([[box.width, box.height] for box in (label.get_window_extent() for label in labels)])
    room = np.column_stack([np.maximum(text[:, 0], 0.8 * ball_pixels), ball_pixels + text[:, 1]])
    below = np.column_stack([np.zeros(len(text)), 0.5 * text[:, 1]])  # names hang under their balls
    centres = spread(axes.transData.transform(X) - below, room, np.array(axes.bbox.extents))
    places = axes.transData.inverted().transform(centres + below)
    for place, true, label, image in zip(places, X, labels, shown, strict=True):
        label.xy = tuple(place)
        _draw_leader(axes, place, true, 0.5 * ball_pixels)
        ball = OffsetImage(
            image, zoom=_BALL_POINTS / image.shape[0], resample=True, interpolation="antialiased"
        )
        axes.add_artist(AnnotationBbox(ball, place, frameon=False, pad=0, zorder=3))
    return figure


def _draw_leader(axes: Axes, place: Array, true: Array, radius: float) -> None:
    """Draw a line from the edge of a ball to the point where it belongs, above all balls, unless the ball covers it."""
    centre, point = axes.transData.transform([place, true])
    apart = float(np.linalg.norm(point - centre))
    if apart <= radius:
        return
    edge = axes.transData.inverted().transform(centre + radius / apart * (point - centre))
    outline = [withStroke(linewidth=2.2, foreground="white")]
    axes.plot(*zip(edge, true, strict=True), color="0.2", linewidth=0.8, zorder=4, path_effects=outline)
    axes.plot(*true, "o", color="0.1", markersize=3.0, markeredgecolor="white", markeredgewidth=0.5, zorder=5)


def spread(points: Array, room: Array, frame: Array) -> Array:
    """Move points (N, 2) apart until boxes of size `room` (N, 2) around them hardly overlap.

    Points stay near their positions, and at least half a box away from the edges of `frame` (left, bottom, right,
    top).
    """
    rng = np.random.default_rng(0)
    room = np.broadcast_to(room, points.shape)
    between = 0.5 * _GAP * (room[:, None] + room[None])
    places = points + rng.normal(scale=1e-3, size=points.shape)
    for k in range(_STEPS):
        apart = (places[:, None] - places[None]) / between
        distance = np.max(np.abs(apart), axis=2)
        np.fill_diagonal(distance, np.inf)
        overlap = np.maximum(1.0 - distance, 0.0)
        length = np.maximum(np.linalg.norm(apart, axis=2), 1e-9)
        push = np.sum(0.5 * overlap[..., None] * apart / length[..., None], axis=1) * room
        places += push + _ATTRACTION * (1.0 - k / _STEPS) * (points - places)
        places = np.clip(places, frame[:2] + 0.5 * room, frame[2:] - 0.5 * room)
    return places


def walk_strip(
    title: str,
    steps: Sequence[float],
    rows: Sequence[tuple[str, Sequence[Array]]],
    doubtful: Sequence[bool] = (),
) -> Figure:
    """Draw balls, RGBA (H, W, 4), from one material (t = 0) to another (t = 1), with one row per method.

    Steps of the first row that `doubtful` selects get a mark, which the figure explains below the strip.
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
    for axes, is_doubtful in zip(grid[0], doubtful, strict=False):
        if is_doubtful:
            axes.set_title("!", fontsize=11, color=MARK, fontweight="bold", pad=1.0)
    if any(doubtful):
        figure.supxlabel("! diagnostic: negative values, albedo above 1, not reciprocal, a dark ring, or not "
        "supported by the data",
                         fontsize=9, color=MARK)  # fmt: skip
    return figure


def balls_beside(title: str, balls: Sequence[tuple[str, Array]]) -> Figure:
    """Draw balls, (H, W, 3 or 4), side by side, each with its name below."""
    figure = new_figure(3.2 * len(balls), 3.8)
    figure.suptitle(title, fontsize=12)
    grid = figure.subplots(1, len(balls), squeeze=False)
    for axes, (name, image) in zip(grid[0], balls, strict=True):
        _show(axes, image)
        axes.set_xlabel(name, fontsize=11)
    return figure


def _show(axes: Axes, image: Array) -> None:
    axes.imshow(image, interpolation="antialiased")
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)
