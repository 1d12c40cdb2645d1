"""Detects readings towards the light that are zero behind the receiver, or bright because of wrong azimuths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from manifold.core.directions import cos_from_mirror
from manifold.core.records import Array, Mask
from manifold.formats.dense import DenseTable
from manifold.formats.readings import Readings

_LEAST_PAIRS = 50  # fewer are a spectrophotometer's, whose geometries have names
_NEAR = np.cos(np.deg2rad(12.0))
_OBLIQUE = np.cos(np.deg2rad([75.0, 20.0]))  # incidences at which light and mirror direction are far apart
_BRIGHTER = 3.0  # rough paints and papers are 1.4 times as bright towards the light at most
LEAST_HIDDEN = np.cos(np.deg2rad(14.0))
"""Cosine of the smallest angle between light and receiver that is suggested; most instruments need 15 degrees."""
_MOST_HIDDEN, _BESIDE = np.cos(np.deg2rad([25.0, 45.0]))


def hidden(wi: Array, wo: Array, values: Array) -> Mask:
    """Return a mask (P,) of the rows that are zero only because the receiver blocks the light.

    The receiver is assumed to block the light if, at each incidence, all readings within 25 degrees of the light are
    zero in all bands, but most readings up to 45 degrees are not. For a mirror, the readings up to 45 degrees would be
    zero as well.
    """
    towards_light = np.einsum("pi,pi->p", wi, wo)
    near = np.flatnonzero(towards_light > _BESIDE)
    is_zero = np.all(values[near] == 0.0, axis=1)
    found = np.zeros(len(wi), dtype=bool)
    if not np.any(is_zero & (towards_light[near] > LEAST_HIDDEN)):
        return found
    _, incidence = np.unique(np.round(wi[near], 6), axis=0, return_inverse=True)
    incidence = incidence.reshape(-1)
    for k in np.unique(incidence[is_zero]):
        own = incidence == k
        cosine, zero = towards_light[near[own]], is_zero[own]
        nearest = np.argmax(cosine)
        is_beside = cosine <= _MOST_HIDDEN
        is_dark = not np.any(is_beside) or np.mean(zero[is_beside]) > 0.5
        if zero[nearest] and cosine[nearest] > LEAST_HIDDEN and not is_dark:
            found[near[own][zero & ~is_beside]] = True
    return found


def without_hidden(record: Readings | DenseTable) -> Readings | DenseTable:
    """Return the record without the zeros that `hidden` finds, and with a note about them."""
    if isinstance(record, Readings):
        is_hidden = hidden(record.wi, record.wo, record.values)
    elif record.coordinates == "incident-outgoing":
        is_hidden = hidden(*record.directions(), record.values.reshape(-1, record.values.shape[-1]))
    else:
        return record  # nodes of half vectors share no incidence
    if not np.any(is_hidden):
        return record
    note = (
        f"{int(is_hidden.sum())} readings around the light are zero: the receiver blocks the light; "
        "they are left out"
    )
    if isinstance(record, Readings):
        return record.select_pairs(~is_hidden).with_note(note)
    values = np.where(is_hidden.reshape(*record.values.shape[:-1], 1), np.nan, record.values)
    return replace(record, values=values, notes=(*record.notes, note))


def with_light_side_note(readings: Readings) -> Readings:
    """Return the readings, with a note if they are far brighter towards the light than in its mirror direction."""
    is_oblique = (readings.wi[:, 2] > _OBLIQUE[0]) & (readings.wi[:, 2] < _OBLIQUE[1])
    brightness = np.mean(np.nan_to_num(readings.values), axis=1)
    towards_light = np.einsum("pi,pi->p", readings.wi, readings.wo)
    towards_mirror = cos_from_mirror(readings.wi, readings.wo)
    light, mirror = (brightness[is_oblique & (cosine > _NEAR)] for cosine in (towards_light, towards_mirror))
    if len(readings) < _LEAST_PAIRS or not light.size or not mirror.size:
        return readings
    if light.mean() < _BRIGHTER * mirror.mean() or not light.mean() > 0.0:
        return readings
    times = f"{light.mean() / mirror.mean():.3g} times as bright" if mirror.mean() > 0.0 else "bright"
    than = "as in the mirror direction" if mirror.mean() > 0.0 else "and dark in the mirror direction"
    return readings.with_note(
        f"{times} towards the light {than}: a retroreflector, or azimuths are not counted from the light"
    )
