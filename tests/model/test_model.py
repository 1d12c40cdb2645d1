"""The fitted manifold: reconstruction, predictions, files, and libraries that changed under it."""

from __future__ import annotations

import itertools
import json
import pickle
import re
import shutil
import warnings
from dataclasses import replace

import h5py
import numpy as np
import pytest
from helpers.places import inside_hull
from helpers.small_library import NAMES, measured, small_library
from threadpoolctl import threadpool_info, threadpool_limits
from typer.testing import CliRunner

from manifold.analytic.base import Lambert
from manifold.brdf import goniometer
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured_cells import fill_unmeasured
from manifold.cli.main import app
from manifold.colour import panel
from manifold.core import progress
from manifold.core.directions import from_spherical
from manifold.core.errors import (
    BandMismatchError,
    LibraryError,
    ModelError,
    ShapeError,
    UsageError,
)
from manifold.core.metrics import rmse
from manifold.core.pairs import RusinkiewiczGrid, cosine_weight
from manifold.core.records import Bands
from manifold.gp.kernels import Kernel
from manifold.io_rgl import read_bsdf, write_bsdf
from manifold.library.importing import import_files
from manifold.library.store import Library
from manifold.model import blending, gram, model_file
from manifold.model.embedding import BrightMaterialWarning
from manifold.model.manifold import LibraryChangedWarning, Manifold
from manifold.model.model_file import read_model, write_model
from manifold.model.settings import KINDS, BlendSettings, GplvmSettings, Settings
from manifold.registries import KERNELS, MAPPINGS


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return Library.open(small_library(tmp_path_factory.mktemp("model")))


@pytest.fixture(scope="module", params=KINDS)
def model(request, library):
    return Manifold.fit(library, KINDS[request.param](), calibrate=False)


@pytest.mark.parametrize(
    ("kind", "mapping"),
    [
        ("blend", "cube-root"),
        *itertools.product(("gplvm",), ("identity", "cube-root", "log", "log-relative")),
    ],
)
def test_prediction_at_a_training_latent_is_the_measured_material(library, mapping, kind):
    settings = GplvmSettings(mapping=mapping) if kind == "gplvm" else BlendSettings()
    model = Manifold.fit(library, settings, calibrate=False)
    wi, wo, above = RusinkiewiczGrid().directions()
    wi, wo = wi[above][::7], wo[above][::7]
    for name in model.names:
        measured = MeasuredBRDF(fill_unmeasured(library.read(name))).eval(wi, wo)
        predicted = model.predict(model.latent(name)).eval(wi, wo)
        np.testing.assert_array_equal(predicted, measured)
        assert rmse(measured, predicted) == 0.0


def test_weights_sum_to_one_and_are_unit_at_the_materials(model):
    np.testing.assert_array_equal(model.weights(model.X), np.eye(len(NAMES)))
    x = np.array([[0.1, 0.2], [5.0, -5.0]])
    np.testing.assert_allclose(model.weights(x).sum(axis=1), 1.0, rtol=1e-12)


def test_weights_that_are_cut_are_invisible(library, monkeypatch, rng):
    model = Manifold.fit(library, BlendSettings(), calibrate=False)
    places, lights, n_cut = inside_hull(model.X, 12, rng) @ model.X, panel.judged(), 0
    for x in places:
        cut = model.predict(x).eval(lights.wi, lights.wo)
        n_used = np.count_nonzero(model.weights(x))
        with monkeypatch.context() as patch:
            patch.setattr(blending, "NEGLIGIBLE", 0.0)
            n_cut += np.count_nonzero(model.weights(x)) - n_used
            whole = model.predict(x).eval(lights.wi, lights.wo)
        assert lights.errors(whole, cut, model.bands).worst < 0.1  # a tenth of what is visible
    assert n_cut > 0


def test_uncertainty_is_zero_at_materials_and_full_far_away(model):
    assert np.all(model.std(model.X) == 0.0)
    far = np.array([50.0, -50.0])
    assert model.std(far) == pytest.approx(1.0)
    assert model.is_extrapolation(far)
    assert not np.any(model.is_extrapolation(model.X))


def test_nearest_material_of_a_latent_is_the_nearest(model):
    name, distance = model.nearest(model.latent("syn_gloss_red") + 1e-9, 1)[0]
    assert name == "syn_gloss_red"
    assert distance == pytest.approx(np.sqrt(2) * 1e-9)


def test_gram_matrix_agrees_with_a_loop(library, model):
    materials = model.materials.filled()
    grid = RusinkiewiczGrid(6, 5, 4)
    found = gram.gram_matrix(materials, MAPPINGS["cube-root"], grid)
    S = np.zeros((len(materials), len(materials)))
    wi, wo, above = grid.directions()
    for k in np.flatnonzero(above):
        T = np.array([np.cbrt(m.eval(wi[k], wo[k])) for m in materials])
        S += cosine_weight(wi[k], wo[k]) * T @ T.T
    np.testing.assert_allclose(found.S, S, rtol=1e-12)
    assert found.n_outputs == above.sum() * 3


@pytest.mark.parametrize("kind", KINDS)
def test_the_gram_matrix_is_remembered_by_the_library(library, monkeypatch, kind):
    first = Manifold.fit(library, KINDS[kind](), calibrate=False)
    monkeypatch.setattr(gram, "gram_matrix", lambda *_, **__: pytest.fail("computed again"))
    np.testing.assert_array_equal(Manifold.fit(library, KINDS[kind](), calibrate=False).X, first.X)


def test_a_saved_model_is_the_same_model(model, tmp_path):
    path = model.library.path.parent / "kept.h5"
    model.save(path)
    loaded = Manifold.load(path)
    assert loaded.names == model.names
    assert loaded.settings == model.settings
    assert loaded.statistics == model.statistics
    for name, array in model.space.arrays.items():
        np.testing.assert_array_equal(loaded.space.arrays[name], array)
    x = model.between("syn_felt_green", "syn_satin_gold", 0.4)
    wi, wo = from_spherical(0.5, 0.0), from_spherical(0.4, 2.0)
    np.testing.assert_array_equal(loaded.predict(x).eval(wi, wo), model.predict(x).eval(wi, wo))


def test_model_and_library_can_be_moved_together(library, model, tmp_path):
    folder = tmp_path / "a"
    folder.mkdir()
    shutil.copytree(library.path, folder / "library.zarr")
    Manifold.fit(Library.open(folder / "library.zarr"), calibrate=False).save(folder / "model.h5")
    folder.rename(tmp_path / "b")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert Manifold.load(tmp_path / "b" / "model.h5").names == model.names


def test_a_changed_library_is_noticed(library, tmp_path):
    copy = tmp_path / "library.zarr"
    shutil.copytree(library.path, copy)
    Manifold.fit(Library.open(copy), calibrate=False).save(tmp_path / "model.h5")
    small_library(tmp_path / "other", names=("syn_satin_blue",), library=copy)
    with pytest.warns(LibraryChangedWarning, match="embed again"):
        Manifold.load(tmp_path / "model.h5")


def test_a_library_that_lost_a_material_is_refused(library, tmp_path):
    copy = tmp_path / "library.zarr"
    shutil.copytree(library.path, copy)
    Manifold.fit(Library.open(copy), calibrate=False).save(tmp_path / "model.h5")
    shutil.rmtree(copy / "materials" / "syn_felt_green")
    with pytest.raises(LibraryError, match="syn_felt_green"):
        Manifold.load(tmp_path / "model.h5")


def test_what_is_no_model_is_refused(tmp_path):
    with pytest.raises(ModelError, match="no such model"):
        Manifold.load(tmp_path / "absent.h5")
    (tmp_path / "text.h5").write_text("not HDF5")
    with pytest.raises(ModelError, match=r"text\.h5"):
        Manifold.load(tmp_path / "text.h5")
    with h5py.File(tmp_path / "foreign.h5", "w") as file:
        file["data"] = np.zeros(3)
    with pytest.raises(ModelError, match="expected a manifold model"):
        Manifold.load(tmp_path / "foreign.h5")


def _rewritten(path, **changes):
    """A model file whose record was changed by this program: its hash is right."""
    write_model(path, replace(read_model(path), **changes))


def test_a_model_that_lacks_any_part_is_refused(model, tmp_path):
    path = tmp_path / "lacking.h5"
    model.save(path)
    whole = read_model(path)
    for part in ("names", "settings"):
        _rewritten(path, **{part: type(getattr(whole, part))()})
        with pytest.raises(ModelError, match="embed again"):
            Manifold.load(path)
        write_model(path, whole)
    for name in whole.arrays:
        _rewritten(path, arrays={n: a for n, a in whole.arrays.items() if n != name})
        with pytest.raises(ModelError, match="embed again"):
            Manifold.load(path)
        write_model(path, whole)


def test_a_model_whose_parts_do_not_fit_is_refused(model, tmp_path):
    path = tmp_path / "unfit.h5"
    model.save(path)
    whole = read_model(path)
    for name, array in whole.arrays.items():
        if array.ndim == 2:
            _rewritten(path, arrays=whole.arrays | {name: array[:-1]})
            with pytest.raises(ModelError, match="embed again"):
                Manifold.load(path)


def test_what_is_not_finite_is_not_written(model, tmp_path):
    path = tmp_path / "infinite.h5"
    model.save(path)
    for changes in (
        {"arrays": {"X": np.array([[np.nan]])}},
        {"statistics": {"objective": float("inf")}},
    ):
        with pytest.raises(ModelError, match=r"infinite\.h5"):
            _rewritten(path, **changes)


def test_a_map_of_version_0_4_is_read_with_a_note(model, tmp_path):
    path = tmp_path / "old.h5"
    model.save(path)
    assert Manifold.load(path).notes == ()
    _rewritten(path, layout=None)
    note = (
        "old.h5: laid out by version 0.4: run `manifold embed` again to place similar materials "
        "closer together"
    )
    assert Manifold.load(path).notes == ((note,) if model.settings.kind == "blend" else ())


def test_other_programs_read_the_arrays_of_a_model(model, tmp_path):
    path = tmp_path / "open.h5"
    model.save(path)
    with h5py.File(path) as file:
        np.testing.assert_array_equal(file["space/X"], model.X)
        assert json.loads(bytes(file["record"][...]))["names"] == list(model.names)


def test_a_model_with_a_changed_latent_is_refused_by_its_hash(model, tmp_path):
    path = tmp_path / "changed.h5"
    model.save(path)
    np.testing.assert_array_equal(Manifold.load(path).X, model.X)
    with h5py.File(path, "a") as file:
        file["space/X"][0, 0] = np.nextafter(model.X[0, 0], np.inf)
    with pytest.raises(ModelError, match="hash"):
        Manifold.load(path)


def test_every_flipped_bit_of_a_model_is_found(model, tmp_path, rng):
    path = tmp_path / "flipped.h5"
    model.save(path)
    whole = path.read_bytes()
    # All of the user block, where the hash itself stands, and some of the rest.
    for bit in (*range(8 * 80), *rng.integers(0, 8 * len(whole), 300)):
        content = bytearray(whole)
        content[bit // 8] ^= 1 << (bit % 8)
        path.write_bytes(content)
        with pytest.raises(ModelError, match=r"flipped\.h5"):
            read_model(path)


def test_a_model_that_is_cut_off_or_grew_is_refused(model, tmp_path):
    path = tmp_path / "cut.h5"
    model.save(path)
    whole = path.read_bytes()
    for content in (whole[:10], whole[:60], whole[:300], whole[:-1], whole + b"\0"):
        path.write_bytes(content)
        with pytest.raises(ModelError, match="embed again"):
            read_model(path)


def test_an_array_that_unpacks_to_more_than_the_file_is_refused(model, tmp_path):
    path = tmp_path / "bomb.h5"
    model.save(path)
    with h5py.File(path, "r+") as file:
        file["space"].create_dataset("bomb", shape=(1 << 40,), dtype="f8", compression="gzip")
    content = bytearray(path.read_bytes())
    content[model_file._DIGEST] = model_file._digest(content)
    path.write_bytes(content)
    with pytest.raises(ModelError, match=r"more than the file holds.*embed again"):
        read_model(path)


def test_a_model_without_a_hash_is_refused_in_one_line(tmp_path):
    path = tmp_path / "old.h5"
    with h5py.File(path, "w") as file:
        file.attrs["format"], file.attrs["format_version"] = "manifold-model", 2
    with pytest.raises(ModelError, match=r"^\S*old\.h5: .*embed again") as caught:
        read_model(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kernel", ["matern32", "matern52"])
def test_a_model_keeps_its_kernel(library, tmp_path, kernel):
    made = Manifold.fit(library, GplvmSettings(kernel=kernel), calibrate=False)
    made.save(tmp_path / "model.h5")
    found = Manifold.load(tmp_path / "model.h5", library)
    assert found.gp.kernel == made.settings.covariance() == found.settings.covariance()
    x = made.between(made.names[0], made.names[1], 0.3)
    np.testing.assert_array_equal(found.std(x), made.std(x))
    np.testing.assert_array_equal(found.weights(x), made.weights(x))


def test_a_model_with_a_kernel_of_ones_own_is_loaded_where_it_is_registered(library, tmp_path, monkeypatch):
    class Cauchy(Kernel):
        family, steepest = "cauchy", 3.0**1.5 / 8.0

        def radial(self, squared, xp=np):
            g = 1.0 / (1.0 + squared)
            return g, -(g**2)

    monkeypatch.setitem(KERNELS, "cauchy", Cauchy)
    settings = GplvmSettings(kernel="cauchy")
    Manifold.fit(library, settings, calibrate=False).save(tmp_path / "model.h5")
    assert isinstance(Manifold.load(tmp_path / "model.h5", library).gp.kernel, Cauchy)
    monkeypatch.delitem(KERNELS, "cauchy")
    with pytest.raises(
        ModelError,
        match=r"model\.h5: no kernel is called 'cauchy'; .* register .* manifold\.registries\.KERNELS",
    ):
        Manifold.load(tmp_path / "model.h5", library)


def test_a_model_of_another_version_is_refused(model, tmp_path, monkeypatch):
    path = tmp_path / "newer.h5"
    monkeypatch.setattr(model_file, "FORMAT_VERSION", 99)
    model.save(path)
    monkeypatch.undo()
    with pytest.raises(ModelError, match="format 99"):
        Manifold.load(path)


@pytest.mark.parametrize(
    ("x", "words"),
    [
        ([0.0], "found 1 coordinate, expected 2"),
        ([0.0, 0.0, 0.0], "found 3 coordinates, expected 2"),
        ([np.nan, 0.0], "expected finite coordinates"),
        ([np.inf, 0.0], "expected finite coordinates"),
    ],
)
def test_latents_that_are_none_are_refused(model, x, words):
    with pytest.raises(ShapeError, match=words):
        model.predict(np.array(x))


def test_impossible_settings_are_refused(library):
    with pytest.raises(UsageError, match="latent dimensions"):
        Manifold.fit(library, BlendSettings(latent_dim=len(NAMES)), calibrate=False)
    with pytest.raises(UsageError, match="cube-root"):
        GplvmSettings(mapping="cuberoot")
    with pytest.raises(UsageError, match="optimizer 'adam', expected dls or l-bfgs"):
        GplvmSettings(optimizer="adam")
    with pytest.raises(UsageError, match="use BlendSettings or GplvmSettings"):
        Settings(latent_dim=2)


@pytest.mark.parametrize(
    "settings", [BlendSettings(landmarks=9), GplvmSettings(3, kernel="matern32", mu=1e-3)]
)
def test_settings_of_each_kind_are_values(settings):
    assert pickle.loads(pickle.dumps(settings)) == settings
    assert replace(settings, length_scale=2.0).covariance().length_scale == 2.0
    assert json.loads(json.dumps(settings.to_json()))["kind"] == settings.kind


def test_a_model_of_the_kind_material_is_read_as_gplvm(library, tmp_path):
    """Until 0.4 the GPLVM had this name, and both kinds had the settings of both."""
    made = Manifold.fit(library, GplvmSettings(mu=1e-3), calibrate=False)
    made.save(tmp_path / "model.h5")
    record = read_model(tmp_path / "model.h5")
    old = {**record.settings, "kind": "material", "sample_bands": 5, "landmarks": None}
    write_model(tmp_path / "old.h5", replace(record, settings=old))
    assert Manifold.load(tmp_path / "old.h5").settings == made.settings


def test_unknown_materials_are_refused_with_near_names(model):
    with pytest.raises(UsageError, match="syn_satin_gold"):
        model.latent("syn_satin_goldd")


def test_a_material_of_the_library_is_embedded_where_it_lies(model):
    for name in ("syn_felt_green", "syn_satin_gold"):
        found = model.embed(model.material(name))
        assert model.nearest(found.latent)[0][0] == name
        assert found.relative_error < 0.2
        again = model.predict(found.latent, found.colours)
        wi, wo = from_spherical(0.5, 0.0), from_spherical(0.3, 1.0)
        np.testing.assert_allclose(again.eval(wi, wo), model.material(name).eval(wi, wo), rtol=0.3)


def test_a_material_with_other_bands_is_not_embedded(model):
    lambert = Lambert(np.array([0.2, 0.3]), Bands((500.0, 600.0)))
    with pytest.raises(BandMismatchError, match="500"):
        model.embed(lambert)


def test_interpolation_begins_and_ends_at_the_materials(model):
    wi, wo = from_spherical(0.5, 0.0), from_spherical(0.4, 2.0)
    a, b = "syn_felt_green", "syn_satin_gold"
    for t, name in ((0.0, a), (1.0, b)):
        expected = model.material(name).eval(wi, wo)
        np.testing.assert_array_equal(model.interpolate(a, b, t).eval(wi, wo), expected)


def test_a_structure_takes_the_reflectance_it_is_given(library):
    model = Manifold.fit(library, calibrate=False)
    x = model.between("syn_felt_green", "syn_paper_white", 0.5)
    wi = from_spherical(np.deg2rad(8.0), 0.0)
    asked = np.array([0.5, 0.3, 0.2])
    colours, reached = model.colours.of_reflectance(x, asked)
    np.testing.assert_allclose(reached, asked, atol=1e-12)
    np.testing.assert_allclose(model.predict(x, colours).albedo(wi), asked, atol=0.01)
    assert np.all(np.diff(colours) < 0)  # larger colour coordinates are brighter


def test_a_reflectance_out_of_reach_is_met_as_nearly_as_can_be(library):
    model = Manifold.fit(library, calibrate=False)
    colours, reached = model.colours.of_reflectance(model.latent("syn_metal_copper"), np.full(3, 5.0))
    assert np.all(np.isfinite(colours))
    assert np.all(reached < 5.0)


def test_colours_are_refused_where_materials_carry_them(library):
    model = Manifold.fit(library, GplvmSettings(), calibrate=False)
    for ask in (
        lambda: model.colours.like(model.X[0], model.names[0]),
        lambda: model.colours.of_reflectance(model.X[0], np.full(3, 0.5)),
        lambda: model.predict(model.X[0], np.zeros(3)),
    ):
        with pytest.raises(UsageError, match="cannot be given"):
            ask()


def test_a_material_that_is_too_bright_to_be_one_is_named(tmp_path):
    files = [measured(name) for name in NAMES[:3]]
    bright = replace(files[0], name="bright", spectra=files[0].spectra * np.float32(30.0))
    for file in (*files, bright):
        write_bsdf(tmp_path / f"{file.name}_rgb.bsdf", file)
    import_files(tmp_path / "library.zarr", [tmp_path])
    with pytest.warns(BrightMaterialWarning, match=r"^bright has a directional albedo of [0-9.]+") as caught:
        Manifold.fit(Library.open(tmp_path / "library.zarr"), BlendSettings(latent_dim=1), calibrate=False)
    assert len(caught) == 1


def test_a_layout_is_fitted_by_one_thread_of_blas(tmp_path):
    counts = []

    def step(*_):
        counts.extend(one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas")

    library = small_library(tmp_path)
    with threadpool_limits(2, "blas"), progress.listen(step):
        Manifold.fit(library)
    assert set(counts) == {1}


def test_a_spectral_file_is_located_on_an_rgb_map_after_the_conversion_that_the_message_names(
    tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    few = goniometer.measure(
        Lambert(np.linspace(0.1, 0.5, 16), Bands(tuple(np.linspace(400.0, 700.0, 16)))), "s"
    )
    write_bsdf("NAME.bsdf", few)
    rgb = Manifold.load("built-in")
    with pytest.raises(BandMismatchError, match="expected RGB") as refusal:
        rgb.embed(MeasuredBRDF(few))
    commands = re.findall(r"manifold (convert \S+ -o [\w.]+)", str(refusal.value))
    assert len(commands) == 2
    for command in commands:
        assert CliRunner().invoke(app, command.split()).exit_code == 0
    located = rgb.embed(MeasuredBRDF(read_bsdf("NAME_rgb.bsdf")))
    assert rgb.nearest(located.latent, 1)
