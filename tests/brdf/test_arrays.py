"""BRDFs as arrays of xarray."""

from __future__ import annotations

import numpy as np
import pytest

from manifold.analytic import corpus
from manifold.brdf import to_xarray
from manifold.core.directions import from_spherical
from manifold.core.errors import ShapeError
from manifold.core.records import Bands

GOLD = next(m for m in corpus.isotropic_materials() if m.name == "syn_satin_gold").truth(
    Bands((450.0, 600.0))
)


def test_an_array_has_the_values_of_the_brdf_at_its_coordinates():
    made = to_xarray(GOLD, [0.0, 45.0], [10.0, 20.0, 60.0], [0.0, 180.0])
    assert made.dims == ("theta_i", "theta_o", "phi", "band")
    for where in (
        {"theta_i": 45.0, "theta_o": 20.0, "phi": 180.0},
        {"theta_i": 0.0, "theta_o": 60.0, "phi": 0.0},
    ):
        i, o, phi = np.deg2rad(list(where.values()))
        np.testing.assert_allclose(made.sel(where), GOLD.eval(from_spherical(i, 0.0), from_spherical(o, phi)))
    assert made.band.values.tolist() == [450.0, 600.0]


@pytest.mark.parametrize("angles", [([-5.0], 10.0), (10.0, [95.0]), ([[10.0]], 10.0)])
def test_elevations_below_the_horizon_and_tables_of_angles_are_refused(angles):
    with pytest.raises(ShapeError, match="expected"):
        to_xarray(GOLD, *angles)
