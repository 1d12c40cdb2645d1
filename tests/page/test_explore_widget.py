"""The map as a widget of notebooks: its traits, and its module in a browser with a stand-in for a notebook's model."""

from __future__ import annotations

import json

import numpy as np
import pytest
from helpers.browser import TIMEOUT_MS, chromium
from helpers.small_library import NAMES

from manifold.core.errors import LatentError, UsageError
from manifold.model.colours import ColourChoice

pytest.importorskip("anywidget", reason="anywidget is not installed: pip install anywidget")
from manifold.page.widget import MapWidget

NOTEBOOK = """<!doctype html><style>div.cell { width: 800px }</style>
<div class="cell" id="a"></div><div class="cell" id="b"></div>
<script id="traits" type="application/json">%s</script>
<script id="module" type="text/plain">%s</script>
<script type="module">
const values = JSON.parse(document.getElementById("traits").textContent), listeners = {};
window.saved = 0;
window.model = {
  get: (name) => values[name],
  set: (name, value) => { values[name] = value; (listeners[`change:${name}`] ?? []).forEach((f) => f()); },
  on: (event, f) => (listeners[event] ??= []).push(f),
  off: (event, f) => (listeners[event] = listeners[event].filter((g) => g !== f)),
  save_changes: () => (window.saved += 1),
};
const text = document.getElementById("module").textContent.replaceAll("<\\\\/script", "</" + "script");
const widget = (await import(URL.createObjectURL(new Blob([text], { type: "text/javascript" })))).default;
window.stop = [];
for (const id of ["a", "b"]) window.stop.push(await widget.render({ model, el: document.getElementById(id) }));
window.inside = (id) => document.getElementById(id).firstChild.shadowRoot;
document.body.dataset.ready = "";
</script>"""


@pytest.fixture(scope="module")
def widget(model):
    return MapWidget(model)


@pytest.fixture(scope="module")
def page(widget, tmp_path_factory):
    """Two views of a widget in one page, and its errors."""
    traits = {name: getattr(widget, name) for name in ("data", "latent", "colour", "link")}
    text = NOTEBOOK % (
        json.dumps(traits).replace("</", "<\\/"),
        widget._esm.replace("</script", "<\\\\/script"),
    )
    path = tmp_path_factory.mktemp("notebook") / "notebook.html"
    path.write_text(text, encoding="utf-8")
    with chromium() as browser:
        made = browser.new_page(viewport={"width": 1400, "height": 1200})
        errors: list[str] = []
        made.on("pageerror", lambda error: errors.append(str(error)))
        made.on("console", lambda m: errors.append(m.text) if m.type == "error" else None)
        made.set_default_timeout(TIMEOUT_MS)
        made.goto(path.as_uri())
        made.wait_for_selector("body[data-ready]", state="attached")
        yield made
        assert errors == []


def test_what_is_moved_in_a_view_is_in_the_traits(page):
    page.evaluate("document.addEventListener('keydown', () => (window.pressed = true))")
    before = page.evaluate("model.get('latent')")
    page.locator("#a #map").press("ArrowRight")
    page.wait_for_function("saved > 0")
    after = page.evaluate("model.get('latent')")
    assert after[0] > before[0]
    assert not page.evaluate("window.pressed")  # notebooks have shortcuts of their own
    page.locator("#a #tab-colour").click()
    page.locator("#a #like").select_option(NAMES[1])
    page.wait_for_function("model.get('colour').like !== undefined")
    assert page.evaluate("model.get('colour')") == {"like": NAMES[1]}
    assert f"like={NAMES[1]}" in page.evaluate("model.get('link')")


def test_what_is_set_in_python_is_shown_in_every_view(page, widget):
    # The material whose colours the view has; in those of another one it is a prediction.
    x = widget.model.latent(NAMES[1]).tolist()
    page.evaluate("(x) => model.set('latent', x)", x)
    for view in ("a", "b"):
        page.locator(f"#{view} #tab-here").click()
        page.locator(f"#{view} #nearest tr").first.get_by_text(NAMES[1]).wait_for()
        page.locator(
            f"#{view} #error-value", has_text="none, because a measured material lies there"
        ).wait_for()
    assert page.evaluate("model.get('link')").startswith(
        f"x={NAMES[1]}"
    )  # a view that is opened later is there, too
    page.evaluate("(name) => model.set('link', `x=${name}`)", NAMES[3])
    for view in ("a", "b"):
        page.locator(f"#{view} #caption", has_text=NAMES[3]).wait_for()


def test_a_view_fits_its_cell_and_goes_without_a_trace(page):
    ends = "[...inside('a').querySelectorAll('main > section')].map((e) => e.getBoundingClientRect().right)"
    assert max(page.evaluate(ends)) <= 810
    assert page.evaluate("inside('b').getElementById('link').hidden")
    page.evaluate("stop[1]()")
    assert page.evaluate("document.getElementById('b').children.length") == 0
    page.evaluate("(x) => model.set('latent', x)", [0.0, 0.0])


def test_the_prediction_is_that_of_the_model_in_the_chosen_colour(widget):
    model = widget.model
    wi = wo = np.array([[0.0, 0.0, 1.0]])
    widget.latent, widget.colour = [0.1, -0.1], {"srgb": "#3366aa"}
    colours = model.choose_colour(np.array([0.1, -0.1]), ColourChoice(srgb="#3366aa")).colours
    expected = model.predict(np.array([0.1, -0.1]), colours).eval(wi, wo)
    assert np.array_equal(widget.prediction().eval(wi, wo), expected)
    widget.colour = {"spectrum": [[380.0, 0.05], [780.0, 0.8]]}
    red, _, blue = widget.prediction().eval(wi, wo)[0]
    assert red > blue
    path = (NAMES[0], NAMES[1], 0.4)
    widget.latent, widget.colour = model.between(*path).tolist(), {"between": list(path)}
    assert np.array_equal(widget.prediction().eval(wi, wo), model.interpolate(*path).eval(wi, wo))
    widget.latent = [0.1, -0.1]  # from Python: it is on no path any more
    assert np.array_equal(widget.prediction().eval(wi, wo), model.predict([0.1, -0.1]).eval(wi, wo))
    with pytest.raises(LatentError, match="found 1 coordinate,"):
        widget.latent = [1.0]


def test_what_the_others_predict_is_not_taken_for_the_prediction_of_all(model):
    shown = MapWidget(model)
    shown.link = f"at={model.names[0]}&without=1"
    with pytest.raises(UsageError, match="move the point"):
        shown.prediction()


def test_a_path_on_the_page_is_one_in_python(page):
    page.evaluate("([a, b]) => model.set('link', `path=${JSON.stringify([a, b, 0.5])}`)", NAMES[:2])
    page.locator("#a #caption", has_text="50 % of the way").wait_for()
    page.locator("#a #tab-compare").click()
    page.locator("#a #walk-t").press("ArrowRight")
    page.wait_for_function("model.get('colour').between?.[2] > 0.5")
    start, end, t = page.evaluate("model.get('colour').between")
    assert (start, end) == tuple(NAMES[:2])
    assert 0.5 < t < 0.6
