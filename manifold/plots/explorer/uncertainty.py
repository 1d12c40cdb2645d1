"""Expected errors, tabulated over the map for the page."""

from __future__ import annotations

from typing import Any

import numpy as np

from manifold.latent.expected_error import COARSE_BELOW
from manifold.model.manifold import Manifold

_NODES = {1: 200, 2: 72, 3: 24}  # per dimension; maps of more dimensions have none
_MARGIN = 0.25  # of the materials' extent, beyond them
_MOST_BALL = 15.0  # CIEDE2000 at which the ground of the map is darkest


def error_field(model: Manifold) -> dict[str, Any] | None:
    """Values on a regular grid over the map, the last dimension running fastest; None above three dimensions.

    Expected errors of the ball or, of a model that is not calibrated, the posterior over the prior standard deviation;
    and where the data do not support predictions.
    """
    X = model.X
    Q = X.shape[1]
    if Q not in _NODES:
        return None
    extent = np.maximum(np.ptp(X, axis=0), 1e-6)
    low, high = X.min(axis=0) - _MARGIN * extent, X.max(axis=0) + _MARGIN * extent
    axes = [np.linspace(a, b, _NODES[Q]) for a, b in zip(low, high, strict=True)]
    places = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=1)
    expected = model.expected_error(places)
    if expected is None:
        words = {"what": "uncertainty", "unit": "posterior over prior standard deviation", "most": 1.0}
        values = model.std(places)
    else:
        coarse = f"; coarse, known from {len(X)} materials" if len(X) < COARSE_BELOW else ""
        words = {"what": "expected error", "unit": f"CIEDE2000 of the ball{coarse}", "most": _MOST_BALL}
        values = expected.ball
    return words | {
        "low": low.tolist(), "high": high.tolist(), "nodes": _NODES[Q], "values": np.round(values, 3).tolist(),
        "unsupported": model.is_extrapolation(places).astype(int).tolist(),
    }  # fmt: skip
