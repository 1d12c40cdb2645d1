"""Pictures of models. This module alone imports matplotlib; nothing here opens a window."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from manifold import atomic, spectra
from manifold.directions import from_spherical
from manifold.errors import UsageError
from manifold.model import Manifold
from manifold.records import Array

_GRID = 120  # background samples per axis
_SUFFIXES = (".png", ".pdf", ".svg")
_MARGIN = 0.18  # of the range of the latents, around them


def latent_map(model: Manifold, marked: Array | None = None) -> Figure:
    """The first two latent dimensions: materials in their own colours over the uncertainty.

    Args:
        model: a fitted manifold; one dimension is drawn along a line.
        marked: a latent (Q,) to mark as predicted.
    """
    figure = Figure(figsize=(10, 7.2), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    X = _two_dimensions(model.X)
    if model.settings.latent_dim == 2:
        _draw_uncertainty(figure, axes, model)
    colours = _material_colours(model)
    axes.scatter(X[:, 0], X[:, 1], s=110, c=colours, edgecolors="black", linewidths=0.8, zorder=3)
    _label(axes, X, [name.removeprefix("syn_").replace("_", " ") for name in model.names])
    if marked is not None:
        x = _two_dimensions(np.asarray(marked, dtype=float)[None])[0]
        axes.scatter(*x, marker="*", s=380, c="#d55e00", edgecolors="white", linewidths=1.2, zorder=5)
        axes.annotate(
            "predicted", x, xytext=(10, -14), textcoords="offset points", fontsize=10, weight="bold",
            color="#d55e00", path_effects=[withStroke(linewidth=3, foreground="white")], zorder=6,
        )  # fmt: skip
    synthetic = all(model.library.attributes(name).is_synthetic for name in model.names)
    kind = "synthetic corpus" if synthetic else "measured materials"
    axes.set_title(f"Material manifold: {len(model.names)} materials ({kind}), {model.bands}", fontsize=12)
    axes.set_xlabel("latent $x_1$ (length scales)")
    axes.set_ylabel("latent $x_2$ (length scales)" if model.settings.latent_dim > 1 else "")
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG (or what the suffix says), atomically.

    Raises:
        UsageError: the file cannot be written, or the suffix is unknown.
    """
    if path.suffix.lower() not in _SUFFIXES:
        raise UsageError(f"{path}: no picture format '{path.suffix}'; expected one of {', '.join(_SUFFIXES)}")
    with atomic.replacing(path) as partial:
        figure.savefig(partial)


def _two_dimensions(X: Array) -> Array:
    """The first two columns, with zeros for a missing second one."""
    return X[:, :2] if X.shape[1] > 1 else np.column_stack([X[:, 0], np.zeros(len(X))])


def _draw_uncertainty(figure: Figure, axes: Axes, model: Manifold) -> None:
    low, high = model.X.min(axis=0), model.X.max(axis=0)
    margin = _MARGIN * (high - low)
    x, y = (np.linspace(low[k] - margin[k], high[k] + margin[k], _GRID) for k in (0, 1))
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    std = model.std(points).reshape(_GRID, _GRID)
    image = axes.pcolormesh(x, y, std, cmap="cividis_r", vmin=0.0, vmax=1.0, shading="gouraud", alpha=0.55)
    bar = figure.colorbar(image, ax=axes, pad=0.015, fraction=0.04)
    bar.set_label("posterior standard deviation, share of the prior's")
    axes.set_xlim(x[0], x[-1])
    axes.set_ylim(y[0], y[-1])


def _material_colours(model: Manifold) -> Array:
    """Display colour of each material: its directional albedo at 30 degrees under D65, shape (N, 3)."""
    wi = from_spherical(np.deg2rad(30.0), 0.0)
    albedo = np.stack([model.material(name).albedo(wi, resolution=16) for name in model.names])
    linear = np.clip(spectra.to_srgb(albedo, model.bands), 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def _label(axes: Axes, X: Array, names: list[str]) -> None:
    """Names beside their points, on the side away from the nearest neighbour, so that few overlap."""
    for k, (x, name) in enumerate(zip(X, names, strict=True)):
        others = np.delete(X, k, axis=0)
        nearest = others[np.argmin(np.linalg.norm(others - x, axis=1))]
        right, up = x[0] >= nearest[0], x[1] >= nearest[1]
        axes.annotate(
            name, x, xytext=(8 if right else -8, 5 if up else -5), textcoords="offset points",
            ha="left" if right else "right", va="bottom" if up else "top", fontsize=8,
            path_effects=[withStroke(linewidth=2.5, foreground="white", alpha=0.8)], zorder=4,
        )  # fmt: skip
