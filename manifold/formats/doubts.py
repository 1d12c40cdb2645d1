"""Notes on records whose values or directions are probably not what their file calls them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from manifold.core.directions import is_near_mirror
from manifold.core.names import percent
from manifold.core.records import Array
from manifold.formats.dense import DenseTable
from manifold.formats.light_side import with_light_side_note
from manifold.formats.readings import Assumption, Readings
from manifold.formats.values import is_diffuse, is_too_bright

_MANY_NEGATIVE = 0.3  # share of the values; noise of one dark band among three makes a sixth negative
_LARGE_NEGATIVE = 0.1  # share of the sum of sizes away from the mirror direction, where noise is far smaller
# Least brightness near the mirror direction, relative to that elsewhere; 1.08 and more in 20 real materials.
_DARK = 0.5
_OBLIQUE = 0.01  # sine of theta from which a direction has an azimuth
_ROUNDED = 0.006  # of numbers with two decimals: 3.14, 6.28
# In radians: a right angle, whose number in radians was read as degrees, and its rounding.
_STEEPEST = np.deg2rad(0.5 * np.pi + 0.03)


def with_doubts(record: Readings | DenseTable) -> Readings | DenseTable:
    """Return the record with notes on negative or too bright values, a dark mirror direction, and angles in radians."""
    values = record.values.reshape(-1, record.values.shape[-1])
    if record.bands.is_rgb:  # single channels of colours outside sRGB are negative
        values = values.mean(axis=1, keepdims=True)
    if isinstance(record, DenseTable):
        return replace(record, notes=(*record.notes, *_on_negative(values, 0.0)))
    near = is_near_mirror(record.wi, record.wo)
    off = np.nan_to_num(values[~near])
    large = float(np.maximum(-off, 0.0).sum() / max(np.abs(off).sum(), np.finfo(float).tiny))
    notes = _on_negative(values, large)
    theta = float(np.arccos(np.clip(min(record.wi[:, 2].min(), record.wo[:, 2].min()), 0.0, 1.0)))
    if 0.0 < theta < _STEEPEST:
        notes.append(
            Assumption(
                f"all directions are within {np.rad2deg(theta):.3g} degrees of the normal: are the angles radians?"
            )
        )
    else:
        notes += _on_azimuths(record.wi, record.wo)
    median = np.median(record.values, axis=1, keepdims=True)
    if is_too_bright(record.wi, record.wo, median):
        times = np.pi * float(np.nanmedian(median[is_diffuse(record.wi, record.wo)]))
        notes.append(
            Assumption(
                f"{times:.3g} times as bright as a perfect diffuser, away from the mirror direction: check the unit"
            )
        )
    noted = with_light_side_note(record)
    if noted is record:
        notes += _on_mirror(values[near], values[~near])
    return replace(noted, notes=(*noted.notes, *notes)) if notes else noted


def _on_azimuths(wi: Array, wo: Array) -> list[str]:
    """Return a note if the largest angle with the plane of incidence is pi/2, pi or 2 pi as a number of degrees."""
    oblique = np.minimum(np.hypot(wi[:, 0], wi[:, 1]), np.hypot(wo[:, 0], wo[:, 1])) > _OBLIQUE
    if not oblique.any():
        return []
    azimuths = (np.arctan2(w[oblique, 1], w[oblique, 0]) for w in (wo, wi))
    between = np.abs(np.subtract(*azimuths)) % np.pi
    largest = float(np.rad2deg(np.minimum(between, np.pi - between).max()))
    if min(abs(largest - turn * np.pi) for turn in (0.5, 1.0, 2.0)) > _ROUNDED:
        return []
    return [
        Assumption(
            f"all azimuths are within {largest:.3g} degrees of the plane of incidence: are they radians?"
        )
    ]


def _on_negative(values: Array, large: float) -> list[str]:
    """Return a note if more values (n, B) are negative than noise explains; `large` is their share in the sum."""
    measured = values[np.isfinite(values)]
    share = float(np.mean(measured < 0.0)) if measured.size else 0.0
    if share < _MANY_NEGATIVE and large < _LARGE_NEGATIVE:
        return []
    return [
        Assumption(
            f"{percent(share)} of the values are negative, more than noise explains: are they densities "
            "(logarithms), or was a baseline subtracted?"
        )
    ]


def _on_mirror(near: Array, off: Array) -> list[str]:
    """Return a note if values (n, B) near the mirror direction are below those elsewhere."""
    if not np.any(np.isfinite(near)) or not np.any(np.isfinite(off)):
        return []
    bright, usual = float(np.nanmedian(near)), float(np.nanmedian(off))
    if usual <= 0.0 or bright >= _DARK * usual:
        return []
    found = "negative" if bright < 0.0 else f"{bright / usual:.2g} times as bright as elsewhere"
    return [
        Assumption(
            f"the mirror direction is {found}, where materials are brightest: are the values densities (logarithms), "
            "or azimuths not counted from the light?"
        )
    ]
