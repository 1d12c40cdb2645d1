"""Readings of a sample at the directions of an MA-T12, for tests that need some."""

from __future__ import annotations

from manifold.formats.readings import Readings, geometry_ma_t12

DIRECTIONS = geometry_ma_t12()


def readings(values, directions=DIRECTIONS, nm=None, gloss=None):
    """Values (P, B) at direction pairs, in linear sRGB or at wavelengths."""
    return Readings("sample", "test", *directions, nm, values, gloss=gloss or {})
