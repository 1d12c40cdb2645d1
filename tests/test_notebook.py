"""What somebody meets who uses the package from Python, in a notebook."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from small_library import NAMES, measured, small_model

from manifold.errors import ShapeError, UsageError
from manifold.io_rgl import write_bsdf
from manifold.library.importing import import_files
from manifold.model.manifold import Manifold, Settings
from manifold.records import Bands


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return Manifold.load(small_model(tmp_path_factory.mktemp("notebook")))


def test_using_colours_does_not_change_how_the_callers_arrays_are_printed():
    script = (
        "import numpy as np; from manifold.colour import diffuse_reflectance_names; before = repr(np.float64(0.5))\n"
        "diffuse_reflectance_names(); import sys; assert 'colour' in sys.modules\n"
        "assert repr(np.float64(0.5)) == before == 'np.float64(0.5)', repr(np.float64(0.5))"
    )
    subprocess.run([sys.executable, "-c", script], check=True)


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
    ("settings", "message"),
    [
        ({"latent_dim": "auto"}, "latent_dim is 'auto', expected a whole number from 0"),
        ({"latent_dim": 2.5}, "latent_dim is 2.5, expected a whole number from 0"),
        ({"latent_dim": -1}, "latent_dim is -1, expected a whole number from 0"),
        ({"sample_bands": 1}, "sample_bands is 1, expected a whole number from 2"),
        ({"grid": "fine"}, "no grid is called 'fine', expected one of default, hikichi"),
    ],
)
def test_settings_are_refused_before_a_library_is_read(settings, message):
    with pytest.raises(UsageError, match=message):
        Settings(**settings)


def test_several_latents_have_the_errors_and_support_of_each(model):
    X = np.vstack([model.X, model.X.mean(axis=0), model.X.max(axis=0) + 9.0])
    together, each = model.expected_error(X), [model.expected_error(x) for x in X]
    for name in ("ball", "cube_root"):
        expected = [getattr(one, name) for one in each]
        np.testing.assert_allclose(getattr(together, name), expected, rtol=1e-12)  # sums in another order
    assert np.all(together.ball[: len(NAMES)] == 0.0)
    assert np.all(together.ball[len(NAMES) :] > 0.0)
    np.testing.assert_array_equal(model.is_extrapolation(X), [model.is_extrapolation(x) for x in X])


def test_several_latents_of_a_monochrome_manifold_have_what_each_has(model):
    monochrome = Manifold.fit(model.library, Settings(kind="monochrome"))
    colours = monochrome.space.colours[2]
    for found in (monochrome.std, monochrome.weights):
        together = found(monochrome.X, colours)
        each = [found(x, colours) for x in monochrome.X]
        np.testing.assert_allclose(together, each, rtol=1e-9, atol=1e-12)  # sums in another order
        if found == monochrome.std:
            assert together[2] == 0.0
            assert np.all(np.delete(together, 2) > 0.0)
