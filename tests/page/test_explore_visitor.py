"""The page under odd links, several spectra, a lost WebGL context, and by keyboard alone."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from helpers.browser import control, follow, settle, shown, state, unpacked, visit
from helpers.small_library import NAMES
from PIL import Image

from manifold.colour.conversion import decode_srgb, srgb_to_xyz
from manifold.colour.difference import delta_e_2000
from manifold.core.directions import from_spherical
from manifold.page.commands import Context
from manifold.page.jobs import Queue
from manifold.page.page import make_page
from manifold.page.server import ExplorerServer

ODD = "illuminant=toString&x=-1e9,0&pin=1e300,0"


@pytest.fixture(scope="module")
def opened(browser, address):
    """A page that stays for many tests, since to open one takes Chromium seconds; by a link that nobody copied."""
    return visit(browser, f"{address}#{ODD}")


@pytest.fixture
def page(opened):
    """The open page as it was at the start, which leaves no error behind."""
    page = opened.page
    opened.errors.clear()
    page.set_viewport_size({"width": 1280, "height": 900})
    page.evaluate("""() => {
      document.activeElement.blur();
      document.getElementById("search").value = "";
      scrollTo(0, 0);
      Object.assign(window.explorer, { spectra: [] }).problem("");
      window.explorer.showTab("here");
      window.explorer.reset();
    }""")
    settle(page)
    yield page
    assert opened.errors == []


def answering(result):
    """A worker whose commands all have this result."""
    script = f"from manifold.page.worker import serve\nserve(lambda command, arguments: {result!r})"
    return (sys.executable, "-c", script)


@pytest.fixture(scope="module")
def served(document, tmp_path_factory):
    """A server whose commands do nothing."""
    folder = tmp_path_factory.mktemp("served")
    context = Context(folder, folder / "model.h5", folder / "library.zarr", NAMES, 2, True)
    queue = Queue(answering({"errors": {"ball": 1.0}}))
    server = ExplorerServer(
        make_page(document | {"served": {"targets": [["gltf", "glTF 2.0"]]}}), context, queue=queue
    )
    threading.Thread(target=server.serve_forever, args=[0.01], daemon=True).start()
    yield server
    server.shutdown()
    server.server_close()


@pytest.fixture(scope="module")
def served_page(browser, served):
    return visit(browser, served.address)


def choose_spectrum(page, name, blue, red):
    text = "".join(f"{nm} {blue if nm < 580 else red}\n" for nm in range(380, 781, 10))
    control(page, "#spectrum-file").set_input_files(
        {"name": name, "mimeType": "text/plain", "buffer": text.encode()}
    )
    page.locator("#caption", has_text=name).wait_for()


@pytest.mark.parametrize(
    "fragment",
    [
        ODD,
        f'x=1e308,1e308&lamp=5,5&path=["{NAMES[0]}","{NAMES[1]}",null]',
        f'path=["{NAMES[0]}","{NAMES[1]}","1"]',
    ],
)
def test_a_link_that_nobody_copied_leads_to_a_page_that_works(page, fragment):
    follow(page, fragment)
    now = state(page)
    reach = page.evaluate("window.explorer.map.reach")
    for place in filter(None, (now["x"], (now["pin"] or {}).get("x"))):
        assert all(low <= v <= high for v, (low, high) in zip(place, reach, strict=True))
    assert now["lamp"][0] ** 2 + now["lamp"][1] ** 2 < 1
    assert now["illuminant"] == "D65"
    assert now["path"] is None
    assert "NaN" not in control(page, "#facts").inner_text()


def test_each_state_keeps_the_spectrum_that_it_was_shown_in(page):
    choose_spectrum(page, "red.txt", 0.05, 0.6)
    red = page.evaluate("window.explorer.reflectance")
    control(page, "#pin").click()
    choose_spectrum(page, "blue.txt", 0.6, 0.05)
    settle(page)
    assert page.locator("#pin-caption").text_content().endswith("red.txt")
    assert page.locator("#spectrum-name").text_content() == "blue.txt"
    page.locator("#undo").click()
    settle(page)
    assert page.locator("#caption").text_content().endswith("red.txt")
    assert page.evaluate("window.explorer.reflectance") == red


def test_a_coordinate_that_is_no_number_or_out_of_reach_is_put_right(page):
    field = control(page, "#coordinates input").first
    field.fill("0.25")
    field.press("Tab")
    field.fill("")
    field.press("Tab")
    settle(page)
    assert state(page)["x"][0] == 0.25
    assert field.input_value() == "0.250"
    field.fill("99")
    field.press("Enter")
    settle(page)
    assert float(field.input_value()) == pytest.approx(state(page)["x"][0], abs=1e-3)
    assert state(page)["x"][0] < 99


def test_balls_come_back_after_the_graphics_were_lost(page):
    page.evaluate(
        "window.lost = window.explorer.balls.gl.getExtension('WEBGL_lose_context'); lost.loseContext()"
    )
    page.locator("#problem", has_text="graphics were lost").wait_for()
    control(page, "#like").select_option(NAMES[2])  # would compile a shader
    page.locator("#map").press("ArrowLeft")
    settle(page)
    assert state(page)["like"] == NAMES[2]
    page.evaluate("lost.restoreContext()")
    page.locator("#problem").wait_for(state="hidden")
    page.evaluate("window.explorer.drawBalls()")
    pixel = """() => { const { gl } = window.explorer.balls, found = new Uint8Array(4);
      window.explorer.drawBalls();
      gl.readPixels(gl.drawingBufferWidth / 2, gl.drawingBufferHeight / 2, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, found);
      return [...found]; }"""
    assert page.evaluate(pixel)[3] == 255


def test_a_search_without_a_result_says_so(page):
    page.locator("#search").fill("zzz")
    page.locator("#found", has_text="no material has such a name").wait_for()
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    settle(page)
    assert "at" not in state(page)


def test_a_message_is_seen_wherever_the_page_is_and_can_be_closed(page):
    page.set_viewport_size({"width": 390, "height": 844})
    page.evaluate("window.scrollTo(0, document.body.scrollHeight)")
    bad = {"name": "bad.txt", "mimeType": "text/plain", "buffer": b"no numbers"}
    control(page, "#spectrum-file").set_input_files(bad)
    page.locator("#problem", has_text="bad.txt").wait_for()
    page.evaluate("window.scrollTo(0, document.body.scrollHeight)")
    box = page.locator("#problem").bounding_box()
    assert 0 <= box["y"] < 844 - box["height"]
    page.locator("#problem-close").press("Enter")
    page.locator("#problem").wait_for(state="hidden")


def test_the_page_says_how_far_predictions_between_similar_materials_are_between_them(page, model):
    control(page, "#coordinates")
    found = model.coherence
    expected = f"detour {found.detour:.2f}; 90th percentile {found.detour_p90:.2f}"
    assert expected in page.locator("#coherence").inner_text()
    assert page.locator("#depth-help").is_hidden()


def test_a_map_without_a_field_of_errors_goes_to_a_material_too(browser, document, tmp_path):
    """As maps of four dimensions are."""
    (tmp_path / "four.html").write_text(make_page(document | {"error": None}), encoding="utf-8")
    elsewhere = visit(browser, (tmp_path / "four.html").as_uri())
    error = elsewhere.page.locator("#error-value")
    assert "measured material" in error.inner_text()  # where the page opens
    elsewhere.page.locator("#map").press("ArrowRight")
    elsewhere.page.locator("#error-value", has_text="not computed above three dimensions").wait_for()
    elsewhere.page.locator("#map").press("Enter")
    elsewhere.page.locator("#error-value", has_text="measured material").wait_for()
    assert elsewhere.errors == []
    elsewhere.page.close()


def test_curves_are_described_as_text_and_dashed_ones_named(page):
    control(page, "#pinned").select_option(NAMES[3])
    settle(page)
    page.locator("#tab-here").click()
    red = page.evaluate("window.explorer.reflectance[0]")
    assert f"red {red:.2f}" in page.locator("#spectrum").get_attribute("aria-label")
    assert "incidence 40° at most" in page.locator("#slices").get_attribute("aria-label")
    for part in ("slices", "spectrum"):
        assert NAMES[3] in page.locator(f"#{part}").get_attribute("aria-label")
        assert NAMES[3] in page.locator(f"#{part}-other").inner_text()


def test_only_one_place_of_the_page_speaks_by_itself(page):
    """An output element does so unless it is told not to: at every step of a slider."""
    script = """[...document.querySelectorAll("output, [role=status], [aria-live]")]
      .filter((e) => e.getAttribute("aria-live") !== "off").map((e) => e.id)"""
    assert page.evaluate(script) == ["live"]
    control(page, "#exposure").press("ArrowRight")  # a control settles what was asked for before
    assert control(page, "#exposure").get_attribute("aria-valuetext") == "+0.25 EV"


def test_a_move_on_the_map_is_announced_once_to_screen_readers(page):
    """Not by the name of the map too, which screen readers read again where it has the focus."""
    page.locator("#map").focus()
    name, said = page.locator("#map").get_attribute("aria-label"), page.locator("#live").text_content()
    page.keyboard.press("Enter")
    page.wait_for_function("(said) => document.getElementById('live').textContent !== said", arg=said)
    place = state(page)["at"]
    assert place in page.locator("#live").text_content()
    assert page.locator("#map").get_attribute("aria-label") == name
    page.keyboard.press("Tab")
    settle(page)
    assert place in page.locator("#map").get_attribute("aria-label")
    page.evaluate("document.getElementById('live').textContent = ''")
    control(page, "#exposure").press("ArrowRight")
    page.wait_for_timeout(600)
    assert page.locator("#live").text_content() == ""


def test_the_focus_is_not_lost_with_the_button_that_has_it(page):
    page.locator("#map").press("Enter")
    settle(page)
    for button, other in (("undo", "redo"), ("redo", "undo")):
        page.locator(f"#{button}").press("Enter")
        settle(page)
        assert page.evaluate("document.activeElement.id") == other
    control(page, "#pin").press("Enter")
    settle(page)
    control(page, "#unpin").press("Enter")
    settle(page)
    assert page.evaluate("document.activeElement.id") == "pin"
    page.evaluate("window.explorer.problem('a message')")
    page.locator("#problem-close").press("Enter")
    assert page.evaluate("document.activeElement.id") == "map"


def test_a_name_that_was_found_is_chosen_by_a_click_alone(page):
    """As screen readers do; a finger that touches the list may mean to scroll it."""
    page.locator("#search").fill("syn")
    page.locator("#found li").nth(1).dispatch_event("pointerdown")
    settle(page)
    assert "at" not in state(page)
    page.locator("#found li").nth(1).dispatch_event("click")
    settle(page)
    assert state(page)["at"] in NAMES


def test_without_webgl_the_reason_is_said(browser, address):
    context = browser.new_context()
    context.add_init_script("HTMLCanvasElement.prototype.getContext = ((get) => function (kind, ...rest) {"
                            " return kind === 'webgl2' ? null : get.call(this, kind, ...rest); })"
                            "(HTMLCanvasElement.prototype.getContext)")  # fmt: skip
    without = context.new_page()
    without.goto(address)
    without.locator("#problem", has_text="has no WebGL2, or it is switched off").wait_for()
    without.locator("#map").press("Enter")
    without.locator("#error-value", has_text="measured material").wait_for()
    context.close()


def test_tab_goes_through_a_narrow_page_from_top_to_bottom(page):
    page.set_viewport_size({"width": 390, "height": 844})
    page.locator("#map").focus()
    tops = []
    for _ in range(30):
        page.keyboard.press("Tab")
        top = page.evaluate("document.activeElement.getBoundingClientRect().top + scrollY")
        if page.evaluate("document.activeElement === document.body"):
            break
        tops.append(page.evaluate("document.activeElement.closest('section')?.id") and top)
    assert len(tops) > 10
    assert all(b > a - 60 for a, b in pairwise(tops))  # beside each other in a row


def test_a_folder_or_a_file_that_is_gone_is_a_message(served_page):
    served_page.page.evaluate("""() => {
      const gone = () => Promise.reject(new DOMException("it could not be read", "NotReadableError"));
      return window.explorer.takeDropped([{ name: "folder", size: 0, slice: () => ({ text: gone }), text: gone }]);
    }""")
    assert "folder: it could not be read" in served_page.page.locator("#problem").inner_text()
    assert served_page.errors == []


def test_dropped_files_are_located_completed_or_a_colour_by_what_they_hold(served_page, served):
    spectrum = "nm reflectance\n" + "".join(f"{nm} 0.5\n" for nm in range(380, 781, 20))
    readings = "Geometry,450,550,650\n45as15,0.1,0.2,0.5\n45as45,0.1,0.2,0.5\n"
    dropped = [["b \u00e9.bsdf", "tensor_file..."], ["my sheet.csv", readings], ["red.txt", spectrum]]
    page = served_page.page
    page.evaluate(
        """(dropped) => {
      const files = new DataTransfer();
      for (const [name, text] of dropped) files.items.add(new File([text], name));
      document.dispatchEvent(new DragEvent("drop", { dataTransfer: files, bubbles: true, cancelable: true }));
    }""",
        dropped,
    )
    page.locator("#caption", has_text="red.txt").wait_for()
    page.locator("#tab-export[aria-selected=true]").wait_for()
    for title in ("locate b-", "complete my-sheet.bsdf"):
        page.locator("#jobs li[data-state=done]", has_text=title).wait_for()
    control(page, "#do-export").press("Enter")
    page.locator("#jobs li[data-state=done]", has_text="export here.glb").wait_for()
    called = {(job.call.command, job.call.subject) for job in served.queue.jobs}
    assert called == {("locate", "b-"), ("complete", "my-sheet.bsdf"), ("export", "here.glb")}
    assert served_page.errors == []


def drop_picture(page, name):
    """A grey picture of 200 x 100 is dropped on the page."""
    page.evaluate(
        """async (name) => {
      const canvas = Object.assign(document.createElement("canvas"), { width: 200, height: 100 });
      canvas.getContext("2d").fillRect(0, 0, 200, 100);
      const files = new DataTransfer(), blob = await new Promise((done) => canvas.toBlob(done));
      files.items.add(new File([blob], name));
      document.dispatchEvent(new DragEvent("drop", { dataTransfer: files, bubbles: true, cancelable: true }));
    }""",
        name,
    )
    page.locator("#photo").wait_for()


def test_the_circle_of_a_dropped_photograph_is_dragged_and_its_light_chosen(served_page, served):
    page = served_page.page
    drop_picture(page, "my ball.PNG")
    canvas = page.locator("#photo-canvas")
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    scale = box["width"] / 200

    def drag(start, end):
        page.mouse.move(box["x"] + start[0] * scale, box["y"] + start[1] * scale)
        page.mouse.down()
        page.mouse.move(box["x"] + end[0] * scale, box["y"] + end[1] * scale)
        page.mouse.up()

    drag((90, 40), (90, 80))  # an outline from its middle
    drag((90, 40), (100, 50))  # it is moved
    drag((140, 50), (130, 50))  # its radius becomes smaller
    settle(page)
    circle = [float(v) for v in page.locator("#photo-circle").input_value().split(",")]
    assert circle == pytest.approx([100, 50, 30], abs=1)
    page.locator("#photo-light").select_option("sky")
    page.locator("#photo-turn").fill("-30")
    page.locator("#photo-find").click()
    page.locator("#jobs li[data-state=done]", has_text="photograph my-ball_photo.png").wait_for()
    asked = served.queue.jobs[-1].call.arguments["request"]
    assert (asked.lights, asked.turns_deg) == (["sky"], [-30])
    assert asked.circles == [",".join(f"{v:.1f}" for v in circle)]
    assert [path.name for path in asked.photographs] == ["my-ball.png"]
    assert served_page.errors == []


def test_a_lamp_s_highlight_is_drawn_on_the_photograph_and_dragged(served_page, served):
    page = served_page.page
    drop_picture(page, "lit.png")
    canvas = page.locator("#photo-canvas")
    page.locator("#photo-circle").fill("100,50,40")
    page.locator("#photo-circle").dispatch_event("change")
    page.locator("#photo-lamp").fill("0,0,1")
    page.locator("#photo-lamp").dispatch_event("change")
    assert page.locator("#photo-light").input_value() == "lamp"
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    scale = box["width"] / 200
    page.mouse.move(
        box["x"] + 100 * scale, box["y"] + 50 * scale
    )  # a lamp at the camera shines in the middle
    page.mouse.down()
    page.mouse.move(box["x"] + 120 * scale, box["y"] + 50 * scale)  # half of the radius: 30 degrees
    page.mouse.up()
    settle(page)
    lamp = [float(v) for v in page.locator("#photo-lamp").input_value().split(",")]
    assert lamp == pytest.approx([np.sin(np.pi / 3), 0.0, np.cos(np.pi / 3)], abs=0.05)
    page.locator("#photo-find").click()
    page.locator("#jobs li[data-state=done]", has_text="photograph lit_photo.png").wait_for()
    asked = served.queue.jobs[-1].call.arguments["request"]
    assert asked.lamps == [",".join(f"{v:.3f}" for v in lamp)]
    assert (asked.lights, asked.turns_deg) == ([], [0.0])
    assert served_page.errors == []


def test_pictures_that_no_browser_shows_are_located_with_a_picture_of_their_light(served_page, served):
    page = served_page.page
    raw = {"name": "raw.exr", "mimeType": "image/x-exr", "buffer": b"1234567"}
    control(page, "#photo-file").set_input_files(raw)
    page.locator("#photo-unseen").wait_for()
    page.locator("#photo-light-file").set_input_files(raw | {"name": "probe.hdr", "buffer": b"123"})
    page.locator("#photo-find").click()
    page.locator("#jobs li[data-state=done]", has_text="photograph raw_photo.png").wait_for()
    asked = served.queue.jobs[-1].call.arguments["request"]
    assert [Path(path).name for path in (*asked.photographs, *asked.lights)] == ["raw.exr", "raw-light.hdr"]
    assert served_page.errors == []


def test_without_a_server_a_photograph_is_told_what_it_needs(page):
    drop_picture(page, "ball.png")
    assert "manifold explore" in page.locator("#photo").inner_text()
    assert not page.locator("#photo-form").is_visible()


def test_a_tab_that_is_shown_again_lists_the_jobs_of_another(browser, served, served_page):
    other, asked = visit(browser, served.address).page, "render here.png"
    control(other, "#do-render").click()
    other.locator("#jobs li", has_text=asked).wait_for()
    assert served_page.page.locator("#jobs li", has_text=asked).count() == 0
    served_page.page.evaluate("window.dispatchEvent(new Event('focus'))")
    control(served_page.page, "#jobs li", has_text=asked).wait_for()
    other.close()


def test_a_widget_without_its_package_is_one_clear_line():
    script = "import sys; sys.modules['anywidget'] = None; import manifold.page.widget"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert "pip install 'brdf-manifold[page]'" in run.stderr.splitlines()[-1]
    assert "During handling" not in run.stderr


def test_tabs_are_chosen_by_mouse_and_arrow_keys(page):
    shown = "[...document.querySelectorAll('[role=tabpanel]')].filter((e) => !e.hidden).map((e) => e.id)"
    assert page.evaluate(shown) == ["here"]
    page.locator("#tab-light").click()
    assert page.evaluate(shown) == ["light"]
    page.keyboard.press("ArrowRight")
    assert page.evaluate(shown) == ["compare"]
    assert page.evaluate("document.activeElement.id") == "tab-compare"
    page.keyboard.press("End")
    page.keyboard.press("ArrowRight")
    assert page.evaluate(shown) == ["here"]
    chosen = page.locator("[role=tab][aria-selected=true]")
    assert chosen.count() == 1
    assert chosen.get_attribute("aria-controls") == "here"
    assert page.locator("[role=tab][tabindex='0']").count() == 1


@pytest.mark.parametrize(("width", "height"), [(1280, 800), (390, 844)])
def test_map_ball_and_sliders_are_the_first_screen(page, width, height):
    page.set_viewport_size({"width": width, "height": height})
    page.evaluate("window.explorer.showTab('colour')")
    settle(page)
    boxes = [page.locator(f"#{name}").bounding_box() for name in ("map", "ball", "lightness", "hue")]
    assert all(box["y"] >= 0 and box["y"] + box["height"] <= height for box in boxes)
    assert page.locator("#ball").bounding_box()["height"] > 0.24 * height
    assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_on_a_phone_the_ball_stays_in_view(page):
    page.set_viewport_size({"width": 390, "height": 844})
    settle(page)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    for scrolled in ("0", "300", "document.body.scrollHeight"):
        page.evaluate(f"window.scrollTo(0, {scrolled})")
        settle(page)
        ball = page.locator("#ball").bounding_box()
        assert 0 <= ball["y"] <= 844 - ball["height"]
    assert page.locator("#map").bounding_box()["height"] > 220


def test_balls_and_names_on_the_map_do_not_cover_each_other(page):
    overlaps = """() => {
      const { places, radius } = window.explorer.map;
      const apart = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]) - 2 * radius;
      return places.flatMap((a, i) => places.slice(i + 1).map((b) => apart(a, b)));
    }"""
    assert min(page.evaluate(overlaps)) > -2
    assert page.evaluate("window.explorer.map.lines.flat().join(' ')").count("felt") == 2
    page.evaluate("window.explorer.zoom(4)")
    assert shown(page, "window.explorer.map.places.flat().every(Number.isFinite)")
    page.evaluate("window.explorer.zoom(1)")


def test_a_ball_that_was_moved_aside_is_chosen_where_it_stands(page):
    place = "() => { const { map } = window.explorer; return map.places[2].map((v) => v / map.ratio); }"
    x, y = page.evaluate(place)
    page.locator("#map").click(position={"x": x, "y": y})
    settle(page)
    assert state(page)["at"] == NAMES[2]


def test_hatching_marks_what_the_data_do_not_support(page):
    """The same points are hatched as `isUnsupported` tells of."""
    script = """() => {
      const { map, data } = window.explorer, { error } = data, was = error.unsupported;
      const ground = (value) => {
        error.unsupported = was.map(() => value);
        map.groundKey = null;
        window.explorer.drawMap();
        const { width, height } = map.ground;
        return map.ground.getContext("2d").getImageData(0, 0, width, height).data;
      };
      const [none, all] = [ground(0), ground(1)], corner = 4 * 30 * 40;
      error.unsupported = was;
      map.groundKey = null;
      window.explorer.drawMap();
      return none.slice(0, corner).some((v, k) => Math.abs(v - all[k]) > 30);
    }"""
    assert page.evaluate(script)


def test_an_illuminant_that_does_not_apply_says_why(page):
    page.locator("#tab-light").click()
    assert page.locator("#illuminant").is_disabled()
    assert "no spectrum" in page.locator("#illuminant-reason").inner_text()


def test_kept_looks_come_back_by_a_click_undo_and_a_link(page):
    page.evaluate("window.explorer.goTo(1)")
    page.locator("#keep").click()
    control(page, "#like").select_option(NAMES[3])
    page.locator("#keep").press("Enter")
    page.evaluate("window.explorer.change({ x: [0.1, 0.2], colour: 'blend' })")
    page.locator("#keep").click()
    settle(page)
    assert page.locator("#strip li").count() == 3
    assert page.locator("#strip canvas").count() == 3
    assert page.locator("#strip li").nth(1).inner_text().startswith(f"{NAMES[1]}, like {NAMES[3]}")
    page.locator("#strip li").nth(1).locator("button").first.click()
    settle(page)
    assert (state(page)["at"], state(page)["colour"], state(page)["like"]) == (NAMES[1], "like", NAMES[3])
    link = page.evaluate("location.hash")
    page.locator("#strip [aria-label^=Remove]").first.press("Enter")
    settle(page)
    assert page.locator("#strip li").count() == 2
    assert page.evaluate("document.activeElement.closest('#strip') !== null")
    page.locator("#undo").click()
    settle(page)
    assert page.locator("#strip li").count() == 3
    page.evaluate("window.explorer.reset()")
    settle(page)
    assert page.locator("#strip").is_hidden()
    follow(page, link)
    kept = state(page)["variants"]
    assert [look.get("at") for look in kept] == [NAMES[1], NAMES[1], None]
    assert [look["colour"] for look in kept] == ["blend", "like", "blend"]
    assert kept[2]["x"] == [0.1, 0.2]


def test_kept_looks_are_saved_together(page):
    assert control(page, "#save-looks").is_disabled()
    for k in (0, 2):
        page.evaluate(f"window.explorer.goTo({k})")
        page.locator("#keep").click()
    settle(page)
    with page.expect_download() as download:
        control(page, "#save-looks").click()
    saved = json.loads(Path(download.value.path()).read_text(encoding="utf-8"))
    assert [one["material"] for one in saved["looks"]] == [NAMES[0], NAMES[2]]
    assert all(sum(one["weights"].values()) == pytest.approx(1.0) for one in saved["looks"])


def test_the_picture_is_saved_as_it_is_shown(page):
    with page.expect_download() as download:
        page.locator("#save-picture").click()
    picture = Image.open(download.value.path())
    assert picture.size == tuple(
        page.evaluate("[explorer.balls.gl.canvas.width, explorer.balls.gl.canvas.height]")
    )
    red, _, _, alpha = picture.convert("RGBA").getpixel((picture.width // 2, picture.height // 2))
    assert alpha == 255
    assert red > 10


def columns_of_ball(page):
    """Encoded values of the picture's middle row, (width, 4)."""
    script = """() => { const { gl } = window.explorer.balls;
      window.explorer.drawBalls();
      const width = gl.drawingBufferWidth, row = new Uint8Array(4 * width);
      gl.readPixels(0, gl.drawingBufferHeight >> 1, width, 1, gl.RGBA, gl.UNSIGNED_BYTE, row);
      return packed(row); }"""
    return unpacked(page.evaluate(script)).reshape(-1, 4)


def test_a_wipe_shows_before_on_the_left_and_after_on_the_right(page):
    rows = []
    for k in (3, 1):  # after, then before: pinned
        page.evaluate(f"window.explorer.goTo({k})")
        settle(page)
        rows.append(columns_of_ball(page))
    control(page, "#pin").click()
    page.evaluate("window.explorer.goTo(3)")
    settle(page)
    after, before = rows
    shown = columns_of_ball(page)
    middle = len(shown) // 2
    assert np.array_equal(shown[: middle - 2], before[: middle - 2])
    assert np.array_equal(shown[middle + 2 :], after[middle + 2 :])
    page.locator("#wipe").press("Home")
    settle(page)
    assert np.array_equal(columns_of_ball(page), after)
    assert NAMES[1] in page.locator("#wipe").get_attribute("aria-valuetext")
    control(page, "input[name=view][value=beside]").check()
    settle(page)
    assert page.locator("#wipe").is_hidden()
    assert state(page)["view"] == "beside"
    control(page, "input[name=view][value=wipe]").check()
    control(page, "#unpin").click()
    settle(page)
    assert page.locator("#wipe").is_hidden()


def test_two_materials_are_compared_pixel_by_pixel(page, model):
    page.evaluate("window.explorer.goTo(3)")
    control(page, "#pinned").select_option(NAMES[1])
    control(page, "input[name=view][value=difference]").check()
    settle(page)
    found = page.evaluate("window.explorer.balls.difference([1, 0], window.explorer.light)")
    assert (
        f"mean {found['mean']:.1f}, largest {found['most']:.1f}"
        in page.locator("#difference-text").inner_text()
    )
    balls = page.evaluate("""() => { const { balls, light } = window.explorer;
      return [1, 0].map((k) => packed(balls.image(k, 96).data)); }""")
    pixels = np.array([unpacked(one) for one in balls], dtype=float).reshape(2, -1, 4)
    first, second = (srgb_to_xyz(decode_srgb(one[pixels[0, :, 3] == 255, :3] / 255.0)) for one in pixels)
    expected = delta_e_2000(first, second, srgb_to_xyz(np.ones(3)))
    assert found["mean"] == pytest.approx(expected.mean(), rel=0.02)  # edges are counted a little otherwise
    control(page, "#pinned").select_option(NAMES[3])
    settle(page)
    assert page.evaluate("window.explorer.balls.difference([1, 0], window.explorer.light)")["most"] == 0.0
    control(page, "#unpin").click()
    settle(page)
    assert page.locator("#difference").is_hidden()


def test_the_shadow_lies_on_the_side_away_from_the_light(page):
    corners = """(turn) => { const { explorer } = window, { gl, side } = explorer.balls;
      explorer.turnTo("turn", turn, true);
      explorer.refresh();
      return [-1, 1].map((right) => { const pixel = new Uint8Array(4), { width, height } = gl.canvas;
        gl.readPixels(width / 2 + right * 0.54 * side, height / 2 - 0.4 * side, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
        return pixel[1]; }); }"""
    control(page, "input[name=light][value=sky]").check()
    settle(page)
    left, right = page.evaluate(corners, 0)  # the sun is on the left, behind the viewer
    assert right < left - 20
    left, right = page.evaluate(corners, 120)  # it comes from the right
    assert left < right - 20


def test_materials_are_found_by_gloss_and_colour(page):
    page.locator("#search").fill("gray")  # the other spelling of grey
    words = page.evaluate("window.explorer.searched()")
    greys = [one["name"] for one in words if "grey" in one["words"]]
    listed = page.locator("#found li").all_inner_texts()
    assert [text.split(":")[0] for text in listed if "GU" in text] == greys
    for one in words:
        k = NAMES.index(one["name"])
        gloss = page.evaluate(f"window.explorer.materials.predict(window.explorer.data.X[{k}]).gloss()")
        assert ("glossy" in one["words"].split()) == (gloss >= 70.0)


def test_the_map_comes_with_its_balls(page, model):
    sizes = page.evaluate(
        "window.explorer.data.names.map((_, k) => window.explorer.materials.thumbnail(k).width)"
    )
    assert len(sizes) == len(NAMES)
    assert min(sizes) > 0
    pixel = """(k) => { const ball = window.explorer.materials.thumbnail(k);
      return [...ball.getContext("2d").getImageData(ball.width / 2, ball.height / 2, 1, 1).data]; }"""
    drawn = """(k) => { const ball = window.explorer.pictureOf({ material: k }, null);
      return [...ball.getContext("2d").getImageData(ball.width / 2, ball.height / 2, 1, 1).data]; }"""
    page.evaluate(
        "explorer.pendingThumbnails = explorer.data.names.map((_, k) => k); explorer.nextThumbnail()"
    )
    page.wait_for_function("() => explorer.pendingThumbnails.length === 0")
    for k in range(len(NAMES)):
        assert np.allclose(page.evaluate(pixel, k), page.evaluate(drawn, k), rtol=0, atol=12)  # coarser light


def test_a_finer_ball_replaces_the_coarse_one_on_the_map(page):
    shown = page.evaluate("""() => { const { map } = explorer, before = map.images[2];
      const flat = document.createElement("canvas");
      const show = (image) => { map.showMaterial(2, image); explorer.drawMap(); };
      flat.getContext("2d").fillStyle = "#00ff00";
      flat.getContext("2d").fillRect(0, 0, 300, 150);
      show(flat);
      const [x, y] = map.places[2], pixel = map.canvas.getContext("2d").getImageData(x, y, 1, 1).data;
      show(before);
      return [...pixel.slice(0, 3)]; }""")
    assert shown == [0, 255, 0]


def test_a_page_without_a_server_says_what_one_can(page):
    page.evaluate("window.explorer.showTab('export')")
    assert "manifold explore" in page.locator("#actions-need").inner_text()
    assert page.locator("#actions").is_hidden()


def located(model, name, **gain):
    """What `manifold locate` says of a material of the map, here with gains."""
    own = model.space.own_colours[model.names.index(name)]
    gains = np.array([gain.get(band, 1.0) for band in ("red", "green", "blue")])
    return {
        "name": "a dropped file", "latent": model.latent(name).tolist(), "colours": [own.tolist(), gains.tolist()],
        "errors": {"ball": 2.5, "cube_root": 0.1}, "expected": {"ball": 3.5}, "diagnostics": ["a diagnostic"],
    }  # fmt: skip


def test_the_page_opens_at_a_material(page, model):
    page.evaluate("explorer.reset()")
    settle(page)
    assert page.locator("#error-value").inner_text() == "none, because a measured material lies there"


def test_the_expected_error_is_that_of_the_colour_and_place_that_are_shown(page, model):
    x = (model.X.mean(axis=0) + 0.1).tolist()
    for change, is_known in (({"colour": "blend"}, False), ({"colour": "picked", "srgb": "#3366aa"}, True)):
        page.evaluate("(change) => window.explorer.change(change)", {"x": x, "path": None} | change)
        settle(page)
        text = page.locator("#error-value").inner_text()
        expected = float(model.left_out.expected(np.array(x)).ball)
        assert float(text.split()[0]) == pytest.approx(expected, rel=0.05)  # between nodes of the page's grid
        assert "(CIEDE2000 of the ball (mean of five lights)" in text
        assert ("its colour not given" in text) == (not is_known)
        if not is_known:
            unknown = float(model.left_out.expected(np.array(x), is_colour_known=False).ball)
            assert float(text.partition("colour; ")[2].split()[0]) == pytest.approx(unknown, rel=0.05)
    walk = {"from": NAMES[0], "to": NAMES[3], "t": 0.5}
    page.evaluate("(change) => window.explorer.change(change)", {"colour": "blend", "path": walk})
    settle(page)
    assert page.locator("#error-value").inner_text() == "none: a step of a walk has no point on the map"
    assert page.evaluate(
        "() => window.explorer.latentDocument(window.explorer.state, window.explorer.prediction).latent"
    ) is None  # fmt: skip


def test_a_dropped_material_stands_on_the_map_in_its_own_colours_until_it_is_removed(page, model):
    found = located(model, NAMES[3], red=0.5)
    page.evaluate("(found) => window.explorer.addGuest(found)", found)
    settle(page)
    assert page.locator("#caption").inner_text() == "a dropped file"
    assert page.locator("#error-value").inner_text().startswith("3.5")
    assert "a diagnostic" in page.locator("#diagnostics").inner_text()
    assert "within 2.5 CIEDE2000" in page.locator("#guests").inner_text()
    expected = model.predict(found["latent"], np.array(found["colours"])).albedo(
        from_spherical(np.deg2rad(8.0), 0.0)
    )
    assert np.allclose(page.evaluate("window.explorer.reflectance"), expected, atol=0.01)
    x, y = page.evaluate(
        "(() => { const { map } = explorer; return map.places[6].map((v) => v / map.ratio); })()"
    )
    page.evaluate("window.explorer.goTo(0)")
    settle(page)
    assert state(page)["colour"] == "blend"
    assert page.evaluate("window.explorer.map.names.length") == 7
    page.locator("#map").click(position={"x": x, "y": y})
    settle(page)
    assert state(page)["colour"] == "own"
    page.locator("#guests [aria-label^=Remove]").press("Enter")
    settle(page)
    assert page.locator("#guests").is_hidden()
    assert page.evaluate("window.explorer.map.names.length") == 6
    assert page.locator("#caption").inner_text() == "a dropped file"  # what is shown stays


def test_a_located_file_is_shown_and_a_finished_job_collapses(browser, served, served_page, model):
    page, queue = served_page.page, served.queue
    usual = queue._command
    queue._command = answering(located(model, NAMES[2]) | {"nearest": [[NAMES[2], 0.0]]})
    queue._kill()
    try:
        control(page, "#locate-file").set_input_files(
            {"name": "mine.bsdf", "mimeType": "application/octet-stream", "buffer": b"tensor_file"}
        )
        page.locator("#caption", has_text="mine").wait_for()
    finally:
        queue._command = usual
        queue._kill()
    job = page.locator("#jobs li[data-state=done]", has_text="locate mine")
    job.wait_for()
    assert job.locator("details").get_attribute("open") is None
    assert page.evaluate("window.explorer.guests.length") == 1
    control(page, "#do-predict").click()
    page.locator("#problem", has_text="the colours of a dropped file").wait_for()
    job.locator("summary").click()
    job.locator("button", has_text="Show at").wait_for()
    page.evaluate("explorer.removeGuest(0); explorer.reset(); explorer.problem('')")


def test_commands_are_requested_for_all_kept_looks(served, served_page):
    page = served_page.page
    page.evaluate("explorer.reset()")
    for k in (0, 1):
        page.evaluate(f"window.explorer.goTo({k})")
        page.locator("#keep").click()
    settle(page)
    control(page, "#all-looks").check()
    control(page, "#action-name").fill("both")
    control(page, "#do-predict").click()
    for k in (1, 2):
        page.locator("#jobs li[data-state=done]", has_text=f"predict both-{k}_rgb.bsdf").wait_for()
    first, second = (job.call.arguments["latent"] for job in served.queue.jobs[-2:])
    assert first != second
    page.evaluate("explorer.reset()")
    assert served_page.errors == []


def test_no_command_predicts_without_a_material_that_it_would_use(served, served_page):
    page, before = served_page.page, len(served.queue.jobs)
    page.evaluate("explorer.reset(); explorer.goTo(1); explorer.leaveOut()")
    control(page, "#do-predict").click()
    page.locator("#problem", has_text="commands predict from all materials").wait_for()
    assert len(served.queue.jobs) == before
    page.evaluate("explorer.reset(); explorer.problem('')")
