"""Draws the map of a library as SVG."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from manifold.core.records import Array

_SIZE, _MARGIN = np.array([560.0, 400.0]), np.array([90.0, 24.0])


def map_svg(X: Array, names: Sequence[str]) -> str:
    """Return an SVG picture of latents X (N, Q) with their names; a map of one dimension is drawn along a line."""
    X = np.column_stack([X, np.zeros(len(X))])[:, :2]
    low, span = X.min(axis=0), np.maximum(np.ptp(X, axis=0), 1e-9)
    places = (X - low) / span * (_SIZE - 2.0 * _MARGIN) + _MARGIN
    places[:, 1] = _SIZE[1] - places[:, 1]
    dots = "".join(
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="#0072b2"/>'
        f'<text x="{x:.1f}" y="{y - 7:.1f}" text-anchor="middle">{escape(name)}</text>'
        for (x, y), name in zip(places.tolist(), names, strict=True)
    )
    width, height = _SIZE.astype(int)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        f'style="background:white" font-family="sans-serif" font-size="10">{dots}</svg>'
    )
