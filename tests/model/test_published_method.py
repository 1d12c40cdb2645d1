"""The method of Hikichi & Iwasaki on files, beside NumPy that only knows the equations of the paper."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import reference
from helpers.small_library import NAMES, measured

from manifold.brdf.measured import MeasuredBRDF
from manifold.core.directions import from_spherical
from manifold.core.errors import ShapeError, UsageError
from manifold.core.pairs import NAMED_GRIDS, RusinkiewiczGrid, cosine_weight
from manifold.evaluate.method_data import Data
from manifold.evaluate.model_methods import model_methods
from manifold.gplvm import log_likelihood
from manifold.io_rgl import read_bsdf, write_bsdf
from manifold.library.compacting import compact_library
from manifold.library.importing import import_files
from manifold.library.store import Library
from manifold.model.comparison import rmse22
from manifold.model.diagnostics import predict_and_diagnose
from manifold.model.location import locate
from manifold.model.manifold import Manifold
from manifold.model.settings import GplvmSettings

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
    return Manifold.fit(library, GplvmSettings(mapping=request.param), calibrate=False)


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


def test_the_posterior_deviation_is_that_of_the_weighted_mapped_values(model, rng):
    """s^2 = tr(K^-1 Y Y^T) / (N D) of the rows `sqrt(cos_i cos_o) T(f)` that the Gram matrix is made of."""
    wi, wo, above = RusinkiewiczGrid.named("default").directions()
    wi, wo = wi[above], wo[above]
    mapped = T[model.settings.mapping](np.array([model.material(name).eval(wi, wo) for name in model.names]))
    Y = (np.sqrt(cosine_weight(wi, wo))[:, None] * mapped).reshape(len(NAMES), -1)
    between = rng.dirichlet(np.ones(len(NAMES)), 5) @ model.X
    _, variance = reference.posterior(model.X, Y, between, model.settings.mu, 1.0)
    K = reference.covariance_matrix(model.X, model.X, model.settings.mu, 1.0)
    Y -= Y.mean(axis=0)
    s2 = np.trace(np.linalg.solve(K, Y @ Y.T)) / Y.size
    found = model.posterior(between)
    np.testing.assert_allclose(found.std, np.sqrt(s2 * variance), rtol=1e-6)
    np.testing.assert_array_equal(found.relative, model.std(between))
    assert found.unit == f"sqrt(cos(theta_i) cos(theta_o)) T(f), T = {model.settings.mapping}, f in 1/sr"
    assert model.posterior(NAMES[0]).std == 0.0  # the datum itself


def test_a_prediction_states_its_posterior_deviation_with_the_unit(model):
    found = predict_and_diagnose(model, model.X.mean(axis=0))
    posterior = model.posterior(model.X.mean(axis=0))
    assert found.to_json()["posterior"] == {
        "std": float(posterior.std), "relative": float(posterior.relative), "unit": posterior.unit,
    }  # fmt: skip
    assert found.rows["posterior standard deviation"].startswith(f"{posterior.std:.3g} of sqrt(cos")


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


COARSE = RusinkiewiczGrid(9, 9, 18, squared_theta_h=False, offset=0.0)


@pytest.fixture(scope="module")
def literal(folder):
    """The published settings to the letter, on one in a thousand of the published pairs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(NAMED_GRIDS, "hikichi", COARSE)
        return Manifold.fit(folder / "library.zarr", GplvmSettings.published())


@pytest.fixture(scope="module")
def raw(folder):
    """Values of the files as they are, zeros below the horizon, less their mean: shape (N, D)."""
    angles = [np.arange(n) * step for n, step in ((9, np.pi / 18), (9, np.pi / 18), (18, np.pi / 18))]
    wi, wo = np.array(
        [reference.rusinkiewicz(h, d, p) for h in angles[0] for d in angles[1] for p in angles[2]]
    ).transpose(1, 0, 2)
    above = (wi[:, 2] > 0.0) & (wo[:, 2] > 0.0)
    Y = np.zeros((len(NAMES), len(wi), 3))
    for k, name in enumerate(NAMES):
        brdf = MeasuredBRDF(read_bsdf(folder / "files" / f"{name}_rgb.bsdf"))
        Y[k, above] = brdf.eval(wi[above], wo[above])
    return Y.reshape(len(NAMES), -1)


def test_the_letter_has_the_gram_matrix_of_raw_values_without_weights(literal, raw):
    """Sums in another order; values are single precision."""
    np.testing.assert_allclose(literal.space.S, raw @ raw.T, rtol=1e-5)
    assert literal.space.n_outputs == raw.shape[1] == 9 * 9 * 18 * 3


def test_the_letter_ends_where_no_move_of_a_coordinate_raises_the_likelihood(literal, raw):
    Y = raw - raw.mean(axis=0)
    mu, l = literal.settings.mu, literal.settings.length_scale
    best = reference.log_likelihood(literal.X, Y, mu, l)
    start = literal.statistics["objective_start"]
    assert literal.statistics["objective"] < start - 1e-3 * abs(start)
    for index in np.ndindex(literal.X.shape):
        for step in (-1e-3, 1e-3):  # ten times the last step of the search
            moved = literal.X.copy()
            moved[index] += step
            # The likelihood sums thousands of outputs; K has a condition of up to 1e5.
            assert reference.log_likelihood(moved, Y, mu, l) < best + 1e-7 * abs(best)


def test_the_letter_predicts_the_posterior_mean_with_its_negative_values(literal, raw, rng):
    mean = raw.mean(axis=0)
    between = np.concatenate([rng.dirichlet(np.ones(len(NAMES)), 20) @ literal.X, literal.X])
    expected, variance = reference.posterior(literal.X, raw, between, 1e-4, 1.0)
    weights = literal.gp.weights(between)
    np.testing.assert_allclose(weights @ raw, expected, atol=1e-7 * np.abs(raw).max())
    np.testing.assert_allclose(literal.gp.variance(between), variance, atol=1e-9)
    np.testing.assert_allclose(literal.posterior(between).std ** 2, variance, atol=1e-9)  # s^2 = 1
    assert literal.posterior(between).unit == "T(f), T = identity, f in 1/sr"
    np.testing.assert_array_equal(weights[20:], np.eye(len(NAMES)))  # the delta of eq. 11
    K = reference.covariance_matrix(literal.X, literal.X, 1e-4, 1.0)
    np.testing.assert_allclose(literal.gp.K, K, atol=1e-14)
    moved, bound = reference.both_sides_of_eq_15(literal.X, raw - mean, between[:20], 1e-4, 1.0)
    found = literal.gp.length_scale_bound(between[:20], literal.space.S)
    np.testing.assert_allclose(found.displacement, moved, rtol=1e-5)
    np.testing.assert_allclose(found.bound, bound, rtol=1e-5)
    negative = between[int(np.argmin((weights @ raw).min(axis=1)))]
    pairs = (
        from_spherical(np.linspace(0.0, 1.4, 30), 0.0)[:, None],
        from_spherical(np.linspace(0.0, 1.4, 30), np.pi),
    )
    assert literal.predict(negative).eval(*pairs).min() < 0.0


def test_the_letter_keeps_the_zeros_of_unmeasured_cells_also_when_it_is_loaded(literal, tmp_path):
    at = (0, 2, slice(None), 11, 11)
    literal.save(tmp_path / "model.h5")
    loaded = Manifold.load(tmp_path / "model.h5", literal.library)
    assert loaded.settings == literal.settings
    for model in (literal, loaded):
        assert np.all(model.materials.measured_file("syn_satin_gold").spectra[at] == 0.0)


def test_reports_of_the_letter_keep_negative_values_and_the_unit_variance(literal):
    data = Data.evaluate(literal.materials.filled(), RusinkiewiczGrid(8, 6, 4))
    others = np.arange(1, len(NAMES))
    for method in model_methods(literal):
        if method.key in ("gp_latents_kept", "gp_encoded", "gp_refitted"):
            found = method.fit(data, others)(0)
            assert not found.is_clipped
            assert 0.0 <= found.variance <= 1.0 + literal.settings.mu  # of s^2 = 1


def test_the_letter_refuses_other_mappings():
    with pytest.raises(UsageError, match=r"expected GplvmSettings\.published"):
        GplvmSettings(mapping="cube-root", as_published=True)


def test_the_research_interface_gives_the_quantities_of_the_paper(literal, raw, rng):
    """Eq. 21 with its constants, the Gram matrix, both sides of eq. 15, and eq. 22 and 23 between two materials."""
    Y = raw - raw.mean(axis=0)
    gram = literal.gram
    assert log_likelihood(literal.X, gram.S, gram.n_outputs) == pytest.approx(
        reference.log_likelihood(literal.X, Y, 1e-4, 1.0), rel=1e-6
    )
    x = rng.dirichlet(np.ones(len(NAMES))) @ literal.X
    moved, bound = reference.both_sides_of_eq_15(literal.X, Y, x[None], 1e-4, 1.0)
    found = literal.eq15(x)
    np.testing.assert_allclose([found.displacement, found.bound], [moved, bound], rtol=1e-5)
    np.testing.assert_array_equal(literal.eq15(np.stack([x, x])).bound, np.repeat(found.bound, 2))
    between = literal.linear(NAMES[1], NAMES[3], 0.3)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(NAMED_GRIDS, "hikichi", COARSE)
        of_paper = rmse22(literal.material(NAMES[1]), between)
    expected = reference.rmse(
        raw[1].reshape(-1, 3), 0.3 * raw[1].reshape(-1, 3) + 0.7 * raw[3].reshape(-1, 3)
    )
    assert of_paper == pytest.approx(expected, rel=1e-5)


def test_latents_of_ones_own_are_kept(folder, model, rng):
    own = rng.normal(size=(len(NAMES), 2))
    fitted = Manifold.fit(folder / "library.zarr", model.settings, latents=own, calibrate=False)
    np.testing.assert_array_equal(fitted.X, own)
    gram = fitted.gram
    F = -log_likelihood(own, gram.S, gram.n_outputs, output_variance=None) / gram.n_outputs
    N = len(NAMES)
    assert fitted.statistics["objective"] == pytest.approx(
        F - 0.5 * N * (1.0 + np.log(2.0 * np.pi)), rel=1e-9
    )
    with pytest.raises(ShapeError, match=r"expected \(6, 2\)"):
        Manifold.fit(folder / "library.zarr", model.settings, latents=own[:, :1])
    with pytest.raises(UsageError, match="use kind gplvm"):
        Manifold.fit(folder / "library.zarr", latents=own)
