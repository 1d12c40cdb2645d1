"""The page in a browser: it predicts as Python does, and every control works by mouse and by keyboard."""

from __future__ import annotations

import json
import shlex
from urllib.parse import quote

import bench_page
import numpy as np
import pytest
from helpers.browser import control, follow, settle, shown, state, unpacked, visit
from helpers.small_library import NAMES, small_library

from manifold.brdf.measured import MeasuredBRDF
from manifold.cli.main import run as command
from manifold.colour import ball_colours
from manifold.colour.conversion import decode_srgb, srgb_to_xyz
from manifold.colour.lights import environment
from manifold.core.directions import from_spherical
from manifold.estimate.attributes import Attributes, Wanted, adjust, factor_of, lab_of
from manifold.estimate.gloss import gloss_units
from manifold.io_rgl import read_bsdf
from manifold.model.blending import blend_weights
from manifold.model.colours import ColourChoice
from manifold.model.manifold import Manifold
from manifold.page.page import make_page
from manifold.page.page_data import tabulate, to_document
from manifold.page.tabulated_pairs import tabulated_pairs

HOSTILE = "</script><img src=x onerror=alert(1)>"


@pytest.fixture(scope="module")
def opened(browser, address):
    return visit(browser, address)


@pytest.fixture
def visited(opened):
    """The one open page as it was at the start; no test leaves an error or a request behind."""
    opened.page.evaluate("window.explorer.reset()")
    settle(opened.page)
    yield opened
    assert opened.errors == []
    assert opened.requests == []


def ball_of_page(page, places):
    """Encoded sRGB (K, 3) of the page's ball at places (K, 2), right and up in radii."""
    script = """(places) => {
      const canvas = document.getElementById("ball"), gl = canvas.getContext("webgl2");
      window.explorer.drawBalls();
      const { width, height } = canvas, { side } = window.explorer.balls, picture = new Uint8Array(4 * width * height);
      gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, picture);
      return places.map(([x, y]) => {
        const [i, j] = [x, y].map((v, k) => Math.floor([width, height][k] / 2 + (v / 1.02) * side / 2));
        return [...picture.slice(4 * (j * width + i), 4 * (j * width + i) + 3)];
      });
    }"""
    return np.array(page.evaluate(script, places.tolist())) / 255.0


def table_of_page(page, x, *, refine=True):
    """Cube roots of colours that the shader has summed on the grid at a place, at rest or moving, (P, 3)."""
    script = """([x, refine]) => {
      const { balls } = window.explorer, { gl } = balls;
      window.explorer.change({ x });
      window.explorer.shown.look = null; // else what was refined stays
      window.explorer.refresh();
      if (refine) balls.refine(0);
      const { target, width, height } = balls.surfaces[0].table, values = new Float32Array(4 * width * height);
      gl.bindFramebuffer(gl.FRAMEBUFFER, target);
      gl.readPixels(0, 0, width, height, gl.RGBA, gl.FLOAT, values);
      return packed(values);
    }"""
    return unpacked(page.evaluate(script, [list(x), refine]), np.float32).reshape(-1, 4)[:, :3]


def test_the_shader_sums_the_prediction_of_python(visited, model, document, rng):
    pairs = tabulated_pairs()
    wi, wo = pairs.wi[: pairs.n_grid], pairs.wo[: pairs.n_grid]
    is_beside_the_plane = np.abs(wo[:, 1]) < 1e-9  # elsewhere the page has the mean of both sides
    for shares in rng.dirichlet(np.ones(len(NAMES)), 2):
        x = shares @ model.X
        f = model.predict(x).eval(wi, wo) * pairs.amplitude[: pairs.n_grid, None] ** 3
        expected = np.cbrt(f @ np.array(document["toSrgb"]["D65"]))[is_beside_the_plane]
        found = table_of_page(visited.page, x)[is_beside_the_plane]
        # Components past the first are bytes relative to it, and texels are half floats.
        assert np.median(np.abs(found - expected)) < 2e-3 * np.median(expected)
        assert np.mean(np.abs(found - expected)) < 0.01 * np.mean(expected)


def test_shaders_ask_for_full_precision(visited):
    """Else half vectors are 16 bits wide where drivers take the defaults of GLSL at their word: 0.3 CIEDE2000."""
    script = """() => {
      const { balls } = window.explorer, { gl } = balls;
      const programs = [...Object.values(balls.programs), ...balls.blends.programs.values()];
      return programs.map(({ handle }) => gl.getShaderSource(gl.getAttachedShaders(handle)[1]).split("\\n")[1]);
    }"""
    found = visited.page.evaluate(script)
    assert len(found) >= 6
    assert set(found) == {
        "precision highp float; precision highp int; precision highp sampler2D; precision highp samplerCube;"
    }


def test_a_moving_ball_makes_up_for_the_materials_that_it_leaves_out(visited, model):
    steps = np.array([(dx, dy) for dx in (-0.3, 0.0, 0.3) for dy in (-0.3, 0.3)])
    places = (model.X[:, None] + steps).reshape(-1, 2)
    x = min(
        places, key=lambda x: min(weight for weight in model.weights(x) if weight > 0.0)
    )  # one is left out
    at_rest = table_of_page(visited.page, x)
    moving = table_of_page(visited.page, x, refine=False)
    assert not np.array_equal(moving, at_rest)
    # A share of less than a thousandth.
    assert np.mean(np.abs(moving - at_rest)) < 0.005 * np.mean(at_rest)


@pytest.fixture(scope="module")
def studio_ball():
    """The quadrature of the package in the page's studio, whose lights are sharper."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ball_colours, "environment", lambda: environment("studio"))
        return ball_colours.ball.__wrapped__(rings=72, spokes=48)


def refined_ball(page, places):
    settle(page)
    page.evaluate("explorer.balls.refine(0); explorer.element.dataset.refined = 'true'")
    return srgb_to_xyz(decode_srgb(ball_of_page(page, places)))


def test_the_ball_of_the_page_is_that_of_the_package(visited, model, rng, studio_ball):
    ball, errors = studio_ball, []
    for shares in rng.dirichlet(np.ones(len(NAMES)), 2):
        x = shares @ model.X
        visited.page.evaluate("(x) => window.explorer.change({ x })", x.tolist())
        expected = ball.xyz(model.predict(x).eval(ball.wi, ball.wo), model.bands)
        errors.append(ball_colours.delta_e(refined_ball(visited.page, ball.places), expected))
    print("mean CIEDE2000 of two balls", np.mean(errors), max(errors))
    assert np.mean(errors) < 0.8  # of single pixels, beside edges of lamps too


def test_a_diffuse_ball_has_no_ripples(visited):
    """Along a circle about its middle, its lightness is smooth."""
    angles = np.linspace(0.0, 2.0 * np.pi, 181)[:-1]
    visited.page.evaluate("window.explorer.goTo(4)")
    assert NAMES[4] == "syn_paper_white"
    for radius in (0.3, 0.6, 0.85):
        places = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        lightness = refined_ball(visited.page, places)[:, 1]
        smooth = np.fft.irfft(np.fft.rfft(lightness)[:8], len(lightness))
        assert np.ptp(lightness) > 0.05
        ripples = np.sqrt(np.mean((lightness - smooth) ** 2))
        assert ripples < 0.0035  # steps of eight bits leave up to 0.0025


def test_a_path_has_the_colours_between_its_ends(visited, model, studio_ball):
    """In reflectance and on the ball as `Manifold.interpolate`; pinned, and in a link, it stays so."""
    page, (start, end), ball = visited.page, NAMES[:2], studio_ball
    x = model.between(start, end, 0.4).tolist()
    path = {"from": start, "to": end, "t": 0.4}
    page.evaluate("([x, path]) => window.explorer.change({ x, path, colour: 'blend' })", [x, path])
    brdf = model.interpolate(start, end, 0.4)
    drawn = refined_ball(page, ball.places)
    found = ball_colours.delta_e(drawn, ball.xyz(brdf.eval(ball.wi, ball.wo), model.bands))
    assert found < 1.0  # what the page may differ by anywhere
    expected = brdf.albedo(from_spherical(np.deg2rad(8.0), 0.0))
    found = page.evaluate("window.explorer.reflectance")
    assert np.allclose(found, expected, atol=0.01)  # by spheres of different nodes
    assert f"40 % of the way from {start} to {end}" in page.locator("#caption").inner_text()
    control(page, "#pin").click()
    page.evaluate("window.explorer.goTo(2)")
    settle(page)
    link = page.evaluate("location.hash")
    page.evaluate("window.explorer.reset()")
    follow(page, link)
    follow(page, "#path=" + quote(json.dumps([*NAMES[:2], 0.4])))
    assert np.allclose(state(page)["x"], x)  # a path says where it is
    follow(page, link)
    pinned = page.evaluate("window.explorer.pinned.prediction.reflectance()")
    assert np.allclose(pinned, expected, atol=0.01)
    control(page, "#unpin").click()
    settle(page)


@pytest.mark.slow
def test_the_ball_of_the_page_is_that_of_mitsuba_in_the_same_light(visited, model):
    places = bench_page.places(model, 10, 0)
    errors = [bench_page.compare_balls(visited.page, model, x, 128).file for x in places]
    print("mean CIEDE2000 of ten balls", np.mean(errors), max(errors))
    assert np.mean(errors) <= 1.0


@pytest.mark.parametrize("choice", [{"like": "syn_metal_copper"}, {"srgb": "#3070c0"}, {"srgb": "#101010"}])
def test_a_chosen_colour_gives_the_reflectance_that_python_gives(visited, model, choice, rng):
    x = rng.dirichlet(np.ones(len(NAMES))) @ model.X
    colours = model.choose_colour(x, ColourChoice(**choice)).colours
    expected = model.colours.reached(x, colours)
    mode = {"colour": "like" if "like" in choice else "picked", **choice}
    visited.page.evaluate("([x, mode]) => window.explorer.change({ x, ...mode })", [x.tolist(), mode])
    found = shown(visited.page, "window.explorer.reflectance")
    assert np.allclose(found, expected, atol=0.01)  # spheres of 200 and of 1024 nodes


def test_a_measured_material_is_compared_with_what_the_others_predict(visited, model, document):
    page, k = visited.page, 3
    page.evaluate(f"window.explorer.goTo({k})")
    control(page, "#leave-out").click()
    u = np.array(shown(page, "[...window.explorer.prediction.u]"))
    others = np.delete(model.X, k, axis=0)
    assert u[k] == 0.0
    assert np.allclose(
        np.delete(u, k), blend_weights(model.X[k : k + 1], others, document["lengthScale"]), atol=1e-5
    )
    assert page.evaluate("window.explorer.pinned.prediction.u")[k] == 1.0
    assert np.allclose(page.evaluate("window.explorer.reflectance"), document["reflectances"][k], atol=0.05)
    assert f"{NAMES[k]} predicted by the others" in page.locator("#caption").inner_text()
    link = page.evaluate("location.hash")
    control(page, "#unpin").click()
    page.evaluate("window.explorer.goTo(1)")
    assert not state(page)["without"]
    assert page.locator("#pin-caption").inner_text() == ""
    follow(page, link)
    assert state(page)["without"]
    assert not state(page)["pin"]["without"]


def test_dragging_and_keys_move_the_point(visited):
    page = visited.page
    box = page.locator("#map").bounding_box()
    page.mouse.move(box["x"] + 20, box["y"] + 20)
    page.mouse.down()
    page.mouse.move(box["x"] + 160, box["y"] + 250, steps=4)
    settle(page)  # the last frame of the drag is drawn before the button is let go
    page.mouse.up()
    settle(page)
    assert page.locator("#undo").is_enabled()
    dragged = state(page)["x"]
    assert f"x={dragged[0]:.3f}"[:6] in page.evaluate("decodeURIComponent(location.hash)")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Shift+ArrowUp")
    settle(page)
    moved = state(page)["x"]
    assert moved[0] > dragged[0]
    assert moved[1] > dragged[1]
    page.keyboard.press("Enter")
    settle(page)
    assert state(page)["at"] in NAMES
    page.keyboard.press("Control+z")
    settle(page)
    assert state(page)["x"] == pytest.approx(moved)
    page.locator("#redo").click()
    settle(page)
    assert state(page)["at"] in NAMES


def test_every_control_does_what_it_says(visited):
    page = visited.page
    page.locator("#search").fill("copper")
    page.keyboard.press("Enter")
    settle(page)
    assert state(page)["at"] == "syn_metal_copper"
    control(page, "#pin").press("Enter")
    control(page, "#nearest button").nth(1).press("Enter")
    control(page, 'input[name="light"][value="lamp"]').press("Space")
    page.locator("#ball").focus()
    page.keyboard.press("ArrowLeft")
    page.locator("#ball").hover(position={"x": 150, "y": 100})
    control(page, "#exposure").press("ArrowRight")
    control(page, "#like").select_option("syn_felt_green")
    settle(page)
    now = state(page)
    assert now["pin"]["at"] == "syn_metal_copper"
    assert now["at"] != "syn_metal_copper"
    assert now["light"] == "lamp"
    assert now["exposure"] == 0.25
    assert now["like"] == "syn_felt_green"
    control(page, "#picked").fill("#3366aa")
    settle(page)
    assert state(page)["colour"] == "picked"
    control(page, 'input[name="colour"][value="blend"]').check()
    control(page, "#walk-from").select_option(NAMES[0])
    control(page, "#walk-to").select_option(NAMES[3])
    control(page, "#walk-t").press("End")
    settle(page)
    assert state(page)["at"] == NAMES[3]
    assert state(page)["path"]["t"] == 1
    control(page, "#pinned").select_option(NAMES[1])
    control(page, "#unpin").click()
    settle(page)
    assert state(page)["pin"] is None
    control(page, "#coordinates input").first.fill("0.25")
    page.keyboard.press("Tab")
    settle(page)
    assert state(page)["x"][0] == 0.25
    before = page.evaluate("document.body.dataset.theme")
    page.locator("#theme").press("Enter")
    assert page.evaluate("document.body.dataset.theme") != before
    page.locator("#zoom-in").click()
    page.locator("#zoom-out").press("Enter")
    assert page.evaluate("window.explorer.map.zoom") == 1


def test_the_page_says_what_it_shows_of_anisotropic_materials(visited, document):
    assert document["anisotropic"] == [False] * len(document["names"])
    found = visited.page.evaluate(
        """() => {
          const { data } = window.explorer, before = window.explorer.diagnostics();
          data.anisotropic.fill(true);
          const after = window.explorer.diagnostics();
          data.anisotropic.fill(false);
          return after.filter((text) => !before.includes(text));
        }"""
    )
    assert [text.startswith("anisotropic: the page shows it") for text in found] == [True]


def test_a_link_restores_what_was_shown(visited):
    follow(visited.page, "#x=0.5,-0.25&srgb=%23336699&lamp=0.2,0.3&exposure=1&pin=syn_metal_copper")
    now = state(visited.page)
    assert now["x"] == [0.5, -0.25]
    assert (now["colour"], now["srgb"]) == ("picked", "#336699")
    assert (now["light"], now["exposure"]) == ("lamp", 1)
    assert now["pin"]["at"] == "syn_metal_copper"
    follow(visited.page, "#x=nan,1&like=%3Cimg%3E&pin=1&path=%5B1&exposure=1e9")
    now = state(visited.page)
    assert now["pin"] is None
    assert (now["colour"], now["exposure"]) == ("blend", 3)


def test_downloads_hold_the_latent_and_the_colours(visited):
    page = visited.page
    control(page, "#like").select_option("syn_felt_green")
    settle(page)
    documents = {}
    for name in ("latent", "colours"):
        with page.expect_download() as download:
            page.locator(f"#save-{name}").click()
        with open(download.value.path(), encoding="utf-8") as stream:
            documents[name] = json.load(stream)
    assert documents["latent"]["latent"] == state(page)["x"]
    assert sum(documents["latent"]["weights"].values()) == pytest.approx(1.0)
    assert documents["colours"]["colour"] == {"like": "syn_felt_green"}
    assert len(documents["colours"]["reflectance"]) == 3


def test_hostile_names_are_text(browser, document, tmp_path):
    page = tmp_path / "hostile.html"
    names = [HOSTILE, "javascript:alert(1)", *document["names"][2:]]
    page.write_text(make_page(document | {"names": names, "library": HOSTILE}), encoding="utf-8")
    made = visit(browser, page.as_uri())
    dialogs = []
    made.page.on("dialog", lambda dialog: dialogs.append(dialog.message) or dialog.dismiss())
    made.page.locator("#search").fill("script")
    made.page.keyboard.press("Enter")
    control(made.page, "#pin").click()
    made.page.locator("#map").hover()
    settle(made.page)
    assert HOSTILE in made.page.locator("#library").text_content()
    assert made.page.locator("img").count() == 0
    assert dialogs == []
    assert made.errors == []
    assert made.requests == []
    made.page.close()


def test_everything_that_can_be_operated_has_a_name(visited):
    script = """[...document.querySelectorAll("button, select, input, canvas, svg")].filter((e) =>
      !(e.getAttribute("aria-label") || e.labels?.length || e.textContent.trim())).map((e) => e.outerHTML)"""
    assert visited.page.evaluate(script) == []
    assert visited.page.locator("[aria-live=polite]").count() == 1


def test_nothing_is_wider_than_the_window(visited):
    for width in (360, 390, 768, 1280):
        visited.page.set_viewport_size({"width": width, "height": 900})
        assert visited.page.evaluate("document.documentElement.scrollWidth") <= width


def test_three_dimensions_have_a_slider(browser, tmp_path):
    from manifold.library.store import Library
    from manifold.model.settings import BlendSettings

    model = Manifold.fit(Library.open(small_library(tmp_path)), BlendSettings(latent_dim=3))
    (tmp_path / "map.html").write_text(make_page(to_document(model, tabulate(model))), encoding="utf-8")
    made = visit(browser, (tmp_path / "map.html").as_uri())
    before = state(made.page)["x"]
    control(made.page, "#coordinates input[type=range]").press("ArrowRight")
    settle(made.page)
    after = state(made.page)["x"]
    assert after[:2] == before[:2]
    assert after[2] > before[2]
    assert made.errors == []
    made.page.close()


def lightness_of(page, places):
    """Of the moving picture, which is lit from the same environment as the one at rest."""
    settle(page)
    return srgb_to_xyz(decode_srgb(ball_of_page(page, np.array(places))))[:, 1]


def test_environments_and_shapes_are_chosen_turned_and_restored(visited):
    page = visited.page
    page.evaluate("window.explorer.goTo(2)")  # glossy: it mirrors the lights
    places = [[x, y] for x in np.linspace(-0.8, 0.8, 9) for y in np.linspace(-0.5, 0.5, 5)]
    seen = [lightness_of(page, places)]
    for light in ("sky", "room"):
        control(page, f'input[name="light"][value="{light}"]').check()
        seen.append(lightness_of(page, places))
    box = page.locator("#ball").bounding_box()
    page.mouse.move(box["x"] + 200, box["y"] + 200)
    page.mouse.down()
    page.mouse.move(box["x"] + 300, box["y"] + 200, steps=3)
    page.mouse.up()
    seen.append(lightness_of(page, places))
    assert abs(state(page)["turn"] - 270 * 100 / box["width"]) < 1
    control(page, 'input[name="shape"][value="box"]').check()
    seen.append(lightness_of(page, places))
    control(page, "#turnShape").press("ArrowRight")
    page.locator("#ball").press("ArrowRight")
    seen.append(lightness_of(page, places))
    assert state(page)["turnShape"] == 30 + 1 + 5
    control(page, 'input[name="shape"][value="cloth"]').check()
    seen.append(lightness_of(page, places))
    for k, one in enumerate(seen):
        for other in seen[:k]:
            assert np.abs(one - other).max() > 0.02
    now, link = state(page), page.evaluate("location.hash")
    page.evaluate("window.explorer.reset()")
    follow(page, link)
    restored = state(page)
    assert [restored[k] for k in ("light", "turn", "shape", "turnShape")] == [
        now[k] for k in ("light", "turn", "shape", "turnShape")
    ]


def test_turning_the_light_once_around_changes_nothing(visited):
    page, places = visited.page, [[0.3, 0.3], [-0.4, 0.2]]
    before = lightness_of(page, places)
    page.evaluate("window.explorer.turnTo('turn', 90, true)")
    turned = lightness_of(page, places)
    page.evaluate("window.explorer.turnTo('turn', 360, true)")
    assert state(page)["turn"] == 0
    assert np.abs(turned - before).max() > 0.02
    assert np.allclose(lightness_of(page, places), before, atol=0.02)  # coarser while it turns


def test_gloss_and_colour_of_the_page_are_those_of_the_package(visited, model):
    script = """(x) => { window.explorer.change({ x }); window.explorer.showTab("colour"); window.explorer.refresh();
      return [window.explorer.prediction.gloss(), ...window.explorer.attributesShown.lch]; }"""
    for name in NAMES:
        gloss, *lch = visited.page.evaluate(script, model.latent(name).tolist())
        brdf = model.material(name)
        assert gloss == pytest.approx(gloss_units(brdf, (60.0,))[60.0], rel=0.05)
        lightness, a, b = lab_of(brdf)
        assert lch[0] == pytest.approx(lightness, abs=0.3)
        assert lch[1] == pytest.approx(np.hypot(a, b), abs=0.3)


def test_a_tinted_place_is_that_of_the_package(visited, model):
    x = 0.5 * (model.X[1] + model.X[3])
    wanted = Attributes({"lightness": Wanted(55.0), "chroma": Wanted(30.0), "hue": Wanted(250.0)})
    adjusted = adjust(model, x, wanted)
    expected = model.predict(adjusted.place.latent, adjusted.colours).albedo(
        from_spherical(np.deg2rad(8.0), 0.0)
    )
    change = "(x) => window.explorer.change({ x, colour: 'lch', lch: [55, 30, 250] })"
    visited.page.evaluate(change, x.tolist())
    assert np.allclose(shown(visited.page, "window.explorer.reflectance"), expected, atol=0.01)


def test_attributes_are_set_by_sliders_and_said_where_they_are_out_of_reach(visited):
    page = visited.page
    page.evaluate("window.explorer.goTo(3)")
    control(page, "#lightness").press("ArrowLeft")
    settle(page)
    now = state(page)
    assert now["colour"] == "lch"
    assert "lch=" in page.evaluate("location.hash")
    control(page, "#hue").fill("200")
    assert state(page)["lch"][2] == 200
    control(page, "#chroma").fill("120")
    settle(page)
    assert "reached" in page.locator("#attributes-missed").inner_text()
    page.keyboard.press("Control+z")
    settle(page)
    link = page.evaluate("location.hash")
    lch = state(page)["lch"]
    page.evaluate("window.explorer.reset()")
    follow(page, link)
    assert np.allclose(state(page)["lch"], lch, atol=1e-3)
    assert page.evaluate("window.explorer.plainColour(explorer.state).srgb").startswith("#")


@pytest.mark.parametrize(
    ("colour", "is_material"), [("blend", True), ("like", False), ("picked", True), ("lch", False)]
)
def test_shown_gloss_command_makes_the_shown_material_with_another_gloss(
    visited, model, tmp_path, colour, is_material
):
    x = model.X[3] if is_material else 0.5 * (model.X[1] + model.X[3])
    change = """([x, colour, like]) => {
      window.explorer.change({ x, colour, like, srgb: "#8090a0", lch: [55, 30, 250] });
      window.explorer.showTab("colour"); }"""
    visited.page.evaluate(change, [x.tolist(), colour, NAMES[0]])
    settle(visited.page)
    gloss = float(visited.page.locator("#gloss").inner_text().removesuffix(" GU"))
    manifold, *words = shlex.split(visited.page.locator("#gloss-command").inner_text())
    assert manifold == "manifold"
    made = {}
    for units in (gloss, 2.0 * gloss):
        file = tmp_path / f"{units:g}_rgb.bsdf"
        options = [f"60={units:g}" if word == "60=VALUE" else word for word in words[:-1]]
        words_run = [*options, str(file), "-M", str(model.library.path.with_name("model.h5"))]
        with pytest.raises(SystemExit) as left:
            command(words_run)
        assert left.value.code == 0
        made[units] = MeasuredBRDF(read_bsdf(file))
        assert gloss_units(made[units], (60.0,))[60.0] == pytest.approx(units, rel=0.05)
    # With the gloss that is shown, the command makes the shown material: its colour at 45/0.
    shown_factor = shown(visited.page, "window.explorer.prediction.factor()")
    assert np.allclose(factor_of(made[gloss]), shown_factor, atol=0.02)


def test_material_that_no_command_makes_shows_no_gloss_command(visited):
    page = visited.page
    page.evaluate("window.explorer.goTo(3); window.explorer.showTab('colour')")
    settle(page)
    assert page.locator("#gloss-note").is_visible()
    page.evaluate("window.explorer.change({ without: true })")
    settle(page)
    assert not page.locator("#gloss-note").is_visible()


def test_a_picture_at_rest_is_drawn_finely(visited):
    page = visited.page
    page.evaluate("window.explorer.goTo(2)")
    coarse = shown(page, "explorer.balls.gl.canvas.height")
    page.evaluate("explorer.rest = 10; explorer.refineLater()")
    page.locator("[data-refined=true]").wait_for(state="attached")
    page.evaluate("explorer.rest = 1e6")
    assert coarse < page.evaluate("explorer.balls.gl.canvas.height")
    assert page.evaluate("explorer.balls.surfaces[0].isRefined")
