"""Draws BRDF values: slices in the plane of incidence, the Rusinkiewicz plane, or spectra at fixed geometries."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from manifold.brdf.interface import EvaluableBRDF
from manifold.colour.conversion import to_srgb
from manifold.core.directions import from_rusinkiewicz, from_spherical
from manifold.core.errors import UsageError
from manifold.core.records import Array
from manifold.model.diagnostics import DiagnosedPrediction
from manifold.pictures.figures import in_lines, new_figure

INCIDENCES_DEG = (20.0, 40.0, 60.0)
GEOMETRIES_DEG = ((45.0, 0.0), (45.0, -30.0), (45.0, 45.0), (60.0, 75.0))
"""(theta_i, theta_o) of spectra, in the plane of incidence, theta_o positive on the mirror side."""

# Nearer to the horizon f = f_cos / cos of a file is what its cells beyond the horizon say (explanation/rgl-files.md).
_ELEVATIONS_DEG = np.linspace(-85.0, 85.0, 341)
_DECADES = 5.0  # most decades of a logarithmic axis
_BRIGHTEST = 3.0  # white of a Rusinkiewicz image, in times the median cube root
_LEGEND_LETTERS = 115  # letters in the width of a figure
_IMAGE = 180  # pixels of a Rusinkiewicz image per side
# Okabe & Ito: distinct for colour-blind readers; line styles distinguish them without colour.
_COLOURS = ("#000000", "#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00")
_STYLES = ("-", "--", "-.", ":", (0, (5, 1)), (0, (1, 1)))


@dataclass(frozen=True, eq=False)
class ShownBRDF:
    """A BRDF to be drawn, with its label and, if it is predicted, the prediction."""

    label: str
    brdf: EvaluableBRDF
    prediction: DiagnosedPrediction | None = None


def angle_slices(sources: Sequence[ShownBRDF], wavelengths_nm: Sequence[float] = ()) -> Figure:
    """Draw f over the outgoing angle in the plane of incidence, to 85 degrees, at incidences of 20, 40 and 60 degrees.

    Angles are positive on the mirror side of the normal. There is one row per channel of linear sRGB under D65, or
    one per wavelength if wavelengths are given.
    """
    _require_sources(sources)
    rows = _channel_names(wavelengths_nm)
    figure = new_figure(10, 1.2 + 2.3 * len(rows))
    grid = figure.subplots(len(rows), len(INCIDENCES_DEG), sharex=True, sharey="row", squeeze=False)
    draw_slices(figure, grid, sources, wavelengths_nm)
    return figure


def draw_slices(
    figure: Figure | SubFigure,
    grid: Array,
    sources: Sequence[ShownBRDF],
    wavelengths_nm: Sequence[float] = (),
) -> None:
    """Draw `angle_slices` into axes (rows, 3) of a figure, or of a part of one."""
    rows = _channel_names(wavelengths_nm)
    for source, colour, style in zip(sources, _COLOURS, _STYLES, strict=False):
        values = _slices_of(source.brdf, wavelengths_nm)
        for column_of_axes, of_incidence in zip(grid.T, values, strict=True):
            for axes, f in zip(column_of_axes, of_incidence.T, strict=True):
                axes.plot(_ELEVATIONS_DEG, f, color=colour, linestyle=style, linewidth=1.6)
    for column, incidence in enumerate(INCIDENCES_DEG):
        grid[0, column].set_title(f"incidence {incidence:g}°", fontsize=11)
        grid[-1, column].set_xlabel("outgoing angle (°)" + ", mirror side positive" * (column == 1))
    if any(np.isnan(line.get_ydata()).any() for each in grid for axes in each for line in axes.lines):
        grid[-1, 2].set_xlabel("outgoing angle (°); gaps: not measured")
    for row, name in enumerate(rows):
        _logarithmic(grid[row])
        grid[row, 0].set_ylabel(f"{name}: $f$ (1/sr)")
        for axes, incidence in zip(grid[row], INCIDENCES_DEG, strict=True):
            axes.axvline(incidence, color="0.75", linewidth=0.8, zorder=0)
            axes.set_xticks(np.arange(-90, 91, 30))
            axes.grid(alpha=0.25, linewidth=0.5)
    _legend(figure, grid[0, 0], sources)


def rusinkiewicz_images(sources: Sequence[ShownBRDF]) -> Figure:
    """Draw the cube root of f as a colour over theta_h (right) and theta_d (down), at phi_d = 90 degrees.

    All images share one exposure: white is the value that 0.5 % of the values below theta_d = 75 degrees exceed, or
    three times their median, so that colours beside highlights are visible. Unmeasured values (NaN) are white.
    """
    _require_sources(sources)
    figure = new_figure(3.1 * len(sources) + 0.6, 3.7)
    # theta_h by squares: highlights fill a visible strip.
    across = (np.arange(_IMAGE) + 0.5) / _IMAGE
    theta_h, theta_d = np.meshgrid(0.5 * np.pi * across**2, 0.5 * np.pi * across)
    wi, wo = from_rusinkiewicz(theta_h.ravel(), theta_d.ravel(), np.full(_IMAGE**2, 0.5 * np.pi))
    above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
    images = []
    for source in sources:
        rgb = np.zeros((_IMAGE**2, 3))
        rgb[above] = np.maximum(to_srgb(source.brdf.eval(wi[above], wo[above]), source.brdf.bands), 0.0)
        images.append(np.cbrt(rgb))
    assessed = above & (theta_d.ravel() < np.deg2rad(75.0))
    white = max(
        min(
            float(np.nanpercentile(image[assessed], 99.5)),
            _BRIGHTEST * float(np.nanmedian(image[assessed].max(axis=1))),
        )
        for image in images
    )
    grid = figure.subplots(1, len(sources), sharey=True, squeeze=False)[0]
    ticks = np.array([0.0, 5.0, 20.0, 45.0, 90.0])
    for axes, image, source in zip(grid, images, sources, strict=True):
        is_known = above & ~np.isnan(image).any(axis=1)
        shown = np.where(is_known[:, None], np.clip(image / max(white, 1e-12), 0.0, 1.0), 1.0)
        axes.imshow(
            shown.reshape(_IMAGE, _IMAGE, 3), extent=(0, 1, 90, 0), aspect="auto", interpolation="nearest"
        )
        axes.set_title(in_lines(source.label, 36), fontsize=10)
        axes.set_xticks(np.sqrt(ticks / 90.0), [f"{t:g}" for t in ticks])
        axes.set_yticks([0, 30, 60, 90])
        axes.set_xlabel(r"half angle $\theta_h$ (°)")
    grid[0].set_ylabel(r"difference angle $\theta_d$ (°)")
    return figure


def spectra_at(sources: Sequence[ShownBRDF]) -> Figure:
    """Draw f over wavelength at four geometries in the plane of incidence; with RGB sources, over the channels.

    Spectral sources beside RGB ones are converted to linear sRGB.
    """
    _require_sources(sources)
    is_rgb = any(source.brdf.bands.is_rgb for source in sources)
    figure = new_figure(10, 6)
    grid = figure.subplots(2, 2, sharex=True)
    marker = "o" if is_rgb else None
    for source, colour, style in zip(sources, _COLOURS, _STYLES, strict=False):
        x, spectra = _spectra_of(source.brdf, is_rgb=is_rgb)
        for axes, f in zip(grid.flat, spectra, strict=True):
            axes.plot(x, f, color=colour, linestyle=style, linewidth=1.6, marker=marker)
    for axes, (theta_i, theta_o) in zip(grid.flat, GEOMETRIES_DEG, strict=True):
        side = ", mirror direction" if theta_o == theta_i else ""
        axes.set_title(rf"$\theta_i$ = {theta_i:g}°, $\theta_o$ = {theta_o:g}°{side}", fontsize=11)
        axes.set_ylabel("$f$ (1/sr)")
        axes.set_ylim(bottom=0.0)
        axes.grid(alpha=0.25, linewidth=0.5)
        if is_rgb:
            axes.set_xticks(np.arange(3), ["R", "G", "B"])
    for axes in grid[-1]:
        axes.set_xlabel("channel of linear sRGB" if is_rgb else "wavelength (nm)")
    _legend(figure, grid[0, 0], sources)
    return figure


def curves(
    kind: str, sources: Sequence[ShownBRDF], wavelengths_nm: Sequence[float] = ()
) -> dict[str, Any] | None:
    """Return the values that `angle_slices` (kind `angles`) or `spectra_at` (`spectra`) draw; None for images.

    `f` holds values in 1/sr by label. For angles its axes are incidence, outgoing angle and channel; for spectra they
    are geometry and wavelength (or channel), with the wavelengths by label (None for linear sRGB). Unmeasured values
    are NaN.
    """
    if kind == "image":
        return None
    if kind == "angles":
        return {
            "incidence_deg": INCIDENCES_DEG, "outgoing_deg": _ELEVATIONS_DEG,
            "channels": _channel_names(wavelengths_nm),
            "f": {source.label: _slices_of(source.brdf, wavelengths_nm) for source in sources},
        }  # fmt: skip
    is_rgb = any(source.brdf.bands.is_rgb for source in sources)
    nm = {source.label: None if is_rgb else source.brdf.bands.wavelengths_nm for source in sources}
    return {
        "geometries_deg": GEOMETRIES_DEG,
        "wavelengths_nm": nm,
        "f": {source.label: _spectra_of(source.brdf, is_rgb=is_rgb)[1] for source in sources},
    }


def _channel_names(wavelengths_nm: Sequence[float]) -> list[str]:
    return [f"{w:g} nm" for w in wavelengths_nm] or ["R", "G", "B"]


def _slices_of(brdf: EvaluableBRDF, wavelengths_nm: Sequence[float]) -> Array:
    """Return f at every incidence and outgoing angle in the drawn channels, shape (3, P, rows)."""
    wo = _outgoing(_ELEVATIONS_DEG)
    return np.array(
        [
            _channels(brdf, brdf.eval(from_spherical(np.deg2rad(incidence), 0.0), wo), wavelengths_nm)
            for incidence in INCIDENCES_DEG
        ]
    )


def _spectra_of(brdf: EvaluableBRDF, *, is_rgb: bool) -> tuple[Array, Array]:
    """Return wavelengths or channels (B,), and f of each geometry in these bands, (4, B)."""
    theta_i, theta_o = np.array(GEOMETRIES_DEG).T
    f = brdf.eval(from_spherical(np.deg2rad(theta_i), 0.0), _outgoing(theta_o))
    if is_rgb:
        return np.arange(3.0), to_srgb(f, brdf.bands)
    return np.asarray(brdf.bands.wavelengths_nm), f


def _require_sources(sources: Sequence[ShownBRDF]) -> None:
    if not 1 <= len(sources) <= len(_COLOURS):
        raise UsageError(f"found {len(sources)} materials to draw, expected 1 to {len(_COLOURS)}")


def _outgoing(theta_deg: Array) -> Array:
    """Return directions in the plane of incidence, positive angles on the mirror side of the normal, shape (..., 3)."""
    return from_spherical(np.deg2rad(theta_deg), np.pi)


def _channels(brdf: EvaluableBRDF, f: Array, wavelengths_nm: Sequence[float]) -> Array:
    """Return values to draw, shape (P, rows)."""
    if not wavelengths_nm:
        return to_srgb(f, brdf.bands)
    if brdf.bands.wavelengths_nm is None:
        raise UsageError("--bands: an RGB material has no wavelengths; leave the option out")
    known = np.asarray(brdf.bands.wavelengths_nm)
    outside = [w for w in wavelengths_nm if not known[0] <= w <= known[-1]]
    if outside:
        raise UsageError(f"band {outside[0]:g} nm, expected {known[0]:.1f} to {known[-1]:.1f} nm")
    return np.stack([f[:, int(np.argmin(np.abs(known - w)))] for w in wavelengths_nm], axis=-1)


def _logarithmic(row: Sequence[Axes]) -> None:
    """Set a logarithmic axis that shows all values of a row, five decades at most."""
    values = np.concatenate([line.get_ydata() for axes in row for line in axes.lines])
    positive = values[values > 0]
    if positive.size == 0:
        return
    top = float(positive.max())
    bottom = max(float(positive.min()), top * 10.0**-_DECADES)
    for axes in row:
        axes.set_yscale("log")
        axes.set_ylim(bottom / 1.5, top * 1.5)


def _legend(figure: Figure | SubFigure, axes: Axes, sources: Sequence[ShownBRDF]) -> None:
    lines = axes.lines[: len(sources)]
    labels = [in_lines(source.label, 80) for source in sources]
    longest = max(len(line) for label in labels for line in label.split("\n"))
    columns = int(np.clip(_LEGEND_LETTERS // (longest + 6), 1, 4))
    figure.legend(lines, labels, loc="outside upper center", ncols=min(len(sources), columns), frameon=False)
