"""Uses the colours of an instrument's own pictures in place of missing spectra."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from manifold.colour.conversion import to_srgb
from manifold.colour.narrow_bands import in_daylight
from manifold.colour.reflectances import spectral_changes, weights_at
from manifold.core.defaults import DARKEST
from manifold.core.errors import FileFormatError
from manifold.core.records import Array
from manifold.estimate.residual import coordinates
from manifold.formats.readings import Readings
from manifold.formats.workbook_pictures import picture_directions, picture_geometry, picture_values

_SAME_PLACE = 0.1  # largest distance in correlation lengths: 1 degree
_MOST_FACTOR = 1.5  # largest factor between a picture's mean and the colour of its reading
_SCATTER = 0.01  # relative deviation of cube roots: means over readings vary by 3 % between pictures
_VISIBLE_NM = (460.0, 605.0)  # within which spectra have to reach to be changed as colours say


def reading_at(readings: Readings, wi: Array, wo: Array) -> int | None:
    """Return the index of the measured reading at a direction pair of an isotropic, reciprocal sample, or None."""
    apart = np.linalg.norm(coordinates(readings.wi, readings.wo) - coordinates(wi, wo), axis=-1)
    apart[~readings.measured.any(axis=1)] = np.inf
    nearest = int(np.argmin(apart))
    return nearest if apart[nearest] < _SAME_PLACE else None


def colour_of(readings: Readings, reading: int | None) -> Array:
    """Return the linear sRGB colour (3,) of a reading under D65, 1 for a white diffuser; NaN for gaps or no reading."""
    if reading is None:
        return np.full(3, np.nan)
    readings = in_daylight(readings)
    return np.asarray(np.pi * to_srgb(readings.values[reading], readings.bands))


def odd_picture(labels: tuple[str, ...], factors: Array) -> str | None:
    """Return a reason why one of J pictures does not belong to the readings; None if all belong.

    `factors` (J, 3) are the ratios of each picture's mean colour to the colour of its reading; NaN without a reading.
    """
    grey = factors.mean(axis=-1)
    relative = grey / np.nanmedian(grey)
    for label, value in zip(labels, relative, strict=True):
        if value > _MOST_FACTOR or value < 1.0 / _MOST_FACTOR:
            return (
                f"the picture {label} is {value:.2f} times as bright as its reading says, relative to the others; "
                "pictures and readings do not belong together"
            )
    return None


def with_picture_colours(readings: Readings) -> Readings:
    """Add readings from the colours of pictures at geometries that lack a spectrum.

    The factor between pictures and readings is the median over the pictures that have a reading. Each new spectrum is
    the spectrum of the reading with the nearest colour, scaled by the difference in colour.
    """
    images: Mapping[str, bytes] = readings.texture.get("images", {})
    found = {c: g for c in images if (g := picture_geometry(c)) is not None and not np.isnan(g[1])}
    nm = readings.wavelengths_nm
    if nm is None or nm[0] > _VISIBLE_NM[0] or nm[-1] < _VISIBLE_NM[1]:
        return readings
    at = [picture_directions(*geometry) for geometry in found.values()]
    read = [reading_at(readings, *pair) for pair in at]
    missing = [k for k, reading in enumerate(read) if reading is None]
    if len(missing) in (0, len(found)):
        return readings
    try:
        seen = np.array([picture_values(images[caption]).mean(axis=(0, 1)) for caption in found])
    except FileFormatError as error:
        return readings.with_note(f"a picture {error}; no picture replaces a missing spectrum")
    factors = seen / np.array([colour_of(readings, reading) for reading in read])
    factor = np.nanmedian(factors, axis=0)
    if np.any(np.abs(np.log(factor)) > np.log(_MOST_FACTOR)) or odd_picture(tuple(found), factors):
        return readings.with_note(
            "the pictures do not match the readings (a different sample?) and are not used"
        )
    whole = readings.values[readings.measured.all(axis=1)]
    colours = np.maximum(np.pi * to_srgb(whole, readings.bands), DARKEST)
    weights = weights_at(nm)
    made = []
    for colour in np.maximum(seen[missing] / factor, DARKEST):
        nearest = int(np.argmin(np.linalg.norm(np.log(colours / colour), axis=1)))
        spectrum = whole[nearest]
        made.append(
            spectrum * (weights @ spectral_changes(colour / colours[nearest], spectrum, readings.bands))
        )
    names = list(found)
    kept = readings.select_pairs(np.flatnonzero(readings.measured.any(axis=1)))
    return replace(
        kept,
        wi=np.vstack([kept.wi, *(at[k][0][None] for k in missing)]),
        wo=np.vstack([kept.wo, *(at[k][1][None] for k in missing)]),
        values=np.vstack([kept.values, *made]),
        weights=np.append(kept.weights, np.ones(len(missing))),
        scatter=np.append(kept.scatter, np.full(len(missing), _SCATTER)),
    ).with_note(
        f"no spectrum at {', '.join(names[k] for k in missing)}: taken from the colours of the pictures there"
    )
