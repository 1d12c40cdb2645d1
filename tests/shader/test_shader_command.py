"""`manifold export --target shader`: one material, folders, packs, places, fits, errors, and the page."""

from __future__ import annotations

import json

import numpy as np
import pytest
from helpers.browser import TIMEOUT_MS
from helpers.small_library import measured, small_model
from typer.testing import CliRunner

from manifold.cli.main import app
from manifold.fit import fits
from manifold.fit.principled import fit_bsdf
from manifold.io_rgl import write_bsdf
from manifold.render import fit_json
from manifold.render.bsdf_parameters import principled

SATIN = "syn_satin_gold"

pytestmark = pytest.mark.usefixtures("quick_pictures")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two files and a folder with a shader of one of them."""
    path = tmp_path_factory.mktemp("shaders")
    (path / "files").mkdir()
    for name in (SATIN, "syn_felt_green"):
        write_bsdf(path / "files" / f"{name}_rgb.bsdf", measured(name))
    result = run("export", path / "files" / f"{SATIN}_rgb.bsdf", "--target", "shader", "-o", path / "satin")
    assert result.exit_code == 0, result.output
    return path


def run(*words):
    return CliRunner().invoke(app, list(map(str, words)))


def test_a_file_becomes_a_folder_of_table_code_layout_and_page(folder):
    made = folder / "satin"
    layout = json.loads((made / "manifold.json").read_text())
    assert layout["material"] == SATIN
    assert layout["errors"]["ball"] <= layout["tolerance"] == 0.3
    assert layout["against"] == "measured file"
    assert layout["bytes"] == (made / "manifold.ktx2").stat().st_size < 1 << 20
    names = {"manifold.json", "manifold.ktx2", "index.html", *(f"manifold.{one}" for one in layout["code"])}
    assert {path.name for path in made.iterdir()} == names
    assert "glsl" in layout["code"]


def test_the_layout_is_enough_to_read_a_value(folder):
    made = folder / "satin"
    layout = json.loads((made / "manifold.json").read_text())
    texture = layout["texture"]
    texels = np.frombuffer(
        (made / "manifold.ktx2").read_bytes()[-8 * texture["width"] * texture["height"] :], "<f2"
    )
    texels = texels.reshape(texture["height"], texture["width"], 4).astype(float)
    values, sums = layout["values"], layout["sums"]
    first = texels[values["first_row"] : values["first_row"] + values["rows"], : values["columns"], :3]
    assert first.max() > 0.0
    total = texels[: sums["rows"], : sums["columns"]]
    assert np.allclose(total[:, -1, 0], total[:, -1, 1], rtol=2e-3)  # all of a row is below its last column
    assert total[-1, 0, 2] == 1.0


def test_the_page_shows_both_balls_from_the_disk(folder, browser):
    page = browser.new_page(viewport={"width": 400, "height": 400})
    said, asked = [], []
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.set_default_timeout(TIMEOUT_MS)
    page.goto((folder / "satin" / "index.html").as_uri())
    page.wait_for_selector("[data-ready=done], #problem:not([hidden])", state="attached")
    assert said == []
    assert all(url.startswith(("file:", "data:")) for url in asked)
    assert page.text_content("h1") == SATIN
    found = page.evaluate("shader.small.difference()")
    assert 0.0 < found["mean"] < 1.0
    assert page.evaluate("document.getElementById('difference').value").startswith(
        f"{found['mean']:.2f} in the mean"
    )
    azimuth = page.evaluate("shader.state.sun[0]")
    page.focus("#balls")
    page.keyboard.press("ArrowLeft")
    assert page.evaluate("shader.state.sun[0]") == azimuth + 5
    page.evaluate("Object.assign(shader.balls, { step() {}, count: 1e9 })")  # the small balls are enough
    page.select_option("#light", label="studio")
    while page.evaluate("shader.small.count") < 16:  # the page's policy forbids `wait_for_function`
        page.wait_for_timeout(50)
    assert page.evaluate("shader.small.difference().mean") < 1.0


def test_a_folder_becomes_a_folder_per_material_and_is_kept(folder, tmp_path):
    words = (
        "export",
        folder / "files",
        "--pack",
        tmp_path / "pack",
        "--target",
        "shader",
        "--tolerance",
        "1",
    )
    result = run(*words)
    assert result.exit_code == 0, result.output
    page = (tmp_path / "pack" / "index.html").read_text()
    for name in (SATIN, "syn_felt_green"):
        assert (tmp_path / "pack" / name / "manifold.glsl").is_file()
        assert (tmp_path / "pack" / name / "balls.png").is_file()
        assert f'href="{name}/index.html"' in page
    document = json.loads((tmp_path / "pack" / "shaders.json").read_text())
    assert [one["file"] for one in document["shaders"]] == [
        "syn_felt_green/manifold.json", f"{SATIN}/manifold.json",
    ]  # fmt: skip
    before = (tmp_path / "pack" / SATIN / "manifold.ktx2").stat().st_mtime_ns
    assert "2 shaders in" in (again := run(*words)).output
    assert "2 of them kept" in again.output
    assert (tmp_path / "pack" / SATIN / "manifold.ktx2").stat().st_mtime_ns == before
    (tmp_path / "pack" / SATIN / "manifold.glsl").write_text("changed")
    assert "1 of them kept" in run(*words).output


def test_a_place_and_a_material_of_the_library_become_shaders(tmp_path):
    model = small_model(tmp_path)
    for word, against in ((SATIN, "measured file"), ("0.1,0.1", "predicted file")):
        made = tmp_path / word.replace(",", "_")
        result = run("export", word, "-M", model, "--target", "shader", "-o", made, "--tolerance", "1")
        assert result.exit_code == 0, result.output
        layout = json.loads((made / "manifold.json").read_text())
        assert layout["against"] == against
        assert layout["errors"]["ball"] <= 1.0


def test_a_fit_becomes_a_shader(tmp_path):
    result = fit_bsdf(measured("syn_metal_copper"), principled(["base_color", "metallic", "roughness"]))
    fit_json.write_document(tmp_path / "copper.fit.json", fits.document(result, fit_json.FitSource("copper")))
    outcome = run("export", tmp_path / "copper.fit.json", "--target", "shader", "-o", tmp_path / "copper")
    assert outcome.exit_code == 0, outcome.output
    layout = json.loads((tmp_path / "copper" / "manifold.json").read_text())
    assert layout["material"] == "copper"
    assert layout["against"] == "fit"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--target", "shader", "--tolerance", "0"), "a tolerance of 0, expected more than 0"),
        (("--target", "shader", "-o", "x.glsl"), "x.glsl: named like a file, expected a folder"),
        (("--target", "shader", "--pack", "pack"), "--pack works only with a library or a folder"),
        (("--tolerance", "1"), "--tolerance and --prefix work only with --target shader"),
        (("--target", "shadr"), "no target is called 'shadr'"),
        (("--target", "gltf,shader"), "--target gltf,shader: a shader cannot be combined with other"),
    ],
)
def test_wrong_options_are_refused(folder, words, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = run("export", folder / "files" / f"{SATIN}_rgb.bsdf", *words)
    assert result.exit_code != 0
    assert message in str(result.exception) + result.output
    assert list(tmp_path.iterdir()) == []
