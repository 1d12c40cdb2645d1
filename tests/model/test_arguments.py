"""Arguments of public functions that cannot be used: each error says what was found and what was expected."""

from __future__ import annotations

import numpy as np
import pytest

import manifold as mf
from manifold.analytic.base import Lambert
from manifold.brdf.wrapper import WrappedBRDF
from manifold.core.errors import ShapeError, UsageError
from manifold.core.records import Bands

WI = mf.directions.from_spherical(0.5, 0.0)


@pytest.fixture(scope="module")
def model():
    return mf.built_in()


class Changed(WrappedBRDF):
    """A Lambertian whose values a function changes."""

    def __init__(self, change):
        super().__init__(Lambert(np.array([0.8, 0.4, 0.2]), Bands(None)))
        self._change = change

    def eval(self, wi, wo):
        return self._change(self._brdf.eval(wi, wo))


@pytest.mark.parametrize(
    "change, words",
    [(lambda f: f * np.nan, "are not finite"), (lambda f: f[:, 0], r"eval returns shape \(\d+,\), expected")],
)
@pytest.mark.parametrize("method", ["embed", "reconstruct"])
def test_a_material_with_unusable_values_is_refused(model, method, change, words):
    with pytest.raises(ShapeError, match=words):
        getattr(model, method)(Changed(change))


@pytest.mark.parametrize(
    "value, words", [(np.nan, "1 of 3 values of colours are not finite"), (-0.1, "are negative")]
)
def test_unusable_colours_are_refused_with_the_reason(model, value, words):
    with pytest.raises(ShapeError, match=words):
        model.predict(model.names[0], [0.5, value, 0.5])


def test_colours_of_the_model_are_not_negative(model):
    assert min(model.colours.like(x, name).min() for x, name in zip(model.X, model.names, strict=True)) >= 0


def test_a_number_of_nearest_materials_below_1_is_refused(model):
    with pytest.raises(UsageError, match="found -1 nearest materials"):
        model.nearest(model.X[0], -1)


@pytest.mark.parametrize("resolution", [0, -1, 8.5, 3])
@pytest.mark.parametrize("is_predicted", [True, False])
def test_a_resolution_that_no_quadrature_has_is_refused(model, resolution, is_predicted):
    brdf = model.predict(model.X.mean(0)) if is_predicted else model.material(model.names[0])
    with pytest.raises(UsageError, match=f"resolution is {resolution}, expected an integer of at least 4"):
        brdf.albedo(WI, resolution)


@pytest.mark.parametrize("is_predicted", [True, False])
def test_an_azimuth_that_is_not_finite_is_refused(model, is_predicted):
    brdf = model.predict(model.X.mean(0)) if is_predicted else model.material(model.names[0])
    with pytest.raises(UsageError, match="azimuth of nan"):
        brdf.turned(float("nan"))
