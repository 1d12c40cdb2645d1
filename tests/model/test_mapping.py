"""Claims about the mappings of BRDF values."""

from __future__ import annotations

import numpy as np
import pytest

from manifold.core.errors import ShapeError, UsageError
from manifold.core.mapping import CubeRoot, Identity, Log, LogRelative
from manifold.registries import MAPPINGS

EVERY = pytest.mark.parametrize("name", list(MAPPINGS))


@EVERY
@pytest.mark.parametrize("weighted", [False, True])
def test_inverse_undoes_forward_over_nine_decades(rng, name, weighted):
    values = 10.0 ** rng.uniform(-4, 5, size=(200, 3))
    weight = rng.random(200) if weighted else None
    mapping = MAPPINGS[name]
    again = mapping.inverse(mapping.forward(values, weight), weight)
    np.testing.assert_allclose(again, values, rtol=1e-10)  # exp of ln loses log10(1e8) digits of 16


@EVERY
def test_zero_stays_exactly_zero_and_masked_cells_stay_masked(name):
    values = np.array([[0.0, np.nan, 2.0]])
    mapping = MAPPINGS[name]
    mapped = mapping.forward(values)
    assert mapped[0, 0] == 0.0
    again = mapping.inverse(mapped)
    assert again[0, 0] == 0.0
    assert np.isnan(mapped[0, 1])
    assert np.isnan(again[0, 1])


@EVERY
def test_mappings_rise_and_keep_shape_and_precision(rng, name):
    values = np.sort(rng.random((50, 1)).astype(np.float32), axis=0)
    mapped = MAPPINGS[name].forward(values)
    assert mapped.shape == values.shape
    assert mapped.dtype == np.float32
    assert np.all(np.diff(mapped[:, 0]) >= 0)


@pytest.mark.parametrize("mapping", [Identity(), CubeRoot()])
def test_signed_mappings_keep_negative_values(mapping):
    values = np.array([-0.125, -1e-6])
    np.testing.assert_allclose(mapping.inverse(mapping.forward(values)), values, rtol=1e-14)


@pytest.mark.parametrize("mapping", [Log(), LogRelative()])
def test_logarithms_take_negatives_for_zero_and_never_return_any(mapping):
    assert np.array_equal(mapping.forward(np.array([-0.5])), [0.0])
    assert np.array_equal(mapping.inverse(np.array([-3.0])), [0.0])


def test_log_relative_is_the_formula(rng):
    f, weight = rng.random((6, 3)), rng.random(6)
    expected = np.log((f * np.maximum(weight, 0.3)[:, None] + 1e-2) / 1e-2)
    mapping = LogRelative(epsilon=1e-2, floor=0.3)
    np.testing.assert_allclose(mapping.forward(f, weight), expected, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(mapping.inverse(expected, weight), f, rtol=1e-12)


def test_what_does_not_fit_and_unknown_names_are_refused():
    with pytest.raises(ShapeError, match="one per direction pair"):
        LogRelative().forward(np.ones((4, 3)), np.ones(3))
    with pytest.raises(
        UsageError, match=f"no mapping is called 'sqrt'; expected one of {', '.join(MAPPINGS)}"
    ):
        MAPPINGS["sqrt"]
