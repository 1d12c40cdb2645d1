"""Draws the latent map: materials as dots in their colours, over the expected error of predictions."""

from __future__ import annotations

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from manifold.colour.conversion import encode_srgb, to_srgb
from manifold.core.directions import from_spherical
from manifold.core.judged_lights import BALL
from manifold.core.records import Array, Indices
from manifold.library.identity import origins_in_words
from manifold.model.gplvm_space import GplvmSpace
from manifold.model.manifold import Manifold
from manifold.pictures.figures import fix_layout, new_figure, place_names, shortened

_DOT_POINTS = 10.5  # diameter of a material
_POINTS_AREA, _MOST_AREA = 60000.0, 30.0  # area of all small points together, and of one, in square points
MARK = "#d55e00"
_UNCERTAINTY = LinearSegmentedColormap.from_list("uncertainty", ["#ffffff", "#c6d8e8", "#5b7f9f"])
_BALL_RANGE, _BALL_TICKS = (0.5, 16.0), (0.5, 1, 2, 4, 8, 16)  # CIEDE2000; a difference of 1 is visible
_LINES = 4  # lines of equal posterior standard deviation, about
_GRID = 120  # background samples per axis
_MARGIN = 0.18  # margin around the latents, as a share of their range


def latent_map(model: Manifold, marked: Array | None = None) -> Figure:
    """Draw the first two latent dimensions: materials in their own colours over the expected error, see `pictured`.

    `marked` (Q,) is a latent to label "predicted". The materials of a one-dimensional map are drawn along a line.
    """
    figure = new_figure(10, 7.2)
    axes = figure.add_subplot()
    X = two_dimensions(model.X[model.pictured])
    if model.settings.latent_dim == 2:
        draw_expected_error(figure, axes, model)
    draw_points(axes, model)
    colours = material_colours(model, model.pictured)
    axes.scatter(X[:, 0], X[:, 1], _DOT_POINTS**2, colours, edgecolors="black", linewidths=0.8, zorder=3)
    names = [shortened(name) for name in material_labels(model)]
    if marked is not None:
        X = np.vstack([X, two_dimensions(np.asarray(marked, dtype=float)[None])])
        names.append("predicted")
        axes.scatter(X[-1:, 0], X[-1:, 1], 3 * _DOT_POINTS**2, MARK, marker="*", edgecolors="white", zorder=5)
    latent_axes(axes, model)
    _label(figure, axes, X, names)
    return figure


def material_labels(model: Manifold) -> list[str]:
    """Return the names of the pictured materials of a map, with the origin of materials that were not measured."""
    labels = []
    for name in (model.names[k] for k in model.pictured):
        origin = model.library.attributes(name).origin
        what = "" if origin in ("measured", "synthetic", name) else f" ({origin})"
        labels.append(name.removeprefix("syn_").replace("_", " ") + what)
    return labels


def latent_axes(axes: Axes, model: Manifold) -> None:
    """Set the title and labels of a map of latents; they state the number of dimensions that are not drawn."""
    dims = model.settings.latent_dim
    materials = [model.library.attributes(name) for name in model.names]
    origins = {material.origin for material in materials}
    kind = f"{origins.pop()} materials" if len(origins) == 1 else f"materials, {origins_in_words(materials)}"
    title = f"Material manifold: {len(materials)} {kind}, {model.bands}"
    title += f"; 2 of {dims} dimensions" if dims > 2 else "; one dimension" if dims == 1 else ""
    axes.set_title(title + " (expected errors are drawn for two dimensions only)" * (dims != 2), fontsize=12)
    axes.set_xlabel("latent $x_1$ (length scales)")
    if dims > 1:
        axes.set_ylabel("latent $x_2$ (length scales)")
    else:
        axes.set_yticks([])


def two_dimensions(X: Array) -> Array:
    """Return the first two columns, with zeros for a missing second one."""
    return X[:, :2] if X.shape[1] > 1 else np.column_stack([X[:, 0], np.zeros(len(X))])


def draw_expected_error(figure: Figure, axes: Axes, model: Manifold) -> None:
    """Draw the expected error as the background of a two-dimensional map, with its colour bar.

    For a model without calibration, it is the posterior standard deviation (for blends, relative to the prior).
    Hatched regions are not supported by the data. For a calibrated GPLVM, contour lines show the posterior standard
    deviation.
    """
    low, high = model.X.min(axis=0), model.X.max(axis=0)
    margin = _MARGIN * (high - low)
    x, y = (np.linspace(low[k] - margin[k], high[k] + margin[k], _GRID) for k in (0, 1))
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    left_out = model.left_out
    posterior = model.posterior(points) if isinstance(model.space, GplvmSpace) else None
    if left_out is None and posterior is not None:
        ground, norm = posterior.std, Normalize(0.0)
        words = f"posterior standard deviation of {posterior.unit}"
    elif left_out is None:
        ground, norm, words = (
            model.std(points),
            Normalize(0.0, 1.0),
            "posterior over prior standard deviation",
        )
    else:
        ground, norm = left_out.expected(points).ball, LogNorm(*_BALL_RANGE, clip=True)
        given = " in a given colour" * model.space.takes_colours
        words = f"expected error of a prediction{given}: {BALL}"
    image = axes.imshow(
        ground.reshape(_GRID, _GRID), extent=(x[0], x[-1], y[0], y[-1]), origin="lower", aspect="auto",
        interpolation="bilinear", cmap=_UNCERTAINTY, norm=norm,
    )  # fmt: skip
    bar = figure.colorbar(
        image, ax=axes, pad=0.015, fraction=0.04, extend="neither" if left_out is None else "both"
    )
    bar.set_label(words)
    if left_out is not None:
        bar.set_ticks(_BALL_TICKS, labels=[f"{tick:g}" for tick in _BALL_TICKS])
    unsupported = model.is_extrapolation(points).reshape(_GRID, _GRID).astype(float)
    keys: list[Artist] = []
    if left_out is not None and posterior is not None:
        lines = axes.contour(
            x, y, posterior.std.reshape(_GRID, _GRID), levels=_LINES, colors="0.35", linewidths=0.7
        )
        axes.clabel(lines, fmt="%.2g", fontsize=7)
        keys.append(Line2D([], [], color="0.35", lw=0.7, label=f"posterior std of {posterior.unit}"))
    if unsupported.any():
        hatched = axes.contourf(x, y, unsupported, levels=[0.5, 1.5], colors="none", hatches=["//"])
        hatched.set(edgecolor="0.45", linewidth=0.0)
        keys.append(Patch(facecolor="none", edgecolor="0.45", hatch="//", label="not supported by the data"))
    if keys:
        axes.legend(handles=keys, loc="lower right", fontsize=8, framealpha=0.9)
    axes.set_xlim(x[0], x[-1])
    axes.set_ylim(y[0], y[-1])


def draw_points(axes: Axes, model: Manifold) -> None:
    """Draw the materials that are not pictured, as small points in their colours."""
    others = np.delete(np.arange(len(model.names)), model.pictured)
    if others.size:
        X, area = two_dimensions(model.X[others]), _POINTS_AREA / len(others)
        colours = material_colours(model, others)
        axes.scatter(X[:, 0], X[:, 1], min(area, _MOST_AREA), colours, linewidths=0.0, zorder=1.5)


def material_colours(model: Manifold, materials: Indices) -> Array:
    """Return the display colours (n, 3) of materials (n,), from reflectances under D65 or albedos at 30 degrees."""
    if model.space.takes_colours:
        reflectances = model.space.reflectances[materials]
    else:
        wi = from_spherical(np.deg2rad(30.0), 0.0)
        reflectances = np.stack([model.material(model.names[k]).albedo(wi, resolution=16) for k in materials])
    return encode_srgb(np.clip(to_srgb(reflectances, model.bands), 0.0, 1.0))


def _label(figure: Figure, axes: Axes, X: Array, names: list[str]) -> None:
    """Place names near their points, from the rim of the map inwards."""
    fix_layout(figure)
    axes.autoscale(enable=False)
    pixels = axes.transData.transform(X)
    labels = [
        axes.annotate(
            names[k], X[k], xytext=(0, 0), textcoords="offset pixels", fontsize=8, ha="center", va="center",
            path_effects=[withStroke(linewidth=2.5, foreground="white", alpha=0.8)], zorder=4,
        )
        for k in np.argsort(-np.linalg.norm(pixels - pixels.mean(axis=0), axis=1))
    ]  # fmt: skip
    place_names(figure, axes, labels, 0.7 * _DOT_POINTS * figure.dpi / 72.0, pixels, zorder=2)
