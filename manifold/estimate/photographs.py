"""Draws photographs of balls beside their predictions and the differences."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from manifold.brdf.measured import MeasuredBRDF
from manifold.colour.conversion import encode_srgb, to_srgb
from manifold.core.errors import UsageError
from manifold.core.records import Array
from manifold.estimate.completion import Completion
from manifold.estimate.lamps import lamp_picture
from manifold.estimate.outlines import Circle
from manifold.estimate.sightings import PhotoRequest, SeenBall
from manifold.io_rgl import read_bsdf
from manifold.pictures import figures
from manifold.render import images
from manifold.render.render import render_floating_ball

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MARGIN = 0.05  # width around the ball in pictures of residuals, in radii
_SIZE, _SAMPLES = 256, 32  # pixels a side, and samples per pixel, of predicted pictures


def require_drawable(picture: Path, request: PhotoRequest) -> None:
    """Raise UsageError if no picture of photographs beside their prediction can be drawn and written."""
    figures.require_writable(picture)
    if request.has_cylinder:
        raise UsageError(f"{picture}: residuals are drawn of balls, found a cylinder; leave --picture out")


def draw_residuals(
    balls: Sequence[SeenBall], file: Path, material: Completion, exposure: float | None, picture: Path
) -> None:
    """Draw photographs beside renderings of a file, with their differences.

    A known exposure is divided out of the photographs. If it was estimated, the renderings are exposed like the
    photographs instead, because a wrong estimate could turn both pictures white or black and hide the differences.
    """
    known = exposure or 1.0
    seen, predicted, errors = [], [], []
    for ball, of_picture in zip(balls, material.exposures.tolist(), strict=True):
        crop = _cropped(ball.photograph.values, ball.circle) / known
        clipped = _cropped(ball.photograph.is_clipped.astype(np.float32), ball.circle).max(axis=2) > 0.0
        camera = ball.sighting.camera
        if ball.light is None:
            brdf = MeasuredBRDF(read_bsdf(file))
            lit = lamp_picture(brdf, camera, ball.lamps, _SIZE, _MARGIN)
            made = lit if brdf.bands.is_rgb else to_srgb(lit, brdf.bands)
        else:
            made = render_floating_ball(
                file, material.bands.is_rgb, ball.light, size=_SIZE, samples=_SAMPLES, margin=_MARGIN,
                turn_deg=camera.turn_deg, elevation_deg=camera.elevation_deg, distance=camera.distance,
            )  # fmt: skip
        made = made * (of_picture / known)
        shown = [encode_srgb(np.nan_to_num(each)) for each in (crop, made)]
        across = (1.0 + _MARGIN) * (2.0 * (np.arange(_SIZE) + 0.5) / _SIZE - 1.0)
        compared = np.hypot(across, across[:, None]) < 0.97
        compared &= np.isfinite(crop).all(axis=2) & ~clipped
        seen.append(crop)
        predicted.append(made)
        errors.append(np.where(compared, images.ciede2000_map(*shown), np.nan))
    names = [ball.photograph.path.name for ball in balls]
    figures.save(residual_figure(names, seen, predicted, errors), picture)


def _cropped(values: Array, circle: Circle) -> Array:
    """Return the square around a circle, nearest pixels, NaN beyond the picture: shape (_SIZE, _SIZE, C)."""
    across = (1.0 + _MARGIN) * circle.radius * (2.0 * (np.arange(_SIZE) + 0.5) / _SIZE - 1.0)
    rows, columns = (np.floor(centre + across).astype(int) for centre in (circle.y, circle.x))
    inside = [(at >= 0) & (at < n) for at, n in zip((rows, columns), values.shape, strict=False)]
    picked = values[np.clip(rows, 0, values.shape[0] - 1)[:, None], np.clip(columns, 0, values.shape[1] - 1)]
    return np.where((inside[0][:, None] & inside[1])[..., None], picked, np.nan)


def residual_figure(
    names: Sequence[str], seen: Sequence[Array], predicted: Sequence[Array], errors: Sequence[Array]
) -> Figure:
    """Draw a row for every photograph: the photograph, its prediction, and the difference.

    The first two are linear sRGB (H, W, 3); errors are CIEDE2000, NaN where nothing was compared, (H, W).
    """
    figure = figures.new_figure(9.0, 3.1 * len(names))
    axes = figure.subplots(len(names), 3, squeeze=False)
    for row, name, photograph, prediction, error in zip(axes, names, seen, predicted, errors, strict=True):
        for axis, picture in zip(row[:2], (photograph, prediction), strict=True):
            axis.imshow(encode_srgb(np.nan_to_num(picture)), interpolation="nearest")
        shown = row[2].imshow(
            error, cmap="magma", vmin=0.0, vmax=figures.LARGEST_DELTA_E, interpolation="nearest"
        )
        figure.colorbar(shown, ax=row[2], shrink=0.8, extend="max")
        difference = f"CIEDE2000 in this light, mean {np.nanmean(error):.1f}"
        titles = figures.in_lines(name), "predicted", difference
        for axis, title in zip(row, titles, strict=True):
            axis.set_title(title, fontsize=9)
            axis.set_axis_off()
    return figure
