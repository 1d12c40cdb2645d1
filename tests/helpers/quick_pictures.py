"""Pictures for tests that do not look at them."""

from __future__ import annotations

import pytest
from matplotlib.figure import Figure

from manifold.colour import ball_colours
from manifold.estimate import reports
from manifold.pictures import export_sheet, figures, fit_comparison
from manifold.render import thumbnails
from manifold.shader import exporting


def draw_quickly(patch: pytest.MonkeyPatch) -> None:
    """Balls of few pixels and samples, and figures that are not laid out."""
    patch.setattr(figures, "Figure", lambda layout, **given: Figure(**given))
    patch.setattr(reports, "_BALL", 64)
    for module, size in ((export_sheet, "_PIXELS"), (fit_comparison, "_PIXELS"), (exporting, "_PACK_PIXELS")):
        patch.setattr(module, size, 32)
    patch.setattr(thumbnails, "SAMPLES", 4)
    patch.setattr(ball_colours, "DRAWN", (6, 6))
