"""Pictures for tests that do not look at them."""

from __future__ import annotations

import pytest
from matplotlib.figure import Figure

from manifold.pictures import export_sheet, figures
from manifold.render import thumbnails


def draw_quickly(patch: pytest.MonkeyPatch) -> None:
    """Balls of few samples, and figures that are not laid out."""
    patch.setattr(figures, "Figure", lambda layout, **given: Figure(**given))
    patch.setattr(thumbnails, "SAMPLES", 4)
    patch.setattr(export_sheet, "_RINGS", 6)
    patch.setattr(export_sheet, "_SPOKES", 6)
