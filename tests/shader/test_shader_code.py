"""The code of a shader in WebGL 2, and its translations."""

from __future__ import annotations

import re
import shutil
import subprocess

import numpy as np
import pytest
from helpers.chi_square import chi_square_p_value
from helpers.shaders import BrowserShader
from helpers.three_js import node_modules

from manifold.colour import panel
from manifold.core.directions import from_spherical, normalize
from manifold.core.errors import UsageError
from manifold.shader import code, ktx2

TOOLS = [name for name in ("glslangValidator", "spirv-cross") if shutil.which(name) is None]
needs_tools = pytest.mark.skipif(
    bool(TOOLS), reason=f"no {' and '.join(TOOLS)}: apt-get install glslang-tools spirv-cross"
)


@pytest.fixture(scope="module")
def run(browser, satin, glsl):
    """The satin gold in the browser."""
    return BrowserShader(browser, glsl, satin.table.texels)


@pytest.fixture(scope="module")
def run_gloss(browser, gloss):
    """The glossy red in the browser."""
    return BrowserShader(browser, code.glsl(gloss.table, gloss.name), gloss.table.texels)


def directions(rng, count, least=0.02):
    return from_spherical(np.arccos(rng.uniform(least, 1.0, count)), rng.uniform(-np.pi, np.pi, count))


def test_values_and_densities_are_those_of_numpy(run, run_gloss, satin, gloss, rng):
    wi, wo = directions(rng, 10_000), directions(rng, 10_000)
    half = normalize(from_spherical(np.abs(rng.normal(0.0, 0.1, 5000)), rng.uniform(-np.pi, np.pi, 5000)))
    near = 2.0 * np.sum(wi[:5000] * half, axis=1, keepdims=True) * half - wi[:5000]
    wo[:5000] = np.where(near[:, 2:] > 0.02, near, wo[:5000])  # half of them around the mirror direction
    for shader, browser_shader in ((satin, run), (gloss, run_gloss)):
        expected, found = shader.table.eval_cos(wi, wo), browser_shader.eval_cos(wi, wo)
        # Processors filter textures with 8 bits of the place between two texels.
        assert np.mean(np.abs(found - expected) <= 0.01 * np.abs(expected)) > 0.99
        expected, found = shader.table.pdf(wi, wo), browser_shader.pdf(wi, wo)
        assert np.allclose(found, expected, rtol=2e-3)  # single precision, at a lobe of 0.004


def test_a_table_of_fewer_incidences_has_its_own_code(browser, reduced, rng):
    run = BrowserShader(browser, code.glsl(reduced, "reduced"), reduced.texels)
    wi, wo = directions(rng, 2000), directions(rng, 2000)
    assert np.allclose(run.eval_cos(wi, wo), reduced.eval_cos(wi, wo), rtol=0.02, atol=1e-4)
    assert np.allclose(run.pdf(wi, wo), reduced.pdf(wi, wo), rtol=2e-3)


def test_the_ball_has_the_stated_error(run, satin):
    lights = panel.judged()
    f = run.eval_cos(lights.wi, lights.wo) / np.maximum(lights.wo[:, 2:], 1e-6)
    seen = lights.xyz(satin.source.eval(lights.wi, lights.wo), satin.source.bands)
    errors = lights.compare(seen, lights.xyz(f, satin.table.bands))
    assert errors.ball == pytest.approx(satin.errors.ball, abs=0.02)
    assert errors.ball < 0.3 + 0.02


@pytest.mark.parametrize("theta_deg", [0.0, 40.0, 80.0])
def test_samples_follow_the_density_in_the_browser(run, run_gloss, theta_deg):
    wi = from_spherical(np.deg2rad(theta_deg), -1.1)
    for shader in (run, run_gloss):
        p = chi_square_p_value(shader, wi, np.random.default_rng(3), n_samples=100_000, is_glossy=True)
        assert p > 1e-3 / 6  # six tests


def test_weighted_samples_return_the_albedo(run, satin, rng):
    for theta in (0.1, 0.7, 1.2):
        wi = from_spherical(theta, 0.5)[None]
        wo, pdf = run.sample(wi, rng.random((50_000, 2)))
        valid = pdf > 0.0
        found = (run.eval_cos(wi, wo[valid]) / pdf[valid, None]).sum(axis=0) / len(pdf)
        assert found == pytest.approx(satin.table.albedo(wi[0]), rel=0.01)  # 50,000 samples: 0.3 %
        assert found == pytest.approx(satin.source.albedo(wi[0]), rel=0.05)  # the table within 0.3 CIEDE2000


def test_no_direction_gives_a_value_that_is_not_finite(run, run_gloss, rng):
    cosines = np.array([1.0, 1.0 - 1e-7, 0.5, 1e-2, 1e-4, 1e-7, 0.0, -0.3])
    theta, phi = np.arccos(cosines), np.array([0.0, 1e-6, 1.0, np.pi, -np.pi])
    w = from_spherical(*np.meshgrid(theta, phi)).reshape(-1, 3)
    wi, wo = (np.broadcast_to(a, (len(w), len(w), 3)).reshape(-1, 3) for a in (w[:, None], w[None]))
    u = np.stack(np.meshgrid(*2 * [np.array([0.0, 1e-7, 0.5, 1.0 - 1e-7, 1.0])]), axis=-1).reshape(-1, 2)
    for shader in (run, run_gloss):
        f, pdf = shader.eval_cos(wi, wo), shader.pdf(wi, wo)
        assert np.isfinite(f).all()
        assert np.isfinite(pdf).all()
        below = (wi[:, 2] <= 0.0) | (wo[:, 2] <= 0.0)
        assert not f[below].any()
        assert not pdf[below].any()
        above = w[w[:, 2] > 0.0]
        drawn, pdf = shader.sample(np.repeat(above, len(u), axis=0), np.tile(u, (len(above), 1)))
        assert np.isfinite(drawn).all()
        assert np.isfinite(pdf).all()
        assert np.abs(np.linalg.norm(drawn, axis=1) - 1.0).max() < 1e-3  # single precision, at the horizon


def test_an_own_name_of_the_table_can_be_defined(browser, satin, glsl):
    own = "uniform highp sampler2D manifold_table;\n#define MANIFOLD_TABLE manifold_table\n" + glsl
    shader = BrowserShader(browser, own, satin.table.texels)
    wi, wo = from_spherical(0.4, 0.0), from_spherical(0.3, 3.0)
    assert np.allclose(shader.eval_cos(wi, wo), satin.table.eval_cos(wi, wo), rtol=0.01)


def test_the_parser_of_three_js_reads_the_texture(browser, satin):
    modules, page = node_modules(), browser.new_page()

    def answer(route):
        name = route.request.url.removeprefix("http://files.test/")
        body = {"": b"<!doctype html>", "x.ktx2": ktx2.content(satin.table.texels)}.get(name)
        kind = "text/javascript" if name.endswith(".js") else "text/html"
        route.fulfill(body=(modules / name).read_bytes() if body is None else body, content_type=kind)

    page.route("**/*", answer)
    page.goto("http://files.test/")
    script = """async () => {
      const { read } = await import("/three/examples/jsm/libs/ktx-parse.module.js");
      const found = read(new Uint8Array(await (await fetch("/x.ktx2")).arrayBuffer()));
      return [found.vkFormat, found.pixelWidth, found.pixelHeight, found.levels[0].levelData.length];
    }"""
    height, width, _ = satin.table.texels.shape
    assert page.evaluate(script) == [97, width, height, satin.table.texels.nbytes]


@needs_tools
def test_the_code_is_translated_to_hlsl_and_metal(glsl, tmp_path):
    translations = code.translated(glsl)
    assert translations.note is None
    assert set(translations.code) == {"hlsl", "metal"}
    for text in translations.code.values():
        assert text.startswith("// syn_satin_gold")
        for name in ("manifold_eval", "manifold_pdf", "manifold_sample", code.ENTRY):
            assert f" {name}(" in text
    path = tmp_path / "manifold.hlsl"
    path.write_text(translations.code["hlsl"])
    words = [
        "glslangValidator",
        "-D",
        "-V",
        "-S",
        "frag",
        "-e",
        code.ENTRY,
        "-o",
        str(tmp_path / "x.spv"),
        str(path),
    ]
    compiled = subprocess.run(words, capture_output=True, text=True, check=False)
    assert compiled.returncode == 0, compiled.stdout


@needs_tools
@pytest.mark.parametrize("version", ["300 es", "330", "450"])
def test_the_code_compiles_in_every_glsl(glsl, tmp_path, version):
    path = tmp_path / "shader.frag"
    use = (
        "in vec3 wi, wo;\nout vec4 result;\n"
        "void main() { result = manifold_sample(wo.xy, wi) + vec4(manifold_eval(wi, wo), 0.0); }"
    )
    path.write_text(f"#version {version}\n{glsl}\n{use}\n")
    compiled = subprocess.run(["glslangValidator", str(path)], capture_output=True, text=True, check=False)
    assert compiled.returncode == 0, compiled.stdout


def test_two_materials_have_names_of_their_own_in_one_program(glsl):
    renamed = code.renamed(glsl, "dark_copper")
    names = set(re.findall(r"\b\w+(?= ?[(\[=;])", renamed)) & set(re.findall(r"\b\w+(?= ?[(\[=;])", glsl))
    assert not any("manifold_" in name.lower() for name in names)
    assert "vec3 dark_copper_eval(vec3 wi, vec3 wo)" in renamed
    assert "const ivec2 DARK_COPPER_SIZE" in renamed
    assert code.renamed("_manifold_table_sampler manifold.ktx2", "a") == "_a_table_sampler manifold.ktx2"
    for wrong in ("2nd", "a-b", "gl_a", "a__b", ""):
        with pytest.raises(UsageError, match="expected a name of letters"):
            code.renamed(glsl, wrong)


def test_without_the_tools_there_is_glsl_alone_and_a_note(glsl, monkeypatch):
    monkeypatch.setattr(code.shutil, "which", lambda name: None)
    translations = code.translated(glsl)
    assert translations.code == {}
    assert translations.note.startswith("glslang and spirv-cross not found: GLSL only, no HLSL or Metal")


@needs_tools
def test_a_translation_that_fails_is_a_note():
    translations = code.translated("this is no shader")
    assert translations.code == {}
    assert translations.note.startswith("glslangValidator failed: GLSL only")
