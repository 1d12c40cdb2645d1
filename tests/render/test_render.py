"""Renders of the material ball, the colours they have, and the differences between pictures."""

from __future__ import annotations

import json
import os
import shutil
import struct
import subprocess
import sys
import warnings
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.small_library import measured, small_model
from PIL import Image

from manifold.analytic import corpus
from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import RoughConductor
from manifold.brdf import goniometer
from manifold.cli.main import run as run_here
from manifold.colour import lights
from manifold.colour.conversion import InvisibleBandsWarning, decode_srgb, sensor_responses, srgb_to_xyz
from manifold.colour.difference import delta_e_2000
from manifold.colour.illuminants import Illuminant
from manifold.core.errors import FileFormatError, ShapeError, UsageError
from manifold.core.records import Bands
from manifold.io_rgl import write_bsdf
from manifold.render import backend, images, render, scenes
from manifold.render.ball import make_settings, parse_illuminant, read_material, render_material
from manifold.render.images import GuessedEncodingWarning
from manifold.render.render import RenderSettings, render_bsdf

GREY = {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.4}}


def run_apart(folder: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """The command line in a folder, as a process of its own."""
    code = "from manifold.cli.main import run; run()"
    return subprocess.run(
        [sys.executable, "-c", code, *arguments],
        cwd=folder, capture_output=True, text=True, env=os.environ | environment, check=False,
    )  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A folder with a felt, a glossy and a spectral material, and a model."""
    path = tmp_path_factory.mktemp("render")
    for name in ("syn_felt_green", "syn_gloss_red"):
        write_bsdf(path / f"{name}_rgb.bsdf", measured(name))
    gold = {m.name: m for m in corpus.isotropic_materials()}["syn_satin_gold"]
    write_bsdf(path / "syn_satin_gold_spec.bsdf", corpus.measure(gold))
    (path / "flat.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    small_model(path)
    return path


# -- scene ----------------------------------------------------------------------------------------------------


def test_a_white_diffuser_on_the_floor_has_radiance_one():
    environment = lights.studio(128).astype(float)
    theta = np.pi * (np.arange(128) + 0.5) / 128
    solid_angle = np.sin(theta) * (np.pi / 128) ** 2
    irradiance = np.sum(environment[..., 0] * (np.maximum(np.cos(theta), 0.0) * solid_angle)[:, None])
    assert irradiance / np.pi == pytest.approx(1.0, rel=1e-3)
    with pytest.raises(UsageError, match="is black, expected radiance above 0"):
        lights.exposed(np.zeros((4, 8, 3)))


def test_normals_of_the_pedestal_point_outwards():
    vertices, triangles = scenes.pedestal(24)
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    inside = np.array([0.0, 0.0, 0.1])
    assert np.all(np.sum(normal * ((a + b + c) / 3 - inside), axis=1) > 0)


def test_the_ball_is_where_its_mask_says():
    black = {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.0}}
    picture = render_bsdf(black, True, RenderSettings(size=64, samples=16)).mean(axis=2)
    mask = scenes.ball_interior(64, 0.03)
    assert picture[mask].max() == 0.0
    assert picture[~scenes.ball_interior(64, -0.05)].min() > 0.0
    assert 0.2 < mask.mean() < 0.4


# -- colour ---------------------------------------------------------------------------------------------------


def test_colours_of_the_spectral_film_are_those_of_mitsubas_own_film():
    mi = backend.mitsuba("spectral")
    settings = RenderSettings(size=32, samples=400)
    red = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.2, 0.1]}}
    ours = render_bsdf(red, False, settings)
    theirs = render.render_scene(
        mi, mi.load_dict(scenes.material_ball(mi, red, render.rgb_film(32))), settings
    )
    # Their matching functions are fits of 1 %; noise of the mean over the ball is far below.
    ball = scenes.ball_interior(32, 0.1)
    np.testing.assert_allclose(ours[ball].mean(axis=0), theirs[ball].mean(axis=0), rtol=0.02)
    np.testing.assert_allclose(ours[~ball].mean(axis=0), theirs[~ball].mean(axis=0), rtol=0.02)


@pytest.mark.parametrize("name", ["A", "F11", "LED-B3"])
def test_a_spectral_render_has_the_colours_that_colour_science_integrates(name):
    """Under a uniform sky a convex diffuser is its reflectance, whatever the light."""
    mi = backend.mitsuba("spectral")
    nm = np.linspace(360.0, 830.0, 95)
    reflectance = 0.2 + 0.6 * np.exp(-(((nm - 610.0) / 40.0) ** 2))
    values = ",".join(f"{v:.6f}" for v in reflectance)
    spectrum = {"type": "regular", "wavelength_min": 360.0, "wavelength_max": 830.0, "values": values}
    film = render.colorimetric_film(mi, 8, Illuminant.named(name))
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2},
        "light": {"type": "envmap", "bitmap": mi.Bitmap(np.ones((4, 8, 3), np.float32))},
        "ball": {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": spectrum}},
        "sensor": {
            "type": "perspective", "fov": 5.0, "film": film,
            "to_world": mi.ScalarTransform4f().look_at([0, -8, 0], [0, 0, 0], [0, 0, 1]),
        },
    }  # fmt: skip
    xyz = render.render_scene(mi, mi.load_dict(scene), RenderSettings(size=8, samples=2000)).mean(axis=(0, 1))
    nodes, responses = sensor_responses(Illuminant.named(name))
    np.testing.assert_allclose(xyz, np.interp(nodes, nm, reflectance) @ responses, rtol=0.01)


def test_an_illuminant_from_a_file_is_the_illuminant(tmp_path):
    named = Illuminant.named("A")
    path = tmp_path / "lamp.csv"
    path.write_text(
        "nm,power\n" + "".join(f"{w},{p}\n" for w, p in zip(named.wavelengths_nm, named.power, strict=True))
    )
    read = parse_illuminant(str(path))
    assert read.power == named.power
    assert not read.is_d65
    assert not Illuminant.read(Path(shutil.copy(path, tmp_path / "D65.txt"))).is_d65
    path.write_text("400 -1\n500 1\n")
    with pytest.raises(FileFormatError, match="expected powers from 0"):
        Illuminant.read(path)
    with pytest.raises(UsageError, match="no such file"):
        parse_illuminant(str(tmp_path / "nothing.csv"))
    with pytest.raises(UsageError, match="did you mean"):
        parse_illuminant("D66")


def test_tone_mapping_keeps_what_a_display_can_show_and_never_reaches_white():
    x = np.linspace(0.0, 0.7, 50)
    np.testing.assert_allclose(decode_srgb(images.tone_map(x)), x, atol=1e-6)
    bright = images.tone_map(np.array([0.7, 0.8, 1.0, 2.0]))
    assert np.all(np.diff(bright) > 0)
    assert bright[-1] < 1.0
    assert images.tone_map(np.array([-0.1]))[0] == 0.0


# -- pictures -------------------------------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_picture_and_another_seed_another():
    a, b, c = (render_bsdf(GREY, True, RenderSettings(size=24, samples=9, seed=s)) for s in (3, 3, 4))
    np.testing.assert_allclose(a, b, rtol=1e-5)  # threads add to a pixel in any order
    assert np.abs(a - c).max() > 1e-3


def test_a_glossy_ball_has_a_highlight_at_the_upper_left_and_a_felt_has_none(folder):
    peaks = {}
    for name in ("syn_gloss_red", "syn_felt_green"):
        source = read_material(folder / f"{name}_rgb.bsdf")
        picture = source.render(RenderSettings(size=64, samples=64))
        values = np.where(scenes.ball_interior(64, 0.1), picture.mean(axis=2), 0.0)
        row, column = np.unravel_index(np.argmax(values), values.shape)
        ball = values[values > 0]
        peaks[name] = (values.max() / np.median(ball), row, column)
        if name == "syn_felt_green":
            assert np.argmax(picture[scenes.ball_interior(64)].mean(axis=0)) == 1
    strength, row, column = peaks["syn_gloss_red"]
    assert strength > 2.5
    assert row < 30
    assert column < 32
    assert peaks["syn_felt_green"][0] < 2


def test_pictures_survive_files(tmp_path, rng):
    linear = rng.random((12, 16, 3)) * 3.0 - 0.1
    images.write_image(tmp_path / "a.exr", linear)
    np.testing.assert_allclose(images.read_image(tmp_path / "a.exr"), linear, rtol=1e-3, atol=1e-3)
    images.write_image(tmp_path / "a.png", linear)
    np.testing.assert_allclose(
        images.read_display(tmp_path / "a.png"), images.tone_map(linear), atol=0.5 / 255 + 1e-6
    )
    np.testing.assert_allclose(images.read_display(tmp_path / "a.exr"), images.tone_map(linear), atol=1e-2)
    (tmp_path / "b.png").write_bytes(b"no picture")
    with pytest.raises(FileFormatError, match="not a readable picture"):
        images.read_image(tmp_path / "b.png")
    with pytest.raises(UsageError, match=r"\.exr \(linear\) or \.png"):
        images.write_image(tmp_path / "a.gif", linear)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.exr", "a.png", "b.png"]


# -- differences ----------------------------------------------------------------------------------------------


def test_flip_is_zero_for_equal_pictures_symmetric_and_one_at_most(rng):
    a, b = rng.random((2, 40, 50, 3))
    np.testing.assert_allclose(images.flip_map(a, a), 0.0, atol=1e-6)
    np.testing.assert_allclose(images.flip_map(a, b), images.flip_map(b, a), rtol=1e-4)
    green, blue = np.zeros((2, 32, 32, 3))
    green[..., 1], blue[..., 2] = 1.0, 1.0
    np.testing.assert_allclose(images.flip_map(green, blue), 1.0, atol=1e-5)  # the most that there is


def test_flip_is_of_display_values_at_the_distance_given():
    """The reference values come from the authors' program for PNG files, at 67.02 pixels per degree."""
    y, x = np.mgrid[0:48, 0:64] / 64.0
    a = np.stack([x, y, 0.5 + 0.4 * np.sin(20 * x)], axis=-1)
    b = np.clip(np.stack([x + 0.05, y * y, 0.5 + 0.4 * np.sin(21 * x)], axis=-1), 0.0, 1.0)
    b[10:20, 30:40] = [1.0, 0.2, 0.1]
    flip = images.flip_map(a, b, 67.02064514160156)
    assert flip.mean() == pytest.approx(0.5536173, rel=1e-3)
    assert flip[15, 35] == pytest.approx(0.9492131, rel=1e-3)


def test_ciede2000_maps_are_those_of_single_colours():
    a, b = np.full((4, 4, 3), 0.5), np.full((4, 4, 3), 0.5)
    b[1, 2] = [0.6, 0.5, 0.4]
    found = images.ciede2000_map(a, b)
    white = srgb_to_xyz(np.ones(3))
    xyz = [srgb_to_xyz(decode_srgb(np.array(c))) for c in ([0.5, 0.5, 0.5], [0.6, 0.5, 0.4])]
    assert found[1, 2] == pytest.approx(float(delta_e_2000(*xyz, white)), rel=1e-9)
    assert np.count_nonzero(found > 1e-9) == 1
    with pytest.raises(ShapeError, match="expected the same"):
        images.ciede2000_map(a, b[:2])


# -- command line ---------------------------------------------------------------------------------------------


def test_pictures_are_compared_in_the_spaces_that_they_state(tmp_path, run):
    codes = np.full((32, 32, 3), (200, 60, 40), np.uint8)
    p3 = np.full((32, 32, 3), (217, 42, 23), np.uint8)  # of the same codes in Display P3, in sRGB
    Image.fromarray(p3).save(tmp_path / "srgb.png")
    Image.fromarray(codes).save(tmp_path / "plain.png")
    chunk = b"cICP" + bytes([12, 13, 0, 1])
    content = (tmp_path / "plain.png").read_bytes()
    stated = struct.pack(">I", 4) + chunk + struct.pack(">I", zlib.crc32(chunk))
    (tmp_path / "p3.png").write_bytes(content[:33] + stated + content[33:])

    def mean(*names, options=()):
        status, _, stderr = run("compare", *names, "-o", "c.png", "--json", "c.json", *options, cwd=tmp_path)
        assert status == 0, stderr
        return json.loads((tmp_path / "c.json").read_text())["ciede2000"]["mean"]

    assert mean("p3.png", "plain.png") > 3.0
    assert mean("p3.png", "srgb.png") < 0.5  # rounding of codes
    assert mean("plain.png", "plain.png", options=["--linear"]) == 0.0
    with pytest.raises(AssertionError, match="expected at most one of them"):
        mean("plain.png", "plain.png", options=["--linear", "--encoded"])


def test_an_environment_is_read_as_asked(tmp_path):
    codes = np.full((16, 32, 3), 128, np.uint8)
    codes[:, :16] = 64
    Image.fromarray(codes).save(tmp_path / "room.png")
    options = {"size": 16, "samples": 1, "seed": 0, "illuminant": "D65", "environment": tmp_path / "room.png"}
    with pytest.warns(GuessedEncodingWarning, match="states no encoding"):
        decoded = make_settings(**options).environment
    linear = make_settings(**options, is_linear=True).environment
    assert decoded[0, 0, 0] / decoded[0, 20, 0] == pytest.approx(
        decode_srgb(64 / 255) / decode_srgb(128 / 255)
    )
    assert linear[0, 0, 0] / linear[0, 20, 0] == pytest.approx(0.5)


def test_render_and_compare_on_the_command_line(folder, tmp_path, run):
    common = ("--size", "32", "--samples", "16")
    for name, output in (("syn_gloss_red_rgb", "a.exr"), ("syn_felt_green_rgb", "b.png")):
        status, out, err = run(
            "render", f"{name}.bsdf", "-o", tmp_path / output, *common, "--json", "-", cwd=folder
        )
        assert status == 0, err
        assert json.loads(out)["material"] == name.removesuffix("_rgb")
    status, _, err = run("compare", "a.exr", "b.png", "-o", "c.png", "--json", "c.json", cwd=tmp_path)
    assert status == 0, err
    numbers = json.loads((tmp_path / "c.json").read_text())
    assert numbers["ciede2000"]["p95"] > 20  # red against green
    assert 0 < numbers["flip"]["mean"] < 1
    assert images.read_image(tmp_path / "c.png").shape[2] == 3


def test_a_latent_renders_like_its_prediction(folder, tmp_path, run):
    at, size = ("0.1,-0.1",), ("--size", "24", "--samples", "16")
    for arguments in (
        ("render", *at, "-o", tmp_path / "latent.exr", *size),
        ("predict", *at, "--resolution", "48", "--incidences", "24", "-o", tmp_path / "p_rgb.bsdf"),
    ):
        status, _, err = run(*arguments, cwd=folder)
        assert status == 0, err
    source = read_material(tmp_path / "p_rgb.bsdf")
    picture = source.render(RenderSettings(size=24, samples=16))
    np.testing.assert_allclose(images.read_image(tmp_path / "latent.exr"), picture, rtol=1e-2, atol=1e-3)


def test_a_picture_of_the_surroundings_is_seen_in_the_ball(folder, tmp_path):
    surroundings = np.full((16, 32, 3), 0.5)
    surroundings[:, 16:] = [1.0, 0.0, 0.0]  # the left half, seen from the camera
    images.write_image(tmp_path / "red.exr", surroundings)
    settings = make_settings(size=32, samples=64, seed=0, illuminant="D65", environment=tmp_path / "red.exr")
    picture = render_bsdf(GREY, True, settings)
    ball, x = scenes.ball_interior(32), np.broadcast_to(np.arange(32), (32, 32))
    left, right = (picture[ball & side].mean(axis=0) for side in (x < 12, x > 20))
    assert left[0] / left[1] > 1.5 * right[0] / right[1]


def test_scalar_variants_make_the_same_picture(folder):
    source = folder / "syn_satin_gold_spec.bsdf"
    done = run_apart(
        folder, "render", source.name, "-o", "scalar.exr", "--size", "16", "--samples", "100",
        MANIFOLD_RENDERER="scalar",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""  # asked for, so no advice
    found = read_material(source)
    picture = found.render(RenderSettings(size=16, samples=400, seed=9))
    scalar = images.read_image(folder / "scalar.exr")
    np.testing.assert_allclose(scalar.mean(axis=(0, 1)), picture.mean(axis=(0, 1)), rtol=0.03)


@pytest.mark.parametrize(
    ("arguments", "message", "code"),
    [
        (("render",), "no material is given; give one", 2),
        (("render", "syn_gloss_red_rgb.bsdf", "--direct"), "--direct evaluates predictions", 2),
        (("render", "syn_gloss_red_rgb.bsdf", "--illuminant", "F11"), "needs a spectrum", 2),
        (("render", "syn_gloss_red_rgb.bsdf", "-o", "a.jpg"), "ends in .exr", 2),
        (("render", "syn_gloss_red_rgb.bsdf", "-o", "nowhere/a.png"), "cannot write", 1),
        (("render", "syn_gloss_red_rgb.bsdf", "--environment", "nothing.exr"), "no such file", 1),
        (("render", "0,0,0,0"), "found 4 coordinates", 2),
        (("compare", "syn_gloss_red_rgb.bsdf", "a.png"), "a.png: no such file", 1),
        (("compare", "syn_gloss_red_rgb.bsdf", "flat.png"), "a material and a picture", 2),
    ],
)
def test_what_cannot_be_rendered_is_refused_in_one_line(
    folder, monkeypatch, capsys, arguments, message, code
):
    monkeypatch.chdir(folder)
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)  # which the program replaces
    with pytest.raises(SystemExit) as leaving:
        run_here(list(arguments))
    assert leaving.value.code == code
    stderr = capsys.readouterr().err
    assert message in stderr
    assert len(stderr.strip().splitlines()) == 1


def test_a_turned_file_is_rendered_aligned():
    normals = GGX.anisotropic(0.5, 0.15)
    metal = RoughConductor(normals, np.array(1.5), np.full(3, 3.0), Bands(None))
    file = goniometer.measure(metal, "brushed", resolution=12, n_theta_i=6, n_phi_i=9)
    settings = RenderSettings(size=16, samples=64)
    plain, half_turn, quarter = (
        render_material(replace(file, rotation_rad=angle), settings) for angle in (0.0, np.pi, 0.5 * np.pi)
    )
    change = [np.abs(found - plain).mean() for found in (half_turn, quarter)]
    assert change[0] < 0.3 * change[1]


def test_a_file_of_the_infrared_is_read_for_rendering_with_a_warning(tmp_path):
    bands = Bands((910.5, 940.5, 1050.5))
    metal = RoughConductor(GGX.isotropic(0.5), np.full(3, 1.5), np.full(3, 3.0), bands)
    write_bsdf(tmp_path / "far_spec.bsdf", goniometer.measure(metal, "far", resolution=4, n_theta_i=3))
    with pytest.warns(InvisibleBandsWarning, match="no colour"):
        read_material(tmp_path / "far_spec.bsdf")
