"""What somebody meets who uses the package from Python, in a notebook."""

from __future__ import annotations

import pickle
import subprocess
import sys

import numpy as np
import pytest
from helpers.small_library import NAMES, measured, small_library, small_model

from manifold.analytic import Lambert
from manifold.brdf import goniometer
from manifold.brdf.measured import MeasuredBRDF
from manifold.core.directions import from_spherical
from manifold.core.errors import FileFormatError, ManifoldError, ShapeError, UsageError
from manifold.core.records import Bands
from manifold.fit.principled import fit_bsdf
from manifold.formats import read_readings
from manifold.formats.readings import Readings, geometry_ma_t12
from manifold.io_rgl import read_bsdf, write_bsdf
from manifold.library.importing import import_files
from manifold.model.manifold import Manifold
from manifold.model.settings import KINDS, BlendSettings, GplvmSettings
from manifold.render.ball import render_ball


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return Manifold.load(small_model(tmp_path_factory.mktemp("notebook")))


def test_using_colours_does_not_change_how_the_callers_arrays_are_printed():
    script = (
        "import numpy as np; before = repr(np.float64(0.5))\n"
        "from manifold.colour.reflectances import diffuse_reflectance_names\n"
        "diffuse_reflectance_names(); import sys; print(before, repr(np.float64(0.5)), 'colour' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert run.stdout.split() == ["np.float64(0.5)", "np.float64(0.5)", "True"], run.stderr


def test_one_source_is_imported_as_a_list_of_one(tmp_path):
    write_bsdf(tmp_path / "one_rgb.bsdf", measured(NAMES[0]))
    found = import_files(tmp_path / "library.zarr", str(tmp_path / "one_rgb.bsdf"))
    assert found.imported == ("one",)


def test_bands_take_any_sequence_and_refuse_what_is_no_axis():
    expected = Bands((400.0, 500.0, 600.0))
    assert Bands([400, 500, 600]) == Bands(np.array([400, 500, 600])) == expected
    assert hash(Bands([400, 500, 600])) == hash(expected)
    for wrong in ((500.0, 400.0), (), (400.0, np.nan), (400.0, 400.0)):
        with pytest.raises(ShapeError, match="finite and increasing"):
            Bands(wrong)


@pytest.mark.parametrize(
    ("kind", "settings", "message"),
    [
        (
            BlendSettings,
            {"latent_dim": "auto"},
            "latent_dim is 'auto', expected a whole number of at least 1",
        ),
        (BlendSettings, {"latent_dim": 2.5}, "latent_dim is 2.5, expected a whole number of at least 1"),
        (BlendSettings, {"latent_dim": -1}, "latent_dim is -1, expected a whole number of at least 1"),
        (BlendSettings, {"sample_bands": 1}, "sample_bands is 1, expected a whole number of at least 2"),
        (GplvmSettings, {"grid": "fine"}, "no grid is called 'fine'; expected one of default, hikichi"),
    ],
)
def test_settings_are_refused_before_a_library_is_read(kind, settings, message):
    with pytest.raises(UsageError, match=message):
        kind(**settings)


def test_several_latents_have_the_errors_and_support_of_each(model):
    X = np.vstack([model.X, model.X.mean(axis=0), model.X.max(axis=0) + 9.0])
    together, each = model.expected_error(X), [model.expected_error(x) for x in X]
    for name in ("ball", "cube_root"):
        expected = [getattr(one, name) for one in each]
        np.testing.assert_allclose(getattr(together, name), expected, rtol=1e-12)  # sums in another order
    assert np.all(together.ball[: len(NAMES)] == 0.0)
    assert np.all(together.ball[len(NAMES) :] > 0.0)
    np.testing.assert_array_equal(model.is_extrapolation(X), [model.is_extrapolation(x) for x in X])
    wi, wo = from_spherical(0.3, 0.0), from_spherical(0.5, 2.0)
    predicted = [brdf.eval(wi, wo) for brdf in model.predict(X.tolist())]
    np.testing.assert_array_equal(predicted, [model.predict(x).eval(wi, wo) for x in X])


class Gloss:
    """A BRDF of somebody's own: what evaluation takes, and no more."""

    bands = Bands(None)
    is_isotropic = True

    def eval(self, wi, wo):
        h = wi + wo
        h = h / np.maximum(np.linalg.norm(h, axis=-1, keepdims=True), 1e-12)
        lobe = np.maximum(h[..., 2:], 0.0) ** 40
        return np.where((wi[..., 2:] > 0) & (wo[..., 2:] > 0), 0.1 + lobe, 0.0) * np.array([0.9, 0.5, 0.2])

    def eval_cos(self, wi, wo):
        return self.eval(wi, wo) * np.maximum(np.asarray(wo)[..., 2:], 0.0)


def test_a_brdf_of_ones_own_becomes_a_file_a_picture_and_a_fit(tmp_path):
    own = Gloss()
    file = goniometer.measure(own, "own", n_theta_i=16)
    write_bsdf(tmp_path / "own_rgb.bsdf", file)
    stored = MeasuredBRDF(read_bsdf(tmp_path / "own_rgb.bsdf"))
    wi, wo = from_spherical(0.5, 0.0), from_spherical(np.linspace(0.0, 1.2, 25), np.pi)
    np.testing.assert_allclose(
        stored.eval(wi, wo), own.eval(wi, wo), rtol=0.02
    )  # 16 incidences, as documented
    assert render_ball(own, size=16, samples=2).mean() > 0.01
    assert fit_bsdf(own).residuals["appearance"] < 0.2


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda model, file: model.embed(file), "material to embed: found BsdfFile, without eval, eval_cos"),
        (lambda model, file: model.embed("a.bsdf"), "found str, without bands"),
        (lambda model, file: model.reconstruct(file), "material to reconstruct: found BsdfFile"),
        (
            lambda model, file: MeasuredBRDF("a.bsdf"),
            "found str, expected a BsdfFile, as returned by read_bsdf",
        ),
        (lambda model, file: fit_bsdf("a.bsdf"), "the material to fit: found str"),
        (lambda model, file: goniometer.measure(file, "a"), "goniometer.measure: found BsdfFile"),
        (
            lambda model, file: write_bsdf("a.bsdf", Gloss()),
            "found Gloss, expected a BsdfFile; goniometer.measure",
        ),
        (lambda model, file: model.predict([0.1, 0.2], np.zeros(3)), "all weights are zero"),
        (
            lambda model, file: Manifold.fit(model.library, names=["a"], calibrate=False),
            "no material 'a' in library.zarr",
        ),
        (
            lambda model, file: Manifold.fit(model.library, names=NAMES[0], calibrate=False),
            "found 1 material, expected at least",
        ),
    ],
)
def test_what_is_no_brdf_or_no_file_is_told_from_one(model, call, message):
    with pytest.raises(ManifoldError, match=message):
        call(model, measured(NAMES[0]))


def test_records_are_short_to_read_and_go_to_other_processes(tmp_path):
    file = measured(NAMES[0])
    assert repr(file) == f"<BsdfFile: {NAMES[0]}, RGB, isotropic, spectra 1 x 8 x 3 x 32 x 32>"
    wi, wo = geometry_ma_t12()
    readings = Readings("a", "mine", wi, wo, None, np.ones((12, 3)), texture={"graininess": 1.0})
    copy, read = (pickle.loads(pickle.dumps(one)) for one in (file, readings))
    write_bsdf(tmp_path / "a.bsdf", file)
    write_bsdf(tmp_path / "b.bsdf", copy)
    assert (tmp_path / "a.bsdf").read_bytes() == (tmp_path / "b.bsdf").read_bytes()
    assert dict(read.texture) == {"graininess": 1.0}


@pytest.mark.parametrize("kind", ["blend", "gplvm"])
def test_held_out_names_are_as_if_their_files_had_never_been_imported(model, tmp_path, kind):
    settings, kept = KINDS[kind](), NAMES[1:]
    shorter = Manifold.fit(small_library(tmp_path, names=kept), settings, calibrate=False)
    Manifold.fit(model.library, settings, calibrate=False)  # whose Gram matrix the library remembers
    held_out = Manifold.fit(model.library.path, settings, names=kept, calibrate=False)
    assert held_out.names == shorter.names == kept
    np.testing.assert_array_equal(held_out.X, shorter.X)
    held_out.save(tmp_path / "held_out.h5")
    assert Manifold.load(tmp_path / "held_out.h5").names == kept


def test_the_way_between_two_materials_has_its_ends_and_stays_where_they_agree(model):
    a, b = NAMES[:2]
    np.testing.assert_array_equal(model.between(a, b, 0.0), model.latent(a))
    np.testing.assert_array_equal(model.between(a, b, 1.0), model.latent(b))
    for t in (0.1, 1.0 / 3.0, 0.5, 0.7):
        np.testing.assert_array_equal(model.between(a, a, t), model.latent(a))


def test_an_rgl_file_where_readings_are_expected_is_said_to_be_a_whole_brdf(tmp_path):
    write_bsdf(tmp_path / "a_rgb.bsdf", measured(NAMES[0]))
    with pytest.raises(
        FileFormatError, match="a whole BRDF, expected readings or a table; read it with manifold"
    ):
        read_readings(tmp_path / "a_rgb.bsdf")


@pytest.mark.filterwarnings("error")
def test_no_directions_give_no_values_and_longer_vectors_are_refused(model):
    wi, none, x = from_spherical(0.5, 0.0), np.zeros((0, 3)), model.X.mean(axis=0)
    for brdf in (model.material(NAMES[0]), model.predict(x)):
        assert brdf.eval(wi, none).shape == (0, 3)
        assert brdf.pdf(wi, none).shape == (0,)
        with pytest.raises(ShapeError, match="wi has a vector of length 2, expected unit vectors"):
            brdf.albedo(2.0 * wi)


def test_a_model_and_brdfs_have_a_picture_in_notebooks(model):
    picture = model._repr_html_()
    assert picture.count("<circle") == len(model.names)
    assert model.names[0] in picture
    for brdf in (model.predict(model.X.mean(axis=0)), model.material(NAMES[0]), Lambert(0.5, Bands(None))):
        assert brdf._repr_png_().startswith(b"\x89PNG")
