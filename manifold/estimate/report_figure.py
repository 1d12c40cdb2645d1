"""Figures of reports: colours over the aspecular angle, and spectra."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from manifold.formats.readings import Readings
from manifold.plots.figures import new_figure
from manifold.records import Array, evenly_spaced

_MOST_INCIDENCES, _MOST_SPECTRA = 4, 6
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#000000")


def colours(angles: Array, read: Array, found: Array) -> Figure | None:
    """CIELAB of readings and completion over the aspecular angle, a line per incidence; None out of the plane.

    Args:
        angles: see `reports.angles_of`, shape (P, 4).
        read, found: CIELAB, shape (P, 3).
    """
    incidences = np.round(angles[:, 0])
    in_plane = np.isfinite(angles[:, 3])
    common = [i for i in np.unique(incidences[in_plane]) if np.sum(in_plane & (incidences == i)) > 1]
    if not common:
        return None
    figure = new_figure(8.5, 2.7)
    axes = figure.subplots(1, 3)
    picked = evenly_spaced(len(common), _MOST_INCIDENCES)
    for colour, incidence in zip(_COLOURS, np.array(common)[picked], strict=False):
        own = np.flatnonzero(in_plane & (incidences == incidence))
        own = own[np.argsort(angles[own, 3])]
        for k, one in enumerate(axes):
            one.plot(
                angles[own, 3], found[own, k], color=colour, linewidth=1.4, label=f"incidence {incidence:g}°"
            )
            one.plot(angles[own, 3], read[own, k], "o", color=colour, markersize=4)
    for name, one in zip(("L*", "a*", "b*"), axes, strict=True):
        one.set_title(name, fontsize=10)
        one.set_xlabel("aspecular angle (°)", fontsize=9)
        one.grid(alpha=0.25)
    axes[0].legend(fontsize=8)
    return figure


def spectra(readings: Readings, found: Array, angles: Array) -> Figure:
    """Reflectance factors of readings and completion at some geometries, evenly chosen.

    Args:
        readings: in B bands.
        found: of the completion there, in 1/sr, shape (P, B).
        angles: as of `colours`.
    """
    figure = new_figure(8.5, 3.0)
    axes = figure.subplots()
    nm = np.asarray(readings.wavelengths_nm)
    picked = evenly_spaced(len(readings), _MOST_SPECTRA)
    for colour, k in zip(_COLOURS, picked, strict=False):
        label = f"{angles[k, 0]:.0f} / {angles[k, 1]:.0f}°, azimuth {angles[k, 2]:.0f}°"
        axes.plot(nm, np.pi * found[k], color=colour, linewidth=1.4, label=label)
        axes.plot(nm, np.pi * readings.values[k], "o", color=colour, markersize=3)
    axes.set_xlabel("wavelength (nm)", fontsize=9)
    axes.set_ylabel("reflectance factor", fontsize=9)
    axes.grid(alpha=0.25)
    axes.legend(fontsize=8, ncols=2)
    return figure
