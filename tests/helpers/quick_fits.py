"""Fits of exports for tests that do not look at how close they are: tests/fit/test_export_direct.py does."""

from __future__ import annotations

import pytest

from manifold.fit.exports import direct


def fit_quickly(patch: pytest.MonkeyPatch) -> None:
    """Fit an eighth of the samples, stop early, and refine one film."""
    patch.setattr(direct, "_PAIRS", 64)
    patch.setattr(direct, "_EVALUATIONS", 6)
    patch.setattr(direct, "_FILM_STARTS", 1)
