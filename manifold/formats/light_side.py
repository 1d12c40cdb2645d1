"""Whether readings are brightest towards the light: retroreflectors are, and misread azimuths."""

from __future__ import annotations

import numpy as np

from manifold.formats.readings import Readings

_LEAST_PAIRS = 50  # fewer are a spectrophotometer's, whose geometries have names
_NEAR = np.cos(np.deg2rad(12.0))
_OBLIQUE = np.cos(np.deg2rad([75.0, 20.0]))
_BRIGHTER = 3.0  # rough paints and papers are 1.4 times as bright towards the light at most


def with_light_side_note(readings: Readings) -> Readings:
    """The readings, with a note where they are far brighter towards the light than in its mirror direction."""
    is_oblique = (readings.wi[:, 2] > _OBLIQUE[0]) & (readings.wi[:, 2] < _OBLIQUE[1])
    brightness = np.mean(np.nan_to_num(readings.values), axis=1)
    towards_light = np.einsum("pi,pi->p", readings.wi, readings.wo)
    towards_mirror = np.einsum("pi,pi->p", readings.wi * [-1.0, -1.0, 1.0], readings.wo)
    light, mirror = (brightness[is_oblique & (cosine > _NEAR)] for cosine in (towards_light, towards_mirror))
    if len(readings) < _LEAST_PAIRS or not light.size or not mirror.size:
        return readings
    ratio = light.mean() / max(mirror.mean(), 1e-300)
    if ratio < _BRIGHTER:
        return readings
    return readings.with_note(
        f"{ratio:.3g} times as bright towards the light as in the mirror direction: a retroreflector, or azimuths are "
        "not counted from the light"
    )
