"""Published neural fits: their files, what they evaluate to, and what is written of them."""

from __future__ import annotations

import io
import os
import zipfile
from itertools import pairwise
from pathlib import Path

import h5py
import numpy as np
import pytest
from helpers.paths import REPOSITORY, real_rgl_files
from typer.testing import CliRunner

from manifold.analytic.corpus import rgl_bands
from manifold.analytic.neural import NeuralBRDF, read_neural_fits, write_neural
from manifold.brdf.measured import BRDF, MeasuredBRDF
from manifold.brdf.plausibility import plausibility
from manifold.cli.main import app
from manifold.colour.conversion import to_srgb
from manifold.directions import from_spherical, to_rusinkiewicz
from manifold.errors import FileFormatError, UsageError
from manifold.io_rgl import read_bsdf
from manifold.metrics import RusinkiewiczGrid, cosine_weight

SIZES = (6, 4, 5, 3)


def published_folder() -> Path | None:
    """The folder of published fits: `MANIFOLD_NBRDF_DIR`, else `../shared/anchors/nbrdf`, else None."""
    named = os.environ.get("MANIFOLD_NBRDF_DIR")
    folder = Path(named) if named else REPOSITORY.parent / "shared" / "anchors" / "nbrdf"
    return folder if folder.is_dir() else None


needs_published_fits = pytest.mark.skipif(
    published_folder() is None, reason="no published neural fits; name their folder in MANIFOLD_NBRDF_DIR"
)


def random_layers(rng, brightness=0.3):
    """Weights of a small network that is bright everywhere, and not symmetric."""
    sizes = list(pairwise(SIZES))
    layers = [(0.5 * rng.standard_normal(size), 0.2 * rng.standard_normal(size[1])) for size in sizes]
    layers[-1] = (0.3 * layers[-1][0], np.full(3, brightness))
    return layers


def keras_file(layers) -> bytes:
    """An HDF5 file with the groups of Keras."""
    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        for k, (kernel, bias) in enumerate(layers, start=9):  # dense_10 sorts before dense_9 as text
            file[f"dense_{k}/dense_{k}/kernel:0"] = kernel.astype(np.float32)
            file[f"dense_{k}/dense_{k}/bias:0"] = bias.astype(np.float32)
    return content.getvalue()


@pytest.fixture
def fits(tmp_path, rng) -> Path:
    """A folder with one network in a zip file and one in a subfolder."""
    with zipfile.ZipFile(tmp_path / "rgl_nbrdf.zip", "w") as archive:
        archive.writestr("data/red_rgb.h5", keras_file(random_layers(rng)))
        archive.writestr("data/red_rgb.json", "{}")
    (tmp_path / "merl").mkdir()
    (tmp_path / "merl" / "blue.h5").write_bytes(keras_file(random_layers(rng)))
    return tmp_path


def some_pairs(rng, n=200):
    theta, phi = rng.uniform(0.01, 1.5, (2, n)), rng.uniform(-np.pi, np.pi, (2, n))
    return from_spherical(theta[0], phi[0]), from_spherical(theta[1], phi[1])


def by_hand(layers, wi, wo, mirrored):
    """The network's value for one pair, one sum at a time."""
    theta_h, theta_d, phi_d, _ = (float(a) for a in to_rusinkiewicz(wi, wo))
    phi_d = phi_d + np.pi if phi_d < 0 else phi_d
    phi_d = np.pi - phi_d if mirrored else phi_d
    x = [np.sin(theta_h), 0.0, np.cos(theta_h)]
    x += [np.sin(theta_d) * np.cos(phi_d), np.sin(theta_d) * np.sin(phi_d), np.cos(theta_d)]
    for k, (kernel, bias) in enumerate(layers):
        x = [sum(x[i] * kernel[i, j] for i in range(len(x))) + bias[j] for j in range(len(bias))]
        x = [max(v, 0.0) if k < len(layers) - 1 else max(np.exp(v) - 1.0, 0.0) for v in x]
    return x


@pytest.mark.parametrize("name", ["red", "blue"])
def test_a_network_is_evaluated_as_published(fits, rng, name):
    brdf = read_neural_fits(fits)[name]
    wi, wo = some_pairs(rng, 20)
    expected = [
        by_hand(brdf.weights.layers, *pair, mirrored=name == "red") for pair in zip(wi, wo, strict=True)
    ]
    np.testing.assert_allclose(brdf.eval(wi, wo), expected, rtol=1e-9)  # sums in another order


def test_a_neural_fit_is_a_reciprocal_isotropic_brdf(fits, rng):
    brdf = read_neural_fits(fits)["red"]
    wi, wo = some_pairs(rng)
    f = brdf.eval(wi, wo)
    assert isinstance(brdf, BRDF)
    assert np.ptp(f) > 0.1
    np.testing.assert_allclose(brdf.eval(wo, wi), f, rtol=1e-9)  # rounding of the angles
    c, s = np.cos(1.0), np.sin(1.0)
    turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    np.testing.assert_allclose(brdf.eval(wi @ turn, wo @ turn), f, rtol=1e-9)
    assert np.all(brdf.eval(wi, -wo) == 0)


def test_up_sampled_spectra_look_like_the_colours_they_come_from(fits, rng):
    rgb = read_neural_fits(fits)["blue"]
    spectral = NeuralBRDF(rgb.weights, rgl_bands())
    wi, wo = some_pairs(rng)
    f = spectral.eval(wi, wo)
    assert f.shape == (200, 195)
    assert f.min() >= 0
    # The basis spectra reproduce linear sRGB at 5 nm; 195 bands of 3.3 nm sample them.
    np.testing.assert_allclose(to_srgb(f, spectral.bands), rgb.eval(wi, wo), atol=2e-3 * f.max())


def test_written_fits_return_no_more_light_than_arrives(tmp_path, rng):
    (tmp_path / "bright.h5").write_bytes(keras_file(random_layers(rng, brightness=1.5)))
    brdf = read_neural_fits(tmp_path / "bright.h5")["bright"]
    assert brdf.albedo(from_spherical(np.array([0.5]), 0.0)).max() > 1.5
    bounded = brdf.plausible()
    theta = np.deg2rad(np.arange(0.0, 88.0, 7.0))
    assert (
        bounded.albedo(from_spherical(theta, 0.0)).max() <= 1.0 + 1e-3
    )  # limits are linear between 3 degrees
    assert plausibility(bounded).reciprocity_error < 1e-9
    path = write_neural(tmp_path / "bright.h5", tmp_path / "out")[0]
    assert path.name == "bright_rgb.bsdf"
    assert MeasuredBRDF(read_bsdf(path)).albedo(from_spherical(theta, 0.0)).max() < 1.03  # of the grid


def test_plausible_fits_are_the_mean_over_both_sides_of_the_plane_of_incidence(tmp_path, rng):
    (tmp_path / "dark.h5").write_bytes(keras_file(random_layers(rng, brightness=0.0)))
    brdf = read_neural_fits(tmp_path)["dark"]
    wi, wo = some_pairs(rng)
    mirror = np.array([1.0, -1.0, 1.0])
    mean = 0.5 * (brdf.eval(wi, wo) + brdf.eval(wi * mirror, wo * mirror))
    np.testing.assert_allclose(brdf.plausible().eval(wi, wo), mean, rtol=1e-9)  # dark: no albedo to limit


def test_materials_of_the_same_name_are_told_apart_by_their_archive(fits):
    with zipfile.ZipFile(fits / "nielsen_nbrdf.zip", "w") as archive:
        archive.writestr("red.h5", zipfile.ZipFile(fits / "rgl_nbrdf.zip").read("data/red_rgb.h5"))
    assert sorted(read_neural_fits(fits)) == ["blue", "red_nielsen", "red_rgl"]


def test_the_command_writes_rgb_files_or_spectra(fits, tmp_path):
    for options, name, bands in (((), "blue_rgb.bsdf", 3), (("--spectral",), "blue_spec.bsdf", 195)):
        out = tmp_path / "out"
        result = CliRunner().invoke(app, ["corpus", str(out), "--neural", str(fits), *options])
        assert result.exit_code == 0, result.output
        file = read_bsdf(out / name)
        assert file.bands.count == bands
        assert file.description.startswith("Neural fit of blue (Sztrajman et al. 2021)")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--neural", "nothing.zip"], "nothing.zip: no such file or folder"),
        (["--spectral"], "--spectral without --neural"),
        (["--neural", ".", "--anisotropic"], "--neural with --anisotropic"),
    ],
)
def test_options_that_do_not_go_together_are_refused(tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=message):
        CliRunner().invoke(app, ["corpus", "out", *arguments], catch_exceptions=False, standalone_mode=False)
    assert not (tmp_path / "out").exists()


def test_what_is_no_neural_fit_is_refused_in_one_line(tmp_path, rng):
    layers = random_layers(rng)
    whole = keras_file(layers)
    layers[1] = (layers[1][0][:2], layers[1][1])
    infinite = random_layers(rng)
    infinite[0][0][0, 0] = np.inf
    for name, content, message in (
        ("empty.h5", b"", "empty.h5: not a readable HDF5 file"),
        ("cut.h5", whole[: len(whole) // 2], "cut.h5: not a readable HDF5 file"),
        ("other.h5", keras_file([]), "other.h5: found dense layers none, expected a chain from 6 inputs"),
        ("broken.h5", keras_file(layers), r"found dense layers 6x4 \+ 4, 2x5 \+ 5, 5x3 \+ 3, expected"),
        ("infinite.h5", keras_file(infinite), "infinite.h5: weights that are not finite"),
        ("text.zip", b"no archive", "text.zip: not a readable zip file"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(FileFormatError, match=message):
            read_neural_fits(tmp_path / name)
        (tmp_path / name).unlink()
    with pytest.raises(
        FileFormatError, match=r"no \.h5 file in it, expected weights of neural fits; give files"
    ):
        read_neural_fits(tmp_path)


@needs_published_fits
def test_published_fits_agree_with_the_files_they_were_trained_on():
    """Relative error, median and 90th percentile: 0.120 / 0.381 linear, 0.063 / 0.098 of cube roots (20 materials)."""
    fits = read_neural_fits(published_folder())
    wi, wo, above = RusinkiewiczGrid().directions()
    wi, wo = wi[above], wo[above]
    weight = cosine_weight(wi, wo)[:, None]
    linear, cube_root = [], []
    for path in real_rgl_files():
        name = path.stem.removesuffix("_rgb")
        fit = fits.get(name, fits.get(f"{name}_rgl"))
        if fit is not None and path.stem.endswith("_rgb"):
            f = np.maximum(
                MeasuredBRDF(read_bsdf(path)).eval(wi, wo), 0.0
            )  # colours outside sRGB are negative
            for errors, a, b in (
                (linear, weight * f, weight * fit.eval(wi, wo)),
                (cube_root, np.cbrt(weight * f), np.cbrt(weight * fit.eval(wi, wo))),
            ):
                errors.append(np.linalg.norm(b - a) / np.linalg.norm(a))
    if len(linear) < 20:
        pytest.skip(
            "the measured RGB files that the fits were trained on are not all here; set MANIFOLD_RGL_DIR"
        )
    # 1e-3: figures have three digits. More files than the 20 of the statement may be at hand.
    tolerance = 1e-3 if len(linear) == 20 else 0.05
    assert np.median(linear) == pytest.approx(0.120, abs=tolerance)
    assert np.percentile(linear, 90) == pytest.approx(0.381, abs=4 * tolerance)
    assert np.median(cube_root) == pytest.approx(0.063, abs=tolerance)
    assert np.percentile(cube_root, 90) == pytest.approx(0.098, abs=tolerance)


@needs_published_fits
def test_all_published_fits_are_read():
    fits = read_neural_fits(published_folder())
    assert len(fits) >= 151
    assert {"cardboard_rgl", "cardboard_nielsen", "gold-metallic-paint", "satin_purple"} <= set(fits)
    assert sum(kernel.size + bias.size for kernel, bias in fits["satin_purple"].weights.layers) == 675


def test_weights_in_other_files_or_of_more_bytes_than_the_file_are_refused(tmp_path):
    (tmp_path / "secret").write_bytes(bytes(800))
    with h5py.File(tmp_path / "outside.h5", "w") as file:
        file.create_dataset("dense/kernel", (10, 10), "<f8", external=[(str(tmp_path / "secret"), 0, 800)])
    with h5py.File(tmp_path / "bomb.h5", "w") as file:
        file.create_dataset(
            "dense/kernel", (1 << 20, 1 << 20), "<f8", chunks=(1 << 10, 1 << 10), fillvalue=1.0
        )
    for name, words in (("outside.h5", "lies in other files"), ("bomb.h5", "more than the file has")):
        with pytest.raises(FileFormatError, match=words):
            read_neural_fits(tmp_path / name)
    with zipfile.ZipFile(tmp_path / "bomb.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("red.h5", bytes(20 << 20))
    with pytest.raises(FileFormatError, match="larger than"):
        read_neural_fits(tmp_path / "bomb.zip")
