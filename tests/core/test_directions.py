"""Directions near the mirror direction."""

from __future__ import annotations

import numpy as np
import pytest

from manifold.core import metrics
from manifold.core.directions import NEAR_MIRROR_DEG, cos_from_mirror, from_spherical, is_near_mirror


@pytest.mark.parametrize("turn", [0.0, 1.1])
def test_directions_near_the_mirror_direction_are_told_by_their_angle_from_it(turn):
    incidence, off = np.deg2rad(40.0), np.deg2rad(NEAR_MIRROR_DEG)
    wi = np.broadcast_to(from_spherical(incidence, turn + np.pi), (3, 3))
    wo = np.array([from_spherical(incidence + share * off, turn) for share in (0.0, -0.99, 1.01)])
    np.testing.assert_allclose(cos_from_mirror(wi, wo), np.cos([0.0, 0.99 * off, 1.01 * off]), rtol=1e-12)
    assert is_near_mirror(wi, wo).tolist() == [True, True, False]


def test_errors_near_the_mirror_direction_name_its_angle(monkeypatch):
    monkeypatch.setattr(metrics, "NEAR_MIRROR_DEG", 7.0)
    errors = metrics.Errors(ball=1.0, cube_root=0.1, near_mirror=0.3, elsewhere=0.1)
    assert "30 % within 7 degrees of the mirror direction" in " ".join(errors.words)
