"""The studio light of the page: that of the ball's quadrature."""

from __future__ import annotations

from typing import Any

from manifold.colour import ball_colours


def studio_light() -> dict[str, Any]:
    """Radiance of the environment, row by row from the zenith, the direction of the viewer, and the half vectors."""
    environment = ball_colours.environment()[..., 0]
    return {
        "rows": environment.shape[0], "columns": environment.shape[1],
        "radiance": [float(f"{v:.6g}") for v in environment.ravel()],
        "view": ball_colours.VIEW.tolist(),
    }  # fmt: skip
