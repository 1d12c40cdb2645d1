"""The method of Hikichi & Iwasaki on files, beside NumPy that only knows the equations of the paper."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import reference
from helpers.small_library import NAMES, measured

from manifold.directions import from_spherical
from manifold.io_rgl import read_bsdf, write_bsdf
from manifold.library.compacting import compact_library
from manifold.library.importing import import_files
from manifold.library.store import Library
from manifold.model.location import locate
from manifold.model.manifold import Manifold
from manifold.model.settings import Settings

T = {"identity": lambda f: f, "cube-root": np.cbrt}


def with_empty_cells(file):
    """The file with a patch of cells zero in all bands, as where nothing was measured."""
    spectra = file.spectra.copy()
    spectra[:, 1:5, :, 10:13, 10:13] = 0.0
    return replace(file, spectra=spectra)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Files of six materials, one of them with unmeasured cells, and their library."""
    path = tmp_path_factory.mktemp("published")
    (path / "files").mkdir()
    for name in NAMES:
        file = measured(name)
        file = with_empty_cells(file) if name == "syn_satin_gold" else file
        write_bsdf(path / "files" / f"{name}_rgb.bsdf", file)
    assert not import_files(path / "library.zarr", [path / "files"]).failed
    return path


@pytest.fixture(scope="module", params=T)
def model(request, folder):
    library = Library.open(folder / "library.zarr")
    return Manifold.fit(library, Settings("material", mapping=request.param), calibrate=False)


@pytest.fixture
def pairs(rng):
    theta, phi = rng.uniform(0.0, np.deg2rad(80.0), (2, 300)), rng.uniform(-np.pi, np.pi, (2, 300))
    return from_spherical(theta[0], phi[0]), from_spherical(theta[1], phi[1])


def values(model, pairs):
    """Values of all materials, shape (N, P B)."""
    return np.array([model.material(name).eval(*pairs).ravel() for name in model.names])


def test_a_prediction_is_the_posterior_mean_of_the_materials_that_the_model_names(model, pairs, rng):
    """Eq. 12 to 14, by plain inversion; at a material's own latent the delta makes it the datum."""
    forward = T[model.settings.mapping]
    Y = forward(values(model, pairs))
    between = rng.dirichlet(np.ones(len(NAMES)), 5) @ model.X
    for X_new in (between, model.X):
        mean, variance = reference.posterior(model.X, Y, X_new, model.settings.mu, 1.0)
        found = np.array([brdf.eval(*pairs).ravel() for brdf in model.predict(list(X_new))])
        # Sums in single precision, whose terms have both signs.
        atol = 2e-5 * np.abs(model.gp.weights(X_new)).sum(axis=1).max() * np.abs(Y).max()
        np.testing.assert_allclose(forward(found), mean, atol=atol)
        np.testing.assert_allclose(
            model.space.variance_fraction(X_new, None) * (1.0 + model.settings.mu), variance, atol=1e-9
        )


def test_the_prediction_at_a_latent_is_the_material_with_its_unmeasured_cells_filled(model, folder, pairs):
    for name in model.names:
        np.testing.assert_array_equal(model.predict(name).eval(*pairs), model.material(name).eval(*pairs))
    file = read_bsdf(folder / "files" / "syn_satin_gold_rgb.bsdf")
    whole, at = measured("syn_satin_gold"), (0, 2, slice(None), 11, 11)
    assert np.all(file.spectra[at] == 0.0)
    used = model.materials.measured_file("syn_satin_gold").spectra
    np.testing.assert_allclose(used[at], whole.spectra[at], rtol=0.5)  # filled from the rim of a smooth patch
    is_measured = np.any(file.spectra != 0.0, axis=2)
    np.testing.assert_array_equal(
        np.moveaxis(used, 2, -1)[is_measured], np.moveaxis(file.spectra, 2, -1)[is_measured]
    )


def test_a_file_of_the_library_is_located_at_its_own_latent(model, folder):
    for name in NAMES:
        located = locate(model, read_bsdf(folder / "files" / f"{name}_rgb.bsdf"))
        np.testing.assert_array_equal(located.latent, model.latent(name))
        assert (located.errors.ball, located.errors.cube_root, located.errors.linear) == (0.0, 0.0, 0.0)
        assert located.diagnostics == ()


def test_a_file_is_located_in_its_compact_library_and_when_it_is_measured_again(model, folder, tmp_path, rng):
    again = measured("syn_felt_green")
    noisy = again.spectra * rng.normal(1.0, 0.01, again.spectra.shape).astype(np.float32)
    np.testing.assert_array_equal(
        locate(model, replace(again, spectra=noisy)).latent, model.latent("syn_felt_green")
    )
    import_files(tmp_path / "compact.zarr", [folder / "files"])
    compact_library(tmp_path / "compact.zarr")
    compact = Manifold.fit(tmp_path / "compact.zarr", model.settings, calibrate=False)
    for name in NAMES:
        located = locate(compact, read_bsdf(folder / "files" / f"{name}_rgb.bsdf"))
        np.testing.assert_array_equal(located.latent, compact.latent(name))
        assert located.errors.cube_root < 0.01  # the bound of compact libraries


def test_a_material_that_the_library_lacks_is_located_beside_its_materials(model):
    file = measured("syn_felt_green")
    located = locate(model, replace(file, spectra=1.2 * file.spectra))
    assert not np.any(np.all(located.latent == model.X, axis=1))
