"""What a visitor of the page may do that nobody planned: odd links, several spectra, lost graphics, only a keyboard."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from itertools import pairwise

import pytest
from browser import chromium, visit
from small_library import NAMES, small_model

from manifold.colour.reflectances import read_reflectance
from manifold.errors import FileFormatError
from manifold.model.manifold import Manifold
from manifold.plots.explorer.actions import Context
from manifold.plots.explorer.jobs import Queue
from manifold.plots.explorer.page import make_page
from manifold.plots.explorer.server import ExplorerServer
from manifold.plots.explorer.tables import tabulate, to_document
from manifold.records import Bands

ENDS = Bands((400.0, 700.0))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("map")


@pytest.fixture(scope="module")
def document(folder):
    model = Manifold.load(small_model(folder))
    return to_document(model, tabulate(model))


@pytest.fixture(scope="module")
def address(document, folder):
    (folder / "map.html").write_text(make_page(document), encoding="utf-8")
    return (folder / "map.html").as_uri()


@pytest.fixture(scope="module")
def browser():
    with chromium() as started:
        yield started


@pytest.fixture(scope="module")
def opened(browser, address):
    """A page that stays for many tests."""
    return visit(browser, address)


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
      window.explorer.reset();
    }""")
    settle(page)
    yield page
    assert opened.errors == []


@pytest.fixture(scope="module")
def elsewhere(browser, address):
    """A window that shows one page after the other: to open one takes Chromium seconds."""
    return visit(browser, address)


@pytest.fixture(scope="module")
def served(document, tmp_path_factory):
    """A server whose commands do nothing."""
    folder = tmp_path_factory.mktemp("served")
    context = Context(folder, folder / "model.h5", folder / "library.zarr", NAMES, 2, True)
    queue = Queue(folder, (sys.executable, "-c", "print('{}')"))
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


def state(page):
    return page.evaluate("window.explorer.state")


def settle(page):
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


def choose_spectrum(page, name, blue, red):
    text = "".join(f"{nm} {blue if nm < 580 else red}\n" for nm in range(380, 781, 10))
    page.locator("#spectrum-file").set_input_files(
        {"name": name, "mimeType": "text/plain", "buffer": text.encode()}
    )
    page.locator("#caption", has_text=name).wait_for()


@pytest.mark.parametrize(
    "fragment",
    ["illuminant=toString", "x=1e308,1e308", "x=-1e9,0&pin=1e300,0", "lamp=5,5",
     f'path=["{NAMES[0]}","{NAMES[1]}",null]', f'path=["{NAMES[0]}","{NAMES[1]}","1"]'],
)  # fmt: skip
def test_a_link_that_nobody_copied_opens_a_page_that_works(elsewhere, address, fragment):
    elsewhere.open(f"{address}#{fragment}")
    page = elsewhere.page
    now = state(page)
    reach = page.evaluate("window.explorer.map.reach")
    for place in filter(None, (now["x"], (now["pin"] or {}).get("x"))):
        assert all(low <= v <= high for v, (low, high) in zip(place, reach, strict=True))
    assert now["lamp"][0] ** 2 + now["lamp"][1] ** 2 < 1
    assert now["illuminant"] == "D65"
    assert now["path"] is None
    assert "NaN" not in page.locator("#facts").inner_text()
    assert elsewhere.errors == []


def test_each_state_keeps_the_spectrum_that_it_was_shown_in(page):
    choose_spectrum(page, "red.txt", 0.05, 0.6)
    red = page.evaluate("window.explorer.reflectance")
    page.locator("#pin").click()
    choose_spectrum(page, "blue.txt", 0.6, 0.05)
    settle(page)
    assert page.locator("#pin-caption").text_content().endswith("red.txt")
    assert page.locator("#spectrum-name").text_content() == "blue.txt"
    page.locator("#undo").click()
    settle(page)
    assert page.locator("#caption").text_content().endswith("red.txt")
    assert page.evaluate("window.explorer.reflectance") == red


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("nm,R,deviation\n400,0.5,a\n700,0.25,b\n", [0.5, 0.25]),
        ("400 0.5\r700 0.25\r", [0.5, 0.25]),
        ("# of a lamp\n700\t0.25\n\n400\t0.5", [0.5, 0.25]),
        ("400;0,5\n700;0,25", [0.5, 0.25]),
        ('"400,0" 0.5\n700 , 0,25 0,1', [0.5, 0.25]),
        ("400,0,5\n700,0,25", "at least two rows"),
        ("400,0.5\n700,0,25", "in the line “700,0,25”"),
        ("400 50\n700 40", "percent"),
        ("0.4 0.5\n700 0.25", "wavelengths in nm"),
        ("400 0.5\n700 nan", "in the line “700 nan”"),
    ],
)
def test_a_spectrum_is_read_as_the_command_reads_it(page, tmp_path, text, expected):
    (tmp_path / "spectrum.txt").write_bytes(text.encode())
    found = page.evaluate(
        """async (text) => {
          await window.explorer.takeSpectrum(new File([text], "spectrum.txt"));
          const said = document.getElementById("problem-text").textContent;
          return window.explorer.spectrum?.rows.map((row) => row[1]) ?? said;
        }""",
        text,
    )
    if isinstance(expected, str):
        assert expected in found
        with pytest.raises(FileFormatError):
            read_reflectance(tmp_path / "spectrum.txt", ENDS)
    else:
        assert found == expected == read_reflectance(tmp_path / "spectrum.txt", ENDS).tolist()


def test_a_coordinate_that_is_no_number_or_out_of_reach_is_put_right(page):
    field = page.locator("#coordinates input").first
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
    page.wait_for_selector("[data-complete]", state="attached")
    page.evaluate(
        "window.lost = window.explorer.balls.gl.getExtension('WEBGL_lose_context'); lost.loseContext()"
    )
    page.locator("#problem", has_text="graphics were lost").wait_for()
    page.locator("#like").select_option(NAMES[2])  # would compile a shader
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


def test_to_undo_is_not_to_follow_the_lamp_back(page):
    page.locator('input[name="light"][value="lamp"]').check()
    settle(page)
    for x in (100, 150, 200):
        page.locator("#ball").hover(position={"x": x, "y": 120})
        page.locator("#map-title").hover()
    assert state(page)["lamp"] != [-0.4, 0.5]
    page.locator("#undo").click()
    settle(page)
    assert state(page)["light"] == "studio"
    assert page.locator("#undo").is_disabled()


def test_a_search_without_a_result_says_so(page):
    page.locator("#search").fill("zzz")
    assert page.locator("#found").inner_text() == "no material has such a name"
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    settle(page)
    assert "at" not in state(page)


def test_a_message_is_seen_wherever_the_page_is_and_can_be_closed(page):
    page.set_viewport_size({"width": 390, "height": 844})
    page.evaluate("window.scrollTo(0, document.body.scrollHeight)")
    bad = {"name": "bad.txt", "mimeType": "text/plain", "buffer": b"no numbers"}
    page.locator("#spectrum-file").set_input_files(bad)
    page.locator("#problem", has_text="bad.txt").wait_for()
    page.evaluate("window.scrollTo(0, document.body.scrollHeight)")
    box = page.locator("#problem").bounding_box()
    assert 0 <= box["y"] < 844 - box["height"]
    page.locator("#problem-close").press("Enter")
    assert page.locator("#problem").is_hidden()


def test_the_map_says_nothing_of_places_out_of_reach(elsewhere, document, folder):
    """Where the materials lie along a line, most of the canvas is: no border there, as between errors."""
    flat = [[a, 0.05 * b] for a, b in document["X"]]
    low, high = ([f(row[q] for row in flat) for q in (0, 1)] for f in (min, max))
    room = [0.25 * (b - a) for a, b in zip(low, high, strict=True)]
    error = document["error"] | {
        "low": [a - r for a, r in zip(low, room, strict=True)],
        "high": [b + r for b, r in zip(high, room, strict=True)],
        "values": [2.0] * len(document["error"]["values"]),
    }
    (folder / "flat.html").write_text(make_page(document | {"X": flat, "error": error}), encoding="utf-8")
    elsewhere.open((folder / "flat.html").as_uri())
    script = """() => { const { canvas, field } = window.explorer.map;
      return [...new Uint32Array(field.getContext("2d").getImageData(0, 0, 64, 64).data.buffer)]; }"""
    assert len(set(elsewhere.page.evaluate(script))) == 1


def test_a_map_without_a_field_of_errors_goes_to_a_material_too(elsewhere, document, folder):
    """As maps of four dimensions are."""
    (folder / "four.html").write_text(make_page(document | {"error": None}), encoding="utf-8")
    elsewhere.open((folder / "four.html").as_uri())
    assert elsewhere.page.locator("#error-value").inner_text() == "not computed above three dimensions"
    elsewhere.page.locator("#map").press("Enter")
    elsewhere.page.locator("#error-value", has_text="measured material").wait_for()
    assert elsewhere.errors == []


def test_curves_are_told_in_words_and_what_is_dashed_is_named(page):
    page.locator("#pinned").select_option(NAMES[3])
    settle(page)
    red = page.evaluate("window.explorer.reflectance[0]")
    assert f"red {red:.2f}" in page.locator("#spectrum").get_attribute("aria-label")
    assert "incidence 40° at most" in page.locator("#slices").get_attribute("aria-label")
    for part in ("slices", "spectrum"):
        assert NAMES[3] in page.locator(f"#{part}").get_attribute("aria-label")
        assert NAMES[3] in page.locator(f"#{part}-part .note").inner_text()


def test_only_one_place_of_the_page_speaks_by_itself(page):
    """An output element does so unless it is told not to: at every step of a slider."""
    script = """[...document.querySelectorAll("output, [role=status], [aria-live]")]
      .filter((e) => e.getAttribute("aria-live") !== "off").map((e) => e.id)"""
    assert page.evaluate(script) == ["live"]
    page.locator("#exposure").press("ArrowRight")
    assert page.locator("#exposure").get_attribute("aria-valuetext") == "+0.25 EV"


def test_a_move_is_said_once(page):
    """Not by the name of the map too, which screen readers read again where it has the focus."""
    page.locator("#map").focus()
    name, said = page.locator("#map").get_attribute("aria-label"), page.locator("#live").inner_text()
    page.keyboard.press("Enter")
    page.wait_for_function("(said) => document.getElementById('live').textContent !== said", arg=said)
    place = state(page)["at"]
    assert place in page.locator("#live").text_content()
    assert page.locator("#map").get_attribute("aria-label") == name
    page.keyboard.press("Tab")
    assert place in page.locator("#map").get_attribute("aria-label")
    page.evaluate("document.getElementById('live').textContent = ''")
    page.locator("#exposure").press("ArrowRight")
    page.wait_for_timeout(600)
    assert page.locator("#live").text_content() == ""


def test_the_focus_is_not_lost_with_the_button_that_has_it(page):
    page.locator("#map").press("Enter")
    settle(page)
    for button, other in (("undo", "redo"), ("redo", "undo")):
        page.locator(f"#{button}").press("Enter")
        settle(page)
        assert page.evaluate("document.activeElement.id") == other
    page.locator("#pin").press("Enter")
    settle(page)
    page.locator("#unpin").press("Enter")
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


def test_a_path_that_was_left_is_off(page):
    page.locator("#path-t").press("End")
    page.locator("#map").press("ArrowLeft")
    settle(page)
    assert page.locator("#path-value").inner_text() == "off"
    assert page.locator("#path-t").input_value() == "0"


def test_in_forced_colours_what_is_chosen_is_seen(page):
    page.emulate_media(forced_colors="active")
    page.locator("#search").fill("syn")
    script = """[...document.querySelectorAll("#found li")].map((e) => getComputedStyle(e).backgroundColor)"""
    chosen, other, *_ = page.evaluate(script)
    page.emulate_media(forced_colors="none")
    assert chosen != other


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


def test_a_choice_stands_beside_its_words(page):
    script = """[...document.querySelectorAll("input[type=radio]")].filter((radio) => {
      const words = document.createRange();
      words.selectNode([...radio.parentElement.childNodes].find((e) => e.nodeType === 3 && e.data.trim()));
      return words.getBoundingClientRect().top > radio.getBoundingClientRect().bottom;
    }).map((radio) => radio.value)"""
    sizes = """new Set([...document.querySelectorAll("input[type=radio]")].map((radio) => radio.clientWidth)).size"""
    for width in (360, 390, 768, 1280, 1920):
        page.set_viewport_size({"width": width, "height": 900})
        assert page.evaluate(script) == []
        assert page.evaluate(sizes) == 1
        assert page.evaluate("document.documentElement.scrollWidth") <= width


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
    assert len(tops) > 20
    assert all(b > a - 60 for a, b in pairwise(tops))  # beside each other in a row


def test_a_folder_or_a_file_that_is_gone_is_a_message(served_page):
    served_page.page.evaluate("""() => {
      const gone = () => Promise.reject(new DOMException("it could not be read", "NotReadableError"));
      return window.explorer.takeDropped([{ name: "folder", size: 0, slice: () => ({ text: gone }), text: gone }]);
    }""")
    assert "folder: it could not be read" in served_page.page.locator("#problem").inner_text()
    assert served_page.errors == []


def test_all_files_that_are_dropped_are_taken_under_their_names(served_page, served):
    served_page.page.evaluate("""() => {
      const files = new DataTransfer();
      for (const name of ["a.bsdf", "b \\u00e9.bsdf"]) files.items.add(new File(["tensor_file..."], name));
      document.dispatchEvent(new DragEvent("drop", { dataTransfer: files, bubbles: true, cancelable: true }));
    }""")
    for title in ("locate a", "locate b-"):
        served_page.page.locator("#jobs li[data-state=done]", has_text=title).wait_for()
    assert {"locate a", "locate b-"} <= {job.action.title for job in served.queue.jobs()}
    assert served_page.errors == []


def test_a_tab_that_is_looked_at_again_shows_what_another_asked_for(browser, served, served_page):
    other, asked = visit(browser, served.address).page, "render here.png"
    other.locator("#do-render").click()
    other.locator("#jobs li", has_text=asked).wait_for()
    assert served_page.page.locator("#jobs li", has_text=asked).count() == 0
    served_page.page.evaluate("window.dispatchEvent(new Event('focus'))")
    served_page.page.locator("#jobs li", has_text=asked).wait_for()
    other.close()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_a_server_that_is_told_to_end_cancels_its_work(tmp_path, number):
    script = f"""
import signal, sys, threading, time
from pathlib import Path
from manifold.plots.explorer.actions import Action, Context
from manifold.plots.explorer.jobs import Queue
from manifold.plots.explorer.server import ExplorerServer
from manifold.workflows.explore import serve_until_interrupted
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # which programs under nohup inherit as ignored
folder = Path({str(tmp_path)!r})
sleeps = (sys.executable, "-c", "import os, time; open('pid', 'w').write(str(os.getpid())); time.sleep(60)")
server = ExplorerServer("", Context(folder, folder, folder, (), 2, True), queue=Queue(folder, sleeps))
server.queue.add(Action("sleep", ()))
while not (folder / "pid").exists() or not (folder / "pid").read_text():
    time.sleep(0.01)
serve_until_interrupted(server, lambda address: print("ready", flush=True))
"""
    process = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "ready\n"
    process.send_signal(number)
    assert process.wait(20) == 0
    process.stdout.close()
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)


def test_a_widget_without_its_package_is_one_clear_line():
    script = "import sys; sys.modules['anywidget'] = None; import manifold.plots.explorer.widget"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert "pip install brdf-manifold[notebook]" in run.stderr.splitlines()[-1]
    assert "During handling" not in run.stderr
