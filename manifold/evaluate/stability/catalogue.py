"""The catalogue of failure modes, from its chapters. A new mode is one more entry of one of these."""

from __future__ import annotations

from manifold.evaluate.stability import (
    data_failures,
    extrapolation_failures,
    fit_failures,
    library_failures,
    model_failures,
    search_failures,
)
from manifold.evaluate.stability.trials import Mode

MODES: tuple[Mode, ...] = (
    *model_failures.MODES,
    *extrapolation_failures.MODES,
    *search_failures.MODES,
    *data_failures.MODES,
    *library_failures.MODES,
    *fit_failures.MODES,
)
