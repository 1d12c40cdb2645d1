"""What public functions take, and errors for what they cannot use; copies for other processes."""

from __future__ import annotations

import copy
import gzip
import pickle

import numpy as np
import pytest
from helpers.sample_files import sample_file

import manifold as mf
from manifold.analytic.base import Lambert
from manifold.brdf.wrapper import WrappedBRDF
from manifold.core.errors import FileFormatError, ShapeError, UsageError
from manifold.core.metrics import Errors
from manifold.core.records import Bands
from manifold.estimate import LibraryAtoms
from manifold.formats import Readings, geometry_ma_t12

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
    ("change", "words"),
    [(lambda f: f * np.nan, "are not finite"), (lambda f: f[:, 0], r"eval returns shape \(\d+,\), expected")],
)
@pytest.mark.parametrize("method", ["embed", "reconstruct"])
def test_a_material_with_unusable_values_is_refused(model, method, change, words):
    with pytest.raises(ShapeError, match=words):
        getattr(model, method)(Changed(change))


@pytest.mark.parametrize(
    ("value", "words"), [(np.nan, "1 of 3 values of colours are not finite"), (-0.1, "are negative")]
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


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: mf.Manifold("built-in"), r"Manifold\('built-in'\): use Manifold.load\(path\)"),
        (lambda: mf.Manifold.load(None), "found NoneType, expected the path of a model"),
        (lambda: mf.read_bsdf(None), "found NoneType, expected the path of a .bsdf file, its bytes"),
        (
            lambda: mf.fit_bsdf(Changed(np.abs), "principle"),
            "no BSDF 'principle' to fit; did you mean principled",
        ),
    ],
)
def test_what_an_argument_cannot_be_is_said(call, words):
    with pytest.raises(UsageError, match=words):
        call()


def test_predictions_in_single_precision_are_those_in_double(model):
    single = WI.astype(np.float32)
    for brdf in (model.predict(model.X.mean(0)), model.predict(model.names[0])):
        found = brdf.eval(single, single)
        assert found.dtype == np.float32
        np.testing.assert_allclose(found, brdf.eval(WI, WI), rtol=1e-4)


def test_errors_print_what_is_known():
    assert repr(Errors(ball=1.5, cube_root=0.1)) == "Errors(ball=1.5, cube_root=0.1)"


def test_readings_are_completed_in_memory_with_expected_errors(library):
    truth = mf.MeasuredBRDF(mf.Library(library).read("syn_gloss_red"))
    wi, wo = geometry_ma_t12()
    completion = mf.complete_readings(Readings("red", "by hand", wi, wo, None, truth.eval(wi, wo)), library)
    np.testing.assert_allclose(completion.brdf.eval(wi, wo), truth.eval(wi, wo), rtol=0.05, atol=1e-3)
    assert 0.0 < completion.expected.cube_root < 1.0


def test_a_list_as_out_is_refused(model):
    with pytest.raises(ShapeError, match=r"out is a list, expected an array \(3,\)"):
        model.material(model.names[0]).eval(WI, WI, out=[0, 0, 0])


def test_a_ball_of_half_a_pixel_is_refused(model):
    with pytest.raises(UsageError, match=r"size is 32.5, expected an integer"):
        mf.render_ball(model.material(model.names[0]), size=32.5)


def test_a_bsdf_is_fitted_by_its_name():
    assert mf.fit_bsdf(Changed(np.abs), "diffuse").values["reflectance"] == pytest.approx([0.8, 0.4, 0.2])


def test_atoms_are_those_of_a_library_or_of_its_path(library, atoms):
    np.testing.assert_array_equal(LibraryAtoms.of_library(library).directions, atoms.directions)


def test_what_the_model_makes_is_the_same_after_pickling(model, rng):
    theta, phi = rng.uniform(0.0, 1.4, (2, 50)), rng.uniform(-3.0, 3.0, (2, 50))
    wi, wo = mf.directions.from_spherical(theta[0], phi[0]), mf.directions.from_spherical(theta[1], phi[1])
    copied = pickle.loads(pickle.dumps(model))
    measured, x, (a, b) = model.material(model.names[0]), model.X.mean(0), model.names[:2]
    for brdf, other in [
        (measured, copied.material(model.names[0])),
        (measured, pickle.loads(pickle.dumps(measured))),
        (measured.select_bands([0, 1, 2]), copy.deepcopy(measured)),
        (model.predict(x), copied.predict(x)),
        (model.predict(x), pickle.loads(pickle.dumps(model.predict(x)))),
        (model.interpolate(a, b, 0.5), copy.deepcopy(model.interpolate(a, b, 0.5))),
    ]:
        np.testing.assert_array_equal(brdf.eval(wi, wo), other.eval(wi, wo))
        np.testing.assert_array_equal(brdf.pdf(wi, wo), other.pdf(wi, wo))


def test_turned_materials_keep_their_azimuth_after_pickling():
    file = sample_file("cloth", azimuths=9)
    turned = mf.MeasuredBRDF(file).turned(0.3)
    wo = mf.directions.from_spherical(0.7, 1.0)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(turned)).eval(WI, wo), turned.eval(WI, wo))
    assert copy.copy(turned).tables is turned.tables  # not prepared again


def test_a_file_is_read_from_its_bytes_and_from_an_open_file(model, tmp_path):
    path = tmp_path / "paint_rgb.bsdf"
    mf.write_bsdf(path, model.library.read(model.names[0]))
    read = mf.read_bsdf(path)
    of_bytes = mf.read_bsdf(gzip.compress(path.read_bytes()))
    with path.open("rb") as stream:
        of_stream = mf.read_bsdf(stream)
    assert (read.name, of_bytes.name, of_stream.name) == ("paint", "material", "paint")
    for other in (of_bytes, of_stream):
        np.testing.assert_array_equal(other.spectra, read.spectra)
    with pytest.raises(FileFormatError, match="material: is empty"):
        mf.read_bsdf(b"")
