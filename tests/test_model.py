"""The fitted manifold: reconstruction, predictions, files, and libraries that changed under it."""

from __future__ import annotations

import shutil
import warnings

import h5py
import numpy as np
import pytest
from small_library import NAMES, small_library

from manifold import gram
from manifold.brdf import MeasuredBRDF
from manifold.directions import from_spherical
from manifold.errors import LibraryError, ModelError, ShapeError, UsageError
from manifold.mapping import mapping_named
from manifold.metrics import RusinkiewiczGrid, cosine_weight, rmse, rusinkiewicz_grid
from manifold.model import LibraryChangedWarning, Manifold, Settings
from manifold.store import Library


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return Library.open(small_library(tmp_path_factory.mktemp("model")))


@pytest.fixture(scope="module")
def model(library):
    return Manifold.fit(library)


@pytest.mark.parametrize("mapping", ["identity", "cube-root", "log", "log-relative"])
def test_prediction_at_a_training_latent_is_the_measured_file(library, mapping):
    model = Manifold.fit(library, Settings(mapping=mapping))
    wi, wo, above = rusinkiewicz_grid()
    wi, wo = wi[above][::7], wo[above][::7]
    for name in model.names:
        measured = MeasuredBRDF(library.read(name)).eval(wi, wo)
        predicted = model.predict(model.latent(name)).eval(wi, wo)
        np.testing.assert_array_equal(predicted, measured)
        assert rmse(measured, predicted) == 0.0


def test_predictions_between_materials_differ_from_both(model):
    x = model.between("syn_felt_green", "syn_satin_gold", 0.5)
    wi, wo = from_spherical(0.5, 0.0), from_spherical(0.4, 2.0)
    f = model.predict(x).eval(wi, wo)
    assert np.all(np.isfinite(f))
    for name in ("syn_felt_green", "syn_satin_gold"):
        assert not np.array_equal(f, model.material(name).eval(wi, wo))


def test_weights_sum_to_one_and_are_unit_at_the_materials(model):
    np.testing.assert_array_equal(model.weights(model.X), np.eye(len(NAMES)))
    x = np.array([[0.1, 0.2], [5.0, -5.0]])
    np.testing.assert_allclose(model.weights(x).sum(axis=1), 1.0, rtol=1e-12)


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


def test_refined_latents_are_no_worse_than_the_principal_components(model):
    assert model.statistics["objective"] <= model.statistics["objective_start"]


def test_gram_matrix_agrees_with_a_loop(library, model):
    materials = model.load_materials()
    grid = RusinkiewiczGrid(6, 5, 4)
    found = gram.gram_matrix(materials, mapping_named("cube-root"), grid)
    S = np.zeros((len(materials), len(materials)))
    wi, wo, above = grid.directions()
    for k in np.flatnonzero(above):
        T = np.array([np.cbrt(m.eval(wi[k], wo[k])) for m in materials])
        S += cosine_weight(wi[k], wo[k]) * T @ T.T
    np.testing.assert_allclose(found.S, S, rtol=1e-12)
    assert found.n_outputs == above.sum() * 3


def test_the_gram_matrix_is_remembered_by_the_library(library, monkeypatch):
    first = Manifold.fit(library)
    monkeypatch.setattr(gram, "gram_matrix", lambda *_: pytest.fail("computed again"))
    np.testing.assert_array_equal(Manifold.fit(library).S, first.S)


def test_a_saved_model_is_the_same_model(model, tmp_path):
    path = model.library.path.parent / "kept.h5"
    model.save(path)
    loaded = Manifold.load(path)
    assert loaded.names == model.names
    assert loaded.settings == model.settings
    assert loaded.statistics == model.statistics
    np.testing.assert_array_equal(loaded.X, model.X)
    np.testing.assert_array_equal(loaded.S, model.S)


def test_model_and_library_can_be_moved_together(library, model, tmp_path):
    folder = tmp_path / "a"
    folder.mkdir()
    shutil.copytree(library.path, folder / "library.zarr")
    Manifold.fit(Library.open(folder / "library.zarr")).save(folder / "model.h5")
    folder.rename(tmp_path / "b")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert Manifold.load(tmp_path / "b" / "model.h5").names == model.names


def test_a_changed_library_is_noticed(library, tmp_path):
    copy = tmp_path / "library.zarr"
    shutil.copytree(library.path, copy)
    Manifold.fit(Library.open(copy)).save(tmp_path / "model.h5")
    small_library(tmp_path / "other", names=("syn_satin_blue",), library=copy)
    with pytest.warns(LibraryChangedWarning, match="embed again"):
        Manifold.load(tmp_path / "model.h5")


def test_a_library_that_lost_a_material_is_refused(library, tmp_path):
    copy = tmp_path / "library.zarr"
    shutil.copytree(library.path, copy)
    Manifold.fit(Library.open(copy)).save(tmp_path / "model.h5")
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
    with pytest.raises(ModelError, match="no manifold model"):
        Manifold.load(tmp_path / "foreign.h5")


@pytest.mark.parametrize("field", ["X", "S", "names"])
def test_a_damaged_model_is_refused(model, tmp_path, field):
    path = tmp_path / "damaged.h5"
    model.save(path)
    with h5py.File(path, "a") as file:
        del file[field]
    with pytest.raises(ModelError, match="embed again"):
        Manifold.load(path)


def test_a_model_of_another_version_is_refused(model, tmp_path):
    path = tmp_path / "newer.h5"
    model.save(path)
    with h5py.File(path, "a") as file:
        file.attrs["format_version"] = 99
    with pytest.raises(ModelError, match="format 99"):
        Manifold.load(path)


@pytest.mark.parametrize("x", [[0.0], [0.0, 0.0, 0.0], [np.nan, 0.0], [np.inf, 0.0]])
def test_latents_that_are_none_are_refused(model, x):
    with pytest.raises(ShapeError, match="expected 2 finite ones"):
        model.predict(np.array(x))


def test_impossible_settings_are_refused(library):
    with pytest.raises(UsageError, match="latent dimensions"):
        Manifold.fit(library, Settings(latent_dim=len(NAMES)))
    with pytest.raises(UsageError, match="cube-root"):
        Manifold.fit(library, Settings(mapping="cuberoot"))


def test_unknown_materials_are_refused_with_near_names(model):
    with pytest.raises(UsageError, match="syn_satin_gold"):
        model.latent("syn_satin_goldd")
