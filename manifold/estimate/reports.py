"""Writes reports on readings and their completion, one HTML page each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.notebook import ball_image, sun_image
from manifold.colour.difference import lab_values
from manifold.colour.panel import SUN_DEG
from manifold.core.directions import NEAR_MIRROR_DEG, angles_from_mirror, from_spherical
from manifold.core.records import Array, evenly_spaced
from manifold.estimate.gloss import gloss_units
from manifold.formats.readings import GLOSS_ANGLES_DEG, NO_GLOSS, GlossUnits, Readings
from manifold.io_rgl import read_bsdf
from manifold.pictures import html_page
from manifold.pictures.html_page import Section
from manifold.render import backend, images
from manifold.render.ball import render_material
from manifold.render.render import RenderSettings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from manifold.estimate.coat import Coated
    from manifold.estimate.completion import Completion
    from manifold.estimate.completions import Completed
    from manifold.estimate.instruments import CalibratedInstrument
    from manifold.estimate.left_out_readings import LeftOutReadings

_BALL, _WIDTH = 256, 192  # pixels of a ball, and on the page
_WIDE = 800  # pixels of a figure on the page
_COARSE_BALL = 96  # without Mitsuba
_SUN_SHARE = 0.625  # of the frame's width that the ball fills, as in the studio
_BACKGROUND = 0.12
_MOST_READINGS = 60  # rows of a table: of more readings, those that differ most
_FLOP_DEG = (15.0, 45.0, 110.0)
_MOST_INCIDENCES, _MOST_SPECTRA = 4, 6  # lines of a figure
_GRAZING_DEG = 80.0  # largest outgoing angle of curves
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#000000")


def write_completion(path: Path, completed: Completed, sources: Sequence[Path] = ()) -> None:
    """Write the report on a completion of readings and photographs; `sources` are the files of the readings."""
    assert completed.path is not None
    completion, brdf = completed.completion, MeasuredBRDF(read_bsdf(completed.path))
    rows: dict[str, object] = {"from": [source.name for source in sources]} if sources else {}
    rows |= completed.rows
    if completed.repeatability is not None:
        rows["repeatability"] = f"{100 * completed.repeatability:g} % of a reading"
    sections = [
        Section("Sample", rows),
        balls(brdf),
        *([] if completed.readings is None else _of_colours(completion, completed.left_out_readings)),
        *_suggested(completed),
        gloss(brdf, completion.evidence.gloss),
        Section(
            "Most probable mixtures",
            heads=("mixture", "probability", "residual", "ball from mean"),
            notes=[
                "Before they are adjusted to the observations; the last column is the cube-root difference of the ball "
                "from that of the mean mixture."
            ] * bool(completion.alternatives),
            table=[
                (
                    " + ".join(f"{weight:.2f} {name}" for name, weight in mixture.like), f"{mixture.probability:.2f}",
                    f"{100 * mixture.misfit:.1f} %", f"{100 * mixture.difference:.0f} %",
                )
                for mixture in completion.alternatives
            ],
        ),
        Section("Notes", notes=completed.diagnostics),
    ]  # fmt: skip
    if completion.evidence.pictures and completed.picture is not None:
        shown = html_page.picture(
            images.read_display(completed.picture), "photographs and predictions", _WIDE
        )
        drawn = Section("Photographs", pictures=[("photographs, predictions and differences", shown)])
        sections.insert(-1, drawn)
    observed = " and ".join(
        ["readings"] * (completed.readings is not None) + ["photographs"] * bool(completion.evidence.pictures)
    )
    title = completed.sample or completed.path.stem
    html_page.write(path, title, f"{completed.path.name}, completed from {observed}.", sections)


def _suggested(completed: Completed) -> list[Section]:
    """Return the directions that were suggested to measure next."""
    if completed.suggested is None:
        return []
    table = [tuple(f"{angle:.0f}" for angle in row) for row in completed.suggested.angles_deg]
    title = "Directions to measure next, in degrees; azimuth 0 on the side of the mirror direction"
    return [Section(title, heads=("incidence", "outgoing", "azimuth"), table=table)]


def write_coat(path: Path, coated: Coated) -> None:
    """Write the report on a material made from a colour and a gloss."""
    brdf = MeasuredBRDF(read_bsdf(coated.path))
    sections = [
        Section("Sample", coated.rows),
        balls(brdf),
        gloss(brdf, coated.sample.gloss),
        Section("Notes", notes=coated.diagnostics),
    ]
    html_page.write(path, coated.sample.name, f"{coated.path.name}, made of a colour and gloss.", sections)


def write_calibration(path: Path, calibrated: CalibratedInstrument) -> None:
    """Write the report on a colour correction that was learned from samples."""
    sections = [
        Section(
            "Leave-one-out relative error",
            heads=("form", "error", "chosen"),
            table=[
                (
                    form,
                    "" if error != error else f"{error:.4f}",
                    "chosen" * (form == calibrated.form),
                )
                for form, error in calibrated.errors.items()
            ],
        ),
        Section(
            "CIEDE2000 (D65/2) to the reference, left out, mean over readings",
            heads=("sample", "uncorrected", "corrected"),
            table=[
                (name, *("" if off != off else f"{off:.2f}" for off in row))
                for name, row in calibrated.ciede2000
            ],
        ),
        Section("Notes", notes=calibrated.notes),
    ]
    html_page.write(path, "Colour correction", f"Learned from {len(calibrated.samples)} samples.", sections)


def balls(brdf: BRDF) -> Section:
    """Return a section with the rendered ball of a material in the studio and under a sun."""
    studio = studio_ball(brdf)
    margin = round(0.5 * _BALL * (1.0 - _SUN_SHARE))
    size = _BALL - 2 * margin
    sun, is_lit = sun_image(brdf, size, SUN_DEG)
    across = 2.0 * (np.arange(size) + 0.5) / size - 1.0
    beside = np.hypot(across, across[:, None])[..., None] > 1.0
    framed = np.pad(
        np.where(is_lit[..., None], sun, np.where(beside, _BACKGROUND, 0.0)),
        ((margin, margin), (margin, margin), (0, 0)),
        constant_values=_BACKGROUND,
    )
    shown = [studio, framed]
    names = ("in the studio", f"under a sun {SUN_DEG:g} degrees beside the view")
    pictures = [
        (name, html_page.picture(image, f"ball {name}", _WIDTH))
        for name, image in zip(names, shown, strict=True)
    ]
    return Section("Ball", pictures=pictures)


def studio_ball(brdf: BRDF) -> Array:
    """Return display values (H, W, 3) of a material's ball in the studio, rendered by Mitsuba if available."""
    if backend.is_available():
        return images.tone_map(render_material(brdf, RenderSettings(size=_BALL)))
    image, inside = ball_image(brdf, _COARSE_BALL)
    return np.where(inside[..., None], image, _BACKGROUND)


def write_index(path: Path, made: Sequence[tuple[str, str, str, str]]) -> None:
    """Write an index page with a card for each report: its picture, link, name and a line of text."""
    cards = "".join(
        html_page.card(ball, f"ball of {name}", link, name, text) for ball, link, name, text in made
    )
    html_page.write(path, "Completions", f"{len(made)} reports.", f"<main>{cards}</main>")


def _of_colours(made: Completion, left_out: LeftOutReadings | None) -> list[Section]:
    """Return readings beside the completion: a figure over angles, spectra, and a table."""
    if made.colours is None or made.colour_misfits is None:
        return []
    read, found = made.colours
    off, predicted = made.colour_misfits, None if left_out is None else left_out.ciede2000
    angles = angles_of(made.readings.wi, made.readings.wo)
    shown = np.arange(len(off))
    title = f"Colours (L*, a*, b* under {made.viewing}), readings and completion"
    if len(off) > _MOST_READINGS:
        shown = np.sort(np.argsort(off)[::-1][:_MOST_READINGS])
        title += f": the {_MOST_READINGS} of {len(off)} readings that differ most"
    table = [
        (
            *(f"{angle:.0f}" for angle in angles[k, :3]),
            "" if np.isnan(angles[k, 3]) else f"{angles[k, 3]:.0f}",
            *(f"{value:.1f}" for value in (*read[k], *found[k])),
            f"{off[k]:.2f}",
            *([] if predicted is None else [f"{predicted[k]:.2f}"]),
        )
        for k in shown
    ]
    lab = ("L* read", "a*", "b*", "L* completed", "a*", "b*")
    heads: tuple[str, ...] = (
        "incidence",
        "outgoing",
        "azimuth",
        "aspecular",
        *lab,
        f"CIEDE2000 ({made.viewing})",
    )
    if predicted is not None:
        heads = (*heads, "predicted from the others")
    rows = {}
    if (flop := flop_index(angles, read)) is not None:
        rows["flop index"] = (
            f"{flop:.2f} read, {flop_index(angles, found):.2f} completed (2.69 (L15 - L110)^1.11 / L45^0.86)"
        )
    figures = [
        (
            "over the aspecular angle; lines: completed, band: within the factor of 90 % probability, dots: readings; "
            f"highlights within {NEAR_MIRROR_DEG:g} degrees of the mirror direction may exceed the frame",
            _colour_figure(made, angles, read),
        )
    ]
    if made.readings.wavelengths_nm is not None:
        spectra = _spectra_figure(made.readings, made.predicted, angles)
        some = min(_MOST_SPECTRA, len(off))
        which = "" if some == len(off) else f" at {some} of {len(off)} geometries, evenly chosen"
        figures.append((f"reflectance factors{which}; lines: completed, dots: readings", spectra))
    pictures = [(caption, html_page.drawing(figure)) for caption, figure in figures if figure is not None]
    return [Section("Over angles", rows, pictures=pictures), Section(title, heads=heads, table=table)]


def _colour_figure(made: Completion, angles: Array, read: Array) -> Figure | None:
    """Draw CIELAB of the completion over aspecular angles, a line per incidence, beside that of readings (P, 3).

    None if they lie out of the plane.
    """
    incidences = np.round(angles[:, 0])
    in_plane = np.isfinite(angles[:, 3])
    known = np.unique(incidences[in_plane])
    if not len(known):
        return None
    from manifold.pictures.figures import new_figure  # Matplotlib, which takes as long to load as all else

    figure = new_figure(8.5, 2.7)
    axes = figure.subplots(1, 3)
    shown = [read[in_plane]]
    picked = evenly_spaced(len(known), _MOST_INCIDENCES)
    for colour, incidence in zip(_COLOURS, known[picked], strict=False):
        aspecular, lab, lightness = _along_plane(made, float(incidence))
        shown.append(lab[np.abs(aspecular) > NEAR_MIRROR_DEG])
        own = in_plane & (incidences == incidence)
        axes[0].fill_between(aspecular, *lightness, color=colour, alpha=0.15, linewidth=0.0)
        for k, one in enumerate(axes):
            one.plot(aspecular, lab[:, k], color=colour, linewidth=1.4, label=f"incidence {incidence:g}°")
            one.plot(angles[own, 3], read[own, k], "o", color=colour, markersize=4)
    of_all = np.vstack(shown)
    for k, (name, one) in enumerate(zip(("L*", "a*", "b*"), axes, strict=True)):
        low, high = float(of_all[:, k].min()), float(of_all[:, k].max())
        margin = 0.1 * (high - low) + 2.0
        one.set_ylim(low - margin, high + margin)
        one.set_title(name, fontsize=10)
        one.set_xlabel("aspecular angle (°)", fontsize=9)
        one.grid(alpha=0.25)
    axes[0].legend(fontsize=8)
    return figure


def _along_plane(made: Completion, incidence_deg: float) -> tuple[Array, Array, tuple[Array, Array]]:
    """Return aspecular angles (P,), every degree, CIELAB of the completion there (P, 3), and bounds of L*, (P,) each.

    The bounds are those of `Completion.factors_at`.
    """
    outgoing = np.arange(-_GRAZING_DEG, _GRAZING_DEG + 1.0)
    wo = from_spherical(np.deg2rad(outgoing), 0.0)
    wi = np.broadcast_to(from_spherical(np.deg2rad(incidence_deg), np.pi), wo.shape)
    brdf, nm = made.written or made.brdf, made.readings.wavelengths_nm
    f, factors = np.maximum(brdf.eval(wi, wo), 0.0), made.factors_at(wi, wo)[:, None]
    if nm is not None:
        f = np.array([np.interp(nm, np.array(brdf.bands.wavelengths_nm), row) for row in f])
    lab, low, high = (
        lab_values(values, made.readings.bands, made.viewing) for values in (f, f / factors, f * factors)
    )
    return incidence_deg - outgoing, lab, (low[:, 0], high[:, 0])


def _spectra_figure(readings: Readings, found: Array, angles: Array) -> Figure:
    """Draw reflectance factors of readings and completion (P, B), in 1/sr, at some geometries, evenly chosen."""
    from manifold.pictures.figures import new_figure

    figure = new_figure(8.5, 3.0)
    axes = figure.subplots()
    nm = np.asarray(readings.wavelengths_nm)
    picked = evenly_spaced(len(readings), _MOST_SPECTRA)
    for colour, k in zip(_COLOURS, picked, strict=False):
        label = f"incidence {angles[k, 0]:.0f}°, outgoing {angles[k, 1]:.0f}°"
        label += (
            f", azimuth {angles[k, 2]:.0f}°" if np.isnan(angles[k, 3]) else f", aspecular {angles[k, 3]:.0f}°"
        )
        axes.plot(nm, np.pi * found[k], color=colour, linewidth=1.4, label=label)
        axes.plot(nm, np.pi * readings.values[k], "o", color=colour, markersize=3)
    axes.set_xlabel("wavelength (nm)", fontsize=9)
    axes.set_ylabel("reflectance factor", fontsize=9)
    axes.grid(alpha=0.25)
    axes.legend(fontsize=8, ncols=2)
    return figure


def angles_of(wi: Array, wo: Array) -> Array:
    """Return polar angles in and out, azimuths from the mirror side, and aspecular angles in degrees, (P, 4).

    The aspecular angle is counted from the mirror direction towards the light; it is NaN outside the plane of
    incidence.
    """
    theta_i, theta_o, azimuth = angles_from_mirror(wi, wo).T
    azimuth[(theta_i < 0.5) | (theta_o < 0.5)] = 0.0
    signed = np.where(azimuth < 90.0, theta_o, -theta_o)
    in_plane = np.minimum(azimuth, 180.0 - azimuth) < 1.0
    return np.column_stack([theta_i, theta_o, azimuth, np.where(in_plane, theta_i - signed, np.nan)])


def flop_index(angles: Array, lab: Array) -> float | None:
    """Return the flop index, how much a coating darkens away from the highlight (Alman 1987).

    Returns None if the necessary angles are missing.
    """
    lightness = []
    for wanted in _FLOP_DEG:
        near = (np.abs(angles[:, 0] - 45.0) < 1.0) & (np.abs(angles[:, 3] - wanted) < 1.0)
        if not near.any():
            return None
        lightness.append(float(lab[near, 0].mean()))
    bright, middle, dark = lightness
    return float(2.69 * max(bright - dark, 0.0) ** 1.11 / max(middle, 1e-3) ** 0.86)


def gloss(brdf: BRDF, read: GlossUnits = NO_GLOSS) -> Section:
    """Return a section with the gloss units of a material, beside the measured ones, by angle in degrees."""
    units_by_angle = gloss_units(brdf, GLOSS_ANGLES_DEG)
    measured = {
        angle: [f"{read[angle]:.3g}" if angle in read else "not read"] for angle in units_by_angle if read
    }
    return Section(
        "Gloss (ISO 2813)",
        heads=("angle", *["measured"] * bool(read), "of the BRDF"),
        table=[
            (f"{angle:g}", *measured.get(angle, []), f"{units:.3g}")
            for angle, units in units_by_angle.items()
        ],
    )
